"""Observer stage of the loop."""

from __future__ import annotations

from train_ato.control.observers.stack import ObserverStack
from train_ato.control.registry import OBSERVERS
from train_ato.interrupt import ComponentCall
from train_ato.loop.inputs import StageInputs
from train_ato.loop.setup import RunSetup
from train_ato.loop.stage_messages import ObserverMessages, diagnostics_due, stamped
from train_ato.messages.links import MessageLink
from train_ato.messages.topics import Role
from train_ato.messages.types import (
    Diagnostic,
    DisturbanceEstimate,
    Measurement,
)


class ObserverStage:
    """Disturbance observer of the scenario."""

    role = Role.OBSERVER

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        observer = OBSERVERS.make(setup.observer, setup.observer_parameters, setup.model, setup.tick)
        self._stack = ObserverStack(setup.model, observer, setup.brake_policy())
        self._call = ComponentCall(f"observer '{setup.observer}'")
        self._inputs = StageInputs(setup, self.role)
        self._link = MessageLink(setup.links.measurement, setup.step_ns, setup.seed, "measurement")

    def step(self, measurement: Measurement) -> DisturbanceEstimate:
        """Return the estimate for the stamp of the measurement, from the measurements that have arrived."""
        stamp = measurement.stamp
        arrived = self._link.pass_on(stamp, self._inputs.measurement(measurement))
        with self._call:
            estimate: DisturbanceEstimate = stamped(self._stack.step(arrived), stamp)
        return estimate

    def on_measurement(self, measurement: Measurement) -> ObserverMessages:
        """Return the estimate for the stamp of the measurement, with diagnostics once a second."""
        stamp = measurement.stamp
        estimate, report = self.step(measurement), None
        if self._inputs.take_changed() or diagnostics_due(stamp, self.setup.tick_ns):
            report = self.diagnostic(stamp)
        return ObserverMessages(estimate, report)

    def diagnostic(self, stamp: int) -> Diagnostic:
        """Return the state of the observer at a stamp [ns]."""
        values = {"observer": self.setup.observer, **self._inputs.diagnostics()}
        return Diagnostic(stamp, "observer", 0, "observing", values)
