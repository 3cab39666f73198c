"""Tables of benchmark figures on standard output."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import Any


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


def print_rows(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table: the first two columns to the left."""
    table = [list(titles), *(list(row) for row in rows)]
    widths = [max(len(row[column]) for row in table) for column in range(len(titles))]
    for row in table:
        pairs = enumerate(zip(row, widths, strict=True))
        cells = [text.ljust(width) if column < 2 else text.rjust(width) for column, (text, width) in pairs]
        sys.stdout.write("  ".join(cells).rstrip() + "\n")


def _row(figure: dict[str, Any]) -> list[str]:
    beside = "" if figure["beside_value"] is None else f"{_number(figure['beside_value'])} ({figure['beside']})"
    sign = "at least" if figure["at_least"] else "at most"
    goal = "" if figure["bound"] is None else f"{sign} {_number(figure['bound'])}"
    value = f"{_number(figure['value'])} {figure['unit']}".rstrip()
    return [figure["benchmark"], figure["what"], value, beside, _number(figure["ratio"]), goal, figure["verdict"]]


def print_entry(entry: dict[str, Any]) -> None:
    """Print the table of a run, then missed goals, left-out and failed benchmarks."""
    machine = entry["machine"]
    changed = " with changes" if entry["changed"] else ""
    sys.stdout.write(
        f"{machine['processor']}, {machine['cores']} cores, load {machine['load']}, Python {machine['python']}, numpy "
        f"{machine['numpy']}, numba {machine['numba']}; commit {entry['commit'][:10]}{changed}\n"
    )
    print_rows(("benchmark", "figure", "value", "beside", "ratio", "goal", ""), map(_row, entry["figures"]))
    missed = [figure for figure in entry["figures"] if figure["verdict"].startswith("missed")]
    goals = sum(figure["bound"] is not None for figure in entry["figures"])
    for figure in missed:
        sys.stdout.write(f"{figure['verdict']}: {figure['benchmark']}: {figure['what']}\n")
    for kind in ("left_out", "failed"):
        for name, reason in entry[kind].items():
            sys.stdout.write(f"{kind.replace('_', ' ')}: {name}: {reason}\n")
    sys.stdout.write(f"{goals - len(missed)} of {goals} goals met\n")


def print_comparison(rows: Iterable[dict[str, Any]], one: str, other: str) -> None:
    """Print the figures of two commits, their ratios to floor or peer, and the change."""
    titles = ("benchmark", "figure", one, other, "ratio", "ratio", "change", "of the")
    numbers = ("one", "other", "one_ratio", "other_ratio", "change")
    print_rows(
        titles,
        (
            [
                row["benchmark"],
                f"{row['what']} [{row['unit']}]" if row["unit"] else row["what"],
                *(_number(row[key]) for key in numbers),
                row["compared"],
            ]
            for row in rows
        ),
    )
