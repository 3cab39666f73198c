"""Profile files in CSV and YAML: position, speed and acceleration over time, in SI or the unit of a suffix."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import Field, model_validator

from plant_sim.data_text import parse_yaml
from plant_sim.si_model import SiModel, option
from plant_sim.units import Place, Speed, Time
from train_ato.messages.types import Array
from train_ato.profile.profile import MAX_TIME, Profile, check_columns, hermite, knot_count
from train_ato.program.errors import refused_unwritten

SCHEMA = "train_ato/profile/1"
MAX_FILE = 256 * 2**20
"""Maximum size of a profile file [bytes]."""
UNITS: dict[str, dict[str, float]] = {
    "time": {"": 1.0, "_s": 1.0, "_ms": 1e-3, "_min": 60.0},
    "position": {"": 1.0, "_m": 1.0, "_km": 1000.0},
    "speed": {"": 1.0, "_m_s": 1.0, "_kmh": 1 / 3.6},
    "acceleration": {"": 1.0, "_m_s2": 1.0},
}
"""Factor to SI of every column, by the unit suffix of its name."""


def read_profile(path: Path, period: float | None = None) -> Profile:
    """Read a profile.

    ``time`` and ``speed`` are required; a missing ``position`` is integrated from 0, a missing ``acceleration`` is the
    derivative of the speed.  Times may be unevenly spaced if a period is given.

    Parameters
    ----------
    path
        ``*.csv``, ``*.yaml`` or ``*.yml``.
    period
        Time between the knots [s]; None keeps the knots of the file.
    """
    try:
        if path.stat().st_size > MAX_FILE:
            raise ValueError(f"{path}: larger than {MAX_FILE} bytes; name a profile file")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror}); name a readable profile file") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: is no text in UTF-8; name a profile file") from None
    try:
        if path.suffix.lower() in (".yaml", ".yml"):
            return _parse_yaml(text, period)
        return parse_csv(text, period)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def parse_csv(text: str, period: float | None = None) -> Profile:
    """Return the profile of a CSV text: ``#`` lines are comments, the first row has the names, the others numbers."""
    rows = (
        (number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line.lstrip()[0] != "#"
    )
    first = next(rows, None)
    if first is None:
        raise ValueError("no row of column names; begin with time,position,speed,acceleration")
    names = [name.strip() for name in next(csv.reader([first[1]]))]
    columns: dict[str, list[float]] = {name: [] for name in names}
    if len(columns) != len(names):
        raise ValueError(f"line {first[0]}: a column has two entries in {', '.join(names)}; remove one")
    for number, line in rows:
        cells = line.split(",")
        if len(cells) != len(names):
            raise ValueError(
                f"line {number}: {len(cells)} values for the {len(names)} columns {', '.join(names)}; correct the row"
            )
        name = ""
        try:
            for name, cell in zip(names, cells, strict=True):
                columns[name].append(float(cell))
        except ValueError:
            raise ValueError(
                f"line {number}, {name}: '{line.strip()[:40]}' contains a value that is not a number; correct it"
            ) from None
    return _assemble(dict(columns), period)


def _parse_yaml(text: str, period: float | None) -> Profile:
    try:
        data = parse_yaml(text)
    except ValueError as error:
        raise ValueError(f"not valid YAML: {error}; correct it") from None
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise ValueError(f"schema: missing or wrong; add the line 'schema: {SCHEMA}'")
    data = {key: value for key, value in data.items() if key not in ("schema", "name", "source", "summary")}
    start, own = data.pop("start", 0.0), data.pop("period", None)
    columns = {name: value for name, value in data.items() if isinstance(value, list)}
    if len(columns) != len(data):
        name = next(name for name in data if name not in columns)
        raise ValueError(f"{name}: unknown key or not a list of numbers; use start, period, {', '.join(UNITS)}")
    if own is not None:
        if not all(type(each) in (int, float) and abs(each) <= MAX_TIME for each in (own, start)) or own < 1e-9:
            raise ValueError(f"period, start: '{own}', '{start}' are not valid; give seconds, period at least 1e-9")
        length = len(next(iter(columns.values()), []))
        columns["time"] = [(round(start * 1e9) + round(own * 1e9) * k) * 1e-9 for k in range(length)]
    return _assemble(columns, period)


def _assemble(columns: dict[str, Any], period: float | None) -> Profile:
    """Return the profile of named columns with unit suffixes."""
    found: dict[str, Array] = {}
    for name, values in columns.items():
        quantity = next((q for q in UNITS if name == q or name.removeprefix(q) in UNITS[q]), None)
        if quantity is None or name.removeprefix(quantity) not in UNITS[quantity]:
            known = ", ".join(f"{q}[{'|'.join(s for s in UNITS[q] if s)}]" for q in UNITS)
            raise ValueError(f"column '{name}' is unknown; use {known}")
        if quantity in found:
            raise ValueError(f"column '{name}' repeats {quantity}; keep one")
        try:
            found[quantity] = np.array(values, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"column '{name}' contains a value that is not a number; correct it") from None
        factor = UNITS[quantity][name.removeprefix(quantity)]
        if factor != 1.0:
            found[quantity] = found[quantity] * factor
    missing = [quantity for quantity in ("time", "speed") if quantity not in found]
    if missing:
        raise ValueError(f"column '{missing[0]}' is missing; add it (time and speed are required)")
    return _complete(found, period)


def _complete(found: dict[str, Array], period: float | None) -> Profile:
    time, speed = found["time"], found["speed"]
    check_columns(found)
    falling = np.flatnonzero(np.diff(time) <= 0)
    if falling.size:
        raise ValueError(
            f"time {time[falling[0] + 1]:g} s is not after that of the previous row; sort the rows by time"
        )
    if "acceleration" not in found:
        found["acceleration"] = np.gradient(speed, time)
    a = found["acceleration"]
    if "position" not in found:
        step = np.diff(time)
        ways = step * (speed[1:] + speed[:-1]) / 2 + step**2 / 12 * (a[:-1] - a[1:])
        found["position"] = np.concatenate(([0.0], np.cumsum(ways)))
    steps = np.diff(time)
    if steps.max() - steps.min() <= max(4e-9, 2e-6 * steps.min()):
        profile = Profile(time, found["position"], speed, a)
        return profile if period is None else profile.resampled(period)
    if period is None:
        raise ValueError("times are not evenly spaced; give the period of the profile")
    return _from_uneven(time, found["position"], speed, a, period)


def _from_uneven(time: Array, position: Array, speed: Array, acceleration: Array, period: float) -> Profile:
    """Return unevenly spaced rows resampled to a period [s] with the polynomials of :mod:`.knots`."""
    start = float(time[0])
    count = knot_count(float(np.floor((time[-1] - start) / period + 1e-9)) + 1)
    rest = abs(speed[-1]) <= 1e-3 and start + (count - 1) * period < time[-1] - 1e-9
    knots = start + period * np.arange(count)
    k = np.clip(np.searchsorted(time, knots, side="right") - 1, 0, time.size - 2)
    h, s = time[k + 1] - time[k], knots - time[k]
    x = hermite(position[k], speed[k], position[k + 1], speed[k + 1], s, h)[0]
    v, a = hermite(speed[k], acceleration[k], speed[k + 1], acceleration[k + 1], s, h)
    if rest:
        x, v, a = np.append(x, position[-1]), np.append(v, 0.0), np.append(a, 0.0)
    return Profile.uniform(start, period, x, v, a)


def csv_text(profile: Profile, source: str = "") -> str:
    """Return a profile as CSV in SI; reading it restores the same bits."""
    text = io.StringIO()
    text.write("# speed profile of vehicle 0's centre: time s, position m, speed m/s, acceleration m/s2\n")
    for line in source.splitlines():
        text.write(f"# {line}\n")
    text.write("time,position,speed,acceleration\n")
    columns = (profile.time, profile.position, profile.velocity, profile.acceleration)
    for row in zip(*(column.tolist() for column in columns), strict=True):
        text.write(",".join(map(repr, row)) + "\n")
    return text.getvalue()


def write_profile(profile: Profile, path: Path, source: str = "") -> None:
    """Write a profile as CSV or YAML, by the suffix of the file; the source is a comment at its begin.

    Raises
    ------
    ValueError
        If the suffix is neither ``.csv`` nor ``.yaml`` or the file cannot be written.
    """
    suffix = path.suffix.lower()
    source = source.encode(errors="backslashreplace").decode()  # the name of a file need not be UTF-8
    if suffix in (".yaml", ".yml"):
        data = {
            "schema": SCHEMA,
            "source": source,
            "start": profile.start,
            "period": profile.period,
            "position": profile.position.tolist(),
            "speed": profile.velocity.tolist(),
            "acceleration": profile.acceleration.tolist(),
        }
        dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
        text = yaml.dump(data, Dumper=dumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    elif suffix == ".csv":
        text = csv_text(profile, source)
    else:
        raise ValueError(f"{path}: unknown ending; use .csv or .yaml")
    with refused_unwritten(path, left=path):
        path.write_text(text, encoding="utf-8")


class Point(SiModel):
    """A corner of the speed curve: a speed at a time or at a place of the train's front."""

    time: Time | None = option(None, "time of the corner", example=60.0)
    place: Place | None = option(None, "place of the front at the corner", example=1200.0)
    speed: Speed = Field(description="speed at the corner", examples=[20.0])

    @model_validator(mode="after")
    def _one_axis(self) -> "Point":
        if (self.time is None) == (self.place is None):
            raise ValueError("a point needs either a time or a place; give exactly one")
        return self


class Step(SiModel):
    """A constant speed from a time on, without transition."""

    at: Time = Field(ge=0, description="time from which the speed holds", examples=[60.0])
    speed: Speed = Field(description="constant speed", examples=[20.0])


def from_points(points: tuple[Point, ...], jerk: float | None, start: float, half: float, period: float) -> Profile:
    """Return the profile through corners of the speed curve, rounded to a jerk limit.

    The speed is averaged over a sliding window: the largest change of acceleration divided by the jerk limit.  The
    distance does not change, no speed is exceeded, and the profile takes one window longer.

    Parameters
    ----------
    points
        Corners, all with a time or all with a place.
    jerk
        Jerk limit [m/s³]; None: corners are not rounded.
    start
        Initial position of vehicle 0's centre for points over time [m].
    half
        Distance from vehicle 0's centre to the front [m].
    period
        Time between the knots [s].

    Raises
    ------
    ValueError
        If a point is not possible; the message has its number.
    """
    time, speed = _corners(points)
    if points[0].place is not None:
        start = points[0].place - half
    acceleration = np.diff(speed) / np.diff(time)
    window = 0.0
    if jerk is not None:
        window = float(max(acceleration.max(), 0.0) - min(acceleration.min(), 0.0)) / jerk
    return _averaged(time, speed, start, window, period)


def _corners(points: tuple[Point, ...]) -> tuple[Array, Array]:
    """Return time [s] and speed [m/s] of every corner."""
    if len(points) < 2:
        raise ValueError("points: fewer than two; add points")
    over_time = points[0].time is not None
    if any((point.time is not None) != over_time for point in points):
        raise ValueError("points: times and places are mixed; use one of them in all points")
    speed = np.array([point.speed for point in points])
    axis = np.array([float(point.time if point.time is not None else point.place or 0.0) for point in points])
    for number in np.flatnonzero(np.diff(axis) <= 0):
        raise ValueError(f"points: number {number + 1} is not beyond the previous one; sort the points")
    if over_time:
        return axis, speed
    both = speed[1:] + speed[:-1]
    for number in np.flatnonzero(both <= 0):
        raise ValueError(
            f"points: numbers {number} and {number + 1} are at rest at different places; add a speed between them"
        )
    return np.concatenate(([0.0], np.cumsum(2 * np.diff(axis) / both))), speed


def _averaged(time: Array, speed: Array, start: float, window: float, period: float) -> Profile:
    """Return the profile of a piecewise linear speed averaged over a window [s]; exact, from its integrals."""
    margin = 2 * window + 2 * period + 1.0
    t = np.concatenate(([time[0] - margin], time, [time[-1] + margin]))
    v = np.concatenate((speed[:1], speed, speed[-1:]))
    a = np.append(np.diff(v) / np.diff(t), 0.0)
    x = np.concatenate(([0.0], np.cumsum(np.diff(t) * (v[1:] + v[:-1]) / 2)))
    x -= x[1]
    y = np.concatenate(([0.0], np.cumsum(np.diff(t) * (x[:-1] + np.diff(t) * (v[:-1] / 2 + np.diff(t) * a[:-1] / 6)))))

    def integrals_at(at: Array) -> tuple[Array, Array, Array, Array]:
        k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
        s = at - t[k]
        ramp = v[k] + s * a[k]
        distance = x[k] + s * (v[k] + s * a[k] / 2)
        return y[k] + s * (x[k] + s * (v[k] / 2 + s * a[k] / 6)), distance, ramp, a[k]

    lead = window / 2 if speed[0] == 0.0 else 0.0
    length = time[-1] - time[0] + lead + (window / 2 if speed[-1] == 0.0 else 0.0)
    knots = period * np.arange(knot_count(float(np.ceil(length / period - 1e-9)) + 1))
    centre = knots + time[0] - lead
    if window <= 0:
        _, distance, ramp, rate = integrals_at(centre)
    else:
        after, before = integrals_at(centre + window / 2), integrals_at(centre - window / 2)
        distance, ramp, rate = ((late - early) / window for late, early in zip(after[:3], before[:3], strict=True))
    done = knots >= length - 1e-12
    if speed[-1] == 0.0:
        distance, ramp, rate = np.where(done, x[-2], distance), np.where(done, 0.0, ramp), np.where(done, 0.0, rate)
    return Profile.uniform(float(time[0]), period, start + distance, ramp, rate)


def from_steps(steps: tuple[Step, ...], until: float, start: float, period: float) -> Profile:
    """Return a profile with speed steps, as the reference of paper 002.

    Parameters
    ----------
    until
        Time of the last knot [s].
    start
        Position of vehicle 0's centre at the first step [m].
    """
    time = np.array([step.at for step in steps] + [until])
    speed = np.array([step.speed for step in steps])
    for number in np.flatnonzero(np.diff(time) <= 0):
        raise ValueError(
            f"steps: number {number} is not before the next one or before until = {until:g} s; sort the steps"
        )
    corner = np.concatenate(([0.0], np.cumsum(np.diff(time) * speed)))
    knots = time[0] + period * np.arange(knot_count(float(np.floor((until - time[0]) / period + 1e-9)) + 1))
    index = np.clip(np.searchsorted(time, knots + 1e-12, side="right") - 1, 0, speed.size - 1)
    position = start + corner[index] + speed[index] * (knots - time[index])
    return Profile.uniform(float(time[0]), period, position, speed[index], np.zeros(knots.size))
