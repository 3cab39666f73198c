"""Run of a standalone node: started by hand, by a launch file, or by ``train-ato run --processes``.

The other nodes end after the plant; the recorder ends after the last publisher.
"""

import gc
import re
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rcl_interfaces.msg import Log as LogMessage

from train_ato.control.component_fault import ComponentFailed
from train_ato.judge.run_end import INTERRUPTED
from train_ato.messages.topics import BY_NAME, Role
from train_ato.messages.types import Tick
from train_ato.ros.graph.environment import opened_by
from train_ato.ros.graph.graph_result import IGNORED, STOPPING_S
from train_ato.ros.nodes.answer_watch import GONE, LEASE_S
from train_ato.ros.nodes.endpoints import ROSOUT, NodeEndpoints
from train_ato.ros.standalone.discovery import Discovery, answer_ready
from train_ato.ros.standalone.notices import (
    FAILURE,
    INTERRUPTION,
    LAST_COUNT,
    NOTE,
    OUTSIDE,
    READY,
    STOP_TRAIN,
    TRAIN_STOPPED,
    EndOrder,
    Notice,
    NoticeKind,
    Notices,
)

TURN_S = 0.1
RECORD_S = 0.02
"""Period of polling the recorder's queues [s]; at 10 000 ticks a second they fill by 200 of 1000 messages."""
CUT = f"its messages ended without the notice of the end of the run: {GONE}"
"""Reason of the failure of a plant that has left."""
SUSPENDED = (
    f"its process was suspended for {{:.1f}} s; after {LEASE_S:g} s the other nodes drop it and messages are lost"
)
"""Reason of the failure of a suspended node."""
NOTICE_S = 1.0
"""Maximum wall time for the notice of the end of the run to be read after the plant has left [s]."""
ANNOUNCE_S = 0.1
"""Wall time between two messages of a connected recorder before the first message of the run [s]."""
SILENCE_S = 5.0
"""Wall time without a message after which the recording ends, if the plant has sent the notice of the end [s]."""
JOINING_S = 0.02
"""Period of the checks for missing endpoints of a restarted node [s]."""
HEARING = 20
"""Number of callbacks run before the reason of a node that has left is read; more than wait at once."""
SAID = re.compile(rf"(?:(?P<begin>{TRAIN_STOPPED}|{STOP_TRAIN}): )?node (?P<node>\S+) failed: (?P<reason>.*)")
"""Line on ``/rosout`` with the failure of a node."""
REPORT_EVERY_S = 3.0
"""Wall time between two reports of missing nodes [s]."""


