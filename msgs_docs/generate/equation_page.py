"""Generate ``msgs_docs/equations.md`` from the equations of the papers in ``equations/paper_NNN.yaml``."""

import importlib
import inspect
from collections import Counter
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import yaml
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from msgs_docs.generate.rows import page_text, table_lines
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS
from train_ato.scenario.scenario import load_scenario

STRICT = ConfigDict(extra="forbid")


class Form(Enum):
    """Form of an equation in the code."""

    LITERAL = "literal"
    CORRECTED = "corrected"
    OPTION = "option"
    DEPARTURE = "departure"
    NOT_NEEDED = "not needed"


MEANINGS = {
    Form.LITERAL: "as printed; a note names additions that do not change it",
    Form.CORRECTED: "the print has an error; the note names the correction",
    Form.OPTION: "the default differs; the settings give the printed form",
    Form.DEPARTURE: "otherwise, without a setting for the printed form; note: reason; settings: nearest form",
    Form.NOT_NEEDED: "definition, step of a derivation or a proof, or general form of another equation; no code",
}


@dataclass(frozen=True, config=STRICT)
class Equation:
    """One numbered equation.

    Attributes
    ----------
    number
        Number in the paper.
    content
        Its content in a few words.
    form
        Form in the code.
    places
        ``module:qualified.name`` of a function or class, or ``folder/file:text`` with a text of the file; main place
        first.
    note
        Addition, correction, reason or effect.
    settings
        Assignments of ``--set`` for the printed form, or the nearest one.
    """

    number: int
    content: str
    form: Form
    places: tuple[str, ...] = ()
    note: str = ""
    settings: tuple[str, ...] = ()


@dataclass(frozen=True, config=STRICT)
class EquationTable:
    """Equations of one paper.

    Attributes
    ----------
    paper, title
        Number and subject of the paper.
    last
        Number of its last equation.
    scenario
        Shipped scenario of the paper, for the settings.
    rows
        Its equations.
    """

    paper: str
    title: str
    last: int
    scenario: str
    rows: tuple[Equation, ...]


EQUATION_TABLES = tuple(
    EquationTable(**yaml.safe_load(path.read_text(encoding="utf-8")))
    for path in sorted(Path(__file__).with_name("equations").glob("paper_*.yaml"))
)


def source_line(place: str, root: Path) -> tuple[str, int]:
    """Return the path from the top folder and the line of a place.

    Parameters
    ----------
    place
        ``module:qualified.name``, or ``folder/file:text``.
    root
        Top folder of the repository.
    """
    where, _, name = place.partition(":")
    if "/" in where:
        return where, _line_of_text(root / where, name, place)
    try:
        found: Any = importlib.import_module(where)
        for part in name.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"place '{place}': {error}; name a function or class") from None
    found = getattr(found, "fget", None) or getattr(found, "py_func", found)  # a property, a compiled function
    try:
        path, line = Path(inspect.getsourcefile(found) or ""), inspect.getsourcelines(found)[1]
    except TypeError:
        raise ValueError(f"place '{place}' has no source; name a function or class") from None
    return str(path.resolve().relative_to(root)), line


def _line_of_text(path: Path, text: str, place: str) -> int:
    """Return the line of the first occurrence of a text in a file."""
    if not path.is_file():
        raise ValueError(f"place '{place}': no such file; correct it")
    content = path.read_text(encoding="utf-8")
    if not text or text not in content:
        raise ValueError(f"place '{place}': the file does not contain this text; correct it")
    return content[: content.index(text)].count("\n") + 1


REGISTRIES = {"laws": LAWS, "observers": OBSERVERS, "compensations": COMPENSATIONS}
"""Registry of the components by block of a scenario."""


def problems(table: EquationTable, root: Path) -> list[str]:
    """Return one line per fault of a table: numbers, places, notes and settings."""
    numbers = [row.number for row in table.rows]
    lines = [
        f"{table.paper} ({number}): {numbers.count(number)} rows; write one"
        for number in range(1, table.last + 1)
        if numbers.count(number) != 1
    ]
    lines += [
        f"{table.paper} ({number}): no such equation; remove it" for number in numbers if not 1 <= number <= table.last
    ]
    for row in table.rows:
        lines += [f"{table.paper} ({row.number}): {text}" for text in _faults(row, table.scenario, root)]
    return lines


def _faults(row: Equation, scenario: str, root: Path) -> Iterator[str]:
    """Yield the faults of one row."""
    if not row.places and row.form is not Form.NOT_NEEDED:
        yield "no place in the code; name one"
    for place in row.places:
        try:
            source_line(place, root)
        except ValueError as error:
            yield str(error)
    if not row.note and row.form in (Form.CORRECTED, Form.DEPARTURE, Form.NOT_NEEDED):
        yield f"{row.form.value} without a note; give the reason"
    if row.form is Form.OPTION and not row.settings:
        yield "option without settings; name the parameter and its value"
    if row.form in (Form.LITERAL, Form.NOT_NEEDED) and row.settings:
        yield f"{row.form.value} with settings; correct the form"
    for text in row.settings:
        try:
            if not changes_run(text, scenario):
                yield f"setting '{text}': is the default and the value of {scenario}; remove it"
        except ValueError as error:
            yield f"setting '{text}': {error}"


def changes_run(setting: str, scenario: str) -> bool:
    """Return True if an assignment differs from the default of the parameter, or from the scenario."""
    plain, changed = load_scenario(scenario)[0], load_scenario(scenario, (setting,))[0]
    block, *names = setting.partition("=")[0].split(".")
    if block not in REGISTRIES:
        return changed != plain
    component, parameter = names
    registry, value = REGISTRIES[block], getattr(changed, block)[component][parameter]
    registry.check_parameters(component, {parameter: value})
    default = {entry.name: entry.default for entry in registry.parameters(component)}[parameter]
    given = getattr(plain, block).get(component, {}).get(parameter, default)
    return bool(value not in (default, given) or default != given)


PAGE = Path("msgs_docs", "equations.md")


def page(root: Path) -> str:
    """Return the text of the page."""
    lines: list[str] = []
    for table in EQUATION_TABLES:
        lines += ["", f"## Paper {table.paper}: {table.title}", ""]
        lines += [f"Settings with `train-ato run {table.scenario} --set ...`.", ""]
        heads = ("equation", "content", "form", "place", "note", "settings")
        lines += table_lines(heads, (_row(row, root) for row in table.rows))
    forms = [f"| {form.value} | {MEANINGS[form]} |" for form in Form]
    rows = [(table.paper, len(table.rows), *counts(table).values()) for table in EQUATION_TABLES]
    counted = table_lines(("paper", "equations", *(form.value for form in Form)), rows)
    return page_text(PAGE.stem, forms=forms, counts=counted, tables=lines)


def counts(table: EquationTable) -> dict[Form, int]:
    """Return the number of equations of a paper by form."""
    found = Counter(row.form for row in table.rows)
    return {form: found[form] for form in Form}


def _row(row: Equation, root: Path) -> tuple[str, ...]:
    places = ", ".join(_linked(place, root) for place in row.places) or "-"
    settings = " ".join(f"`{text}`" for text in row.settings) or "-"
    return f"({row.number})", row.content, row.form.value, places, row.note or "-", settings


def _linked(place: str, root: Path) -> str:
    """Return a place as a link to its line."""
    path, line = source_line(place, root)
    where, _, name = place.partition(":")
    link = f"[{path}:{line}](../{path}#L{line})"
    return link if "/" in where else f"`{name}` {link}"
