"""Nodes ``profile``, ``supervisor`` and ``observer``: each receives messages and sends those of its stage.

The profile sends its latched speed profile at the start and after re-planning, and a reference per tick. The supervisor
releases traction and brakes as long as the train keeps its limits. The observer sends the disturbance estimate.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from train_ato.control.contract import Parameter
from train_ato.control.registry import OBSERVERS
from train_ato.loop.observer import ObserverStage
from train_ato.loop.profile import ProfileStage
from train_ato.loop.stamp_synchronizer import AwaitedReport, ProfileInputs
from train_ato.loop.supervisor import SupervisorStage
from train_ato.messages.topics import AHEAD
from train_ato.messages.types import Measurement, Odometry, TrainAhead
from train_ato.ros.nodes.endpoints import NodeEndpoints
from train_ato.ros.nodes.parameters import Declared, block_parameters, declare
from train_ato.scenario.changes import Changes, RunChanges
from train_ato.scenario.setup import RunSetup


class ProfileNode:
    """ROS node of the profile; sends the reference for every measurement."""

    def __init__(self, stage: ProfileStage, endpoints: NodeEndpoints) -> None:
        self.stage = stage
        self.endpoints = endpoints
        self._inputs = AwaitedReport(stage.setup, lambda: endpoints.left_out("ato/state"))
        self._joins = False
        endpoints.counter = self._inputs
        endpoints.awaited = lambda: "ato/state" if self._inputs.waits else ""
        endpoints.subscribe(
            {
                "train/measurement": partial(self._answer, self._inputs.put),
                "ato/state": partial(self._answer, self._inputs.report),
                AHEAD: partial(self._answer, self._inputs.ahead),
            },
            stage.setup.tick_ns,
        )

    @property
    def ignored(self) -> int:
        """Number of duplicate and late messages."""
        return self._inputs.ignored

    def join(self, stamp: int) -> None:
        """Join a run that has reached a stamp [ns]: the profile is sent with the first reference."""
        self.stage.join()
        self._joins = True

    def begin(self) -> None:
        """Send the profile and the limits, latched for nodes that start later."""
        start = self.stage.start()
        self.endpoints.publish(*[("ato/limits", start.limits)] if self._joins else start.published())

    def _answer(self, add: Callable[[Any], list[ProfileInputs]], message: Any) -> None:
        for inputs in add(message):
            self.endpoints.publish(*self.stage.on_measurement(*inputs).published())


class SupervisorNode:
    """ROS node of the supervision; sends a brake release for every odometry message."""

    def __init__(self, stage: SupervisorStage, endpoints: NodeEndpoints) -> None:
        self.stage = stage
        self.endpoints = endpoints
        self.ignored = 0
        endpoints.counter = self
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
    """ROS node of the observer of the scenario, or of the start parameter ``observer``.

    Raises
    ------
    ValueError
        If a start parameter is unknown, out of range or refused by the observer.
    """

    def __init__(self, setup: RunSetup, endpoints: NodeEndpoints) -> None:
        self.endpoints = endpoints
        self.ignored = 0
        endpoints.counter = self
        changed = self._declared(setup)
        scenario = RunChanges(given={self.endpoints.name: changed}).begun(setup.scenario)
        self.stage = ObserverStage(replace(setup, scenario=scenario), changed)
        endpoints.subscribe({"train/measurement": self._on_measurement}, setup.tick_ns)

    def join(self, stamp: int) -> None:
        """Join a run that has reached a stamp [ns]: the estimate begins again at the next measurement."""

    def _declared(self, setup: RunSetup) -> Changes:
        """Declare the observer and its parameters; return the start parameters that differ from the scenario."""
        given = setup.scenario.observers
        names = tuple(dict.fromkeys((*OBSERVERS.loadable(), setup.observer, *given)))
        chosen = Parameter("observer", setup.observer, "", 0.0, 0.0, "disturbance observer", names)
        parameters = [Declared("observer", setup.observer, chosen, read_only=True)]
        for name in names:
            parameters += block_parameters(name, OBSERVERS.parameters(name), given.get(name, {}), read_only=True)
        values = declare(self.endpoints.node, parameters)
        return {p.name: values[p.name] for p in parameters if values[p.name] != p.value}

    def _on_measurement(self, measurement: Measurement) -> None:
        if measurement.stamp <= self.endpoints.last_stamp:
            self.ignored += 1
            return
        self.endpoints.publish(*self.stage.on_measurement(measurement).published())
