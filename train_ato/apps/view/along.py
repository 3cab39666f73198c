"""Figures of the coupler and brake-shoe forces along the train."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import BasicTicker, BasicTickFormatter, ColumnDataSource, LinearColorMapper, Range1d
from bokeh.plotting import figure

from train_ato.apps.view.facts import Facts
from train_ato.apps.view.feed import LEAST_REACH, LEAST_SHOE
from train_ato.apps.view.hover import add_hover
from train_ato.apps.view.style import BUFF, DRAFT, SHOE, SOFT


class Along:
    """Coupler and shoe forces of every vehicle.

    Attributes
    ----------
    source
        One row for each vehicle: ``vehicle``, ``coupler`` (kN, of the coupler behind it) and ``shoe`` (kN).
    figures
        Coupler force and, with an air brake, shoe force; the front of the train is on the right.
    reach, shoe_reach : Range1d
        Ranges of the force axes; the page widens them for larger forces.
    """

    def __init__(self, facts: Facts, tools: dict[str, Any]) -> None:
        n = facts.layout.n_vehicles
        zeros = np.zeros(n, dtype=np.float32)
        self.source = ColumnDataSource({"vehicle": np.arange(n), "coupler": zeros, "shoe": zeros})
        self._count = n
        span = Range1d(n - 0.4, -0.6)
        self.reach = Range1d(-LEAST_REACH, LEAST_REACH)
        self.shoe_reach = Range1d(0.0, LEAST_SHOE)
        coupler = figure(x_range=span, y_range=self.reach, y_axis_label="coupler kN", name="along", **tools)
        sign = LinearColorMapper(palette=[BUFF, DRAFT], low=-1e-6, high=1e-6)
        bars = coupler.vbar(
            x="vehicle", top="coupler", width=0.86, source=self.source, line_color=None,
            fill_color={"field": "coupler", "transform": sign},
        )  # fmt: skip
        add_hover(coupler, bars, [("vehicle", "@vehicle"), ("coupler behind it", "@coupler{+0} kN")])
        coupler.hspan(y=0, line_color=SOFT, line_width=1)
        coupler.yaxis.formatter = BasicTickFormatter(use_scientific=False)
        coupler.yaxis.ticker.desired_num_ticks = 5
        coupler.xgrid.visible = False
        self.figures = [coupler]
        if facts.layout.air_brake:
            coupler.xaxis.visible = False
            self.figures.append(self._shoes(span, tools))
        self.figures[-1].xaxis.ticker = BasicTicker(min_interval=1, num_minor_ticks=0)
        self.figures[-1].xaxis.axis_label = "vehicle (front of the train on the right)"

    def _shoes(self, span: Range1d, tools: dict[str, Any]) -> Any:
        plot = figure(x_range=span, y_range=self.shoe_reach, y_axis_label="shoes kN", name="shoes", **tools)
        bars = plot.vbar(x="vehicle", top="shoe", width=0.86, source=self.source, fill_color=SHOE, line_color=None)
        add_hover(plot, bars, [("vehicle", "@vehicle"), ("brake shoes", "@shoe{0} kN")])
        plot.yaxis.ticker.desired_num_ticks = 3
        plot.xgrid.visible = False
        return plot

    def show(self, along: dict[str, Any]) -> None:
        """Show the forces of a snapshot."""
        whole = slice(0, self._count)
        self.source.patch({"coupler": [(whole, along["coupler"])], "shoe": [(whole, along["shoe"])]})
