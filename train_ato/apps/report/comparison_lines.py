"""What runs side by side need: a colour for each, one line for all units, and the events they have in common."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from train_ato.report.digest import Digest
from train_ato.report.events import Event
from train_ato.report.lines import Lines
from train_ato.report.quantities import RUN_COLOURS
from train_ato.types import Array


def run_colours(count: int) -> list[str]:
    """Return a colour for every run."""
    return [RUN_COLOURS[index % len(RUN_COLOURS)] for index in range(count)]


def common_events(digests: Sequence[Digest]) -> list[Event]:
    """Return what happens in every run at the same time."""
    if not digests:
        return []

    def key(event: Event) -> tuple[str, str, int]:
        return event.kind, event.text, round(event.begin)

    shared = set.intersection(*({key(event) for event in digest.events} for digest in digests))
    return [event for event in digests[0].events if key(event) in shared and event.kind != "limit"]


def run_dash(index: int) -> str:
    """Tell runs of one colour apart."""
    return ("solid", "dashed", "dotted")[index // len(RUN_COLOURS) % 3]


def farthest(lines: Lines | None, column: str) -> Array | None:
    """Return a column, or of those of all units at every time the value farthest from zero."""
    if lines is None:
        return None
    of_units = [values for name, values in lines.columns.items() if name.partition(":")[0] == column]
    if not of_units:
        return None
    table = np.array(of_units)
    return np.asarray(table[np.nan_to_num(np.abs(table)).argmax(axis=0), np.arange(table.shape[1])])
