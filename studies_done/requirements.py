"""Time of the evaluation of requirements, per formula and simulated hour, and its ratio to rtamt in the same run.

Run: ``python studies_done/requirements.py`` (``--json`` for data); rtamt is a dependency of the tests, ``pip install rtamt``.
The signals are random walks; the times do not depend on their values.  The goal: at most 2 ms per formula and hour.
The exit status is 1 if it is missed widely (see figures.py).
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Goal, judge

from train_ato.judge.requirements import robustness_at_start, robustness_bounds, robustness_series
from train_ato.scenario.formula import parse_formula, signals_of

HOUR_S = 3600
TICKS = {"xuzhou_metro": 0.05, "daqin_heavy_haul": 0.1}
"""Tick of two shipped scenarios [s]."""
FORMULAS = (
    "G (speed <= limit + 1 km/h)",
    "F[0,30] speed >= 5 km/h",
    "G (speed_error >= 2 km/h -> F[0,30] abs(speed_error) <= 1 km/h)",
    "G[10,end] (H[0,5] speed <= 1 km/h or abs(jerk) <= 0.3 m/s3)",
    "G (speed >= 1 km/h -> (speed_error <= 5 km/h U[0,2] speed <= limit))",
)
MOST_MS = 2.0
SHARE = 20
"""The ratio to rtamt is that of a 20th of the hour, because rtamt needs a minute for some formulas of an hour."""
REPEATS = 7
RTAMT_WORDS = (("G", "always"), ("F", "eventually"), ("H", "historically"), ("U", "until"))


def _least_ms(call: Callable[[], Any]) -> float:
    taken = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        call()
        taken.append(time.perf_counter() - begin)
    return 1e3 * min(taken)


def _rtamt_ms(text: str, signals: dict[str, Any], tick: float) -> float | None:
    """Return the time of rtamt [ms], of one evaluation; None if it is not installed."""
    try:
        import rtamt
    except ImportError:
        return None
    size = next(iter(signals.values())).size
    spec = rtamt.StlDiscreteTimeSpecification()
    for name in signals:
        spec.declare_var(name, "float")
    spec.spec = _as_rtamt(text, tick, size)
    spec.parse()
    rows = {"time": list(range(size)), **{name: values.tolist() for name, values in signals.items()}}
    begin = time.perf_counter()
    found = spec.evaluate(rows)
    taken = 1e3 * (time.perf_counter() - begin)
    own = robustness_series(parse_formula(text), signals, tick)
    assert np.allclose([value for _, value in found], own, rtol=0, atol=1e-9), text
    return taken


def _as_rtamt(text: str, tick: float, size: int) -> str:
    """Return a formula of the table in the grammar of rtamt: numbers in SI, intervals in samples."""
    for unit, factor in (("km/h", 1 / 3.6), ("m/s3", 1.0)):
        parts = text.split(f" {unit}")
        heads = [part.rpartition(" ") for part in parts[:-1]]
        text = "".join(f"{head} ({float(number) * factor!r})" for head, _, number in heads) + parts[-1]
    out, rest = "", text
    while "[" in rest:
        before, _, rest = rest.partition("[")
        inside, _, rest = rest.partition("]")
        begin, end = (size - 1 if part == "end" else round(float(part) / tick) for part in inside.split(","))
        end = min(end, size - 1)
        out += f"{before}[{begin}:{end}]"
    text = out + rest
    for letter, word in RTAMT_WORDS:
        text = text.replace(f"{letter} ", f"{word} ").replace(f"{letter}[", f"{word}[")
    return text


def main() -> int:
    """Print a line for every formula and tick, and the goal; return the exit status."""
    rows = []
    stream = np.random.default_rng(1)
    for scenario, tick in TICKS.items():
        size = round(HOUR_S / tick)
        for text in FORMULAS:
            formula = parse_formula(text)
            signals = {name: np.cumsum(stream.normal(scale=0.02, size=size)) for name in signals_of(formula)}
            robustness_at_start(formula, signals, tick)  # compiles the until
            own = _least_ms(lambda f=formula, s=signals, t=tick: robustness_at_start(f, s, t))
            half = {name: values[: size // 2] for name, values in signals.items()}
            live = _least_ms(lambda f=formula, s=half, t=tick, n=size: robustness_bounds(f, s, t, n - n // 2))
            part = {name: values[: size // SHARE] for name, values in signals.items()}
            short = _least_ms(lambda f=formula, s=part, t=tick: robustness_at_start(f, s, t))
            other = _rtamt_ms(text, part, tick)
            rows.append({"scenario": scenario, "samples": size, "formula": text, "ms": own, "bounds_ms": live,
                         "rtamt_ms": other, "ratio": None if other is None else other / short})  # fmt: skip
    goals = [Goal(f"slowest formula, {HOUR_S} s", max(row["ms"] for row in rows), MOST_MS, "ms")]
    if "--json" in sys.argv:
        sys.stdout.write(json.dumps({"rows": rows, "goals": [goal.as_data() for goal in goals]}, indent=2) + "\n")
        return judge(goals, quiet=True)
    for row in rows:
        other = (
            "rtamt is not installed"
            if row["ratio"] is None
            else f"rtamt {row['rtamt_ms']:8.1f} ms, x {row['ratio']:.0f}"
        )
        own = f"{row['ms']:6.3f} ms   bounds {row['bounds_ms']:6.3f} ms"
        sys.stdout.write(f"{row['samples']:6d} samples {row['formula']:72s} {own}   {other}\n")
    return judge(goals)


if __name__ == "__main__":
    sys.exit(main())
