"""Generate ``msgs_docs/hazards.md`` from the hazard table and the measured runs of its pairs."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic.dataclasses import dataclass

from msgs_docs.generate.equation_page import STRICT
from msgs_docs.generate.fault_page import BASES, STANDSTILL, FaultRow, FaultRun, run_row
from msgs_docs.generate.fault_page import ROWS as FAULT_ROWS
from msgs_docs.generate.rows import page_text, read_rows, table_lines, texts, unmeasured_rows, write_rows
from plant_sim.traction import Envelope
from train_ato.judge.protection_record import REACTIONS, protection_summary, state_spans
from train_ato.judge.recording import BRAKE_PIPE
from train_ato.loop.train_protection import TrainProtection
from train_ato.messages.receiver import Receiver
from train_ato.messages.types import Array, Odometry, Protection
from train_ato.supervision.plant_line import highest_limit, line_supervision
from train_ato.supervision.supervisor import SupervisionDecision, Supervisor
from train_ato.supervision.track_supervision import TrackSupervision

Guide = Literal["not provided", "provided wrongly", "too early or late", "too long or too short"]
"""Way in which a control action is unsafe."""
GUIDES: tuple[Guide, ...] = ("not provided", "provided wrongly", "too early or late", "too long or too short")


@dataclass(frozen=True, config=STRICT)
class Monitor:
    """Part that meets a requirement, and one way to remove it.

    Attributes
    ----------
    part
        Name of the part, ``module:name``.
    removed
        Condition of the run without the monitor; "": no row removes it.
    sets
        Assignments to the scenario that remove it.
    place
        Name to be replaced, ``module:name``; "": that of the monitor.
    """

    part: str
    removed: str = ""
    sets: tuple[str, ...] = ()
    place: str = ""


@dataclass(frozen=True, config=STRICT)
class RemovalPair:
    """Run with the monitors of a row, and the same run without them.

    Attributes
    ----------
    without
        Monitors to be removed, ``module:name``.
    fault
        Row of the fault table; "" with ``sets``.
    sets
        Assignments to the scenario in place of a row of the fault table.
    """

    without: tuple[str, ...]
    fault: str = ""
    sets: tuple[str, ...] = ()


@dataclass(frozen=True, config=STRICT)
class HazardRow:
    """One unsafe control action with its requirement.

    Attributes
    ----------
    requirement
        Identifier of the requirement.
    hazard, action, guide
        Key of the hazard; control action; way in which it is unsafe.
    unsafe
        The unsafe control action in words.
    text
        Text of the requirement.
    monitors
        Parts that meet the requirement: ``module:name``.
    faults
        Rows of the fault table that are runs of this requirement.
    tests
        Other tests, as pytest names them.
    pair
        Run with and without the monitors; None if the row has tests only.
    """

    requirement: str
    hazard: str
    action: str
    guide: Guide
    unsafe: str
    text: str
    monitors: tuple[str, ...]
    faults: tuple[str, ...] = ()
    tests: tuple[str, ...] = ()
    pair: RemovalPair | None = None


@dataclass(frozen=True, config=STRICT)
class OpenHazard:
    """Faults that no monitor detects: the run has the hazard.

    Attributes
    ----------
    hazard, text
        Key of the hazard; cause and missing defence in words.
    sets
        Assignments to the scenario.
    """

    hazard: str
    text: str
    sets: tuple[str, ...]


def _hazard_row(requirement: str, row: dict[str, Any]) -> HazardRow:
    """Return a row of the file, with the names of the parts in place of the short names of the monitors."""
    found = HazardRow(requirement, **row)
    pair = found.pair and replace(found.pair, without=_parts(found.pair.without))
    return replace(found, monitors=_parts(found.monitors), pair=pair)


def _parts(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(MONITORS[name].part for name in names)


TABLE: dict[str, Any] = texts("hazards")
HAZARDS: dict[str, dict[str, str]] = TABLE["hazards"]
"""Description, measure whose value above the bound is the hazard, its unit, and origin of the bound."""
ACTIONS: dict[str, str] = TABLE["actions"]
"""Control action, or feedback it is based on, with sender and receiver."""
HARMLESS: dict[tuple[str, Guide], str] = {(row["action"], row["guide"]): row["reason"] for row in TABLE["harmless"]}
"""Control actions and ways that lead to no hazard, with the reason."""
MONITORS = {name: Monitor(**row) for name, row in TABLE["monitors"].items()}
"""Monitors by their short name."""
ROWS = tuple(_hazard_row(name, row) for name, row in TABLE["requirements"].items())
OPEN = tuple(OpenHazard(**row) for row in TABLE["open"])
"""Hazards without a monitor, found in this analysis."""

UNLIMITED = 900.0
"""Speed limit without effect [m/s], within the valid values of a message."""
_protect, _receive, _supervise = TrainProtection.step, Receiver.receive, Supervisor.step


def _newest_arrival(self: Receiver, now: int, message: Any) -> Any:
    self._checked = False
    return _receive(self, now, message)


def _wheel_alone(self: Supervisor, odometry: Odometry | None) -> SupervisionDecision:
    if odometry is None:
        return _supervise(self, None)
    wheel = (values[:1].repeat(2) for values in (odometry.position, odometry.speed, odometry.since_balise))
    return _supervise(self, Odometry(odometry.stamp, *wheel))


REMOVALS: dict[str, Monitor] = {monitor.part: monitor for monitor in MONITORS.values() if monitor.removed}
"""Monitors that a pair removes, by the name of the part."""
REPLACEMENTS: dict[str, object] = {
    MONITORS[name].part: replacement
    for name, replacement in {
        "track": lambda *given, **named: TrackSupervision(
            replace(line_supervision(*given, **named).train, max_speed=UNLIMITED), (), (), None
        ),
        "estimator": _wheel_alone,
        "odometry_check": lambda *_: "",
        "protection": lambda self, stamp, **given: _protect(self, stamp, **{**given, "standstill": True}),
        "separation": lambda couplers, time: False,
        "alive": lambda *_: "",
        "measurement_check": lambda *_: "",
        "assurance": lambda *_: False,
        "command_hold": lambda *_: None,
        "ato_state": lambda *_, **__: False,
        "ato_request": lambda *_, **__: None,
        "ato_brake": lambda *_: False,
        "receiver": _newest_arrival,
        "validity": lambda _: lambda _: "",
    }.items()
}
"""Part in place of a monitor whose removal needs more than assignments."""


def monitor_part(name: str) -> object:
    """Return the part of a name ``module:name``.

    Raises
    ------
    ImportError, AttributeError
        If there is no such module or part.
    """
    module, _, path = name.partition(":")
    return attrgetter(path)(import_module(module))


@contextmanager
def _replaced(place: str, replacement: object) -> Iterator[None]:
    module, _, path = place.partition(":")
    outer, _, name = path.rpartition(".")
    owner: Any = monitor_part(f"{module}:{outer}") if outer else import_module(module)
    before = vars(owner)[name]
    setattr(owner, name, replacement)
    try:
        yield
    finally:
        setattr(owner, name, before)


@contextmanager
def removed_monitors(names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Remove monitors for the time of a run; yield the assignments to its scenario."""
    with ExitStack() as stack:
        for name in names:
            if name in REPLACEMENTS:
                stack.enter_context(_replaced(REMOVALS[name].place or name, REPLACEMENTS[name]))
        yield tuple(text for name in names for text in REMOVALS[name].sets)


