"""No compensation: the law sees the state as measured, the reference and the feed-forward of now.

A command acts late and nothing is done about it: right for trains that answer at once, and for laws that bring their
own means (`funnel`, `gpc`).

Needs: nothing; any law, any train.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from train_ato.brake.shoes import ShoeForecast, Shoes
from train_ato.compensate.contract import Situation, View
from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.compensate.rigid import RigidForce
    from train_ato.model import TrainModel


@dataclass(frozen=True)
class NoParameters:
    """No parameters."""


class NoCompensation:
    """No compensation: everything as it is now."""

    Parameters: ClassVar[type] = NoParameters

    def __init__(self, parameters: Any, model: TrainModel, period: float) -> None:
        self.parameters = parameters
        self.model = model
        self.period = period
        self._offsets = model.offsets
        self._share = model.share.tolist()
        self._one = np.ones(model.n_units)
        self._rigid: RigidForce | None = None
        self.shoes = ShoeForecast(model)

    @property
    def rigid(self) -> RigidForce:
        """Forces along the profile."""
        assert self._rigid is not None, "set_profile comes before the first step"
        return self._rigid

    def set_profile(self, rigid: RigidForce) -> None:
        """Take a new profile."""
        self._rigid = rigid

    def reset(self) -> None:
        """Forget the brake events."""
        self.shoes = ShoeForecast(self.model)

    def see(self, now: Situation) -> View:
        """Return state, reference and feed-forward of now."""
        _, _, acceleration, jerk = self.rigid.profile.at(now.t)
        self.shoes.tell(now.t, now.pressure)
        shoes = self.shoes.at(now.t, now.reference[1])
        force = self.rigid.total(now.t) + shoes.total
        return self.as_measured(now, now.t, acceleration, jerk, self.shared(force), shoes)

    def shared(self, force: float) -> Array:
        """Return a total force split over the units [N]."""
        return np.array([force * share for share in self._share])

    def as_measured(
        self, now: Situation, acting_time: float, acceleration: float, jerk: float, feedforward: Array, shoes: Shoes
    ) -> View:
        """Return a view of the measured state with the reference of now."""
        place, speed, pull = now.reference
        return View(
            position=now.position,
            velocity=now.velocity,
            applied=now.applied,
            reference_position=place - self._offsets,
            reference_velocity=speed * self._one,
            reference_acceleration=pull * self._one,
            acting_time=acting_time,
            lead=acting_time - now.t,
            acting_acceleration=acceleration,
            acting_jerk=jerk,
            feedforward=feedforward,
            shoe_force=shoes.own,
            train_shoe_force=shoes.total,
        )
