"""Data models of the draft gears: loading and unloading force over the deflection."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from plant_sim.number_text import number_text
from plant_sim.si_model import SiModel
from plant_sim.units import Damping, Force, Length, Speed, Stiffness


class GearCurve(SiModel):
    """Loading curve fl(d) = F0 d/(d + x0) + a1 d + a2 d² of one coupler (two gears in series), as in paper 000."""

    stroke: Length = Field(gt=0, description="D, deflection at the stop")
    force_at_stroke: Force = Field(gt=0, description="fl(D), determines a2")
    preload: Force = Field(gt=0, description="F0")
    preload_length: Length = Field(gt=0, description="x0")
    stiffness: Stiffness = Field(gt=0, description="a1")
    unloading_ratio: float = Field(gt=0, le=1, description="r: unloading force over loading force")
    slack: Length = Field(0.010, ge=0, description="free play from draft to buff")
    damping: Damping = Field(1e5, ge=0, description="structural damping c in c x' d/(d + x0), in contact")
    stop_stiffness: Stiffness = Field(200e6, gt=0, description="beyond the stroke")

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
    transition_stiffness: Stiffness = Field(
        60e6, gt=0, description="k between the branches; above the largest slope of fl"
    )
    transition_damping: Damping = Field(0.0, ge=0, description="damping between the branches")

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
    switching_speed: Speed = Field(0.02, gt=0, description="ve")


class LinearGear(SiModel):
    """Spring and damper with optional slack (papers 002 and 004)."""

    kind: Literal["linear"]
    stiffness: Stiffness = Field(gt=0)
    damping: Damping = Field(0.0, ge=0)
    slack: Length = Field(0.0, ge=0)


class RigidGear(SiModel):
    """Rigid coupler; its force follows from the balance of the vehicles."""

    kind: Literal["rigid"]


class TableGear(SiModel):
    """Tabulated loading and unloading force over the deflection, with transitions as in :class:`ClipGear`."""

    kind: Literal["table"]
    deflection: tuple[Length, ...] = Field(description="rising, from 0")
    loading: tuple[Force, ...]
    unloading: tuple[Force, ...]
    slack: Length = Field(0.0, ge=0)
    damping: Damping = Field(0.0, ge=0)
    transition_stiffness: Stiffness = Field(60e6, gt=0)
    transition_damping: Damping = Field(0.0, ge=0, description="damping between the branches")
    stop_stiffness: Stiffness = Field(200e6, gt=0, description="beyond the last deflection")

    @model_validator(mode="after")
    def _curves(self) -> TableGear:
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
        slopes = [
            (f1 - f0) / (d1 - d0) for (d0, f0), (d1, f1) in pairwise(zip(self.deflection, self.loading, strict=True))
        ]
        _check_transition(self.transition_stiffness, max(slopes))
        return self


DraftGear = Annotated[ClipGear | SmoothedGear | LinearGear | RigidGear | TableGear, Field(discriminator="kind")]
