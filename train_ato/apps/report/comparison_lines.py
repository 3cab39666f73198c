"""Comparison of runs: colours, one line for all power units, and common events."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from train_ato.apps.report.curves import Curves
from train_ato.apps.report.event import Event
from train_ato.apps.report.page_data import PageData
from train_ato.apps.report.quantities import RUN_COLOURS
from train_ato.messages.types import Array


def run_colours(count: int) -> list[str]:
    """Return a colour for every run."""
    return [RUN_COLOURS[index % len(RUN_COLOURS)] for index in range(count)]


def common_events(pages: Sequence[PageData]) -> list[Event]:
    """Return the events that are in every run at the same time."""
    if not pages:
        return []

    def key(event: Event) -> tuple[str, str, int]:
        return event.kind, event.text, round(event.begin)

    shared = set.intersection(*({key(event) for event in data.events} for data in pages))
    return [event for event in pages[0].events if key(event) in shared and event.kind != "limit"]


def run_dash(index: int) -> str:
    """Return the line style of a run; runs with the same colour differ in it."""
    return ("solid", "dashed", "dotted")[index // len(RUN_COLOURS) % 3]


def largest_magnitude(lines: Curves | None, column: str) -> Array | None:
    """Return a column; for several power units, the value with the largest magnitude at every time."""
    if lines is None:
        return None
    of_units = [values for name, values in lines.columns.items() if name.partition(":")[0] == column]
    if not of_units:
        return None
    table = np.array(of_units)
    return np.asarray(table[np.nan_to_num(np.abs(table)).argmax(axis=0), np.arange(table.shape[1])])
