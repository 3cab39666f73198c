"""End of a run: status and reason, as the plant sends them on ``train/end`` and as ``summary.json`` has them."""

from dataclasses import dataclass

from train_ato.messages.types import Diagnostic

DONE, INTERRUPTED, FAILED = "done", "interrupted", "failed"
RESET = "reset by a request"
"""Begin of the reason of a run that its runner begins again."""
LEVELS = {DONE: 0, INTERRUPTED: 1, FAILED: 2}
"""Level of the end notice by status."""


@dataclass(frozen=True)
class RunEnd:
    """End of a run.

    Attributes
    ----------
    status
        ``done``: all planned ticks; ``interrupted``: fewer ticks, by a request or a signal; ``failed``.
    reason
        One line; "" for ``done``.
    ticks
        Number of complete ticks, ticks without a command included.
    """

    status: str
    reason: str
    ticks: int

    @classmethod
    def judged(cls, ticks: int, planned: int, failure: str | None, interruption: str | None) -> "RunEnd":
        """Return the end of a run from its ticks; a run with fewer ticks than planned is never ``done``.

        Parameters
        ----------
        ticks, planned
            Numbers of complete and of planned ticks.
        failure
            Failed node and reason, or None.
        interruption
            Signal or request that ended the run, "" for an unknown one, None without one.
        """
        if failure is not None:
            return cls(FAILED, failure, ticks)
        if interruption is not None or ticks < planned:
            return cls(INTERRUPTED, interruption or f"ended after {ticks} of {planned} ticks", ticks)
        return cls(DONE, "", ticks)

    def notice(self, stamp: int) -> Diagnostic:
        """Return the end notice of the plant for the last stamp [ns]."""
        values = {"status": self.status, "ticks": str(self.ticks)}
        return Diagnostic(stamp, "plant", LEVELS[self.status], self.reason, values)

    @classmethod
    def of(cls, notice: Diagnostic) -> "RunEnd | None":
        """Return the end in an end notice; None for a notice without a known status and a number of ticks."""
        status, ticks = notice.values.get("status", ""), notice.values.get("ticks", "")
        return cls(status, notice.message, int(ticks)) if status in LEVELS and ticks.isdecimal() else None
