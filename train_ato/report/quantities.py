"""Labels, units and colours of quantities and events, common to all figures and pages.

The colours are those of Okabe and Ito, distinguishable with any colour vision.  On the scale of coupler forces draft is
red, zero white and buff blue.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.library import read_yaml
from train_ato.messages.types import Array
from train_ato.program.display_units import display_unit

BLUE, ORANGE, GREEN, VERMILION = "#0072b2", "#e69f00", "#009e73", "#d55e00"
PURPLE, SKY, GREY, BLACK = "#cc79a7", "#56b4e9", "#7f8790", "#222222"
BROWN = "#8c510a"
WINE, INDIGO, OLIVE = "#882255", "#332288", "#999933"
"""Colours of the colour-blind safe palette of Tol, for events of the supervision."""
RUN_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, VERMILION, SKY, BLACK, BROWN)
"""Colours of runs, or of the power units of one run."""
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, GREY, SKY, BROWN)
"""Colours of laws, settings and differences in figures with a title of their own; the sixth is that of a reference."""
INK, FAINT, PAPER, NOTHING = "#1f2933", "#d9dee3", "#ffffff", "#b9c0c7"
"""Colours of text and axes, of grid lines, of the background, of times without messages in a map."""
FONT = "Arial, Helvetica, 'Liberation Sans', 'DejaVu Sans', sans-serif"

_BUFF_TO_DRAFT = (
    "#053061", "#2166ac", "#4393c3", "#92c5de", "#d1e5f0", "#f7f7f7",
    "#fddbc7", "#f4a582", "#d6604d", "#b2182b", "#67001f",
)  # fmt: skip
_NONE_TO_FULL = ("#ffffff", "#fff7bc", "#fee391", "#fec44f", "#fe9929", "#ec7014", "#cc4c02", "#993404", "#662506")

TABLES: dict[str, Any] = read_yaml(Path(__file__).with_name("page.yaml"))
"""Tables of the figures by name, for page and print."""
_NAMED = {
    "blue": BLUE, "orange": ORANGE, "green": GREEN, "vermilion": VERMILION, "purple": PURPLE, "sky": SKY, "grey": GREY,
    "black": BLACK, "brown": BROWN, "wine": WINE, "indigo": INDIGO, "olive": OLIVE,
}  # fmt: skip


def _coloured(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row with the value of its colour."""
    return {**row, "colour": _NAMED.get(row["colour"], row["colour"])}


@dataclass(frozen=True)
class CurveStyle:
    """Appearance of a line.

    Attributes
    ----------
    words
        Label in the legend.
    unit
        Unit in the tooltip.
    colour
        Colour of the line.
    dash
        ``solid``, ``dashed`` or ``dotted``.
    width
        Width of the line [pixels or points].
    digits
        Decimals in the tooltip.
    """

    words: str
    unit: str
    colour: str
    dash: str = "solid"
    width: float = 1.4
    digits: int = 1


OF_ONE = " on the power unit's vehicle"
"""Part of a label replaced by the number of the power unit if there are several."""
QUANTITIES = {name: CurveStyle(**_coloured(row)) for name, row in TABLES["curves"].items()}
"""Appearance of every quantity."""


def style_of(name: str) -> CurveStyle:
    """Return the appearance of a quantity with its unit of display."""
    return replace(QUANTITIES[name], unit=display_unit(QUANTITIES[name].unit)[0])


def unit_in_figures(column: str) -> str:
    """Return the unit of a column before that of display, "" for an own signal."""
    name = column.partition(":")[0]
    return QUANTITIES[name].unit if name in QUANTITIES else ""


AXES: dict[str, str] = TABLES["axes"]
"""Titles of the axes."""


def axis_title(axis: str) -> str:
    """Return the title of an axis, or the title itself, in the units of display."""
    return re.sub(r"(?<= in )[^ ,:]+", lambda unit: display_unit(unit[0])[0], AXES.get(axis, axis))


@dataclass(frozen=True)
class Kind:
    """Kind of event: label in a legend, and colour."""

    words: str
    colour: str


KINDS = {name: Kind(**_coloured(row)) for name, row in TABLES["kinds"].items()}
"""Kinds of event."""

PANELS: dict[str, tuple[str, str]] = {name: tuple(row) for name, row in TABLES["panels"].items()}
"""Panels over time: key or title of the y axis, and name where the panel is missing; heat maps have no axis."""


@dataclass(frozen=True)
class Heat:
    """A heat map: quantity [kN], title of its rows; ``signed``: draft is red and buff blue about white."""

    words: str
    rows: str
    signed: bool


