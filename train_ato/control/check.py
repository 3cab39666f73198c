"""Contract tests on anybody's law: what must hold before it is put into the loop.

``check_law("package.module:Law")`` drives the law on shipped trains, taken as rigid, along a run of a minute, and feeds
it what sensors must not but do send. A law may refuse a train with a ValueError that says why; one train must remain.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from train_ato.control.check_bench import PERIOD, Bench
from train_ato.control.contract import LawInput, Preview, parameters_of
from train_ato.control.registry import load
from train_ato.types import Array

HOSTILE = (math.nan, math.inf, -math.inf, 1e300, -1e300, 1e18)
"""Values that every input is set to in turn."""
TRAINS = ("xuzhou_metro_3", "freight_five", "crh380a_three_units", "hxd1_c80_105")
"""Shipped trains on which a law is tried; the last with a sensor at its first coupler."""
PATIENCE = 3.0
"""Longest time that is spent on timing one law on one train [s]."""
SLOW = "slower than the control period"


@dataclass(frozen=True)
class Finding:
    """Outcome of one test on one train: ``passed`` is None for what is only reported."""

    train: str
    test: str
    passed: bool | None
    detail: str = ""


BROKEN = (Exception, SystemExit)
"""What a law may throw at its checker: a law that ends the program is one more that raises."""


def check_law(
    target: str | type,
    values: dict[str, Any] | None = None,
    told: Callable[[float, str], None] | None = None,
) -> list[Finding]:
    """Run every contract test.

    Parameters
    ----------
    target
        The law's class, or ``package.module:Law``.
    values
        Parameters that differ from the defaults.
    told
        Called with the share of the work that is done and a word on it.

    Returns
    -------
    list of Finding
        The law is fit for the loop if none has ``passed`` False.

    Raises
    ------
    ValueError
        If the class cannot be loaded.
    """
    law = load(target) if isinstance(target, str) else target
    findings = [_described(law)]
    if findings[0].passed is False:
        return findings
    parameters = law.Parameters(**(values or {}))  # type: ignore[attr-defined]
    accepted = 0
    for index, name in enumerate(TRAINS):
        bench = Bench(name)
        try:
            made = law(parameters, bench.model, PERIOD)
        except ValueError as error:
            findings.append(Finding(name, "accepts the train", None, f"refused: {error}"))
            continue
        except BROKEN as error:
            findings.append(Finding(name, "accepts the train", False, f"raised {_named(error)}"))
            continue
        accepted += 1
        wrong = _misshapen(made)
        findings.append(Finding(name, "has the methods and words of a law", not wrong, wrong))
        if wrong:
            continue
        for finding in _on_train(lambda b=bench: law(parameters, b.model, PERIOD), bench):  # type: ignore[misc]
            findings.append(finding)
            if told is not None:
                told(
                    (index + (1 + list(TESTS).index(finding.test)) / len(TESTS)) / len(TRAINS),
                    f"{name}, {finding.test}",
                )
    findings.append(Finding("all", "accepts at least one train", accepted > 0, f"{accepted} of {len(TRAINS)}"))
    return findings


def table(findings: list[Finding]) -> str:
    """Return the findings as text, one line each."""
    words = {True: "ok", False: "FAILED", None: "note"}
    width = max(len(finding.test) for finding in findings)
    return "\n".join(f"{words[f.passed]:6}  {f.train:20}  {f.test:{width}}  {f.detail}" for f in findings)


def _described(law: Any) -> Finding:
    declared = getattr(law, "Parameters", None)
    test = "describes its parameters"
    if not (isinstance(declared, type) and dataclasses.is_dataclass(declared)):
        return Finding("", test, False, "the class needs a dataclass `Parameters`")
    try:
        listed = parameters_of(declared)
    except KeyError as error:
        return Finding("", test, False, f"a field was not made by parameter(): it lacks {error}")
    for entry in listed:
        number = isinstance(entry.default, (int, float)) and not isinstance(entry.default, bool)
        if number and not entry.low <= float(entry.default) <= entry.high:
            return Finding("", test, False, f"default of {entry.name} lies outside its own range")
        if not entry.meaning:
            return Finding("", test, False, f"{entry.name} has no meaning")
    return Finding("", test, True, f"{len(listed)} parameters")


def _misshapen(law: Any) -> str:
    """Return what a law lacks of the contract, an empty text if nothing."""
    for name in ("reset", "step"):
        if not callable(getattr(law, name, None)):
            return f"it has no method {name}()"
    if not callable(getattr(law, "missed", _misshapen)):
        return "missed is no method"
    horizon = getattr(law, "horizon", 0)
    if isinstance(horizon, bool) or not isinstance(horizon, int) or horizon < 0:
        return f"horizon is a number of entries, 0 or more, not {horizon!r}"
    return ""


def _on_train(make: Callable[[], Any], bench: Bench) -> Iterator[Finding]:
    """Run the tests; a law that cannot keep up with its period is not driven any further: that would take hours."""
    for test, run in TESTS.items():
        try:
            passed, detail = run(make, bench)
        except BROKEN as error:
            passed, detail = False, f"raised {_named(error)}"
        yield Finding(bench.name, test, passed, detail)
        if detail.startswith(SLOW):
            return


def _named(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def _within(output: Any, given: LawInput) -> str:
    """Return what is wrong with an output, an empty text if nothing is."""
    force = getattr(output, "force", None)
    if not isinstance(force, np.ndarray) or force.shape != given.force_min.shape or force.dtype != np.float64:
        return f"force is no float64 array of shape {given.force_min.shape}: {force!r}"
    if not np.isfinite(force).all():
        return f"not finite: {force}"
    if (force < given.force_min - 1e-6).any() or (force > given.force_max + 1e-6).any():
        return f"{force} N is outside {given.force_min} ... {given.force_max} N"
    pipe = getattr(output, "brake_pipe", None)
    return "" if pipe is None or math.isfinite(pipe) else f"brake pipe pressure {pipe}"


def _bounds(make: Callable[[], Any], bench: Bench) -> tuple[bool, str]:
    law = make()
    for speed_error in (0.0, -5.0, 5.0, 0.3):
        for step in range(50):
            t = step * PERIOD
            place, speed, _, _ = bench.profile.at(t)
            given = bench.inputs(
                t, place, max(0.0, speed + speed_error), np.zeros(bench.model.n_units), getattr(law, "horizon", 0)
            )
            wrong = _within(law.step(given), given)
            if wrong:
                return False, f"{speed_error:+g} m/s off: {wrong}"
    return True, ""


def _determinism(make: Callable[[], Any], bench: Bench) -> tuple[bool, str]:
    first, _ = bench.drive(make(), 200)
    second, _ = bench.drive(make(), 200)
    return first.tobytes() == second.tobytes(), ""


def _reset(make: Callable[[], Any], bench: Bench) -> tuple[bool, str]:
    law = make()
    first, _ = bench.drive(law, 200)
    law.reset()
    second, _ = bench.drive(law, 200)
    off = np.flatnonzero((first != second).any(axis=1))
    return off.size == 0, f"the run after reset() differs from step {off[0]} on" if off.size else ""


def _untouched(make: Callable[[], Any], bench: Bench) -> tuple[bool, str]:
    """Compare what the law was given before and after, and hand it arrays that it could write to."""
    law = make()
    for step in range(200):
        place, speed, _, _ = bench.profile.at(step * PERIOD)
        given = bench.inputs(step * PERIOD, place, speed, np.zeros(bench.model.n_units), getattr(law, "horizon", 0))
        ahead = (given.preview.position, given.preview.velocity, given.preview.acceleration)
        given = dataclasses.replace(given, preview=Preview(*(np.array(part) for part in ahead)))
        before = {name: np.array(value) for name, value in _arrays(given)}
        law.step(given)
        for name, value in _arrays(given):
            if not np.array_equal(before[name], value):
                return False, f"changed {name} in step {step}"
    return True, ""


def _arrays(given: LawInput) -> Iterator[tuple[str, Array]]:
    for owner, prefix in ((given, ""), (given.preview, "preview.")):
        for entry in dataclasses.fields(owner):
            value = getattr(owner, entry.name)
            if isinstance(value, np.ndarray) and value.size:
                yield prefix + entry.name, value


def _hostile(make: Callable[[], Any], bench: Bench) -> tuple[bool, str]:
    """Set every input in turn, alone, to every hostile value, and go on with a sound one."""
    law = make()
    bench.drive(law, 20)
    place, speed, _, _ = bench.profile.at(2.0)
    sound = bench.inputs(2.0, place, speed, np.zeros(bench.model.n_units), getattr(law, "horizon", 0))
    kept = ("force_min", "force_max")
    for entry in dataclasses.fields(sound):
        value = getattr(sound, entry.name)
        for bad in HOSTILE:
            if entry.name in kept or isinstance(value, bool):
                continue
            spoilt: Any = bad
            if isinstance(value, np.ndarray):
                spoilt = np.full_like(value, bad)
            elif isinstance(value, Preview):
                spoilt = Preview(
                    *(np.full_like(part, bad) for part in (value.position, value.velocity, value.acceleration))
                )
            given = dataclasses.replace(sound, **{entry.name: spoilt})
            wrong = _within(law.step(given), given) or _within(law.step(sound), sound)
            if wrong:
                return False, f"{entry.name} = {bad:g}: {wrong}"
    return True, f"{len(HOSTILE)} values for every input"


def _recovery(make: Callable[[], Any], bench: Bench) -> tuple[bool, str]:
    _, errors = bench.drive(make())
    forces, spoilt = bench.drive(make(), spoil=range(200, 205))
    if not np.isfinite(forces).all():
        return False, "the force is not finite"
    usual, after = np.abs(errors[-100:]).max(), np.abs(spoilt[-100:]).max()
    detail = f"speed error at the end {after:.3g} m/s, undisturbed {usual:.3g}"
    return bool(after <= max(2.0 * usual, 0.05)), detail


def _timing(make: Callable[[], Any], bench: Bench) -> tuple[bool | None, str]:
    """Take the time of up to 300 steps; only a law slower than its own period fails."""
    law = make()
    horizon = getattr(law, "horizon", 0)
    taken: list[float] = []
    for step in range(300):
        place, speed, _, _ = bench.profile.at(step * PERIOD)
        given = bench.inputs(step * PERIOD, place, speed, np.zeros(bench.model.n_units), horizon)
        begin = time.perf_counter_ns()
        law.step(given)
        taken.append((time.perf_counter_ns() - begin) / 1e3)
        if sum(taken) > PATIENCE * 1e6:
            break
    median, high = np.percentile(np.array(taken[len(taken) // 6 :]), [50, 99])
    if median > PERIOD * 1e6:
        return False, f"{SLOW} of {PERIOD * 1e3:.0f} ms: median {median / 1e3:.0f} ms, no further test on this train"
    return None, f"median {median:.1f} µs, 99 % below {high:.1f} µs"


TESTS: dict[str, Callable[[Callable[[], Any], Bench], tuple[bool | None, str]]] = {
    "time of a step": _timing,
    "same inputs, same bits": _determinism,
    "finite and inside the limits": _bounds,
    "reset forgets everything": _reset,
    "leaves its inputs alone": _untouched,
    "hostile inputs": _hostile,
    "recovers after NaN": _recovery,
}
"""Contract tests in their order."""
