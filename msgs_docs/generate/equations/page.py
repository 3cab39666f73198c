"""Generate ``msgs_docs/equations.md`` from the tables of the equations."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from msgs_docs.generate.equations.places import source_line
from msgs_docs.generate.equations.row import EQUATION_TABLES, MEANINGS, Equation, EquationTable, Form

PAGE = Path("msgs_docs", "equations.md")
"""Path of the page in the repository."""

INTRODUCTION = """# Equations of the papers in the code

Made by `python -m msgs_docs.generate` from `msgs_docs/generate/equations/`; do not edit by hand.

Every numbered equation of the five papers, with its place in the code. `test/test_equation_table.py` checks that no
number is missing, that every place exists, and that the program accepts every setting and needs it. Measured effects of
the printed forms: [reproduction.md](reproduction.md); choices where a paper gives nothing: [left_out.md](left_out.md).

| form | meaning |
|---|---|
"""


def page(root: Path) -> str:
    """Return the text of the page."""
    lines = [INTRODUCTION.rstrip("\n"), *(f"| {form.value} | {MEANINGS[form]} |" for form in Form), "", *_counts()]
    for table in EQUATION_TABLES:
        lines += ["", f"## Paper {table.paper}: {table.title}", ""]
        lines += [f"Settings with `train-ato run {table.scenario} --set ...`.", ""]
        lines += ["| equation | content | form | place | note | settings |", "|---|---|---|---|---|---|"]
        lines += [_row(row, root) for row in table.rows]
    return "\n".join(lines) + "\n"


def counts(table: EquationTable) -> dict[Form, int]:
    """Return the number of equations of a paper by form."""
    found = Counter(row.form for row in table.rows)
    return {form: found[form] for form in Form}


def _counts() -> list[str]:
    heads = " | ".join(form.value for form in Form)
    rows = [
        f"| {table.paper} | {len(table.rows)} | {' | '.join(map(str, counts(table).values()))} |"
        for table in EQUATION_TABLES
    ]
    return [f"| paper | equations | {heads} |", "|---" * (len(Form) + 2) + "|", *rows]


def _row(row: Equation, root: Path) -> str:
    places = ", ".join(_linked(place, root) for place in row.places) or "-"
    settings = " ".join(f"`{text}`" for text in row.settings) or "-"
    cells = (f"({row.number})", row.content, row.form.value, places, row.note or "-", settings)
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def _linked(place: str, root: Path) -> str:
    """Return a place as a link to its line."""
    path, line = source_line(place, root)
    where, _, name = place.partition(":")
    link = f"[{path}:{line}](../{path}#L{line})"
    return link if "/" in where else f"`{name}` {link}"
