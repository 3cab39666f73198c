"""Figure in the run folder: speed, error, force, couplers and air brake over time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from train_ato.apps.report.curves import curves_of
from train_ato.apps.report.events import detect_events
from train_ato.apps.report.page_data import downsampled
from train_ato.apps.report.print_parts import SCREEN_DPI, over_time, save_figure, styled
from train_ato.apps.report.words import ENDS, MODES, driven_laws, evaluation_note
from train_ato.loop.recording import Recording
from train_ato.loop.result import RunResult
from train_ato.loop.setup import RunSetup

LONG_RUN_S = 600.0
"""Minimum duration for a time axis in minutes [s]."""
PANELS = ("speed", "speed_error", "forces", "coupler_extremes", "pipe", "shoe_force")
"""Panels of the figure; panels without data are omitted."""
POINTS = 400_000
"""Numbers in one panel, with the times; a long run has more, which the figure cannot show."""
MARKED = ("law", "protection", "outside", "scored", "end")
"""Kinds of event marked in the figure."""


def write_run_figure(setup: RunSetup, result: RunResult, folder: Path) -> None:
    """Draw ``figure.png`` into a run folder, if the run has a complete tick."""
    if result.recording is not None:
        draw_run(replace(result.recording, setup=setup, summary=result.summary), folder / "figure.png")


def draw_run(recording: Recording, path: Path) -> None:
    """Write the figure of one run with setup and summary, as PNG or SVG."""
    figure = run_figure(recording)
    if figure is not None:
        save_figure(figure, path, SCREEN_DPI)


@styled()
def run_figure(recording: Recording) -> Figure | None:
    """Return the figure of one run with setup and summary; None without data."""
    recording = recording.within_span()
    curves, _ = curves_of(recording, PANELS, lambda lines: downsampled(lines, POINTS))
    events = [event for event in detect_events(recording) if event.kind in MARKED]
    note = evaluation_note(recording.setup.scenario.evaluation) if recording.setup is not None else ""
    lines = [*titles(recording.summary), *([note] if note else [])]
    return over_time(curves, PANELS, events, recording.span[1], "\n".join(lines))


def titles(summary: dict[str, Any]) -> list[str]:
    """Return the lines of the title: scenario and law; mode and early end of the run."""
    head = (
        f"{summary['scenario']}: {driven_laws(summary)}, observer {summary['observer']}, "
        f"compensation {summary['compensation']}, seed {summary['seed']}"
    )
    mode = MODES.get(str(summary.get("mode")), "")
    end = ENDS.get(str(summary.get("status")), "")
    more = ", ".join(part for part in (f"mode: {mode}" if mode else "", end.upper()) if part)
    return [head, more] if more else [head]
