"""Profile files: CSV and YAML, position, speed and acceleration over time, SI unless a key carries a unit suffix."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from train_ato.profile.knots import knot_count
from train_ato.profile.profile import Profile
from train_ato.types import Array

__all__ = ["SCHEMA", "csv_text", "parse_csv", "read_profile", "write_profile"]

SCHEMA = "train_ato/profile/1"
LARGEST_FILE = 256 * 2**20
"""Files beyond this many bytes are refused."""
UNITS: dict[str, dict[str, float]] = {
    "time": {"": 1.0, "_s": 1.0, "_ms": 1e-3, "_min": 60.0},
    "position": {"": 1.0, "_m": 1.0, "_km": 1000.0},
    "speed": {"": 1.0, "_m_s": 1.0, "_kmh": 1 / 3.6},
    "acceleration": {"": 1.0, "_m_s2": 1.0},
}
"""SI value of one unit of every column, by the suffix of its name."""


def read_profile(path: Path, period: float | None = None) -> Profile:
    """Read a profile.

    ``time`` and ``speed`` must be there; a missing ``position`` is integrated from 0, a missing ``acceleration`` taken
    from the speed.  Times need not be evenly spaced if a period is asked for.

    Parameters
    ----------
    path
        ``*.csv``, ``*.yaml`` or ``*.yml``.
    period
        Of the knots [s]; None keeps those of the file.

    Raises
    ------
    ValueError
        One line that names the file, the column and the row.
    """
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ValueError(f"{path}: larger than {LARGEST_FILE} bytes; not a profile")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read ({error.__class__.__name__}); name a readable profile file") from None
    try:
        if path.suffix.lower() in (".yaml", ".yml"):
            return _parse_yaml(text, period)
        return parse_csv(text, period)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def parse_csv(text: str, period: float | None = None) -> Profile:
    """Return the profile of a CSV text: ``#`` lines are comments, then one row of names, then numbers."""
    rows = (
        (number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line.lstrip()[0] != "#"
    )
    first = next(rows, None)
    if first is None:
        raise ValueError("no row of column names; the first row names time, position, speed, acceleration")
    names = [name.strip() for name in next(csv.reader([first[1]]))]
    columns: dict[str, list[float]] = {name: [] for name in names}
    if len(columns) != len(names):
        raise ValueError(f"line {first[0]}: a column is named twice in {', '.join(names)}")
    for number, line in rows:
        cells = line.split(",")
        if len(cells) != len(names):
            raise ValueError(f"line {number}: {len(cells)} values for the {len(names)} columns {', '.join(names)}")
        name = ""
        try:
            for name, cell in zip(names, cells, strict=True):
                columns[name].append(float(cell))
        except ValueError:
            raise ValueError(f"line {number}, {name}: '{line.strip()[:40]}' is not all numbers") from None
    return _assemble(dict(columns), period)


def _parse_yaml(text: str, period: float | None) -> Profile:
    try:
        data = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except yaml.YAMLError as error:
        raise ValueError("not valid YAML: " + " ".join(str(error).split())) from None
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise ValueError(f"schema: a profile file is a mapping with the line 'schema: {SCHEMA}'")
    data = {key: value for key, value in data.items() if key not in ("schema", "name", "source", "summary")}
    start, own = data.pop("start", 0.0), data.pop("period", None)
    columns = {name: value for name, value in data.items() if isinstance(value, list)}
    if len(columns) != len(data):
        name = next(name for name in data if name not in columns)
        raise ValueError(f"{name}: unknown key or not a list of numbers (known: start, period, {', '.join(UNITS)})")
    if own is not None:
        if not isinstance(own, (int, float)) or not isinstance(start, (int, float)) or own <= 0:
            raise ValueError(f"period, start: '{own}', '{start}' are not numbers of seconds, the period > 0")
        length = len(next(iter(columns.values()), []))
        columns["time"] = [(round(start * 1e9) + round(own * 1e9) * k) * 1e-9 for k in range(length)]
    return _assemble(columns, period)


def _assemble(columns: dict[str, Any], period: float | None) -> Profile:
    """Turn named columns with unit suffixes into a profile."""
    found: dict[str, Array] = {}
    for name, values in columns.items():
        quantity = next((q for q in UNITS if name == q or name.removeprefix(q) in UNITS[q]), None)
        if quantity is None or name.removeprefix(quantity) not in UNITS[quantity]:
            known = ", ".join(f"{q}[{'|'.join(s for s in UNITS[q] if s)}]" for q in UNITS)
            raise ValueError(f"column '{name}' is not known; columns are {known}")
        if quantity in found:
            raise ValueError(f"column '{name}' says {quantity} a second time; keep one")
        try:
            found[quantity] = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise ValueError(f"column '{name}' holds something that is not a number") from None
        factor = UNITS[quantity][name.removeprefix(quantity)]
        if factor != 1.0:
            found[quantity] = found[quantity] * factor
    missing = [quantity for quantity in ("time", "speed") if quantity not in found]
    if missing:
        raise ValueError(f"column '{missing[0]}' is missing; a profile needs time and speed")
    return _complete(found, period)


def _complete(found: dict[str, Array], period: float | None) -> Profile:
    time, speed = found["time"], found["speed"]
    for name, column in found.items():
        if column.size != time.size or column.ndim != 1:
            raise ValueError(f"column '{name}' has {column.size} values, time has {time.size}")
        wrong = np.flatnonzero(~np.isfinite(column))
        if wrong.size:
            raise ValueError(f"column '{name}', value {wrong[0] + 1} is {column[wrong[0]]}; it must be finite")
    if time.size < 2:
        raise ValueError("a profile needs at least two rows")
    falling = np.flatnonzero(np.diff(time) <= 0)
    if falling.size:
        raise ValueError(
            f"time {time[falling[0] + 1]:g} s does not lie beyond the row before; rows are in order of time"
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
        raise ValueError("times are not evenly spaced; say at which period the profile is wanted")
    return _from_uneven(time, found["position"], speed, a, period)


def _from_uneven(time: Array, position: Array, speed: Array, acceleration: Array, period: float) -> Profile:
    """Read unevenly spaced rows at even times by the same polynomials as between the knots of a profile."""
    start = float(time[0])
    count = knot_count(float(np.floor((time[-1] - start) / period + 1e-9)) + 1)
    rest = abs(speed[-1]) <= 1e-3 and start + (count - 1) * period < time[-1] - 1e-9
    knots = start + period * np.arange(count)
    k = np.clip(np.searchsorted(time, knots, side="right") - 1, 0, time.size - 2)
    h, s = time[k + 1] - time[k], knots - time[k]

    def hermite(y: Array, d: Array) -> tuple[Array, Array]:
        slope = (y[k + 1] - y[k]) / h
        c2, c3 = (3 * slope - 2 * d[k] - d[k + 1]) / h, (d[k] + d[k + 1] - 2 * slope) / h**2
        return y[k] + s * (d[k] + s * (c2 + s * c3)), d[k] + s * (2 * c2 + 3 * s * c3)

    x = hermite(position, speed)[0]
    v, a = hermite(speed, acceleration)
    if rest:
        x, v, a = np.append(x, position[-1]), np.append(v, 0.0), np.append(a, 0.0)
    return Profile.uniform(start, period, x, v, a)


def csv_text(profile: Profile, source: str = "") -> str:
    """Return a profile as CSV in SI, every number written so that reading it gives the same bits."""
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
    """Write a profile as CSV or, by the file's suffix, as YAML; the source goes into its head.

    Raises
    ------
    ValueError
        If the suffix is neither ``.csv`` nor ``.yaml`` or the file cannot be written.
    """
    suffix = path.suffix.lower()
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
        raise ValueError(f"{path}: a profile is written as .csv or .yaml; choose one of these endings")
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ValueError(f"{path}: cannot be written ({error.strerror}); choose another place") from None
