"""Effects of line sections on the arrays of the kernel: traction, electric brake, adhesion and tunnel air by place.

The kernel reads forces, adhesion and resistance of a vehicle from arrays. When the centre of a vehicle passes the limit
of a section, its columns change before the next tick, and the power of the units that its pantograph feeds; the
compiled step is the same on every line. All changes are
factors, so that jumps of adhesion and resistance keep their effect. A line without such sections changes nothing.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant_sim import kernel as k
from plant_sim.consist import Consist
from plant_sim.formats.fields import print_assumption
from plant_sim.line import Line, LineSection, Tunnel
from plant_sim.packing import Arrays
from plant_sim.plant_setup import PlantSetup, SpeedAdhesion
from plant_sim.railway import MIN_POWER_SPEED
from plant_sim.states import Array

Row = tuple[float, float, float, float]
"""Segment of an envelope: end [m/s], constant force [N], slope [N s/m], power [W]."""
MAX_ACCELERATION, MARGIN = 5.0, 1.0
"""Bound of the acceleration of a vehicle [m/s²], and of its additional way in a shock of its couplers [m]."""
MAX_SKIPPED = 1000
"""Largest number of ticks until the places are compared again."""
MANY_TICKS = 2**31
"""Number of ticks without a limit of a section."""


def with_adhesion_of(line: Line, setup: PlantSetup) -> PlantSetup:
    """Return the setup with an adhesion, by default dry rail, if the line has sections with another one."""
    if setup.adhesion is not None or not line.adhesion:
        return setup
    return setup.model_copy(update={"adhesion": SpeedAdhesion(kind="curtius_kniffler")})


def has_tunnel_air(line: Line, consist: Consist) -> bool:
    """Return True if a train has an additional air resistance in a tunnel of a line; print missing data on stderr."""
    narrow = [entry for entry in line.tunnels if entry.cross_section is not None]
    known = any(vehicle.tunnel_resistance for vehicle in consist.vehicles)
    if narrow and not known:
        print_assumption(
            f"train '{consist.name}' has no tunnel_resistance: {len(narrow)} tunnels of line '{line.name}' add none; "
            "add it to the consist"
        )
    return bool(narrow) and known


def places_without_power(
    line: Line, consist: Consist, behind: Sequence[float] | None = None
) -> dict[int, list[tuple[float, float]]]:
    """Return begin and end of every neutral section [m] for every pantograph that feeds a power unit, by its vehicle.

    Parameters
    ----------
    behind
        Distance of every vehicle from the front [m], as of a train without length; None: that of the train.
    """
    at, vehicles, supplies = behind or consist.offsets, consist.vehicles, consist.supplies
    fed = [supplies[unit] for unit in consist.power_units if not vehicles[unit].independent_power]
    around = min((at[each] for each in fed), default=0.0), max((at[each] for each in fed), default=0.0)
    every = {supplies[unit] for unit in consist.power_units}
    return {each: [entry.without_power(at[each], *around) for entry in line.neutral_sections] for each in every}


class SectionZones:
    """Zones of a line with constant effects of its sections.

    Attributes
    ----------
    breaks : Array, shape (m,)
        Limits of the zones [m], rising; zone i is before break i, zone m beyond the last one.
    dead : dict of list of tuple
        Begin and end of every neutral section [m], by the number of the vehicle with the pantograph.
    neutral, electric_brake_off : dict of list of bool, length m + 1
        No traction, no electric brake, by the same number.
    power : list of float, length m + 1
        Largest power of the train at the wheels [W]; infinite without a limit.
    adhesion : list of float, length m + 1
        Factor on the adhesion, the smallest of overlapping sections.
    cross_section : list of float, length m + 1
        Cross section of the narrowest tunnel [m²]; infinite outside.
    """

    def __init__(self, line: Line, consist: Consist, behind: Sequence[float] | None = None) -> None:
        tunnels = [entry for entry in line.tunnels if entry.cross_section is not None]
        listed: tuple[LineSection | Tunnel, ...] = (*line.power_limits, *line.adhesion, *tunnels)
        ends = {place for entry in listed for place in (entry.begin, entry.end)}
        self.dead = dead = places_without_power(line, consist, behind)
        ends |= {place for extents in dead.values() for extent in extents for place in extent}
        self.breaks: Array = np.array(sorted(ends))
        begins = [-math.inf, *self.breaks.tolist()]

        def inside(fed: int, off: list[bool]) -> list[bool]:
            extents = [extent for extent, acts in zip(dead[fed], off, strict=True) if acts]
            return [any(begin <= at < end for begin, end in extents) for at in begins]

        every, electric = [True for _ in line.neutral_sections], [not e.electric_brake for e in line.neutral_sections]
        self.neutral = {fed: inside(fed, every) for fed in dead}
        self.electric_brake_off = {fed: inside(fed, electric) for fed in dead}

        def least(entries: Sequence[Any], key: str, default: float) -> list[float]:
            return [min((getattr(e, key) for e in entries if e.begin <= at < e.end), default=default) for at in begins]

        self.power = least(line.power_limits, "wheel_power", math.inf)
        self.adhesion = least(line.adhesion, "factor", 1.0)
        self.cross_section = least(tunnels, "cross_section", math.inf)

    def at(self, places: Array) -> NDArray[np.int64]:
        """Return the zone of every place."""
        return np.searchsorted(self.breaks, places, side="right")


class SectionEffects:
    """Effects of the sections of a line on one train.

    Parameters
    ----------
    consist, line, setup
        Data of the train.
    arrays
        Arrays of the kernel; their envelope gets the segments of every zone.
    """

    def __init__(self, consist: Consist, line: Line, setup: PlantSetup, arrays: Arrays) -> None:
        self._arrays, self._vehicles = arrays, len(consist.vehicles)
        self._zones = SectionZones(line, consist)
        has_tunnel_air(line, consist)
        self.exist = self._zones.breaks.size > 0
        """True for a line with sections."""
        if not self.exist:
            return
        self._unit_of = {vehicle: unit for unit, vehicle in enumerate(consist.power_units)}
        supplies = consist.supplies
        self._fed: dict[int, list[int]] = {}
        for unit, vehicle in enumerate(consist.power_units):
            self._fed.setdefault(supplies[vehicle], []).append(unit)
        self._resistance = _tunnel_factors(consist, setup, self._zones.cross_section)
        self._pointers = self._zone_envelopes(consist)
        self._zone: NDArray[np.int64] = np.full(self._vehicles, -1, dtype=np.int64)
        self._next = 0
        self._update()

    def apply(self, stamp: int, tick_ns: int) -> None:
        """Change the columns of the vehicles that have passed a limit, before the tick from ``stamp`` [ns] on."""
        if stamp < self._next:
            return
        self._update()
        self._next = stamp + tick_ns * min(self.ticks_before_next(tick_ns * 1e-9), MAX_SKIPPED)

    def _update(self) -> None:
        zone = self._zones.at(self._arrays.state[k.X, : self._vehicles])
        for vehicle in np.flatnonzero(zone != self._zone).tolist():
            self._enter(vehicle, int(self._zone[vehicle]), int(zone[vehicle]))
        self._zone = zone

    def ticks_before_next(self, tick: float) -> int:
        """Return the number of ticks in which no vehicle can pass the limit of a section; ``tick`` in s."""
        position, speed = self._arrays.state[[k.X, k.V], : self._vehicles]
        around = np.concatenate(([-np.inf], self._zones.breaks, [np.inf]))
        behind, ahead = around[self._zone], around[self._zone + 1]
        distance = np.maximum(np.minimum(position - behind, ahead - position) - MARGIN, 0.0)
        speed = np.abs(speed)
        time = (np.sqrt(speed**2 + 2.0 * MAX_ACCELERATION * distance) - speed) / MAX_ACCELERATION
        shortest = float(time.min()) / tick
        return int(shortest) if shortest < MANY_TICKS else MANY_TICKS

    def _enter(self, vehicle: int, before: int, zone: int) -> None:
        """Change the columns of a vehicle from one zone, -1 for the open line, to another."""
        a, zones = self._arrays, self._zones
        factor = zones.adhesion[zone] / (zones.adhesion[before] if before >= 0 else 1.0)
        a.vehicle[k.C2, vehicle] *= self._resistance[zone][vehicle] / (
            self._resistance[before][vehicle] if before >= 0 else 1.0
        )
        a.vehicle[k.RAIL, vehicle] *= factor
        unit = self._unit_of.get(vehicle)
        if unit is not None:
            a.unit[k.ADHESION, unit] *= factor
        for fed in self._fed.get(vehicle, ()):
            a.unit_index[k.TRACTION_FIRST : k.ELECTRIC_END + 1, fed] = self._pointers[zone][fed]

    def _zone_envelopes(self, consist: Consist) -> list[list[tuple[int, ...]]]:
        """Append the envelopes of all zones; return the pointers of every unit in every zone."""
        a = self._arrays
        rows: list[Row] = [(float(r[0]), float(r[1]), float(r[2]), float(r[3])) for r in a.envelope]
        open_line = [
            tuple(int(value) for value in a.unit_index[k.TRACTION_FIRST : k.ELECTRIC_END + 1, unit])
            for unit in range(a.unit.shape[1])
        ]
        powers = [largest_power(rows[first:end]) for first, end, *_ in open_line]
        whole = math.fsum(powers) or 1.0
        found: list[list[tuple[int, ...]]] = []
        for zone, power in enumerate(self._zones.power):
            pointers: list[tuple[int, ...]] = []
            for unit, vehicle in enumerate(consist.power_units):
                first, end, brake_first, brake_end, electric_first, electric_end = open_line[unit]
                fed = consist.supplies[vehicle]
                if not consist.vehicles[vehicle].independent_power:
                    if self._zones.neutral[fed][zone]:
                        end = first
                    elif power < whole:
                        limited = limited_segments(rows[first:end], power * powers[unit] / whole)
                        first, end = len(rows), len(rows) + len(limited)
                        rows += limited
                    if self._zones.electric_brake_off[fed][zone]:
                        friction = friction_segments(rows[brake_first:brake_end], rows[electric_first:electric_end])
                        brake_first, brake_end = len(rows), len(rows) + len(friction)
                        rows += friction
                        if friction:
                            electric_first, electric_end = len(rows), len(rows) + 1
                            rows.append((math.inf, 0.0, 0.0, 0.0))
                pointers.append((first, end, brake_first, brake_end, electric_first, electric_end))
            found.append(pointers)
        a.envelope = np.array(rows)
        return found


def _tunnel_factors(consist: Consist, setup: PlantSetup, sections: Sequence[float]) -> list[list[float]]:
    """Return the factor on the quadratic resistance of every vehicle in every zone.

    Raises
    ------
    ValueError
        For a vehicle with a tunnel resistance and without a quadratic running resistance.
    """
    found = []
    for section in sections:
        factors = []
        for vehicle in consist.vehicles:
            added = 0.0 if math.isinf(section) else vehicle.tunnel_coefficient(section)
            own = vehicle.resistance.polynomial(vehicle.mass * setup.mismatch.mass_scale, consist.gravity)[2]
            if added > 0 and own <= 0:
                raise ValueError(
                    "tunnel_resistance: the vehicle has no quadratic running resistance; add its coefficient"
                )
            factors.append(1.0 + added / own if added > 0 else 1.0)
        found.append(factors)
    return found


def _force(row: Row, speed: float) -> float:
    return row[1] + row[2] * speed + row[3] / max(speed, MIN_POWER_SPEED)


def largest_power(rows: Sequence[Row]) -> float:
    """Return the largest power of an envelope [W], at the ends and at the vertex of every segment."""
    largest, begin = 0.0, 0.0
    for row in rows:
        speeds = [begin, row[0]]
        if row[2] < 0:
            speeds.append(min(max(-row[1] / (2 * row[2]), begin), row[0]))
        largest = max(largest, *(_force(row, speed) * speed for speed in speeds))
        begin = row[0]
    return largest


def limited_segments(rows: Sequence[Row], power: float) -> list[Row]:
    """Return the segments of an envelope limited to a power [W].

    The limits of a segment with force f0 + f1 v + p / v are at f1 v² + f0 v + p = power.
    """
    found: list[Row] = []
    begin = 0.0
    for row in rows:
        end, constant, slope, part = row
        inside = [root for root in _roots(slope, constant, part - power) if begin < root < end]
        for stop in (*sorted(inside), end):
            middle = 0.5 * (begin + stop)
            exceeds = _force(row, middle) * max(middle, MIN_POWER_SPEED) > power
            found.append((stop, 0.0, 0.0, power) if exceeds else (stop, constant, slope, part))
            begin = stop
    return found


def friction_segments(whole: Sequence[Row], electric: Sequence[Row]) -> list[Row]:
    """Return the segments of a brake without its electric part, at most their difference; none without such a part."""
    found: list[Row] = []
    begin = 0.0
    for end in sorted({row[0] for row in (*whole, *electric) if row[0] <= whole[-1][0]}) if electric else ():
        _, constant, slope, power = next(row for row in whole if row[0] >= end)
        _, less, less_slope, less_power = next((row for row in electric if row[0] >= end), (end, 0.0, 0.0, 0.0))
        lack = min(power - less_power, 0.0) / max(begin, MIN_POWER_SPEED)
        found.append((end, constant - less + lack, slope - less_slope, max(power - less_power, 0.0)))
        begin = end
    return found


def _roots(a: float, b: float, c: float) -> list[float]:
    """Return the real roots of a x² + b x + c."""
    if a == 0.0:
        return [-c / b] if b != 0.0 else []
    square = b * b - 4.0 * a * c
    if square < 0.0:
        return []
    half = -0.5 * (b + math.copysign(math.sqrt(square), b))
    return [half / a, *([c / half] if half != 0.0 else [])]
