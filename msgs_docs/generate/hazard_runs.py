"""Runs of the hazard table with and without the monitors, and the measures of the hazards."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from msgs_docs.generate.fault_runs import STANDSTILL, FaultRun, run_row
from msgs_docs.generate.fault_table import ROWS as FAULT_ROWS
from msgs_docs.generate.fault_table import FaultRow
from msgs_docs.generate.hazard_table import RemovalPair
from msgs_docs.generate.monitor_removal import removed_monitors
from plant_sim.traction import Envelope
from train_ato.loop.protection_record import REACTIONS, protection_summary, state_spans
from train_ato.loop.recording import BRAKE_PIPE
from train_ato.loop.train_protection import Protection
from train_ato.messages.types import Array
from train_ato.supervision.plant_line import highest_limit

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


def _behind_supervised_location(run: FaultRun) -> tuple[float, float]:
    return run.front - run.supervised_location, 0.0


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


def _traction_while_braked(run: FaultRun) -> tuple[float, float]:
    command = run.recording.command.max(axis=1)
    return float((command * _braked(run)).max()) * KILO, 0.0


def _end_speed(run: FaultRun) -> tuple[float, float]:
    return run.end_speed * KMH, STANDSTILL * KMH


def _speed_at_release(run: FaultRun) -> tuple[float, float]:
    recording = run.recording
    spans = state_spans(recording.reports, "plant")[:-1]
    ends = [span.end for span in spans if span.state == Protection.EMERGENCY_BRAKE.text]
    speeds = np.abs(np.interp(ends, recording.time, recording.front_velocity)) if ends else np.zeros(1)
    return float(speeds.max()) * KMH, STANDSTILL * KMH


def _behind_stop(run: FaultRun) -> tuple[float, float]:
    return run.front - run.stop, STOPPING_ERROR


def _demands(run: FaultRun) -> tuple[float, float]:
    reports = run.recording.reports
    reactions = sum(span.state in REACTIONS for span in state_spans(reports, "plant"))
    return float(protection_summary(reports)["brake_interventions"] + reactions), 0.0


MEASURES: dict[str, Callable[[FaultRun], tuple[float, float]]] = {
    "H1": _speed_above_limit,
    "H2": _behind_supervised_location,
    "H3": _rolled_back,
    "H4": _unrequested_distance,
    "H5": _traction_while_braked,
    "H6": _end_speed,
    "H7": _speed_at_release,
    "H8": _behind_stop,
    "H9": _demands,
}
"""Function by hazard that returns the value of its measure and the bound, in the unit of the hazard."""
