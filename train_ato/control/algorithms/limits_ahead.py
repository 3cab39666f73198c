"""Limits ahead by place: speed limit of the line for the whole train, force of every unit with the line's sections.

The tables follow once from the nominal train and line. Adhesion applies to every power unit with its centre in the
section, neutral sections and power limits to one with its pantograph there, as in the plant
(:mod:`plant_sim.section_effects`). The adhesion is the dry adhesion of Curtius and Kniffler times the factor of the
section. It limits only on lines with adhesion sections.

Force limits of line sections in the plan of a predictive law: limits at its nodes, and the command of every unit.
"""

# mypy: allow-untyped-defs

import math

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import plain_sum
from plant_sim.line import Line
from plant_sim.railway import adhesion_by_speed, envelope_force
from plant_sim.section_effects import Row, SectionZones, largest_power, limited_segments
from train_ato.control.guard import within_limits
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.messages.validity import MAX_SPEED
from train_ato.supervision.track_supervision import limits_under_train


@compiled
def node_limits(force, nodes, parts, effect, limits, side):
    """Narrow the limits of the total force at the nodes by those of the units ahead.

    A limit of a node is a mean over the time to the neighbours. Its weights fall linearly to 0 there. The planned force
    is linear between the nodes. With this limit it has the impulse that a section leaves. The first node also keeps the
    limit at the effect of the command. Its mean takes the force away before a section begins: without it the last steps
    before the section would make a spike of force out of every small error that is left.

    Parameters
    ----------
    force : Array, shape (h, units)
        Limit of every unit at the times of the lookahead [N].
    nodes : Array, shape (nodes,)
        Times of the nodes after the effect [s].
    parts
        Steps from a node to the next at the end of the lookahead.
    effect
        Row of the effect of the command.
    limits : Array, shape (2, nodes)
        Smallest and largest total force [N]; changed.
    side
        0: ``force`` is the smallest, 1: the largest.
    """
    n, first = nodes.size, force.shape[0] - parts * (nodes.size - 1) - 1
    total, weight = np.zeros(n), np.zeros(n)
    for j in range(n - 1):
        step = nodes[j + 1] - nodes[j]
        for k in range(parts + 1):
            value = 0.0
            for unit in range(force.shape[1]):
                value += force[first + j * parts + k, unit]
            part = k / parts
            ends = 0.5 if k == 0 or k == parts else 1.0
            total[j] += ends * step * (1.0 - part) * value
            weight[j] += ends * step * (1.0 - part)
            total[j + 1] += ends * step * part * value
            weight[j + 1] += ends * step * part
    for j in range(n):
        value = total[j] / weight[j]
        limits[side, j] = min(limits[side, j], value) if side else max(limits[side, j], value)
    value = 0.0
    for unit in range(force.shape[1]):
        value += force[effect, unit]
    limits[side, 0] = min(limits[side, 0], value) if side else max(limits[side, 0], value)


def within_units(wanted: list[float], share: list[float], low: list[float], high: list[float]) -> list[float]:
    """Return the forces of the units inside their limits [N]; other units take over what one cannot give.

    Parameters
    ----------
    wanted, share, low, high : list of float, length units
        Forces [N], shares of a total force, and limits at the time of effect [N].
    """
    found = within_limits(wanted, low, high)
    for _ in wanted:
        rest = plain_sum(wanted) - plain_sum(found)
        free = [
            part if (most > force if rest > 0.0 else least < force) else 0.0
            for part, force, least, most in zip(share, found, low, high, strict=True)
        ]
        whole = plain_sum(free)
        if rest == 0.0 or whole == 0.0:
            break
        found = within_limits([force + rest * part / whole for force, part in zip(found, free, strict=True)], low, high)
    return found


def limits_at_nodes(low: Array, high: Array, nodes: Array, *, parts: int, effect: int, limits: Array) -> Array:
    """Return limits of the total force narrowed by :func:`node_limits` on both sides [N], shape (2, nodes)."""
    found = limits.copy()
    node_limits(low, nodes, parts, effect, found, 0)
    node_limits(high, nodes, parts, effect, found, 1)
    return found


def limits_force(line: Line) -> bool:
    """Return True for a line with sections that limit the force."""
    return bool(line.neutral_sections or line.power_limits or line.adhesion)


