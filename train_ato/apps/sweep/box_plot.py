"""Box plots of a metric of a sweep, one for each law or value of another list."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from train_ato.apps.report.print_parts import sheet, styled
from train_ato.apps.report.quantities import COLOURS, INK
from train_ato.apps.sweep.groups import NotDrawable, grouped, inside, list_key, metric_words
from train_ato.apps.sweep.spec import SweepSpec

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["box_plot"]

SPREAD = 0.16
"""Half width of the points of a box, over the distance of the boxes."""


@styled()
def box_plot(spec: SweepSpec, table: pd.DataFrame, metric: str) -> Figure:
    """Return a box with its points for every value of the list; only tracked runs count, their number is below.

    Box: median and quartiles; whiskers: the last runs within 1.5 times the distance of the quartiles.

    Raises
    ------
    NotDrawable
        If the design has no list, or no run is tracked.
    ValueError
        For an unknown metric.
    """
    key = list_key(spec)
    if key is None:
        raise NotDrawable("the design has no list of values to compare")
    words = metric_words(table, metric)
    groups = list(grouped(table, key))
    values = [group.runs[metric][inside(group.runs)].dropna().to_numpy(dtype=float) for group in groups]
    if not any(entry.size for entry in values):
        raise NotDrawable("no run is tracked")
    figure, (axes,) = sheet(1, [1.6])
    places = np.arange(len(groups))
    drawn = axes.boxplot(
        [entry if entry.size else [np.nan] for entry in values], positions=places, widths=0.5, showfliers=False,
        patch_artist=True, medianprops={"color": INK, "lw": 1.2}, boxprops={"lw": 0.7}, whiskerprops={"lw": 0.7},
        capprops={"lw": 0.7},
    )  # fmt: skip
    for index, (box, entry) in enumerate(zip(drawn["boxes"], values, strict=True)):
        colour = COLOURS[index % len(COLOURS)]
        box.set(facecolor=colour, alpha=0.3)
        share = np.linspace(-1.0, 1.0, entry.size) if entry.size > 1 else np.zeros(entry.size)
        axes.plot(index + SPREAD * share, entry, ".", ms=2.5, color=colour, alpha=0.7)
    labels = [
        f"{group.label}\n{int(inside(group.runs).sum())} of {len(group.runs)} tracked"
        for group in groups
    ]  # fmt: skip
    axes.set_xticks(places, labels)
    _use_logarithm(axes, np.concatenate(values))
    axes.set_ylabel(words)
    axes.set_xlabel(key)
    figure.suptitle(f"{spec.title}: {words} of the tracked runs by {key}", fontsize=8.5)
    return figure


def _use_logarithm(axes: object, values: np.ndarray) -> None:
    """Use a logarithmic axis for positive values over more than two decades."""
    if values.min() > 0.0 and values.max() > 100.0 * values.min():
        axes.set_yscale("log")  # type: ignore[attr-defined]
