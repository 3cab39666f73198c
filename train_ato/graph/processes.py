"""Every node of a run in a process of its own."""

from __future__ import annotations

import queue
import time
from pathlib import Path
from typing import Any

from plant_sim.node import silent_node
from train_ato.graph import shared_memory
from train_ato.graph.child import Child, Event
from train_ato.graph.environment import variables
from train_ato.graph.run_end import ANSWERING, STOPPING_S, GraphOptions, Report, RunEnd
from train_ato.interrupt import Interrupt, interruptible
from train_ato.record.layout import LOG, PARTIAL
from train_ato.run_setup import RunSetup
from train_ato.topics import Role

ROLES = (Role.RECORDER, Role.PLANT, Role.CONTROLLER, Role.OBSERVER, Role.PROFILE)
"""Order in which the processes are started."""
_STARTING_S = 60.0
_ANSWER_S = 2.0
_CLOSING_S = 5.0
_TURN_S = 0.1


def run_processes(
    setup: RunSetup, folder: Path, domain: int, options: GraphOptions, report: Report | None = None
) -> RunEnd:
    """Drive one run with a process for each node, recorded into ``folder``.

    The nodes read the resolved scenario that is written there; no process and no shared memory is left behind.

    Returns
    -------
    RunEnd
        Its ``failure`` names the node at fault; the log is closed unless the recorder itself was killed.

    Raises
    ------
    ValueError
        If the log cannot be made.
    """
    for taken in (LOG, PARTIAL):
        if (folder / taken).exists():
            raise ValueError(f"{folder / taken}: exists already; name another output folder")
    scenario = folder / "scenario.yaml"
    scenario.write_text(setup.resolved_yaml(), encoding="utf-8")
    (folder / "log").mkdir(exist_ok=True)
    with interruptible() as interrupt:
        conductor = _Conductor(options, interrupt, report)
        try:
            conductor.start(scenario, folder, domain)
            conductor.conduct()
        finally:
            conductor.end_all()
            shared_memory.clean()
    conductor.end.interrupted = interrupt.asked
    return conductor.end