class LimitsAhead:
    """Limits at places and speeds of the reference.

    Parameters
    ----------
    model
        The nominal train and line.

    Attributes
    ----------
    places, speeds : Array
        Places of vehicle 0's centre at which the limit over the train changes [m]; limits [m/s], one more. A line
        without limits has the largest valid speed.
    """

    def __init__(self, model: TrainModel) -> None:
        limits = [(limit.at, limit.speed) for limit in model.line.restricted_limits] or [(0.0, MAX_SPEED)]
        steps = limits_under_train(limits, model.consist.length)
        self.places = np.array([at for at, _ in steps[1:]]) - model.consist.vehicles[0].length / 2.0
        self.speeds = np.array([speed for _, speed in steps])
        self._zones = SectionZones(model.line, model.consist)
        self._offsets, supplies = model.offsets.copy(), model.consist.supplies
        self._fed_at = np.array(model.consist.offsets)[[supplies[unit] for unit in model.units]]
        self._rows, self._pointers = self._zone_envelopes(model)
        vehicles = [model.consist.vehicles[unit] for unit in model.units]
        weight = [model.consist.gravity * (vehicle.adhesive_mass or vehicle.mass) for vehicle in vehicles]
        by_zone = [factor if model.line.adhesion else math.inf for factor in self._zones.adhesion]
        self._adhesion = np.array([[factor * each for each in weight] for factor in by_zone]).reshape(-1, len(weight))

    def speed_limit(self, position: Array) -> Array:
        """Return the lowest limit over the train with vehicle 0's centre at places [m/s], shape (h,)."""
        return np.asarray(self.speeds[np.searchsorted(self.places, position, side="right")])

    def force(self, position: Array, speed: Array) -> tuple[Array, Array]:
        """Return smallest and largest force of every unit [N], each of shape (h, units).

        Parameters
        ----------
        position, speed : Array, shape (h,)
            Of vehicle 0's centre [m, m/s].
        """
        found: tuple[Array, Array] = _forces(
            position, speed, self._offsets, self._fed_at, self._zones.breaks, self._rows, self._pointers, self._adhesion
        )
        return found

    def _zone_envelopes(self, model: TrainModel) -> tuple[Array, np.ndarray[tuple[int, ...], np.dtype[np.int64]]]:
        """Return rows of envelopes, and first and end of traction and brake for every zone and unit."""
        zones, rows = self._zones, list[Row]()
        traction = [[(float(a), float(b), float(c), float(d)) for a, b, c, d in unit.rows] for unit in model.traction]
        brake = [[(float(a), float(b), float(c), float(d)) for a, b, c, d in unit.rows] for unit in model.brake]
        powers = [largest_power(unit) for unit in traction]
        whole = plain_sum(powers) or 1.0
        pointers = np.zeros((len(zones.power), model.n_units, 4), dtype=np.int64)
        for zone, power in enumerate(zones.power):
            for unit, vehicle in enumerate(model.units):
                pull, hold = traction[unit], brake[unit]
                if not model.consist.vehicles[vehicle].independent_power:
                    fed = model.consist.supplies[vehicle]
                    if zones.neutral[fed][zone]:
                        pull = []
                    elif power < whole:
                        pull = limited_segments(pull, power * powers[unit] / whole)
                    hold = [] if zones.electric_brake_off[fed][zone] else hold
                begin, middle = len(rows), len(rows) + len(pull)
                rows += [*pull, *hold]
                pointers[zone, unit] = begin, middle, middle, len(rows)
        return np.array(rows or [(0.0, 0.0, 0.0, 0.0)]), pointers


@compiled(allocates=False)
def step_value(places, values, position):
    """Return the value that holds at a position; value i before place i, the last one beyond all places."""
    step = 0
    while step < places.size and places[step] <= position:
        step += 1
    return values[step]


@compiled
def _forces(position, speed, offsets, fed_at, breaks, rows, pointers, adhesion):
    """Return smallest and largest force of the units at places and speeds [N], each of shape (h, units)."""
    low, high = np.empty((position.size, offsets.size)), np.empty((position.size, offsets.size))
    for k in range(position.size):
        size = abs(speed[k])
        for unit in range(offsets.size):
            zone, fed = 0, 0
            while zone < breaks.size and breaks[zone] <= position[k] - offsets[unit]:
                zone += 1
            while fed < breaks.size and breaks[fed] <= position[k] - fed_at[unit]:
                fed += 1
            first, end, brake_first, brake_end = pointers[fed, unit]
            grip = adhesion[zone, unit] * adhesion_by_speed(size)
            low[k, unit] = -min(envelope_force(rows, brake_first, brake_end, size), grip)
            high[k, unit] = min(envelope_force(rows, first, end, size), grip)
    return low, high
