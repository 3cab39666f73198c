"""Data model of a line: grades, curves, tunnels, speed limits and stops over the distance from km 0.

Sections of a line that limit a train: neutral sections, power limits, adhesion, temporary speed restrictions.

Neutral sections, power limits and adhesion hold for every vehicle with its centre in the section; a temporary speed
restriction holds for the whole length of the train.

Line for a train that runs against its direction: every place mirrored between begin and end.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from plant_sim.chainage import ChainageSection, place_of_post, post_at, with_places
from plant_sim.si_model import SiModel, Source, Summary, option
from plant_sim.units import Length, Mass, Number, Place, Power, Ratio, Slope, Speed, Unit, Usual, number_text

Begin = Annotated[Place, Field(description="place at which it begins", examples=[1200.0])]
End = Annotated[Place, Field(description="place at which it ends, beyond begin", examples=[1500.0])]


class LineSection(SiModel):
    """Section of a line from ``begin`` to ``end``."""

    begin: Begin
    end: End

    @model_validator(mode="after")
    def _extent(self) -> LineSection:
        if self.end <= self.begin:
            raise ValueError(
                f"end {number_text(self.end)} m must be beyond begin {number_text(self.begin)} m; correct it"
            )
        return self


class NeutralSection(LineSection):
    """Neutral section of the overhead line: no traction power.

    Boards beside the line can announce it, and switch the power off before its begin and on beyond its end.
    """

    electric_brake: bool = option(False, "electric brake that works without the line, as a rheostatic brake")
    announced_before: Place | None = option(
        None, "distance of the board that announces it to begin", example=500.0, ge=0
    )
    off_before: Place = option(0.0, "distance to begin at which the power is off", example=100.0, ge=0)
    on_after: Place = option(0.0, "distance beyond end at which the power returns", example=60.0, ge=0)
    coasting: bool = option(
        False,
        "all units coast from the first pantograph at off_before until the last one is at on_after; "
        "otherwise each unit has power by its own pantograph",
    )

    @model_validator(mode="after")
    def _announced_first(self) -> NeutralSection:
        if self.announced_before is not None and self.announced_before < self.off_before:
            raise ValueError(
                f"announced_before {number_text(self.announced_before)} m is behind off_before "
                f"{number_text(self.off_before)} m; give at least as much"
            )
        return self

    def without_power(self, behind: float, first: float, last: float) -> tuple[float, float]:
        """Return the places of a pantograph between which its units have no power [m].

        Parameters
        ----------
        behind, first, last
            Distance of this pantograph, the first one and the last one from the front [m].
        """
        ahead, rest = (behind - first, last - behind) if self.coasting else (0.0, 0.0)
        return self.begin - self.off_before - ahead, self.end + self.on_after + rest


class PowerLimit(LineSection):
    """Limit of the traction power of the train, as power at the wheels or as line current.

    The power units share it in proportion to their largest powers. The electric brake is not limited.
    """

    power: Annotated[Power | None, Usual(20e3, 500e6)] = option(None, "largest power at the wheels", example=3e6, gt=0)
    current: Annotated[float | None, Unit("A"), Usual(10, 20e3)] = option(
        None, "largest line current, with voltage and efficiency", example=1200.0, gt=0
    )
    voltage: Annotated[float | None, Unit("V"), Usual(200, 60e3)] = option(
        None, "voltage of the line", example=3000.0, gt=0
    )
    efficiency: Ratio | None = option(None, "power at the wheels over power from the line", example=0.85, gt=0, le=1)

    @model_validator(mode="after")
    def _one_form(self) -> PowerLimit:
        electric = (self.current, self.voltage, self.efficiency)
        missing = electric.count(None)
        if missing not in (0, len(electric)) or (self.power is None) == (missing > 0):
            raise ValueError("a power limit has power, or current with voltage and efficiency; give one of the two")
        return self

    @property
    def wheel_power(self) -> float:
        """Largest power at the wheels [W]."""
        if self.power is not None:
            return self.power
        assert self.current is not None
        assert self.voltage is not None
        assert self.efficiency is not None
        return self.current * self.voltage * self.efficiency


class AdhesionSection(LineSection):
    """Section with another adhesion, as a factor on that of the plant; without one, on Curtius and Kniffler, dry."""

    factor: Ratio = Field(
        gt=0, le=2, description="factor on the adhesion, about 0.5 for leaves on the rail", examples=[0.5]
    )


class TemporaryRestriction(LineSection):
    """Temporary speed restriction, beside the speed limits of the line."""

    speed: Speed = Field(gt=0, description="largest permitted speed", examples=[8.0])
    reason: str = option("", "reason, for displays", example="track works")


ROUNDING = 1e-6
"""Rounding of places [m]."""
ROUNDING_STEP = 0.25e-3
"""Largest step of the grade within a vertical curve."""
MAX_LENGTH = 20e6
"""Largest length of a line, half way around the Earth [m]; the model has a table with a place every metre."""
MAX_GRADE = 0.5
"""Largest plausible grade; a larger one is probably in per mille without the suffix."""


def check_grade(grade: float) -> None:
    """Raise ValueError for an implausible grade."""
    if abs(grade) > MAX_GRADE:
        raise ValueError(f"grade {grade:g} is {1e3 * grade:g} per mille; write grade_permille for per mille")


def order_fault(places: Sequence[float], start: float | None = None) -> str:
    """Return problem and remedy for places [m] that do not rise; empty if they do.

    Sorting entries of falling kilometres would put each on the neighbouring stretch and turn the direction. ``start``
    is the place where a train begins in falling kilometres, by default the first one.
    """
    for number, (before, after) in enumerate(pairwise(places), 1):
        if after == before:
            return f"[{number}]: two entries at {number_text(after)} m; keep one"
        if after < before and all(b < a for a, b in pairwise(places)):
            first = number_text(places[0] if start is None else start)
            return (
                f"[{number}]: {number_text(after)} m after {number_text(before)} m: places fall; in falling kilometres "
                f"write every place as its distance from {first} m and keep the order of the entries"
            )
        if after < before:
            return (
                f"[{number}]: {number_text(after)} m after {number_text(before)} m: places must rise in the direction "
                "of running; correct the place or the order"
            )
    return ""


class Grade(SiModel):
    """Grade from a position to the next entry; > 0 uphill."""

    at: Place = Field(description="place at which the grade begins", examples=[1200.0])
    grade: Slope = Field(description="grade, > 0 uphill", examples=[0.012])

    @model_validator(mode="after")
    def _plausible(self) -> Grade:
        check_grade(self.grade)
        return self


class VerticalCurve(SiModel):
    """Rounding of the change of grade at a place, with half of its length before the place and half behind it."""

    at: Place = Field(description="place of the change, where an entry of grades begins", examples=[1200.0])
    radius: Annotated[Place, Usual(200, 500e3)] = Field(ge=100, description="radius of the rounding", examples=[10e3])


class Curve(LineSection):
    """Curve of constant radius."""

    radius: Annotated[Place, Usual(10, 100e3)] = Field(ge=5, description="radius of the curve", examples=[400.0])
    side: Literal["left", "right"] | None = option(
        None, "direction of the curve in displays; default: left and right in turn"
    )
    resistance_n_per_kn: Annotated[float | None, Unit("N/kN"), Usual(0.005, 100)] = option(
        None, "resistance per weight; default: 600/R", example=1.2, ge=0
    )


class Tunnel(LineSection):
    """Tunnel with an additional resistance per weight, or with a cross section for that of the train."""

    resistance_n_per_kn: Annotated[float, Unit("N/kN"), Usual(0.005, 100)] = option(
        0.0, "additional resistance per weight", example=1.5, ge=0
    )
    cross_section: Annotated[float | None, Unit("m²"), Usual(5, 500)] = option(
        None, "cross section, for tunnel_resistance of the consist", example=45.0, gt=0
    )

    @model_validator(mode="after")
    def _has_resistance(self) -> Tunnel:
        if self.cross_section is None and "resistance_n_per_kn" not in self.model_fields_set:
            raise ValueError("a tunnel needs resistance_n_per_kn or cross_section; give one")
        return self


class SpeedLimit(SiModel):
    """Speed limit from a position to the next entry, for the whole length of the train."""

    at: Place = Field(description="place at which the limit begins", examples=[1200.0])
    speed: Speed = Field(gt=0, description="largest permitted speed", examples=[20.0])


class Rating(SiModel):
    """Figures of a train by which a line has speed limits: those of the train, or the ones that a limit needs."""

    axle_load: Annotated[Mass | None, Usual(1e3, 100e3)] = option(
        None, "mass on an axle; a limit needs at most it", example=20e3, gt=0
    )
    cant_deficiency: Annotated[Length | None, Usual(0.01, 0.5)] = option(
        None, "permitted cant deficiency; a limit needs at least it", example=0.13, gt=0, le=1
    )
    brake_percentage: Number | None = option(
        None, "braked weight percentage; a limit needs at least it", example=110.0, gt=0, le=500
    )

    def met_by(self, train: Rating) -> bool:
        """Return True if a train has every figure that is needed."""
        light = self.axle_load is None or (train.axle_load is not None and train.axle_load <= self.axle_load)
        least = ((self.cant_deficiency, train.cant_deficiency), (self.brake_percentage, train.brake_percentage))
        return light and all(need is None or (own is not None and own >= need) for need, own in least)


class CategoryLimits(SiModel):
    """Speed limits for trains of a category, or for all trains with some figures, in place of speed_limits."""

    category: str = Field(min_length=1, description="name that the categories of a consist have", examples=["freight"])
    needs: Rating | None = option(
        None, "figures that a train needs; a train of no category of the line takes the first that it meets"
    )
    speed_limits: tuple[SpeedLimit, ...] = Field(
        min_length=1, description="speed limits in the order of their places", examples=[[{"at": 0.0, "speed": 22.0}]]
    )

    @model_validator(mode="after")
    def _order(self) -> CategoryLimits:
        if fault := order_fault([entry.at for entry in self.speed_limits]):
            raise ValueError(f"speed_limits{fault}")
        return self


class Stop(SiModel):
    """Stopping point of the front of the train."""

    at: Place = Field(description="place of the front at standstill", examples=[1200.0])
    name: str = option("", "name of the station", example="Market")
    dwell: Annotated[float, Unit("s"), Usual(2, 14400)] = option(
        0.0, "time at rest at an intermediate stop", example=30.0, ge=0
    )


class Coordinate(SiModel):
    """Coordinate of a place of the line (WGS 84), for displays."""

    at: Place = Field(description="place on the line", examples=[1200.0])
    latitude: Annotated[float, Unit("deg")] = Field(ge=-90, le=90, description="latitude, > 0 north", examples=[48.14])
    longitude: Annotated[float, Unit("deg")] = Field(
        ge=-180, le=180, description="longitude, > 0 east", examples=[11.56]
    )


class Line(SiModel):
    """Line; before ``begin`` and beyond ``end`` it continues level and straight."""

    schema_: Literal["train_ato/line/1"] = Field(alias="schema", description="kind and version of the file")
    name: str = Field(description="name in lists, logs and reports", examples=["metro_12_km"])
    summary: Summary = ""
    source: Source = ""
    begin: Place = option(0.0, "place at which the line begins", example=100.0)
    end: Place = Field(description="place at which the line ends", examples=[12e3])
    chainage: tuple[ChainageSection, ...] = option(
        (),
        "kilometres of the posts along the line, in running order. They may fall or jump. Places are "
        "then shown as 12+345 and can be written so",
        example=[{"begin": 84500.0, "end": 80200.0}, {"begin": 80250.0, "end": 77000.0}],
    )
    grades: tuple[Grade, ...] = option((), "grades in the order of their places; level before the first")
    vertical_curves: tuple[VerticalCurve, ...] = option(
        (), "rounded changes of grade in the order of their places; default: every grade changes at one place"
    )
    curves: tuple[Curve, ...] = ()
    tunnels: tuple[Tunnel, ...] = option(
        (), "tunnels in any order", example=[{"begin": 1200.0, "end": 1500.0, "resistance_n_per_kn": 1.5}]
    )
    speed_limits: tuple[SpeedLimit, ...] = option((), "speed limits in the order of their places")
    category_limits: tuple[CategoryLimits, ...] = option(
        (), "speed limits by category or figures of a train; the first of its categories decides"
    )
    temporary_restrictions: tuple[TemporaryRestriction, ...] = ()
    neutral_sections: tuple[NeutralSection, ...] = ()
    power_limits: tuple[PowerLimit, ...] = option(
        (), "limits of the traction power", example=[{"begin": 1200.0, "end": 1500.0, "power": 3e6}]
    )
    adhesion: tuple[AdhesionSection, ...] = ()
    stops: tuple[Stop, ...] = option((), "stopping points in the order of their places")
    coordinates: tuple[Coordinate, ...] = option(
        (),
        "coordinates in the order of their places, at least two, for displays",
        example=[
            {"at": 0.0, "latitude": 48.14, "longitude": 11.56},
            {"at": 12e3, "latitude": 48.22, "longitude": 11.63},
        ],
    )

    @model_validator(mode="before")
    @classmethod
    def _posts(cls, data: Any) -> Any:
        return with_places(data) if isinstance(data, dict) and "chainage" in data else data

    def post_at(self, place: float) -> str:
        """Return the kilometre of a place [m] as the posts of the line show it, or with three decimals."""
        return post_at(self.chainage, self.begin, place) if self.chainage else f"{place / 1e3:.3f}"

    def with_posts(self, text: str) -> str:
        """Return a text with posts for the places on the line, written as ``km 1.250``; that of ``extent`` stays."""

        def shown(found: re.Match[str]) -> str:
            place = 1e3 * float(found[1])
            return f"km {post_at(self.chainage, self.begin, place, 0)}" if self.begin <= place <= self.end else found[0]

        return re.sub(r"\bkm (-?\d+\.\d{3})(?!\d| \.\.\. \S+, posts)", shown, text) if self.chainage else text

    @property
    def extent(self) -> str:
        """Places of its begin and end in words, with its posts."""
        text = f"km {self.begin / 1e3:.3f} ... {self.end / 1e3:.3f}"
        return f"{text}, posts {self.post_at(self.begin)} ... {self.post_at(self.end)}" if self.chainage else text

    def check_place(self, place: float, what: str, remedy: str) -> None:
        """Refuse a place beyond the line [m]; ``what`` is there."""
        if not self.begin - 1e-6 <= place <= self.end + 1e-6:
            raise ValueError(f"{what} lies beyond line '{self.name}' ({self.extent}); {remedy}")

    def place_of(self, text: str) -> float:
        """Return the place of a post such as ``12+345`` [m].

        Raises
        ------
        ValueError
            If the line has no chainage, or this kilometre nowhere or twice.
        """
        if not self.chainage:
            raise ValueError(f"'{text}': line '{self.name}' has no chainage; write the distance in kilometres")
        return place_of_post(self.chainage, self.begin, text)

    @model_validator(mode="after")
    def _order(self) -> Line:
        if self.end <= self.begin:
            raise ValueError(
                f"end {number_text(self.end)} m must be beyond begin {number_text(self.begin)} m; write distances that "
                "rise in the direction of running"
            )
        if self.end - self.begin > MAX_LENGTH:
            length = number_text((self.end - self.begin) / 1000)
            raise ValueError(f"a line of {length} km, at most {MAX_LENGTH / 1000:.0f} km; check the unit of end")
        for name in ("grades", "vertical_curves", "speed_limits", "stops", "coordinates"):
            if fault := order_fault([entry.at for entry in getattr(self, name)], self.end):
                raise ValueError(f"{name}{fault}")
        names = [entry.category for entry in self.category_limits]
        if twice := next((name for k, name in enumerate(names) if name in names[:k]), ""):
            raise ValueError(f"category_limits: '{twice}' has two entries; keep one")
        if len(self.coordinates) == 1:
            raise ValueError("coordinates has one entry; give at least two, or none")
        return self

    @model_validator(mode="after")
    def _roundings(self) -> Line:
        reached = self.begin
        for number, (entry, (change, half)) in enumerate(
            zip(self.vertical_curves, map(self._rounding, self.vertical_curves), strict=True)
        ):
            key = f"vertical_curves[{number}] at {number_text(entry.at)} m"
            if change == 0.0:
                raise ValueError(f"{key}: no grade changes there; give the place of an entry of grades")
            if entry.at - half < reached - ROUNDING or entry.at + half > self.end + ROUNDING:
                raise ValueError(
                    f"{key}: its {number_text(2 * half)} m reach beyond the line or the rounding before; lower its "
                    "radius"
                )
            reached = entry.at + half
            inside = [grade.at for grade in self.grades if ROUNDING < abs(grade.at - entry.at) < half - ROUNDING]
            if inside:
                raise ValueError(
                    f"{key}: its {number_text(2 * half)} m reach over the grade at {number_text(inside[0])} m; lower "
                    "its radius"
                )
        return self

    def _rounding(self, curve: VerticalCurve) -> tuple[float, float]:
        """Return the change of grade at a vertical curve, and half of its length [m]."""
        before, change = 0.0, 0.0
        for entry in self.grades:
            if abs(entry.at - curve.at) <= ROUNDING:
                change = entry.grade - before
                break
            before = entry.grade
        return change, curve.radius * abs(change) / 2

    @property
    def rounded_grades(self) -> tuple[Grade, ...]:
        """Grades with every vertical curve in steps of at most 0.25 per mille, with the heights of the curve."""
        if not self.vertical_curves:
            return self.grades
        roundings = [(entry.at, self._rounding(entry)) for entry in self.vertical_curves]
        found: list[Grade] = []
        for entry in self.grades:
            here = (rounding for at, rounding in roundings if abs(entry.at - at) <= ROUNDING)
            change, half = next(here, (0.0, 0.0))
            steps = math.ceil(abs(change) / ROUNDING_STEP)
            for step in range(steps):
                at, part = entry.at - half + 2 * half * step / steps, (step + 0.5) / steps
                found.append(Grade(at=at, grade=entry.grade - change * (1.0 - part)))
            found.append(Grade(at=entry.at + half, grade=entry.grade))
        return tuple(found)

    @model_validator(mode="after")
    def _restrictions_below_limits(self) -> Line:
        first = self.speed_limits[0].at if self.speed_limits else float("inf")
        for number, entry in enumerate(self.temporary_restrictions):
            if entry.begin < first:
                raise ValueError(
                    f"temporary_restrictions[{number}] begins at {number_text(entry.begin)} m, where the line has no "
                    "speed limit; begin speed_limits there or before"
                )
        return self

    @property
    def restricted_limits(self) -> tuple[SpeedLimit, ...]:
        """Most restrictive speed limits: those of the line and the temporary restrictions, by rising distance."""
        restrictions = self.temporary_restrictions
        if not restrictions:
            return self.speed_limits
        places = {limit.at for limit in self.speed_limits}
        places |= {place for entry in restrictions for place in (entry.begin, entry.end)}
        found: list[SpeedLimit] = []
        for at in sorted(places):
            speed = next(limit.speed for limit in reversed(self.speed_limits) if limit.at <= at)
            speed = min([speed, *(entry.speed for entry in restrictions if entry.begin <= at < entry.end)])
            if not found or found[-1].speed != speed:
                found.append(SpeedLimit(at=at, speed=speed))
        return tuple(found)


AGAINST = "reverse"
"""Selection of a line name for the other direction: ``LINE:reverse``."""
ENDING = f":{AGAINST}"
OTHER_SIDE = {"left": "right", "right": "left", None: None}


def reversed_line(line: Line) -> Line:
    """Return the line for the other direction of running: place x becomes begin + end - x.

    Grades change their sign, curves their side. A grade, and a speed limit, that holds from its place on in one
    direction holds up to that place in the other one.

    Raises
    ------
    ValueError
        If the line has speed limits, but none at its begin, which is the end of the reversed line.
    """

    def mirrored(place: float) -> float:
        return line.begin + line.end - place

    def stretch(entry: Any) -> dict[str, float]:
        return {"begin": mirrored(entry.end), "end": mirrored(entry.begin)}

    def stretches(entries: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(entry.model_copy(update=stretch(entry)) for entry in reversed(entries))

    def points(entries: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(entry.model_copy(update={"at": mirrored(entry.at)}) for entry in reversed(entries))

    for of, entries in (
        ("", line.speed_limits), *((f" of '{row.category}'", row.speed_limits) for row in line.category_limits),
    ):  # fmt: skip
        if entries and entries[0].at > line.begin:
            raise ValueError(
                f"line '{line.name}': speed_limits{of}: none before {number_text(entries[0].at)} m, where "
                f"a train in the other direction ends; begin them at {number_text(line.begin)} m"
            )
    curves = tuple(curve.model_copy(update={"side": OTHER_SIDE[curve.side]}) for curve in stretches(line.curves))

    def limits(entries: tuple[SpeedLimit, ...]) -> list[dict[str, float]]:
        pieces = [(mirrored(end), entry.speed) for entry, end in _pieces(line, entries)]
        return [{"at": at, "speed": speed} for at, speed in reversed(pieces)]

    update = {
        "name": line.name.removesuffix(ENDING) if line.name.endswith(ENDING) else line.name + ENDING,
        "grades": [{"at": at, "grade": grade} for at, grade in _mirrored_grades(line)],
        "chainage": [{"begin": entry.end, "end": entry.begin} for entry in reversed(line.chainage)],
        "curves": curves,
        "speed_limits": limits(line.speed_limits),
        "category_limits": [
            {**entry.model_dump(exclude_unset=True), "speed_limits": limits(entry.speed_limits)}
            for entry in line.category_limits
        ],
        **{key: points(getattr(line, key)) for key in ("vertical_curves", "stops", "coordinates")},
    }
    for key in ("tunnels", "temporary_restrictions", "neutral_sections", "power_limits", "adhesion"):
        update[key] = stretches(getattr(line, key))
    data = line.model_dump(by_alias=True, exclude_unset=True)
    return Line.model_validate(data | update)


def line_for(line: Line, categories: Sequence[str], rating: Rating | None = None) -> Line:
    """Return a line with the speed limits of the first category of a train that it has.

    Parameters
    ----------
    categories
        Categories of the train in the order of their choice; none: the line as it is.
    rating
        Figures of the train; without a category of the line, it takes the first limits whose needs it meets.

    Raises
    ------
    ValueError
        If the line has limits of other categories only: the train would have none.
    """
    train = rating or Rating()
    met = [entry for entry in line.category_limits if entry.needs is None or entry.needs.met_by(train)]
    named = (entry for name in categories for entry in met if entry.category == name)
    chosen = next(named, next((entry for entry in met if entry.needs is not None), None))
    if chosen is None:
        if line.category_limits and not line.speed_limits:
            known = ", ".join(entry.category for entry in line.category_limits)
            raise ValueError(
                f"line '{line.name}': category_limits: none for this train; add one of {known} to the categories of "
                "the train, or speed_limits to the line"
            )
        return line
    data = line.model_dump(by_alias=True, exclude_unset=True)
    return Line.model_validate(data | {"speed_limits": [entry.model_dump() for entry in chosen.speed_limits]})


def _pieces(line: Line, entries: tuple[Any, ...]) -> list[tuple[Any, float]]:
    """Return every entry that holds on the line, with the end of its piece [m]."""
    ends = [*(entry.at for entry in entries[1:]), line.end][: len(entries)]
    return [
        (entry, min(end, line.end))
        for entry, end in zip(entries, ends, strict=True)
        if end > line.begin and entry.at < line.end
    ]


def _mirrored_grades(line: Line) -> list[tuple[float, float]]:
    """Return place [m] and grade of the pieces of the reversed line; level where the line has no grade."""
    pieces = _pieces(line, line.grades) if line.grades else []
    found = [(line.begin + line.end - end, 0.0 - entry.grade) for entry, end in reversed(pieces)]
    if pieces and pieces[0][0].at > line.begin:
        found.append((line.begin + line.end - pieces[0][0].at, 0.0))
    return found
