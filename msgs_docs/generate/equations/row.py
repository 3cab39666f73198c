"""Equations of a paper: one row per equation, read from ``paper_NNN.yaml``."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import yaml


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


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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


def read_equations(path: Path) -> EquationTable:
    """Return the equations of a file; unknown keys and forms raise TypeError or ValueError."""
    data: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    rows = []
    for row in data.pop("rows"):
        lists: dict[str, Any] = {key: tuple(row.pop(key, ())) for key in ("places", "settings")}
        rows.append(Equation(form=Form(row.pop("form")), **lists, **row))
    return EquationTable(rows=tuple(rows), **data)


EQUATION_TABLES = tuple(read_equations(path) for path in sorted(Path(__file__).parent.glob("paper_*.yaml")))
"""Tables of the papers."""
