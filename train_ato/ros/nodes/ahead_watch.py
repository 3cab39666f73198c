"""Live reports of the train ahead at the plant: their subscription, and the wait for them in lockstep."""

import time
from collections.abc import Callable

import numpy as np

from train_ato.loop.plant import PlantStage
from train_ato.messages.topics import REPORT
from train_ato.messages.types import TrainAhead
from train_ato.ros.nodes.endpoints import NodeEndpoints

LOOK_S = 0.2
"""Period of the checks of a wait for a report [s]."""


class AheadWatch:
    """Reports of the train ahead, and the wait for the report of a step.

    In lockstep a step of the supervisor waits for a report of its stamp, so that the run does not depend on the speeds
    of both programs.  It does not wait after the last report, nor for a train whose reports have been missing for the
    time-out; their age and the rules of the end of authority then protect the train.

    Parameters
    ----------
    stage, endpoints
        Plant of the train behind with its radio.
    resume
        Called after a report.
    """

    def __init__(self, stage: PlantStage, endpoints: NodeEndpoints, resume: Callable[[], None]) -> None:
        leader, radio = stage.setup.scenario.leader, stage.radio
        assert leader is not None
        assert radio is not None
        self._stage, self._radio, self._endpoints = stage, radio, endpoints
        self._topic, self._resume = f"{leader.train}/{REPORT}", resume
        self._ended = self._missing = False
        self._last_moment: float | None = None
        endpoints.subscribe({REPORT: self._on_report}, at=self._topic)

    def lacking(self) -> list[str]:
        """Return the first report as a missing condition for the start."""
        return [] if self._radio.latest >= 0 or self._ended else [f"a report on {self._topic}"]

    def _on_report(self, report: TrainAhead) -> None:
        if np.isnan(report.time[0]):
            self._ended = True
        else:
            self._radio.put(report)
        self._missing, self._last_moment = False, None
        self._resume()

    def is_due(self, stamp: int, limit: float) -> bool:
        """Return True if the step of a stamp [ns] waits for its report, at most for a wall time [s]."""
        known = self._ended or self._missing or self._radio.latest >= stamp
        if known or not self._stage.setup.supervised_at(stamp):
            return False
        if self._last_moment is None:
            self._last_moment = time.monotonic() + limit
        if time.monotonic() < self._last_moment:
            return True
        self._missing = True
        self._endpoints.note(f"node plant: no report on {self._topic} for {limit:g} s; the run goes on without")
        return False
