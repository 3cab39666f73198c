"""A law to start from: copy this file, rename the class, change ``demand``.

It drives the train with the feed-forward of the nominal model and two gains on what is left of the error. Try it with::

    train-ato check-law my_law:MyLaw

and, to run it by name, register it in the package that holds it (``pyproject.toml``)::

    [project.entry-points."train_ato.controllers"]
    my_law = "my_law:MyLaw"

After ``pip install -e .`` of that package ``train-ato run demo --controller my_law --set controllers.my_law.gain=0.2``
uses it; in the running graph it is the ROS parameter ``controller`` and its parameters are ``my_law.gain``, ...
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from train_ato.control.contract import LawInput, parameter
from train_ato.control.parts.guard import GuardedLaw


@dataclass(frozen=True)
class MyLawParameters:
    """Every field: default, unit, lowest and highest value, one line of meaning."""

    gain: float = parameter(0.1, "1/s", 0.0, 10.0, "gain on the speed error, times the train's inertia")
    stiffness: float = parameter(0.005, "1/s²", 0.0, 10.0, "gain on the position error")


class MyLaw(GuardedLaw):
    """Feed-forward and two gains: a template."""

    Parameters: ClassVar[type] = MyLawParameters

    def __init__(self, parameters: MyLawParameters, model: Any, period: float) -> None:
        super().__init__(parameters, model, period)
        self.mass = model.inertia * model.share

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force wanted of every unit [N]; GuardedLaw checks the inputs and cuts to the limits."""
        speed_error = inputs.velocity - inputs.reference_velocity
        position_error = inputs.position - inputs.reference_position
        pull = self.parameters.gain * speed_error + self.parameters.stiffness * position_error
        wanted: list[float] = (inputs.feedforward - inputs.disturbance - self.mass * pull).tolist()
        return wanted
