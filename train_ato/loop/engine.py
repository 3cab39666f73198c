"""Control loop in one Python process without ROS, with the same log as the nodes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from train_ato.judge.recording_builder import RecordingBuilder
from train_ato.judge.result import Progress, RunResult, failure_of_ato
from train_ato.loop.stage_messages import Published
from train_ato.loop.stages import Stages
from train_ato.messages.topics import TickBlock
from train_ato.messages.types import AtoReport, BrakeRelease, Diagnostic
from train_ato.program.errors import FirstFailure
from train_ato.program.interrupt import Interrupt, interruptible
from train_ato.scenario.setup import RunSetup

if TYPE_CHECKING:
    from train_ato.loop.span import CompiledSpans

COMPILED_FROM = 2000
"""Number of ticks from which a run uses compiled ticks: loading them takes as long as some hundred ticks."""


SIGNALS = "signals"
"""Name of the node in the diagnostics with own signals of the user."""


class Sink(Protocol):
    """Receiver of the messages of a run in the order of publication."""

    def add(self, topic: str, message: object, stamp: int) -> None:
        """Add one message."""

    def add_ticks(self, block: TickBlock) -> None:
        """Add the messages of compiled ticks, by default one by one; the arrays change after the call."""
        for stamp, messages in block.messages():
            for topic, message in messages:
                self.add(topic, message, stamp)


def run_engine(
    setup: RunSetup,
    *,
    sink: Sink | None = None,
    progress: Callable[[Progress], None] | None = None,
    rate: float = 0.0,
    log_folder: Path | None = None,
    interrupt: Interrupt | None = None,
    compiled: bool | None = None,
    summary_only: bool = False,
    messages_only: bool = False,
    on_tick: Callable[[TickLoop], bool] | None = None,
) -> RunResult:
    """Run a scenario to its end.

    Parameters
    ----------
    setup
        Prepared run.
    sink
        Receiver of every message, for example a log; None keeps only the series.
    progress
        Called about ten times a second of wall time.
    rate
        Maximum simulated seconds per second of wall time; 0 is unlimited.
    log_folder
        Folder for the traceback of a failure.
    interrupt
        Flag that ends the run after the current tick; None: set by Ctrl-C and SIGTERM, which end the program too.
    compiled
        Run ticks without events in compiled code; the numbers are the same. None: for runs of at least
        :data:`COMPILED_FROM` ticks.
    summary_only
        Return no recording; the series that the same summary does not need are not made.
    messages_only
        Return neither recording nor metrics, whose memory grows with the length of the run.
    on_tick
        Called in every tick before the law; True ends the run after this tick. No tick is then compiled.

    Returns
    -------
    RunResult
        Recording and summary, also of a run that ``interrupt`` ended.

    Raises
    ------
    KeyboardInterrupt, SystemExit
        Without ``interrupt``, after Ctrl-C or SIGTERM; the sink has all ticks.
    """
    if interrupt is None:
        with interruptible() as asked:
            result = run_engine(
                setup, sink=sink, progress=progress, rate=rate, log_folder=log_folder, interrupt=asked,
                compiled=compiled, summary_only=summary_only,
                messages_only=messages_only, on_tick=on_tick,
            )  # fmt: skip
        asked.pass_on()
        return result
    wanted = setup.ticks >= COMPILED_FROM and not rate if compiled is None else compiled
    stopped = False
    brief = (
        summary_only
        and sink is None
        and not setup.scenario.criteria.requirements
        and not setup.scenario.evaluation.couplers
    )
    loop = TickLoop(setup, sink, compiled=wanted, summary_only=brief)
    begin = next_report = time.perf_counter()
    clock_begin: float | None = None
    watch = FirstFailure(log_folder)
    try:
        loop.start()
        while not (loop.plant.finished or interrupt.asked or stopped):
            if on_tick is None:
                loop.advance()
            else:
                stopped = loop.tick(on_tick)
            if rate > 0.0:
                clock_begin = time.monotonic() if clock_begin is None else clock_begin  # after the first tick
                time.sleep(max(0.0, clock_begin + loop.ticks * setup.tick / rate - time.monotonic()))
            if progress is not None and (now := time.perf_counter()) >= next_report:
                progress(Progress(loop.ticks * setup.tick, setup.ticks * setup.tick, now - begin))
                next_report = now + 0.1
        loop.conclude()
    except (Exception, SystemExit) as error:  # a user-defined law may raise any; the failure names the stage
        watch.fail(loop.active, error)
    wall = time.perf_counter() - begin
    times = [] if loop.compiled else loop.controller.step_times
    published, recording = loop.recording.counts, loop.recording.finish()
    interrupted = interrupt.asked or stopped
    by_caller = f"stop_when ended it after {loop.ticks} of {setup.ticks} ticks" if stopped else ""
    if messages_only:
        failure = watch.failure or (None if interrupted else failure_of_ato(recording))
        return RunResult(None, {}, interrupted, failure, published)
    result = RunResult.of(
        setup, recording, wall, loop.ticks, times, interrupted=interrupted, failure=watch.failure,
        published=published, interruption=by_caller or interrupt.reason(loop.ticks, setup.ticks),
    )  # fmt: skip
    return replace(result, recording=None, published={}) if summary_only else result


class TickLoop(Stages):
    """The stages in the order of the messages of the nodes."""

    def __init__(
        self, setup: RunSetup, sink: Sink | None, *, compiled: bool = False, summary_only: bool = False
    ) -> None:
        super().__init__(setup)
        self.recording = RecordingBuilder(setup, summary_only)
        self.last_report: AtoReport | None = None
        self._release: BrakeRelease | None = None
        self.ticks = 0
        self.active = "engine"
        self._sink = sink
        self._spans_wanted = compiled
        self._spans: CompiledSpans | None = None

    def _publish(self, stamp: int, messages: Published) -> None:
        self.recording.extend(messages)
        if self._sink is not None:
            for topic, message in messages:
                self._sink.add(topic, message, stamp)

    def start(self) -> None:
        """Send the profile."""
        self.active = "profile"
        start = self.profile.start()
        self._publish(0, start.published())
        self.controller.set_profile(self.profile.profile)

    def tick(self, on_tick: Callable[[TickLoop], bool] | None = None) -> bool:
        """Run one tick; return the result of ``on_tick``, which is called before the law, False without it."""
        self.observe()
        stops = False
        if on_tick is not None:
            self.active = "on_tick"
            stops = on_tick(self)
        self.act()
        return stops

    def note(self, signals: Mapping[str, str]) -> None:
        """Send own signals of the user at the stamp of this tick."""
        self._publish(self.plant.stamp, [("/diagnostics", Diagnostic(self.plant.stamp, SIGNALS, 0, "", dict(signals)))])

    def observe(self) -> None:
        """Run the stages of a tick up to the inputs of the law."""
        stamp = self.plant.stamp
        self.active = "plant"
        plant = self.plant.observe()
        self._publish(stamp, plant.published())
        self._release = speeds = None
        if self.supervisor is not None and plant.odometry is not None:
            self.active = "supervisor"
            supervisor = self.supervisor.step(plant.odometry, plant.ahead)
            self._publish(stamp, supervisor.published())
            self._release, speeds = supervisor.release, supervisor.speeds
        self.active = "profile"
        report = None if self._release is None else self.last_report
        profile = self.profile.on_measurement(plant.measurement, report, plant.ahead)
        self._publish(stamp, profile.published())
        if profile.profile is not None:
            self.controller.set_profile(self.profile.profile)
        self.active = "observer"
        observer = self.observer.on_measurement(plant.measurement)
        self._publish(stamp, observer.published())
        self.active = "controller"
        self.controller.receive(
            plant.measurement, profile.reference, observer.estimate, plant.protection, speeds, ahead=plant.ahead
        )

    def act(self) -> None:
        """Run the law and the train of a tick after :meth:`observe`."""
        self.active = "controller"
        controller = self.controller.command()
        self._publish(self.plant.stamp, controller.published())
        self.active = "plant"
        self.plant.act(controller.command, controller.brake_pipe_command, self._release)
        self.last_report = controller.state or self.last_report
        self.ticks += 1

    @property
    def compiled(self) -> bool:
        """True if a compiled law has run; it has no time of its own."""
        return self._spans is not None and self._spans.untimed

    def advance(self) -> None:
        """Run the ticks up to the next event in compiled code if the run is long enough, otherwise one tick."""
        if self._spans_wanted and self.ticks:  # the first tick is one in Python and does not wait for their code
            self._spans_wanted, self._spans = False, self.compiled_spans()
        if self._spans is not None:
            self.active = "compiled ticks"
            self._spans.ato = self.last_report
            if done := self._spans.run():
                self.ticks += done
                self.last_report = self._spans.ato
                if not self._spans.has_answer:
                    return
        self.tick()

    def compiled_spans(self) -> CompiledSpans:
        """Return the compiled ticks of the run."""
        from train_ato.loop.span import CompiledSpans  # late import: only long runs need them

        return CompiledSpans(self, self.recording, None if self._sink is None else self._sink.add_ticks)

    def conclude(self) -> None:
        """Send the state after the last tick."""
        self._publish(self.plant.stamp, self.plant.conclude().published())
