"""Node ``plant``: the simulated train, the only source of simulation time.

In lockstep it sends the measurement of t_k, waits for the command stamped t_k and integrates to t_k+1; a rate delays
the ticks and changes no number.  Without lockstep it does not wait: the newest command is held and late commands are
counted.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from rclpy.clock import Clock, ClockType

from train_ato.judge.recording import OUTSIDE_KEY
from train_ato.judge.run_end import RunEnd
from train_ato.loop.plant import PlantStage
from train_ato.loop.rate_limit import SteadyRateLimit
from train_ato.loop.stage_messages import Published
from train_ato.messages.topics import BY_NAME, END_TOPIC, EPOCH_NS, REPORT, Role
from train_ato.messages.types import BrakeRelease, Command, Diagnostic, Pipe, Tick, TrainAhead
from train_ato.ros.graph.graph_result import GraphOptions
from train_ato.ros.nodes.answer_watch import AnswerWatch, TickLateness, awaited_node, departure, silent_node
from train_ato.ros.nodes.endpoints import NodeEndpoints
from train_ato.ros.nodes.plant_requests import PlantRequests
from train_ato.ros.nodes.tick_answers import OUTAGE_RATE, Outage, TickAnswers

LOOK_S = 0.2
"""Period of the checks of a wait for a report [s]."""


class AheadWatch:
    """Reports of the train ahead, and the wait for the report of a step.

    In lockstep a step of the supervisor waits for a report of its stamp, so that the run does not depend on the speeds
    of both programs. It does not wait after the last report, and not for a train whose reports have been missing for
    the time-out. The age of the reports and the rules of the end of authority then protect the train.

    Parameters
    ----------
    stage, endpoints
        Plant of the train behind with its radio.
    resume
        Called after a report.
    """

    def __init__(self, stage: PlantStage, endpoints: NodeEndpoints, resume: Callable[[], None]) -> None:
        leader, radio = stage.setup.scenario.leader, stage.radio
        assert leader is not None
        assert radio is not None
        self._stage, self._radio, self._endpoints = stage, radio, endpoints
        self._topic, self._resume = f"{leader.train}/{REPORT}", resume
        self._ended = self._missing = False
        self._last_moment: float | None = None
        endpoints.subscribe({REPORT: self._on_report}, at=self._topic)

    def lacking(self) -> list[str]:
        """Return the first report as a missing condition for the start."""
        return [] if self._radio.latest >= 0 or self._ended else [f"a report on {self._topic}"]

    def _on_report(self, report: TrainAhead) -> None:
        if np.isnan(report.position[0]):
            self._ended = True
        else:
            self._radio.put(report)
        self._missing, self._last_moment = False, None
        self._resume()

    def is_due(self, stamp: int, limit: float) -> bool:
        """Return True if the step of a stamp [ns] waits for its report, at most for a wall time [s]."""
        known = self._ended or self._missing or self._radio.latest >= stamp
        if known or not self._stage.setup.supervised_at(stamp):
            return False
        if self._last_moment is None:
            self._last_moment = time.monotonic() + limit
        if time.monotonic() < self._last_moment:
            return True
        self._missing = True
        self._endpoints.note(f"node plant: no report on {self._topic} for {limit:g} s; the run goes on without")
        return False


LEAD = 400
"""Maximum lead of the plant over the recorder [ticks]: less than half of the recorder's queues."""
MIN_WAIT_S = 0.0005
"""Minimum wait before a tick [s]; shorter waits are omitted."""
STOPPING_RATE = 10.0
"""Simulated seconds per wall second after the loss of a node in lockstep, until standstill."""
CLOCK_S = 0.5
"""Wall time between two messages on ``/clock`` in a pause [s], for nodes that join in it."""
FIRST_LOST = "; an answer before its publisher has a reader is lost: wait for get_subscription_count()"
"""Remedy for a program without an answer to the first measurement.

The measurement is not sent again: a program with a state that is only slow would take two steps for one tick.
"""
STANDING_S = 2.0
"""Simulated time at standstill after which a run with a lost node ends [s]."""


