"""A measured run at the ticks: every quantity read between its rows, forces shared, energy summed up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from train_ato.measured.recording import Measured
from train_ato.measured.samples import Samples
from train_ato.run_setup import RunSetup
from train_ato.types import Array

__all__ = ["Series", "series_of"]

MOST_FORCE = 3.0
"""A force beyond so many times what the train can do is a wrong unit."""


@dataclass(frozen=True)
class Series:
    """The measured run at the ticks: k ticks, u power units, SI.

    Attributes
    ----------
    position, velocity, applied, command : Array, shape (k, u)
        Of every power unit.
    reference_velocity, reference_acceleration : Array, shape (k,)
        What was to be kept; the profile where the recorder does not say.
    pressure : Array or None, shape (k,)
        Of the brake pipe.
    traction, regenerated : Array, shape (k,)
        Energy up to the tick [J].
    commanded, referenced : bool
        Whether the recorder gave demands and a reference.
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


def series_of(found: Measured, setup: RunSetup) -> Series:
    """Return the measured run at the ticks, every quantity linear between its rows.

    A force of the whole train is shared by its power units equally.  Where no demand was recorded the force at the
    wheel stands for it, where no reference was, the profile.

    Raises
    ------
    ValueError
        If a force is beyond what the train can do, a brake pipe is missing, or there is no force at all.
    """
    if not found.force:
        raise ValueError(
            f"{found.table.path}: no column of the force; name one force_kn, or take the profile alone: --profile-only"
        )
    if found.pressure is not None and not setup.shape.air_brake:
        title = found.pressure.column.title
        raise ValueError(
            f"{found.table.path}: column '{title}': train '{setup.consist.name}' has no air brake; --ignore '{title}'"
        )
    _check_forces(found, setup)
    units = setup.shape.n_units
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
    return Series(
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
    """Return the place of vehicle 0's centre as it was recorded, else that of the profile."""
    return found.position.at(time) if found.position is not None else front


def _of_units(samples: dict[int | None, Samples], time: Array, units: int) -> list[Array]:
    whole = samples.get(None)
    if whole is not None:
        return [whole.at(time) / units] * units
    return [samples[unit].at(time) for unit in range(units)]


def _sum(power: Array, tick: float) -> Array:
    return np.concatenate(([0.0], np.cumsum((power[1:] + power[:-1]) / 2 * tick)))


def _check_forces(found: Measured, setup: RunSetup) -> None:
    """Refuse forces that the train's power units could never give: the usual sign of a wrong unit."""
    grid = np.linspace(0.0, max(1.0, float(found.speed.values.max())), 50)
    limits = [setup.model.force_limits(np.full(setup.shape.n_units, speed)) for speed in grid]
    most = np.max([np.maximum(np.abs(low), np.abs(high)) for low, high in limits], axis=0)
    for group in (found.force, found.command):
        for unit, samples in group.items():
            bound = MOST_FORCE * float(most.sum() if unit is None else most[unit])
            wrong = np.flatnonzero(np.abs(samples.values) > bound)
            if wrong.size:
                place = int(wrong[0])
                value = samples.values[place]
                raise found.table.wrong(
                    int(samples.rows[place]),
                    samples.column,
                    f"{value / 1e3:g} kN is {abs(value) / bound * MOST_FORCE:.1f} times what train "
                    f"'{setup.consist.name}' can do; is the unit in the column's name right?",
                )
