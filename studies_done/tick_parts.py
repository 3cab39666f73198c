"""Costs of a tick by part, in Python and in compiled spans, beside the compiled kernel as the floor.

    python studies_done/tick_parts.py [--page msgs_docs/ticks.md] [SCENARIO ...]

The table has wall times per tick of a whole run in memory: of the stages in Python by their medians, of a span by sums
over the run. ``--page`` writes the table into a page, between its two marks.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Figure, publish
from tick import stage_times

from train_ato.log.run_folder import Encoder
from train_ato.log.log_writer import RunLog
from train_ato.loop.engine import TickLoop
from train_ato.scenario.setup import RunSetup, prepare
from train_ato.loop import span
from train_ato.messages.codec import Wire
from train_ato.messages.topics import topics_of
from train_ato.scenario.scenario import load_scenario

SCENARIOS = ("daqin_heavy_haul", "xuzhou_metro")
BEGIN, END = "<!-- begin of the measured table -->\n", "<!-- end of the measured table -->\n"
COMPILED_CALL = "compiled call: kernel, sensors, supervisor, law, delay line"
PARTS: tuple[tuple[Any, str, str], ...] = (
    (TickLoop, "tick", "ticks left to Python"),
    (span, "ticks_to_event", "next event"),
    (span, "is_regular", "conditions of a span"),
    (span.Span, "__init__", "forecast and arrays of a span"),
    (span.CompiledSpans, "call", COMPILED_CALL),
    (span.Span, "_store", "states after a span"),
    (span.SpanMessages, "__init__", "steps of the supervisor as messages"),
    (span.SpanMessages, "record", "recording in memory, diagnostics"),
    (span.SpanMessages, "block", "messages of the log as arrays"),
    (span.SpanMessages, "store", "receiving ends after a span"),
    (Encoder, "add_ticks", "encoding and log, with waits for the compression"),
)
"""Owner, function and text of the parts of a compiled run."""


def timed(function: Callable[..., Any], times: dict[str, float], part: str) -> Callable[..., Any]:
    """Return a function that adds its wall time [s] to a part."""

    def call(*arguments: Any, **more: Any) -> Any:
        begin = time.perf_counter()
        result = function(*arguments, **more)
        times[part] = times.get(part, 0.0) + time.perf_counter() - begin
        return result

    return call


def run_once(setup: RunSetup, sink: Any = None) -> float:
    """Run a scenario in compiled spans; return its wall time [s]."""
    begin = time.perf_counter()
    loop = TickLoop(setup, sink, compiled=True)
    loop.start()
    while not loop.plant.finished:
        loop.advance()
    loop.conclude()
    loop.recording.finish()
    return time.perf_counter() - begin


def recorded_once(setup: RunSetup) -> float:
    """Run a scenario in compiled spans with its log; return its wall time [s]."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        with RunLog(Path(folder), topics_of(setup.layout)) as log:
            run_once(setup, Encoder(log, Wire(setup.layout)))
        return time.perf_counter() - begin


def span_times(run: Callable[[RunSetup], float], setup: RunSetup) -> dict[str, float]:
    """Return the wall times of a compiled run by part [us per tick]; the rest is the loop of the engine."""
    times: dict[str, float] = {}
    kept = [(owner, name, getattr(owner, name)) for owner, name, _ in PARTS]
    for owner, name, part in PARTS:
        setattr(owner, name, timed(getattr(owner, name), times, part))
    try:
        whole = run(setup)
    finally:
        for owner, name, function in kept:
            setattr(owner, name, function)
    times["loop of the engine, start and end"] = whole - sum(times.values())
    times["whole run"] = whole
    return {part: 1e6 * value / setup.ticks for part, value in times.items()}


def table(name: str) -> list[str]:
    """Return the lines of the table of a scenario."""
    setup = prepare(*load_scenario(name, ()))
    run_once(setup)  # loads the compiled code
    lines = [f"`{name}`, tick of {setup.tick:g} s, {len(setup.consist.vehicles)} vehicle(s)", ""]
    lines += ["| part | us per tick | part of the tick |", "|---|---:|---:|"]
    stages = stage_times(name)
    for part, value in stages.items():
        shown = {"tick": "**Python, without the log**", "kernel": "of it the kernel, the floor"}.get(part, part)
        lines.append(f"| {shown} | {value:.1f} | {100 * value / stages['tick']:.0f} % |")
    runs = (("compiled spans, without the log", run_once), ("compiled spans, with the log", recorded_once))
    for title, run in runs:
        times = span_times(run, setup)
        whole = times.pop("whole run")
        publish(Figure(f"{name}, {title}", whole, "us", "its compiled call", times[COMPILED_CALL]))
        speed = setup.tick / whole * 1e6
        lines.append(f"| **{title}**: {speed:.0f} times real time | {whole:.1f} | 100 % |")
        for part, value in sorted(times.items(), key=lambda entry: -entry[1]):
            lines.append(f"| {part} | {value:.1f} | {100 * value / whole:.0f} % |")
    return [*lines, ""]


def main() -> int:
    """Print the tables, and write them into a page; return the exit status."""
    parser = argparse.ArgumentParser(description="costs of a tick by part")
    parser.add_argument("scenarios", nargs="*", default=SCENARIOS)
    parser.add_argument("--page", type=Path, help="page to write")
    options = parser.parse_args()
    text = "\n".join(line for name in options.scenarios for line in table(name))
    sys.stdout.write(text + "\n")
    if options.page is not None:
        before, _, rest = options.page.read_text().partition(BEGIN)
        options.page.write_text(before + BEGIN + "\n" + text + "\n" + END + rest.partition(END)[2])
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
