"""Figure of the commands of a law on recorded inputs, the recorded commands and their difference."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from train_ato.apps.replay.open_loop import OpenLoop
from train_ato.apps.report.print_parts import SHEET_SIZE, styled, write_figure
from train_ato.apps.report.quantities import COLOURS, QUANTITIES
from train_ato.apps.report.run_figure import LONG_RUN_S
from train_ato.messages.types import Array

_FEW = 4
"""Largest number of power units with a curve each."""


@styled(SHEET_SIZE)
def draw_open_loop(result: OpenLoop, title: str, recorded: str, replayed: str, path: Path) -> None:
    """Draw speed, both force demands, their difference and, with an air brake in use, both brake-pipe demands.

    Parameters
    ----------
    result
        Outputs to draw.
    title
        Title of the figure.
    recorded, replayed
        Names of the two outputs.
    path
        File of the figure; its suffix selects the format.

    Raises
    ------
    ValueError
        If the file cannot be written.
    """
    pipe = any(demand.size > 0 and np.ptp(demand) > 0 for demand in (result.recorded_pipe, result.replayed_pipe))
    panels = 4 if pipe else 3
    figure = Figure(figsize=(11, 2.6 * panels), dpi=110, layout="constrained")
    axes = figure.subplots(panels, 1, sharex=True)
    long = bool(result.stamp[-1] * 1e-9 > LONG_RUN_S)
    time: Array = result.stamp.astype(np.float64) * (1e-9 / 60 if long else 1e-9)
    _draw_speed(axes[0], result, time)
    _draw_pair(
        axes[1], time, (result.recorded.sum(axis=1) / 1e3, recorded), (result.replayed.sum(axis=1) / 1e3, replayed)
    )
    axes[1].set_ylabel("command of all units in kN")
    _draw_difference(axes[2], result, time)
    if pipe:
        _draw_pair(axes[3], time, (result.recorded_pipe / 1e3, recorded), (result.replayed_pipe / 1e3, replayed))
        axes[3].set_ylabel("brake pipe command in kPa")
    for panel in axes:
        panel.margins(x=0.01)
    axes[-1].set_xlabel("time in min" if long else "time in s")
    figure.suptitle(title)
    write_figure(figure, path)


def _draw_speed(panel: Axes, result: OpenLoop, time: Array) -> None:
    panel.plot(time, 3.6 * result.reference, color=QUANTITIES["profile"].colour, lw=2.2, alpha=0.65, label="profile")
    panel.plot(time, 3.6 * result.velocity, color=QUANTITIES["measured_speed"].colour, lw=1.0, label="measured")
    panel.set_ylabel("speed in km/h\n(both as recorded)")
    _legend(panel, 2)


def _draw_pair(panel: Axes, time: Array, recorded: tuple[Array, str], replayed: tuple[Array, str]) -> None:
    panel.plot(time, recorded[0], color=COLOURS[5], lw=2.2, alpha=0.5, label=recorded[1])
    panel.plot(time, replayed[0], color=COLOURS[1], lw=0.8, label=replayed[1])
    _legend(panel, 2)


def _draw_difference(panel: Axes, result: OpenLoop, time: Array) -> None:
    difference = result.difference / 1e3
    units = difference.shape[1]
    if units <= _FEW:
        for unit in range(units):
            label = "replayed - recorded" if units == 1 else f"unit {unit}"
            panel.plot(time, difference[:, unit], color=COLOURS[unit], lw=0.8, label=label)
    else:
        panel.fill_between(
            time, difference.min(axis=1), difference.max(axis=1), color=COLOURS[0], alpha=0.3, lw=0, label="all units"
        )
        panel.plot(time, difference.mean(axis=1), color=COLOURS[0], lw=0.8, label="mean over units")
    if not np.any(difference):
        panel.set_ylim(-1, 1)
    panel.set_ylabel("difference in kN\nper unit")
    _legend(panel, units if units <= _FEW else 2)


def _legend(panel: Axes, columns: int) -> None:
    """Draw the legend above the panel, clear of the curves."""
    panel.legend(
        loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.1, frameon=False, ncols=columns, fontsize="small"
    )
