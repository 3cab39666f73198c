"""Plausibility checks of a recorded speed and force history; errors name the line."""

from dataclasses import dataclass, field

import numpy as np

from plant_sim.chainage import places_along
from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.units import number_text
from train_ato.api.import_csv.columns import MAX_GAP, QUANTITIES, Column
from train_ato.api.import_csv.samples import ColumnSamples, Rows
from train_ato.api.import_csv.table import CsvTable, FileFaults
from train_ato.messages.types import Array

STANDSTILL_NOISE = 0.5 / 3.6
"""Magnitude of the speed noise at standstill [m/s]."""
MAX_SPEED, FASTER = 200.0, "faster than any train"
"""Maximum speed; larger ones have a wrong unit [m/s]."""
JUMP, JUMP_RATE = 1.5, 5.0
"""A change of speed between rows above both limits, [m/s] and [m/s²], is an error of the recorder."""
BOUNDS = {
    "speed": (-STANDSTILL_NOISE, "forward speed is > 0; remove the rows of backward motion", MAX_SPEED, FASTER),
    "reference_speed": (0.0, "forward speed is > 0, correct the row", MAX_SPEED, FASTER),
    "brake_pipe_pressure": (0.0, "give the absolute pressure", 1.5e6, "above the pressure of any brake pipe"),
}
"""Lowest value, remedy below it, highest value, and problem above it, by quantity."""
POSITION_NOISE = 5.0
"""Minimum tolerance of decreasing positions [m]; larger for a coarser resolution."""
DISTANCE_SHARE, DISTANCE_LEAST = 0.2, 200.0
"""Tolerance between positions and integral of the speed: fraction, and minimum length [m]."""

LEAP, LEAP_SHARE, LEAP_WAY = 50.0, 0.25, 200.0
"""Tolerance between positions and integral of the speed over ``LEAP_WAY`` [m]: length [m], and fraction of the way."""
STEP, STEP_SHARE, RUN_SHARE = 5.0, 0.25, 0.03
"""Difference between them that is noted: from row to row [m] and as a fraction, and as a fraction of the run."""
NEAR, STANDSTILL, OVERSPEED = 200.0, 10.0, 1.25
"""Tolerance of a place [m], shortest halt [s], and speed over the limit of the line that is noted."""
BESIDE, ALIKE = 15.0, 5.0
"""Distance from its stop that every halt has, and difference between these distances, that are noted [m]."""


@dataclass
class Measured:
    """Checked data of a recorder; times from the first row on [s].

    Attributes
    ----------
    table
        The file.
    end
        Time of the last row.
    interval, largest_gap
        Median and largest time between rows [s].
    speed, position, reference_speed, pressure : ColumnSamples or None
        Quantities of the train; the position is that of vehicle 0.
    force, command : dict of ColumnSamples
        By power unit; None: sum of all.
    unit_speed, unit_position : dict of ColumnSamples
        By power unit.
    notes : list of str
        Corrections, one line each.
    """

    table: CsvTable
    end: float
    interval: float
    largest_gap: float
    speed: ColumnSamples
    position: ColumnSamples | None = None
    reference_speed: ColumnSamples | None = None
    pressure: ColumnSamples | None = None
    force: dict[int | None, ColumnSamples] = field(default_factory=dict)
    command: dict[int | None, ColumnSamples] = field(default_factory=dict)
    unit_speed: dict[int, ColumnSamples] = field(default_factory=dict)
    unit_position: dict[int, ColumnSamples] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def place_notes(found: Measured, places: Array, line: Line, length: float) -> list[str]:
    """Return notes on places or speeds that do not fit to a line.

    Without places of its own, a speed in another unit moves the train along the line without a contradiction.

    Parameters
    ----------
    places
        Front of the train at every sample of the speed [m].
    length
        Length of the train [m].
    """
    notes, speed = [], found.speed.values
    remedy = f"check the unit of '{found.speed.column.title}', the places and the line"
    if line.speed_limits:
        starts = np.array([entry.at for entry in line.speed_limits])
        limits = np.array([np.inf, *(entry.speed for entry in line.speed_limits)])
        most = np.maximum(*(limits[np.searchsorted(starts, places + way, side="right")] for way in (-NEAR, NEAR)))
        row = int(np.argmax(speed / most))
        if speed[row] > OVERSPEED * most[row]:
            notes.append(
                f"{3.6 * speed[row]:.1f} km/h at km {line.post_at(places[row])}, where line '{line.name}' "
                f"permits {number_text(3.6 * most[row])}; {remedy}"
            )
    standing = np.concatenate(([False], speed < STANDSTILL_NOISE, [False]))
    begins, ends = (np.flatnonzero(edge) for edge in (standing[1:] & ~standing[:-1], standing[:-1] & ~standing[1:]))
    lasting = (found.speed.time[ends - 1] - found.speed.time[begins] >= STANDSTILL) | (begins == 0)
    stands = places[begins[lasting]]
    if found.position is None and not (found.force or line.speed_limits or (line.stops and stands.size > 1)):
        notes.append(
            f"nothing confirms the unit of '{found.speed.column.title}' ({number_text(np.ptp(places) / 1e3, 3)} km at "
            f"up to {number_text(3.6 * speed.max(), 3)} km/h): no places, no force, and no limits or stops of the line"
        )
    if line.stops and stands.size > 1:
        ahead = stands[:, None] - [entry.at for entry in line.stops]
        nearest = np.abs(ahead).argmin(axis=1)
        offsets = ahead[np.arange(stands.size), nearest]
        beside = np.abs(offsets)
        regular = beside <= BESIDE
        odd = ~regular & ~np.isin(nearest, nearest[regular]) & (np.count_nonzero(regular) > stands.size / 2)
        if np.count_nonzero(beside > max(NEAR, length)) >= stands.size / 2:
            worst = int(np.argmax(beside))
            notes.append(
                f"the train stands at km {line.post_at(stands[worst])}, {beside[worst]:.0f} m beside the "
                f"nearest stop of line '{line.name}'; {remedy}"
            )
        elif beside.min() > BESIDE and np.ptp(offsets) <= ALIKE:
            notes.append(
                f"the train stands {beside[0]:.0f} m {'beyond' if offsets[0] > 0 else 'before'} the stop of line "
                f"'{line.name}' at all {stands.size} halts; check the zero of the places, and front or centre"
            )
        elif odd.any():
            worst = int(np.argmax(np.where(odd, beside, 0.0)))
            notes.append(
                f"the train stands at km {line.post_at(stands[worst])}, {beside[worst]:.0f} m "
                f"{'beyond' if offsets[worst] > 0 else 'before'} its stop at km "
                f"{line.post_at(line.stops[nearest[worst]].at)}, unlike at the other halts; check the places there"
            )
    return notes


