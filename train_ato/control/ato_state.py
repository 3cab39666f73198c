"""States of the ATO and their transitions: SUBSET-125, 6.3.

========================  =====================================================================
not available             no valid measurement
available                 valid measurement; the train moves, or traction or a brake is locked
ready                     standstill, nothing locked: can be engaged
engaged                   the law drives
disengaging               traction is off, after the takeover time the train brakes to a stop
failure                   traction is off, the train brakes to a stop; until a reset at standstill
========================  =====================================================================

The ATO is engaged at the start of a run.
"""

from train_ato.messages.types import AtoState

TAKEOVER_TIME = 5.0
"""Time for the driver to take over after the end of the engagement [s]; then the train brakes: SUBSET-125, 6.3."""
TRANSITIONS = {
    "engage": (AtoState.READY, AtoState.ENGAGED, "request"),
    "disengage": (AtoState.ENGAGED, AtoState.DISENGAGING, "request"),
    "reset": (AtoState.FAILURE, AtoState.NOT_AVAILABLE, "reset"),
}
"""State that a request needs, state that follows, and its reason."""


class AtoStateMachine:
    """State of the ATO with the reason of its last change.

    Attributes
    ----------
    state : AtoState
        Present state.
    reason : str
        Reason of the last change.
    since : int
        Stamp of the last change [ns].
    """

    def __init__(self) -> None:
        self.state = AtoState.ENGAGED
        self.reason = "start of the run"
        self.since = 0

    def update(self, stamp: int, *, valid: bool, standstill: bool, locked: str) -> bool:
        """Apply the conditions of one period; return True after a change.

        Parameters
        ----------
        stamp
            Time [ns].
        valid, standstill
            Measurement valid; train at standstill.
        locked
            Traction cut-off or brake in effect as text, "" without one.
        """
        before = self.state
        if before is AtoState.ENGAGED:
            if locked:
                self._change(stamp, AtoState.DISENGAGING, locked)
        elif before is AtoState.FAILURE:
            pass
        elif not valid:
            self._change(stamp, AtoState.NOT_AVAILABLE, "no valid measurement")
        elif before is AtoState.DISENGAGING and not standstill:
            pass
        elif standstill and not locked:
            self._change(stamp, AtoState.READY, "standstill, brakes released")
        else:
            self._change(stamp, AtoState.AVAILABLE, locked or "the train moves")
        return self.state is not before

    def fail(self, stamp: int, reason: str) -> None:
        """Enter the state failure."""
        self._change(stamp, AtoState.FAILURE, reason)

    def stop(self, stamp: int, reason: str) -> None:
        """End an engagement and brake at once, without time for a driver to take over."""
        if self.state is AtoState.ENGAGED:
            self._change(stamp, AtoState.DISENGAGING, reason)
            self.since = stamp - round(TAKEOVER_TIME * 1e9)

    def check(self, request: str, *, standstill: bool) -> None:
        """Check a request without effect; ValueError with the reason of the refusal."""
        needed = TRANSITIONS[request][0]
        if self.state is not needed:
            raise ValueError(f"{request}: the ATO is {self.state.text}, not {needed.text}; wait for this state")
        if request == "reset" and not standstill:
            raise ValueError("reset: the train moves; wait for standstill")

    def request(self, stamp: int, request: str, *, standstill: bool) -> None:
        """Apply a request; errors as :meth:`check`."""
        self.check(request, standstill=standstill)
        self._change(stamp, *TRANSITIONS[request][1:])

    def brakes(self, stamp: int) -> bool:
        """Return True if the ATO brakes to a stop: after a failure, and after the takeover time."""
        if self.state is AtoState.DISENGAGING:
            return stamp - self.since >= TAKEOVER_TIME * 1e9
        return self.state is AtoState.FAILURE

    def _change(self, stamp: int, state: AtoState, reason: str) -> None:
        if state is not self.state:
            self.state, self.reason, self.since = state, reason, stamp
