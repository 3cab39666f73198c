"""Lines of the figures, worked out of a recording at full resolution, in the units that are shown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from train_ato.metrics import limit_over_train
from train_ato.model import TrainModel
from train_ato.report.delays import delays
from train_ato.report.happened import delay_jumps
from train_ato.report.recording import Recording
from train_ato.report.thin import aligned
from train_ato.types import Array

KMH, KILO, KWH = 3.6, 1e3, 3.6e6
MOST_UNITS = 8
"""Trains of more power units are drawn as the sum over them."""
FAR_ENVELOPE = 20.0
"""An envelope this many times beyond the largest force tells nothing and is left out."""
ENERGIES: tuple[tuple[str, str, float], ...] = (
    ("traction", "energy_traction", 1.0),
    ("regenerated", "energy_regenerated", -1.0),
    ("running", "energy_running", 1.0),
    ("curve", "energy_curve", 1.0),
    ("grade", "energy_grade", 1.0),
    ("air_brake", "energy_air_brake", 1.0),
    ("couplers", "energy_couplers", 1.0),
    ("outside", "energy_outside", 1.0),
    ("kinetic", "energy_kinetic", 1.0),
)
"""Line, key in the plant's diagnostics, and the sign that makes it work done on the train."""


class LeftOut(Exception):
    """A figure that a run cannot fill; the message says why."""


@dataclass(frozen=True)
class Lines:
    """Lines over one time.

    Attributes
    ----------
    time : Array, shape (k,)
        Stamps [s].
    columns : dict of Array, each of shape (k,)
        By quantity, in its unit; ``quantity:3`` is that of unit 3.  NaN where there is no value.
    """

    time: Array
    columns: dict[str, Array]


def speed(recording: Recording) -> Lines:
    """Return speed of vehicle 0, its profile and its limit [km/h], and its position [km]."""
    motion = recording.motion
    if motion is None:
        raise LeftOut("the log has neither train/cars nor train/measurement")
    now = motion["speed"][:, 0]
    columns = {"measured_speed" if recording.measured_only else "speed": KMH * now}
    if (reference := recording.of("ato/reference", "speed")) is not None:
        columns["profile"] = KMH * aligned(motion.time, *reference)[:, 0]
    if "position" in motion:
        position = motion["position"][:, 0]
        if (limit := whole_train_limit(recording, position)) is not None:
            columns["limit"] = limit
        columns["position_km"] = position / KILO
    return Lines(motion.time, columns)


def whole_train_limit(recording: Recording, position: Array) -> Array | None:
    """Return the lowest limit under the train [km/h] for positions of vehicle 0; None where the line has none."""
    setup = recording.setup
    if setup is not None and setup.line.speed_limits:
        front = position + setup.consist.vehicles[0].length / 2
        limit = limit_over_train(setup.line, front, setup.consist.length)
        return np.where(np.isfinite(limit), KMH * limit, np.nan)
    if recording.limits is None or not recording.limits[0].size:
        return None
    places, speeds = recording.limits
    step = np.searchsorted(places, position, side="right") - 1
    return np.where(step >= 0, KMH * speeds[np.maximum(step, 0)], np.nan)


def _of_units(recording: Recording, name: str) -> tuple[Array, Array]:
    """Return time and truth (else the measurement) of every power unit's vehicle, shapes (k,) and (k, u)."""
    cars = recording.of("train/cars", name)
    if cars is not None and recording.setup is not None and recording.setup.model.units:
        return cars[0], cars[1][:, list(recording.setup.model.units)]
    measured = recording.of("train/measurement", name)
    if measured is not None and measured[1].shape[1]:
        return measured
    raise LeftOut(f"the log has no {name} of a power unit")


def _reference(recording: Recording, name: str, time: Array) -> Array:
    reference = recording.of("ato/reference", name)
    if reference is None:
        raise LeftOut("the log has no ato/reference")
    if not recording.recorded("reference"):
        raise LeftOut("the reference was not measured: the profile is the measured speed itself")
    return np.asarray(aligned(time, *reference)[:, :1])


def _per_unit(name: str, values: Array) -> dict[str, Array]:
    """Name the columns of units; a single unit needs no number."""
    if values.shape[1] == 1:
        return {name: values[:, 0]}
    return {f"{name}:{unit}": values[:, unit] for unit in range(min(values.shape[1], MOST_UNITS))}


