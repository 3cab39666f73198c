"""Figures of runs: speed against the profile, error, force, coupler forces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from train_ato.history import History
from train_ato.metrics import limit_over_train, scored_part
from train_ato.run_setup import RunSetup

LONG_RUN_S = 600.0
"""From this length on the time axis is in minutes."""
COLOURS = ("#1b6ca8", "#d1495b", "#2e8b57", "#8f5fb8", "#c98a1b", "#4b4b4b", "#17a2a2", "#a3785a")


def _time_axis(history: History) -> tuple[Any, str]:
    if history.time[-1] > LONG_RUN_S:
        return history.time / 60.0, "time in min"
    return history.time, "time in s"


def draw_run(setup: RunSetup, history: History, summary: dict[str, Any], path: Path) -> None:
    """Draw one run as a PNG: speed, speed error, force, coupler forces over time.

    Parameters
    ----------
    setup, history, summary
        The run.
    path
        PNG to write.
    """
    figure = Figure(figsize=(11, 10), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    several = setup.shape.n_vehicles > 1
    panels = figure.subplots(4 if several else 3, 1, sharex=True)
    time, label = _time_axis(history)
    _draw_speed(panels[0], setup, history, time)
    _draw_error(panels[1], setup, history, time)
    _draw_force(panels[2], setup, history, time)
    if several:
        _draw_couplers(panels[3], history, time)
    panels[-1].set_xlabel(label)
    for panel in panels:
        panel.grid(alpha=0.3)
        panel.margins(x=0.01)
    figure.suptitle(
        f"{summary['scenario']}: {summary['controller']}, observer {summary['observer']}, "
        f"compensation {summary['compensation']}, seed {summary['seed']}"
    )
    figure.savefig(path)


def _draw_speed(panel: Axes, setup: RunSetup, history: History, time: Any) -> None:
    panel.plot(time, 3.6 * history.reference_velocity, color=COLOURS[5], lw=2.2, alpha=0.5, label="profile")
    panel.plot(time, 3.6 * history.front_velocity, color=COLOURS[0], lw=1.0, label="train")
    if setup.line.speed_limits:
        front = history.front_position + setup.consist.vehicles[0].length / 2
        limit = 3.6 * limit_over_train(setup.line, front, setup.consist.length)
        panel.plot(time, limit, color=COLOURS[1], lw=1.0, ls="--", label="limit (whole train)")
    panel.set_ylabel("speed in km/h")
    panel.legend(loc="lower right", ncols=3, fontsize="small")


def _draw_error(panel: Axes, setup: RunSetup, history: History, time: Any) -> None:
    error = 3.6 * (history.velocity - history.reference_velocity[:, None])
    for unit in range(error.shape[1]):
        label = "speed error" if error.shape[1] == 1 else f"unit {unit}"
        panel.plot(time, error[:, unit], color=COLOURS[unit % len(COLOURS)], lw=0.9, label=label)
    part = scored_part(setup, history)
    if part.stop < time.size:
        panel.axvline(time[part.stop], color=COLOURS[5], ls=":", lw=1.2, label="end of the scored part")
    panel.set_ylabel("speed error in km/h")
    panel.legend(loc="upper right", ncols=4, fontsize="small")


def _draw_force(panel: Axes, setup: RunSetup, history: History, time: Any) -> None:
    low, high = _limits(setup, history)
    panel.fill_between(time, low / 1e3, high / 1e3, color=COLOURS[5], alpha=0.10, lw=0, label="envelope (nominal)")
    panel.plot(time, history.command.sum(axis=1) / 1e3, color=COLOURS[4], lw=0.8, label="demand")
    panel.plot(time, history.applied.sum(axis=1) / 1e3, color=COLOURS[0], lw=0.9, label="applied")
    panel.set_ylabel("force of all units in kN")
    panel.legend(loc="upper right", ncols=3, fontsize="small")


def _limits(setup: RunSetup, history: History) -> tuple[Any, Any]:
    """Return the envelope of all units together at every tick [N]."""
    grid = np.linspace(0.0, max(1.0, float(np.abs(history.velocity).max())), 400)
    pairs = [setup.model.force_limits(np.full(setup.shape.n_units, speed)) for speed in grid]
    low = np.interp(np.abs(history.front_velocity), grid, [pair[0].sum() for pair in pairs])
    high = np.interp(np.abs(history.front_velocity), grid, [pair[1].sum() for pair in pairs])
    return low, high


def _draw_couplers(panel: Axes, history: History, time: Any) -> None:
    panel.fill_between(
        time,
        history.coupler_low / 1e3,
        history.coupler_high / 1e3,
        color=COLOURS[2],
        alpha=0.2,
        lw=0,
        label="all couplers",
    )
    for column, name in enumerate(("first", "middle", "last")):
        panel.plot(time, history.coupler_some[:, column] / 1e3, color=COLOURS[column], lw=0.8, label=name)
    panel.set_ylabel("coupler force in kN\n(draft > 0)")
    panel.legend(loc="upper right", ncols=4, fontsize="small")


def draw_comparison(setup: RunSetup, runs: dict[str, History], path: Path) -> None:
    """Draw several runs of one scenario over each other: speed error and force over time."""
    figure = Figure(figsize=(11, 7), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    speed, error, force = figure.subplots(3, 1, sharex=True)
    label = ""
    for index, (name, history) in enumerate(runs.items()):
        time, label = _time_axis(history)
        colour = COLOURS[index % len(COLOURS)]
        if index == 0:
            speed.plot(time, 3.6 * history.reference_velocity, color=COLOURS[5], lw=2.2, alpha=0.5, label="profile")
        speed.plot(time, 3.6 * history.front_velocity, color=colour, lw=0.9, label=name)
        error.plot(time, 3.6 * (history.front_velocity - history.reference_velocity), color=colour, lw=0.9, label=name)
        force.plot(time, history.applied.sum(axis=1) / 1e3, color=colour, lw=0.8, label=name)
    for panel, text in ((speed, "speed in km/h"), (error, "speed error in km/h"), (force, "applied force in kN")):
        panel.set_ylabel(text)
        panel.grid(alpha=0.3)
        panel.margins(x=0.01)
    speed.legend(loc="lower right", ncols=5, fontsize="small")
    force.set_xlabel(label)
    figure.suptitle(f"{setup.scenario.name}: laws on the same train")
    figure.savefig(path)
