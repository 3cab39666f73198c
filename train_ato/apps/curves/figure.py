"""Figure of braking curves: speed over the distance before the target."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from train_ato.apps.curves.table import CurveTable

COLOURS = {
    "EBD": "#4b4b4b", "SBD": "#9a9a9a", "EBI": "#d1495b", "SBI": "#e07a2f", "SBI1": "#c98a1b", "SBI2": "#e07a2f",
    "Warning": "#c9b21b", "Permitted": "#2e8b57", "Indication": "#1b6ca8",
}  # fmt: skip
DASHED = ("EBD", "SBD")
"""Curves of the braking train; the others are limits of a train at constant speed."""
WIDE = 3.5
"""Width of the line that another one may cover [pt]."""
PANEL_HEIGHT = 4.6
"""Height of the panel of one case [in]."""


def draw_curves(tables: dict[str, CurveTable], path: Path) -> None:
    """Draw the curves of every case as PNG, PDF or SVG.

    Raises
    ------
    ValueError
        If the file cannot be written.
    """
    figure = Figure(figsize=(11, PANEL_HEIGHT * len(tables)), dpi=110, layout="constrained")
    panels = figure.subplots(len(tables), 1, squeeze=False)[:, 0]
    for panel, (name, table) in zip(panels, tables.items(), strict=True):
        _draw_table(panel, name, table)
    try:
        figure.savefig(path)
    except OSError as error:
        raise ValueError(f"{path}: cannot be written ({error.strerror}); choose another place") from None


def _draw_table(panel: Axes, name: str, table: CurveTable) -> None:
    for curve, rows in table.items():
        style = "--" if curve in DASHED else "-"
        panel.plot([row[1] for row in rows], [row[0] for row in rows], style, color=COLOURS[curve], lw=1.5, label=curve)
    panel.axvline(0.0, color=COLOURS["EBD"], lw=0.8, ls=":")
    panel.invert_xaxis()
    panel.set_xlabel("distance before the target in m")
    panel.set_ylabel("speed in km/h")
    panel.set_ylim(bottom=0)
    panel.grid(alpha=0.3)
    panel.margins(x=0.01)
    panel.set_title(name, loc="left", fontsize="medium", pad=24.0)
    panel.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=len(table), frameon=False, fontsize="small")
