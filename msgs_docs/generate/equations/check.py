"""Check of the tables of equations: complete, with places that exist and settings that the program accepts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from msgs_docs.generate.equations.places import source_line
from msgs_docs.generate.equations.row import Equation, EquationTable, Form
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS
from train_ato.scenario.scenario import load_scenario

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
    """Return True if an assignment differs from the default of the parameter, or from the scenario.

    Raises
    ------
    ValueError
        If the program does not accept it.
    """
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
