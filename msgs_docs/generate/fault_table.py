"""Faults of a run with the expected reaction: data of ``msgs_docs/faults.md`` and of ``test/test_fault_table.py``.

The rows are in ``faults.yaml``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from plant_sim.library import read_yaml

BEGIN = 20
"""Time of the faults of messages and nodes [s]; the metro train accelerates at 43 km/h."""
NOTHING = "plant: finished"
"""Reaction of a run in which nothing is detected."""


@dataclass(frozen=True)
class FaultRow:
    """One fault and its expected reaction.

    Attributes
    ----------
    name
        Fault in words; the key of the row.
    kind
        Threat of EN 50159, or part with the fault.
    sets
        Assignments to the scenario.
    reaction
        Pattern of an event of the run: ``node: message: reason``.
    arrives
        True if the train reaches the planned stop; otherwise it is at standstill elsewhere.
    base
        Key of :data:`BASES`.
    """

    name: str
    kind: str
    sets: tuple[str, ...]
    reaction: str
    arrives: bool = False
    base: str = "metro"

    @property
    def slow(self) -> bool:
        """True for a run of more than a few seconds."""
        return self.base == "daqin"


TABLE: dict[str, Any] = read_yaml(Path(__file__).with_name("faults.yaml"))
BASES: dict[str, tuple[str, ...]] = {name: tuple(map(str, texts)) for name, texts in TABLE["bases"].items()}
"""Scenario and assignments of the runs by name."""
ROWS = tuple(FaultRow(**{**row, "sets": tuple(row["sets"])}) for row in TABLE["rows"])
"""Rows of the table."""