KMH, KILO = 3.6, 1e-3
STOPPING_ERROR = 5.0
"""Largest distance from the planned stop of a train that has reached it [m]."""
FAULTS: dict[str, FaultRow] = {row.name: row for row in FAULT_ROWS}
"""Rows of the fault table by name."""
PROTECTION_STATE = "train/protection"


def fault_of(pair: RemovalPair) -> FaultRow:
    """Return the scenario of a pair: a row of the fault table, or one with its own assignments."""
    return FAULTS[pair.fault] if pair.fault else FaultRow("", "", pair.sets, "")


def run_pair(pair: RemovalPair) -> tuple[FaultRun, FaultRun]:
    """Return the runs with and without the monitors of a pair."""
    row = fault_of(pair)
    with removed_monitors(pair.without) as sets:
        without = run_row(FaultRow(row.name, row.kind, (*row.sets, *sets), row.reaction, base=row.base))
    return run_row(row), without


def _speed_above_limit(run: FaultRun) -> tuple[float, float]:
    limit = highest_limit(run.setup.line)
    return (run.top_speed - limit) * KMH, (run.largest_speed - limit) * KMH


def _rolled_back(run: FaultRun) -> tuple[float, float]:
    """Return the largest distance backwards and its bound [m].

    The bound is the distance of the largest traction up to the limit, over a period of the supervisor and the build-up
    of the emergency brake, and of the emergency brake from the speed reached.
    """
    setup = run.setup
    spec, train = setup.scenario.supervision, setup.supervisor().track.train
    traction = sum(Envelope(setup.consist.vehicles[i].traction).largest() for i in setup.consist.power_units)
    acceleration = traction / sum(vehicle.inertia for vehicle in setup.consist.vehicles)
    time = np.sqrt(2.0 * spec.roll_away / acceleration)
    time += setup.supervision_ticks * setup.tick + train.brake.emergency_time.to_standstill
    speed = acceleration * time
    bound = 0.5 * acceleration * time**2 + speed**2 / (2.0 * min(train.brake.safe.values))
    position = run.recording.front_position
    return float((np.maximum.accumulate(position) - position).max()), float(bound)