class PlantNode:
    """ROS node of the plant.

    Parameters
    ----------
    stage, endpoints
        Stage of the loop and endpoints of the node.
    options
        Options of the run; lockstep, time-out and rate are start values of ROS parameters of the node.
    recorded
        True: limit the lead over the recorder to :data:`LEAD`.
    scenario
        File of the resolved scenario, for tools; "" without one.

    Attributes
    ----------
    finished : bool
        True after the last tick and its report.
    recorder_heard : float
        Wall time of the last message of a recorder that receives every publisher [s].
    paused : bool
        True while only single steps begin a tick.
    on_stepped : callable
        Called when no further step begins a tick: in a pause, after it, and at the end.
    sent_stamp : int
        Stamp of the last measurement sent [ns], -1 before the first.
    answer_watch : AnswerWatch
        Time without an answer.
    outage : Outage
        Nodes whose process is started again.
    answers : TickAnswers
        Answers of the other nodes to the ticks.
    outside : str
        Nodes that are programs outside of this project, with spaces between them.
    resets : bool
        The runner begins the run again after a request to reset it.
    late, held : int
        Numbers of commands after their tick, and of ticks without a command.
    """

    def __init__(
        self, stage: PlantStage, endpoints: NodeEndpoints, options: GraphOptions, *, recorded: bool, scenario: str
    ) -> None:
        self.stage = stage
        self.endpoints = endpoints
        self.finished = False
        self.late = self.held = 0
        self.outside = ""
        self.resets = options.resets
        self.answers = TickAnswers(stage.setup)
        self.sent_stamp = -1
        self.blocked = False
        self.recorder_heard = -math.inf
        self.paused = False
        self.on_stepped: Callable[[], None] = lambda: None
        self._recorded = recorded
        self._begun = self._waiting = self._stopping = False
        self._steps = 0
        self._acknowledged = 0
        self.answer_watch = AnswerWatch()
        self._lost: tuple[str, str] | None = None
        self._interruption: str | None = None
        self._lateness = TickLateness()
        self._standing = 0
        self.outage = Outage(2 * stage.setup.supervision_ticks)
        self._lockstep_rate: float | None = None
        self._requests = PlantRequests(self, endpoints, options, scenario)
        given = self._requests.given
        self._period = None if given["lockstep"] else stage.setup.tick_ns / given["rate"]
        self._rate = SteadyRateLimit(stage.setup.tick, 0.0 if self._period is not None else given["rate"])
        self.paused = given["paused"]
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = endpoints.node.create_timer(1.0, self._awake, clock=steady, autostart=False)
        endpoints.node.create_timer(CLOCK_S, self._repeat_clock, clock=steady)
        endpoints.on_second_publisher = self._on_second_publisher
        endpoints.subscribe(
            {
                **dict.fromkeys(("ato/command", "ato/brake_pipe_command", "atp/brake_release"), self._on_answer),
                "recorder/progress": self._on_recorder_progress,
            }
        )
        self.ahead = AheadWatch(stage, endpoints, self._resume_loop) if stage.radio is not None else None
        ahead, unread = self.ahead, "a train behind that reads train/report"
        endpoints.lacking = lambda: [
            *([] if ahead is None else ahead.lacking()),
            *([unread] if options.followed and not endpoints.readers(REPORT) else []),
        ]

    @property
    def answered(self) -> bool:
        """True if the command for the last measurement has arrived; a run without lockstep ends before it."""
        return self.answers.stamps[Command] >= self.sent_stamp

    @property
    def ignored(self) -> int:
        """Number of duplicate or unexpected answers."""
        return self.answers.ignored

    @property
    def supervised_stamp(self) -> int:
        """Stamp of the last measurement sent to the supervisor [ns]; -1 without one."""
        setup = self.stage.setup
        if not setup.layout.supervised or self.sent_stamp < 0:
            return -1
        return self.sent_stamp - self.sent_stamp % (setup.supervision_ticks * setup.tick_ns)

    @property
    def timeout(self) -> float:
        """Effective time-out [s]."""
        return float(self.endpoints.node.get_parameter("timeout").value)

    @property
    def tick(self) -> int:
        """Number of complete ticks."""
        return self.stage.tick

    @property
    def stamp(self) -> int:
        """Stamp of the current tick [ns]."""
        return self.stage.stamp

    def begin(self) -> None:
        """Send the first measurement; all further ticks follow from messages and the timer."""
        self._begun = True
        self.answer_watch.begin()
        if self._period is not None:
            self._wake_every(self._period)
        self._next()

    def follow_recorder(self) -> None:
        """Limit the lead over the recorder if there is one."""
        self._recorded = self.endpoints.senders("recorder/progress") > 0

    def request_stop(self, reason: str = "stopped by a request") -> None:
        """End the run after the current tick, or at once between two ticks; the end notice has the reason."""
        self._stopping = True
        self._interruption = f"{reason} at {self.stamp * 1e-9:.3f} s"
        if not self._waiting:
            self.endpoints.guard(self._next)

    def check_overdue(self) -> bool:
        """Return True if an answer is due for longer than the time-out."""
        self.answer_watch.check()
        return self.silent_for() > self.timeout

    def silent_for(self) -> float:
        """Return the wall time of waiting for a due answer [s]; 0 if none is due, or the loss is known."""
        due = self._waiting or self.blocked
        if not due or self.finished or self._lost is not None or self.outage.away:
            return 0.0
        return self.answer_watch.silent_for(released=self._period is not None and self.stage.setup.layout.supervised)

    def lose_silent(self, last: Mapping[Role, int], awaited: Mapping[Role, str], hanging: Role | None = None) -> None:
        """Lose the node that has not answered, or on which one of these waits.

        Parameters
        ----------
        last
            Stamp of the last answer of every node [ns].
        awaited
            Topic for which a node waits, "" for none.
        hanging
            Node that does not react at all, or None.
        """
        answers, setup, watch = self.answers, self.stage.setup, self.answer_watch
        sent, release = answers.stamps[Command], answers.stamps[BrakeRelease]
        stamp = 0 if sent < 0 else min(sent + setup.tick_ns, self.sent_stamp)
        if self._period is None:
            commanded, released = answers.all_commanded(self.sent_stamp), release >= self.supervised_stamp
        else:
            commanded = watch.silent_for(released=False) <= self.timeout
            released = not setup.layout.supervised or watch.release_silent_for() <= self.timeout
        if hanging is not None:
            role, chain = hanging, ""
        elif commanded and not released and not self.blocked:
            role, chain, stamp = Role.SUPERVISOR, "", self.supervised_stamp
        else:
            role = silent_node(last, stamp, blocked=self.blocked, supervised=-1 if released else self.supervised_stamp)
            role, chain = (role, "") if answers.stamps_wrongly(role) else awaited_node(role, awaited)
        reason = f"no answer to stamp {stamp * 1e-9:.3f} s within {self.timeout:g} s"
        first = FIRST_LOST if stamp == 0 and role is self.endpoints.external else ""
        self.lose(role, f"{reason}{chain}{answers.unused_of(role) or first}")

    def lose_departed(self, gone: Sequence[Role]) -> None:
        """Lose the nodes that have left, by the name of the first one."""
        self.lose(gone[0], departure(gone, self.stamp))

    def lose(self, role: Role, reason: str) -> None:
        """Stop the train with the service brake, or a stronger fail-safe reaction; then fail the run.

        A run without supervision, or without its recorder, fails at once.
        """
        if not self.stage.setup.layout.supervised or role is Role.RECORDER:
            self.endpoints.watch.fail(role.value, reason)
        elif self._lost is None:
            self._lost = (role.value, reason)
            self.answers.lose(role)
            self._recorded = self.blocked = False  # a silent recorder does not hold the train
            self.stage.report_outage(f"node {role.value}: {reason}")
            self.stage.protection.lose(self.stage.lost)
            if self._period is None or self._lockstep_rate is not None:
                self._period = self.stage.setup.tick_ns / STOPPING_RATE
                self._rate.change(0.0)
            self._wake_every(self._period)
            self._resume_loop()

    def await_return(self, role: Role, reason: str) -> None:
        """Go on without a node while its process is started again; the fail-safe reactions act meanwhile.

        In lockstep the ticks follow the wall clock until every answer is in order again.
        """
        if self._lost is not None or self.finished:
            return
        self.outage.begin(role, reason)
        self.blocked = False
        self.stage.report_outage(self.outage.text)
        if self._period is None:
            self._lockstep_rate = self._rate.factor
            self._period = self.stage.setup.tick_ns / min(self._rate.factor or OUTAGE_RATE, OUTAGE_RATE)
            self._rate.change(0.0)
        self._wake_every(self._period)
        self._resume_loop()

    def _check_return(self, stamp: int) -> None:
        """End the outage after enough ticks with all answers; an outage at the end of the run fails it."""
        if self.stage.finished:
            self._conclude()
            role, reason = next(iter(self.outage.away.items()))
            self.endpoints.watch.fail(role.value, f"{reason}; it did not return before the end of the run")
        elif self.outage.step(self.answers.all_arrived(stamp)):
            returned = {role.value: count for role, count in self.outage.returned.items()}
            self.stage.report_outage("", returned)
            if self._lockstep_rate is not None:
                self._rate.change(self._lockstep_rate)
                self._lateness.restart()  # ticks without a due time may follow
                self._period = self._lockstep_rate = self.answers.pipe = None
                self._timer.cancel()

    def _on_second_publisher(self, topic: str, reason: str) -> bool:
        """Lose the node whose topic has a second publisher, in a supervised run; return False in another one."""
        if not self.stage.setup.layout.supervised:
            return False
        self.lose(BY_NAME[topic].publishers[0], reason)
        return True

    def _on_answer(self, answer: Command | Pipe | BrakeRelease) -> None:
        """Take an answer to the current tick, without lockstep also to an earlier one; the last one runs the tick."""
        commands = isinstance(answer, Command)
        if commands and self.answers.stamps[Command] < 0:
            self.answers.piped = self.answers.piped and not self.endpoints.left_out("ato/brake_pipe_command")
        lockstep, stamp = self._period is None, self.stage.stamp
        due = (self._waiting and answer.stamp == stamp) if lockstep else answer.stamp <= self.sent_stamp
        unstamped = not lockstep and answer.stamp == -EPOCH_NS and self.endpoints.external is not None
        if unstamped and self.sent_stamp >= 0:  # a command of the present tick, and of several the newest
            answer, due = replace(answer, stamp=self.sent_stamp), True
        if not self.answers.take(answer, expected=due, again=unstamped):
            if text := self.answers.refusal(answer, self.sent_stamp):
                self.endpoints.note(text)
            return
        if commands:
            self.answer_watch.heard = time.monotonic()
        elif isinstance(answer, BrakeRelease):
            self.answer_watch.heard_release = time.monotonic()
        if lockstep and (answers := self.answers.use(stamp)) is not None:
            self._waiting = False
            self.stage.act(*answers)
            self._next()

    def _next(self) -> None:
        """Begin the next tick, unless the run is finished, paused or too early, or the recorder is behind."""
        if self.stage.finished or self._stopping:
            self._conclude()
        elif self.paused and not self._steps:
            self.on_stepped()
        elif self._recorded and self.stage.tick - self._acknowledged > LEAD and not self.outage.away:
            self.blocked = True
        elif self._period is None and self.ahead is not None and self.ahead.is_due(self.stamp, self.timeout):
            self._wake_every(LOOK_S * 1e9)
        elif self._rate.factor and not self._steps and (wait := self._rate.wait(self.stage.tick)) > MIN_WAIT_S:
            self._wake_every(wait * 1e9)
        else:
            self._steps = max(0, self._steps - 1)
            if self.paused:
                self._lateness.restart()  # a step in a pause has no due time
            self._waiting = True
            self.sent_stamp = self.stage.stamp
            if self._period is not None:
                self._lateness.begin(self._period * 1e-9)
            elif self._rate.factor:
                self._lateness.begin(self.stage.setup.tick / self._rate.factor)
            self._send(self.stage.observe().published())

    def _conclude(self) -> None:
        if not self.finished:
            self.finished = True
            self._send(self.stage.conclude().published())
            self.on_stepped()
            if self.stage.reports is not None:
                self.endpoints.publish((REPORT, self.stage.reports.last(self.stamp)))

    @property
    def end(self) -> RunEnd:
        """End of the run with status and reason."""
        interruption = None if self.stage.finished else self._interruption
        return RunEnd.judged(self.stage.tick, self.stage.setup.ticks, self.endpoints.watch.failure, interruption)

    def announce_end(self) -> None:
        """Send the end notice, after the last message and the last failure; without it this node has failed."""
        self.endpoints.publish((END_TOPIC, self.end.notice(self.stamp)))

    def _send(self, messages: Published) -> None:
        """Send messages of the stage; counts from the wall clock and other programs are added to its diagnostics."""
        noted = self._period is not None or self.answers.ignored or self.held
        counted = noted or self._rate.factor or self.outside
        if counted and any(isinstance(message, Diagnostic) for _, message in messages):
            counts = self._lateness.report() | ({OUTSIDE_KEY: self.outside} if self.outside else {})
            if noted:
                wall = {"wall_late": self.late, "wall_held": self.held, "wall_ignored": self.ignored}
                counts |= {name: str(count) for name, count in wall.items()}
            messages = [
                (topic, replace(message, values={**message.values, **counts}))
                if isinstance(message, Diagnostic)
                else (topic, message)
                for topic, message in messages
            ]
        self.endpoints.publish(*messages)

    def _repeat_clock(self) -> None:
        """Send the time of a paused run again: a node that joins in a pause then has it."""
        if self._begun and self.paused and not self._waiting and not self.finished:
            self.endpoints.repeat("/clock", Tick(max(0, self.sent_stamp)))

    def _wake_every(self, nanoseconds: float) -> None:
        self._timer.timer_period_ns = int(nanoseconds)
        self._timer.reset()

    def _awake(self) -> None:
        """Begin a delayed tick; without lockstep run a tick with the newest command, which may be late."""
        if self._period is None:
            self._timer.cancel()
            self._resume_loop()
        elif self._waiting and not self.finished and self.endpoints.watch.failure is None:
            self.endpoints.guard(self._free_tick)

    def _free_tick(self) -> None:
        stamp = self.stage.stamp
        command, last_pipe, release = self.answers.use_newest()
        self._waiting = False
        if command is None:
            self.held += 1
            self.stage.act(release=release)
        else:
            self.late += command.stamp != stamp
            pipe = None if last_pipe is None else Pipe(stamp, last_pipe.pressure)
            self.stage.act(Command(stamp, command.force), pipe, release)
        if self._lost is not None:
            self._standing = self._standing + 1 if self.stage.standstill else 0
            if self._standing * self.stage.setup.tick >= STANDING_S or self.stage.finished:
                self._conclude()
                self.endpoints.watch.fail(*self._lost)
                return
        elif self.outage.away:
            self._check_return(stamp)
        self._next()

    def _on_recorder_progress(self, tick: Tick) -> None:
        if not tick.stamp:
            self.recorder_heard = time.monotonic()
            return
        acknowledged = tick.stamp // self.stage.setup.tick_ns
        if not self._acknowledged < acknowledged <= self.stage.tick:
            self.answers.ignored += 1
            self.endpoints.name_unused("recorder/progress", tick.stamp)
            return
        self._acknowledged = acknowledged
        if self.blocked:
            self.answer_watch.heard = time.monotonic()
            self.blocked = False
            self._next()

    def set_paused(self, paused: bool) -> None:
        """Pause after the current tick, or resume."""
        was, self.paused = self.paused, paused
        if was and not paused:
            self._steps = 0
            self.on_stepped()
            self._rate.restart()
            self._lateness.restart()
            self._resume_loop()

    def set_rate(self, factor: float) -> None:
        """Change the rate during the run, in one without lockstep to a rate above 0."""
        self._lateness.restart()  # the present tick began at the rate before
        if self._lockstep_rate is not None:
            self._lockstep_rate = factor
            return
        if self._period is not None:
            self._period = self.stage.setup.tick_ns / factor
            self._wake_every(self._period)
            return
        self._rate.change(factor)
        self._timer.cancel()
        self._resume_loop()

    def single_step(self) -> None:
        """Run one tick while paused; ValueError if the run is not paused between two ticks."""
        if not self.paused or self._waiting or self.finished:
            raise ValueError("not paused between two ticks; pause first")
        self.run_steps(1)

    def run_steps(self, count: int) -> int:
        """Run ticks of a paused run, after the present one; return the number of complete ticks after them."""
        self._steps += count
        goal = self.stage.tick + self._waiting + self._steps
        self._resume_loop()
        return goal

    def _resume_loop(self) -> None:
        """Begin a tick unless one is running or the run is blocked, finished or failed."""
        busy = self._waiting or self.blocked or self.finished or self.endpoints.watch.failure is not None
        if self._begun and not busy:
            self.answer_watch.restart()
            self.endpoints.guard(self._next)
