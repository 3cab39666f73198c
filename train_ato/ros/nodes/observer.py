"""Node ``observer``: sends the disturbance estimate for every measurement."""

from __future__ import annotations

from dataclasses import replace

from train_ato.control.contract import Parameter
from train_ato.control.registry import OBSERVERS
from train_ato.loop.observer import ObserverStage
from train_ato.loop.setup import RunSetup
from train_ato.messages.types import Measurement
from train_ato.ros.nodes.endpoints import NodeEndpoints
from train_ato.ros.nodes.parameters import Declared, block_parameters, declare
from train_ato.scenario.changes import Changes, RunChanges


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
        self.endpoints.publish_all(self.stage.on_measurement(measurement).published())
