"""Sections of a line that limit a train: neutral sections, power limits, adhesion, temporary speed restrictions.

Neutral sections, power limits and adhesion hold for every vehicle with its centre in the section; a temporary speed
restriction holds for the whole length of the train.
"""

from __future__ import annotations

from pydantic import Field, model_validator

from plant_sim.number_text import number_text
from plant_sim.si_model import SiModel
from plant_sim.units import Length, Power, Ratio, Speed


class LineSection(SiModel):
    """Section of a line from ``begin`` to ``end``."""

    begin: Length
    end: Length

    @model_validator(mode="after")
    def _extent(self) -> LineSection:
        if self.end <= self.begin:
            raise ValueError(
                f"end {number_text(self.end)} m must be beyond begin {number_text(self.begin)} m; correct it"
            )
        return self


class NeutralSection(LineSection):
    """Neutral section of the overhead line: no traction power."""

    electric_brake: bool = Field(False, description="true: the electric brake works without the line (rheostatic)")


class PowerLimit(LineSection):
    """Limit of the traction power of the train, as power at the wheels or as line current.

    The power units share it in proportion to their largest powers. The electric brake is not limited.
    """

    power: Power | None = Field(None, gt=0, description="largest power at the wheels")
    current: float | None = Field(None, gt=0, description="largest line current [A], with voltage and efficiency")
    voltage: float | None = Field(None, gt=0, description="line voltage [V]")
    efficiency: Ratio | None = Field(None, gt=0, le=1, description="power at the wheels over power from the line")

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

    factor: Ratio = Field(gt=0, le=2, description="for example 0.5 for leaves on the rail")


class TemporaryRestriction(LineSection):
    """Temporary speed restriction, beside the speed limits of the line."""

    speed: Speed = Field(gt=0)
    reason: str = ""
