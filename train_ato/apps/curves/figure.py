"""Figure of braking curves: speed over the distance before the target."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from train_ato.apps.curves.table import CurveTable
from train_ato.apps.report.print_figures import SHEET_SIZE, styled, write_figure
from train_ato.apps.report.quantities import BLACK, BLUE, BROWN, GREEN, GREY, ORANGE, PURPLE, VERMILION

CURVE_COLOURS = {
    "EBD": BLACK, "SBD": GREY, "EBI": VERMILION, "SBI": PURPLE, "SBI1": BROWN, "SBI2": PURPLE,
    "Warning": ORANGE, "Permitted": GREEN, "Indication": BLUE,
}  # fmt: skip
DASHED = ("EBD", "SBD")
"""Curves of the braking train; the others are limits of a train at constant speed."""
WIDE = 3.5
"""Width of the line that another one may cover [pt]."""
PANEL_HEIGHT = 4.6
"""Height of the panel of one case [in]."""


@styled(SHEET_SIZE)
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
    write_figure(figure, path)


def _draw_table(panel: Axes, name: str, table: CurveTable) -> None:
    for curve, rows in table.items():
        style = "--" if curve in DASHED else "-"
        panel.plot(
            [row[1] for row in rows], [row[0] for row in rows], style, color=CURVE_COLOURS[curve], lw=1.5, label=curve
        )
    panel.axvline(0.0, color=CURVE_COLOURS["EBD"], lw=0.8, ls=":")
    panel.invert_xaxis()
    panel.set_xlabel("distance before the target in m")
    panel.set_ylabel("speed in km/h")
    panel.set_ylim(bottom=0)
    panel.margins(x=0.01)
    panel.set_title(name, loc="left", fontsize="medium", pad=24.0)
    panel.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=len(table), frameon=False, fontsize="small")
