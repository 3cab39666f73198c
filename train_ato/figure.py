"""The figure that a run leaves in its folder: speed, error, force, couplers and air brake over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from train_ato.history import History
from train_ato.metrics import limit_over_train, scored_part
from train_ato.report.events import Event
from train_ato.report.lines import KILO, KMH, Lines, envelope
from train_ato.report.plate_parts import (
    SCREEN_DPI,
    clock_axis,
    draw_lines,
    event_legend,
    legend_above,
    save,
    sheet,
    styled,
)
from train_ato.report.words import ENDS, WAYS
from train_ato.run_setup import RunSetup
from train_ato.types import Array

LONG_RUN_S = 600.0
"""From this length on a figure of its own may have its time axis in minutes."""
COLOURS = ("#1b6ca8", "#d1495b", "#2e8b57", "#8f5fb8", "#c98a1b", "#4b4b4b", "#17a2a2", "#a3785a")
"""Colours of lines that show no quantity of the report: laws, settings, differences."""
LOW = {"pressure": 0.6, "shoe_force": 0.6}
"""Panels lower than the others."""
OUTSIDE = ("gust", "delay_jump", "emergency_brake")
"""Changes that act on the train; all others are of the law."""
APPLIED_PA = 1000.0
"""A brake pipe that never falls by this much was never used [Pa]."""


def draw_run(setup: RunSetup, history: History, summary: dict[str, Any], path: Path) -> None:
    """Draw one run over time.

    Parameters
    ----------
    setup, history, summary
        The run.
    path
        PNG or SVG to write.
    """
    panels = [
        ("speed", _speed(setup, history)),
        ("speed_error", _errors(history)),
        ("force", _forces(setup, history)),
        ("coupler", _couplers(setup, history)),
        *(_brake(history)),
    ]
    drawn = [(axis, lines) for axis, lines in panels if lines is not None]
    events = _events(setup, history, summary)
    with styled():
        figure, axes = sheet(len(drawn), [LOW.get(axis, 1.0) for axis, _ in drawn])
        for panel, (axis, lines) in zip(axes, drawn, strict=True):
            draw_lines(panel, lines, axis, events)
            legend_above(panel)
        clock_axis(axes[-1], float(history.time[-1]))
        event_legend(figure, events)
        figure.suptitle("\n".join(titles(summary)), fontsize=8.5)
        save(figure, path, SCREEN_DPI)


def titles(summary: dict[str, Any]) -> list[str]:
    """Return what stands above the figure: what was run and how, and how it ended unless it ran to its end."""
    head = (
        f"{summary['scenario']}: {summary['controller']}, observer {summary['observer']}, "
        f"compensation {summary['compensation']}, seed {summary['seed']}"
    )
    way = WAYS.get(str(summary.get("way")), "")
    end = ENDS.get(str(summary.get("status")), "")
    more = ", ".join(part for part in (f"run as {way}" if way else "", end.upper()) if part)
    return [head, more] if more else [head]


def _speed(setup: RunSetup, history: History) -> Lines:
    columns = {"profile": KMH * history.reference_velocity, "speed": KMH * history.front_velocity}
    if setup.line.speed_limits:
        front = history.front_position + setup.consist.vehicles[0].length / 2
        limit = limit_over_train(setup.line, front, setup.consist.length)
        columns["limit"] = np.where(np.isfinite(limit), KMH * limit, np.nan)
    return Lines(history.time, columns)


def _errors(history: History) -> Lines:
    error = KMH * (history.velocity - history.reference_velocity[:, None])
    several = error.shape[1] > 1
    names = [f"speed_error:{unit}" if several else "speed_error" for unit in range(error.shape[1])]
    return Lines(history.time, dict(zip(names, error.T, strict=True)))


def _forces(setup: RunSetup, history: History) -> Lines:
    columns: dict[str, Array] = {
        "demand": history.command.sum(axis=1) / KILO,
        "applied": history.applied.sum(axis=1) / KILO,
    }
    if not setup.plant.unlimited and setup.model.n_units:
        low, high = envelope(setup.model, history.front_velocity)
        columns |= {"envelope_low": low / KILO, "envelope_high": high / KILO}
    return Lines(history.time, columns)


def _couplers(setup: RunSetup, history: History) -> Lines | None:
    if setup.shape.n_vehicles < 2 or np.isnan(history.coupler_high).all():  # of a measured run nobody knows them
        return None
    columns: dict[str, Array] = {
        "draft": np.maximum(history.coupler_high, 0.0) / KILO,
        "buff": np.minimum(history.coupler_low, 0.0) / KILO,
    }
    if setup.shape.n_vehicles > 3:
        some = zip(("first_coupler", "middle_coupler", "last_coupler"), history.coupler_some.T, strict=True)
        columns |= {name: values / KILO for name, values in some}
    return Lines(history.time, columns)


def _brake(history: History) -> list[tuple[str, Lines | None]]:
    """Return brake pipe and shoe force where the air brake was used."""
    pipe, shoes = history.brake_pipe, history.shoe_force
    if pipe is None or float(np.ptp(pipe)) < APPLIED_PA:
        return []
    force = None if shoes is None else Lines(history.time, {"shoe_force": shoes / KILO})
    return [("pressure", Lines(history.time, {"pipe": pipe / KILO})), ("shoe_force", force)]


def _events(setup: RunSetup, history: History, summary: dict[str, Any]) -> list[Event]:
    """Return what was changed while the run went on, the end of the scored part and that of an unfinished run."""
    events = []
    for change in summary.get("changes", ()):
        kind = "outside" if change["name"] in OUTSIDE else "law"
        events.append(Event(kind, float(change["at_s"]), str(change["name"])))
    part = scored_part(setup, history)
    if part.stop < history.time.size:
        events.append(Event("scored", float(history.time[part.stop]), "end of the scored part"))
    if summary.get("status") in ENDS:
        events.append(Event("end", float(history.time[-1]), str(summary["status"])))
    return events
