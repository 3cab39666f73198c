"""Run with all nodes in one process, on one executor."""

import gc
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from train_ato.judge.run_end import INTERRUPTED
from train_ato.messages.codec import Wire
from train_ato.messages.topics import Role
from train_ato.messages.types import Tick
from train_ato.program.errors import FirstFailure
from train_ato.program.interrupt import Interrupt, interruptible
from train_ato.ros.graph import shared_memory
from train_ato.ros.graph.assembly import TURN_S, executor_of, make_node
from train_ato.ros.graph.graph_result import ANSWERING, STOPPING_S, GraphOptions, GraphResult, Report
from train_ato.ros.graph.node_process import NodeProcess, with_stop
from train_ato.ros.graph.wait_note import WaitNote
from train_ato.ros.nodes.endpoints import NodeEndpoints, roles_of
from train_ato.ros.nodes.outside_plant import OutsidePlant
from train_ato.ros.standalone.notices import READY
from train_ato.scenario.setup import RunSetup

RECORD_EVERY = 8
"""Ticks after which the recorder empties its queues of 1000 messages; a new message is sought in all of its queue."""
_SLICE_S, _PACED_S = 0.003, 0.03
"""Wall time of the callbacks between two looks at the ticks, of a fast run and of one with a tick or none in it [s]."""
START_LIMIT_S = 30.0
"""Maximum wall time of the discovery of the nodes [s]."""
_SHORT_S = 0.005
_NONE: Mapping[Role, NodeProcess] = MappingProxyType({})


def run_composed(
    setup: RunSetup,
    folder: Path,
    domain: int,
    options: GraphOptions,
    report: Report | None = None,
    apart: Mapping[Role, NodeProcess] = _NONE,
) -> GraphResult:
    """Run all nodes in this process, besides those ``apart``, to the end of a scenario, recorded into ``folder``.

    The shared memory of killed runs is removed first: a process ended by SIGKILL cannot remove its own.

    Returns
    -------
    GraphResult
        Its ``failure`` names the failed node; the log is closed in every case.

    Raises
    ------
    ValueError
        If the log or a node cannot be created, before the start of the run.
    """
    shared_memory.clean()
    watch = FirstFailure(folder / "log")
    external = options.external
    with interruptible() as interrupt, executor_of(domain, options.arguments or None, watch) as (context, executor):
        wire = Wire(setup.layout)
        all_endpoints = {
            role: NodeEndpoints(role, wire, context, watch, external=external)
            for role in roles_of(setup.layout)
            if role is not external and role not in apart
        }
        nodes = {role: make_node(role, setup, own, folder, options) for role, own in all_endpoints.items()}
        if Role.OBSERVER in nodes and Role.CONTROLLER in nodes:
            nodes[Role.OBSERVER].stage.on_fault = nodes[Role.CONTROLLER].stage.fail
        elif Role.OBSERVER in nodes:  # an external controller reads no order to brake
            nodes[Role.OBSERVER].stage.on_fault = lambda fault: nodes[Role.PLANT].lose(Role.OBSERVER, str(fault))
        if external is Role.PLANT:
            nodes[external] = OutsidePlant(setup, nodes[Role.RECORDER], options.patience)
        else:
            nodes[Role.PLANT].outside = "" if external is None else external.value
        for role, endpoints in all_endpoints.items():
            if role is not Role.RECORDER:
                executor.add_node(endpoints.node)
        try:
            end = _Composed(executor, all_endpoints, nodes, watch, interrupt, options, apart).run(report)
            if interrupt.asked:
                end.interruption = interrupt.reason(end.ticks, setup.ticks)
            return end
        finally:
            all_endpoints[Role.RECORDER].destroy()