def way_of(speed: ColumnSamples) -> Array:
    """Return the integral of the speed up to every sample [m], shape (k,)."""
    steps = np.diff(speed.time) * (speed.values[1:] + speed.values[:-1]) / 2
    return np.concatenate(([0.0], np.cumsum(steps)))


class MeasuredCheck:
    """Checks of one file.

    Parameters
    ----------
    table
        The file.
    consist
        The train.
    line, against
        Line of the measurement; against its direction, falling positions are mirrored. Positions that fall, or lie
        off the line, are kilometres of its posts if it has a chainage.
    largest_gap
        Maximum time between rows [s].
    """

    def __init__(
        self, table: CsvTable, consist: Consist, line: Line, *, against: bool = False, largest_gap: float = MAX_GAP
    ) -> None:
        self._table, self._consist, self._line, self._against = table, consist, line, against
        self._units = len(consist.power_units)
        self._rows = Rows(table, largest_gap)
        self._faults = FileFaults(table.path)

    def run(self) -> Measured:
        """Return the checked data; raise all faults together."""
        attempt = self._faults.attempt
        for column in self._table.columns.values():
            attempt(self._check_unit, column)
        speeds = {column.unit: attempt(self._speed, column) for column in self._columns("speed")}
        if None not in speeds and 0 not in speeds:
            self._faults.add("no speed column; name one speed_kmh or speed_m_s")
        speed = speeds.get(None) or speeds.get(0)
        reference, pressure = attempt(self._found, "reference_speed"), attempt(self._found, "brake_pipe_pressure")
        force, command = attempt(self._forces), attempt(self._by_unit, "command_force")
        unit_position = attempt(self._unit_positions)
        if speed is None:
            self._faults.refuse()
        assert speed is not None
        position = attempt(self._position, speed, unit_position or {})
        self._faults.refuse()
        steps = np.diff(self._rows.time)
        return Measured(
            table=self._table,
            end=float(self._rows.time[-1]),
            interval=float(np.median(steps)),
            largest_gap=float(steps.max()),
            speed=speed,
            unit_speed={unit: samples for unit, samples in speeds.items() if unit is not None and samples is not None},
            reference_speed=reference,
            pressure=pressure,
            force=force or {},
            command=command or {},
            notes=self._rows.notes,
            unit_position=unit_position or {},
            position=position,
        )

    def _columns(self, quantity: str) -> list[Column]:
        return [column for column in self._table.columns.values() if column.quantity == quantity]

    def _check_unit(self, column: Column) -> None:
        """Check the number of the power unit of a column."""
        if column.unit is not None and column.unit >= self._units:
            raise ValueError(
                f"column '{column.title}': the train has {self._units} power units, counted from 0 at the front; "
                "choose another --train or --ignore the column"
            )

    def _speed(self, column: Column) -> ColumnSamples:
        samples = self._bounded(self._rows.samples(column))
        speed = samples.values
        if speed.max() < STANDSTILL_NOISE:
            raise ValueError(
                f"{self._table.path}: column '{column.title}': the train does not move; give a file with motion"
            )
        change = np.abs(np.diff(speed, prepend=speed[0]))
        rate = change / np.diff(samples.time, prepend=samples.time[0] - 1.0)
        jumps = (change > JUMP) & (rate > JUMP_RATE)
        self._rows.refuse(samples, jumps, "{} is an impossible jump; correct or remove the row")
        return samples

    def _bounded(self, samples: ColumnSamples) -> ColumnSamples:
        """Return samples within the bounds of their quantity."""
        low, negative, high, large = BOUNDS[samples.column.quantity]
        self._rows.refuse(samples, samples.values < low, f"{{}} is negative; {negative}")
        self._rows.refuse(samples, samples.values > high, f"{{}} is {large}; check the unit in the column name")
        return samples

    def _found(self, quantity: str) -> ColumnSamples | None:
        samples = self._rows.find(quantity)
        return None if samples is None else self._bounded(samples)

    def _by_unit(self, quantity: str) -> dict[int | None, ColumnSamples]:
        columns = self._columns(quantity)
        found = {column.unit: self._rows.samples(column) for column in columns}
        if None in found and len(found) > 1:
            other = next(column for column in columns if column.unit is not None)
            whole = found[None].column.title
            raise ValueError(
                f"{self._table.path}: '{whole}' is the sum of all power units, '{other.title}' is for one; remove one"
            )
        missing = sorted(set(range(self._units)) - {unit for unit in found if unit is not None})
        if found and None not in found and missing:
            raise ValueError(
                f"{self._table.path}: {quantity} of unit {missing[0]} is missing; give it for every power unit"
            )
        return found

    def _forces(self) -> dict[int | None, ColumnSamples]:
        """Return the forces at the wheel; separate traction and brake columns are combined."""
        whole = self._by_unit("force")
        traction, brake = self._rows.find("traction_force"), self._rows.find("brake_force")
        parts = [samples for samples in (traction, brake) if samples is not None]
        if whole and parts:
            one = next(iter(whole.values())).column.title
            raise ValueError(
                f"{self._table.path}: '{one}' and '{parts[0].column.title}' are both the force; --ignore one"
            )
        forces = next(quantity.units for quantity in QUANTITIES if quantity.name == "force")
        for samples in parts:
            title = samples.column.title.replace("{", "{{").replace("}", "}}")
            signed = next(name for name, value in forces.items() if value == samples.column.factor)
            remedy = f"read a signed force with --rename '{title}:=force_{signed}'"
            self._rows.refuse(samples, samples.values < 0, f"{{}} is negative; {remedy}")
        if not parts:
            return whole
        first = parts[0]
        values = (traction.at(first.time) if traction else 0.0) - (brake.at(first.time) if brake else 0.0)
        return {None: first.moved(np.asarray(values, dtype=np.float64))}

    def _unit_positions(self) -> dict[int, ColumnSamples]:
        columns = self._columns("position")
        found = {column.unit: self._rows.samples(column) for column in columns if column.unit is not None}
        return {unit: self._rising(samples) for unit, samples in found.items()}

    def _rising(self, samples: ColumnSamples) -> ColumnSamples:
        """Return positions that rise in the direction of running; those of posts, or falling ones, are converted."""
        values, title, line = samples.values, samples.column.title, self._line
        steps = np.diff(values)
        falling = values[-1] < values[0] and (steps < 0).sum() > 4 * (steps > 0).sum()
        if line.chainage and (falling or values.min() < line.begin or values.max() > line.end):
            places = places_along(line.chainage, line.begin, values.tolist())
            if places is not None and places[-1] < places[0]:
                other = "without :reverse" if self._against else "with --line LINE:reverse"
                raise self._table.wrong(
                    int(samples.rows[int(np.argmax(steps != 0)) + 1]),
                    samples.column,
                    f"kilometres against the direction of line '{line.name}', from {line.post_at(places[0])} to "
                    f"{line.post_at(places[-1])}: name the line {other}, or use the speed only with --ignore '{title}'",
                )
            if places is not None:
                self._rows.notes.append(f"{title}: kilometres of the posts of line '{line.name}'")
                return samples.moved(np.array(places))
        if not falling:
            return samples
        if not self._against:
            raise self._table.wrong(
                int(samples.rows[int(np.argmax(steps < 0)) + 1]),
                samples.column,
                f"positions fall, from {number_text(values[0] / 1e3)} to {number_text(values[-1] / 1e3)} km: name the "
                f"line of this direction with --line LINE:reverse, or use the speed only with --ignore '{title}'",
            )
        self._rows.notes.append(f"{title}: falling kilometres, mirrored with the line")
        return samples.moved(line.begin + line.end - values)

    def _position(self, speed: ColumnSamples, unit_position: dict[int, ColumnSamples]) -> ColumnSamples | None:
        """Return the position of vehicle 0 from the position column of the file."""
        centre, front = self._rows.find("position"), self._rows.find("front_position")
        if centre is not None and front is not None:
            both = f"'{centre.column.title}' and '{front.column.title}'"
            raise ValueError(f"{self._table.path}: {both} are both the position; remove one with --ignore")
        centre, front = (None if samples is None else self._rising(samples) for samples in (centre, front))
        if front is not None:
            centre = front.moved(front.values - self._consist.vehicles[0].length / 2)
        elif centre is None and 0 in unit_position:
            own = unit_position[0]
            centre = own.moved(own.values + self._consist.offsets[self._consist.power_units[0]])
        if centre is None:
            return None
        fallen = np.maximum.accumulate(centre.values) - centre.values
        noise = max(POSITION_NOISE, 1.5 * self._table.resolution(centre.column))
        self._rows.refuse(centre, fallen > noise, "{} is behind an earlier position; positions must increase")
        self._check_distance(centre, speed)
        self._check_leaps(centre, speed)
        self._note_small_leaps(centre, speed)
        return centre

    def _check_distance(self, position: ColumnSamples, speed: ColumnSamples) -> None:
        """Compare the positions with the integral of the speed, to detect wrong units."""
        way = float(way_of(speed)[-1])
        run = float(position.values[-1] - position.values[0])
        if abs(run - way) > max(DISTANCE_LEAST, DISTANCE_SHARE * max(run, way)):
            place, pace = position.column.title, speed.column.title
            raise ValueError(
                f"{self._table.path}: '{place}' covers {run / 1e3:.3f} km, the integral of '{pace}' is {way / 1e3:.3f} "
                f"km; check the units, or use the speed only with --ignore '{place}'"
            )

        if abs(run - way) > max(STEP + self._table.resolution(position.column), RUN_SHARE * way):
            self._rows.notes.append(
                f"{position.column.title}: covers {run / 1e3:.3f} km, the integral of '{speed.column.title}' is "
                f"{way / 1e3:.3f} km; read as it is"
            )

    def _note_small_leaps(self, position: ColumnSamples, speed: ColumnSamples) -> None:
        """Note the rows whose position differs from the speed by less than a leap that is refused."""
        steps = np.diff(position.values)
        gap = np.abs(steps - np.diff(np.interp(position.time, speed.time, way_of(speed))))
        wrong = np.flatnonzero(gap > STEP + self._table.resolution(position.column) + STEP_SHARE * np.abs(steps))
        if wrong.size:
            row = int(wrong[np.argmax(gap[wrong])])
            more = f" (and {wrong.size - 1} more rows)" if wrong.size > 1 else ""
            self._rows.notes.append(
                self._table.at(
                    int(position.rows[row + 1]),
                    position.column,
                    f"{number_text(steps[row])} m since the row above, {number_text(gap[row])} m beside "
                    f"'{speed.column.title}'; read as it is{more}",
                )
            )

    def _check_leaps(self, position: ColumnSamples, speed: ColumnSamples) -> None:
        """Compare the positions with the integral of the speed place by place, to detect leaps of an odometer."""
        way = np.interp(position.time, speed.time, way_of(speed))
        ahead = position.values - way
        least = LEAP + 3 * self._table.resolution(position.column)
        last = np.maximum(np.searchsorted(way, way + LEAP_WAY), np.arange(1, way.size + 1)).clip(max=way.size - 1)
        leap = np.abs(ahead[last] - ahead)
        wrong = np.flatnonzero(leap > np.maximum(least, LEAP_SHARE * (way[last] - way)))
        if not wrong.size:
            return
        row = int(wrong[0])
        row += 1 + int(np.argmax(np.abs(np.diff(ahead[row : last[row] + 1]))))
        place, gap = position.column.title, float(ahead[row] - ahead[row - 1])
        than = f"{number_text(abs(gap))} m {'more' if gap > 0 else 'less'} than"
        seconds = float(position.time[row] - position.time[row - 1])
        raise self._table.wrong(
            int(position.rows[row]),
            position.column,
            f"{number_text(position.values[row] - position.values[row - 1])} m in {number_text(seconds)} s since the "
            f"row above, {than} '{speed.column.title}' gives: a leap of the odometer; correct the positions, or use "
            f"the speed only with --ignore '{place}'",
        )
