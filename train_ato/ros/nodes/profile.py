"""Node ``profile``: sends the latched speed profile at the start and after re-planning, and a reference per tick."""

from __future__ import annotations

from train_ato.loop.profile import ProfileStage
from train_ato.loop.stamp_synchronizer import AwaitedReport, ProfileInputs
from train_ato.messages.topics import AHEAD
from train_ato.ros.nodes.endpoints import NodeEndpoints


class ProfileNode:
    """ROS node of the profile; sends the reference for every measurement."""

    def __init__(self, stage: ProfileStage, endpoints: NodeEndpoints) -> None:
        self.stage = stage
        self.endpoints = endpoints
        self._inputs = AwaitedReport(stage.setup, lambda: endpoints.left_out("ato/state"))
        self._joins = False
        endpoints.awaited = lambda: "ato/state" if self._inputs.waits else ""
        endpoints.subscribe(
            {
                "train/measurement": lambda message: self._answer(self._inputs.put(message)),
                "ato/state": lambda message: self._answer(self._inputs.report(message)),
                AHEAD: lambda message: self._answer(self._inputs.ahead(message)),
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
        self.endpoints.publish_all([("ato/limits", start.limits)] if self._joins else start.published())

    def _answer(self, ready: list[ProfileInputs]) -> None:
        for inputs in ready:
            self.endpoints.publish_all(self.stage.on_measurement(*inputs).published())
