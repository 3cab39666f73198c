"""Runs in Python and in compiled spans for the tests, with the comparison of their messages and recordings."""

from typing import Any
from unittest.mock import patch

from engine_runs import PARTS
from numba import typeof

from train_ato.api.scenario_choice import choose_scenario
from train_ato.judge.result import RunResult
from train_ato.judge.series import DiagnosticSeries
from train_ato.loop import engine
from train_ato.loop.engine import Sink, TickLoop, run_engine
from train_ato.loop.span import CompiledSpans
from train_ato.messages.codec import Wire
from train_ato.scenario.setup import RunSetup
from train_ato.studies.sweep.row import WALL_TIMES


class Messages(Sink):
    """All messages of a run as the bytes of the log."""

    def __init__(self, setup: RunSetup) -> None:
        self.rows: list[tuple[str, int, bytes]] = []
        self._wire = Wire(setup.layout)

    def add(self, topic: str, message: Any, stamp: int) -> None:
        self.rows.append((topic, stamp, self._wire.encode(topic, message)))


def setup_of(name: str, changes: dict[str, Any]) -> RunSetup:
    return choose_scenario(name).changed(changes, None).prepare(parts=PARTS)


class Both:
    """One case in Python and in compiled spans, each driven once: all messages, recording of Python, compiled part."""

    def __init__(self, setup: RunSetup) -> None:
        self.python, self._one, _ = _driven(setup, compiled=False)
        self.compiled, self._other, loop = _driven(setup, compiled=True)
        assert self._one.recording is not None
        self.recording = self._one.recording
        self.part = loop._spans.ticks / loop.ticks if loop._spans is not None else 0.0

    def assert_equal(self, least: float = 0.0) -> None:
        """Compare messages and recordings; at least this part of the ticks must be compiled."""
        first = next((pair for pair in zip(self.python, self.compiled, strict=False) if pair[0] != pair[1]), None)
        assert first is None, first
        assert len(self.python) == len(self.compiled), (len(self.python), len(self.compiled))
        assert_same_recording(self._one, self._other)
        assert self.part >= least


def _driven(setup: RunSetup, *, compiled: bool) -> tuple[list[tuple[str, int, bytes]], RunResult, TickLoop]:
    sink, loops = Messages(setup), []

    def kept(*given: Any, **named: Any) -> TickLoop:
        loops.append(TickLoop(*given, **named))
        return loops[-1]

    with patch.object(engine, "TickLoop", kept), patch.object(CompiledSpans, "call", call_of_same_types):
        result = run_engine(setup, sink=sink, compiled=compiled)
    assert result.failure is None, result.failure
    return sink.rows, result, loops[0]


_CALL = CompiledSpans.call


def call_of_same_types(spans: CompiledSpans, arguments: tuple[Any, ...]) -> int:
    """Call the compiled ticks, which look at the types of their arguments in the first call of a run only."""
    kinds = typeof(arguments)
    assert vars(spans).setdefault("kinds", kinds) == kinds
    return _CALL(spans, arguments)


def finished_loop(setup: RunSetup, *, compiled: bool) -> TickLoop:
    """Return the ticks of a run after their end."""
    loop = TickLoop(setup, None, compiled=compiled)
    loop.start()
    while not loop.plant.finished:
        loop.advance()
    return loop


def compiled_part(setup: RunSetup) -> float:
    """Return the part of the ticks of a run that are compiled."""
    loop = finished_loop(setup, compiled=True)
    return loop._spans.ticks / loop.ticks if loop._spans is not None else 0.0


def messages_of(setup: RunSetup, *, compiled: bool) -> list[tuple[str, int, bytes]]:
    """Return topic, stamp and content of all messages of a run in order."""
    return _driven(setup, compiled=compiled)[0]


def assert_same_recording(one: RunResult, other: RunResult) -> None:
    assert one.recording is not None and other.recording is not None
    a, b = one.recording, other.recording
    assert a.topics.keys() == b.topics.keys()
    for topic, samples in a.topics.items():
        found = b.topics[topic]
        assert samples.time.tobytes() == found.time.tobytes(), topic
        assert samples.values.keys() == found.values.keys(), topic
        for name, values in samples.values.items():
            assert (values.shape, values.tobytes()) == (found[name].shape, found[name].tobytes()), (topic, name)
    assert repr(a.reports) == repr(b.reports)
    assert a.diagnostics.keys() == b.diagnostics.keys()
    for node, series in a.diagnostics.items():
        assert repr(_columns(series)) == repr(_columns(b.diagnostics[node])), node
    assert one.published == other.published
    assert _of_simulation(one.summary) == _of_simulation(other.summary)


def _columns(series: DiagnosticSeries) -> list[Any]:
    values = {key: series.texts(key) for key in series.values}
    return [series.time.tolist(), series.level.tolist(), series.message, values]


def _of_simulation(summary: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in summary.items() if key not in WALL_TIMES}
