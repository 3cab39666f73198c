"""Observer stage of the loop."""

from collections.abc import Callable

import numpy as np

from train_ato.control import component_fault as fault
from train_ato.control.observers.contract import ObserverStack
from train_ato.control.observers.none import NoObserver
from train_ato.control.registry import OBSERVERS
from train_ato.loop.inputs import StageInputs
from train_ato.loop.stage_messages import ObserverMessages
from train_ato.messages.delay_lines import MessageLink
from train_ato.messages.topics import Role
from train_ato.messages.types import Diagnostic, DisturbanceEstimate, Measurement
from train_ato.program.interrupt import ComponentCall
from train_ato.scenario.changes import GIVEN, Changes, changes_to_json
from train_ato.scenario.setup import RunSetup


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
    failure : ComponentFailed or None
        Failure of the observer.
    answer : DisturbanceEstimate or exception, optional
        Result of :meth:`step` in a compiled tick that is left to Python, used in place of a second one.
    """

    role = Role.OBSERVER

    def __init__(self, setup: RunSetup, given: Changes | None = None) -> None:
        self.setup = setup
        self._given = given or {}
        observer = setup.component(OBSERVERS, setup.scenario.observer, setup.observer_parameters, setup.tick)
        self.on_fault: Callable[[fault.ComponentFailed], None] | None = None
        self._limit = fault.step_limit(observer)
        self._none = np.zeros(setup.model.n_units) if type(observer) is NoObserver else None
        self.failure: fault.ComponentFailed | None = None
        self.answer: DisturbanceEstimate | BaseException | None = None
        self.stack = ObserverStack(setup.model, observer, setup.brake_policy())
        self._call = ComponentCall(f"observer '{setup.scenario.observer}'")
        self.inputs = StageInputs(setup, self.role)
        self._link = MessageLink(setup.scenario.links.measurement, setup.step_ns, setup.scenario.seed, "measurement")

    def step(self, stamp: int, measurement: Measurement) -> DisturbanceEstimate:
        """Return the estimate for a stamp [ns] and the newest valid measurement, from those that have arrived.

        After an exception, which leaves the observer in an unknown state, it is 0.
        """
        arrived, setup, cause, text = self._link.pass_on(stamp, measurement), self.setup, None, ""
        with self._call:
            if self.failure is None:
                try:
                    with self._limit:
                        estimate = self.stack.step(arrived)
                    text = fault.estimate_fault(
                        setup.scenario.observer, self.stack.observer, estimate.force, setup.model.n_units
                    )
                    if not text:
                        return DisturbanceEstimate(stamp, np.array(estimate.force, dtype=np.float64))
                except BaseException as error:  # a user-defined observer may raise any
                    fault.raise_if_interrupted(error)
                    cause, text = error, fault.fault_of_error("observer", setup.scenario.observer, error)
                self.failure = fault.ComponentFailed(text, self.role.value)
                self.failure.__cause__ = cause
                if self.on_fault is not None:
                    self.on_fault(self.failure)
        if self.on_fault is None:
            raise self.failure
        return DisturbanceEstimate(stamp, np.zeros(setup.model.n_units))

    def on_measurement(self, measurement: Measurement) -> ObserverMessages:
        """Return the estimate for the stamp of the measurement, with diagnostics once a second."""
        stamp, answer, self.answer = measurement.stamp, self.answer, None
        given = self.inputs.measurement(measurement)
        estimate: DisturbanceEstimate
        if self._none is not None:  # it needs neither brake policy nor shoe forces
            estimate = DisturbanceEstimate(stamp, self._none)
        else:
            estimate = self.step(stamp, given) if answer is None else fault.unless_raised(answer)
        return ObserverMessages(self.diagnostic(stamp) if self.inputs.report_due(stamp) else None, estimate)

    def diagnostic(self, stamp: int) -> Diagnostic:
        """Return the state of the observer at a stamp [ns]."""
        values = {"observer": self.setup.scenario.observer, **self.inputs.diagnostics()}
        if self._given:
            values[GIVEN] = changes_to_json(self._given)
            self._given = {}
        return Diagnostic(stamp, "observer", 0, "observing", values)
