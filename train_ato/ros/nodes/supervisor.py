"""Node ``supervisor``: releases traction and brakes as long as the train keeps its limits."""

from __future__ import annotations

from train_ato.loop.awaited_report import AwaitedReport
from train_ato.loop.supervisor import SupervisorStage
from train_ato.messages.types import AtoReport, Odometry
from train_ato.ros.nodes.endpoints import NodeEndpoints


class SupervisorNode:
    """ROS node of the supervision; sends a brake release for every odometry message."""

    def __init__(self, stage: SupervisorStage, endpoints: NodeEndpoints) -> None:
        self.stage = stage
        self.endpoints = endpoints
        self._inputs: AwaitedReport[Odometry] = AwaitedReport(stage.setup)
        endpoints.subscribe(
            {
                "train/odometry": lambda message: self._answer(self._inputs.put(message)),
                "ato/state": lambda message: self._answer(self._inputs.report(message)),
            }
        )

    @property
    def ignored(self) -> int:
        """Number of duplicate and late messages."""
        return self._inputs.ignored

    def _answer(self, ready: list[tuple[Odometry, AtoReport | None]]) -> None:
        for odometry, report in ready:
            self.endpoints.publish_all(self.stage.step(odometry, report).published())
