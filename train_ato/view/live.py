"""Feed from a running graph; one thread reads the topics and calls the nodes, independent of the browsers."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.control.contract import LawPlan
from train_ato.judge import recording as rec
from train_ato.judge.requirements import Robustness, evaluate_formula
from train_ato.judge.series import TopicSamples
from train_ato.judge.verdict import three_digits
from train_ato.messages.topic import TrainLayout
from train_ato.messages.types import Array, Diagnostic
from train_ato.ros.graph.domain_lock import DomainLock
from train_ato.scenario.changes import KEY as CHANGED
from train_ato.scenario.changes import LAW, changes_from_json
from train_ato.scenario.formula import parse_formula
from train_ato.scenario.interventions import KEY as DONE
from train_ato.scenario.interventions import interventions_from_json
from train_ato.scenario.setup import RunSetup, prepare
from train_ato.view.controls import Controls
from train_ato.view.facts import Facts, ProfileCurve, facts_of, reported_plan
from train_ato.view.feed import FINISHED, FRAMES_PER_SECOND, RUN_ENDED, Feed, Mark, ProtectionTracker, ending_of
from train_ato.view.reader import DEPTH, Copied, Copier, GraphReader, taker, train_layout
from train_ato.view.snapshot import Snapshot

LATEST_START_S = 1.0
"""Largest simulated time of the first snapshot: a page that joins later has no samples of the start."""
EVERY_S, MAX_LOAD = 1.0, 0.05
"""Shortest wall time between two evaluations [s], and their largest part of the wall time."""
COLOURS = {True: "#4caf7d", False: "#ff6b5e", None: "inherit"}


class LiveRequirements:
    """Evaluation of the requirements at the snapshots of the page, held to the ticks of the run.

    Parameters
    ----------
    setup
        The run.

    Attributes
    ----------
    markup : str
        Result as HTML; "" for a scenario without requirements.
    """

    def __init__(self, setup: RunSetup) -> None:
        self._setup = setup
        named = setup.scenario.criteria.requirements or {}
        self._formulas = {name: parse_formula(text) for name, text in named.items()}
        self._snapshots: list[Snapshot] = []
        self._due = 0.0
        self._end = (setup.ticks + 1) * setup.tick
        self.markup = ""

    def add(self, moment: Snapshot) -> None:
        """Add a snapshot; evaluate if the last evaluation is long enough ago."""
        if not self._formulas or (self._snapshots and moment.time <= self._snapshots[-1].time):
            return
        if not 0.0 <= moment.time <= self._end:  # a stamp of a foreign node
            return
        self._snapshots.append(moment)
        begin = time.monotonic()
        if begin < self._due:
            return
        self.markup = "<br>".join(_line(name, found) for name, found in self.evaluate().items())
        end = time.monotonic()
        self._due = end + max(EVERY_S, (end - begin) / MAX_LOAD)

    def evaluate(self) -> dict[str, Robustness]:
        """Return the bounds of every requirement; {} without snapshots from the start."""
        if not self._snapshots or self._snapshots[0].time > LATEST_START_S:
            return {}
        recording = self._recording()
        return {name: evaluate_formula(formula, self._setup, recording) for name, formula in self._formulas.items()}

    def _recording(self) -> rec.Recording:
        """Return the snapshots as a recording at the ticks; between two snapshots the earlier one is held."""
        tick, moments = self._setup.tick, self._snapshots
        times = np.array([moment.time for moment in moments])
        ticks = tick * np.arange(round(times[-1] / tick) + 1)
        rows = np.maximum(np.searchsorted(times, ticks + 0.5 * tick, side="right") - 1, 0)

        def samples(**values: list[Array | float]) -> TopicSamples:
            stacked = {name: np.array(column, dtype=np.float64) for name, column in values.items()}
            return TopicSamples(ticks, {name: found.reshape(len(moments), -1)[rows] for name, found in stacked.items()})

        nothing = np.full(4, math.nan)
        topics = {
            rec.TRUTH: samples(
                front_position=[moment.position[0] for moment in moments],
                front_velocity=[moment.velocity[0] for moment in moments],
                coupler_draft_max=[moment.coupler.max(initial=0.0) for moment in moments],
                coupler_buff_max=[moment.coupler.min(initial=0.0) for moment in moments],
            ),
            rec.MEASUREMENT: samples(applied=[moment.applied for moment in moments]),
            rec.REFERENCE: samples(
                position=[moment.reference[0] for moment in moments],
                velocity=[moment.reference[1] for moment in moments],
                acceleration=[moment.reference[2] for moment in moments],
            ),
            rec.COMMAND: samples(force=[moment.command for moment in moments]),
            rec.BRAKE_PIPE: samples(pressure=[moment.pipe for moment in moments]),
            rec.BRAKE_SHOES: samples(
                total=[math.nan if moment.shoe is None else moment.shoe.sum() for moment in moments]
            ),
            rec.SUPERVISED_SPEEDS: samples(
                speed=[
                    np.append(moment.velocity[0], nothing if moment.limits is None else moment.limits)
                    for moment in moments
                ]
            ),
        }
        return rec.Recording(topics)


def _line(name: str, found: Robustness) -> str:
    """Return a requirement as a line of HTML: state, and the margin that can still be reached."""
    unit = f" {found.unit}" if found.unit else ""
    if found.passed is None:
        parts = [
            f"{word} {three_digits(value)}{unit}"
            for word, value in (("at least", found.lower), ("at most", found.upper))
            if math.isfinite(value)
        ]
        text = f"open{', robustness ' if parts else ''}{' and '.join(parts)}"
    else:
        value = found.lower if found.passed else found.upper
        text = f"{'fulfilled' if found.passed else 'broken'}, robustness {three_digits(value)}{unit}"
    return f'<span style="color:{COLOURS[found.passed]}">{escape(name)}: {escape(text)}</span>'


LEARN_AGAIN_S, LEARN_SLOWEST_S = 0.5, 16.0
FACTOR_SPAN_S = 1.0
BRAKE_APPLIED = "emergency brake applied"
LABELS = {BRAKE_APPLIED: "emergency", "emergency brake released": "released"}
MAX_COPIED = 20_000
"""Largest number of messages in a tap; the oldest are dropped."""
ENDING_S = 30.0
"""Maximum wall time for the thread of the feed to end [s]."""
WAITING_RATE = 1e-6
"""Rate of a run that waits for its first page: the second tick is due after a day."""
FIRST_STEP_S = 0.3
"""Wall time between the single ticks of a waiting run until a frame arrives."""
SUMMARY_AGAIN_S = 0.5
"""Wall time between two searches for the summary of an ended run."""
STANDING_S = 1.0
"""Wall time without a new tick after which no rate is shown."""


class LiveFeed(Feed):
    """Data of the run on a ROS domain.

    Parameters
    ----------
    domain
        ROS domain of the run; its environment variables must be set
        (:func:`train_ato.ros.graph.environment.applied`).
    wait
        Called repeatedly with the name of the missing part; an exception ends the wait.
    first_rate
        Rate from the first page on (infinity: no limit), of a run that was started at :data:`WAITING_RATE`; None: the
        run does not wait.
    namespace
        Namespace of the train, one of several in the domain; "" for none.
    """

    live = True

    def __init__(
        self, domain: int, wait: Callable[[str], None], first_rate: float | None = None, namespace: str = ""
    ) -> None:
        from rclpy.node import Node

        from train_ato.ros.graph.assembly import executor_of

        self._stack = executor_of(domain)
        context, self._executor = self._stack.__enter__()
        self._asking, self._listening = (
            Node(name, context=context, namespace=namespace, enable_rosout=False, start_parameter_services=False)
            for name in ("view", "view_reader")
        )
        self._executor.add_node(self._asking)
        self.domain = domain
        self.controls = Controls(self._asking, self._executor.wake)
        self._state, self._law = "running", ""
        self._tracker = ProtectionTracker()
        self._plan: LawPlan | None = None
        self._rates: deque[tuple[float, float]] = deque()
        self._stopping = threading.Event()
        try:
            facts = self._learn(wait)
        except BaseException:
            self._end()
            raise
        super().__init__(facts)
        self.requirements = None if facts.setup is None else LiveRequirements(facts.setup)
        self.folder = self._named.parent if self._named.is_file() else None
        self.repeatable = first_rate is not None
        self._summary_due = self._step_due = 0.0
        self._held = self._page_opened = False
        self._reader = GraphReader(self._listening, facts.layout)
        self._presence = Presence(self._listening, domain, namespace)
        self._copier: Copier | None = None
        self._taps: list[deque[Copied]] = []
        self._thread = threading.Thread(target=self._run, name="graph", daemon=True)
        self._thread.start()
        if first_rate is not None:
            self._hold(first_rate)

    def _hold(self, rate: float) -> None:
        """Pause the run until the first page, then at the rate."""

        def paused(done: bool, text: str) -> None:
            self.controls.set_parameter("plant", "rate", 0.0 if math.isinf(rate) else rate, held)

        def held(done: bool, text: str) -> None:
            self._held = True
            self._step_due = 0.0

        self.controls.set_parameter("plant", "paused", True, paused)

    def page_opened(self) -> None:
        """Begin a run that waits for its first page."""
        self._page_opened = True

    def _begin_if_seen(self, now: float) -> None:
        """Begin the run after its first frame and page; single ticks until the frame has arrived."""
        if not self._held:
            return
        if self.frame is None:
            if now >= self._step_due:
                self._step_due = now + FIRST_STEP_S
                self.controls.call("step", lambda done, text: None)
        elif self._page_opened:
            self._held = False
            self.controls.call("pause", lambda done, text: None, data=False)

    @property
    def paused(self) -> bool:
        """Parameter ``paused`` of the plant."""
        return bool(self.controls.value("plant", "paused", False))

    @property
    def law(self) -> str:
        """Active law: parameter ``law`` of the controller."""
        return str(self.controls.value("controller", "law", self._law))

    def _learn(self, wait: Callable[[str], None]) -> Facts:
        """Wait for the parameters of the nodes; read the scenario of the plant or, without one, the first messages."""
        again, interval = 0.0, LEARN_AGAIN_S
        while not self.controls.ready:
            wait(f"{self.controls.missing} on domain {self.domain}")
            if time.monotonic() > again:
                # a node that is slow to answer must not receive requests faster than it answers
                again, interval = time.monotonic() + interval, min(2.0 * interval, LEARN_SLOWEST_S)
                self.controls.learn()
            self._executor.spin_once(timeout_sec=0.05)
        if outside := self.controls.outside("controller"):
            self._law = f"external: {outside}"
        self._named = named = Path(str(self.controls.value("plant", "scenario", "")))
        if named.is_file():
            from train_ato.scenario.scenario import load_scenario

            return facts_of(prepare(*load_scenario(str(named))))
        return Facts(f"run on domain {self.domain}", self._seen_shape(wait))

    def _seen_shape(self, wait: Callable[[str], None]) -> TrainLayout:
        takers = [
            taker(self._listening, name, DEPTH, reliable=False) for name in ("train/vehicles", "train/measurement")
        ]
        found = [None, None]
        plant = self.controls.outside("plant")
        if plant and not self._listening.count_publishers("train/vehicles"):
            raise ValueError(f"the plant {plant} sends no train/vehicles; show its record later: `train-ato view RUN`")
        while not all(found):
            wait(f"train/vehicles and train/measurement on domain {self.domain}; a paused run publishes none")
            found = [
                taken[0] if (taken := take()) is not None else old for take, old in zip(takers, found, strict=True)
            ]
            time.sleep(0.01)
        topics = ("train/brake_pipe", "train/disturbance", rec.SUPERVISED_SPEEDS)
        there = {name: self._listening.count_publishers(name) > 0 for name in topics}
        assert found[0] is not None
        assert found[1] is not None
        return train_layout(
            found[0],
            found[1],
            air_brake=there["train/brake_pipe"],
            disturbed=there["train/disturbance"],
            supervised=there[rec.SUPERVISED_SPEEDS],
        )

    def subscribe(self) -> deque[Copied]:
        """Return a queue of the serialized messages from now on; without a queue they are not read."""
        queue: deque[Copied] = deque(maxlen=MAX_COPIED)
        self.controls.submit(lambda: self._taps.append(queue))
        return queue

    def unsubscribe(self, queue: deque[Copied]) -> None:
        """Remove a queue."""
        self.controls.submit(lambda: self._taps.remove(queue))

    def _run(self) -> None:
        """Spin the executor and read the topics until the feed is closed."""
        period = 1.0 / FRAMES_PER_SECOND
        due = time.monotonic()
        while not self._stopping.is_set():
            now = time.monotonic()
            if now >= due:
                due = max(due + period, now)
                self._read_messages(now)
            self.controls.serve()
            self._executor.spin_once(timeout_sec=max(0.001, due - time.monotonic()))
        self._end()

    def _read_messages(self, now: float) -> None:
        """Read new messages; after a second without a new tick the frame shows no rate."""
        gone = self._presence.gone
        self._presence.look(now, news=False)
        # Later messages belong to another run, whose train may have other vehicles.
        moment = None if gone or self._presence.replaced else self._reader.poll()
        if moment is not None:
            self._presence.look(now, news=True)
        self._process_messages()
        self._look_for_end(now)
        self._begin_if_seen(now)
        if self._taps:
            self._copier = self._copier or Copier(self._listening, self.facts.layout)
            for message in self._copier.poll():
                for queue in self._taps:
                    queue.append(message)
        if moment is not None:
            factor, state = self._rate(now, moment.time), self._plant_state(now)
            if self.requirements is not None:
                self.requirements.add(moment)
            states = self._tracker.states
            self.show(replace(moment, law=self.law, state=state, factor=factor, states=states, plan=self._plan))
        elif self.frame is not None:
            shown = self.frame.moment
            factor = shown.factor if self._rates and now - self._rates[-1][0] < STANDING_S else math.nan
            state, states = self._plant_state(now), self._tracker.states
            changed = (state, self.law, states) != (shown.state, shown.law, shown.states)
            if changed or (math.isnan(factor) and not math.isnan(shown.factor)):
                self.show(replace(shown, law=self.law, state=state, factor=factor, states=states), kept=False)

    def _look_for_end(self, now: float) -> None:
        """Note the end of the run; its verdict follows with the summary."""
        if self._state != FINISHED and not self._presence.gone:
            return
        self.controls.over = True
        if (self.ending is None or not self.ending.verdict) and now >= self._summary_due:
            self._summary_due = now + SUMMARY_AGAIN_S
            self.ending = ending_of(FINISHED if self._state == FINISHED else RUN_ENDED, self.folder)

    def _plant_state(self, now: float) -> str:
        """Return the last state of the plant, or ``run ended``, ``paused``, ``no data``."""
        if self.ending is not None:
            return self.ending.state
        if self.paused:
            return "paused" if self._state == "running" else self._state
        return "no data" if self._presence.silent(now) else self._state

    def _rate(self, now: float, simulated: float) -> float:
        """Return simulated seconds per second of wall time over the last second."""
        self._rates.append((now, simulated))
        while len(self._rates) > 2 and now - self._rates[0][0] > FACTOR_SPAN_S:
            self._rates.popleft()
        begin, first = self._rates[0]
        return (simulated - first) / (now - begin) if now > begin else math.nan

    def _process_messages(self) -> None:
        """Process diagnostics, new profiles and speed limits."""
        reader = self._reader
        for trajectory in reader.profiles:
            self.take_profile(
                ProfileCurve(trajectory.time.astype(np.float64) * 1e-9, trajectory.position, trajectory.velocity)
            )
        if reader.limits and not self.facts.limit_places.size:
            limits = reader.limits[-1]
            self.facts = replace(self.facts, limit_places=limits.position, limit_speeds=limits.velocity)
            self.scale = self.facts.scale(self.profile)
            self.profile_number += 1
        for message in reader.diagnostics:
            if message.node == "plant":
                self._state = message.message
            elif message.node == "controller":
                self._plan = reported_plan(message.values)
            self.marks = [*self.marks, *marks_of(message), *self._tracker.take(message)]
        reader.clear()

    def _end(self) -> None:
        self._listening.destroy_node()
        self._stack.__exit__(None, None, None)

    def close(self) -> None:
        """Stop the thread and destroy the nodes."""
        self._stopping.set()
        self._executor.wake()
        self._thread.join(timeout=ENDING_S)


def marks_of(message: Diagnostic) -> list[Mark]:
    """Return the changes and interventions in a diagnostics message."""
    found: list[Mark] = []
    time_s = message.stamp * 1e-9
    if message.node == "controller" and CHANGED in message.values:
        for name, value in changes_from_json(message.values[CHANGED]).items():
            shown = str(value) if name == LAW else f"{name} = {value}"
            found.append(Mark(time_s, shown, f"law {value}" if name == LAW else shown))
    if message.node == "plant" and DONE in message.values:
        for entry in interventions_from_json(message.values[DONE]):
            text = entry.described()
            label = LABELS.get(text, entry.do.replace("_", " "))
            found.append(Mark(time_s, label, text, acknowledge=text == BRAKE_APPLIED))
    return found


LOOK_S = 0.5
"""Wall time between two checks of the graph."""
SILENT_S = 2.0
"""Wall time without a new tick after which a run that is not paused or finished counts as silent."""
PAUSES = 3.0
"""Multiple of the last time between two ticks after which a slow run counts as silent, if that is longer."""
TOPIC = "train/vehicles"


class Presence:
    """Monitor of the plant's publisher; another run on the same domain has a different publisher.

    The middleware reports the end of a killed publisher after 10 s and more; the lock of the domain is free at once.

    Parameters
    ----------
    node
        rclpy node in the graph.
    domain
        ROS domain of the run.
    namespace
        Namespace of its nodes; "" for none.

    Attributes
    ----------
    gone : bool
        The first publisher has disappeared, a second one exists, or the run has released its domain.
    replaced : bool
        Another publisher exists.
    """

    def __init__(self, node: Any, domain: int, namespace: str = "") -> None:
        self._node = node
        self._lock = DomainLock(domain, namespace)
        self._was_held = False
        self._met: frozenset[bytes] = frozenset()
        self._looked = self._news = float("-inf")
        self._pause = 0.0
        self.gone = self.replaced = False

    def look(self, now: float, *, news: bool) -> None:
        """Check the graph at a wall time [s]; ``news`` means a new tick at this time."""
        if news:
            self._pause = now - self._news if self._news > float("-inf") else 0.0
            self._news = now
        if now - self._looked >= LOOK_S:
            self._looked = now
            found = frozenset(bytes(entry.endpoint_gid) for entry in self._node.get_publishers_info_by_topic(TOPIC))
            self._met = self._met or found
            self.replaced = bool(found - self._met)
            held = self._lock.held
            self._was_held |= held
            self.gone = self.gone or found != self._met or (self._was_held and not held)

    def silent(self, now: float) -> bool:
        """Return True if no tick came for longer than the rate of the run explains."""
        return now - self._news > max(SILENT_S, PAUSES * self._pause) > 0.0
