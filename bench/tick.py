"""Time of a tick of the engine by stage, compared with the compiled kernel, and of the construction of messages.

    python bench/tick.py [SCENARIO ...]

The times are medians over the ticks of a run of 60 s, without the log. The floor is the time of the kernel for the
steps of a tick. Some runs are also measured whole, in Python and in compiled spans (:mod:`train_ato.loop.span`), with
equal numbers; ``studies_done/tick_parts.py`` has the parts of a span. One of them has a law in Python,
``examples/my_law.py``; its goal is 1500 times real time. The exit status is 1 if it is missed widely (see figures.py).
The messages of a tick are dataclasses without the run-time check of frozen fields
(:func:`plant_sim.states.frozen_message`); the last line compares one of them with the frozen form.
"""

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import fields, make_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from figures import Figure, judge, publish

from plant_sim import kernel
from plant_sim.states import Measurement
from train_ato.loop.engine import TickLoop, run_engine
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare

SCENARIOS = ("daqin_heavy_haul", "daqin_heavy_haul:twin", "xuzhou_metro", "crh380a_funnel:short", "crh380a_gpc:short")
SIMULATED_S = 60
IN_PYTHON = "law=my_law:MyLaw"
MIN_IN_PYTHON = 1500.0
"""Least times of real time with a law in Python, unrecorded."""
COMPILED = (
    ("daqin_heavy_haul", ()),
    ("daqin_heavy_haul:twin", ()),
    ("daqin_heavy_haul", (IN_PYTHON,)),
    ("xuzhou_metro", ("law=pid", "duration=200")),
    ("crh380a_funnel:short", ("supervision.enabled=false", "law=funnel", "compensation=none")),
)
"""Runs in compiled spans: scenario and assignments."""
PARTS = (
    ("plant", "observe"), ("supervisor", "step"), ("profile", "on_measurement"), ("observer", "on_measurement"),
    ("controller", "receive"), ("controller", "command"), ("plant", "act"), ("recording", "extend"),
)  # fmt: skip
"""Attributes of the loop and their methods, in the order of a tick."""
FrozenMeasurement = make_dataclass(
    "FrozenMeasurement", [entry.name for entry in fields(Measurement)], frozen=True, slots=True
)
"""Copy of :class:`plant_sim.states.Measurement` with the run-time check."""


def timed(method: Callable[..., Any], times: list[int]) -> Callable[..., Any]:
    """Return a method that adds its wall time [ns] to the last entry of a list."""

    def call(*arguments: Any, **more: Any) -> Any:
        begin = time.perf_counter_ns()
        result = method(*arguments, **more)
        times[-1] += time.perf_counter_ns() - begin
        return result

    return call


def stage_times(name: str) -> dict[str, float]:
    """Return the median time of every part of a tick [us]; the kernel is a part of ``plant.act``."""
    setup = prepare(*load_scenario(name, (f"duration={SIMULATED_S}",)))
    loop = TickLoop(setup, None)
    loop.start()
    loop.tick()
    times: dict[str, list[int]] = {"tick": []}
    for stage, method in PARTS:
        owner = getattr(loop, stage)
        if owner is not None:
            times[f"{stage}.{method}"] = []
            setattr(owner, method, timed(getattr(owner, method), times[f"{stage}.{method}"]))
    advance, times["kernel"] = kernel.advance, []
    kernel.advance = timed(advance, times["kernel"])
    try:
        while not loop.plant.finished:
            for entries in times.values():
                entries.append(0)
            timed(loop.tick, times["tick"])()
    finally:
        kernel.advance = advance
    return {part: statistics.median(entries) / 1e3 for part, entries in times.items()}


def run_times(name: str, assignments: tuple[str, ...]) -> tuple[float, float, float]:
    """Return CPU time per tick in Python and in compiled spans [us], and the latter as times of real time."""
    setup = prepare(*load_scenario(name, assignments))
    found = []
    for compiled in (True, False, True):  # the first one loads the compiled code
        begin = time.process_time()
        run_engine(setup, compiled=compiled)
        found.append((time.process_time() - begin) / setup.ticks)
    return found[1] * 1e6, found[2] * 1e6, setup.tick / found[2]


def construction_us(message: type[Any]) -> float:
    """Return the time of a constructor with seven fields [us], the best of several rounds."""
    make, count = partial(message, 0, *[np.zeros(1)] * 6), 20_000
    best = float("inf")
    for _ in range(7):
        begin = time.perf_counter_ns()
        for _ in range(count):
            make()
        best = min(best, (time.perf_counter_ns() - begin) / count / 1e3)
    return best


def main() -> int:
    """Print the table; return the exit status."""
    for name in sys.argv[1:] or SCENARIOS:
        times = stage_times(name)
        publish(Figure(f"tick, {name}", times["tick"], "us", "its kernel", times["kernel"]))
        publish(*(Figure(f"tick, {name}, {part}", value, "us") for part, value in times.items() if "." in part))
    goals: list[Figure] = []
    sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
    for name, assignments in () if sys.argv[1:] else COMPILED:
        python, compiled, factor = run_times(name, assignments)
        whole = ", ".join((name, *assignments)) if IN_PYTHON in assignments else name
        publish(Figure(f"compiled tick, {whole}", compiled, "us", "the same in Python", python))
        bound = MIN_IN_PYTHON if IN_PYTHON in assignments else None
        goals.append(Figure(f"times real time, {whole}", factor, bound=bound, at_least=True))
    frozen, plain = construction_us(FrozenMeasurement), construction_us(Measurement)
    publish(Figure("construction of a measurement", plain, "us", "frozen", frozen))
    return judge(goals)


if __name__ == "__main__":
    raise SystemExit(main())
