"""Timing points of a journey: windows of arrival, departure and passing, dwell times, speed windows.

A journey is a file of its own (``train_ato/journey/1``) or the key ``points`` of a plan. Times are those of the run: 0
is its start. Places are those of the train's front.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

from pydantic import Field, model_validator

from plant_sim.si_model import SiModel
from plant_sim.units import Length, Speed, Time


class TimeWindow(SiModel):
    """Earliest and latest time; each may be left out."""

    earliest: Time | None = Field(None, ge=0, description="not before this time")
    latest: Time | None = Field(None, ge=0, description="not after this time")

    @model_validator(mode="after")
    def _order(self) -> TimeWindow:
        if self.earliest is not None and self.latest is not None and self.earliest > self.latest:
            raise ValueError(
                f"earliest = {self.earliest:g} s is after latest = {self.latest:g} s; exchange them or widen the window"
            )
        return self


class SpeedWindow(SiModel):
    """Least and largest speed at a place; each may be left out."""

    least: Speed | None = Field(None, ge=0, description="not slower than this speed")
    most: Speed | None = Field(None, gt=0, description="not faster than this speed")

    @model_validator(mode="after")
    def _order(self) -> SpeedWindow:
        if self.least is not None and self.most is not None and self.least > self.most:
            raise ValueError(
                f"least = {self.least:g} m/s is above most = {self.most:g} m/s; exchange them or widen the window"
            )
        return self


class TimingPoint(SiModel):
    """A place with the times at which the train stops there or passes it."""

    at: Length = Field(description="place of the front")
    name: str = Field("", max_length=100)
    stop: bool = Field(False, description="stop here; arrival, departure or dwell imply it")
    arrival: TimeWindow | None = Field(None, description="window of the arrival")
    departure: TimeWindow | None = Field(None, description="window of the departure")
    passing: TimeWindow | None = Field(None, description="window of passing without a stop")
    dwell: Time | None = Field(None, ge=0, description="least time at rest; default: 0")
    speed: SpeedWindow | None = Field(None, description="window of the speed when passing")

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
    """Check order and ends of timing points.

    Raises
    ------
    ValueError
        One line: point, problem; fix.
    """
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

    schema_: Literal["train_ato/journey/1"] = Field(alias="schema")
    name: str = Field(max_length=100)
    source: str = Field("", max_length=500)
    points: tuple[TimingPoint, ...]

    @model_validator(mode="after")
    def _order(self) -> JourneyFile:
        check_points(self.points)
        return self
