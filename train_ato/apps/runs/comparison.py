"""Result of a comparison of laws: one table, one figure and one page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.apps.runs.ranking import rank_of
from train_ato.apps.runs.summary_table import RESULTS, html_table
from train_ato.loop.metric_names import metric_heading

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from train_ato.apps.report.page_data import PageData

SHOWN = tuple(key for key in RESULTS if key not in ("real_time_factor", "step_time_us_median"))
"""Metrics of the table."""
OWN = "own"
"""Source of the gains of a law without the choice."""


@dataclass(frozen=True)
class Compared:
    """One law of a comparison.

    Attributes
    ----------
    label : str
        Name of the law in table and figures.
    metrics : dict
        Metrics of its run; empty for a refused law.
    gains : str
        Source of its parameters: ``fitted``, ``model``, ``printed``, ``given``, or ``own`` for a law without a choice.
    reason : str
        Reason of a refusal or of a failed run; otherwise empty.
    data : PageData or None
        Data of the figures.
    """

    label: str
    metrics: dict[str, Any]
    gains: str = OWN
    reason: str = ""
    data: PageData | None = None

    @property
    def status(self) -> str:
        """``done``, ``failed`` or ``refused``."""
        return str(self.metrics["status"]) if self.metrics else "refused"


class Comparison:
    """One scenario driven with several laws.

    Made by :func:`train_ato.compare`.

    Attributes
    ----------
    scenario : str
        Name of the scenario.
    laws : tuple of Compared
        The best first: by end of the run, outcome of tracking, verdict, failed criteria, rms of the speed error.
    """

    def __init__(self, scenario: str, laws: Sequence[Compared]) -> None:
        self.scenario = scenario
        self.laws = tuple(sorted(laws, key=lambda law: rank_of(law.metrics)))

    @property
    def table(self) -> pd.DataFrame:
        """One row for each law: status, gains, metrics with the unit in their name, reason of a refusal or failure."""
        import pandas as pd

        rows = [
            {
                "status": law.status,
                "gains": law.gains,
                **{key: law.metrics.get(key) for key in SHOWN},
                "reason": law.reason,
            }
            for law in self.laws
        ]
        return pd.DataFrame(rows, index=pd.Index([law.label for law in self.laws], name="law"))

    @property
    def metrics(self) -> dict[str, dict[str, Any]]:
        """Metrics of the laws with a run."""
        return {law.label: law.metrics for law in self.laws if law.metrics}

    @property
    def rows(self) -> list[dict[str, Any]]:
        """Metrics, status and gains of every law as plain data; a refused law has its reason."""
        return [
            {**law.metrics, "controller": law.label, "status": law.status, "gains": law.gains}
            | ({"reason": law.reason} if law.reason else {})
            for law in self.laws
        ]

    @property
    def _pages(self) -> list[PageData]:
        return [law.data for law in self.laws if law.data is not None]

    @property
    def drawable(self) -> bool:
        """True if any law has data to draw."""
        return any(data.curves for data in self._pages)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw speed, speed error, applied force and coupler extremes of all laws in one figure.

        Parameters
        ----------
        path
            PNG or SVG file to write; default: none, a notebook shows the figure.

        Raises
        ------
        ValueError
            If no law has a complete tick.
        """
        from train_ato.apps.report.print_figures import comparison_figure
        from train_ato.apps.report.print_parts import SCREEN_DPI, save_figure
        from train_ato.apps.report.writing import comparison_title

        figure = comparison_figure(self._pages, comparison_title(self._pages)) if self._pages else None
        if figure is None:
            raise ValueError(f"{self.scenario}: no law has a complete tick to draw")
        if path is not None:
            save_figure(figure, Path(path), SCREEN_DPI)
        return figure

    def report(self, path: str | Path = "comparison.html") -> Path:
        """Write the page of linked figures of all laws and return its path.

        Raises
        ------
        ValueError
            If the file exists already or cannot be written, or no law has a complete tick.
        """
        from train_ato.apps.report.writing import write_comparison_page
        from train_ato.arguments import check_new_file

        page = Path(path)
        check_new_file(page, (".html", ".htm"), "report")
        if not self.drawable:
            raise ValueError(f"{self.scenario}: no law has a complete tick to draw")
        write_comparison_page(self._pages, page)
        return page

    def __repr__(self) -> str:
        laws = ", ".join(law.label if law.status == "done" else f"{law.label} ({law.status})" for law in self.laws)
        return f"<Comparison {self.scenario}: {laws}>"

    def _repr_html_(self) -> str:
        keys = [key for key in SHOWN if any(key in law.metrics for law in self.laws)]
        rows = [[law.label, *(law.metrics.get(key) for key in keys), law.reason or law.status] for law in self.laws]
        return html_table(self.scenario, ["law", *(metric_heading(key) for key in keys), "end"], rows)
