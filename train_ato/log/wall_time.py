"""Wall time of a recording: a metadata record of the log, because every message has simulated times."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode

from train_ato.log.mcap_records import metadata_of, records
from train_ato.log.reading import readable

WALL_TIME = "wall_time"
"""Name of the metadata record."""


def clock_ns() -> int:
    """Return the wall time [ns since 1970]."""
    return time.time_ns()


@dataclass(frozen=True)
class WallTime:
    """Wall time of a recording.

    Attributes
    ----------
    begin_ns : int
        Opening of the log [ns since 1970].
    duration_s : float or None
        Wall time from the opening to the closing of the log [s]; None for the log of a killed run.
    """

    begin_ns: int
    duration_s: float | None = None

    @classmethod
    def now(cls) -> WallTime:
        """Return the wall time of a recording that begins now."""
        return cls(clock_ns())

    def ended(self) -> WallTime:
        """Return the wall time of the recording with its end now."""
        return replace(self, duration_s=(clock_ns() - self.begin_ns) * 1e-9)

    @property
    def begin(self) -> str:
        """Opening of the log, ISO 8601 in UTC, to the millisecond."""
        found = datetime.fromtimestamp(self.begin_ns * 1e-9, timezone.utc)
        return found.isoformat(timespec="milliseconds").replace("+00:00", "Z")

    def record(self) -> dict[str, str]:
        """Return the content of the metadata record."""
        found = {"begin": self.begin, "begin_ns": str(self.begin_ns)}
        return found if self.duration_s is None else {**found, "duration_s": f"{self.duration_s:.3f}"}

    def listed(self) -> dict[str, Any]:
        """Return the record with numbers, for JSON."""
        return {"begin": self.begin, "begin_ns": self.begin_ns, "duration_s": self.duration_s}

    @classmethod
    def of(cls, record: Mapping[str, str]) -> WallTime | None:
        """Return the wall time of a metadata record; None if its numbers cannot be read or do not fit its text."""
        try:
            duration = record.get("duration_s")
            found = cls(int(record["begin_ns"]), None if duration is None else float(duration))
            return found if found.begin == record["begin"] else None
        except (KeyError, ValueError, OverflowError, OSError):
            return None


def read_wall_time(path: Path, *, broken: bool = False) -> WallTime | None:
    """Return the wall time of a log; None for a log without the record, as of another recorder.

    Parameters
    ----------
    path
        MCAP file.
    broken
        Stop at the first damage without an error.

    Raises
    ------
    ValueError
        If the file is not a log or damaged.
    """
    found = None
    with readable(path, broken=broken), path.open("rb") as file:
        for entry in records(file, path.stat().st_size):
            if entry.code == Opcode.METADATA and (record := metadata_of(entry.content)).name == WALL_TIME:
                found = WallTime.of(record.metadata) or found
    return found
