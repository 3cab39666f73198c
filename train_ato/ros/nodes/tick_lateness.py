"""Wall times of the ticks of a run with a rate: lateness of every tick, and the time behind."""

from __future__ import annotations

import time

import numpy as np

LATE = 1.5
"""Shortest step of a late tick from the one before, in periods."""


class TickLateness:
    """Lateness of the ticks.

    Attributes
    ----------
    late : int
        Number of ticks after more than :data:`LATE` periods.
    """

    def __init__(self) -> None:
        self.late = 0
        self._lateness: list[float] = []
        self._wall = self._planned = 0.0
        self._last: int | None = None
        self._unreported: list[int] = []

    def begin(self, period: float) -> None:
        """Note the begin of a tick, due a period after the last one [s]; a period of 0 has no due time."""
        now = time.monotonic_ns()
        if self._last is not None and period > 0:
            step = (now - self._last) * 1e-9
            self._wall, self._planned = self._wall + step, self._planned + period
            self._lateness.append(step - period)
            self.late += step > LATE * period
        self._last = now
        if period > 0:
            self._unreported.append(time.time_ns())

    def restart(self) -> None:
        """Begin again after a pause, which is no lateness."""
        self._last = None

    def report(self) -> dict[str, str]:
        """Return the figures for the diagnostics, with the wall times of the ticks since the last report.

        ``wall_tick_begin_ns`` is the begin of the first of these ticks [ns since 1970], ``wall_tick_steps_us`` has the
        steps between them.
        """
        if not self._unreported:
            return {}
        begins, self._unreported = np.array(self._unreported), []
        found = {
            "wall_tick_begin_ns": str(begins[0]),
            "wall_tick_steps_us": " ".join(str(step) for step in np.diff(begins) // 1000),
        }
        if self._lateness:
            lateness = np.array(self._lateness)
            found["wall_ticks_late"] = str(self.late)
            found["wall_lateness_max_s"] = f"{max(0.0, lateness.max()):.6f}"
            found["wall_lateness_p99_s"] = f"{max(0.0, np.percentile(lateness, 99)):.6f}"
            found["wall_behind_share"] = f"{max(0.0, 1.0 - self._planned / self._wall):.6f}"
        return found