HEAT = {
    "couplers": Heat("coupler force", "coupler behind vehicle", True),
    "shoes": Heat("shoe force", "vehicle", False),
}
"""Heat maps by the name of their panel."""
FILLED = ("draft", "buff")
"""Lines with a tinted area down to zero."""
NO_LINES = ("position_km", "envelope_high", "envelope_low")
"""Columns not drawn as lines."""
FROM_ZERO = ("delay", "speed", "shoe_force")
"""Axes that begin at zero, so that small changes look small; not for a train that runs backwards."""
BOUNDS = (
    "limit", "line_limit", "emergency_brake_speed", "service_brake_speed", "warning_speed", "permitted_speed",
    "envelope_low", "envelope_high",
)  # fmt: skip
"""Limits: they do not set the range of an axis if that would squash the other lines."""
SQUASH = 1.6
"""Largest bound over the largest other value of an axis with a range for both."""


@dataclass(frozen=True)
class Trace:
    """One line of a figure: column and appearance."""

    column: str
    look: CurveStyle


def traces_of(columns: Iterable[str]) -> list[Trace]:
    """Return the lines of columns in drawing order; ``quantity:3`` is that of unit 3, ``signal:x`` the own signal x."""
    order = {name: place for place, name in enumerate(QUANTITIES)}
    lines = [column for column in columns if column.partition(":")[0] in order and column not in NO_LINES]
    traces: list[Trace] = []
    for column in sorted(lines, key=lambda column: order[column.partition(":")[0]]):
        name, _, unit = column.partition(":")
        look = style_of(name)
        if name == "signal":
            look = replace(look, words=unit, colour=RUN_COLOURS[len(traces) % len(RUN_COLOURS)])
        elif unit:
            colour = RUN_COLOURS[int(unit) % len(RUN_COLOURS)]
            dash = "dashed" if name == "truth" else look.dash
            look = replace(look, words=f"{look.words.removesuffix(OF_ONE)}, unit {unit}", colour=colour, dash=dash)
        traces.append(Trace(column, look))
    return traces


def blend(stops: tuple[str, ...], count: int) -> list[str]:
    """Return ``count`` colours at equal distances along the stops, as ``#rrggbb``."""
    table = np.array([[int(stop[i : i + 2], 16) for i in (1, 3, 5)] for stop in stops], dtype=np.float64)
    places = np.linspace(0.0, len(stops) - 1.0, count)
    mixed = [np.interp(places, np.arange(len(stops)), table[:, channel]) for channel in range(3)]
    return [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in zip(*(np.rint(part).astype(int) for part in mixed), strict=True)]


def buff_to_draft(count: int = 255) -> list[str]:
    """Return the colours of coupler forces: blue for buff, white for zero, red for draft."""
    return blend(_BUFF_TO_DRAFT, count)


def none_to_full(count: int = 255) -> list[str]:
    """Return the colours of a quantity >= 0, such as shoe force."""
    return blend(_NONE_TO_FULL, count)


@dataclass(frozen=True)
class AxisRange:
    """Range of an axis.

    Attributes
    ----------
    low, high : float
        Extremes of the lines that set the range.
    from_zero : bool
        True if the axis begins at zero.
    far : dict of float
        Least magnitude of every bound that does not set the range, by column.
    """

    low: float
    high: float
    from_zero: bool
    far: dict[str, float]

    def remark(self, column: str) -> str:
        """Return the value of a bound that is outside of the frame as text, "" for other lines."""
        least = self.far.get(column, 0.0)
        return f" (outside: {least:.0f} or more)" if least > max(abs(self.low), abs(self.high)) else ""


def axis_range(axis: str, lines: Sequence[tuple[str, Array]]) -> AxisRange:
    """Return the range of an axis.

    Parameters
    ----------
    axis
        Key of the title of the axis.
    lines
        Column and values of every line; NaN: no value.
    """
    finite = [(column, values) for column, values in lines if np.isfinite(values).any()]
    main = [values for column, values in finite if column.partition(":")[0] not in BOUNDS]
    low = min((float(np.nanmin(values)) for values in main), default=0.0)
    high = max((float(np.nanmax(values)) for values in main), default=0.0)
    reach = max(abs(low), abs(high))
    far = {
        column: float(np.nanmin(np.abs(values)))
        for column, values in finite
        if column in BOUNDS and main and reach > 0.0 and float(np.nanmax(np.abs(values))) > SQUASH * reach
    }
    near = [values for column, values in finite if column in BOUNDS and column not in far]
    return AxisRange(
        min([low, *(float(np.nanmin(values)) for values in near)]),
        max([high, *(float(np.nanmax(values)) for values in near)]),
        axis in FROM_ZERO and low >= -0.02 * reach,
        far,
    )
