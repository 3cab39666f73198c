"""A feed from a running graph: one thread reads the topics and talks to the nodes, whatever the browsers do."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np

from train_ato.changes import KEY as CHANGED
from train_ato.changes import LAW
from train_ato.changes import from_text as changes_from_text
from train_ato.interventions import KEY as DONE
from train_ato.interventions import from_text as interventions_from_text
from train_ato.shape import Shape
from train_ato.types import Diagnostic, Trajectory
from train_ato.view.controls import Controls
from train_ato.view.facts import Facts, Profile, facts_of
from train_ato.view.feed import FRAMES_PER_SECOND, Feed, Mark
from train_ato.view.presence import Presence
from train_ato.view.reader import DEPTH, Copied, Copier, GraphReader, shape_of, taker

MEETING_S = 15.0
LEARN_AGAIN_S = 0.5
FACTOR_SPAN_S = 1.0
LABELS = {"emergency brake applied": "emergency", "emergency brake released": "released"}
MOST_COPIED = 20_000
"""Messages that a tap holds at most; the oldest are dropped."""
STANDING_S = 1.0
"""Wall time without a new tick after which the pace shown is none."""


class LiveFeed(Feed):
    """Figures of the run on a ROS domain.

    Parameters
    ----------
    domain
        That of the run; the environment variables of the run must be set (:func:`train_ato.graph.environment.applied`).

    Raises
    ------
    ValueError
        If the nodes of a run are not found there.
    """

    live = True

    def __init__(self, domain: int) -> None:
        from rclpy.node import Node

        from train_ato.graph.assembly import executor_of

        self._stack = executor_of(domain)
        context, self._executor = self._stack.__enter__()
        self._asking = Node("view", context=context, enable_rosout=False, start_parameter_services=False)
        self._listening = Node("view_reader", context=context, enable_rosout=False, start_parameter_services=False)
        self._executor.add_node(self._asking)
        self.domain = domain
        self.controls = Controls(self._asking, self._executor.wake)
        self._state, self._law = "running", ""
        self._paces: deque[tuple[float, float]] = deque()
        self._stopping = threading.Event()
        try:
            facts = self._learn()
        except ValueError:
            self._end()
            raise
        super().__init__(facts)
        self._reader = GraphReader(self._listening, facts.shape)
        self._presence = Presence(self._listening)
        self._copier: Copier | None = None
        self._taps: list[deque[Copied]] = []
        self._thread = threading.Thread(target=self._run, name="graph", daemon=True)
        self._thread.start()

    @property
    def paused(self) -> bool:
        """Whether the plant says that it is paused."""
        return bool(self.controls.value("plant", "paused", False))

    @property
    def law(self) -> str:
        """Law in charge, as the controller's parameter says."""
        return str(self.controls.value("controller", "controller", self._law))

    def _learn(self) -> Facts:
        """Wait for the nodes' parameters; read the scenario that the plant names, or the first messages."""
        last, again = time.monotonic() + MEETING_S, 0.0
        while not self.controls.ready:
            now = time.monotonic()
            if now > last:
                raise ValueError(f"domain {self.domain}: no nodes 'plant' and 'controller' answer; is a run going on?")
            if now > again:
                again = now + LEARN_AGAIN_S
                self.controls.learn()
            self._executor.spin_once(timeout_sec=0.05)
        named = Path(str(self.controls.value("plant", "scenario", "")))
        if named.is_file():
            from train_ato.run_setup import prepare
            from train_ato.scenario import load

            return facts_of(prepare(*load(str(named))))
        return Facts(f"run on domain {self.domain}", self._seen_shape())

    def _seen_shape(self) -> Shape:
        takers = [taker(self._listening, name, DEPTH, reliable=False) for name in ("train/cars", "train/measurement")]
        last, found = time.monotonic() + MEETING_S, [None, None]
        while not all(found):
            if time.monotonic() > last:
                raise ValueError(f"domain {self.domain}: no train/cars comes; the run is paused or over")
            found = [
                taken[0] if (taken := take()) is not None else old for take, old in zip(takers, found, strict=True)
            ]
            time.sleep(0.01)
        there = {name: self._listening.count_publishers(name) > 0 for name in ("train/brake_pipe", "train/disturbance")}
        assert found[0] is not None
        assert found[1] is not None
        return shape_of(found[0], found[1], air_brake=there["train/brake_pipe"], disturbed=there["train/disturbance"])

    def tap(self) -> deque[Copied]:
        """Return a queue that takes the messages themselves from now on; they are read only while there is one."""
        queue: deque[Copied] = deque(maxlen=MOST_COPIED)
        self.controls.ask(lambda: self._taps.append(queue))
        return queue

    def untap(self, queue: deque[Copied]) -> None:
        """Let a queue take no more."""
        self.controls.ask(lambda: self._taps.remove(queue))

    def _copy(self) -> None:
        if self._taps:
            self._copier = self._copier or Copier(self._listening, self.facts.shape)
            for message in self._copier.poll():
                for queue in self._taps:
                    queue.append(message)

    def _run(self) -> None:
        """Turn the executor and read the topics until told to end."""
        period = 1.0 / FRAMES_PER_SECOND
        due = time.monotonic()
        while not self._stopping.is_set():
            now = time.monotonic()
            if now >= due:
                due = max(due + period, now)
                self._look(now)
            self.controls.serve()
            self._executor.spin_once(timeout_sec=max(0.001, due - time.monotonic()))
        self._end()

    def _look(self, now: float) -> None:
        """Take what is new; once a second without news the frame says that time stands still."""
        moment = self._reader.poll()
        self._presence.look(now, news=moment is not None)
        self.controls.over = self._presence.gone
        if self._presence.gone:  # what comes now is of another run
            moment = None
            self._reader.forget()
        self._heed()
        self._copy()
        if moment is not None:
            self.show(replace(moment, law=self.law, state=self._told_state(now), factor=self._pace(now, moment.time)))
        elif self.frame is not None:
            shown = self.frame.moment
            factor = shown.factor if self._paces and now - self._paces[-1][0] < STANDING_S else math.nan
            state = self._told_state(now)
            if (state, self.law) != (shown.state, shown.law) or (math.isnan(factor) and not math.isnan(shown.factor)):
                self.show(replace(shown, law=self.law, state=state, factor=factor), kept=False)

    def _told_state(self, now: float) -> str:
        """Return what the plant said last, unless it says nothing any more."""
        if self._state == "finished":
            return self._state
        if self._presence.gone:
            return "gone"
        if self.paused:
            return "paused" if self._state == "running" else self._state
        return "silent" if self._presence.silent(now) else self._state

    def _pace(self, now: float, simulated: float) -> float:
        """Return simulated seconds per second of wall time over the last second."""
        self._paces.append((now, simulated))
        while len(self._paces) > 2 and now - self._paces[0][0] > FACTOR_SPAN_S:
            self._paces.popleft()
        begin, first = self._paces[0]
        return (simulated - first) / (now - begin) if now > begin else math.nan

    def _heed(self) -> None:
        """Take what nodes said of themselves, a new profile, the limits."""
        reader = self._reader
        for trajectory in reader.profiles:
            self.take_profile(
                Profile(trajectory.time.astype(np.float64) * 1e-9, trajectory.position, trajectory.velocity)
            )
        if reader.limits and not self.facts.limit_places.size:
            self._take_limits(reader.limits[-1])
        for message in reader.diagnostics:
            if message.node == "plant":
                self._state = message.message
            self.marks = [*self.marks, *marks_of(message)]
        reader.forget()

    def _take_limits(self, limits: Trajectory) -> None:
        self.facts = replace(self.facts, limit_places=limits.position, limit_speeds=limits.velocity)
        self.scale = self.facts.scale(self.profile)
        self.profile_number += 1

    def _end(self) -> None:
        self._listening.destroy_node()
        self._stack.__exit__(None, None, None)

    def close(self) -> None:
        """End the thread and take the nodes down."""
        self._stopping.set()
        self._executor.wake()
        self._thread.join(timeout=5.0)


def marks_of(message: Diagnostic) -> list[Mark]:
    """Return what a node's diagnostics say was changed at their stamp."""
    found: list[Mark] = []
    time_s = message.stamp * 1e-9
    if CHANGED in message.values:
        for name, value in changes_from_text(message.values[CHANGED]).items():
            shown = str(value) if name == LAW else f"{name} = {value}"
            found.append(Mark(time_s, shown, f"law {value}" if name == LAW else shown))
    if DONE in message.values:
        done = interventions_from_text(message.values[DONE])
        labels = [LABELS.get(entry.described(), entry.do.replace("_", " ")) for entry in done]
        found += [Mark(time_s, label, entry.described()) for label, entry in zip(labels, done, strict=True)]
    return found