def _unrequested_distance(run: FaultRun) -> tuple[float, float]:
    recording = run.recording
    begins = [span.begin for span in state_spans(run.recording.reports, "plant") if span.state in REACTIONS]
    stopped = (recording.time >= min(begins, default=np.inf)) & (np.abs(recording.front_velocity) < STANDSTILL)
    later = recording.front_position[int(np.argmax(stopped)) :] if stopped.any() else np.zeros(1)
    return float(later.max() - later[0]), run.setup.scenario.supervision.roll_away


def _braked(run: FaultRun) -> Array:
    """Return 1 at every complete tick with a brake in effect for two periods of the supervisor, shape (k,)."""
    recording, setup = run.recording, run.setup
    period = setup.supervision_ticks * setup.tick
    braked = np.zeros(recording.time.size, dtype=bool)
    if (state := recording.of(PROTECTION_STATE, "active")) is not None:
        at = np.searchsorted(state[0], recording.time, side="right") - 1
        braked |= state[1][np.maximum(at, 0), 1:].any(axis=1)
    if (pipe := recording.of(BRAKE_PIPE, "pressure")) is not None and setup.consist.air_brake is not None:
        brake = setup.consist.air_brake
        at = np.searchsorted(pipe[0], recording.time, side="right") - 1
        braked |= pipe[1][np.maximum(at, 0), 0] < brake.charged - brake.reduction[-1]
    count = round(2.0 * period / setup.tick)
    lasting = np.convolve(braked, np.ones(count + 1))[: braked.size] > count
    return lasting.astype(np.float64)


def _speed_at_release(run: FaultRun) -> tuple[float, float]:
    recording = run.recording
    spans = state_spans(recording.reports, "plant")[:-1]
    ends = [span.end for span in spans if span.state == Protection.EMERGENCY_BRAKE.text]
    speeds = np.abs(np.interp(ends, recording.time, recording.front_velocity)) if ends else np.zeros(1)
    return float(speeds.max()) * KMH, STANDSTILL * KMH


def _demands(run: FaultRun) -> tuple[float, float]:
    reports = run.recording.reports
    reactions = sum(span.state in REACTIONS for span in state_spans(reports, "plant"))
    return float(protection_summary(reports)["brake_interventions"] + reactions), 0.0


MEASURES: dict[str, Callable[[FaultRun], tuple[float, float]]] = {
    "H1": _speed_above_limit, "H2": lambda run: (run.front - run.supervised_location, 0.0), "H3": _rolled_back,
    "H4": _unrequested_distance,
    "H5": lambda run: (float((run.recording.command.max(axis=1) * _braked(run)).max()) * KILO, 0.0),
    "H6": lambda run: (run.end_speed * KMH, STANDSTILL * KMH), "H7": _speed_at_release,
    "H8": lambda run: (run.front - run.stop, STOPPING_ERROR), "H9": _demands,
}  # fmt: skip
"""Function by hazard that returns the value of its measure and the bound, in the unit of the hazard."""

PAGE = Path("msgs_docs", "hazards.md")
MEASURED = Path("msgs_docs", "hazards_measured.json")
NAME = "hazards"
MUTANTS = Path("msgs_docs", "mutation_measured.json")
"""Numbers of mutants by file and outcome, written by ``bench/mutation.py``."""