@dataclass
class _Composed:
    """One run: discovery, control loop, last messages, closed log."""

    _executor: Any
    _all_endpoints: dict[Role, NodeEndpoints]
    _nodes: dict[Role, Any]
    _watch: FirstFailure
    _interrupt: Interrupt
    _options: GraphOptions
    _apart: Mapping[Role, NodeProcess]
    _left: bool = False

    def __post_init__(self) -> None:
        self._plant = self._nodes[Role.PLANT]

    def run(self, report: Report | None) -> GraphResult:
        end = GraphResult()
        try:
            if self._wait_for(self._absent):
                gc.collect()
                gc.freeze()
                begin = time.perf_counter()
                if Role.PROFILE in self._nodes:
                    self._all_endpoints[Role.PROFILE].guard(self._nodes[Role.PROFILE].begin)
                if self._wait_for(self._unmeasured):
                    self._of_plant.guard(self._plant.begin)
                    self._drive(report)
                end.wall_s = time.perf_counter() - begin
        finally:
            self._close(end)
            gc.unfreeze()
        plant_end = self._plant.end
        end.ticks = plant_end.ticks
        end.step_ns = self._nodes[Role.CONTROLLER].stage.step_times if Role.CONTROLLER in self._nodes else []
        end.ignored = {
            role.value: count for role, node in self._nodes.items() if (count := getattr(node, "ignored", 0))
        }
        end.interruption = plant_end.reason if plant_end.status == INTERRUPTED else None
        end.failure = self._watch.failure and with_stop(self._watch.failure, self._apart)
        return end

    def _turn_until(self, done: Callable[[], bool], limit: float) -> None:
        """Run callbacks until a condition is true, at most for the limit [s] or until a failure of the run."""
        last = time.monotonic() + limit
        while not done() and time.monotonic() <= last and self._watch.failure is None:
            self._executor.spin_once(timeout_sec=_SHORT_S)
            self._record()

    def _record(self) -> None:
        self._all_endpoints[Role.RECORDER].guard(self._nodes[Role.RECORDER].poll)

    @property
    def _of_plant(self) -> NodeEndpoints:
        """Endpoints of the plant, those of the recorder for an external one."""
        return self._all_endpoints.get(Role.PLANT, self._all_endpoints[Role.RECORDER])

    def _absent(self) -> list[tuple[str, list[str]]]:
        """Return the missing conditions for the start, by node."""
        lacking = [(role.value, endpoints.missing()) for role, endpoints in self._all_endpoints.items()]
        lacking += [(role.value, ["its connections"]) for role, node in self._apart.items() if READY not in node.counts]
        return [(name, lacks) for name, lacks in lacking if lacks]

    def _check_apart(self) -> None:
        """Fail the run by the first node whose process has failed; the loss of the plant is found here, too."""
        for node in self._apart.values():
            node.look()
            name, _, reason = (node.failure or "").removeprefix("node ").partition(" failed: ")
            if reason and name != Role.PLANT.value:
                self._watch.fail(name, reason)

    def _unmeasured(self) -> list[tuple[str, list[str]]]:
        """Return the missing first measurement of an external plant, after a message that all nodes read from it."""
        self._record()
        if Role.PLANT in self._all_endpoints or self._nodes[Role.RECORDER].measured:
            return []
        self._all_endpoints[Role.RECORDER].repeat("recorder/progress", Tick(0))
        return [(Role.PLANT.value, ["its first measurement"])]

    def _wait_for(self, lacking: Callable[[], list[tuple[str, list[str]]]]) -> bool:
        """Run callbacks until nothing is lacking; return False after the limit of the start, a failure or Ctrl-C."""
        limit = self._options.starting(START_LIMIT_S)
        last, note = time.monotonic() + limit, WaitNote()
        while not self._interrupt.asked:
            self._check_apart()
            absent = lacking()
            if not absent or self._watch.failure is not None:
                return not absent
            note("; ".join(f"node {name}, which lacks {', '.join(lacks)}" for name, lacks in absent))
            if time.monotonic() > last:
                name, lacks = absent[0]
                others = "".join(f"; node {other} for {', '.join(more)}" for other, more in absent[1:])
                self._watch.fail(name, f"it waited {limit:g} s for {', '.join(lacks)}{others}")
                return False
            self._executor.spin_once(timeout_sec=0.01)
        return False

    def _drive(self, report: Report | None) -> None:
        plant, watch = self._plant, self._watch
        look, recorded, slice_s = time.monotonic() + TURN_S, 0, _SLICE_S
        while not plant.finished and watch.failure is None:
            begun = plant.tick
            self._executor.spin_for(slice_s)
            slice_s = _SLICE_S if plant.tick > begun + 1 else _PACED_S
            if plant.tick >= recorded + RECORD_EVERY:
                recorded = plant.tick
                self._record()
            now = time.monotonic()
            if now >= look:
                look = now + TURN_S
                self._record()
                if report is not None:
                    report(plant.tick)
                self._look()
                if self._interrupt.asked:
                    plant.request_stop()
                    self._turn_until(lambda: plant.finished, STOPPING_S)
                    return

    def _look(self) -> None:
        """Lose the external node if it has left, a node whose process has failed, or whose answer is overdue."""
        self._check_apart()
        external, recorder = self._options.external, self._all_endpoints[Role.RECORDER]
        left, self._left = self._left, external is not None and recorder.external_left
        if external is not None and left and self._left and not self._plant.finished:  # its last messages are read
            self._plant.lose_departed([external])
        elif self._plant.check_overdue():
            last = {role: endpoints.last_stamp for role, endpoints in self._all_endpoints.items()}
            outside = () if external is None else (external,)
            last |= {role: self._nodes[Role.RECORDER].last_stamp_of(role) for role in (*outside, *self._apart)}
            self._plant.lose_silent(
                last, {role: endpoints.awaited() for role, endpoints in self._all_endpoints.items()}
            )

    def _close(self, end: GraphResult) -> None:
        """Record the messages in flight, close the log and compare the message counts."""
        recorder, plant = self._nodes[Role.RECORDER], self._plant
        due = [(self._all_endpoints[role], plant.sent_stamp) for role in ANSWERING if role in self._nodes]
        if Role.SUPERVISOR in self._all_endpoints:
            due.append((self._all_endpoints[Role.SUPERVISOR], plant.supervised_stamp))
        # A run without lockstep ends before the answers to its last measurement; they still count.
        self._turn_until(
            lambda: plant.answered and all(endpoints.last_stamp >= stamp for endpoints, stamp in due), STOPPING_S
        )
        self._plant.announce_end()
        if self._of_plant.wire.layout.reports:
            self._of_plant.deliver(STOPPING_S)  # to the train behind; the other readers are in this process
        if self._watch.failure is not None:
            self._of_plant.log(self._watch.failure)
        for endpoints in self._all_endpoints.values():
            for name, count in endpoints.published.items():
                end.published[name] = end.published.get(name, 0) + count
        if self._options.external is not Role.PLANT:  # it goes on, and so do the answers
            self._turn_until(lambda: recorder.complete(end.published), self._options.draining)
        in_order = self._watch.failure is None and self._options.external is not Role.PLANT
        expected = end.published if in_order else None
        self._all_endpoints[Role.RECORDER].guard(lambda: recorder.close(expected))
        if (external := self._options.external) is not None:
            end.outside = {external.value: recorder.endpoints.external_name}
            end.published |= {
                name: n
                for name, n in recorder.log.counts.items()
                if external is Role.PLANT or recorder.endpoints.sent_outside(name)
            }
