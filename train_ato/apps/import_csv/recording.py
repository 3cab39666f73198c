"""A recorded speed and force history that can be true: every number looked at, what is odd named by its line."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from train_ato.measured.columns import Column
from train_ato.measured.samples import LARGEST_GAP, Rows, Samples
from train_ato.measured.table import Table
from train_ato.types import Array

__all__ = ["Measured", "measured"]

BACKWARDS = 0.5 / 3.6
"""Speeds up to this far from 0 are noise at standstill [m/s]."""
FASTEST = 200.0
"""Speeds beyond this are a wrong unit [m/s]."""
JUMP, JUMP_RATE = 1.5, 5.0
"""A change of speed from row to row beyond the first [m/s] and faster than the second [m/s²] is no train's."""
FALL = 5.0
"""Positions may fall by this noise below the largest before [m]; by more where they are written more coarsely."""
DISTANCE_SHARE, DISTANCE_LEAST = 0.2, 200.0
"""Way of the position column and integral of the speed may differ by this share or this length [m]."""


@dataclass
class Measured:
    """What a recorder saw; times from the first row on [s].

    Attributes
    ----------
    table
        The file.
    end
        Time of the last row.
    interval, largest_gap
        Median and largest time between rows [s].
    speed, position, reference_speed, pressure : Samples or None
        Of the train; the position is that of vehicle 0's centre.
    force, command : dict of Samples
        By the power unit, None: of all together.
    unit_speed, unit_position : dict of Samples
        By the power unit.
    notes : list of str
        What was put right, in one line each.
    """

    table: Table
    end: float
    interval: float
    largest_gap: float
    speed: Samples
    position: Samples | None = None
    reference_speed: Samples | None = None
    pressure: Samples | None = None
    force: dict[int | None, Samples] = field(default_factory=dict)
    command: dict[int | None, Samples] = field(default_factory=dict)
    unit_speed: dict[int, Samples] = field(default_factory=dict)
    unit_position: dict[int, Samples] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def measured(table: Table, units: int, half: float, offsets: Array, largest_gap: float = LARGEST_GAP) -> Measured:
    """Check what a file says and put it in order.

    Parameters
    ----------
    table
        The file.
    units
        Number of power units of the train.
    half
        From vehicle 0's centre to the train's front [m].
    offsets
        Distance of every power unit behind vehicle 0's centre [m], shape (units,).
    largest_gap
        Rows further apart are refused [s].

    Raises
    ------
    ValueError
        One line: the file, the line, the column, what is wrong and the remedy.
    """
    return _Check(table, units, half, offsets, largest_gap).run()


