"""Interpolation of a measured run at the ticks, with forces per power unit and energy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant_sim.number_text import number_text
from train_ato.apps.import_csv.recording import Measured
from train_ato.apps.import_csv.samples import ColumnSamples
from train_ato.loop.setup import RunSetup
from train_ato.messages.types import Array

__all__ = ["MeasuredSeries", "series_of"]

MAX_FORCE_RATIO = 3.0
"""Maximum force relative to the envelope; larger ones have a wrong unit."""


@dataclass(frozen=True)
class MeasuredSeries:
    """Measured run at k ticks for u power units, in SI.

    Attributes
    ----------
    position, velocity, applied, command : Array, shape (k, u)
        States and forces of every power unit.
    reference_velocity, reference_acceleration : Array, shape (k,)
        Recorded reference; otherwise the profile.
    pressure : Array or None, shape (k,)
        Brake-pipe pressure.
    traction, regenerated : Array, shape (k,)
        Energy up to the tick [J].
    commanded, referenced : bool
        True if demand and reference were recorded.
    """

    time: Array
    position: Array
    velocity: Array
    applied: Array
    command: Array
    reference_velocity: Array
    reference_acceleration: Array
    pressure: Array | None
    traction: Array
    regenerated: Array
    commanded: bool
    referenced: bool


def series_of(found: Measured, setup: RunSetup) -> MeasuredSeries:
    """Return the measured run at the ticks, by linear interpolation.

    A total force is distributed equally over the power units.  Without a recorded demand the command is the force at
    the wheel; without a recorded reference it is the profile.

    Raises
    ------
    ValueError
        If a force is too large for the train, or the brake pipe or the force is missing.
    """
    if not found.force:
        raise ValueError(
            f"{found.table.path}: no force column; name one force_kn, or import only the profile with --profile-only"
        )
    if found.pressure is not None and not setup.layout.air_brake:
        title = found.pressure.column.title
        raise ValueError(
            f"{found.table.path}: column '{title}': train '{setup.consist.name}' has no air brake; remove it with "
            f"--ignore '{title}'"
        )
    _check_forces(found, setup)
    units = setup.layout.n_units
    time: Array = np.asarray(setup.tick * np.arange(setup.ticks + 1), dtype=np.float64)
    front = setup.profile.position[: time.size]
    offsets = setup.model.offsets
    velocity = [found.unit_speed.get(unit, found.speed).at(time) for unit in range(units)]
    position = [
        found.unit_position[unit].at(time)
        if unit in found.unit_position
        else _centre(found, time, front) - offsets[unit]
        for unit in range(units)
    ]
    applied = _of_units(found.force, time, units)
    v, f = np.stack(velocity, axis=1), np.stack(applied, axis=1)
    power = (v * f).sum(axis=1)
    reference = found.reference_speed
    kept = reference.at(time) if reference is not None else setup.profile.velocity[: time.size]
    return MeasuredSeries(
        time=time,
        position=np.stack(position, axis=1),
        velocity=v,
        applied=f,
        command=np.stack(_of_units(found.command, time, units), axis=1) if found.command else f,
        reference_velocity=kept,
        reference_acceleration=np.gradient(kept, setup.tick)
        if reference is not None
        else setup.profile.acceleration[: time.size],
        pressure=found.pressure.at(time) if found.pressure is not None else None,
        traction=_sum(np.maximum(power, 0.0), setup.tick),
        regenerated=_sum(np.maximum(-power, 0.0), setup.tick),
        commanded=bool(found.command),
        referenced=reference is not None,
    )


def _centre(found: Measured, time: Array, front: Array) -> Array:
    """Return the recorded position of vehicle 0, or else that of the profile."""
    return found.position.at(time) if found.position is not None else front


def _of_units(samples: dict[int | None, ColumnSamples], time: Array, units: int) -> list[Array]:
    whole = samples.get(None)
    if whole is not None:
        return [whole.at(time) / units] * units
    return [samples[unit].at(time) for unit in range(units)]


def _sum(power: Array, tick: float) -> Array:
    return np.concatenate(([0.0], np.cumsum((power[1:] + power[:-1]) / 2 * tick)))


def _check_forces(found: Measured, setup: RunSetup) -> None:
    """Check the forces against the envelopes of the train, to detect wrong units."""
    grid = np.linspace(0.0, max(1.0, float(found.speed.values.max())), 50)
    limits = [setup.model.force_limits(np.full(setup.layout.n_units, speed)) for speed in grid]
    most = np.max([np.maximum(np.abs(low), np.abs(high)) for low, high in limits], axis=0)
    for group in (found.force, found.command):
        for unit, samples in group.items():
            bound = MAX_FORCE_RATIO * float(most.sum() if unit is None else most[unit])
            wrong = np.flatnonzero(np.abs(samples.values) > bound)
            if wrong.size:
                place = int(wrong[0])
                value = samples.values[place]
                raise found.table.wrong(
                    int(samples.rows[place]),
                    samples.column,
                    f"{number_text(value / 1e3)} kN is {abs(value) / bound * MAX_FORCE_RATIO:.1f} times the maximum "
                    f"of train '{setup.consist.name}'; check the unit in the column name",
                )
