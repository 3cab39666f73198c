"""Running-time supplements of a timetable: per cent, time per distance and time per stop, on sections of the line.

The forms are those of UIC leaflet 451-1 (per cent, minutes per 100 km) and of the margins of OSRD (``5%``,
``3min/100km``).
"""

import re
from typing import Annotated

from pydantic import model_validator

from plant_sim.chainage import parse_post
from plant_sim.input_error import build_model
from plant_sim.line import Line
from plant_sim.si_model import SiModel, option
from plant_sim.units import Place, Ratio, Time, Usual

PER_DISTANCE = 100e3
"""Distance to which ``per_100km`` refers [m]."""
MIN_DISTANCE = 1.0
"""Least distance of the end of a supplement from a stop; a nearer one is taken as the stop [m]."""


class Allowance(SiModel):
    """Supplement on the least running time, on the whole plan or between two places; several of them add up."""

    share: Annotated[Ratio | None, Usual(1e-3, 1)] = option(
        None, "part of the least running time", example=0.05, ge=0, le=10
    )
    per_100km: Annotated[Time | None, Usual(6, 7200)] = option(None, "time per 100 km", example=90.0, ge=0, le=36_000)
    per_stop: Annotated[Time | None, Usual(1, 1200)] = option(
        None, "time for every stop after the first, the last one included", example=10.0, ge=0, le=36_000
    )
    begin: Place | str | None = option(
        None, "place of the front at which it begins, or a post 12+345; default: as in the plan", example=1200.0
    )
    end: Place | str | None = option(
        None, "place of the front at which it ends, or a post 12+345; default: as in the plan", example=5400.0
    )

    @model_validator(mode="after")
    def _has_time(self) -> "Allowance":
        if self.share is None and self.per_100km is None and self.per_stop is None:
            raise ValueError("an allowance has no time; give share_percent, per_100km_min or per_stop")
        for key, place in (("begin", self.begin), ("end", self.end)):
            if isinstance(place, str) and parse_post(place) is None:
                raise ValueError(f"{key} = '{place[:30]}': is no place; write metres, or a post as 12+345")
        if isinstance(self.begin, float) and isinstance(self.end, float) and self.end <= self.begin:
            raise ValueError(f"end = {self.end:g} m must lie beyond begin = {self.begin:g} m; exchange them")
        return self

    def on(self, line: Line) -> "Allowance":
        """Return the supplement with the places of its posts on a line [m].

        Raises
        ------
        ValueError
            For a post that the line does not have, and an end before the begin.
        """
        try:
            begin, end = (line.place_of(place) if isinstance(place, str) else place for place in (self.begin, self.end))
        except ValueError as error:
            raise ValueError(f"allowance: {error}") from None
        return build_model(Allowance, self.model_dump() | {"begin": begin, "end": end}, "allowance")

    def covers(self, first: float, last: float) -> bool:
        """Return True for a part of the line between two places [m] on which the supplement holds."""
        begin, end = self.extent(first, last)
        return begin <= first + MIN_DISTANCE and end >= last - MIN_DISTANCE

    def extent(self, first: float, last: float) -> tuple[float, float]:
        """Return its begin and end [m]; those of the plan where it has none."""
        return float(first if self.begin is None else self.begin), float(last if self.end is None else self.end)

    def seconds(self, least: float, distance: float, *, at_stop: bool) -> float:
        """Return the supplement [s] of a part with a least running time [s] and a distance [m]."""
        per_stop = (self.per_stop or 0.0) if at_stop else 0.0
        return (self.share or 0.0) * least + (self.per_100km or 0.0) * distance / PER_DISTANCE + per_stop


_NUMBER = r"(\d+(?:\.\d*)?|\.\d+)"
_FORMS = (
    (re.compile(_NUMBER + r"%"), "share_percent"),
    (re.compile(_NUMBER + r"min/100km"), "per_100km_min"),
    (re.compile(_NUMBER + r"s/stop"), "per_stop"),
)
_PLACE = r"(-?\d+(?:\+\d{3})?(?:\.\d*)?)"
_SECTION = re.compile(rf"{_PLACE}\.\.{_PLACE}")


def parse_allowance(text: str) -> Allowance:
    """Return the supplement of ``5%``, ``1.5min/100km``, ``10s/stop``, sums with ``+``, ``:KM..KM`` for a section.

    A kilometre is a number, or a post as ``12+345``.
    """
    amounts, colon, section = text.replace(" ", "").partition(":")
    data: dict[str, float | str] = {}
    for amount in amounts.split("+"):
        found = [(key, match[1]) for form, key in _FORMS if (match := form.fullmatch(amount))]
        if not found or found[0][0] in data:
            raise ValueError(
                f"'{text}': '{amount}' is no supplement of its own; write 5%, 1.5min/100km or 10s/stop, joined by +, "
                "and for a section :KM..KM"
            )
        data[found[0][0]] = float(found[0][1])
    if colon:
        places = _SECTION.fullmatch(section)
        if places is None:
            raise ValueError(
                f"'{text}': '{section}' is no section; write two kilometres, as 5%:12.5..18 or 5%:12+500..18+000"
            )
        for key, place in (("begin", places[1]), ("end", places[2])):
            data |= {key: place} if "+" in place else {f"{key}_km": float(place)}
    return build_model(Allowance, data, f"'{text}'")
