"""The closed loop as a plain Python loop, without ROS: the fastest way to run, with the same log as the nodes write."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from train_ato.failure import Watch
from train_ato.history import HistoryBuilder
from train_ato.interrupt import Interrupt, interruptible
from train_ato.outcome import Outcome, Progress
from train_ato.pace import Pace
from train_ato.roles.controller import ControllerRole
from train_ato.roles.observer import ObserverRole
from train_ato.roles.outgoing import Outgoing
from train_ato.roles.plant import PlantRole
from train_ato.roles.profile import ProfileRole
from train_ato.roles.trajectories import profile_of
from train_ato.run_setup import RunSetup


class Sink(Protocol):
    """Whatever takes the messages of a run, in the order in which they are published."""

    def add(self, topic: str, message: object, stamp: int) -> None:
        """Take one message."""


def run_engine(
    setup: RunSetup,
    *,
    sink: Sink | None = None,
    progress: Callable[[Progress], None] | None = None,
    realtime: float | None = None,
    log_folder: Path | None = None,
    interrupt: Interrupt | None = None,
) -> Outcome:
    """Drive one run to its end.

    Parameters
    ----------
    setup
        The checked run.
    sink
        Takes every message, e.g. a log; None keeps only the series.
    progress
        Called about ten times a second of wall time.
    realtime
        Pace on the wall clock, in simulated seconds per second; None runs as fast as it can.
    log_folder
        Where the traceback of a failure goes.
    interrupt
        Flag that ends the run after the tick under way; None: Ctrl-C and SIGTERM do.

    Returns
    -------
    Outcome
        The series, how long it took, and whether it was interrupted (Ctrl-C ends a run, it does not lose it).
    """
    if interrupt is None:
        with interruptible() as asked:
            return run_engine(
                setup, sink=sink, progress=progress, realtime=realtime, log_folder=log_folder, interrupt=asked
            )
    loop = _Loop(setup, sink)
    begin = time.perf_counter()
    pace = Pace(realtime, setup.tick)
    watch = Watch(log_folder)
    next_report = begin
    try:
        loop.start()
        while not (loop.plant.finished or interrupt.asked):
            loop.tick()
            pace.wait(loop.ticks)
            if progress is not None and (now := time.perf_counter()) >= next_report:
                progress(Progress(loop.ticks * setup.tick, setup.ticks * setup.tick, now - begin))
                next_report = now + 0.1
        loop.conclude()
    except Exception as error:  # a law of somebody else may raise anything: the run fails by the node's name
        watch.fail(loop.active, error)
    wall = time.perf_counter() - begin
    times = loop.controller.step_times
    return Outcome.of(setup, loop.history, wall, loop.ticks, times, interrupt.asked, watch.failure, loop.published)


class _Loop:
    """The four roles, called in the order in which the nodes answer each other."""

    def __init__(self, setup: RunSetup, sink: Sink | None) -> None:
        self.plant = PlantRole(setup)
        self.profile = ProfileRole(setup)
        self.observer = ObserverRole(setup)
        self.controller = ControllerRole(setup)
        self.history = HistoryBuilder(setup)
        self.ticks = 0
        self.active = "engine"
        self.published: dict[str, int] = {}
        self._sink = sink

    def _publish(self, stamp: int, messages: Outgoing) -> None:
        for topic, message in messages:
            self.history.add(topic, message)
            self.published[topic] = self.published.get(topic, 0) + 1
            if self._sink is not None:
                self._sink.add(topic, message, stamp)

    def start(self) -> None:
        self.active = "profile"
        messages = self.profile.start()
        self._publish(0, messages)
        self._follow(messages)

    def _follow(self, messages: Outgoing) -> None:
        """Hand the controller a profile if there is one."""
        for topic, message in messages:
            if topic == "ato/profile":
                self.controller.set_profile(profile_of(message))

    def tick(self) -> None:
        stamp = self.plant.stamp
        self.active = "plant"
        seen = self.plant.observe()
        self._publish(stamp, seen)
        measurement = seen[-1][1]
        self.active = "profile"
        answer = self.profile.answer(measurement)
        self._publish(stamp, answer)
        reference = answer[-1][1]
        if len(answer) > 1:
            self._follow(answer)
        self.active = "observer"
        answer = self.observer.answer(measurement)
        self._publish(stamp, answer)
        estimate = answer[-1][1]
        self.active = "controller"
        command, pipe, messages = self.controller.step(measurement, reference, estimate)
        self._publish(stamp, messages)
        self.active = "plant"
        self.plant.act(command, pipe)
        self.ticks += 1

    def conclude(self) -> None:
        self._publish(self.plant.stamp, self.plant.conclude())
