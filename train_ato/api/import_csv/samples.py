"""Rows of a recorder's file in order of time, and the samples of every quantity."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.traction import Envelope
from plant_sim.units import number_text
from train_ato.api.import_csv.columns import NOTCH, TIMESTAMP, Column
from train_ato.api.import_csv.table import CsvTable
from train_ato.messages.types import Array

HOUR = 3600.0
ZONE = "write date and time with the zone, for example 2026-10-25T02:59:59+02:00"


@dataclass(frozen=True)
class ColumnSamples:
    """Samples of one quantity in SI, shape (k,) each, with linear interpolation."""

    column: Column
    time: Array
    values: Array
    rows: NDArray[np.intp]

    def at(self, moments: Array) -> Array:
        """Return the values at some times [s]; the first and the last value are held outside."""
        return np.asarray(np.interp(moments, self.time, self.values))

    def moved(self, values: Array) -> "ColumnSamples":
        """Return other values at the same times."""
        return ColumnSamples(self.column, self.time, values, self.rows)


def sort_rows(table: CsvTable) -> str:
    """Sort the rows of a file by time and remove repeated rows; return a note, "" without a change."""
    column = table.find("time") or table.find(TIMESTAMP)
    if column is None:
        return ""
    time = table.values[column.title]
    order = np.argsort(time, kind="stable")
    moved = int((order != np.arange(order.size)).sum())
    columns = np.column_stack([values[order] for values in table.values.values()])
    same = np.all((columns[1:] == columns[:-1]) | (np.isnan(columns[1:]) & np.isnan(columns[:-1])), axis=1)
    kept = order[np.concatenate(([True], ~same))]
    for title, values in table.values.items():
        table.values[title] = values[kept]
    table.lines = table.lines[kept]
    parts = [f"{moved} rows sorted by time"] if moved else []
    parts += [f"{order.size - kept.size} repeated rows removed"] if kept.size < order.size else []
    return ", ".join(parts)


FORCES = ("force", "traction_force", "brake_force")


def add_notch_force(table: CsvTable, consist: Consist) -> str:
    """Replace the notches of a file by their force; return a note, "" without notches.

    Notches beside a demand, and without a speed of the train, are refused.
    """
    notches = [column for column in table.columns.values() if column.quantity == NOTCH]
    if not notches:
        return ""
    title = notches[0].title
    speed, given = table.find("speed") or table.find("speed", 0), table.find("command_force")
    if given is not None:
        raise ValueError(f"{table.path}: '{title}' and '{given.title}' are both the demand; --ignore one")
    if speed is None:
        raise ValueError(f"{table.path}: '{title}' has its force at the speed; name the speed of the train speed_kmh")
    units = [consist.vehicles[unit] for unit in consist.power_units]
    traction = [Envelope(unit.traction) for unit in units]
    brake = [Envelope(unit.electric_brake or unit.brake) for unit in units]
    both = int(np.count_nonzero(np.count_nonzero([table.values[entry.title] for entry in notches], axis=0) > 1))
    share = sum((table.values[column.title] for column in notches), np.zeros(table.lines.size))
    rows = np.arange(table.lines.size)
    known = ~np.isnan(table.values[speed.title])
    moving = np.abs(np.interp(rows, rows[known], table.values[speed.title][known])) if known.any() else rows * 0.0
    force = np.array(
        [
            part * plain_sum(envelope.force(v) for envelope in (traction if part > 0 else brake)) if part else part
            for part, v in zip(share.tolist(), moving.tolist(), strict=True)
        ]
    )
    for column in notches:
        del table.columns[column.title], table.values[column.title]
    measured = any(column.quantity in FORCES for column in table.columns.values())
    for quantity in ("command_force",) if measured else ("command_force", "force"):
        name = f"{title} as {quantity}"
        table.columns[name], table.values[name] = Column(name, quantity, 1.0), force
        table.decimals[name] = -1
    use = "the demand" if measured else "the demand and, without a measured force in the file, the force"
    twice = f"; in {both} rows the shares of two handles add" if both else ""
    return f"{title}: share of the largest force at the speed; it is {use}{twice}"


def _more(places: NDArray[np.intp]) -> str:
    """Return the number of further rows with the same fault."""
    return f" (and {places.size - 1} more rows)" if places.size > 1 else ""


class Rows:
    """The rows of a file.

    Parameters
    ----------
    table
        The file.
    largest_gap
        Maximum time between rows, and between the numbers of one column [s].

    Attributes
    ----------
    time : Array, shape (n,)
        Times from the first row on [s].
    notes : list of str
        Bridged gaps, one line each.
    """

    def __init__(self, table: CsvTable, largest_gap: float) -> None:
        self.table = table
        self.notes: list[str] = []
        self._largest_gap = largest_gap
        self.time = self._clock()

    def _clock(self) -> Array:
        """Return the times of the rows, from the first one on."""
        table = self.table
        columns = [table.find("time"), table.find(TIMESTAMP)]
        column = columns[0] or columns[1]
        if column is None:
            raise ValueError(f"{table.path}: no time column; name one time_s, or timestamp for date and time")
        if columns[0] and columns[1]:
            raise ValueError(
                f"{table.path}: '{columns[0].title}' and '{columns[1].title}' are both the time; --ignore one"
            )
        time = table.values[column.title]
        if time.size < 2:
            raise ValueError(f"{table.path}: {time.size} rows of numbers; give at least two")
        empty = np.flatnonzero(np.isnan(time))
        if empty.size:
            raise table.wrong(int(empty[0]), column, "is empty; every row needs a time, remove the row")
        steps = np.diff(time)
        wrong = np.flatnonzero(steps <= 0)
        if wrong.size:
            row = int(wrong[0]) + 1
            order = "the same time as" if steps[row - 1] == 0 else f"{number_text(-steps[row - 1])} s before"
            same = all(np.array_equal(v[row], v[row - 1], equal_nan=True) for v in table.values.values())
            remedy = "sort the rows by time, or give --sort"
            if column.quantity == TIMESTAMP and abs(steps[row - 1] + HOUR) <= self._largest_gap:
                remedy = f"the clock was set back by an hour: {ZONE}"
            if steps[row - 1] == 0:
                remedy = "the row is repeated; remove it, or give --sort" if same else "remove one row"
            raise table.wrong(row, column, f"{order} the row above; {remedy}{_more(wrong)}")
        wide = np.flatnonzero(steps > self._largest_gap * (1 + 1e-9))
        if wide.size:
            row = int(wide[0]) + 1
            cause = ""
            if column.quantity == TIMESTAMP and abs(steps[row - 1] - HOUR) <= self._largest_gap:
                cause = f"; if the clock was set forward by an hour, {ZONE}"
            elif column.quantity == TIMESTAMP and not (steps % 60.0).any():
                cause = "; 08:15 is read as hours and minutes, write 00:08:15 for minutes and seconds"
            raise table.wrong(row, column, self._gap(steps[row - 1], "the row above") + cause + _more(wide))
        return np.asarray(time - time[0])

    def _gap(self, seconds: float, since: str) -> str:
        return (
            f"{number_text(seconds)} s after {since}; gaps above {self._largest_gap:g} s are not bridged; split "
            f"the run there, or give --largest-gap {number_text(np.ceil(seconds))}"
        )

    def find(self, quantity: str, unit: int | None = None) -> ColumnSamples | None:
        """Return the samples of a quantity; None if the file has no column of it."""
        column = self.table.find(quantity, unit)
        return None if column is None else self.samples(column)

    def samples(self, column: Column) -> ColumnSamples:
        """Return the samples of a column; check that its gaps can be bridged."""
        values = self.table.values[column.title]
        rows = np.flatnonzero(~np.isnan(values))
        if not rows.size:
            raise ValueError(
                f"{self.table.path}: column '{column.title}' is empty; remove it with --ignore '{column.title}'"
            )
        time = self.time[rows]
        edges = np.concatenate(([0.0], time, [self.time[-1]]))
        gaps = np.diff(edges)
        wide = np.flatnonzero(gaps > self._largest_gap * (1 + 1e-9))
        if wide.size:
            place = int(wide[0])
            row = int(rows[place]) if place < rows.size else values.size - 1
            above = "the first row" if place == 0 else f"the last value, in line {self.table.lines[rows[place - 1]]}"
            raise self.table.wrong(row, column, self._gap(gaps[place], above))
        if rows.size < values.size:
            line = self.table.lines[int(np.flatnonzero(np.isnan(values))[0])]
            self.notes.append(
                f"{column.title}: {values.size - rows.size} empty cells bridged, the first in line {line}, at most "
                f"{number_text(gaps.max(), 3)} s"
            )
        return ColumnSamples(column, time, values[rows], rows)

    def refuse(self, samples: ColumnSamples, wrong: NDArray[np.bool_], text: str) -> None:
        """Raise an error for the first wrong value; ``{}`` in the text is replaced by the value."""
        places = np.flatnonzero(wrong)
        if places.size:
            place = int(places[0])
            value = samples.values[place] / samples.column.factor
            problem = text.format(number_text(value)) + _more(places)
            raise self.table.wrong(int(samples.rows[place]), samples.column, problem)
