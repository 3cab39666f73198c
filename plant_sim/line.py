"""A line as data: grades, curves, tunnels, speed limits and stops over the distance from its km 0."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

from pydantic import Field, model_validator

from plant_sim.units import Length, SiModel, Slope, Speed

SCHEMA = "train_ato/line/1"
STEEPEST = 0.5
"""No railway is steeper; beyond it a grade in per mille was written without its suffix."""


def check_grade(grade: float) -> None:
    """Raise for a grade that no railway has."""
    if abs(grade) > STEEPEST:
        raise ValueError(f"grade {grade:g} is {1e3 * grade:g} per mille; if per mille are meant write grade_permille")


class Grade(SiModel):
    """Grade from a place on, until the next entry; > 0 uphill."""

    at: Length
    grade: Slope = Field(description="0.012, or with its suffix grade_permille: 12")

    @model_validator(mode="after")
    def _meant(self) -> Grade:
        check_grade(self.grade)
        return self


class Curve(SiModel):
    """A stretch of constant radius; resistance 600/R N/kN."""

    begin: Length
    end: Length
    radius: Length = Field(ge=5)


class Tunnel(SiModel):
    """A stretch with an added resistance of so many N per kN of weight (tunnels)."""

    begin: Length
    end: Length
    resistance_n_per_kn: float = Field(ge=0)


class SpeedLimit(SiModel):
    """Limit from a place on, until the next entry; holds for the whole length of the train."""

    at: Length
    speed: Speed = Field(gt=0)


class Stop(SiModel):
    """A place where the front of the train stops."""

    at: Length
    name: str = ""
    dwell: float = Field(0.0, ge=0, description="s")


class Line(SiModel):
    """A whole line. Before ``begin`` and beyond ``end`` it goes on level and straight."""

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
    stops: tuple[Stop, ...] = ()

    @model_validator(mode="after")
    def _order(self) -> Line:
        if self.end <= self.begin:
            raise ValueError("end must lie beyond begin")
        for name, places in (
            ("grades", [entry.at for entry in self.grades]),
            ("speed_limits", [entry.at for entry in self.speed_limits]),
            ("stops", [entry.at for entry in self.stops]),
        ):
            if any(b <= a for a, b in pairwise(places)):
                raise ValueError(f"{name} must be listed by rising distance")
        for stretches in (self.curves, self.tunnels):
            if any(stretch.end <= stretch.begin for stretch in stretches):
                raise ValueError("a curve or tunnel must end beyond its begin")
        return self
