"""Preview: feed-forward of the time at which the command takes effect; the state stays as measured.

The profile ahead gives the force that the train will need when the command arrives. This costs almost no computation.
On the metro train it removes most of the speed error. On the heavy-haul train with `pid` it does not reduce the error,
because F is the force of a rigid train, without the waves in the couplers. `twin` includes them.

Through a delay tau and a first-order lag Ta, exactly::

    u_ff(t) = F(t + tau) + Ta F'(t + tau)

F is the force of the nominal train along the profile. This is the exact form of the inverse that paper 001 approximates
by Padé (per unit mass a_ff = v_d'(t + sigma) + tau v_d''(t + sigma) + w). The delay of a unit can depend on the sign of
the command. The sign of its feed-forward then selects the delay.

Needs: any law, any train; delay and lag of the model. Laws with an equivalent control of their own (`funnel`, `gpc`)
use only the reference ahead.
"""

from dataclasses import dataclass
from typing import ClassVar

from plant_sim.compiled import compiled
from plant_sim.record import Records
from train_ato.control.compensation.base import CompensationBase
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.contract import LawInput, flag, parameter
from train_ato.control.train_model import Actuator, TrainModel
from train_ato.messages.types import Array


@dataclass(frozen=True)
class PreviewParameters:
    """Parameters of :class:`PreviewFeedforward`."""

    lag: bool = flag("compensate the lag of the actuators as well as the delay", default=True)
    delay_factor: float = parameter(1.0, "1", 0.0, 10.0, "factor on the delay of the model")


@compiled
def mean_delay(actuators: Records[Actuator], sent: Array) -> float:
    """Return the mean delay of the units [s], by the signs of the last command sent, shape (d, units)."""
    delay: float = 0.0
    for u in range(actuators.size):
        braking = len(sent) > 0 and sent[len(sent) - 1, u] < 0.0
        delay += actuators[u].share * (actuators[u].backward if braking else actuators[u].forward)
    return delay


class PreviewFeedforward(CompensationBase):
    """Feed-forward of the time at which the command takes effect, through delay and lag."""

    Parameters: ClassVar[type] = PreviewParameters

    def __init__(self, parameters: PreviewParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        factor = parameters.delay_factor
        self.actuators["forward"], self.actuators["backward"] = factor * model.delay, factor * model.delay_brake
        self.lag = model.lag if parameters.lag else 0.0
        self._along["lag"] = self.lag

    def step(self, inputs: CompensationInput) -> LawInput:
        """Return the measured state with the feed-forward of the time of effect."""
        t = inputs.t
        self.shoes.demand(t, inputs.pressure)
        effect = t + mean_delay(self.actuators, inputs.commands_in_flight)
        feedforward = self.feedforward(t, self.shoes_along(effect).total)
        return self.law_input(inputs, effect, feedforward, self.shoes.at(t, inputs.reference.velocity))
