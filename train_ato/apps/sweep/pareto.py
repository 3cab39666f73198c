"""Pareto figure of a sweep: an error against the variation of the command."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from train_ato.apps.report.print_parts import add_print_legend, sheet, styled
from train_ato.apps.report.quantities import COLOURS
from train_ato.apps.sweep.groups import NotDrawable, grouped, inside, metric_words
from train_ato.messages.types import Array

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["pareto_figure", "pareto_front"]

VARIATION = "command_variation_kn_per_s"


def pareto_front(first: Array, second: Array) -> NDArray[np.intp]:
    """Return the indices of the runs that no other run beats in both values, by rising first value.

    Parameters
    ----------
    first, second : Array, shape (runs,)
        Values, the smaller the better.

    Examples
    --------
    >>> pareto_front(np.array([1.0, 2.0, 3.0, 2.0]), np.array([5.0, 3.0, 4.0, 6.0])).tolist()
    [0, 1]
    """
    order = np.lexsort((second, first))
    best = np.concatenate(([np.inf], np.minimum.accumulate(second[order])[:-1]))
    return np.asarray(order[second[order] < best], dtype=np.intp)


@styled()
def pareto_figure(table: pd.DataFrame, metric: str, name: str) -> Figure:
    """Return error over command variation of the tracked runs, with a front for every law.

    Parameters
    ----------
    table
        Table of the sweep.
    metric
        Error, a numeric column; its magnitude counts.
    name
        Name of the scenario.

    Raises
    ------
    NotDrawable
        If no run is tracked.
    ValueError
        For an unknown metric.
    """
    words = metric_words(table, metric)
    figure, (axes,) = sheet(1, [2.0])
    drawn = 0
    for index, group in enumerate(grouped(table, "law")):
        runs = group.runs[inside(group.runs)].dropna(subset=[metric, VARIATION])
        lost = len(group.runs) - int(inside(group.runs).sum())
        x, y = runs[VARIATION].to_numpy(dtype=float), np.abs(runs[metric].to_numpy(dtype=float))
        if not x.size:
            continue
        drawn += 1
        colour = COLOURS[index % len(COLOURS)]
        front = pareto_front(x, y)
        label = f"{group.label}, {front.size} of {x.size} on the front" + (f", {lost} not tracked" if lost else "")
        axes.plot(x, y, ".", ms=4, color=colour, alpha=0.35)
        axes.plot(x[front], y[front], "o-", ms=3.5, lw=1.1, color=colour, label=label, drawstyle="steps-post")
    if not drawn:
        raise NotDrawable("no run is tracked")
    for axis, values in (("x", table[VARIATION]), ("y", table[metric].abs())):
        shown = values[inside(table)].dropna()
        if shown.min() > 0.0 and shown.max() > 100.0 * shown.min():
            getattr(axes, f"set_{axis}scale")("log")
    axes.set_xlabel(metric_words(table, VARIATION))
    axes.set_ylabel(words)
    add_print_legend(axes)
    figure.suptitle(f"{name}: {words} against command variation, tracked runs", fontsize=8.5)
    return figure
