"""Limits ahead by place: speed limit of the line for the whole train, force of every unit with the line's sections.

The tables follow once from the nominal train and line. Neutral sections, power limits and adhesion hold for every power
unit with its centre in the section, as in the plant (:mod:`plant_sim.section_effects`); the adhesion is that of
Curtius and Kniffler, dry, times the factor of the section, and limits on lines with adhesion sections only.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.railway import adhesion_by_speed, envelope_force
from plant_sim.section_effects import Row, SectionZones, largest_power, limited_segments
from plant_sim.summation import plain_sum
from train_ato.messages.types import Array
from train_ato.messages.validity import MAX_SPEED

if TYPE_CHECKING:
    from plant_sim.line import Line
    from train_ato.control.train_model import TrainModel


def limits_force(line: Line) -> bool:
    """Return True for a line with sections that limit the force."""
    return bool(line.neutral_sections or line.power_limits or line.adhesion)


class LimitsAhead:
    """Limits at places and speeds of the reference.

    Parameters
    ----------
    model
        The nominal train and line.
    """

    def __init__(self, model: TrainModel) -> None:
        self._places, self._speeds = _whole_train_limits(model)
        self._zones = SectionZones(model.line)
        self._offsets = model.offsets
        self._rows, self._pointers = self._zone_envelopes(model)
        vehicles = [model.consist.vehicles[unit] for unit in model.units]
        weight = [model.consist.gravity * (vehicle.adhesive_mass or vehicle.mass) for vehicle in vehicles]
        by_zone = [factor if model.line.adhesion else math.inf for factor in self._zones.adhesion]
        self._adhesion = np.array([[factor * each for each in weight] for factor in by_zone]).reshape(-1, len(weight))

    def speed_limit(self, position: Array) -> Array:
        """Return the lowest limit over the train with vehicle 0's centre at places [m/s], shape (h,)."""
        found: Array = _step_values(self._places, self._speeds, position)
        return found

    def force(self, position: Array, speed: Array) -> tuple[Array, Array]:
        """Return smallest and largest force of every unit [N], each of shape (h, units).

        Parameters
        ----------
        position, speed : Array, shape (h,)
            Of vehicle 0's centre [m, m/s].
        """
        found: tuple[Array, Array] = _forces(
            position, speed, self._offsets, self._zones.breaks, self._rows, self._pointers, self._adhesion
        )
        return found

    def _zone_envelopes(self, model: TrainModel) -> tuple[Array, np.ndarray[tuple[int, ...], np.dtype[np.int64]]]:
        """Return rows of envelopes, and first and end of traction and brake for every zone and unit."""
        zones, rows = self._zones, list[Row]()
        traction = [[(float(a), float(b), float(c), float(d)) for a, b, c, d in unit.rows] for unit in model.traction]
        brake = [[(float(a), float(b), float(c), float(d)) for a, b, c, d in unit.rows] for unit in model.brake]
        powers = [largest_power(unit) for unit in traction]
        whole = plain_sum(powers) or 1.0
        pointers = np.zeros((len(zones.neutral), model.n_units, 4), dtype=np.int64)
        for zone, (neutral, off, power) in enumerate(
            zip(zones.neutral, zones.electric_brake_off, zones.power, strict=True)
        ):
            for unit, vehicle in enumerate(model.units):
                pull, hold = traction[unit], brake[unit]
                if not model.consist.vehicles[vehicle].independent_power:
                    pull = (
                        []
                        if neutral
                        else limited_segments(pull, power * powers[unit] / whole)
                        if power < whole
                        else pull
                    )
                    hold = [] if off else hold
                begin, middle = len(rows), len(rows) + len(pull)
                rows += [*pull, *hold]
                pointers[zone, unit] = begin, middle, middle, len(rows)
        return np.array(rows or [(0.0, 0.0, 0.0, 0.0)]), pointers


def _whole_train_limits(model: TrainModel) -> tuple[Array, Array]:
    """Return places of vehicle 0's centre at which the limit over the train changes [m], and the limits [m/s].

    A line without limits has the largest valid speed.
    """
    limits = [(limit.at, limit.speed) for limit in model.line.restricted_limits]
    if not limits:
        return np.zeros(0), np.array([MAX_SPEED])
    half = model.consist.vehicles[0].length / 2.0
    rear = model.consist.length - half
    begins = [at - half for at, _ in limits]
    ends = [at + rear for at, _ in limits[1:]] + [math.inf]
    places = sorted({*begins[1:], *ends[:-1]})
    found = []
    for low in [-math.inf, *places]:
        held = [
            speed for (_, speed), begin, end in zip(limits, [-math.inf, *begins[1:]], ends, strict=True)
            if begin <= low < end
        ]  # fmt: skip
        found.append(min(held))
    return np.array(places), np.array(found)


@compiled
def _step_values(places, values, position):
    """Return the values that hold at positions; value i before place i, the last one beyond all places."""
    found = np.empty(position.size)
    for k in range(position.size):
        step = 0
        while step < places.size and places[step] <= position[k]:
            step += 1
        found[k] = values[step]
    return found


@compiled
def _forces(position, speed, offsets, breaks, rows, pointers, adhesion):
    """Return smallest and largest force of the units at places and speeds [N], each of shape (h, units)."""
    low, high = np.empty((position.size, offsets.size)), np.empty((position.size, offsets.size))
    for k in range(position.size):
        size = abs(speed[k])
        for unit in range(offsets.size):
            zone = 0
            while zone < breaks.size and breaks[zone] <= position[k] - offsets[unit]:
                zone += 1
            first, end, brake_first, brake_end = pointers[zone, unit]
            grip = adhesion[zone, unit] * adhesion_by_speed(size)
            low[k, unit] = -min(envelope_force(rows, brake_first, brake_end, size), grip)
            high[k, unit] = min(envelope_force(rows, first, end, size), grip)
    return low, high
