"""Changes during a recorded run, from the diagnostics in its log."""

from __future__ import annotations

from pathlib import Path

from train_ato.log.recorded import read_reports
from train_ato.scenario.changes import RunChanges


def read_changes(run: Path) -> RunChanges:
    """Return the planned and requested changes of a run: laws, parameters, interventions, ATO requests.

    Parameters
    ----------
    run
        Run folder or MCAP file.

    Raises
    ------
    ValueError
        If it is not a log, or damaged.
    """
    return RunChanges.of(read_reports(run))


def late_commands(run: Path) -> int:
    """Return the number of late and missing commands of a run without lockstep; they are not reproducible."""
    plant = [message.values for message in read_reports(run) if message.node == "plant"]
    counts = [sum(int(values.get(key, "0")) for key in ("wall_late", "wall_held")) for values in plant]
    return max(counts, default=0)
