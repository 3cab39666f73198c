"""Limit of the rate of the simulation: simulated seconds per second of wall time."""

import time

_MAX_LAG_S = 0.2


class SteadyRateLimit:
    """Calculates the wait before a tick for a loop that must not sleep; the factor may change during a run.

    A delay above 0.2 s is not caught up.

    Parameters
    ----------
    tick
        Simulated seconds of one tick.
    factor
        Maximum simulated seconds per second of wall time; 0 never waits.
    """

    def __init__(self, tick: float, factor: float = 0.0) -> None:
        self._tick = tick
        self.factor = factor
        self._origin: tuple[float, int] | None = None

    def change(self, factor: float) -> None:
        """Set the factor from the next tick on."""
        self.factor = factor
        self._origin = None

    def restart(self) -> None:
        """Restart the clock at the next tick, so that a pause is not caught up."""
        self._origin = None

    def wait(self, ticks: int) -> float:
        """Return the wait before the next tick after ``ticks`` ticks [s], for a factor above 0."""
        now = time.monotonic()
        if self._origin is None:
            self._origin = (now, ticks)
        begin, first = self._origin
        ahead = begin + (ticks - first) * self._tick / self.factor - now
        if ahead < -_MAX_LAG_S:
            self._origin = (now, ticks)
        return max(0.0, ahead)
