"""Runs of the fault table in the engine, and their measured figures.

The rows are data of ``msgs_docs/faults.md`` and of ``test/test_fault_table.py``, from ``faults.yaml``.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.library import read_yaml
from plant_sim.traction import Envelope
from train_ato.judge.recording import Recording
from train_ato.judge.result import RunResult
from train_ato.judge.series import TopicSamples
from train_ato.loop.engine import run_engine
from train_ato.messages.types import Diagnostic
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import RunSetup, prepare
from train_ato.supervision.plant_line import highest_limit
from train_ato.supervision.step_function import EMERGENCY_MARGIN

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


SECOND = 1_000_000_000
STANDSTILL = 0.05
"""Speed of a train at standstill [m/s]."""
REACTIONS = ("coast", "service brake", "emergency brake", "disengaging", "failure", "braking law")
"""States of plant and controller with a demand to coast or to brake."""
DETECTIONS = ("refusal ", "missing ")
"""Beginnings of the keys of diagnostics that report a refused or missing message."""


@dataclass(frozen=True)
class FaultRun:
    """Run of a row with its figures."""

    setup: RunSetup
    result: RunResult

    @property
    def recording(self) -> Recording:
        """Recording of the run."""
        assert self.result.recording is not None
        return self.result.recording

    @property
    def _motion(self) -> TopicSamples:
        """Truth of vehicle 0, also after the last command of a lost controller."""
        motion = self.recording.motion
        assert motion is not None
        return motion

    @property
    def _half(self) -> float:
        return self.setup.consist.vehicles[0].length / 2.0

    @property
    def stop(self) -> float:
        """Planned stop of the front [m]."""
        return float(self.setup.profile.position[-1]) + self._half

    @property
    def supervised_location(self) -> float:
        """Supervised location [m]."""
        return self.stop + self.setup.scenario.supervision.overlap

    @cached_property
    def front(self) -> float:
        """Largest true position of the front [m]."""
        return float(self._motion["position"].max()) + self._half

    @cached_property
    def top_speed(self) -> float:
        """Largest true speed [m/s]."""
        return float(np.abs(self._motion["velocity"]).max())

    @cached_property
    def end_speed(self) -> float:
        """True speed at the end of the run [m/s]."""
        return float(abs(self._motion["velocity"][-1, 0]))

    @cached_property
    def largest_speed(self) -> float:
        """Bound on the speed [m/s]: highest limit, margin of the emergency brake, and overshoot.

        The overshoot is the speed gained with the full traction, downhill on the steepest grade, between the
        intervention and the end of the traction, and the speed error of the odometers.
        """
        setup = self.setup
        consist, odometry = setup.consist, setup.plant.odometry
        limit = highest_limit(setup.line)
        traction = sum(Envelope(consist.vehicles[i].traction).largest() for i in consist.power_units)
        grade = max((-entry.grade for entry in setup.line.grades), default=0.0)
        acceleration = traction / sum(vehicle.inertia for vehicle in consist.vehicles) + 9.81 * max(grade, 0.0)
        error = max(odometry.wheel_error, odometry.radar_error)
        top = limit + EMERGENCY_MARGIN.above(limit)
        return top * (1.0 + error) + acceleration * setup.supervisor().track.train.t_traction_cut_off

    @cached_property
    def events(self) -> list[tuple[float, str]]:
        """Time [s] and text of every report: ``node: message: reason``, and one text for each refused topic."""
        return [(report.stamp / SECOND, text) for report in self.recording.reports for text in _texts(report)]

    @cached_property
    def detected(self) -> float | None:
        """Time of the first report of a refused or missing message, or of the first reaction [s]."""
        times = [
            report.stamp / SECOND
            for report in self.recording.reports
            if any(key.startswith(DETECTIONS) for key in report.values) or _reacts(report)
        ]
        return min(times, default=None)

    @cached_property
    def reacted(self) -> float | None:
        """Time of the first demand to coast or to brake [s]."""
        return min((report.stamp / SECOND for report in self.recording.reports if _reacts(report)), default=None)


def _reacts(report: Diagnostic) -> bool:
    return report.node in ("plant", "controller") and report.message in REACTIONS


def _texts(report: Diagnostic) -> Iterator[str]:
    values = report.values
    reason = values.get("protection") or values.get("reason") or values.get("ato_reason") or ""
    yield f"{report.node}: {report.message}: {reason}"
    for key, text in values.items():
        if key.startswith(("refusal ", "missing ", "faults")):
            yield f"{report.node}: {key}: {text}".replace("refusal", "refused")


def setup_of(row: FaultRow) -> RunSetup:
    """Return the prepared run of a row."""
    name, *sets = BASES[row.base]
    return prepare(*load_scenario(name, (*sets, *row.sets)))


def run_row(row: FaultRow) -> FaultRun:
    """Run a row in the engine."""
    setup = setup_of(row)
    return FaultRun(setup, run_engine(setup))
