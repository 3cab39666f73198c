"""Runs of the fault table in the engine, and ``msgs_docs/faults.md`` with them and the models of the faults.

The rows of ``faults.yaml`` are also data of ``test/test_fault_table.py``.
"""

import re
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from msgs_docs.generate.rows import page_text, read_rows, table_lines, texts, unmeasured_rows, write_rows
from plant_sim.traction import Envelope
from train_ato.cli.inject import ACTIONS
from train_ato.judge.recording import Recording
from train_ato.judge.result import RunResult
from train_ato.judge.series import TopicSamples
from train_ato.loop.engine import run_engine
from train_ato.messages import receiver
from train_ato.messages.faults import FAULT_TOPICS, MessageFault, NodeFault
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


TABLE: dict[str, Any] = texts("faults")
BASES: dict[str, tuple[str, ...]] = {name: tuple(map(str, texts)) for name, texts in TABLE["bases"].items()}
"""Scenario and assignments of the runs by name."""
ROWS = tuple(FaultRow(**{**row, "sets": tuple(row["sets"])}) for row in TABLE["rows"])

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
        consist, odometry = setup.consist, setup.scenario.plant.odometry
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


PAGE = Path("msgs_docs", "faults.md")
MEASURED = Path("msgs_docs", "faults_measured.json")
NAME = "faults"
REQUESTS = ("drop", "freeze", "cut-out", "brake-fade", "adhesion")
SHARED = ("do", "topic", "reader", "begin", "end", "node", "at")

MODES = {"engine": "E", "composed": "C", "processes": "P"}
"""Letters of the modes in the tables."""


def _key(row: FaultRow) -> list[str]:
    return [row.base, *BASES[row.base], *row.sets]


def figures_of(row: FaultRow, run: FaultRun) -> dict[str, Any]:
    """Return the figures of a run: distance to the supervised location [m], speeds [km/h], times [s]."""
    return {
        "run": _key(row),
        "margin_m": round(run.supervised_location - run.front, 1),
        "top_speed_kmh": round(3.6 * run.top_speed, 1),
        "bound_kmh": round(3.6 * run.largest_speed, 1),
        "detected_s": run.detected,
        "reacted_s": run.reacted,
    }


def measure(root: Path) -> None:
    """Run all rows and write their figures."""
    figures = {row.name: figures_of(row, run_row(row)) for row in ROWS}
    write_rows(root / MEASURED, figures)


def unmeasured(root: Path) -> list[str]:
    """Return one line per row without current figures, and per leftover."""
    return unmeasured_rows("fault", NAME, {row.name: _key(row) for row in ROWS}, read_rows(root / MEASURED))


def page(root: Path) -> str:
    """Return the text of the page."""
    return page_text(
        NAME,
        messages=_models(MessageFault),
        topics=", ".join(f"`{name}` ({', '.join(readers)})" for name, readers in FAULT_TOPICS.items()),
        nodes=_models(NodeFault),
        defences=_defences(),
        requests=REQUESTS,
        actions=ACTIONS,
        **{mode: sum(mode in ways_of(row) for row in ROWS) for mode in MODES},
        begin=BEGIN,
        ended=sum(ends_process(row) and "processes" in ways_of(row) for row in ROWS),
        recorder=RECORDER_ROWS,
        bases=BASES,
        rows=ROWS,
        figures=read_rows(root / MEASURED),
        ways=ways_of,
        modes=MODES,
    )


def _models(union: Any) -> list[str]:
    """Return the rows of the models of a union: word, meaning from the docstring, own keys."""
    members = typing.get_args(typing.get_args(union)[0]) or typing.get_args(union)
    rows = []
    for model in members:
        assert issubclass(model, BaseModel)
        own = [_key_text(name, entry) for name, entry in model.model_fields.items() if name not in SHARED]
        meaning = " ".join((model.__doc__ or "").replace("``", "`").split())
        rows.append((f"`{model.model_fields['do'].default}`", meaning, "; ".join(own) or "-"))
    return table_lines(("`do`", "meaning", "keys"), rows)


def _key_text(name: str, entry: Any) -> str:
    words = typing.get_args(entry.annotation)
    choices = f" ({', '.join(map(str, words))})" if words and all(isinstance(word, str) for word in words) else ""
    default = "" if entry.is_required() else f", default {entry.default}"
    return f"`{name}`{choices}{default}{f', {entry.description}' if entry.description else ''}"


def _defences() -> list[str]:
    """Return the table of the defences in the docstring of the receiver."""
    rows = []
    for line in (receiver.__doc__ or "").splitlines():
        threat, defence = line[:22].strip(), line[22:].strip()
        if defence and not line.startswith("=") and line[20:22] == "  ":
            rows.append((threat, defence))
    return table_lines(rows[0], rows[1:])
