"""Nodes ``profile``, ``supervisor`` and ``observer``: each receives messages and sends those of its stage.

The profile sends its latched speed profile at the start and after re-planning, and a reference per tick. The supervisor
releases traction and brakes as long as the train keeps its limits. The observer sends the disturbance estimate.
"""

import sys
from dataclasses import replace

from train_ato.control.contract import Parameter
from train_ato.control.registry import OBSERVERS
from train_ato.loop.observer import ObserverStage
from train_ato.loop.profile import ProfileStage
from train_ato.loop.supervisor import SupervisorStage
from train_ato.messages.topics import AHEAD
from train_ato.messages.types import AtoReport, Measurement, Odometry, TrainAhead
from train_ato.ros.nodes.endpoints import NodeEndpoints
from train_ato.ros.nodes.parameters import Declared, block_parameters, declare
from train_ato.scenario.changes import Changes, RunChanges
from train_ato.scenario.setup import RunSetup


class ProfileNode:
    """ROS node of the profile; sends the reference for every measurement.

    A measurement waits for the report of the ATO of the period before, and for that of the train ahead. If the next
    measurement comes first, the newest reports are used: without lockstep the plant does not wait.

    Attributes
    ----------
    ignored : int
        Number of duplicate and late messages.
    """

    def __init__(self, stage: ProfileStage, endpoints: NodeEndpoints) -> None:
        self.stage = stage
        self.endpoints = endpoints
        self.ignored = 0
        self._joins = False
        self._held: Measurement | None = None
        self._report: AtoReport | None = None
        self._ahead: TrainAhead | None = None
        self._heard = -1 if stage.setup.layout.behind else sys.maxsize
        self._last = -1
        self._period_ns = stage.setup.supervision_ticks * stage.setup.tick_ns
        endpoints.ignored = lambda: self.ignored
        endpoints.awaited = lambda: "" if self._held is None else "ato/state"
        endpoints.subscribe({"train/measurement": self._on_measurement}, stage.setup.tick_ns)
        endpoints.subscribe({"ato/state": self._on_report, AHEAD: self._on_ahead})

    def join(self, stamp: int) -> None:
        """Join a run that has reached a stamp [ns]: the profile is sent with the first reference."""
        self.stage.join()
        self._joins = True

    def begin(self) -> None:
        """Send the profile and the limits, latched for nodes that start later."""
        start = self.stage.start()
        self.endpoints.publish(*[("ato/limits", start.limits)] if self._joins else start.published())

    def _on_measurement(self, measurement: Measurement) -> None:
        if measurement.stamp <= self._last:
            self.ignored += 1
            return
        self._last = measurement.stamp
        if self._held is not None:
            self.endpoints.publish(*self.stage.on_measurement(self._held, self._report, self._ahead).published())
        self._held = measurement
        self._answer()

    def _on_report(self, report: AtoReport) -> None:
        if self._report is not None and report.stamp <= self._report.stamp:
            self.ignored += 1
            return
        self._report = report
        self._answer()

    def _on_ahead(self, ahead: TrainAhead) -> None:
        self._ahead, self._heard = ahead, ahead.stamp
        self._answer()

    def _answer(self) -> None:
        """Send the reference for the held measurement if the reports of its step have arrived."""
        held, report = self._held, self._report
        if held is None:
            return
        supervised = self.stage.setup.supervised_at(held.stamp)
        due = supervised and held.stamp > 0
        late = due and (report is None or report.stamp < held.stamp - self._period_ns)
        if (supervised and self._heard < held.stamp) or (late and not self.endpoints.left_out("ato/state")):
            return
        self._held = None
        self.endpoints.publish(*self.stage.on_measurement(held, report if due else None, self._ahead).published())


class SupervisorNode:
    """ROS node of the supervision; sends a brake release for every odometry message."""

    def __init__(self, stage: SupervisorStage, endpoints: NodeEndpoints) -> None:
        self.stage = stage
        self.endpoints = endpoints
        self.ignored = 0
        endpoints.ignored = lambda: self.ignored
        self._odometry: Odometry | None = None
        self._ahead: TrainAhead | None = None
        self._heard = -1 if stage.setup.layout.behind else sys.maxsize
        endpoints.subscribe({"train/odometry": self._on_odometry, AHEAD: self._on_ahead})

    def join(self, stamp: int) -> None:
        """Join a run that has reached a stamp [ns]."""
        self.stage.join()

    def _on_odometry(self, odometry: Odometry) -> None:
        if odometry.stamp <= self.endpoints.last_stamp:
            self.ignored += 1
            return
        if self._odometry is not None:
            self._step(waits=False)  # without lockstep, the report of the step before may not have come
        self._odometry = odometry
        self._step()

    def _on_ahead(self, ahead: TrainAhead) -> None:
        self._ahead, self._heard = ahead, ahead.stamp
        self._step()

    def _step(self, *, waits: bool = True) -> None:
        """Take the step of an odometry; it waits for the report of the train ahead of this step, in a run with any."""
        odometry = self._odometry
        if odometry is not None and not (waits and self._heard < odometry.stamp):
            self._odometry = None
            self.endpoints.publish(*self.stage.step(odometry, self._ahead).published())


class ObserverNode:
    """ROS node of the observer of the scenario, or of the start parameter ``observer``."""

    def __init__(self, setup: RunSetup, endpoints: NodeEndpoints) -> None:
        self.endpoints = endpoints
        self.ignored = 0
        endpoints.ignored = lambda: self.ignored
        changed = self._declared(setup)
        scenario = RunChanges(given={self.endpoints.name: changed}).begun(setup.scenario)
        self.stage = ObserverStage(replace(setup, scenario=scenario), changed)
        endpoints.subscribe({"train/measurement": self._on_measurement}, setup.tick_ns)

    def join(self, stamp: int) -> None:
        """Join a run that has reached a stamp [ns]: the estimate begins again at the next measurement."""

    def _declared(self, setup: RunSetup) -> Changes:
        """Declare the observer and its parameters; return the start parameters that differ from the scenario."""
        given = setup.scenario.observers
        names = tuple(dict.fromkeys((*OBSERVERS.loadable(), setup.scenario.observer, *given)))
        chosen = Parameter("observer", setup.scenario.observer, "", 0.0, 0.0, "disturbance observer", names)
        parameters = [Declared("observer", setup.scenario.observer, chosen, read_only=True)]
        for name in names:
            parameters += block_parameters(name, OBSERVERS.parameters(name), given.get(name, {}), read_only=True)
        values = declare(self.endpoints.node, parameters)
        return {p.name: values[p.name] for p in parameters if values[p.name] != p.value}

    def _on_measurement(self, measurement: Measurement) -> None:
        if measurement.stamp <= self.endpoints.last_stamp:
            self.ignored += 1
            return
        self.endpoints.publish(*self.stage.on_measurement(measurement).published())
