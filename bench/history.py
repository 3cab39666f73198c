"""History of benchmark runs, one JSON value per line, and the comparison of two commits."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

Entry = dict[str, Any]


def append_entry(path: Path, entry: Entry) -> None:
    """Append a run to the history; the folder is made if it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(entry) + "\n")


def entries(path: Path) -> Iterator[Entry]:
    """Yield the runs of a history, the oldest first.

    Raises
    ------
    ValueError
        If a line is not JSON, or the file does not exist.
    """
    if not path.is_file():
        raise ValueError(f"--history {path}: no such file; run `python -m bench` first, or name another file")
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            entry = json.loads(line)
        except json.JSONDecodeError as error:
            raise ValueError(f"{path}: line {number}: not JSON ({error.msg}); remove the line") from None
        if isinstance(entry, dict):
            yield entry


def entry_of(path: Path, commit: str) -> Entry:
    """Return the figures of a commit: of every benchmark those of its latest run, with the facts of the latest run.

    Parameters
    ----------
    commit
        Full name of a commit or its beginning.

    Raises
    ------
    ValueError
        If the history has no run of it.
    """
    known = list(entries(path))
    found = [entry for entry in known if commit and str(entry.get("commit", "")).startswith(commit)]
    if not found:
        names = ", ".join(dict.fromkeys(str(entry.get("commit", ""))[:10] for entry in known))
        raise ValueError(f"--compare {commit}: no run of this commit in {path}; commits: {names or 'none'}")
    figures = {(figure["benchmark"], figure["what"]): figure for entry in found for figure in entry["figures"]}
    return {**found[-1], "figures": list(figures.values())}


def compare_entries(one: Entry, other: Entry) -> list[Entry]:
    """Return a row for every figure of both runs.

    ``change`` is the factor from the first to the second run: of the ratio to the floor or peer if both have one,
    because the speed of a shared machine drifts, otherwise of the value.
    """
    first = {(figure["benchmark"], figure["what"]): figure for figure in one["figures"]}
    rows = []
    for figure in other["figures"]:
        before = first.get((figure["benchmark"], figure["what"]))
        if before is None:
            continue
        relative = bool(before["ratio"] and figure["ratio"])
        key = "ratio" if relative else "value"
        rows.append(
            {
                "benchmark": figure["benchmark"],
                "what": figure["what"],
                "unit": figure["unit"],
                "one": before["value"],
                "other": figure["value"],
                "one_ratio": before["ratio"],
                "other_ratio": figure["ratio"],
                "compared": key,
                "change": figure[key] / before[key] if before[key] else None,
            }
        )
    return rows


def other_machine(one: Entry, other: Entry) -> list[str]:
    """Return the facts of the machines and versions that differ, as text."""
    left, right = one["machine"], other["machine"]
    return [
        f"{key}: {left.get(key)} and {right.get(key)}"
        for key in dict.fromkeys((*left, *right))
        if key != "load" and left.get(key) != right.get(key)
    ]
