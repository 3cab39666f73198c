"""Changes during a recorded run, from the diagnostics in its log."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from train_ato.log.recorded import read_reports
from train_ato.messages.topics import Role
from train_ato.messages.types import Diagnostic
from train_ato.scenario.changes import RunChanges

OWN_KEYS = {
    Role.PLANT.value: "commands_lost",
    Role.SUPERVISOR.value: "brake_interventions",
    Role.PROFILE.value: "knots",
    Role.OBSERVER.value: "observer",
    Role.CONTROLLER.value: "compensation",
}
"""Key in the diagnostics of every node of this project; a program in place of the node has others, or sends none."""


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


def outside_nodes(
    reports: Iterable[Diagnostic], supervised: bool, names: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Return the nodes of a run that were programs outside of this project, with their names.

    Parameters
    ----------
    reports
        Diagnostics of the run.
    supervised
        True for a run with a supervisor.
    names
        Names of the publishers by node; a program that reports another name of its law or observer has that.
    """
    first: dict[str, Diagnostic] = {}
    for report in reports:
        first.setdefault(report.node, report)
    if not first:  # a log without the topic says nothing about its nodes
        return dict(names or {})
    found = {}
    for node, key in OWN_KEYS.items():
        values = first[node].values if node in first else {}
        if key not in values and (supervised or node != Role.SUPERVISOR.value):
            found[node] = values.get(node) or (names or {}).get(node, node)
    return found
