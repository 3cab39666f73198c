"""Progress and end of a run whose plant is a program outside of this project, as the recorder sees them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from train_ato.judge.run_end import DONE, FAILED, RunEnd
from train_ato.messages.topics import BY_NAME, Role
from train_ato.ros.nodes.answer_watch import AnswerWatch, awaited_node, departure, silent_node

if TYPE_CHECKING:
    from train_ato.ros.nodes.recorder import RecorderNode
    from train_ato.scenario.setup import RunSetup

MEASUREMENT = "train/measurement"
TRUTH = "train/vehicles"


class OutsidePlant:
    """External plant, in place of the plant node in the process of the recorder.

    The run is complete with the measurement after the last tick, or with the state of the vehicles there.

    Parameters
    ----------
    setup
        Prepared run.
    recorder
        Recorder of the run.
    timeout
        Wall time after which a missing message is a failure [s].
    """

    def __init__(self, setup: RunSetup, recorder: RecorderNode, timeout: float) -> None:
        self._setup = setup
        self._recorder = recorder
        self._timeout = timeout
        self._interruption: str | None = None
        self._heard = -1, -1
        self._watch = AnswerWatch()
        self._answering = [Role.PROFILE, Role.OBSERVER, Role.CONTROLLER]
        self._end_ns = setup.ticks * setup.tick_ns

    def begin(self) -> None:
        """Wait for the first measurement from now on."""
        self._watch.begin()

    def announce_end(self) -> None:
        """Send no end notice: the program is no node of this project."""

    @property
    def tick(self) -> int:
        """Number of complete ticks."""
        return min(max(0, *map(self._recorder.last_stamp, (MEASUREMENT, TRUTH))), self._end_ns) // self._setup.tick_ns

    @property
    def sent_stamp(self) -> int:
        """Stamp of the last measurement of a tick [ns], -1 before the first."""
        return min(self._recorder.last_stamp(MEASUREMENT), self._end_ns - self._setup.tick_ns)

    @property
    def supervised_stamp(self) -> int:
        """Stamp of the last odometry of a tick [ns], -1 without one."""
        return min(self._recorder.last_stamp("train/odometry"), self._end_ns - 1)

    @property
    def answered(self) -> bool:
        """True if every node has answered the last measurement, as recorded."""
        return all(self._recorder.last_stamp_of(role) >= self.sent_stamp for role in self._answering)

    @property
    def finished(self) -> bool:
        """True after the last tick, a request to stop, or an end notice of the program."""
        complete = self.tick >= self._setup.ticks
        return complete or self._interruption is not None or self._recorder.endpoints.end is not None

    @property
    def end(self) -> RunEnd:
        """End of the run with status and reason."""
        notice = self._recorder.endpoints.end
        told = None if notice is None else RunEnd.of(notice)
        failure, interruption = self._recorder.endpoints.watch.failure, self._interruption
        if told is not None and told.status == FAILED:
            failure = failure or told.reason
        elif told is not None and told.status != DONE:
            interruption = told.reason
        return RunEnd.judged(self.tick, self._setup.ticks, failure, interruption)

    def request_stop(self, reason: str = "stopped by a request") -> None:
        """End the run at once."""
        self._interruption = f"{reason} at {self.tick * self._setup.tick:.3f} s"

    def check_overdue(self) -> bool:
        """Return True if neither a measurement nor a command has come for longer than the time-out."""
        self._watch.check()
        heard = self.sent_stamp, self._recorder.last_stamp_of(Role.CONTROLLER)
        if heard != self._heard:
            self._heard = heard
            self._watch.heard = time.monotonic()
        return not self.finished and self._watch.silent_for(released=False) > self._timeout

    def lose_departed(self, gone: Sequence[Role]) -> None:
        """Fail the run by the program that has left."""
        self._recorder.endpoints.watch.fail(gone[0].value, departure(gone, self.tick * self._setup.tick_ns))

    def lose_silent(self, last: Mapping[Role, int], awaited: Mapping[Role, str]) -> None:
        """Fail the run by the node that is silent; arguments as of the plant node."""
        sent, watch = self.sent_stamp, self._recorder.endpoints.watch
        supervised = self.supervised_stamp if self._setup.layout.supervised else -1
        answered = all(last.get(role, -1) >= sent for role in self._answering)
        if answered and last.get(Role.SUPERVISOR, -1) >= supervised:
            after = "no measurement" if sent < 0 else f"no measurement after that of {sent * 1e-9:.3f} s"
            watch.fail(Role.PLANT.value, f"{after} within {self._timeout:g} s")
            return
        role, chain = awaited_node(silent_node(last, sent, blocked=False, supervised=supervised), awaited)
        topic = awaited.get(role, "")
        if topic in BY_NAME and BY_NAME[topic].publishers == (Role.PLANT,):
            role, chain = Role.PLANT, f": node {role.value} waits for its {topic}"
        watch.fail(role.value, f"no answer to stamp {sent * 1e-9:.3f} s within {self._timeout:g} s{chain}")
