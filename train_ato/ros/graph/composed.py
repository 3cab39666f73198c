"""All nodes of a run in one process, on one executor."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from plant_sim.node import PlantNode, silent_node
from train_ato.failure import Watch
from train_ato.graph.assembly import TURN_S, executor_of, make_node
from train_ato.graph.run_end import ANSWERING, STOPPING_S, GraphOptions, Report, RunEnd
from train_ato.interrupt import Interrupt, interruptible
from train_ato.nodes.shell import ROLES, Shell
from train_ato.run_setup import RunSetup
from train_ato.topics import Role
from train_ato.wire import Wire

RECORD_EVERY = 50
"""Ticks after which the recorder empties its queues; they hold 1000."""
_SHORT_S = 0.005


def run_composed(
    setup: RunSetup, folder: Path, domain: int, options: GraphOptions, report: Report | None = None
) -> RunEnd:
    """Drive one run with all nodes in this process, recorded into ``folder``.

    Returns
    -------
    RunEnd
        Its ``failure`` names the node at fault; the log is closed in every case.

    Raises
    ------
    ValueError
        If the log or a node cannot be made; nothing has run then.
    """
    watch = Watch(folder / "log")
    with interruptible() as interrupt, executor_of(domain) as (context, executor):
        wire = Wire(setup.shape)
        shells = {role: Shell(role, wire, context, watch) for role in ROLES}
        nodes = {
            role: make_node(role, setup, shells[role], folder, options.realtime, options.patience, pace=options.pace)
            for role in ROLES
        }
        for role, shell in shells.items():
            if role is not Role.RECORDER:
                executor.add_node(shell.node)
        try:
            return _Composed(executor, shells, nodes, watch, interrupt, options).run(report)
        finally:
            shells[Role.RECORDER].destroy()


class _Composed:
    """One run: meet, drive, drain, close."""

    def __init__(
        self,
        executor: Any,
        shells: dict[Role, Shell],
        nodes: dict[Role, Any],
        watch: Watch,
        interrupt: Interrupt,
        options: GraphOptions,
    ) -> None:
        self._executor = executor
        self._shells = shells
        self._nodes = nodes
        self._watch = watch
        self._interrupt = interrupt
        self._options = options
        self._plant: PlantNode = nodes[Role.PLANT]

    def run(self, report: Report | None) -> RunEnd:
        end = RunEnd()
        try:
            if self._meet():
                gc.collect()
                gc.freeze()
                begin = time.perf_counter()
                self._shells[Role.PROFILE].guard(self._nodes[Role.PROFILE].begin)
                self._shells[Role.PLANT].guard(self._plant.begin)
                self._drive(report)
                end.wall_s = time.perf_counter() - begin
        finally:
            self._close(end)
            gc.unfreeze()
        end.ticks = self._plant.role.tick
        end.late, end.held = self._plant.late, self._plant.held
        end.step_ns = self._nodes[Role.CONTROLLER].role.step_times.nanoseconds
        end.interrupted = self._interrupt.asked
        end.failure = self._watch.failure
        return end

    def _turn_until(self, done: Callable[[], bool], limit: float) -> bool:
        """Run callbacks until a condition holds; False when the limit passed, the run failed or was interrupted."""
        last = time.monotonic() + limit
        while not done():
            if time.monotonic() > last or self._watch.failure is not None:
                return False
            self._executor.spin_once(timeout_sec=_SHORT_S)
            self._record()
        return True

    def _record(self) -> None:
        self._shells[Role.RECORDER].guard(self._nodes[Role.RECORDER].poll)

    def _meet(self) -> bool:
        last = time.monotonic() + self._options.meeting
        while not self._interrupt.asked:
            absent = [(role.value, shell.missing()) for role, shell in self._shells.items() if shell.missing()]
            if not absent:
                return True
            if time.monotonic() > last:
                name, lacks = absent[0]
                self._watch.fail(name, f"it did not find {lacks[0]} within {self._options.meeting:g} s")
                return False
            self._executor.spin_once(timeout_sec=0.01)
        return False

    def _drive(self, report: Report | None) -> None:
        plant, watch, spin_once = self._plant, self._watch, self._executor.spin_once
        look, record = time.monotonic() + TURN_S, 0
        while not plant.finished and watch.failure is None:
            spin_once(timeout_sec=TURN_S)
            if plant.role.tick >= record:
                record = plant.role.tick + RECORD_EVERY
                self._record()
            now = time.monotonic()
            if now >= look:
                look = now + TURN_S
                self._record()
                if report is not None:
                    report(plant.role.tick)
                self._look()
                if self._interrupt.asked:
                    plant.request_stop()
                    self._turn_until(lambda: plant.finished, STOPPING_S)
                    return

    def _look(self) -> None:
        """Fail the run by name when an answer has been due for too long."""
        if self._plant.overdue:
            last = {role: shell.last_stamp for role, shell in self._shells.items()}
            silent = silent_node(last, self._plant.stamp, self._plant.blocked)
            self._watch.fail(
                silent.value,
                f"no answer to stamp {self._plant.stamp * 1e-9:.3f} s within {self._plant.timeout:g} s",
            )

    def _close(self, end: RunEnd) -> None:
        """Take what is under way, close the log, compare the numbers."""
        recorder, plant = self._nodes[Role.RECORDER], self._plant
        answering = [self._shells[role] for role in ANSWERING]
        # A paced run does not wait for the answers to its last measurement; they are still to be counted.
        self._turn_until(lambda: all(shell.last_stamp >= plant.asked for shell in answering), STOPPING_S)
        for shell in self._shells.values():
            for name, count in shell.published.items():
                end.published[name] = end.published.get(name, 0) + count
        self._turn_until(lambda: recorder.complete(end.published), self._options.draining)
        expected = end.published if self._watch.failure is None else None
        self._shells[Role.RECORDER].guard(lambda: recorder.close(expected))
        end.recorded = dict(recorder.log.counts)
