"""Node ``profile``: sends the latched speed profile at the start and after re-planning, and a reference per tick."""

from __future__ import annotations

from train_ato.loop.profile import ProfileStage
from train_ato.messages.types import Measurement
from train_ato.ros.nodes.endpoints import NodeEndpoints


class ProfileNode:
    """ROS node of the profile; sends the reference for every measurement."""

    def __init__(self, stage: ProfileStage, endpoints: NodeEndpoints) -> None:
        self.stage = stage
        self.endpoints = endpoints
        self.ignored = 0
        endpoints.subscribe({"train/measurement": self._on_measurement})

    def begin(self) -> None:
        """Send the profile and the limits, latched for nodes that start later."""
        self.endpoints.publish_all(self.stage.start().published())

    def _on_measurement(self, measurement: Measurement) -> None:
        if measurement.stamp <= self.endpoints.last_stamp:
            self.ignored += 1
            return
        self.endpoints.publish_all(self.stage.on_measurement(measurement).published())
