"""Data model of a line: grades, curves, tunnels, speed limits and stops over the distance from km 0."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

from pydantic import Field, model_validator

from plant_sim.line_sections import AdhesionSection, NeutralSection, PowerLimit, TemporaryRestriction
from plant_sim.number_text import number_text
from plant_sim.si_model import SiModel
from plant_sim.units import Length, Slope, Speed

SCHEMA = "train_ato/line/1"
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

    at: Length
    grade: Slope = Field(description="for example 0.012, or grade_permille: 12")

    @model_validator(mode="after")
    def _plausible(self) -> Grade:
        check_grade(self.grade)
        return self


class Curve(SiModel):
    """Curve of constant radius R [m], with a resistance of 600/R N/kN."""

    begin: Length
    end: Length
    radius: Length = Field(ge=5)
    side: Literal["left", "right"] | None = Field(None, description="turn, for displays; default: in turn")


class Tunnel(SiModel):
    """Tunnel with an additional resistance per weight, or with a cross section for that of the train."""

    begin: Length
    end: Length
    resistance_n_per_kn: float = Field(0.0, ge=0)
    cross_section: float | None = Field(None, gt=0, description="[m²], for tunnel_resistance of the consist")

    @model_validator(mode="after")
    def _has_resistance(self) -> Tunnel:
        if self.cross_section is None and "resistance_n_per_kn" not in self.model_fields_set:
            raise ValueError("a tunnel needs resistance_n_per_kn or cross_section; give one")
        return self


class SpeedLimit(SiModel):
    """Speed limit from a position to the next entry, for the whole length of the train."""

    at: Length
    speed: Speed = Field(gt=0)


class Stop(SiModel):
    """Stopping point of the front of the train."""

    at: Length
    name: str = ""
    dwell: float = Field(0.0, ge=0, description="dwell time [s]")


class Coordinate(SiModel):
    """Coordinate of a place of the line (WGS 84), for displays."""

    at: Length
    latitude: float = Field(ge=-90, le=90, description="[deg], > 0 north")
    longitude: float = Field(ge=-180, le=180, description="[deg], > 0 east")


class Line(SiModel):
    """Line; before ``begin`` and beyond ``end`` it continues level and straight."""

    schema_: Literal["train_ato/line/1"] = Field(alias="schema")
    name: str
    summary: str = ""
    source: str = ""
    begin: Length = 0.0
    end: Length
    grades: tuple[Grade, ...] = ()
    curves: tuple[Curve, ...] = ()
    tunnels: tuple[Tunnel, ...] = ()
    speed_limits: tuple[SpeedLimit, ...] = ()
    temporary_restrictions: tuple[TemporaryRestriction, ...] = ()
    neutral_sections: tuple[NeutralSection, ...] = ()
    power_limits: tuple[PowerLimit, ...] = ()
    adhesion: tuple[AdhesionSection, ...] = ()
    stops: tuple[Stop, ...] = ()
    coordinates: tuple[Coordinate, ...] = Field((), description="at least two, by rising distance; for displays")

    @model_validator(mode="after")
    def _order(self) -> Line:
        if self.end <= self.begin:
            raise ValueError(
                f"end {number_text(self.end)} m must be beyond begin {number_text(self.begin)} m; write distances that "
                "rise in the direction of running"
            )
        for name, places in (
            ("grades", [entry.at for entry in self.grades]),
            ("speed_limits", [entry.at for entry in self.speed_limits]),
            ("stops", [entry.at for entry in self.stops]),
            ("coordinates", [entry.at for entry in self.coordinates]),
        ):
            fault = order_fault(places, max(self.begin, self.end))
            if fault:
                raise ValueError(f"{name}{fault}")
        for stretches in (self.curves, self.tunnels):
            if any(stretch.end <= stretch.begin for stretch in stretches):
                raise ValueError("a curve or tunnel must have its end beyond its begin; correct it")
        if len(self.coordinates) == 1:
            raise ValueError("coordinates has one entry; give at least two, or none")
        return self

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
