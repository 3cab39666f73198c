"""Template of a law: copy this file, rename the class, change ``demand``.

The law adds two gains on the remaining error to the feed-forward of the nominal model. Test it with::

    train-ato check-law my_law:MyLaw
    train-ato run demo --law my_law:MyLaw --set laws.my_law:MyLaw.gain=0.04

or in Python, without registration::

    train_ato.run("demo", law=MyLaw(gain=0.04))

A short name needs a registration in the package that holds the law (``pyproject.toml``) and ``pip install -e .``::

    [project.entry-points."train_ato.controllers"]
    my_law = "my_law:MyLaw"

In the node graph the law is the ROS parameter ``law``, and its parameters are ``my_law.gain``, ...
"""

from dataclasses import dataclass
from typing import Any

from train_ato.control.contract import LawInput, parameter
from train_ato.control.guard import GuardedLaw


@dataclass
class MyLaw(GuardedLaw):
    """Feed-forward and two gains (template). Each parameter: default, unit, lowest and highest value, description."""

    gain: float = parameter(0.05, "1/s", 0.0, 10.0, "gain on the speed error, times the inertia of the train")
    stiffness: float = parameter(0.00125, "1/s²", 0.0, 10.0, "gain on the position error")

    def bind(self, model: Any, period: float) -> None:
        """Take the train and the control period [s]; raise ValueError for a train that the law cannot drive."""
        super().bind(model, period)
        self.mass = model.inertia * model.share

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force demand of every unit [N]; GuardedLaw checks the inputs and limits the output."""
        speed_error = inputs.velocity - inputs.reference_velocity
        position_error = inputs.position - inputs.reference_position
        pull = self.gain * speed_error + self.stiffness * position_error
        wanted: list[float] = (inputs.feedforward - inputs.disturbance - self.mass * pull).tolist()
        return wanted