def speed_error(recording: Recording) -> Lines:
    """Return speed minus that of the reference at the same stamp [km/h], every power unit."""
    time, values = _of_units(recording, "speed")
    return Lines(time, _per_unit("speed_error", KMH * (values - _reference(recording, "speed", time))))


def position_error(recording: Recording) -> Lines:
    """Return position minus that of the reference [m], every power unit at its place in the train."""
    time, values = _of_units(recording, "position")
    offsets = recording.setup.model.offsets if recording.setup is not None else 0.0
    errors = values + offsets - _reference(recording, "position", time)
    return Lines(time, _per_unit("position_error", np.asarray(errors)))


def forces(recording: Recording) -> Lines:
    """Return demand, applied force and nominal envelope of all units together [kN]."""
    command, applied = recording.of("ato/command", "force"), recording.of("train/measurement", "applied")
    if applied is None and command is None:
        raise LeftOut("the log has neither ato/command nor train/measurement")
    if applied is not None and not recording.recorded("command"):
        command = None
    time = (command or applied or (np.empty(0), np.empty(0)))[0]
    columns: dict[str, Array] = {}
    for name, found in (("demand", command), ("applied", applied)):
        if found is not None and found[1].shape[1]:
            columns[name] = aligned(time, *found).sum(axis=1) / KILO
    if not columns:
        raise LeftOut("the train has no power unit")
    largest = max(float(np.nanmax(np.abs(values), initial=0.0)) for values in columns.values())
    columns |= _envelope(recording, time, largest)
    return Lines(time, columns)


def _envelope(recording: Recording, time: Array, largest: float) -> dict[str, Array]:
    setup, motion = recording.setup, recording.motion
    if setup is None or motion is None or setup.plant.unlimited:
        return {}
    low, high = envelope(setup.model, aligned(time, motion.time, motion["speed"][:, 0]))
    if max(float(np.nanmax(high, initial=0.0)), -float(np.nanmin(low, initial=0.0))) > FAR_ENVELOPE * KILO * largest:
        return {}
    return {"envelope_high": high / KILO, "envelope_low": low / KILO}


def envelope(model: TrainModel, speed: Array) -> tuple[Array, Array]:
    """Return the smallest and the largest force of all units together at these speeds [N]."""
    size = np.abs(speed)
    grid = np.linspace(0.0, max(1.0, float(np.nanmax(size, initial=0.0))), 400)
    pairs = [model.force_limits(np.full(model.n_units, value)) for value in grid]
    low, high = (np.array([pair[side].sum() for pair in pairs]) for side in (0, 1))
    return np.interp(size, grid, low), np.interp(size, grid, high)


def unit_forces(recording: Recording) -> Lines:
    """Return the applied force of every power unit [kN]."""
    applied = recording.of("train/measurement", "applied")
    if applied is None or applied[1].shape[1] < 2:
        raise LeftOut(
            "the train has a single power unit" if applied is not None else "the log has no train/measurement"
        )
    return Lines(applied[0], _per_unit("applied", applied[1] / KILO))


def couplers(recording: Recording) -> tuple[Array, NDArray[np.float64]]:
    """Return time [s] and the force of every coupler [kN], shape (k, vehicles - 1), > 0 draft."""
    found = recording.of("train/cars", "coupler")
    if found is None:
        raise LeftOut("the log has no train/cars")
    if found[1].shape[1] < 2:
        raise LeftOut("the train is taken as one vehicle: it has no coupler")
    return found[0], found[1][:, :-1] / KILO


