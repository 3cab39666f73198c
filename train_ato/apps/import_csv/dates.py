"""Date and time of day of recorders: ISO 8601, day.month.year, month/day/year, a time of day alone, Unix time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone

__all__ = ["DATE", "TIME_OF_DAY", "moments"]

_FRACTION = re.compile(r"[.,](\d+)$|[.,](\d+)(?=[Z+-])")
_DAY_FIRST = re.compile(r"^(\d{1,2})\.(\d{1,2})\.(\d{4})(?:[ T]+|,\s*)(\d{1,2})(:\d{2}(?::\d{2}(?:[.,]\d+)?)?)$")
_SLASHES = re.compile(r"^(\d{1,2})/(\d{1,2})/(\d{4})(?:[ T]+|,\s*)(\d{1,2})(:\d{2}(?::\d{2}(?:[.,]\d+)?)?)$")
_HALF = re.compile(r"^(.*?)(\d{1,2})(:\d{2}(?::\d{2}(?:[.,]\d+)?)?)\s*([AaPp])\.?[Mm]\.?$")
_UNIX = re.compile(r"^\d{10}(?:\d{3})?(?:[.,]\d+)?$")
TIME_OF_DAY = re.compile(r"^\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d+)?)?(?:\s*[AaPp]\.?[Mm]\.?)?$")
"""Time of day without a date."""
DATE = re.compile(r"^(?:\d{4}-\d{1,2}-\d{1,2}|\d{1,2}[./]\d{1,2}[./]\d{4})$")
"""Date without a time of day."""
DAY = 86_400_000_000
"""Microseconds of a day."""
_ZERO, _UNIT = datetime(2000, 1, 1, tzinfo=timezone.utc), timedelta(microseconds=1)
MILLISECONDS = 1e11
"""Unix times above it are in milliseconds."""


def moments(texts: Sequence[str]) -> list[float | None]:
    """Return the seconds of the moments of a column from the first one on; None for a text that is no date and time.

    Times of day alone pass midnight where they fall by more than 12 h. The order of day and month in ``03/01/2026`` is
    the one that all rows have; where both are possible, the one with the shorter run.
    """
    orders = [[_microseconds(text, first) for text in texts] for first in ("month", "day")]
    best = min(orders, key=lambda found: (found.count(None), _length(found)))
    clocks = all(TIME_OF_DAY.match(text) for text in texts)
    found: list[float | None] = []
    days, last = 0, None
    zero = next((value for value in best if value is not None), 0)
    for value in best:
        if value is not None and clocks:
            days += DAY if last is not None and value + days < last - DAY // 2 else 0
            value += days  # the day of the value
            last = value
        found.append(None if value is None else (value - zero) / 1e6)
    return found


def _length(values: Sequence[int | None]) -> int:
    known = [value for value in values if value is not None]
    return max(known) - min(known) if known else 0


def _microseconds(text: str, first: str) -> int | None:
    """Return a moment in microseconds, in UTC without a zone; ``first`` of month and day in a date with slashes."""
    if _UNIX.match(text):
        value = float(text.replace(",", "."))
        return round(value * (1e3 if value > MILLISECONDS else 1e6))
    if (half := _HALF.match(text)) is not None:
        before, hour, rest, letter = half.groups()
        if not 1 <= int(hour) <= 12:
            return None
        text = f"{before}{int(hour) % 12 + (12 if letter in 'Pp' else 0)}{rest}"
    if TIME_OF_DAY.match(text):
        text = f"2000-01-01T{text.zfill(len(text) + 1) if text[1] == ':' else text}"
    for pattern in (_DAY_FIRST, _SLASHES):
        if (parts := pattern.match(text)) is not None:
            day, month, year, hour, rest = parts.groups()
            if pattern is _SLASHES and first == "month":
                day, month = month, day
            text = f"{year}-{int(month):02d}-{int(day):02d}T{int(hour):02d}{rest}"
    plain = _FRACTION.sub(lambda match: "." + (match[1] or match[2])[:6].ljust(6, "0"), text).replace("Z", "+00:00")
    plain = re.sub(r"([ T])(\d):", r"\g<1>0\2:", plain)
    try:
        moment = datetime.fromisoformat(plain)
    except ValueError:
        return None
    return ((moment if moment.tzinfo is not None else moment.replace(tzinfo=timezone.utc)) - _ZERO) // _UNIT
