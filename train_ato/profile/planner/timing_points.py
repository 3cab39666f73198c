"""Timing points of a journey: windows of arrival, departure and passing, dwell times, speed windows.

A journey is a file of its own (``train_ato/journey/1``) or the key ``points`` of a plan. Times are those of the run: 0
is its start. Places are those of the train's front.

Journey files: own YAML, and the journeys of TTOBench 1.5 (JSON, BSD-2).

A TTOBench journey is a list of timing points with place, lower and upper time, lower and upper speed; null is no
constraint.  First and last point are the departure and the arrival, a point with both speeds 0 is a stop.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from plant_sim.chainage import rows_with_places
from plant_sim.formats.fields import Fields, finite_number, keys_not_carried, known_text, note_lost_keys, read_data
from plant_sim.input_error import build_model
from plant_sim.line import Line
from plant_sim.si_model import SiModel, Source, option
from plant_sim.units import Place, Speed, Time


class TimeWindow(SiModel):
    """Earliest and latest time; each may be left out."""

    earliest: Time | None = option(None, "earliest time", example=120.0, ge=0)
    latest: Time | None = option(None, "latest time", example=130.0, ge=0)

    @model_validator(mode="after")
    def _order(self) -> TimeWindow:
        if self.earliest is not None and self.latest is not None and self.earliest > self.latest:
            raise ValueError(
                f"earliest = {self.earliest:g} s is after latest = {self.latest:g} s; exchange them or widen the window"
            )
        return self


class SpeedWindow(SiModel):
    """Least and largest speed at a place; each may be left out."""

    least: Speed | None = option(None, "lowest speed", example=10.0, ge=0)
    most: Speed | None = option(None, "highest speed", example=20.0, gt=0)

    @model_validator(mode="after")
    def _order(self) -> SpeedWindow:
        if self.least is not None and self.most is not None and self.least > self.most:
            raise ValueError(
                f"least = {self.least:g} m/s is above most = {self.most:g} m/s; exchange them or widen the window"
            )
        return self


class TimingPoint(SiModel):
    """A place with the times at which the train stops there or passes it."""

    at: Place = Field(description="place of the front; in a journey file also a post 12+345", examples=[1200.0])
    name: str = option("", "name of the station", example="Market", max_length=100)
    stop: bool = option(False, "stop at this place; arrival, departure or dwell imply it")
    arrival: TimeWindow | None = option(None, "window of the arrival")
    departure: TimeWindow | None = option(None, "window of the departure")
    passing: TimeWindow | None = option(None, "window of passing without a stop")
    dwell: Time | None = option(None, "least time at rest; default: 0", example=30.0, ge=0)
    speed: SpeedWindow | None = option(None, "window of the speed when passing")

    @property
    def stops(self) -> bool:
        """True if the train stops here."""
        return self.stop or bool(self.arrival or self.departure) or self.dwell is not None

    @property
    def label(self) -> str:
        """Name and kilometre."""
        place = f"km {self.at / 1000:.3f}"
        return f"'{self.name}' ({place})" if self.name else place

    @model_validator(mode="after")
    def _stops_or_passes(self) -> TimingPoint:
        if self.stops and (self.passing or self.speed):
            raise ValueError(f"timing point {self.label} is a stop with a window of passing; remove one of them")
        return self


def check_points(points: tuple[TimingPoint, ...]) -> None:
    """Check order and ends of timing points."""
    if len(points) < 2:
        raise ValueError(f"fewer than two timing points ({len(points)}); give at least a departure and an arrival")
    for before, after in pairwise(points):
        if after.at <= before.at:
            raise ValueError(
                f"timing point {after.label} is not beyond {before.label}; list the points in the order of running"
            )
    for point, wrong in ((points[0], "arrival"), (points[-1], "departure")):
        if point.passing or point.speed or getattr(point, wrong):
            raise ValueError(
                f"timing point {point.label}: first and last point are a departure and an arrival; remove its other "
                "windows"
            )
    end = points[-1].arrival
    if end is None or end.latest is None:
        raise ValueError(f"timing point {points[-1].label}: the last point has no arrival: latest; add it")


class JourneyFile(SiModel):
    """Timing points of a journey, in the order of running."""

    schema_: Literal["train_ato/journey/1"] = Field(alias="schema", description="kind and version of the file")
    name: str = Field(max_length=100, description="name in lists and reports", examples=["metro_morning"])
    source: Source = ""
    points: tuple[TimingPoint, ...] = Field(
        description="timing points in the order of their places",
        examples=[[{"at": 0.0, "stop": True}, {"at": 12e3, "arrival": {"latest": 900.0}}]],
    )

    @model_validator(mode="after")
    def _order(self) -> JourneyFile:
        check_points(self.points)
        return self


LENGTHS, TIMES, SPEEDS = {"m": 1.0, "km": 1e3}, {"s": 1.0}, {"km/h": 1 / 3.6, "m/s": 1.0}
COLUMNS = (
    ("position", LENGTHS),
    ("lower time constraint", TIMES),
    ("upper time constraint", TIMES),
    ("lower speed constraint", SPEEDS),
    ("upper speed constraint", SPEEDS),
)

CARRIED = ("metadata.id", "metadata.associated track", "timing points.values", *(
    f"timing points.units.{column}" for column, _ in COLUMNS
))  # fmt: skip
"""Keys of a journey of TTOBench that are used."""


def read_journey(name: str, line: Line) -> JourneyFile:
    """Return the journey in a file; every place must be on the line.

    Raises
    ------
    ValueError
        One line that names the file, the key, the value and the remedy.
    """
    if not Path(name).is_file():
        raise ValueError(f"{name}: no such file; give a journey (train_ato YAML, TTOBench 1.5 JSON)")
    data = read_data(Path(name))
    if "timing points" in data:
        journey = _ttobench_journey(data, name, line)
    elif str(data.get("schema", "")).startswith("train_ato/journey/"):
        journey = _own_journey(data, name, line)
    else:
        raise ValueError(
            f"{name}: schema = '{str(data.get('schema', ''))[:60]}': no supported journey format (train_ato YAML, "
            "TTOBench 1.5 JSON); begin a train_ato file with 'schema: train_ato/journey/1'"
        )
    for point in journey.points:
        what = f"{name}: timing point {line.with_posts(point.label)}"
        line.check_place(point.at, what, "give the line of the journey or move the point")
    return journey


def _own_journey(data: dict[str, Any], name: str, line: Line) -> JourneyFile:
    """Return a journey whose places can be posts of the line."""
    try:
        if line.chainage and isinstance(rows := data.get("points"), list):
            data = {**data, "points": rows_with_places(rows, line.chainage, line.begin, f"{name}: points")}
        return build_model(JourneyFile, data, name)
    except ValueError as error:
        raise ValueError(line.with_posts(str(error))) from None


def _ttobench_journey(data: dict[str, Any], name: str, line: Line) -> JourneyFile:
    top = Fields(data, name)
    note_lost_keys(name, "TTOBench", keys_not_carried(data, CARRIED))
    metadata = top.below("metadata") if "metadata" in top else Fields({}, f"{name}: metadata")
    track = metadata.text("associated track", line.name)
    if line.source.startswith("TTOBench") and track != line.name:
        raise ValueError(f"{name}: metadata: associated track = '{track}': the line is '{line.name}'; give that track")
    fields = top.below("timing points")
    units = fields.below("units")
    factors = [known[known_text(units.text(column), f"{units.place}: {column}", known)] for column, known in COLUMNS]
    rows = fields.rows("values", len(COLUMNS), 2)
    points = []
    for k, row in enumerate(rows):
        place = f"{fields.place}: values[{k}]"
        at = finite_number(row[0], f"{place}[0]", -1e8, 1e8) * factors[0]
        values = [
            None if value is None else finite_number(value, f"{place}[{i + 1}]", 0.0, 1e8) * factor
            for i, (value, factor) in enumerate(zip(row[1:], factors[1:], strict=True))
        ]
        points.append(_point(at, values, first=k == 0, last=k == len(rows) - 1))
    source = f"TTOBench journey {metadata.text('id', Path(name).stem)}, BSD-2-Clause"
    plain = {"schema": "train_ato/journey/1", "name": Path(name).stem[:100], "source": source[:500], "points": points}
    return build_model(JourneyFile, plain, name)


def _point(at: float, values: list[float | None], *, first: bool, last: bool) -> dict[str, Any]:
    """Return the keys of a timing point from earliest, latest, least and largest speed."""
    earliest, latest, least, most = values
    window = {"earliest": earliest, "latest": latest}
    if first or last:
        return {"at": at, "stop": True, "departure" if first else "arrival": window}
    if most == 0.0:
        return {"at": at, "stop": True, "arrival": window}
    point: dict[str, Any] = {"at": at}
    if earliest is not None or latest is not None:
        point["passing"] = window
    if least or most is not None:
        point["speed"] = {"least": least, "most": most}
    return point
