"""Pairing of a measurement with the report of the ATO of the supervision period before."""

from __future__ import annotations

from train_ato.loop.setup import RunSetup
from train_ato.messages.types import AtoReport, Measurement


class AwaitedReport:
    """Holds back a measurement until the report of the period before has arrived.

    If the next measurement comes first, the held one is released with the newest report: without lockstep the plant
    does not wait.

    Parameters
    ----------
    setup
        Prepared run with its supervision period.

    Attributes
    ----------
    ignored : int
        Number of duplicate and late messages.
    """

    def __init__(self, setup: RunSetup) -> None:
        self._setup = setup
        self._period_ns = setup.supervision_ticks * setup.tick_ns
        self._held: Measurement | None = None
        self._report: AtoReport | None = None
        self._last = -1
        self.ignored = 0

    @property
    def waits(self) -> bool:
        """True if a measurement is held back."""
        return self._held is not None

    def put(self, message: Measurement) -> list[tuple[Measurement, AtoReport | None]]:
        """Add a measurement; return the pairs that are complete, in order."""
        if message.stamp <= self._last:
            self.ignored += 1
            return []
        self._last = message.stamp
        ready = [] if self._held is None else [(self._held, self._report)]
        self._held = message
        return ready + self._complete()

    def report(self, report: AtoReport) -> list[tuple[Measurement, AtoReport | None]]:
        """Add a report of the ATO; return the pair that it completes."""
        if self._report is not None and report.stamp <= self._report.stamp:
            self.ignored += 1
            return []
        self._report = report
        return self._complete()

    def _complete(self) -> list[tuple[Measurement, AtoReport | None]]:
        held, report = self._held, self._report
        if held is None:
            return []
        supervised = self._setup.supervised_at(held.stamp)
        if supervised and held.stamp > 0 and (report is None or report.stamp < held.stamp - self._period_ns):
            return []
        self._held = None
        return [(held, report if supervised and held.stamp > 0 else None)]
