"""Node ``plant``: the train as the only source of time.

In lockstep it sends the measurement of t_k, waits for the command stamped t_k and integrates to t_k+1; a pace may hold
it back, which changes no number.  In ``realtime`` it does not wait: the newest command is held and late ones are
counted.  This module is the only one of ``plant_sim`` that knows the stack.
"""

from __future__ import annotations

import time
from dataclasses import replace

from rclpy.clock import Clock, ClockType

from train_ato.nodes.plant_requests import PlantRequests
from train_ato.nodes.shell import Shell
from train_ato.pace import SteadyPace
from train_ato.roles.outgoing import Outgoing
from train_ato.roles.plant import PlantRole
from train_ato.topics import Role
from train_ato.types import Command, Diagnostic, Pipe, Tick

LEAD = 400
"""Ticks that the plant may be ahead of the recorder: less than half of the recorder's queues."""
SHORTEST_WAIT_S = 0.0005
"""A tick that is early by less is not held back."""


class PlantNode:
    """Wraps the plant role.

    Parameters
    ----------
    role, shell
        What it drives and how it talks.
    realtime
        Simulated seconds per second of wall time; None runs in lockstep.
    timeout
        Wall time after which a missing answer is a failure [s]; a ROS parameter of the node.
    recorded
        Whether a recorder listens and has to be waited for.
    pace
        Simulated seconds per second of wall time at most, in lockstep; 0 is as fast as it goes.
    scenario
        File of the resolved scenario, for tools; "" if there is none.

    Attributes
    ----------
    finished : bool
        The last tick is over and the end was reported.
    paused : bool
        No tick is begun but single steps.
    asked : int
        Stamp of the last measurement sent [ns], -1 before the first.
    ignored, late, held : int
        Commands that came twice or for another stamp; commands that came after their tick; ticks without any.
    """

    def __init__(
        self,
        role: PlantRole,
        shell: Shell,
        *,
        realtime: float | None = None,
        timeout: float = 10.0,
        recorded: bool = True,
        pace: float = 0.0,
        scenario: str = "",
    ) -> None:
        self.role = role
        self.shell = shell
        self.finished = False
        self.ignored = self.late = self.held = 0
        self.asked = -1
        self.blocked = False
        self.paused = False
        self._recorded = recorded
        self._begun = self._waiting = self._stopping = self._single = False
        self._command: Command | None = None
        self._pipe: Pipe | None = None
        self._acknowledged = 0
        self._heard = time.monotonic()
        self._requests = PlantRequests(self, shell, realtime or 0.0, timeout, pace, scenario)
        given = self._requests.given
        self._period = role.setup.tick_ns / given["realtime"] if given["realtime"] > 0 else None
        self._pace = SteadyPace(role.setup.tick, 0.0 if self._period is not None else given["pace"])
        self.paused = given["paused"]
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = shell.node.create_timer(1.0, self._awake, clock=steady, autostart=False)
        shell.subscribe(
            {
                "ato/command": self._commanded,
                "ato/brake_pipe": self._pipe_demanded,
                "record/acknowledged": self._written,
            }
        )

    @property
    def overdue(self) -> bool:
        """Tell whether an answer has been due for longer than the time-out."""
        return self.silent_for() > self.timeout

    @property
    def timeout(self) -> float:
        """Time-out in force [s]."""
        return float(self.shell.node.get_parameter("timeout").value)

    @property
    def stamp(self) -> int:
        """Stamp of the tick under way [ns]."""
        return self.role.stamp

    def begin(self) -> None:
        """Send the first measurement; from here on the messages drive everything."""
        self._begun = True
        self._heard = time.monotonic()
        if self._period is not None:
            self._wake_every(self._period)
        self._next()

    def follow_recorder(self) -> None:
        """Wait for a recorder from now on if there is one."""
        self._recorded = self.shell.senders("record/acknowledged") > 0

    def request_stop(self) -> None:
        """End the run after the tick under way, or at once where none is."""
        self._stopping = True
        if not self._waiting:
            self.shell.guard(self._next)

    def silent_for(self) -> float:
        """Return the wall time since an answer was due and did not come [s]; 0 while none is due."""
        due = self._waiting or self.blocked
        return time.monotonic() - self._heard if due and not self.finished else 0.0

    def _commanded(self, command: Command) -> None:
        if self.shell.senders("ato/command") > 1:
            raise ValueError("ato/command has more than one publisher; end the other one")
        self._heard = time.monotonic()
        if self._period is not None:
            self._command = command
        elif not self._waiting or command.stamp != self.role.stamp or self._command is not None:
            self.ignored += 1
        else:
            self._command = command
            self._act_if_complete()

    def _pipe_demanded(self, pipe: Pipe) -> None:
        if self._period is not None:
            self._pipe = pipe
        elif not self._waiting or pipe.stamp != self.role.stamp or self._pipe is not None:
            self.ignored += 1
        else:
            self._pipe = pipe
            self._act_if_complete()

    def _act_if_complete(self) -> None:
        command, pipe = self._command, self._pipe
        if command is None or (pipe is None and self.role.setup.shape.air_brake):
            return
        self._command = self._pipe = None
        self._waiting = False
        self.role.act(command, pipe)
        self._next()

    def _next(self) -> None:
        """Go on to the next tick, unless the run is over, the train is paused or too early, or the recorder behind."""
        if self.role.finished or self._stopping:
            self._conclude()
        elif self.paused and not self._single:
            pass
        elif self._recorded and self.role.tick - self._acknowledged > LEAD:
            self.blocked = True
        elif self._pace.factor and not self._single and (wait := self._pace.wait(self.role.tick)) > SHORTEST_WAIT_S:
            self._wake_every(wait * 1e9)
        else:
            self._single = False
            self._waiting = True
            self.asked = self.role.stamp
            self._send(self.role.observe())

    def _conclude(self) -> None:
        if not self.finished:
            self.finished = True
            self._send(self.role.conclude())

    def _send(self, messages: Outgoing) -> None:
        """Send what the role has to say; what follows from the wall clock is added to its diagnostics."""
        if self._period is not None or self.ignored:
            wall = {"wall_late": self.late, "wall_held": self.held, "wall_ignored": self.ignored}
            counts = {name: str(count) for name, count in wall.items()}
            messages = [
                (topic, replace(message, values={**message.values, **counts}))
                if isinstance(message, Diagnostic)
                else (topic, message)
                for topic, message in messages
            ]
        self.shell.publish_all(messages)

    def _wake_every(self, nanoseconds: float) -> None:
        self._timer.timer_period_ns = int(nanoseconds)
        self._timer.reset()

    def _awake(self) -> None:
        """Begin the tick that was early; in realtime take one with the newest command, which may be late."""
        if self._period is None:
            self._timer.cancel()
            self._resume_loop()
        elif self._waiting and not self.finished and self.shell.watch.failure is None:
            self.shell.guard(self._paced_tick)

    def _paced_tick(self) -> None:
        command, stamp = self._command, self.role.stamp
        self._waiting = False
        if command is None:
            self.held += 1
            self.role.hold()
        else:
            self.late += command.stamp != stamp
            pipe = None if self._pipe is None else Pipe(stamp, self._pipe.pressure)
            self.role.act(Command(stamp, command.force), pipe)
            self._command = None
        self._next()

    def _written(self, tick: Tick) -> None:
        self._acknowledged = tick.stamp // self.role.setup.tick_ns
        if self.blocked:
            self._heard = time.monotonic()
            self.blocked = False
            self._next()

    def set_paused(self, paused: bool) -> None:
        """Begin no further tick, or go on."""
        was, self.paused = self.paused, paused
        if was and not paused:
            self._pace.restart()
            self._resume_loop()

    def set_pace(self, factor: float) -> None:
        """Change the pace while the train runs.

        Raises
        ------
        ValueError
            In realtime, where the pace is the clock's, if it is to be 0.
        """
        if self._period is not None:
            if factor <= 0:
                raise ValueError("pace 0: a run in realtime has a pace; give a number above 0")
            self._period = self.role.setup.tick_ns / factor
            self._wake_every(self._period)
            return
        self._pace.change(factor)
        self._timer.cancel()
        self._resume_loop()

    def single_step(self) -> None:
        """Take one tick while paused.

        Raises
        ------
        ValueError
            If it is not paused between two ticks.
        """
        if not self.paused or self._waiting or self.finished:
            raise ValueError("not paused between two ticks; pause first")
        self._single = True
        self._resume_loop()

    def _resume_loop(self) -> None:
        """Begin a tick if none is under way and nothing else holds it back."""
        busy = self._waiting or self.blocked or self.finished or self.shell.watch.failure is not None
        if self._begun and not busy:
            self._heard = time.monotonic()
            self.shell.guard(self._next)


def silent_node(last: dict[Role, int], stamp: int, blocked: bool) -> Role:
    """Return the node that a stalled plant waits for: the first, in the order of dependence, that did not answer."""
    if blocked:
        return Role.RECORDER
    for role in (Role.PROFILE, Role.OBSERVER):
        if last.get(role, -1) < stamp:
            return role
    return Role.CONTROLLER
