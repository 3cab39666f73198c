"""Robustness map of a sweep: a metric over two ranges, with the border of stability."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from train_ato.messages.types import Array
from train_ato.report.print_figures import LEGEND, WIDTH, NotebookFigure, add_print_legend, sheet, styled
from train_ato.report.quantities import COLOURS, FAINT, INK, VERMILION, none_to_full
from train_ato.scenario.dimensions import Dimension
from train_ato.studies.sweep.groups import NotDrawable, grouped, inside, list_key, metric_words
from train_ato.studies.sweep.spec import MISSING_SCIPY, SweepSpec

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


CELLS = 240
"""Number of cells of the picture along each axis."""
COLUMNS = 3
WORDS = {"tracking": "outcome of tracking is not “tracked”", "verdict": "verdict is not “passed”"}


@dataclass(frozen=True)
class MapCells:
    """Places of the runs and the picture between them.

    Attributes
    ----------
    first, second : Array, shape (places,)
        Coordinates of the places in the ranges, 0 to 1.
    stable : Array, shape (places,)
        1 if every run of a place is inside of the border, else 0.
    value : Array, shape (places,)
        Largest magnitude of the metric of the runs of a place.
    nearest : Array, shape (CELLS, CELLS)
        Nearest place of every cell: rows over the second, columns over the first range.
    """

    first: Array
    second: Array
    stable: Array
    value: Array
    nearest: NDArray[np.intp]


def map_cells(first: Array, second: Array, stable: Array, value: Array) -> MapCells:
    """Return the places of runs, and the nearest place of every cell of the picture.

    Parameters
    ----------
    first, second, stable, value : Array, shape (runs,)
        Coordinates 0 to 1, 1 inside of the border, metric.
    """
    try:
        from scipy.spatial import KDTree
    except ImportError:
        raise NotDrawable(MISSING_SCIPY) from None

    coordinates = np.asarray(np.round(np.column_stack((first, second)), 9), dtype=np.float64)
    places, index = np.unique(coordinates, axis=0, return_inverse=True)
    worst = np.full(len(places), -np.inf)
    np.maximum.at(worst, index.ravel(), np.nan_to_num(np.abs(value), nan=-np.inf))
    kept = np.ones(len(places))
    np.minimum.at(kept, index.ravel(), stable.astype(float))
    centres = (np.arange(CELLS) + 0.5) / CELLS
    columns, rows = np.meshgrid(centres, centres)
    nearest = KDTree(places).query(np.column_stack((columns.ravel(), rows.ravel())))[1].reshape(CELLS, CELLS)
    return MapCells(places[:, 0], places[:, 1], kept, np.where(np.isfinite(worst), worst, np.nan), nearest)


@styled()
def robustness_map(spec: SweepSpec, table: pd.DataFrame, metric: str, border: str = "tracking") -> Figure:
    """Return a metric over the first two ranges, a panel for every law or value of another list.

    A cell has the colour of the nearest run, of several runs at one place the worst; the border divides cells with
    all runs inside from the others.

    Raises
    ------
    NotDrawable
        If the design has fewer than two ranges.
    ValueError
        For an unknown metric or border.
    """
    ranges = [dimension for dimension in spec.dimensions if dimension.is_range and dimension.key != "seed"]
    if len(ranges) < 2:
        raise NotDrawable("the design has no two ranges")
    words = metric_words(table, metric)
    inside(table, border)
    groups = [(label, runs) for label, runs in grouped(table, list_key(spec)) if len(runs)]
    maps = [_cells_of(runs, ranges[0], ranges[1], metric, border) for _, runs in groups]
    columns = min(COLUMNS, len(groups))
    rows = -(-len(groups) // columns)
    figure = NotebookFigure(figsize=(WIDTH, 0.9 + rows * (3.6 if columns == 1 else 2.5)), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    top = max((float(cells.value[cells.stable > 0].max()) for cells in maps if cells.stable.any()), default=1.0)
    image: Any = None
    for panel, (label, runs), cells in zip(panels, groups, maps, strict=False):
        image = _draw(panel, cells, ranges[0], ranges[1], top)
        panel.set_title(f"{label}: {int(inside(runs, border).sum())} of {len(runs)} inside")
    for panel in panels[len(groups) :]:
        panel.set_visible(False)
    for panel in panels[max(0, len(groups) - columns) : len(groups)]:
        panel.set_xlabel(ranges[0].key)
        panel.tick_params(labelbottom=True)
    for panel in panels[::columns]:
        panel.set_ylabel(ranges[1].key)
    bar = figure.colorbar(image, ax=list(panels), pad=0.01, aspect=28)
    bar.set_label(words)
    bar.outline.set_linewidth(0.5)
    handles = [
        Line2D([], [], color=VERMILION, lw=1.6, label=f"border: {WORDS[border]}"),
        Patch(facecolor=FAINT, label="outside"),
        Line2D([], [], color=INK, marker="x", ms=3.2, mew=0.6, ls="", label="run outside"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, **LEGEND)
    figure.suptitle(f"{spec.title}: {words}, and the border of stability", fontsize=8.5)
    return figure


def _cells_of(runs: pd.DataFrame, first: Dimension, second: Dimension, metric: str, border: str) -> MapCells:
    """Return places and picture of the runs of a group."""
    shares = [np.array([dimension.share(value) for value in runs[dimension.key]]) for dimension in (first, second)]
    return map_cells(shares[0], shares[1], inside(runs, border), runs[metric].to_numpy(dtype=float))


def _draw(panel: Any, cells: MapCells, first: Dimension, second: Dimension, top: float) -> Any:
    """Draw a picture, its border and its runs; return the picture."""
    edges = np.linspace(0.0, 1.0, CELLS + 1)
    x, y = _values(first, edges), _values(second, edges)
    stable = cells.stable[cells.nearest]
    colours = ListedColormap(none_to_full(255)[20:], name="metric").with_extremes(bad=FAINT)
    picture = np.where(stable > 0, cells.value[cells.nearest], np.nan)
    image = panel.pcolormesh(x, y, picture, cmap=colours, vmin=0.0, vmax=top, rasterized=True)
    middle = (edges[1:] + edges[:-1]) / 2
    if 0.0 < stable.mean() < 1.0:
        lines = (_values(first, middle), _values(second, middle), stable)
        panel.contour(*lines, levels=[0.5], colors=[VERMILION], linewidths=1.6)
    for mark, chosen in ((".", cells.stable > 0), ("x", cells.stable == 0)):
        places = _values(first, cells.first[chosen]), _values(second, cells.second[chosen])
        panel.plot(*places, mark, color=INK, ms=2.2 if mark == "." else 3.2, mew=0.6, alpha=0.6)
    for axis, dimension in (("x", first), ("y", second)):
        if dimension.scale == "log":
            getattr(panel, f"set_{axis}scale")("log")
    panel.grid(visible=False)
    panel.set_xlim(x[0], x[-1])
    panel.set_ylim(y[0], y[-1])
    return image


def _values(dimension: Dimension, shares: Array) -> Array:
    """Return the values of a range at coordinates."""
    assert dimension.low is not None and dimension.high is not None
    if dimension.scale == "log":
        return dimension.low * (dimension.high / dimension.low) ** shares
    return dimension.low + shares * (dimension.high - dimension.low)


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
    groups = grouped(table, key)
    values = [runs[metric][inside(runs)].dropna().to_numpy(dtype=float) for _, runs in groups]
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
    labels = [f"{label}\n{int(inside(runs).sum())} of {len(runs)} tracked" for label, runs in groups]
    axes.set_xticks(places, labels)
    _use_logarithm(axes, "y", np.concatenate(values))
    axes.set_ylabel(words)
    axes.set_xlabel(key)
    figure.suptitle(f"{spec.title}: {words} of the tracked runs by {key}", fontsize=8.5)
    return figure


def _use_logarithm(axes: Any, axis: str, values: Any) -> None:
    """Use a logarithmic axis ``x`` or ``y`` for positive values over more than two decades."""
    if values.min() > 0.0 and values.max() > 100.0 * values.min():
        getattr(axes, f"set_{axis}scale")("log")


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
    for index, (law, group) in enumerate(grouped(table, "law")):
        runs = group[inside(group)].dropna(subset=[metric, VARIATION])
        lost = len(group) - int(inside(group).sum())
        x, y = runs[VARIATION].to_numpy(dtype=float), np.abs(runs[metric].to_numpy(dtype=float))
        if not x.size:
            continue
        drawn += 1
        colour = COLOURS[index % len(COLOURS)]
        front = pareto_front(x, y)
        label = f"{law}, {front.size} of {x.size} on the front" + (f", {lost} not tracked" if lost else "")
        axes.plot(x, y, ".", ms=4, color=colour, alpha=0.35)
        axes.plot(x[front], y[front], "o-", ms=3.5, lw=1.1, color=colour, label=label, drawstyle="steps-post")
    if not drawn:
        raise NotDrawable("no run is tracked")
    for axis, values in (("x", table[VARIATION]), ("y", table[metric].abs())):
        _use_logarithm(axes, axis, values[inside(table)].dropna())
    axes.set_xlabel(metric_words(table, VARIATION))
    axes.set_ylabel(words)
    add_print_legend(axes)
    figure.suptitle(f"{name}: {words} against command variation, tracked runs", fontsize=8.5)
    return figure
