"""Preview: the feed-forward is that of the time the command will act; the state stays as measured.

The profile is known ahead, so what the train will need when the command arrives is known too. Free, and the greatest
part of what can be gained.

Through a delay tau and a first-order lag Ta, exactly::

    u_ff(t) = F(t + tau) + Ta F'(t + tau)

with F the force of the nominal train along the profile: the exact form of the inverse that paper 001 approximates by
Padé (per unit mass a_ff = v_d'(t + sigma) + tau v_d''(t + sigma) + w). A unit whose delay depends on the sign of the
command uses the delay of the sign its feed-forward has.

Needs: any law, any train; delay and lag of the model. Laws that bring their own equivalent control (`funnel`, `gpc`)
take nothing of it but the reference ahead.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from train_ato.compensate.contract import Situation, View
from train_ato.compensate.none import NoCompensation
from train_ato.control.contract import parameter
from train_ato.control.parts.shares import mean_over_units
from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.model import TrainModel


@dataclass(frozen=True)
class PreviewParameters:
    """Parameters of :class:`Preview`."""

    lag: bool = parameter(True, "", 0, 1, "lead through the actuators' lag as well as the delay")
    delay_factor: float = parameter(1.0, "1", 0.0, 10.0, "look ahead by so many times the model's delay")


class Preview(NoCompensation):
    """Feed-forward of the time the command will act, through delay and lag."""

    Parameters: ClassVar[type] = PreviewParameters

    def __init__(self, parameters: PreviewParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        factor = parameters.delay_factor
        self.forward = [factor * delay for delay in model.delay.tolist()]
        self.backward = [factor * delay for delay in model.delay_brake.tolist()]
        self.lag = model.lag if parameters.lag else 0.0

    def see(self, now: Situation) -> View:
        """Return the measured state with the feed-forward of the acting time."""
        self.shoes.tell(now.t, now.pressure)
        acting_time = now.t + self.mean_delay(now.under_way)
        _, speed, acceleration, jerk = self.rigid.profile.at(acting_time)
        feedforward = self.led(now.t, self.shoes.at(acting_time, speed).total)
        shoes = self.shoes.at(now.t, now.reference[1])
        return self.as_measured(now, acting_time, acceleration, jerk, feedforward, shoes)

    def led(self, t: float, shoes: float) -> Array:
        """Return the feed-forward of every unit for commands sent at ``t`` [N], with a shoe force when they act."""
        wanted: list[float] = []
        before: tuple[float, float] | None = None
        force = 0.0
        for share, forward, backward in zip(self._share, self.forward, self.backward, strict=True):
            if before != (forward, backward):
                before = (forward, backward)
                force = self.rigid.ahead(t + forward, self.lag) + shoes
                if force < 0.0 and backward != forward:
                    force = min(0.0, self.rigid.ahead(t + backward, self.lag) + shoes)
            wanted.append(force * share)
        return np.array(wanted)

    def mean_delay(self, under_way: Array) -> float:
        """Return the units' mean delay by the sign of the last command sent [s]."""
        if self.forward == self.backward or under_way.shape[0] == 0:
            delays = self.forward
        else:
            last = under_way[-1].tolist()
            delays = [b if u < 0 else f for f, b, u in zip(self.forward, self.backward, last, strict=True)]
        return mean_over_units(self._share, delays)
