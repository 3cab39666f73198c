"""Text messages of the driver's display: the newest events, and those that wait for an acknowledgement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from train_ato.apps.report.writing import short_clock
from train_ato.apps.view.feed import Mark

MOST_MESSAGES = 5
"""Largest number of messages on the page: lines of the message area of ERA_ERTMS_015560, 8.2.3.4."""


def message_rows(
    marks: Sequence[Mark], time: float, acknowledged: frozenset[int], *, live: bool
) -> dict[str, list[Any]]:
    """Return the messages up to a simulated time [s], newest first; those that need an acknowledgement lead.

    Parameters
    ----------
    marks
        Events of the run by rising time.
    time
        Simulated time on the page [s].
    acknowledged
        Numbers of the acknowledged events.
    live
        False: nothing waits for an acknowledgement, since a recorded run has no driver.
    """
    past = [(number, mark) for number, mark in enumerate(marks) if mark.text and mark.time <= time + 1e-9]
    waiting = {number for number, mark in past if live and mark.acknowledge and number not in acknowledged}
    newest = sorted(past, key=lambda entry: (entry[0] in waiting, entry[0]), reverse=True)[:MOST_MESSAGES]
    return {
        "number": [number for number, _ in newest],
        "clock": [short_clock(mark.time) for _, mark in newest],
        "text": [mark.text for _, mark in newest],
        "waiting": [int(number in waiting) for number, _ in newest],
    }
