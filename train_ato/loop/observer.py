"""The disturbance observer chosen by the scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING

from train_ato.links import MessageLink
from train_ato.observe.registry import OBSERVERS
from train_ato.observe.stack import ObserverStack
from train_ato.roles.outgoing import Outgoing, due, stamped
from train_ato.run_setup import RunSetup
from train_ato.topics import Role
from train_ato.types import (
    Diagnostic,
    DisturbanceEstimate,
    Measurement,
)

if TYPE_CHECKING:
    pass


class ObserverRole:
    """The disturbance observer chosen by the scenario."""

    role = Role.OBSERVER

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        observer = OBSERVERS.make(setup.observer, setup.observer_parameters, setup.model, setup.tick)
        self._stack = ObserverStack(setup.model, observer, setup.brake_policy())
        self._link = MessageLink(setup.links.measurement, setup.step_ns, setup.seed, "measurement")

    def step(self, measurement: Measurement) -> DisturbanceEstimate:
        """Return the estimate for the measurement's stamp, from what has arrived by then."""
        stamp = measurement.stamp
        estimate: DisturbanceEstimate = stamped(self._stack.step(self._link.pass_on(stamp, measurement)), stamp)
        return estimate

    def answer(self, measurement: Measurement) -> Outgoing:
        """Return what to send for a measurement; ``ato/estimate`` comes last."""
        messages: Outgoing = []
        stamp = measurement.stamp
        if due(stamp, self.setup.tick_ns):
            messages.append(
                ("/diagnostics", Diagnostic(stamp, "observer", 0, "observing", {"observer": self.setup.observer}))
            )
        messages.append(("ato/estimate", self.step(measurement)))
        return messages
