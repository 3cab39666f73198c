"""Line force and speed limits of a whole train, tabulated over the place of its front.

Limits by place on the forces of a plan: neutral sections, power limits, adhesion, and tunnel air.

The passes of the planner keep a reserve of traction and a reserve of the brakes. A reserve is a fraction of the whole
force, by cell and speed. The adhesion of a rail takes most of the force at the corner of the envelope, and less below
and above.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plant_sim.compiled import compiled
from plant_sim.consist import Consist, VehicleType
from plant_sim.line import Line, LineSection
from plant_sim.packing import NO_LIMIT, Integers
from plant_sim.railway import MIN_POWER_SPEED, adhesion_by_speed
from plant_sim.section_effects import SectionZones, has_tunnel_air
from plant_sim.track import Track
from plant_sim.traction import Envelope
from train_ato.messages.types import Array
from train_ato.profile.planner.passes import sliding_extreme
from train_ato.profile.planner.train_tables import TrainTables, envelope_table

MIN_CELL, MAX_CELL, CELLS = 0.05, 5.0, 8000
"""Bounds of the cell length in the middle of a section [m], and the number of cells between these bounds."""
END_CELL, CELL_GROWTH = 0.002, 1.15
"""Cell length at both ends of a section, where speeds are low [m], and growth factor from cell to cell."""
MIN_STEP = 5e-3
"""Change of the line force over the inertia from which a cell ends there in a plan with a timetable [m/s²]."""
MIN_STEP_CELL = 1e-3
"""Least length of a cell beside such a step [m]."""


class PlaceGrid:
    """Grid of places of the front on one section, dense at both ends.

    Parameters
    ----------
    begin, end
        First and last place of the grid [m].
    borders : Array, optional
        Places of the front that are borders of cells too [m].

    Attributes
    ----------
    places : Array, shape (cells + 1,)
        Increasing places [m].
    steps : Array, shape (cells,)
        Distance between them [m].
    """

    def __init__(self, begin: float, end: float, borders: Array | None = None) -> None:
        length = end - begin
        coarse = float(np.clip(length / CELLS, MIN_CELL, MAX_CELL))
        count = int(np.log(coarse / END_CELL) / np.log(CELL_GROWTH))
        ramp = np.cumsum(END_CELL * CELL_GROWTH ** np.arange(count))
        ramp = np.concatenate(([0.0], ramp[ramp < 0.3 * length]))
        middle = length - 2 * ramp[-1]
        inner = ramp[-1] + np.linspace(0.0, middle, max(10, int(np.ceil(middle / coarse))) + 1)[1:-1]
        self.begin, self.end = begin, end
        self.places: Array = begin + np.concatenate((ramp, inner, length - ramp[::-1]))
        self.places[-1] = end
        if borders is not None:
            inside = borders[(borders > self.places[1]) & (borders < self.places[-2])]
            near = np.searchsorted(inside, self.places - MIN_STEP_CELL) < np.searchsorted(
                inside, self.places + MIN_STEP_CELL
            )
            self.places = np.union1d(self.places[~near], inside[np.diff(inside, prepend=begin) > MIN_STEP_CELL])
        self.steps: Array = np.diff(self.places)
        self.cells = self.steps.size


class LineForce:
    """Grade, curve and tunnel force on a whole train, every vehicle at its own position.

    Parameters
    ----------
    line, train
        Line and train.
    over_length
        Average over the length of each vehicle instead of the value at its centre.
    """

    def __init__(self, line: Line, train: TrainTables, *, over_length: bool = False) -> None:
        self._train = train
        track = Track(line)
        lengths = train.lengths.tolist()
        pieces = {length: track.over_length(length) if over_length else track.at_points() for length in set(lengths)}
        rows = zip(lengths, train.behind, train.masses * train.gravity, strict=True)
        self._vehicles = [(pieces[length], behind, weight) for length, behind, weight in rows]

    def at(self, front: Array, back: float = 0.0) -> Array:
        """Return the force at increasing places of the front [N], > 0 against the motion; beyond a step of it.

        With ``back`` it is that of a train moved back by a distance [m].
        """
        total = np.zeros(front.size)
        for vehicle in self._vehicles:
            _add_force(total, front, *vehicle, back)
        return total

    def work(self, front: Array) -> Array:
        """Return the work from the first of increasing places of the front to each of them [J]."""
        total = np.zeros(front.size)
        for vehicle in self._vehicles:
            _add_work(total, front, *vehicle)
        return total

    def steps(self) -> Array:
        """Return the rising places of the front just beyond the steps of the force [m].

        The table has the mean force of a cell for a train that coasts over a step inside the cell. Otherwise the plan
        would pull in one part of the cell and brake in the other.
        """
        found = [np.zeros(0)]
        for pieces, behind, weight in self._vehicles:
            first, end, grade, slope, curve = pieces[:5]
            before = grade + slope * (end - first) + curve
            change = np.abs(grade[1:] + slope[1:] * (end[:-1] - first[1:]) + curve[1:] - before[:-1])
            far = weight * change > MIN_STEP * self._train.inertia
            found.append(end[:-1][far] + behind + 5e-10)  # half of the distance of the places before and beyond it
        return np.unique(np.concatenate(found))

    def over_cells(self, grid: PlaceGrid) -> tuple[Array, Array, Array]:
        """Return minimum, mean and maximum force over every cell [N], shape (cells,) each."""
        mean = np.diff(self.work(grid.places)) / grid.steps
        ends = np.stack((self.at(grid.places)[:-1], self.at(grid.places, 1e-9)[1:], mean))
        return ends.min(axis=0), mean, ends.max(axis=0)


@compiled
def _add_force(total: Array, front: Array, pieces: Array, behind: float, weight: float, back: float) -> None:
    piece = 0
    for k in range(front.size):
        x = front[k] - behind - back
        while piece + 1 < pieces.shape[1] and pieces[1, piece] <= x:
            piece += 1
        total[k] += weight * (pieces[2, piece] + pieces[3, piece] * (x - pieces[0, piece]) + pieces[4, piece])


@compiled
def _add_work(total: Array, front: Array, pieces: Array, behind: float, weight: float) -> None:
    """Add the work of one vehicle from the first place on [J]."""
    piece, work = 0, 0.0
    x0 = front[0] - behind
    while piece + 1 < pieces.shape[1] and pieces[1, piece] <= x0:
        piece += 1
    for k in range(1, front.size):
        x1 = front[k] - behind
        while True:
            stop = min(x1, pieces[1, piece])
            middle = 0.5 * (x0 + stop) - pieces[0, piece]
            work += (stop - x0) * (pieces[2, piece] + pieces[3, piece] * middle + pieces[4, piece])
            x0 = stop
            if stop >= x1:
                break
            piece += 1
        total[k] += weight * work


class SpeedLimits:
    """Speed limits of the line, each valid for every part of the train.

    Attributes
    ----------
    begin, end, speed : Array
        m, m, m/s; the last limit ends at infinity.
    """

    def __init__(self, line: Line, speed_max: float) -> None:
        places = [limit.at for limit in line.restricted_limits]
        speeds = [min(limit.speed, speed_max) for limit in line.restricted_limits]
        self.begin: Array = np.array([-np.inf, *places])
        self.end: Array = np.array([*places, np.inf])
        self.speed: Array = np.array([speed_max, *speeds])

    def over_grid(self, grid: PlaceGrid, length: float, extension: float = 0.0, acceleration: float = 0.0) -> Array:
        """Return the limit of the whole train at every place of the grid [m/s], shape (cells + 1,).

        A limit is applied to the nearest grid places outside its range, so that it also holds between grid places.

        Parameters
        ----------
        length
            Of the train [m].
        extension
            Time by which a limit starts earlier and ends later [s].
        acceleration
            Maximum acceleration or deceleration in that time [m/s²].
        """
        limit = np.full(grid.cells + 1, np.inf)
        for begin, end, speed in zip(self.begin, self.end, self.speed, strict=True):
            distance = extension * (speed + extension * acceleration)
            first = max(0, int(np.searchsorted(grid.places, begin - distance + 1e-9, side="right")) - 1)
            last = int(np.searchsorted(grid.places, end + length + distance - 1e-9, side="left"))
            if begin - distance >= grid.end or end + length + distance <= grid.begin:
                continue
            limit[first : last + 1] = np.minimum(limit[first : last + 1], speed)
        return limit

    def at(self, front: Array, length: float) -> Array:
        """Return the limit of the whole train at places of its front [m/s]."""
        edges = np.unique(np.concatenate((self.begin[1:], self.end[:-1] + length)))
        inside = np.concatenate((edges[:1] - 1.0, edges)) if edges.size else np.zeros(1)
        first = np.searchsorted(self.end + length, inside, side="right")
        last = np.searchsorted(self.begin, inside, side="right")
        lowest = np.array([self.speed[a:b].min() for a, b in zip(first, last, strict=True)])
        return np.asarray(lowest[np.searchsorted(edges, front, side="right")])

    def highest(self, places: Array, length: float) -> Array:
        """Return the largest limit of the whole train between the neighbours of every grid place [m/s]."""
        at = np.unique(np.concatenate((places, self.begin[1:], self.end[:-1] + length)))
        at = at[(at >= places[0]) & (at <= places[-1])]
        limit = np.maximum(*[self.at(at + side, length) for side in (-1e-6, 1e-6)])
        cell: Array = np.maximum.reduceat(limit, np.searchsorted(at, places))
        return np.asarray(np.maximum(cell, np.concatenate((cell[:1], cell[:-1]))))


Zones = tuple[int, ...]
"""Zone of every vehicle."""
STEP_RESERVE = 0.01
"""Difference of the reserves by part and by force from which an envelope has a step there."""


class PlaceLimits:
    """Reserved fractions of traction and brakes of a train, by the place of its front."""

    def __init__(self, line: Line, consist: Consist, train: TrainTables) -> None:
        self._zones, self._line = SectionZones(line, consist, train.behind.tolist()), line
        self._train, self._consist = train, consist
        self._vehicles, self._supplies = consist.vehicles, consist.supplies
        self._has_adhesion = bool(line.adhesion)
        self._reserves: dict[Zones, Array] = {}
        pulls = [Envelope(vehicle.traction).forces(train.speed) for vehicle in self._vehicles]
        self._powers = [float((pull * train.speed).max()) for pull in pulls]

    @property
    def breaks(self) -> Array:
        """Limits of the zones [m], rising."""
        return self._zones.breaks

    def sections_at(self, front: float, *, brakes: bool) -> list[str]:
        """Return the sections that limit the traction, or the brakes, of the train at a place of its front [m]."""
        line, places = self._line, front - self._train.behind
        units = np.array([bool(v.brake if brakes else v.traction) and not v.independent_power for v in self._vehicles])
        supplies = np.array(self._supplies)[units].tolist()
        fed = places[supplies]
        dead = np.array([self._zones.dead[vehicle] for vehicle in supplies])
        acting: list[tuple[str, LineSection, NDArray[np.bool_]]] = [
            ("neutral section", entry, (fed >= dead[:, number, 0]) & (fed < dead[:, number, 1]))
            for number, entry in enumerate(line.neutral_sections if supplies else ())
            if not (brakes and entry.electric_brake)
        ]
        listed: list[tuple[str, Sequence[LineSection], Array]] = [
            ("section with low adhesion", [entry for entry in line.adhesion if entry.factor < 1.0], places),
            ("power limit", () if brakes else line.power_limits, fed),
        ]
        acting += [
            (kind, entry, (at >= entry.begin) & (at < entry.end)) for kind, entries, at in listed for entry in entries
        ]
        return [
            f"{kind} from km {entry.begin / 1000:.3f} to km {entry.end / 1000:.3f}"
            for kind, entry, acts in acting
            if acts.any()
        ]

    def without_power(self, front: Array, time: Array) -> list[dict[str, float | str]]:
        """Return places [m] of the neutral sections of a plan, and the times [s] without power in a unit.

        A section with a board that announces it has the time at which the front passes the board, one that all units
        pass without power has its phase.

        Parameters
        ----------
        front, time
            Rising places of the front [m] and times [s] of the knots.
        """
        units = [fed for v, fed in zip(self._vehicles, self._supplies, strict=True)
                 if (v.traction or v.brake) and not v.independent_power]  # fmt: skip
        behind = self._train.behind[units]
        found = []
        for entry in sorted(self._line.neutral_sections if units else (), key=lambda entry: entry.begin):
            first, last = entry.begin - entry.off_before + behind.min(), entry.end + entry.on_after + behind.max()
            if first >= front[-1] or last <= front[0]:
                continue
            board = entry.begin - (entry.announced_before or 0.0)
            announced, off, on = (round(float(at), 3) for at in np.interp((board, first, last), front, time))
            row: dict[str, float | str] = {"place_m": round(entry.begin, 3)}
            row |= {"post": self._line.post_at(entry.begin)} if self._line.chainage else {}
            row |= {} if entry.announced_before is None else {"announced_s": announced}
            row |= {"off_s": off, "on_s": on}
            found.append(row | ({"phase": "coasting"} if entry.coasting else {}))
        return found

    def zones_at(self, places: Array) -> NDArray[np.int64]:
        """Return the zone of vehicles with their centres at places [m]."""
        return self._zones.at(places)

    def _zones_along(self, front: Array) -> tuple[list[Zones], Integers]:
        """Return the zones of the vehicles after every change along places of the front, and the row of each place."""
        zones = self.zones_at(front[:, None] - self._train.behind)
        changes = np.append(True, (zones[1:] != zones[:-1]).any(axis=1))
        return [tuple(zone) for zone in zones[changes].tolist()], np.cumsum(changes) - 1

    def over_cells(self, grid: PlaceGrid, width: Array, range_: Array, forces: Array) -> tuple[Array, Integers]:
        """Return reserves of traction and brakes over the speed, and the row of every cell: (rows, 2, n) and (cells,).

        The mean over a range of speeds keeps a limit in two cases: each of its forces has the largest reserve of the
        range, or none is above the least force left in the range. The second case leaves more force where an envelope
        rises in a step. A reserve of the upper side would take the force of the lower side.

        Parameters
        ----------
        width : Array, shape (cells,)
            Distance before and after a cell over which its forces are averaged [m].
        range_ : Array, shape (2, n)
            Half of the range of speeds over which traction and brakes are averaged, at every speed [m/s].
        forces : Array, shape (2, n)
            Traction and brake force that the reserves reduce [N].
        """
        places = grid.places
        ends = np.stack((places[:-1], np.nextafter(places[1:], -np.inf)), axis=1).ravel()
        zones, which = self._zones_along(ends)
        kinds = [self._reserve(zone) for zone in zones]
        numbers = {kind.tobytes(): k for k, kind in enumerate(kinds)}  # most zones have equal reserves
        at = np.array([numbers[kind.tobytes()] for kind in kinds])[which]
        change = np.diff(at, prepend=-1) != 0
        run, of_run = np.cumsum(change) - 1, at[change]
        first = np.maximum(np.searchsorted(places, places[:-1] - width, side="right") - 1, 0)
        last = np.minimum(np.searchsorted(places, places[1:] + width, side="left"), grid.cells)
        pairs, pair = np.unique(run[2 * first] * run.size + run[2 * last - 1], return_inverse=True)
        spans = (divmod(both, run.size) for both in pairs.tolist())
        inside = [tuple(np.unique(of_run[a : b + 1]).tolist()) for a, b in spans]
        rows = {mixed: row for row, mixed in enumerate(dict.fromkeys(inside))}
        found = np.stack([np.max([kinds[k] for k in mixed], axis=0) for mixed in rows])
        if range_.any():
            found = np.stack([[self._averaged(row, k, range_[k], forces[k]) for k in (0, 1)] for row in found])
        return found, np.array([rows[mixed] for mixed in inside])[pair.ravel()]

    def _averaged(self, reserves: Array, side: int, range_: Array, force: Array) -> Array:
        """Return the reserve of traction or brakes that also holds for a mean over a range of speeds, shape (n,)."""
        edges = self._train.speed[1] * np.arange(force.size + 1)
        by_part = sliding_extreme(reserves[side], range_, edges, True)
        left = (self._train.traction, self._train.brake)[side] * (1.0 - reserves[side])
        least = sliding_extreme(left, range_, edges, False)
        by_force = 1.0 - np.minimum(least / np.maximum(force, 1e-9), 1.0)
        return np.asarray(np.where(by_force < by_part - STEP_RESERVE, by_force, by_part))

    def largest_air(self, grid: PlaceGrid) -> Array:
        """Return the largest tunnel air over v² and inertia in every cell [1/m], shape (cells,)."""
        ends = [self.tunnel_coefficient(places) for places in (grid.places[:-1], grid.places[1:])]
        return np.asarray(np.maximum(*ends) / self._train.inertia)

    def least_air(self, grid: PlaceGrid) -> Array:
        """Return the least tunnel air over v² and inertia in every cell [1/m], shape (cells,)."""
        ends = [self.tunnel_coefficient(places) for places in (grid.places, np.nextafter(grid.places, -np.inf))]
        return np.asarray(np.minimum(ends[0][:-1], ends[1][1:]) / self._train.inertia)

    def tunnel_coefficient(self, front: Array) -> Array:
        """Return the additional air resistance over v² of the train at places of its front [N s²/m²]."""
        total = np.zeros(front.size)
        for vehicle, behind in zip(self._vehicles, self._train.behind, strict=True):
            if vehicle.tunnel_resistance:
                by_zone = [
                    0.0 if math.isinf(section) else vehicle.tunnel_coefficient(section)
                    for section in self._zones.cross_section
                ]
                total += np.array(by_zone)[self._zones.at(front - behind)]
        return total

    def electric_share(self, front: Array, speed: Array) -> Array:
        """Return the share of the electric brake that acts at places of the front [m] and speeds [m/s]."""
        zones, which = self._zones_along(front)
        whole = np.maximum(self._train.electric, 1e-9)
        shares = np.stack([self.available(zone)[1] / whole for zone in zones])
        column = np.minimum(speed / self._train.speed[1], whole.size - 1)
        low = np.minimum(column.astype(int), whole.size - 2)
        first, last = (shares[which, low + k] for k in (0, 1))
        return np.asarray(np.minimum(first + (column - low) * (last - first), 1.0))

    def _reserve(self, zones: Zones) -> Array:
        """Return the reserves of traction and brakes over the speed, shape (2, n)."""
        if zones not in self._reserves:
            traction, electric, air = self.available(zones)
            train = self._train
            have = np.stack((train.traction, train.brake))
            left = np.minimum(np.stack((traction, electric + air)), have)
            reserve = np.where(have > 0.0, 1.0 - left / np.maximum(have, 1e-9), 0.0)
            self._reserves[zones] = np.maximum(reserve, 0.0)
        return self._reserves[zones]

    def available(self, zones: Zones, *, equal_parts: bool = False) -> tuple[Array, Array, Array]:
        """Return traction, electric and air brake force of the train over the speed with its vehicles in zones [N].

        Each unit is limited in its own zone; the force of the train is the sum, as in the plant.  With equal parts
        all units use the same part of their envelopes, and the most limited unit limits the train.
        """
        speed, whole = self._train.speed, math.fsum(self._powers) or 1.0
        forces, left = np.zeros((2, speed.size)), np.zeros((2, speed.size))
        least_part = np.ones((2, speed.size))
        grip = np.zeros(speed.size)
        for vehicle, zone, supply, own in zip(self._vehicles, zones, self._supplies, self._powers, strict=True):
            if vehicle.traction or vehicle.brake:
                both = np.stack(_forces(vehicle, self._train))
                adhesion = self._adhesion(zone, vehicle.adhesive_mass or vehicle.mass, speed)
                most, least = adhesion, adhesion
                if not vehicle.independent_power:
                    fed = zones[supply]
                    power = self._zones.power[fed] * own / whole
                    most = np.minimum(most, power / np.maximum(speed, MIN_POWER_SPEED))
                    most = most * (not self._zones.neutral[supply][fed])
                    least = least * (not self._zones.electric_brake_off[supply][fed])
                limited = np.minimum(both, np.stack((most, least)))
                forces, left = forces + both, left + limited
                least_part = np.minimum(least_part, np.where(both > 0.0, limited / np.maximum(both, 1e-9), 1.0))
            grip = grip + self._adhesion(zone, vehicle.mass, speed)
        parts = np.where(forces > 0.0, left / np.maximum(forces, 1e-9), 1.0)
        parts = least_part if equal_parts else parts
        traction, electric = parts * np.stack((self._train.traction, self._train.electric))
        air = self._train.brake - self._train.electric
        return traction, electric, np.minimum(air, np.maximum(grip - electric, 0.0))

    def _adhesion(self, zone: int, mass: float, speed: Array) -> Array:
        """Return the largest force between wheel and rail [N] for a mass on the axles [kg]."""
        if not self._has_adhesion:
            return np.full(speed.size, NO_LIMIT)
        return np.asarray(self._zones.adhesion[zone] * adhesion_by_speed(speed) * mass * self._consist.gravity)


def _forces(vehicle: VehicleType, train: TrainTables) -> list[Array]:
    """Return traction and electric brake of a vehicle over the speed [N], with the steps of the table of the train."""
    envelopes = [Envelope(vehicle.traction), Envelope(vehicle.electric_brake or vehicle.brake)]
    return [
        envelope_table(e, train.speed, train.speed_max) if e.rows.size else np.zeros(train.speed.size)
        for e in envelopes
    ]


def place_limits(line: Line, consist: Consist, train: TrainTables) -> PlaceLimits | None:
    """Return the limits by place of a train on a line; None for a line without."""
    has_tunnels = has_tunnel_air(line, consist)
    limited = line.neutral_sections or line.power_limits or line.adhesion or has_tunnels
    return PlaceLimits(line, consist, train) if limited else None
