"""Date and time of day of recorders: ISO 8601, or day.month.year."""

from __future__ import annotations

import re
from datetime import datetime, timezone

_FRACTION = re.compile(r"[.,](\d+)$|[.,](\d+)(?=[Z+-])")
_DAY_FIRST = re.compile(r"^(\d{1,2})\.(\d{1,2})\.(\d{4})(?:[ T]+|,\s*)(\d{1,2})(:\d{2}(?::\d{2}(?:[.,]\d+)?)?)$")


def date_and_time(text: str) -> datetime:
    """Return a moment; without a time zone it is UTC.

    Parameters
    ----------
    text
        ``2026-03-01T08:15:30.5``, ``2026-03-01 08:15:30``, or ``01.03.2026 08:15:30,5``.

    Raises
    ------
    ValueError
        If it is neither form, for example ``03/01/2026``, whose month is ambiguous.
    """
    if (parts := _DAY_FIRST.match(text)) is not None:
        day, month, year, hour, rest = parts.groups()
        text = f"{year}-{int(month):02d}-{int(day):02d}T{int(hour):02d}{rest}"
    plain = _FRACTION.sub(lambda match: "." + (match[1] or match[2])[:6].ljust(6, "0"), text).replace("Z", "+00:00")
    moment = datetime.fromisoformat(plain)
    return moment if moment.tzinfo is not None else moment.replace(tzinfo=timezone.utc)