class _Conductor:
    """Starts the processes, follows their events, ends them."""

    def __init__(self, options: GraphOptions, interrupt: Interrupt, report: Report | None) -> None:
        self.end = RunEnd()
        self._options = options
        self._interrupt = interrupt
        self._report = report
        self._events: queue.Queue[Event] = queue.Queue()
        self._children: dict[Role, Child] = {}
        self._waiting: dict[Role, str] = {}
        self._reports: dict[Role, dict[str, Any]] = {}
        self._silent: dict[str, Any] | None = None
        self._ready: set[Role] = set()
        self._asked = -1
        self._finished = self._closed = self._leaving = False

    def start(self, scenario: Path, folder: Path, domain: int) -> None:
        """Start one process for each node."""
        environment = variables(domain, folder / "log")
        for role in ROLES:
            arguments = ["--scenario", str(scenario.resolve())]
            if role is Role.RECORDER:
                arguments += ["--out", str(folder.resolve())]
            if role is Role.PLANT:
                arguments += ["--timeout", repr(self._options.patience), "--pace", repr(self._options.pace)]
                if self._options.realtime is not None:
                    arguments += ["--realtime", repr(self._options.realtime)]
            self._children[role] = Child(role, arguments, environment, folder / "log", self._events)

    def conduct(self) -> None:
        """Meet, drive, drain, close."""
        if self._meet():
            begin = time.perf_counter()
            self._children[Role.PROFILE].tell("begin")
            self._children[Role.PLANT].tell("begin")
            self._drive()
            self.end.wall_s = time.perf_counter() - begin
        self._collect()
        self._close_log()

    @property
    def _over(self) -> bool:
        return self.end.failure is not None or self._interrupt.asked

    def _fail(self, reason: str) -> None:
        if self.end.failure is None:
            self.end.failure = reason

    def _turn(self) -> None:
        """Take one event, or let a tenth of a second pass."""
        try:
            role, event = self._events.get(timeout=_TURN_S)
        except queue.Empty:
            return
        self._take(role, event)

    def _take(self, role: Role, event: dict[str, Any]) -> None:
        kind = event["event"]
        if kind == "ready":
            self._ready.add(role)
            self._waiting.pop(role, None)
        elif kind == "waiting":
            self._waiting[role] = event["absent"]
        elif kind == "progress":
            self.end.ticks = event["tick"]
            if self._report is not None:
                self._report(self.end.ticks)
        elif kind == "finished":
            self._finished = True
            self._asked = event["asked"]
            self.end.ticks, self.end.late, self.end.held = event["tick"], event["late"], event["held"]
        elif kind == "silent":
            self._silent = event
        elif kind == "report":
            self._reports[role] = event
        elif kind == "closed":
            self._closed = True
            self.end.recorded = event["recorded"]
            if event["failure"]:
                self._fail(event["failure"])
        elif kind == "failed":
            self._fail(event["reason"])
        elif kind == "ended":
            self._children[role].ended = True
            if not self._leaving:
                self._fail(f"node {role.value} failed: {self._children[role].obituary()}")

    def _meet(self) -> bool:
        """Wait until every node has met the others; the time counts from when all of them run."""
        begin = time.monotonic()
        running: float | None = None
        while len(self._ready) < len(ROLES) and not self._over:
            self._turn()
            now = time.monotonic()
            if running is None and len(self._ready) + len(self._waiting) == len(ROLES):
                running = now
            late = running is not None and now - running > self._options.meeting
            if late or now - begin > _STARTING_S:
                role = next(role for role in ROLES if role not in self._ready)
                lacks = self._waiting.get(role)
                why = f"it did not find {lacks}" if lacks else "it did not start"
                self._fail(f"node {role.value} failed: {why} within {now - begin:.0f} s")
        return not self._over

    def _drive(self) -> None:
        while not self._finished and self.end.failure is None:
            self._turn()
            if self._silent is not None:
                self._name_silent(self._silent)
            if self._interrupt.asked:
                self._children[Role.PLANT].tell("stop")
                last = time.monotonic() + _ANSWER_S
                while not self._finished and self.end.failure is None and time.monotonic() < last:
                    self._turn()
                return

    def _ask(self, whole: bool) -> None:
        """Ask every living node for its report and wait for the answers."""
        self._reports.clear()
        asked = [child for child in self._children.values() if not child.ended]
        for child in asked:
            child.tell("report", whole=whole)
        last = time.monotonic() + _ANSWER_S
        while time.monotonic() < last and any(c.role not in self._reports and not c.ended for c in asked):
            self._turn()

    def _name_silent(self, event: dict[str, Any]) -> None:
        """Find out which node the plant waits for: one that hangs, or the first that did not answer the stamp."""
        self._ask(whole=False)
        hanging = [role for role in ROLES if role not in self._reports]
        last = {role: int(answer["last_stamp"]) for role, answer in self._reports.items()}
        silent = hanging[0] if hanging else silent_node(last, event["stamp"], event["blocked"])
        self._fail(
            f"node {silent.value} failed: no answer to stamp {event['stamp'] * 1e-9:.3f} s "
            f"within {event['timeout']:g} s"
        )

    def _collect(self) -> None:
        """Ask for the numbers of published messages and the step times."""
        if not self._reports:
            # A paced run does not wait for the answers to its last measurement; they are still to be counted.
            last = time.monotonic() + STOPPING_S
            self._ask(whole=True)
            while self.end.failure is None and not self._answered() and time.monotonic() < last:
                self._ask(whole=True)
        for role, answer in self._reports.items():
            for name, count in answer["published"].items():
                self.end.published[name] = self.end.published.get(name, 0) + count
            if role is Role.CONTROLLER:
                self.end.step_ns = answer["step_ns"]

    def _answered(self) -> bool:
        """Tell whether every node has answered the last measurement."""
        return all(role in self._reports and self._reports[role]["last_stamp"] >= self._asked for role in ANSWERING)

    def _close_log(self) -> None:
        """Let the recorder take what is under way and compare; after a failure only close the log."""
        recorder = self._children[Role.RECORDER]
        if recorder.ended or Role.RECORDER not in self._ready:
            return
        known = self._finished and len(self._reports) == len(ROLES)
        if self.end.failure is None and not known and not self._interrupt.asked:
            absent = next((role for role in ROLES if role not in self._reports), Role.PLANT)
            self._fail(f"node {absent.value} failed: it did not report at the end of the run")
        limit = self._options.draining if known else 0.0
        if known and self.end.failure is None:
            recorder.tell("drain", published=self.end.published, limit=limit)
        else:
            recorder.tell("close")
        last = time.monotonic() + limit + _CLOSING_S
        while not self._closed and not recorder.ended and time.monotonic() < last:
            self._turn()
        if not self._closed:
            self._fail(f"node recorder failed: it did not close the log within {limit + _CLOSING_S:g} s")

    def end_all(self) -> None:
        """End every process, those that do not want to by force."""
        self._leaving = True
        for child in self._children.values():
            child.tell("exit")
        for role, child in self._children.items():
            answers = role in self._reports or not self._reports
            child.end(_CLOSING_S if answers else 0.0)
