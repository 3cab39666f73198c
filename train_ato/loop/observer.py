"""Observer stage of the loop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from train_ato.control.component_fault import (
    ComponentFailed,
    estimate_fault,
    fault_of_error,
    raise_if_interrupted,
    step_limit,
)
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
from train_ato.scenario.changes import GIVEN, Changes, changes_to_json


class ObserverStage:
    """Disturbance observer of the scenario.

    Parameters
    ----------
    setup
        Prepared run.
    given
        Start parameters in ``setup`` that the scenario does not have, for the first diagnostics.

    Attributes
    ----------
    on_fault : callable or None
        Receives the failure of the observer, whose estimate is then 0; None: the failure is raised.
    """

    role = Role.OBSERVER

    def __init__(self, setup: RunSetup, given: Changes | None = None) -> None:
        self.setup = setup
        self._given = given or {}
        observer = setup.component(OBSERVERS, setup.observer, setup.observer_parameters, setup.tick)
        self.on_fault: Callable[[ComponentFailed], None] | None = None
        self._observer = observer
        self._failure: ComponentFailed | None = None
        self._stack = ObserverStack(setup.model, observer, setup.brake_policy())
        self._call = ComponentCall(f"observer '{setup.observer}'")
        self._inputs = StageInputs(setup, self.role)
        self._link = MessageLink(setup.links.measurement, setup.step_ns, setup.seed, "measurement")

    def step(self, measurement: Measurement) -> DisturbanceEstimate:
        """Return the estimate for the stamp of the measurement, from the measurements that have arrived."""
        stamp = measurement.stamp
        arrived = self._link.pass_on(stamp, self._inputs.measurement(measurement))
        with self._call:
            return self._estimate(arrived, stamp)

    def _estimate(self, measurement: Measurement, stamp: int) -> DisturbanceEstimate:
        """Return the estimate; after an exception, which leaves the observer in an unknown state, it is 0."""
        setup, cause, text = self.setup, None, ""
        if self._failure is None:
            try:
                with step_limit(self._observer):
                    estimate: DisturbanceEstimate = stamped(self._stack.step(measurement), stamp)
                text = estimate_fault(setup.observer, self._observer, estimate.force, setup.model.n_units)
                if not text:
                    return estimate
            except BaseException as error:  # a user-defined observer may raise any
                raise_if_interrupted(error)
                cause, text = error, fault_of_error("observer", setup.observer, error)
            self._failure = ComponentFailed(text, self.role.value)
            self._failure.__cause__ = cause
            if self.on_fault is not None:
                self.on_fault(self._failure)
        if self.on_fault is None:
            raise self._failure
        return DisturbanceEstimate(stamp, np.zeros(setup.model.n_units))

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
        if self._given:
            values[GIVEN] = changes_to_json(self._given)
            self._given = {}
        return Diagnostic(stamp, "observer", 0, "observing", values)
