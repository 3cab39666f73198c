"""Modes of a run in which the tests run each row of the fault table."""

from __future__ import annotations

import re

from msgs_docs.generate.fault_table import ROWS, FaultRow

_MODEL = re.compile(r"(?:do|topic|node|what): [\w/]+")

RECORDER_ROWS: tuple[FaultRow, ...] = tuple(
    FaultRow(f"recorder {past}", "node", (f"faults=[{{at: 4.9, do: {do}, node: recorder}}]",), "node recorder failed")
    for past, do in (("killed", "kill"), ("stopped", "stop"))
)
"""Faults that exist only with one process per node."""


def ends_process(row: FaultRow) -> bool:
    """Return True if a run with one process per node kills, stops or starts a process for the fault."""
    return any(f"do: {word}, node" in text for word in ("kill", "stop", "duplicate") for text in row.sets)


def _model(row: FaultRow) -> tuple[str, ...]:
    """Return the keys of a row with its fault, topic and node, without the other values."""
    return tuple(word for text in row.sets for word in (text.partition("=")[0], *sorted(_MODEL.findall(text))))


_FIRST = {_model(row): row for row in reversed(ROWS) if not row.slow}
"""First row of each kind of fault on each topic, node or part."""


def ways_of(row: FaultRow) -> tuple[str, ...]:
    """Return the modes of a row: long runs in the engine only, the first row of a kind also in several processes."""
    if row in RECORDER_ROWS:
        return ("processes",)
    if row.slow:
        return ("engine",)
    return ("engine", "composed", "processes") if _FIRST[_model(row)] == row else ("engine", "composed")
