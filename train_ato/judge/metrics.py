"""Definition of the metrics of a run, and of the fatigue of its couplers."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_sim.line import Line
from train_ato.control.plan_text import PASSES, STATUS
from train_ato.judge.recording import TRUTH, Recording
from train_ato.judge.stops import STANDSTILL_SPEED, StopResult, running_time, stops_of_run
from train_ato.judge.tracking import time_at_force_limit
from train_ato.messages.types import Array
from train_ato.profile.trip.plan import SLOPE, coupler_cycles, coupler_damage, cycle_damage
from train_ato.scenario.setup import RunSetup

OF_THE_PLANT = (
    "energy_traction_kwh", "energy_regenerated_kwh", "saturated_s",
    "commands_lost", "commands_missed", "commands_refused", "commands_late",
)  # fmt: skip
"""Metrics from every plant step."""
OF_THE_EVALUATION = ("speed_rmse_kmh", "speed_error_max_kmh", "position_error_max_m", "position_rmse_m")
"""Metrics without a value if the evaluation has no tick."""
COMMAND_COUNTS = (
    ("commands_lost", ("commands_lost",)),
    ("commands_missed", ("missed ato/command", "wall_held")),
    ("commands_refused", ("refused ato/command",)),
    ("commands_late", ("wall_late",)),
)
"""Metric, and its counts in the diagnostics of the plant: a command is missed by a fault, or as none came in time."""
ROUNDING = 1e-6
"""Difference of a time of the scenario from the stamp of the same tick by rounding [s]."""
LATENESS = {
    "ticks_late": "wall_ticks_late",
    "lateness_max_s": "wall_lateness_max_s",
    "lateness_p99_s": "wall_lateness_p99_s",
    "behind_share": "wall_behind_share",
}
"""Metric of a run with a rate, and key in the diagnostics of the plant."""
JERK_SPAN = 0.1
"""Time difference for acceleration and jerk [s]."""


def summarise(setup: RunSetup, recording: Recording) -> dict[str, Any]:
    """Return the metrics of a run from its series and the totals of the plant.

    Without diagnostics of the plant, energies and saturation are omitted, and coupler forces are those at the ticks.
    Errors are v - v_d of the true state at the same stamp. They count at every tick from the first motion of train or
    reference to the end of the evaluation, and are None without such a tick. Metrics with ``run`` in the key count to
    the end of the run. Errors are those of vehicle 0. With several power units rms uses the mean over the units, and a
    maximum uses the largest unit.
    """
    part = evaluated_ticks(setup, recording)
    whole_error = speed_errors(recording, slice(part.start, None))
    velocity_error = whole_error[: part.stop - part.start]
    position_error = position_errors(setup, recording, part)
    totals = recording.totals
    at_limit = time_at_force_limit(setup, recording)
    duration = recording.time.size * setup.tick
    acceleration, jerk = differences(recording.front_velocity, setup.tick)
    metrics = {
        "speed_rmse_kmh": 3.6 * _rms(velocity_error),
        "speed_error_max_kmh": 3.6 * _largest(velocity_error),
        "speed_rmse_run_kmh": 3.6 * _rms(whole_error),
        "speed_error_run_max_kmh": 3.6 * _largest(whole_error),
        "position_error_max_m": _largest(position_error),
        "position_rmse_m": _rms(position_error),
        "stop_error_m": stop_error(setup, recording),
        **_stop_metrics(setup, recording),
        "overspeed_max_kmh": 3.6 * overspeed(setup, recording),
        "coupler_draft_max_kn": totals.get("coupler_draft_max", 0.0) / 1e3,
        "coupler_buff_max_kn": totals.get("coupler_buff_max", 0.0) / 1e3,
        "acceleration_max": _largest(acceleration),
        "jerk_max": _largest(jerk),
        "jerk_1s_max": _largest(mean_jerk_1s(acceleration, setup.tick)),
        "command_variation_kn_per_s": float(np.abs(np.diff(recording.command, axis=0)).sum()) / duration / 1e3,
        "energy_traction_kwh": totals.get("energy_traction", 0.0) / 3.6e6,
        "energy_regenerated_kwh": totals.get("energy_regenerated", 0.0) / 3.6e6,
        "saturated_s": 0.0 if at_limit is None else float(at_limit[1][-1]),
        "replans": int(totals.get("replans", 0)),
        "held_steps": int(totals.get("held_steps", 0)),
        "unsound_measurements": int(totals.get("unsound_measurements", 0)),
        **{key: int(sum(totals.get(name, 0) for name in names)) for key, names in COMMAND_COUNTS},
    }
    if part.start == part.stop:
        metrics |= dict.fromkeys(OF_THE_EVALUATION)
    metrics |= stop_not_kept(recording)
    if setup.scenario.evaluation.couplers:
        metrics["couplers"] = coupler_rows(recording)
    metrics |= {key: totals[name] for key, name in LATENESS.items() if name in totals}
    if "ticks_late" in metrics:
        metrics["ticks_late"] = int(metrics["ticks_late"])
    if "plant" not in {report.node for report in recording.changed_reports}:
        metrics = {key: value for key, value in metrics.items() if key not in OF_THE_PLANT}
        metrics["coupler_draft_max_kn"] = float(max(0.0, recording.coupler_draft_max.max())) / 1e3
        metrics["coupler_buff_max_kn"] = float(min(0.0, recording.coupler_buff_max.min())) / 1e3
    return metrics


def coupler_rows(recording: Recording) -> list[dict[str, float | int]]:
    """Return extremes [kN] and rainflow cycles of the force of every coupler at the ticks; [] without couplers."""
    found = recording.of(TRUTH, "coupler_force")
    rows: list[dict[str, float | int]] = []
    for number, force in enumerate(() if found is None else found[1].T[:-1]):
        cycles = coupler_cycles(force)
        rows.append({
            "coupler": number,
            "draft_max_kn": round(max(float(force.max()), 0.0) / 1e3, 3),
            "buff_max_kn": round(min(float(force.min()), 0.0) / 1e3, 3),
            "cycles": float(cycles[:, 1].sum()),
            "range_max_kn": round(float(cycles[:, 0].max(initial=0.0)) / 1e3, 3),
            "damage": float(f"{cycle_damage(cycles):.6g}"),
        })  # fmt: skip
    return rows


FATIGUE_KEYS = ("coupler_damage", "coupler_damage_worst")
"""Damage of all couplers and of the worst one, keys of a summary."""


@dataclass(frozen=True)
class CouplerFatigue:
    """Fatigue of the couplers of a train in one run.

    Attributes
    ----------
    damage : Array, shape (couplers,)
        Damage after Miner; 1 per force cycle with a range of 1 MN.
    range_max : Array, shape (couplers,)
        Largest force of a coupler minus its smallest one [N].
    """

    damage: Array
    range_max: Array

    @property
    def total(self) -> float:
        """Damage of all couplers."""
        return float(self.damage.sum())

    def summary(self) -> dict[str, float | int]:
        """Return damage of all couplers and of the worst one, its number, its range [kN] and the slope."""
        worst = int(self.damage.argmax())
        return {
            FATIGUE_KEYS[0]: round(self.total, 4),
            FATIGUE_KEYS[1]: round(float(self.damage[worst]), 4),
            "worst_coupler": worst,
            "range_of_worst_kn": round(float(self.range_max[worst]) / 1e3, 1),
            "slope": SLOPE,
        }


def coupler_fatigue(recording: Recording) -> CouplerFatigue | None:
    """Return the fatigue of the couplers at the ticks of a recording with vehicles; None without couplers."""
    found = recording.of(TRUTH, "coupler_force")
    if found is None or found[1].shape[1] < 2:
        return None
    force = found[1][:, :-1]
    return CouplerFatigue(coupler_damage(force), force.max(axis=0) - force.min(axis=0))


def relative_fatigue(run: CouplerFatigue, other: CouplerFatigue) -> dict[str, Any]:
    """Return the damage of another run, and the ratio of a run to it; None if the other one has no damage."""
    ratio = run.total / other.total if other.total > 0.0 else None
    return {"other_coupler_damage": round(other.total, 4), "ratio": None if ratio is None else round(ratio, 4)}


def stop_not_kept(recording: Recording) -> dict[str, Any]:
    """Return the time of the first plan whose force cannot keep a stop [s], and the largest distance beyond it [m].

    {} without such a plan.
    """
    found: dict[str, Any] = {}
    for report in recording.changed_reports:
        _, passes, beyond = report.values.get(STATUS, "").partition(PASSES)
        if passes and report.node == "controller":
            before = found.get("stop_not_kept_m", 0.0)
            found = {"stop_not_kept_s": report.stamp / 1e9} | found
            found["stop_not_kept_m"] = max(before, float(beyond.split()[0]))
    return found


def _stop_metrics(setup: RunSetup, recording: Recording) -> dict[str, Any]:
    """Return error, running time and delay at the stops; None without an arrival at every stop that was due."""
    stops: list[StopResult] = stops_of_run(setup, recording)
    errors = [stop.error for stop in stops if stop.error is not None]
    delays = [stop.arrival - stop.planned for stop in stops if stop.arrival is not None]
    complete = bool(stops) and len(errors) == len(stops)
    return {
        "stop_error_max_m": max(errors, key=abs) if complete else None,
        "running_time_s": running_time(setup, recording, stops),
        "arrival_delay_max_s": max(delays) if complete else None,
        "stops": [stop.as_row() | post_of(setup.line, stop.front) for stop in stops],
    }


def evaluated_ticks(setup: RunSetup, recording: Recording) -> slice:
    """Return the ticks from the first motion of train or reference to the end of the evaluation."""
    fastest = np.maximum(np.abs(recording.front_velocity), np.abs(recording.reference_velocity))
    moving = np.flatnonzero(fastest > STANDSTILL_SPEED)
    first = int(moving[0]) if moving.size else 0
    last = recording.time.size
    evaluation = setup.scenario.evaluation
    if evaluation.until is not None:
        beyond = np.flatnonzero(recording.reference_position > evaluation.until)
        last = min(last, int(beyond[0])) if beyond.size else last
    if evaluation.until_time is not None:
        last = min(last, int(np.searchsorted(recording.time, evaluation.until_time + ROUNDING, side="right")))
    return slice(min(first, last), last)


def speed_errors(recording: Recording, rows: slice) -> Array:
    """Return speed minus reference of every unit at ticks of a run [m/s], shape (k, u)."""
    return recording.velocity[rows] - recording.reference_velocity[rows, None]


def position_errors(setup: RunSetup, recording: Recording, rows: slice) -> Array:
    """Return position minus reference of every unit at ticks of a run [m], shape (k, u)."""
    return recording.position[rows] + setup.model.offsets - recording.reference_position[rows, None]


def _rms(errors: Array) -> float:
    """Return the mean of the root mean squares of the columns."""
    if errors.size == 0:
        return 0.0
    return float(np.sqrt((errors**2).mean(axis=0)).mean())


def _largest(values: Array) -> float:
    return float(np.abs(values).max()) if values.size else 0.0


def differences(velocity: Array, tick: float) -> tuple[Array, Array]:
    """Return acceleration [m/s²] and jerk [m/s³] from differences over 0.1 s or a tick, whichever is longer."""
    stride = max(1, round(JERK_SPAN / tick))
    span = stride * tick
    acceleration = np.diff(velocity[::stride]) / span
    return acceleration, np.diff(acceleration) / span


def mean_jerk_1s(acceleration: Array, tick: float) -> Array:
    """Return the change of the mean acceleration from one second to the next [m/s³].

    The capture of the wheels at standstill lasts 0.1 s and hardly counts in it, as for a passenger.

    Parameters
    ----------
    acceleration
        From :func:`differences` [m/s²].
    tick
        Tick of the run [s].
    """
    span = max(1, round(JERK_SPAN / tick)) * tick
    count = max(1, round(1.0 / span))
    sums = np.cumsum(np.append(0.0, acceleration))
    means = (sums[count:] - sums[:-count]) / count
    return np.asarray(means[count:] - means[:-count]) / (count * span)


def stop_error(setup: RunSetup, recording: Recording) -> float | None:
    """Return front minus target [m] if the train is at rest at the end (|v| < 0.01 m/s), else None."""
    position, velocity = recording.final
    return None if abs(velocity) >= STANDSTILL_SPEED else position - float(setup.profile.position[-1])


def overspeed(setup: RunSetup, recording: Recording) -> float:
    """Return the maximum speed above the limit for the whole train [m/s], 0 if the limit was never exceeded."""
    return float(excess_speed(setup, recording).max(initial=0.0))


def excess_speed(setup: RunSetup, recording: Recording) -> Array:
    """Return speed in either direction minus limit for the whole train at every tick [m/s], shape (k,).

    On a line without limits the shape is (0,).
    """
    if not setup.line.speed_limits:
        return np.zeros(0)
    limit = limit_over_train(setup.line, front_of_train(setup, recording), setup.consist.length)
    return np.asarray(np.abs(recording.front_velocity) - limit)


def front_of_train(setup: RunSetup, recording: Recording) -> Array:
    """Return the position of the front of vehicle 0 at every tick [m], shape (k,)."""
    return recording.front_position + setup.consist.vehicles[0].length / 2


def post_of(line: Line, place: float) -> dict[str, Any]:
    """Return the kilometre of a place [m] by the posts of a line as ``post``; {} for a line without a chainage."""
    return {"post": line.post_at(place)} if line.chainage else {}


def place_of_front(setup: RunSetup, recording: Recording, at_s: float) -> dict[str, Any]:
    """Return the position of the front of vehicle 0 at a time [s] as ``km`` and ``post``."""
    km = float(np.interp(at_s, recording.time, front_of_train(setup, recording))) / 1e3
    return {"km": km, **post_of(setup.line, 1e3 * km)}


def limit_over_train(line: Line, front: Array, length: float) -> Array:
    """Return the lowest limit between rear and front of the train [m/s], one value per front position."""
    places = np.array([limit.at for limit in line.restricted_limits])
    speeds = np.array([limit.speed for limit in line.restricted_limits])
    first = np.searchsorted(places, front - length, side="right") - 1
    last = np.searchsorted(places, front, side="right") - 1
    result = np.where(last >= 0, speeds[np.maximum(last, 0)], np.inf)
    for index in range(speeds.size):
        inside = (index >= first) & (index <= last)
        result = np.where(inside, np.minimum(result, speeds[index]), result)
    return np.asarray(result)