class StandaloneRunner:
    """Runs the executor of one node until the end of the run or Ctrl-C.

    Parameters
    ----------
    role, node, endpoints, executor
        The node.
    stopped
        Set by Ctrl-C, SIGTERM, or the end of an attached process.
    fingerprint
        Fingerprint of the node's scenario.
    recorded
        For the plant: do not begin without a recorder.
    attached
        Print the progress, at the end the counts, for the process that started this one.
    notices
        Notices of the process that started this one.
    restarted
        For the new process of a node: stamp at which the old one has left the run [ns].

    Attributes
    ----------
    first_heard, last_heard : float
        Monotonic wall time of the recorder's first and last message [s].
    """

    def __init__(
        self,
        role: Role,
        node: Any,
        endpoints: NodeEndpoints,
        executor: Any,
        *,
        stopped: EndOrder,
        fingerprint: dict[str, str],
        recorded: bool,
        attached: bool,
        notices: Notices,
        restarted: int | None,
    ) -> None:
        self.role = role
        self.node = node
        self.endpoints = endpoints
        self._executor = executor
        self._stopped = stopped
        self._attached = attached
        self._notices = notices
        self._restarted = restarted
        self._away: dict[Role, int] = {}
        self._continued = threading.Event()
        self._met = False
        self._suspended = 0.0
        self.first_heard = self.last_heard = self._announced = 0.0
        self._next_report = time.monotonic() + REPORT_EVERY_S
        if attached:
            endpoints.on_note = lambda text: self._say(NOTE, text)
        self._discovery = None
        self._said: dict[str, re.Match[str]] = {}
        if role is Role.PLANT:
            self._discovery = Discovery(endpoints, fingerprint, recorded, self._recorder_connected)
        if (role is Role.PLANT and not attached) or role is Role.CONTROLLER:
            endpoints.node.create_subscription(LogMessage, "/rosout", self._hear, ROSOUT)
        if role is Role.OBSERVER and endpoints.external is not Role.CONTROLLER:
            node.stage.on_fault = lambda fault: endpoints.log(f"{STOP_TRAIN}: node {role.value} failed: {fault}")
        if role not in (Role.PLANT, Role.RECORDER):
            answer_ready(endpoints, fingerprint)

    def run(self) -> int:
        """Run the node; return the exit status."""
        gc.freeze()
        gc.enable()
        signal.signal(signal.SIGCONT, lambda *_: self._continued.set())
        {Role.PLANT: self._drive, Role.RECORDER: self._record}.get(self.role, self._follow)()
        if self.role is Role.PLANT:
            self.node.announce_end()
        if self.endpoints.watch.failure is not None:
            stopped = f"{TRAIN_STOPPED}: " if self._train_stopped else ""
            self.endpoints.log(f"{stopped}{self.endpoints.watch.failure}")
        self.endpoints.deliver(STOPPING_S)
        ignored = getattr(self.node, "ignored", 0)
        if self._attached:
            if self._left_early:
                self._say(FAILURE, f"its process was ended by {self._stopped.signal}")
            elif self.role is Role.PLANT and self.node.end.status == INTERRUPTED:
                self._say(INTERRUPTION, self.node.end.reason)
            self._print_counts(ignored)
        elif ignored:
            sys.stderr.write(f"{self.role.value}: {ignored} {IGNORED}\n")
        if self.endpoints.watch.failure is not None:
            if self._attached:
                self._say(FAILURE, self.endpoints.watch.failure)
            with suppress(OSError):  # full disk
                sys.stderr.write(f"{self.endpoints.watch.failure}\n")
        return int(self.endpoints.watch.failure is not None or self._left_early)

    @property
    def _left_early(self) -> bool:
        """True for an attached node that a signal has ended before the run."""
        return self._attached and bool(self._stopped.signal) and self.role is not Role.PLANT and not self.endpoints.end

    def _say(self, kind: str, text: str) -> None:
        """Print a line for the process that started this one."""
        with suppress(OSError):  # the other process has ended
            sys.stdout.write(f"{kind}{' '.join(text.split())}\n")
            sys.stdout.flush()

    def _print(self, name: str, *values: int) -> None:
        if self._attached:
            self._say(f"{name}:", " ".join(str(value) for value in values))

    def _print_counts(self, ignored: int) -> None:
        """Print the numbers of messages and the wall times of the controller's steps."""
        for topic, count in self.endpoints.published.items():
            self._print(f"published {topic}", count)
        if self.role is Role.RECORDER:
            for topic, count in self.node.log.counts.items():
                self._print(f"recorded {topic}", count)
            if self.endpoints.external is not None:
                self._say(OUTSIDE, self.endpoints.external_name)
        if self.role is Role.CONTROLLER:
            self._print("step_ns", *self.node.stage.step_times)
            if self._train_stopped:
                self._print(TRAIN_STOPPED, 1)
        self._print(LAST_COUNT, ignored)

    @property
    def _train_stopped(self) -> bool:
        """True for a controller that has braked the train after the failure of a component."""
        return self.role is Role.CONTROLLER and self.endpoints.watch.of_component

    @property
    def _ends(self) -> bool:
        return self._stopped.is_set() or self.endpoints.watch.failure is not None

    def _follow(self) -> None:
        """Answer measurements until the plant ends."""
        if self._restarted is not None:
            self.node.join(self._restarted)
            self._rejoin()
            self.node.join(self._restarted)
        if self.role is Role.PROFILE:
            self.endpoints.guard(self.node.begin)
        of_plant = next(name for name in self.endpoints.subscribed if Role.PLANT in BY_NAME[name].publishers)
        connected = self.endpoints.external is not Role.PLANT
        turned = time.monotonic()
        while not self._ends and not self._left(of_plant):
            self._executor.spin_once(timeout_sec=TURN_S)
            self._suspended = max(self._suspended, time.monotonic() - turned)
            turned = time.monotonic()
            self._take_notices()
            if not connected and not self.endpoints.missing((Role.RECORDER,)):
                connected = True
                self._print(READY, 1)
        self._check_end(lambda: self._executor.spin_once(timeout_sec=TURN_S))
        if self.role is Role.OBSERVER and self.node.stage.failure is not None:
            self.endpoints.watch.fail(self.role.value, self.node.stage.failure)

    def _check_end(self, turn: Callable[[], None]) -> None:
        """Fail the run by the name of the plant if it has left without the notice of the end."""
        suspended = self.node.suspended if self.role is Role.RECORDER else self._suspended
        last = time.monotonic() + NOTICE_S
        while not self._ends and self.endpoints.end is None and time.monotonic() < last:
            turn()
        if self._ends or self.endpoints.end is not None:
            return
        if self._continued.is_set() and suspended > LEASE_S:  # a loaded machine only delays it
            self.endpoints.watch.fail(self.role.value, SUSPENDED.format(suspended))
        else:
            self.endpoints.watch.fail(Role.PLANT.value, CUT)

    def _rejoin(self) -> None:
        """Wait until all endpoints are connected and no message waits: answers that are caught up would be a jump.

        The messages before are handled without an answer, so that the first answer takes no longer than the others.
        """
        endpoints, handled = self.endpoints, -1
        endpoints.joining = True
        while not self._ends and (endpoints.missing((Role.RECORDER,)) or handled != endpoints.handled):
            self._executor.spin_once(timeout_sec=JOINING_S)
            self._take_notices()
            handled = endpoints.handled
            self._executor.spin_once(timeout_sec=0.0)
        endpoints.joining = False

    def _take_notices(self) -> None:
        """Follow the notices; report each restarted node whose old publishers have left."""
        while self._notices is not None and not self._notices.empty():
            self._follow_notice(self._notices.get())
        for role in [role for role in self._away if self.endpoints.left(role)]:
            self.endpoints.renew(role)
            self._print(f"without {role.value}", self._away.pop(role), self.endpoints.last_stamp)

    def _follow_notice(self, notice: Notice) -> None:
        if notice.kind is NoticeKind.LOST and self.role is Role.PLANT:
            self.node.lose(notice.role, notice.text)
        elif notice.kind is NoticeKind.FAILED and self.role is Role.PLANT:
            self.endpoints.watch.fail(notice.role.value, notice.text)
        elif notice.kind is NoticeKind.AWAY:
            number, _, reason = notice.text.partition(" ")
            self._away[notice.role] = int(number)
            if self.role in (Role.PLANT, Role.CONTROLLER):
                self.node.await_return(notice.role, reason)

    def _record(self) -> None:
        """Record until the last publisher ends, and close the log; other programs may publish /diagnostics.

        A program in place of a node may run on: after the notice of the end, silence ends the recording too.
        """
        alone = [name for name in self.endpoints.subscribed if len(BY_NAME[name].publishers) == 1]
        topics = [name for name in alone if not self.endpoints.sent_outside(name)]
        while not self._ends and not (self._left(*topics) and self.node.answered) and not self._silent_after_end():
            self.endpoints.guard(self._poll)
            self._announce_connected()
            self._take_notices()
            time.sleep(RECORD_S)
        self._check_end(lambda: time.sleep(RECORD_S))
        self.endpoints.guard(lambda: self.node.close(None))

    def _announce_connected(self) -> None:
        """Send the plant the message of a connected recorder, before the first measurement.

        A publisher that has found the recorder may not be found by it yet, and its first messages would be lost.
        """
        if self.node.measured or time.monotonic() < self._announced + ANNOUNCE_S:
            return
        self._announced = time.monotonic()
        if absent := self.endpoints.missing():
            self._report_waiting(f"recorder waits for {', '.join(absent)}")
        else:
            self.endpoints.repeat("recorder/progress", Tick(0))

    def _recorder_connected(self) -> bool:
        """Return True if the recorder was connected a moment ago: less than the lease of an ended node."""
        return bool(time.monotonic() - self.node.recorder_heard < LEASE_S / 2)

    def _silent_after_end(self) -> bool:
        """Return True if the plant has ended, and no message has come for :data:`SILENCE_S`."""
        return self.endpoints.end is not None and time.monotonic() - self.last_heard > SILENCE_S

    def _poll(self) -> None:
        # a second publisher, which has failed the run, may go on for ever
        if self.node.poll() and not (self.node.wrong and self.endpoints.end):
            self.last_heard = time.monotonic()
            self.first_heard = self.first_heard or self.last_heard

    def _left(self, *topics: str) -> bool:
        """Return True if the topics had publishers and have none any more."""
        senders = sum(self.endpoints.senders(topic) for topic in topics)
        self._met = self._met or senders > 0
        return self._met and not senders

    def _drive(self) -> None:
        """Wait for the other nodes, then run until the last tick or Ctrl-C."""
        if not self._wait_for_nodes():
            return
        self.node.follow_recorder()
        begin = time.perf_counter_ns()
        self.endpoints.guard(self.node.begin)
        look = 0.0
        while not self._ends and not self.node.finished:
            self._executor.spin_once(timeout_sec=TURN_S)
            self._take_notices()
            if time.monotonic() >= look:
                look = time.monotonic() + TURN_S
                self._print("tick", self.node.stage.tick)
                self._print_returned()
                self._check_departed()
                self._check_answers()
        if self._stopped.is_set() and not self.node.finished:
            self._stop()
        self._turn_until(lambda: self.node.answered)
        self._print("wall_ns", time.perf_counter_ns() - begin)
        self._print("tick", self.node.stage.tick)
        self._print_returned()

    def _print_returned(self) -> None:
        for role, count in self.node.outage.returned.items():
            self._print(f"returned {role.value}", count)

    def _wait_for_nodes(self) -> bool:
        """Return True when all nodes are connected, False after a stop or a failure."""
        assert self._discovery is not None
        while not self._ends:
            if self._discovery.complete():
                self.node.outside = " ".join(sorted(role.value for role in self._discovery.outside))
                return True
            self._report_waiting(self._discovery.missing_peers())
            self._executor.spin_once(timeout_sec=0.02)
        return False

    def _report_waiting(self, missing: str) -> None:
        """Print the missing nodes and endpoints, every :data:`REPORT_EVERY_S`."""
        if time.monotonic() < self._next_report:
            return
        self._next_report = time.monotonic() + REPORT_EVERY_S
        hint = "" if opened_by() else "; only nodes of this machine are found (msgs_docs/nodes.md)"
        text = f"not begun: {missing}{hint}"
        self.endpoints.node.get_logger().info(text)
        self.endpoints.log(text, LogMessage.INFO)

    def _stop(self) -> None:
        """End the run after the current tick, if its command arrives."""
        self.node.request_stop(f"node plant was stopped by {self._stopped.signal or 'its runner'}")
        self._turn_until(lambda: self.node.finished)

    def _turn_until(self, done: Callable[[], bool]) -> None:
        """Run callbacks until a condition is true, at most 10 s; return at once after a failure, or without a node."""
        assert self._discovery is not None
        last = time.monotonic() + STOPPING_S
        while not done() and self.endpoints.watch.failure is None and time.monotonic() < last:
            if self._discovery.departed():
                return
            self._executor.spin_once(timeout_sec=TURN_S)

    def _hear(self, line: LogMessage) -> None:
        """Store the failure that a node says of itself, or of a component; the controller stops the train for one."""
        found = SAID.fullmatch(line.msg) if line.level >= LogMessage.ERROR else None
        if found is None:
            return
        if self.role is Role.PLANT and (found["begin"] == TRAIN_STOPPED or found["node"] == line.name):
            self._said[line.name] = found
        elif self.role is Role.CONTROLLER and found["begin"] == STOP_TRAIN:
            self.node.stage.fail(ComponentFailed(found["reason"], found["node"]))

    def _check_departed(self) -> None:
        """Lose the nodes that have left; the process that started an attached plant names those that it has started."""
        assert self._discovery is not None
        gone = [] if self.node.finished else self._discovery.departed()
        if self._attached:
            gone = [role for role in gone if role is self.endpoints.external]
        if not gone:
            return
        for _ in range(HEARING):  # a node leaves after its last line has arrived here, which may wait for its callback
            self._executor.spin_once(timeout_sec=0.0)
        said = self._said.get(gone[0].value)
        if said is None:
            self.node.lose_departed(gone)
        elif said["begin"] == TRAIN_STOPPED:
            self.endpoints.watch.fail(said["node"], said["reason"])
        else:
            self.node.lose(gone[0], said["reason"])

    def _check_answers(self) -> None:
        """Fail the run by the name of the silent node if an answer is overdue, or of a plant that was suspended."""
        overdue = self.node.check_overdue()
        if self._continued.is_set() and self.node.answer_watch.suspended > LEASE_S:
            self.endpoints.watch.fail(self.role.value, SUSPENDED.format(self.node.answer_watch.suspended))
        elif overdue:
            assert self._discovery is not None
            last, awaited = self._discovery.progress(lambda: self._executor.spin_once(timeout_sec=TURN_S))
            hanging = [role for role in self._discovery.others if role not in last]
            self.node.lose_silent(last, awaited, hanging[0] if hanging else None)
