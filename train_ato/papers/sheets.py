"""Sheets of panels on which the papers' figures are drawn."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes

from train_ato.reproduce.drawing import COLOURS, blank

__all__ = ["COLOURS", "Sheet"]


class Sheet:
    """A figure of panels below and beside each other.

    Parameters
    ----------
    title
        Above all panels.
    rows, columns
        Of panels.
    height
        Of one row [inch].
    width
        Of the sheet [inch].
    share
        All panels of a column have one time axis.
    """

    def __init__(
        self, title: str, rows: int, columns: int = 1, *, height: float = 2.4, width: float = 11.0, share: bool = True
    ) -> None:
        self._figure, self.panels = blank(title, rows, columns, (width, 0.8 + height * rows), shared=share)

    def panel(self, row: int, column: int = 0) -> Axes:
        """Return one panel."""
        found: Axes = self.panels[row, column]
        return found

    def save(self, path: Path, below: str = "time in s", *, legends: int | None = None) -> Path:
        """Write the sheet, its lowest panels labelled and so many rows with a legend (all), and return the file."""
        for row, panels in enumerate(self.panels):
            for panel in panels:
                panel.grid(alpha=0.3)
                panel.margins(x=0.01)
                if (legends is None or row < legends) and panel.get_legend_handles_labels()[0]:
                    panel.legend(loc="best", ncols=4 if len(panels) == 1 else 2, fontsize="small")
        for panel in self.panels[-1]:
            if not panel.get_xlabel():
                panel.set_xlabel(below)
        self._figure.savefig(path)
        return path