class _Check:
    """One look through a file."""

    def __init__(self, table: Table, units: int, half: float, offsets: Array, largest_gap: float) -> None:
        self._table = table
        self._units = units
        self._half = half
        self._offsets = offsets
        self._rows = Rows(table, largest_gap)

    def run(self) -> Measured:
        self._check_units()
        speeds = {
            column.unit: self._speed(column) for column in self._table.columns.values() if column.quantity == "speed"
        }
        speed = speeds.get(None) or speeds.get(0)
        if speed is None:
            raise ValueError(f"{self._table.path}: no column of the speed; name one speed_kmh or speed_m_s")
        steps = np.diff(self._rows.time)
        found = Measured(
            table=self._table,
            end=float(self._rows.time[-1]),
            interval=float(np.median(steps)),
            largest_gap=float(steps.max()),
            speed=speed,
            unit_speed={unit: samples for unit, samples in speeds.items() if unit is not None},
            reference_speed=self._reference(),
            pressure=self._pressure(),
            force=self._forces(),
            command=self._by_unit("command_force"),
            notes=self._rows.notes,
        )
        found.unit_position = self._unit_positions()
        found.position = self._position(found)
        return found

    def _check_units(self) -> None:
        """Refuse power units that the train does not have."""
        for column in self._table.columns.values():
            if column.unit is not None and column.unit >= self._units:
                raise ValueError(
                    f"{self._table.path}: column '{column.title}': the train has {self._units} power units, counted "
                    "from 0 at the front; choose another --consist or --ignore the column"
                )

    def _speed(self, column: Column) -> Samples:
        samples = self._rows.samples(column)
        speed = samples.values
        self._rows.refuse(
            samples, speed < -BACKWARDS, "{} is negative; the speed counts forward, cut out the part run back"
        )
        self._rows.refuse(
            samples, speed > FASTEST, "{} is faster than any train; is the unit in the column's name right?"
        )
        if speed.max() < BACKWARDS:
            raise ValueError(f"{self._table.path}: column '{column.title}': the train never moves; this is no run")
        change = np.abs(np.diff(speed, prepend=speed[0]))
        rate = change / np.diff(samples.time, prepend=samples.time[0] - 1.0)
        self._rows.refuse(
            samples,
            (change > JUMP) & (rate > JUMP_RATE),
            "{} is a jump that no train makes; correct the row or take it out",
        )
        return samples

    def _reference(self) -> Samples | None:
        samples = self._rows.find("reference_speed")
        if samples is not None:
            self._rows.refuse(samples, samples.values < 0, "{} is negative; a reference counts forward")
            self._rows.refuse(samples, samples.values > FASTEST, "{} is faster than any train; is the unit right?")
        return samples

    def _pressure(self) -> Samples | None:
        samples = self._rows.find("brake_pipe_pressure")
        if samples is not None:
            self._rows.refuse(samples, samples.values < 0, "{} is negative; the pressure is absolute")
            self._rows.refuse(samples, samples.values > 1.5e6, "{} is beyond any brake pipe's; is the unit right?")
        return samples

    def _by_unit(self, quantity: str) -> dict[int | None, Samples]:
        columns = [column for column in self._table.columns.values() if column.quantity == quantity]
        found = {column.unit: self._rows.samples(column) for column in columns}
        if None in found and len(found) > 1:
            other = next(column for column in columns if column.unit is not None)
            whole = found[None].column.title
            raise ValueError(f"{self._table.path}: '{whole}' is of all units, '{other.title}' of one; give either")
        missing = sorted(set(range(self._units)) - {unit for unit in found if unit is not None})
        if found and None not in found and missing:
            raise ValueError(f"{self._table.path}: {quantity} of unit {missing[0]} is missing; give it for every unit")
        return found

    def _forces(self) -> dict[int | None, Samples]:
        """Return the forces at the wheel; traction and brake apart become one."""
        whole, traction, brake = (
            self._by_unit("force"),
            self._rows.find("traction_force"),
            self._rows.find("brake_force"),
        )
        parts = [samples for samples in (traction, brake) if samples is not None]
        if whole and parts:
            one = next(iter(whole.values())).column.title
            raise ValueError(
                f"{self._table.path}: '{one}' and '{parts[0].column.title}' both say the force; --ignore one"
            )
        for samples in parts:
            self._rows.refuse(samples, samples.values < 0, "{} is negative; a force that has a sign is called force")
        if not parts:
            return whole
        first = parts[0]
        values = (traction.at(first.time) if traction else 0.0) - (brake.at(first.time) if brake else 0.0)
        return {None: first.moved(np.asarray(values, dtype=np.float64))}

    def _unit_positions(self) -> dict[int, Samples]:
        columns = [column for column in self._table.columns.values() if column.quantity == "position"]
        return {column.unit: self._rows.samples(column) for column in columns if column.unit is not None}

    def _position(self, found: Measured) -> Samples | None:
        """Return the place of vehicle 0's centre, whichever of the ways to say it the file has."""
        centre, front = self._rows.find("position"), self._rows.find("front_position")
        if centre is not None and front is not None:
            both = f"'{centre.column.title}' and '{front.column.title}'"
            raise ValueError(f"{self._table.path}: {both} both say the position; --ignore one")
        if front is not None:
            centre = front.moved(front.values - self._half)
        elif centre is None and 0 in found.unit_position:
            own = found.unit_position[0]
            centre = own.moved(own.values + self._offsets[0])
        if centre is None:
            return None
        fallen = np.maximum.accumulate(centre.values) - centre.values
        noise = max(FALL, 1.5 * self._table.resolution(centre.column))
        self._rows.refuse(centre, fallen > noise, "{} lies behind the place that was reached; positions rise")
        self._check_distance(centre, found.speed)
        return centre

    def _check_distance(self, position: Samples, speed: Samples) -> None:
        """Compare the way of the positions with the integral of the speed: a wrong unit shows there."""
        steps = np.diff(speed.time)
        way = float((steps * (speed.values[1:] + speed.values[:-1]) / 2).sum())
        run = float(position.values[-1] - position.values[0])
        if abs(run - way) > max(DISTANCE_LEAST, DISTANCE_SHARE * max(run, way)):
            place, pace = position.column.title, speed.column.title
            raise ValueError(
                f"{self._table.path}: '{place}' runs {run / 1e3:.3f} km, '{pace}' adds up to {way / 1e3:.3f} km; is a "
                f"unit wrong? --ignore '{place}' goes by the speed alone"
            )