def coupler_extremes(recording: Recording) -> Lines:
    """Return largest draft and buff along the train and three couplers [kN]."""
    time, force = couplers(recording)
    columns = {"draft": np.maximum(force.max(axis=1), 0.0), "buff": np.minimum(force.min(axis=1), 0.0)}
    last = force.shape[1] - 1
    if last >= 2:
        columns |= {"first_coupler": force[:, 0], "middle_coupler": force[:, last // 2], "last_coupler": force[:, last]}
    return Lines(time, columns)


def disturbance(recording: Recording) -> Lines:
    """Return the disturbance as estimated for every power unit and as it was [kN]."""
    estimate, truth = recording.of("ato/estimate", "force"), recording.of("train/disturbance", "force")
    setup = recording.setup
    told = estimate is not None and bool(np.any(estimate[1]))
    if truth is None and not told:
        raise LeftOut("no disturbance in the scenario and no observer that estimated one")
    time = (estimate or truth or (np.empty(0), np.empty(0)))[0]
    columns: dict[str, Array] = {}
    if estimate is not None and told:
        columns |= _per_unit("estimate", estimate[1] / KILO)
    if truth is not None:
        force = aligned(time, *truth) / KILO
        units = list(setup.model.units) if setup is not None else []
        if units:
            columns |= _per_unit("truth", force[:, units])
        if force.shape[1] > len(units):
            columns["whole_truth"] = force.sum(axis=1)
    return Lines(time, columns)


def delay(recording: Recording) -> Lines:
    """Return the delay from command to effect as found in the log, as set, and as the law believes it [s]."""
    if not recording.recorded("command"):
        raise LeftOut("the command was not measured")
    found = delays(recording, delay_jumps(recording))
    command = recording.of("ato/command", "force")
    if not found or command is None:
        raise LeftOut("the log lacks commands or applied forces")
    time = command[0]
    columns = {}
    for name, (other, values) in found.items():
        row = np.searchsorted(other, time, side="right") - 1
        if name == "delay":  # one value for a whole window, told at its middle
            row = (
                np.searchsorted((other[1:] + other[:-1]) / 2, time) if other.size > 1 else np.zeros(time.size, np.intp)
            )
        columns[name] = np.where(row >= 0, values[np.maximum(row, 0)], np.nan)
    return Lines(time, columns)


def pipe(recording: Recording) -> Lines:
    """Return the brake-pipe pressure at the head, demanded and as it is [kPa]."""
    demand, head = recording.of("ato/brake_pipe", "pressure"), recording.of("train/brake_pipe", "pressure")
    if demand is None and head is None:
        raise LeftOut(recording.without_brake)
    time = (head or demand or (np.empty(0), np.empty(0)))[0]
    columns = {
        name: aligned(time, *found)[:, 0] / KILO
        for name, found in (("pipe_demand", demand), ("pipe", head))
        if found is not None
    }
    if all(np.nanmax(values) - np.nanmin(values) < 1.0 for values in columns.values()):
        raise LeftOut("the air brake was never applied")
    return Lines(time, columns)


def shoes(recording: Recording) -> tuple[Array, NDArray[np.float64]]:
    """Return time [s] and the shoe force of every vehicle [kN], shape (k, vehicles)."""
    found = recording.of("train/brake_cylinders", "shoe_force")
    if found is None:
        raise LeftOut(recording.without_brake)
    if not np.any(found[1]):
        raise LeftOut("the air brake was never applied")
    return found[0], found[1] / KILO


def shoe_force(recording: Recording) -> Lines:
    """Return the shoe force of the whole train [kN]."""
    time, force = shoes(recording)
    return Lines(time, {"shoe_force": force.sum(axis=1)})


def energy(recording: Recording) -> Lines:
    """Return the work done on the train since the start [kWh]; all of it together is the kinetic energy."""
    said = recording.said.get("plant")
    if said is not None:
        columns = {
            name: sign * values / KWH
            for name, key, sign in ENERGIES
            if (values := said.numbers(key)) is not None and np.nanmax(np.abs(values)) > 0
        }
        if columns:
            return Lines(said.time, columns)
    applied, moved = recording.of("train/measurement", "applied"), recording.of("train/measurement", "speed")
    if applied is None or moved is None or applied[1].shape[1] != moved[1].shape[1] or applied[0].size < 2:
        raise LeftOut("the log has neither the plant's diagnostics nor forces and speeds of the units")
    power = (applied[1] * moved[1]).sum(axis=1)
    steps = np.diff(applied[0], prepend=applied[0][0])
    work = {"traction": np.maximum(power, 0.0), "regenerated": np.minimum(power, 0.0)}
    return Lines(applied[0], {name: np.cumsum(values * steps) / KWH for name, values in work.items()})


LINES: dict[str, Callable[[Recording], Lines]] = {
    "speed": speed,
    "speed_error": speed_error,
    "position_error": position_error,
    "forces": forces,
    "unit_forces": unit_forces,
    "coupler_extremes": coupler_extremes,
    "disturbance": disturbance,
    "delay": delay,
    "pipe": pipe,
    "shoe_force": shoe_force,
    "energy": energy,
}
"""Figures of lines over time."""
MAPS: dict[str, Callable[[Recording], tuple[Array, NDArray[np.float64]]]] = {"couplers": couplers, "shoes": shoes}
"""Figures of all vehicles over time."""
