"""Sheets of panels for the figures of the papers."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from matplotlib.axes import Axes

from train_ato.papers.claims import FigureFile
from train_ato.papers.drawing import COLOURS, blank_figure, save

__all__ = ["COLOURS", "Sheet"]


class Sheet:
    """Figure with rows and columns of panels.

    Parameters
    ----------
    caption
        Caption on the page.
    rows, columns
        Number of panels.
    height
        Height of a row [inch].
    width
        Width of the sheet [inch].
    share
        One time axis for all panels of a column.
    """

    def __init__(
        self, caption: str, rows: int, columns: int = 1, *, height: float = 2.4, width: float = 11.0, share: bool = True
    ) -> None:
        self._figure, self.panels = blank_figure(caption, rows, columns, (width, 0.8 + height * rows), shared=share)

    def panel(self, row: int, column: int = 0) -> Axes:
        """Return one panel."""
        found: Axes = self.panels[row, column]
        return found

    def save(self, path: Path, below: str = "time in s", *, legends: Collection[int] | None = None) -> FigureFile:
        """Write the sheet with an axis label below and legends in the given rows (default: all); return it."""
        for row, panels in enumerate(self.panels):
            for panel in panels:
                panel.margins(x=0.01)
                if (legends is None or row in legends) and panel.get_legend_handles_labels()[0]:
                    panel.legend(loc="best", ncols=4 if len(panels) == 1 else 2, fontsize="small")
        for panel in self.panels[-1]:
            if not panel.get_xlabel():
                panel.set_xlabel(below)
        return save(self._figure, path)