def _pair_key(row: HazardRow) -> list[Any]:
    assert row.pair is not None
    fault = fault_of(row.pair)
    return [row.hazard, *BASES[fault.base], *fault.sets, *row.pair.without]


def _open_key(entry: OpenHazard) -> list[str]:
    return [entry.hazard, *BASES["metro"], *entry.sets]


def run_open(entry: OpenHazard) -> tuple[float, float]:
    """Return measure and bound of the run of a hazard without a monitor."""
    return MEASURES[entry.hazard](run_row(FaultRow("", "", entry.sets, "")))


def pair_figures(row: HazardRow) -> dict[str, Any]:
    """Return the measure with and without the monitors, and the bound, in the unit of the hazard."""
    assert row.pair is not None
    kept, removed = run_pair(row.pair)
    measure = MEASURES[row.hazard]
    value, bound = measure(kept)
    return {
        "run": _pair_key(row),
        "with": round(value, 1),
        "without": round(measure(removed)[0], 1),
        "bound": round(bound, 1),
    }


def measure(root: Path) -> None:
    """Run all pairs and write their figures."""
    figures = {row.requirement: pair_figures(row) for row in ROWS if row.pair is not None}
    for entry in OPEN:
        value, bound = run_open(entry)
        figures[entry.text] = {"run": _open_key(entry), "without": round(value, 1), "bound": round(bound, 1)}
    write_rows(root / MEASURED, figures)


def _mutation_rows(root: Path) -> list[str]:
    """Return the rows of the mutation score, one for each file and one for all."""
    found: dict[str, dict[str, int]] = read_rows(root / MUTANTS)
    total: Counter[str] = sum(map(Counter, found.values()), Counter())
    rows = []
    for path, outcomes in [*((f"`{path}`", Counter(counts)) for path, counts in found.items()), ("all", total)]:
        number = outcomes.total() - outcomes["equivalent"]
        alive = number - sum(outcomes[name] for name in ("killed", "timeout", "segfault"))
        score = 100 * (number - alive) / number
        rows.append(f"| {path} | {outcomes.total()} | {outcomes['equivalent']} | {alive} | {score:.1f} % |")
    return rows


def unmeasured(root: Path) -> list[str]:
    """Return one line per row without current figures, and per leftover."""
    keys: dict[str, Any] = {row.requirement: _pair_key(row) for row in ROWS if row.pair is not None}
    keys |= {entry.text: _open_key(entry) for entry in OPEN}
    return unmeasured_rows("hazard", NAME, keys, read_rows(root / MEASURED))


def page(root: Path) -> str:
    """Return the text of the page."""
    figures = read_rows(root / MEASURED)
    pairs = [(row, fault_of(row.pair), figures.get(row.requirement, {})) for row in ROWS if row.pair is not None]
    used = {fault.base for _, fault, _ in pairs}
    return page_text(
        NAME,
        hazards=HAZARDS,
        matrix=_matrix(),
        rows=ROWS,
        verification=[_verification(row) for row in ROWS],
        mutation=_mutation_rows(root),
        bases={name: run for name, run in BASES.items() if name in used},
        pairs=pairs,
        removals=REMOVALS,
        open=[(entry, figures.get(entry.text, {})) for entry in OPEN],
    )


def _matrix() -> list[str]:
    """Return the requirements by control action and way, with the reasons of the harmless ones."""
    lines = []
    for action, path in ACTIONS.items():
        cells = []
        for guide in GUIDES:
            found = [row.requirement for row in ROWS if (row.action, row.guide) == (action, guide)]
            cells.append(", ".join(found) or f"no hazard: {HARMLESS[action, guide]}")
        lines.append((action, path, *cells))
    return table_lines(("control action", "path", *GUIDES), lines)


def _verification(row: HazardRow) -> str:
    places = (name.partition(":") for name in row.monitors)
    monitors = ", ".join(f"`{name}` (`{module.replace('.', '/')}.py`)" for module, _, name in places)
    tests = ", ".join(f"`{test.removeprefix('test/')}`" for test in row.tests)
    return f"| {row.requirement} | {monitors} | {'; '.join(row.faults) or '-'} | {tests or '-'} |"
