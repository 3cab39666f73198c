"""Template of a delay compensation: copy this file, rename the class, change ``step``.

The law receives the feed-forward for the time at which its command takes effect. Test it with::

    train-ato check-compensation my_compensation:MyCompensation
    train-ato run demo --compensation my_compensation:MyCompensation \
        --set compensations.my_compensation:MyCompensation.ratio=0.5

or in Python, without registration::

    train_ato.run("demo", compensation=MyCompensation(ratio=0.5))

A short name needs a registration by the entry-point group ``train_ato.compensations`` (``pyproject.toml``).
"""

from dataclasses import dataclass
from typing import Any

from train_ato.control.compensation.base import CompensationBase
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.contract import LawInput, parameter


@dataclass
class MyCompensation(CompensationBase):
    """Feed-forward ahead (template). Each parameter: default, unit, lowest and highest value, description."""

    ratio: float = parameter(1.0, "1", 0.0, 1.0, "part of the mean delay and lag of the model that is compensated")

    def bind(self, model: Any, period: float) -> None:
        """Take the train and the control period [s]; raise ValueError for a train without a usable model."""
        super().bind(model, period)
        self.delay = self.ratio * float(model.delay.mean())
        self.lag = self.ratio * model.lag

    def step(self, inputs: CompensationInput) -> LawInput:
        """Return the measured state with the feed-forward of the time of effect."""
        self.shoes.demand(inputs.t, inputs.pressure)
        effect = inputs.t + self.delay
        force = self.rigid.ahead(effect, self.lag) + self.shoes.at(effect, self.rigid.profile.at(effect)[1]).total
        shoes = self.shoes.at(inputs.t, inputs.reference.velocity)
        return self.law_input(inputs, effect, self.shared(force), shoes)
