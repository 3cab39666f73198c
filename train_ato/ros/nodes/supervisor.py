"""Node ``supervisor``: releases traction and brakes as long as the train keeps its limits."""

from __future__ import annotations

from train_ato.loop.supervisor import SupervisorStage
from train_ato.messages.types import Odometry
from train_ato.ros.nodes.endpoints import NodeEndpoints


class SupervisorNode:
    """ROS node of the supervision; sends a brake release for every odometry message."""

    def __init__(self, stage: SupervisorStage, endpoints: NodeEndpoints) -> None:
        self.stage = stage
        self.endpoints = endpoints
        self.ignored = 0
        endpoints.subscribe({"train/odometry": self._on_odometry})

    def join(self, stamp: int) -> None:
        """Join a run that has reached a stamp [ns]."""
        self.stage.join()

    def _on_odometry(self, odometry: Odometry) -> None:
        if odometry.stamp <= self.endpoints.last_stamp:
            self.ignored += 1
            return
        self.endpoints.publish_all(self.stage.step(odometry).published())
