"""Data models of the draft gears: loading and unloading force over the deflection."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from plant_sim.si_model import SiModel, option
from plant_sim.units import Damping, Force, Length, Number, Speed, Stiffness, Usual, number_text

Stroke = Annotated[Length, Usual(0.005, 2)]
Slack = Annotated[Length, Usual(1e-4, 0.5)]
Spring = Annotated[Stiffness, Usual(1e4, 5e8)]
Stop = Annotated[Stiffness, Usual(1e6, 1e10)]
Preload = Annotated[Force, Usual(500, 1e6)]
Full = Annotated[Force, Usual(20e3, 20e6)]
Damper = Annotated[Damping, Usual(500, 1e9)]


class GearCurve(SiModel):
    """Loading curve fl(d) = F0 d/(d + x0) + a1 d + a2 d² of one coupler (two gears in series), as in paper 000."""

    stroke: Stroke = Field(gt=0, description="D, deflection at the stop", examples=[0.166])
    force_at_stroke: Full = Field(
        gt=0, description="force at the end of the stroke, which determines a2 of the loading curve", examples=[2270e3]
    )
    preload: Preload = Field(gt=0, description="force F0 of the loading curve", examples=[60e3])
    preload_length: Annotated[Length, Usual(1e-5, 0.2)] = Field(
        gt=0, description="length x0 of the loading curve", examples=[0.002]
    )
    stiffness: Spring = Field(gt=0, description="stiffness a1 of the loading curve", examples=[2.5e6])
    unloading_ratio: Number = Field(gt=0, le=1, description="unloading force over loading force", examples=[0.25])
    slack: Slack = option(0.010, "free play from draft to buff", ge=0)
    damping: Damper = option(1e5, "structural damping c in c x' d/(d + x0), with the gear in contact", ge=0)
    stop_stiffness: Stop = option(200e6, "stiffness beyond the stroke", gt=0)

    @model_validator(mode="after")
    def _rises(self) -> GearCurve:
        if self.steepness(self.stroke) <= 0:
            raise ValueError(
                f"force_at_stroke {number_text(self.force_at_stroke)} N is too small, the loading curve falls "
                f"before the stroke; raise it or lower stiffness ({number_text(self.stiffness)} N/m)"
            )
        return self

    @property
    def second_order(self) -> float:
        """Coefficient a2 from the force at the stroke [N/m²]."""
        d = self.stroke
        return (self.force_at_stroke - self.preload * d / (d + self.preload_length) - self.stiffness * d) / d**2

    def steepness(self, deflection: float) -> float:
        """Return the slope of the loading curve [N/m] at a deflection [m]."""
        soft = self.preload * self.preload_length / (deflection + self.preload_length) ** 2
        return self.stiffness + 2 * self.second_order * deflection + soft


class ClipGear(GearCurve):
    """Draft gear of paper 000, eqs. (7)-(9): force between unloading curve fu and loading curve fl (MT-2)."""

    kind: Literal["clip"]
    transition_stiffness: Stop = option(
        60e6, "stiffness between the branches, above the largest slope of the loading curve", gt=0
    )
    transition_damping: Damper = option(0.0, "damping between the branches", example=5e6, ge=0)

    @model_validator(mode="after")
    def _stiff_enough(self) -> ClipGear:
        _check_transition(self.transition_stiffness, max(self.steepness(0.0), self.steepness(self.stroke)))
        return self


def _check_transition(stiffness: float, steepest: float) -> None:
    if stiffness < steepest * (1 - 1e-9):
        raise ValueError(
            f"transition_stiffness {number_text(stiffness)} N/m is below the largest slope "
            f"{number_text(steepest)} N/m of the loading curve, "
            "which the force could not reach; raise it"
        )


class SmoothedGear(GearCurve):
    """Draft gear of paper 000, eq. (6): branches joined over a switching speed (QKX100)."""

    kind: Literal["smoothed"]
    switching_speed: Annotated[Speed, Usual(1e-4, 0.5)] = option(0.02, "speed over which the branches are joined", gt=0)


class LinearGear(SiModel):
    """Spring and damper with optional slack (papers 002 and 004)."""

    kind: Literal["linear"]
    stiffness: Spring = Field(gt=0, description="stiffness of the spring", examples=[20e6])
    damping: Damper = option(0.0, "damping of the damper", example=0.5e6, ge=0)
    slack: Slack = option(0.0, "free play from draft to buff", example=0.01, ge=0)


class RigidGear(SiModel):
    """Rigid coupler; its force follows from the balance of the vehicles."""

    kind: Literal["rigid"]


class GearTable(SiModel):
    """Loading and unloading force over the deflection in one direction."""

    deflection: Annotated[tuple[Length, ...], Usual(0.005, 2)] = Field(
        description="deflections of the table, rising from 0", examples=[(0.0, 0.05, 0.1)]
    )
    loading: Annotated[tuple[Force, ...], Usual(20e3, 20e6)] = Field(
        description="force at each deflection in loading", examples=[(0.0, 400e3, 1500e3)]
    )
    unloading: tuple[Force, ...] = Field(
        description="force at each deflection in unloading", examples=[(0.0, 100e3, 1500e3)]
    )

    @model_validator(mode="after")
    def _curves(self) -> GearTable:
        if not len(self.deflection) == len(self.loading) == len(self.unloading) >= 2:
            raise ValueError("deflection, loading and unloading need the same length of at least 2; correct them")
        if self.deflection[0] != 0 or any(b <= a for a, b in pairwise(self.deflection)):
            raise ValueError("deflection must begin at 0 and rise; correct it")
        if any(u < 0 or u > f for u, f in zip(self.unloading, self.loading, strict=True)):
            raise ValueError("unloading must be between 0 and loading, because a gear dissipates energy; correct it")
        if self.unloading[0] > 0:
            raise ValueError(
                f"unloading begins at {number_text(self.unloading[0])} N, but a relaxed gear has no force; begin "
                "it at 0 (loading may begin at the preload)"
            )
        for name, force in (("loading", self.loading), ("unloading", self.unloading)):
            if any(b < a for a, b in pairwise(force)) or force[-1] <= 0:
                raise ValueError(f"{name} must rise with the deflection; correct it")
        return self

    @property
    def steepest(self) -> float:
        """Largest slope of the loading curve [N/m]."""
        points = zip(self.deflection, self.loading, strict=True)
        return max((f1 - f0) / (d1 - d0) for (d0, f0), (d1, f1) in pairwise(points))


class TableGear(GearTable):
    """Tabulated loading and unloading force over the deflection, with transitions as in :class:`ClipGear`."""

    kind: Literal["table"]
    buff: GearTable | None = option(
        None,
        "forces in buff, > 0, if they differ from those above, which then hold in draft",
        example={"deflection": (0.0, 0.08), "loading": (20e3, 2000e3), "unloading": (0.0, 2000e3)},
    )
    slack: Slack = option(0.0, "free play from draft to buff", example=0.01, ge=0)
    damping: Damper = option(0.0, "damping of the gear in contact", example=1e5, ge=0)
    transition_stiffness: Stop = option(60e6, "stiffness between the branches", gt=0)
    transition_damping: Damper = option(0.0, "damping between the branches", example=5e6, ge=0)
    stop_stiffness: Stop = option(200e6, "stiffness beyond the last deflection", gt=0)

    @model_validator(mode="after")
    def _stiff_enough(self) -> TableGear:
        _check_transition(self.transition_stiffness, max(table.steepest for table in self.tables))
        return self

    @property
    def tables(self) -> tuple[GearTable, GearTable]:
        """Tables in draft and in buff."""
        return self, self.buff or self


DraftGear = Annotated[ClipGear | SmoothedGear | LinearGear | RigidGear | TableGear, Field(discriminator="kind")]
