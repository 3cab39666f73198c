"""Result of a sweep: table, figures, counts of the ends of its runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.apps.sweep.groups import ERROR_METRIC, NotDrawable
from train_ato.apps.sweep.spec import SweepSpec

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["SweepResult"]


class SweepResult:
    """Finished runs of a sweep.

    Made by :func:`train_ato.sweep`.

    Attributes
    ----------
    spec : SweepSpec
        Specification.
    table : pandas.DataFrame
        One row for each finished run; see ``msgs_docs/sweeps.md`` for the columns.
    path : Path or None
        Folder of the sweep, None for one in memory.
    """

    def __init__(self, spec: SweepSpec, table: pd.DataFrame, path: Path | None = None) -> None:
        self.spec = spec
        self.table = table
        self.path = path

    @property
    def counts(self) -> dict[str, int]:
        """Number of runs by status."""
        return {str(status): int(count) for status, count in self.table["status"].value_counts().items()}

    def plot_box(self, metric: str = ERROR_METRIC, path: str | Path | None = None) -> Figure:
        """Draw a box plot of a metric for every value of the first list, for example of every law.

        Parameters
        ----------
        metric
            Numeric column of the table.
        path
            PNG or SVG file to write; default: none, a notebook shows the figure.

        Raises
        ------
        ValueError
            If the table has no such metric, or the design no list.
        """
        from train_ato.apps.sweep.box_plot import box_plot

        return self._saved(box_plot(self.spec, self.table, metric), path)

    def plot_map(
        self, metric: str = ERROR_METRIC, border: str = "tracking", path: str | Path | None = None
    ) -> Figure:  # fmt: skip
        """Draw a metric over the first two ranges, with the border of stability.

        Parameters
        ----------
        metric, path
            As for :meth:`plot_box`.
        border
            ``tracking``: runs with the outcome ``tracked`` are inside of the border; ``verdict``: those that pass the
            criteria of the scenario.

        Raises
        ------
        ValueError
            If the table has no such metric, or the design not two ranges.
        """
        from train_ato.apps.sweep.robustness_map import robustness_map

        return self._saved(robustness_map(self.spec, self.table, metric, border), path)

    def plot_pareto(self, metric: str = ERROR_METRIC, path: str | Path | None = None) -> Figure:
        """Draw a metric against the variation of the command, with the Pareto front of every law.

        Parameters
        ----------
        metric, path
            As for :meth:`plot_box`.

        Raises
        ------
        ValueError
            If the table has no such metric, or no run ended.
        """
        from train_ato.apps.sweep.pareto import pareto_figure

        return self._saved(pareto_figure(self.table, metric, self.spec.title), path)

    def figures(self, folder: str | Path, metric: str = ERROR_METRIC, border: str = "tracking") -> dict[str, Path]:
        """Write the figures that the design permits into a folder, and return their files by name."""
        plots: dict[str, Any] = {
            "box": lambda path: self.plot_box(metric, path),
            "map": lambda path: self.plot_map(metric, border, path),
            "pareto": lambda path: self.plot_pareto(metric, path),
        }
        written = {}
        for name, plot in plots.items():
            file = Path(folder) / f"{name}.png"
            try:
                plot(file)
            except NotDrawable:
                file.unlink(missing_ok=True)
            else:
                written[name] = file
        return written

    def _saved(self, figure: Figure, path: str | Path | None) -> Figure:
        if path is not None:
            from train_ato.apps.report.print_parts import SCREEN_DPI, save_figure

            save_figure(figure, Path(path), SCREEN_DPI)
        return figure

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {status}" for status, count in self.counts.items())
        return f"<SweepResult {self.spec.title}, {self.spec.design}: {counts}>"

    def _repr_html_(self) -> str:
        return str(self.table.drop(columns=["point", "sha256"]).to_html(max_rows=20))
