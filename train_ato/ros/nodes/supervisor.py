"""Node ``supervisor``: releases traction and brakes as long as the train keeps its limits."""

from __future__ import annotations

from train_ato.loop.supervisor import SupervisorStage
from train_ato.loop.train_ahead import is_early
from train_ato.messages.topics import AHEAD
from train_ato.messages.types import Odometry, TrainAhead
from train_ato.ros.nodes.endpoints import NodeEndpoints


class SupervisorNode:
    """ROS node of the supervision; sends a brake release for every odometry message."""

    def __init__(self, stage: SupervisorStage, endpoints: NodeEndpoints) -> None:
        self.stage = stage
        self.endpoints = endpoints
        self.ignored = 0
        self._odometry: Odometry | None = None
        self._ahead: TrainAhead | None = None
        endpoints.subscribe({"train/odometry": self._on_odometry, AHEAD: self._on_ahead})

    def join(self, stamp: int) -> None:
        """Join a run that has reached a stamp [ns]."""
        self.stage.join()

    def _on_odometry(self, odometry: Odometry) -> None:
        if odometry.stamp <= self.endpoints.last_stamp:
            self.ignored += 1
            return
        self._step()  # without lockstep, the report of the step before may not have come
        self._odometry = odometry
        self._step_if_complete()

    def _on_ahead(self, ahead: TrainAhead) -> None:
        self._ahead = ahead
        self._step_if_complete()

    def _step_if_complete(self) -> None:
        """Take the step of an odometry with the report of the train ahead of this step, in a run with reports."""
        odometry, ahead = self._odometry, self._ahead
        if odometry is not None and not is_early(self.stage.setup, odometry.stamp, ahead):
            self._step()

    def _step(self) -> None:
        odometry, self._odometry = self._odometry, None
        if odometry is not None:
            self.endpoints.publish_all(self.stage.step(odometry, self._ahead).published())
