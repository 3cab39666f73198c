"""The changes that a log tells of."""

from __future__ import annotations

from pathlib import Path

from train_ato.changes import Told
from train_ato.record.reading import iter_raw
from train_ato.wire_variable import decode_diagnostic


def told_by(run: Path) -> Told:
    """Return what was changed while a recorded run went on, planned or from outside.

    Parameters
    ----------
    run
        Run folder or MCAP file.

    Raises
    ------
    ValueError
        If it is no log, or damaged.
    """
    told = Told()
    for _, _, data in iter_raw(run, ("/diagnostics",)):
        told.take(decode_diagnostic(data))
    return told


def late_commands(run: Path) -> int:
    """Return how many commands of a run on the wall clock came late or not at all: those cannot be repeated."""
    counts = [0]
    for _, _, data in iter_raw(run, ("/diagnostics",)):
        message = decode_diagnostic(data)
        if message.node == "plant":
            counts.append(sum(int(message.values.get(key, "0")) for key in ("wall_late", "wall_held")))
    return max(counts)
