"""Words, units and colours of what is drawn: the same in every figure, on every page.

The colours are those of Okabe and Ito, told apart by readers with any colour vision; draft is red and buff is blue on
a scale that is white at zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BLUE, ORANGE, GREEN, VERMILLION = "#0072b2", "#e69f00", "#009e73", "#d55e00"
PURPLE, SKY, GREY, BLACK = "#cc79a7", "#56b4e9", "#7f8790", "#222222"
BROWN = "#8c510a"
RUN_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, VERMILLION, SKY, BLACK, BROWN)
"""Colours of several runs, or of several units of one run."""
INK, FAINT, PAPER = "#1f2933", "#d9dee3", "#ffffff"
"""Text and axes, grid lines, ground."""
FONT = "Arial, Helvetica, 'Liberation Sans', 'DejaVu Sans', sans-serif"

_BUFF_TO_DRAFT = (
    "#053061", "#2166ac", "#4393c3", "#92c5de", "#d1e5f0", "#f7f7f7",
    "#fddbc7", "#f4a582", "#d6604d", "#b2182b", "#67001f",
)  # fmt: skip
_NONE_TO_FULL = ("#ffffff", "#fff7bc", "#fee391", "#fec44f", "#fe9929", "#ec7014", "#cc4c02", "#993404", "#662506")


@dataclass(frozen=True)
class Quantity:
    """What a line shows.

    Attributes
    ----------
    words
        As the legend says it.
    unit
        As the axis and the hover say it.
    colour
        Of the line.
    dash
        ``solid``, ``dashed`` or ``dotted``.
    width
        Of the line, in pixels or points.
    digits
        Behind the decimal point, in the hover.
    """

    words: str
    unit: str
    colour: str
    dash: str = "solid"
    width: float = 1.4
    digits: int = 1


OF_ONE = " on that vehicle"
"""Left out of the words where several units are told by their number."""
QUANTITIES: dict[str, Quantity] = {
    "profile": Quantity("profile", "km/h", GREY, width=3.2, digits=2),
    "speed": Quantity("train", "km/h", BLUE, digits=2),
    "measured_speed": Quantity("train (measured)", "km/h", BLUE, digits=2),
    "limit": Quantity("speed limit, whole train", "km/h", VERMILLION, "dashed"),
    "line_limit": Quantity("speed limit of the line", "km/h", VERMILLION, "dashed"),
    "replanned": Quantity("profile planned anew", "km/h", GREEN, "dashed", 2.0, 2),
    "speed_error": Quantity("speed error", "km/h", BLUE, digits=3),
    "position_error": Quantity("position error", "m", BLUE, digits=2),
    "demand": Quantity("demand", "kN", ORANGE),
    "applied": Quantity("applied", "kN", BLUE),
    "envelope_high": Quantity("most traction", "kN", GREY, "dotted", 1.0, 0),
    "envelope_low": Quantity("most electric brake", "kN", GREY, "dotted", 1.0, 0),
    "draft": Quantity("largest draft along the train", "kN", "#b2182b"),
    "buff": Quantity("largest buff along the train", "kN", "#2166ac"),
    "first_coupler": Quantity("first coupler", "kN", BLACK, width=1.0),
    "middle_coupler": Quantity("middle coupler", "kN", GREEN, width=1.0),
    "last_coupler": Quantity("last coupler", "kN", ORANGE, width=1.0),
    "estimate": Quantity("estimate", "kN", GREEN, width=1.0),
    "whole_truth": Quantity("truth on the whole train", "kN", GREY, width=1.0),
    "truth": Quantity(f"truth{OF_ONE}", "kN", PURPLE, width=1.6),
    "delay_set": Quantity("set in the scenario: delay and lag", "s", ORANGE, width=2.2, digits=2),
    "delay": Quantity("found in the log", "s", BLUE, digits=2),
    "delay_believed": Quantity("believed by the law", "s", GREEN, "dashed", digits=2),
    "pipe_demand": Quantity("brake pipe, demand", "kPa", ORANGE),
    "pipe": Quantity("brake pipe at the head", "kPa", BLUE),
    "shoe_force": Quantity("shoe force, whole train", "kN", BROWN, digits=0),
    "traction": Quantity("traction", "kWh", VERMILLION),
    "regenerated": Quantity("electric brake, regenerated", "kWh", GREEN),
    "running": Quantity("running resistance", "kWh", GREY),
    "curve": Quantity("curves", "kWh", PURPLE),
    "grade": Quantity("grades", "kWh", BLACK),
    "air_brake": Quantity("air brake", "kWh", BROWN),
    "couplers": Quantity("draft gears", "kWh", SKY),
    "outside": Quantity("disturbances", "kWh", SKY, "dotted"),
    "kinetic": Quantity("kinetic energy", "kWh", BLUE, "dashed"),
    "height": Quantity("height over the begin", "m", GREEN, digits=1),
}
"""Every line that is drawn."""

AXES: dict[str, str] = {
    "speed": "speed in km/h",
    "speed_error": "speed error in km/h",
    "position_error": "position error in m",
    "force": "force of all units in kN",
    "coupler": "coupler force in kN (draft > 0)",
    "disturbance": "disturbance in kN (forward > 0)",
    "delay": "delay in s",
    "pressure": "pressure in kPa",
    "shoe_force": "shoe force in kN",
    "energy": "energy in kWh",
    "grade": "grade in ‰ (uphill > 0)",
    "distance": "position of vehicle 0 in km",
}
"""Titles of the axes."""
FROM_ZERO = ("delay",)
"""Axes that begin at zero, so that what hardly changes looks like it."""


def blend(stops: tuple[str, ...], count: int) -> list[str]:
    """Return so many colours evenly along the stops, as ``#rrggbb``."""
    table = np.array([[int(stop[i : i + 2], 16) for i in (1, 3, 5)] for stop in stops], dtype=np.float64)
    places = np.linspace(0.0, len(stops) - 1.0, count)
    mixed = [np.interp(places, np.arange(len(stops)), table[:, channel]) for channel in range(3)]
    return [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in zip(*(np.rint(part).astype(int) for part in mixed), strict=True)]


def buff_to_draft(count: int = 255) -> list[str]:
    """Return the colours of coupler forces: blue for buff, white for none, red for draft."""
    return blend(_BUFF_TO_DRAFT, count)


def none_to_full(count: int = 255) -> list[str]:
    """Return the colours of a quantity that starts at none, such as shoe force."""
    return blend(_NONE_TO_FULL, count)
