"""Data model of the friction brakes of a train: shoes, air brake, emergency brake."""

from itertools import pairwise
from typing import Annotated

from pydantic import Field, model_validator

from plant_sim.si_model import SiModel, option
from plant_sim.units import Acceleration, Force, Number, Pressure, Ratio, Speed, Time, Usual, number_text

Filling = Annotated[Time, Usual(0.2, 120)]
BuildUp = Annotated[Time, Usual(0.05, 60)]


class Shoes(SiModel):
    """Air-brake shoes or pads of one vehicle: paper 000, eqs. (10)-(15) and table 1."""

    count: int = Field(gt=0, description="number of brake shoes or pads of the vehicle", examples=[16])
    force: Annotated[Force, Usual(500, 500e3)] = Field(
        gt=0, description="force K of one shoe at full cylinder pressure", examples=[25e3]
    )
    friction: Number = Field(
        gt=0, description="factor on the friction coefficient, 0.481 for C80 and 0.441 for HXD1", examples=[0.481]
    )

    @property
    def standstill_force(self) -> float:
        """Retarding force at full cylinder pressure and speed 0 [N]: paper 000, eqs. (10)-(12)."""
        force_kn = self.force / 1e3
        return self.count * self.force * (self.friction * (force_kn + 200.0) / (4.0 * force_kn + 200.0))


class AirBrake(SiModel):
    """Brake pipe and cylinders of a train: paper 000, section 1.1.4, and values that it does not give."""

    charged: Annotated[Pressure, Usual(100e3, 2e6)] = option(600e3, "absolute pressure of the charged brake pipe", gt=0)
    apply_wave: Annotated[Speed, Usual(60, 350)] = option(200.0, "speed of the application wave along the train", gt=0)
    release_wave: Annotated[Speed, Usual(12, 120)] = option(36.0, "speed of the release wave along the train", gt=0)
    apply_time: Filling = option(4.0, "time constant of the cylinders filling", gt=0)
    release_time: Filling = option(6.0, "time constant of the cylinders emptying", gt=0)
    pipe_apply_time: Filling = option(2.0, "time constant of the falling pipe pressure, which is published only", gt=0)
    pipe_release_time: Filling = option(6.0, "time constant of the rising pipe pressure, which is published only", gt=0)
    pipe_vent_time: Filling = option(
        1.0, "time constant of the pressure in an open pipe, which is published only", gt=0
    )
    reduction: Annotated[tuple[Pressure, ...], Usual(10e3, 1e6)] = option(
        (0.0, 50e3), "brake-pipe reductions of the table of the braking factor"
    )
    braking_factor: tuple[Ratio, ...] = option((0.0, 0.17), "braking factor at those reductions")
    reservoir_use: Ratio = option(0.0, "part of a reservoir that one full application uses", example=0.3, ge=0, le=1)
    recharge_time: Annotated[Time, Usual(3, 3600)] = option(
        60.0, "time constant of the reservoirs recharging while released", gt=0
    )

    @model_validator(mode="after")
    def _table(self) -> "AirBrake":
        if len(self.reduction) != len(self.braking_factor) or len(self.reduction) < 2:
            raise ValueError("reduction and braking_factor need the same length of at least 2; correct them")
        if any(b <= a for a, b in pairwise(self.reduction)):
            raise ValueError("reduction does not rise; list it by rising values")
        if any(b < a for a, b in pairwise(self.braking_factor)) or not 0 < self.braking_factor[-1] <= 1:
            raise ValueError("braking_factor must rise with the reduction to a value above 0 and up to 1; correct it")
        if self.reduction[0] != 0 or self.braking_factor[0] != 0:
            raise ValueError(
                "reduction and braking_factor must begin at 0, because a charged pipe does not brake; begin both at 0"
            )
        if self.reduction[-1] > self.charged:
            raise ValueError(
                f"reduction {number_text(self.reduction[-1])} Pa exceeds charged {number_text(self.charged)} Pa; "
                "write both absolute, in Pa "
                "or with the suffix _kpa"
            )
        return self


class EmergencyBrake(SiModel):
    """Friction emergency brake of a train without air brake: an own path, independent of drives and commands.

    A loop along the train applies it on every vehicle at the same time. Its friction falls with the speed as that of
    the shoes: paper 000, eqs. (11), (12). The defaults are an assumption: brake percentage 100, which is 0.0075 x 100 +
    0.076 = 0.83 m/s² (SUBSET-026, A.3.7.4), and a build-up of 2.3 s.
    """

    deceleration: Annotated[Acceleration, Usual(0.05, 5)] = option(
        0.83, "brake force of a vehicle at standstill over its inertial mass", gt=0, le=5
    )
    delay: BuildUp = option(0.8, "dead time from the application to the first force", ge=0, le=10)
    time_constant: BuildUp = option(1.5, "time constant of the build-up after the delay", gt=0, le=60)
    release_time: BuildUp = option(1.5, "time constant of the release, which has no delay", gt=0, le=60)
