"""Requirements of a scenario: robustness of their formulas over a recording, as rows of the verdict.

Series of the signals of requirements, from a recording; names, units and meanings are in the scenario layer.

Robustness of a formula over sampled signals: margin to the change of its truth value, in SI units.

The semantics are quantitative (A. Donzé and O. Maler, "Robust satisfaction of temporal logic over real-valued signals",
FORMATS 2010) and use the samples of a run. A comparison has the difference of its sides. ``and`` and ``G`` have the
minimum, ``or`` and ``F`` the maximum, and ``not`` the negative value. A window is cut at the ends of the run. In an
empty window ``G`` is infinitely true and ``F`` infinitely false.

A window of w samples takes log2(w) passes over the samples, because the extreme of 2 m samples follows from two
neighbouring extremes of m samples. A bounded until is ``l U[0,w] r = F[0,w] r and (l U r)``. It takes one pass more (A.
Donzé, T. Ferrère and O. Maler, "Efficient robust monitoring for STL", CAV 2013).
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_sim.compiled import compiled
from train_ato.judge.metrics import JERK_SPAN, front_of_train, limit_over_train, place_of_front
from train_ato.judge.recording import BRAKE_PIPE, BRAKE_PIPE_TAIL, BRAKE_SHOES, SUPERVISED_SPEEDS, Recording
from train_ato.judge.stops import PlannedStop, planned_stops
from train_ato.messages.types import Array
from train_ato.scenario import formula as stl
from train_ato.scenario.setup import RunSetup
from train_ato.scenario.signals import find_signal, unavailable_signal

_ON_GRID = 1e-6
"""Part of a tick by which a limit of a window may be beside a sample."""


def robustness_series(formula: stl.Formula, signals: Mapping[str, Array], tick: float) -> Array:
    """Return the robustness at every sample, shape (k,).

    Parameters
    ----------
    formula
        Syntax tree.
    signals : dict of Array, each of shape (k,)
        Samples by name [SI].
    tick
        Time between two samples [s].
    """
    return _Samples(signals, tick).formula(formula, 1.0)


def robustness_at_start(formula: stl.Formula, signals: Mapping[str, Array], tick: float) -> float:
    """Return the robustness at the first sample, that of the run; parameters as :func:`robustness_series`."""
    return _Samples(signals, tick).at_start(formula, 1.0)


def robustness_bounds(
    formula: stl.Formula, signals: Mapping[str, Array], tick: float, remaining: int
) -> tuple[float, float]:
    """Return the smallest and the largest robustness at the start of a run that is not complete.

    A formula with a lower bound of at least 0 will hold and one with a negative upper bound is violated, for all
    signals after the last sample.

    Parameters
    ----------
    formula, signals, tick
        As for :func:`robustness_series`, up to the present sample.
    remaining
        Number of samples to the end of the run.
    """
    samples = _Samples(signals, tick, remaining)
    return samples.at_start(formula, 1.0), samples.at_start(formula, -1.0)


class _Samples:
    """Samples of the signals, followed by ``remaining`` unknown ones."""

    def __init__(self, signals: Mapping[str, Array], tick: float, remaining: int = 0) -> None:
        self._signals, self._tick, self._remaining = signals, tick, remaining
        self._size = next(iter(signals.values())).size

    def at_start(self, node: stl.Formula, sign: float) -> float:
        """Return the robustness at the first sample; the outer operators need no series."""
        if isinstance(node, stl.Negation):
            return -self.at_start(node.operand, -sign)
        if isinstance(node, stl.Connective) and node.operator != "->":
            return (min if node.operator == "and" else max)(
                self.at_start(node.left, sign), self.at_start(node.right, sign)
            )
        if isinstance(node, stl.Temporal) and node.operator in ("G", "F"):
            begin, end = self._window(node.window)
            values = self.formula(node.operand, sign)[begin : end + 1]
            if node.operator == "G":
                return float(values.min(initial=math.inf))
            return float(values.max(initial=-math.inf))
        return float(self.formula(node, sign)[0])

    def formula(self, node: stl.Formula, sign: float) -> Array:
        """Return the robustness at every sample; an unknown predicate is infinite, with ``sign`` 1 false."""
        if isinstance(node, stl.Predicate):
            left, right = self._term(node.left), self._term(node.right)
            values = np.broadcast_to(right - left if node.operator == "<=" else left - right, (self._size,))
            return np.append(values, np.full(self._remaining, -sign * math.inf)) if self._remaining else values
        if isinstance(node, stl.Negation):
            return -self.formula(node.operand, -sign)
        if isinstance(node, stl.Connective):
            right = self.formula(node.right, sign)
            if node.operator == "->":
                return np.maximum(-self.formula(node.left, -sign), right)
            return (np.minimum if node.operator == "and" else np.maximum)(self.formula(node.left, sign), right)
        begin, end = self._window(node.window)
        past = node.operator in ("O", "H", "S")
        if isinstance(node, stl.Temporal):
            lowest = node.operator in ("G", "H")
            return _reversed_if(
                past, _extreme(_reversed_if(past, self.formula(node.operand, sign)), begin, end, lowest=lowest)
            )
        left, right = (_reversed_if(past, self.formula(part, sign)) for part in (node.left, node.right))
        return _reversed_if(past, _until(left, right, begin, end))

    def _window(self, window: stl.Window) -> tuple[int, int]:
        """Return the first and the last sample of a window, at most the number of all samples."""
        size = self._size + self._remaining
        begin = math.ceil(min(window.begin / self._tick, size) - _ON_GRID)
        return begin, max(begin - 1, math.floor(min(window.end / self._tick, size) + _ON_GRID))

    def _term(self, node: stl.Term) -> Array | float:
        """Return the values of a term, shape (k,), or its only value."""
        if isinstance(node, stl.NumberTerm):
            return node.value
        if isinstance(node, stl.SignalTerm):
            return self._signals[node.name]
        if isinstance(node, stl.AbsTerm):
            return np.abs(self._term(node.operand))
        assert isinstance(node, stl.ArithmeticTerm)
        left, right = self._term(node.left), self._term(node.right)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if node.operator == "/":
                return np.divide(left, right)
            return {"+": np.add, "-": np.subtract, "*": np.multiply}[node.operator](left, right)


def _reversed_if(past: bool, values: Array) -> Array:
    return values[::-1] if past else values


def _extreme(values: Array, begin: int, end: int, *, lowest: bool) -> Array:
    """Return the minimum or maximum over the samples i + begin to i + end of every sample i, shape (k,)."""
    join, empty = (np.minimum, math.inf) if lowest else (np.maximum, -math.inf)
    size, width = values.size, end - begin + 1
    if width <= 0 or begin >= size:
        return np.full(size, empty)
    if end >= size - 1:  # every window reaches the end of the run
        part = np.asarray(join.accumulate(values[begin:][::-1])[::-1])
        return np.append(part, np.full(begin, empty)) if begin else part
    part, other = np.empty(size - 1 + width), np.empty(size - 1 + width)
    part[: size - begin], part[size - begin :] = values[begin:], empty
    count, length = 1, part.size
    while count < width:  # part[i] is the extreme of count samples from i on
        step = min(count, width - count)
        length -= step
        join(part[:length], part[step : step + length], out=other[:length])
        part, other, count = other, part, count + step
    return part[:size]


def _until(left: Array, right: Array, begin: int, end: int) -> Array:
    """Return the robustness of ``left U[begin,end] right``, shape (k,)."""
    unbounded: Array = _until_end(np.ascontiguousarray(left), np.ascontiguousarray(right))
    holds = np.minimum(unbounded, _extreme(right, 0, end - begin, lowest=False))
    if begin:
        later = np.full(left.size, -math.inf)
        later[: max(0, left.size - begin)] = holds[begin:]
        holds = np.minimum(_extreme(left, 0, begin - 1, lowest=True), later)
    return holds


@compiled
def _until_end(left: Array, right: Array) -> Array:  # pragma: no cover - compiled
    """Return the robustness of the until without a bound: u[i] = max(right[i], min(left[i], u[i + 1]))."""
    result = np.empty(left.size)
    held = -np.inf
    for index in range(left.size - 1, -1, -1):
        held = max(right[index], min(left[index], held))
        result[index] = held
    return result


PERMITTED, EMERGENCY = 1, 4
"""Columns of the permitted speed and of the emergency-brake speed in ``atp/speeds``."""


def signal_series(names: Iterable[str], setup: RunSetup, recording: Recording) -> dict[str, Array]:
    """Return the samples of signals at the complete ticks, shape (k,) each [SI].

    A signal of a slower topic keeps its value to the next message; before the first message it has the first value.
    """
    found = {}
    for name in names:
        signal = find_signal(name)
        assert signal is not None, name
        values, unit = SERIES[signal[0].name](setup, recording), signal[1]
        found[name] = values.sum(axis=1) if values.ndim == 2 and unit is None else values
        if unit is not None:
            found[name] = values[:, unit]
    return found


def _held(topic: str, name: str, column: int) -> Callable[[RunSetup, Recording], Array]:
    """Return the function of a value that is held between the messages of a topic."""

    def values(setup: RunSetup, recording: Recording) -> Array:
        found = recording.of(topic, name)
        if found is None or not found[0].size:
            return np.full(recording.time.size, np.nan)
        rows = np.searchsorted(found[0], recording.time, side="right") - 1
        return np.asarray(found[1][np.maximum(rows, 0), column], dtype=np.float64)

    return values


def _change(values: Array, samples: int) -> Array:
    """Return the change over the last samples; before the start the first value is assumed."""
    earlier = np.append(np.full(min(samples, values.size), values[0]), values[:-samples])
    return np.asarray(values - earlier)


def _acceleration(setup: RunSetup, recording: Recording) -> Array:
    samples = max(1, round(JERK_SPAN / setup.tick))
    return _change(recording.front_velocity, samples) / (samples * setup.tick)


def _jerk(setup: RunSetup, recording: Recording) -> Array:
    samples = max(1, round(1.0 / setup.tick))
    return _change(_change(recording.front_velocity, samples), samples) / (samples * setup.tick) ** 2


def _distance_to_stop(setup: RunSetup, recording: Recording) -> Array:
    """Return the way to the next stop [m]: a stop is the next one up to its planned departure."""
    stops = planned_stops(setup.profile) or [PlannedStop(float(setup.profile.position[-1]), 0.0, np.inf)]
    rows = np.searchsorted([stop.departure for stop in stops], recording.time, side="right")
    rows = np.minimum(rows, len(stops) - 1)
    places = np.array([float(setup.profile.position[0]), *(stop.position for stop in stops)])
    sign = np.where(np.diff(places) < 0.0, -1.0, 1.0)  # a train can run back after a stop
    return np.asarray(sign[rows] * (places[1:][rows] - recording.front_position))


SERIES: dict[str, Callable[[RunSetup, Recording], Array]] = {
    "time": lambda setup, recording: recording.time,
    "speed": lambda setup, recording: recording.front_velocity,
    "reference_speed": lambda setup, recording: recording.reference_velocity,
    "speed_error": lambda setup, recording: recording.front_velocity - recording.reference_velocity,
    "limit": lambda setup, run: limit_over_train(setup.line, front_of_train(setup, run), setup.consist.length),
    "permitted_speed": _held(SUPERVISED_SPEEDS, "speed", PERMITTED),
    "emergency_brake_speed": _held(SUPERVISED_SPEEDS, "speed", EMERGENCY),
    "acceleration": _acceleration,
    "jerk": _jerk,
    "position": lambda setup, recording: recording.front_position,
    "front": front_of_train,
    "reference_position": lambda setup, recording: recording.reference_position,
    "position_error": lambda setup, recording: recording.front_position - recording.reference_position,
    "distance_to_stop": _distance_to_stop,
    "command": lambda setup, recording: recording.command,
    "effort": lambda setup, recording: recording.applied,
    "coupler_draft": lambda setup, recording: np.maximum(0.0, recording.coupler_draft_max),
    "coupler_buff": lambda setup, recording: np.minimum(0.0, recording.coupler_buff_max),
    "pipe_pressure": _held(BRAKE_PIPE, "pressure", 0),
    "pipe_pressure_tail": _held(BRAKE_PIPE_TAIL, "pressure", 0),
    "shoe_force": _held(BRAKE_SHOES, "total", 0),
}
"""Series of every signal; shape (k, u) for one with a value for each power unit."""


ROBUSTNESS = "robustness"
"""Metric in the row of a requirement."""


@dataclass(frozen=True)
class Robustness:
    """Robustness of a formula at the start of a run.

    Attributes
    ----------
    lower, upper
        Bounds [SI]; equal for a complete run.
    unit
        SI unit; "" for comparisons of different quantities.
    at_s
        Time of the decisive margin [s]. ``G`` has the time of its smallest margin, ``F`` that of its largest, and a
        connective that of its decisive part. None for others.
    """

    lower: float
    upper: float
    unit: str = ""
    at_s: float | None = None

    @property
    def passed(self) -> bool | None:
        """Return True or False if the bounds decide it; None also for a window beyond the end of the run."""
        if math.isfinite(self.lower) and self.lower >= 0.0:
            return True
        if math.isfinite(self.upper) and self.upper < 0.0:
            return False
        return None

    @property
    def value(self) -> float | None:
        """Return the robustness [SI]; None if it is not known or not finite."""
        return self.lower if self.lower == self.upper and math.isfinite(self.lower) else None


def evaluate_formula(formula: stl.Formula, setup: RunSetup, recording: Recording) -> Robustness:
    """Return the robustness of a formula over a recording with at least one complete tick.

    The recording of a run that ended early has bounds for all continuations up to the duration of the scenario.
    """
    signals = signal_series(stl.signals_of(formula), setup, recording)
    remaining = max(0, setup.ticks - recording.time.size)
    dimension = stl.robustness_dimension(formula)
    unit = "" if dimension is None else stl.unit_text(dimension)
    at_s = _decisive_time(formula, signals, setup.tick)
    if remaining:
        return Robustness(*robustness_bounds(formula, signals, setup.tick, remaining), unit, at_s)
    value = robustness_at_start(formula, signals, setup.tick)
    return Robustness(value, value, unit, at_s)


def _decisive_time(formula: stl.Formula, signals: Mapping[str, Any], tick: float) -> float | None:
    """Return the time of the margin that is the robustness at the start of a run [s], or None."""
    if isinstance(formula, stl.Predicate):
        return 0.0
    if isinstance(formula, stl.Negation):
        return _decisive_time(formula.operand, signals, tick)
    if isinstance(formula, stl.Connective):
        parts = (stl.Negation(formula.left) if formula.operator == "->" else formula.left, formula.right)
        choose = min if formula.operator == "and" else max
        return _decisive_time(choose(parts, key=lambda part: robustness_at_start(part, signals, tick)), signals, tick)
    if not isinstance(formula, stl.Temporal) or formula.operator not in ("G", "F"):
        return None
    begin = math.ceil(formula.window.begin / tick - 1e-6)
    margins = robustness_series(formula.operand, signals, tick)
    end = margins.size if math.isinf(formula.window.end) else math.floor(formula.window.end / tick + 1e-6) + 1
    within = margins[begin:end]
    if not within.size:
        return None
    return float((begin + int(within.argmin() if formula.operator == "G" else within.argmax())) * tick)


def requirement_rows(setup: RunSetup, recording: Recording) -> list[dict[str, Any]]:
    """Return the rows of ``criteria`` in ``summary.json`` for the requirements of the scenario.

    A row has the name, ``metric``: ``robustness``, value [SI] (None if it is not known), limit 0, ``passed``, the
    formula, the unit, and the time and place of the decisive margin.
    """
    rows = []
    for name, text in (setup.scenario.criteria.requirements or {}).items():
        found = evaluate_formula(stl.parse_formula(text), setup, recording)
        rows.append(requirement_row(name, text, found, setup, recording))
    return rows


def recorded_rows(recording: Recording, formulas: Sequence[str], where: str) -> list[dict[str, Any]]:
    """Return the rows of formulas over a recording with its scenario, each with its text as name.

    Raises
    ------
    ValueError
        Without a scenario or a complete tick, or for a signal that the run does not have; ``where`` begins the message.
    """
    setup = recording.setup
    if setup is None:
        raise ValueError(f"{where}: the log has no scenario ({recording.setup_missing}); name a run folder")
    if not recording.time.size:
        raise ValueError(f"{where}: the log has no complete tick; name another run")
    rows = []
    for text in formulas:
        formula = stl.parse_formula(text)
        if reason := unavailable_signal(stl.signals_of(formula), setup.layout, setup.line):
            raise ValueError(f"{where} '{text}': {reason}")
        rows.append(requirement_row(text, text, evaluate_formula(formula, setup, recording), setup, recording))
    return rows


def requirement_row(
    name: str, text: str, found: Robustness, setup: RunSetup, recording: Recording
) -> dict[str, Any]:  # fmt: skip
    """Return the row of a requirement for ``summary.json``."""
    value = found.value if found.value is not None else found.upper if found.passed is False else None
    return {
        "criterion": name,
        "metric": ROBUSTNESS,
        "value": value,
        "limit": 0.0,
        "passed": found.passed,
        "formula": text,
        "unit": found.unit,
        "at_s": found.at_s,
        **({"km": None} if found.at_s is None else place_of_front(setup, recording, found.at_s)),
    }
