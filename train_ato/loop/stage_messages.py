"""Messages of the stages of the loop, by name and in the order of publication."""

from dataclasses import field, fields, replace
from functools import cache
from typing import Any

import numpy as np

from plant_sim.states import frozen_message
from train_ato.messages import types as msg
from train_ato.messages.topics import AHEAD, REPORT

SECOND_NS = 1_000_000_000
"""Period of the diagnostics [ns]: every node sends them at the first stamp of a simulated second."""

Published = list[tuple[str, Any]]
"""Topic names and messages in the order of publication."""


def on(topic: str) -> dict[str, str]:
    """Return the metadata of a field of :class:`StageMessages` with the topic of its message."""
    return {"topic": topic}


@cache
def _topics(kind: Any) -> list[tuple[str, str]]:
    return [(entry.name, entry.metadata["topic"]) for entry in fields(kind)]


class StageMessages:
    """Messages of a stage in the order of publication; None for those that a step does not send."""

    __slots__ = ()

    def published(self) -> Published:
        """Return the messages in the order of publication."""
        kind: Any = type(self)
        return [(topic, sent) for name, topic in _topics(kind) if (sent := getattr(self, name)) is not None]


@frozen_message
class PlantTruth(StageMessages):
    """True state of the train at a stamp."""

    clock: msg.Tick = field(metadata=on("/clock"))
    vehicles: msg.VehicleStates = field(metadata=on("train/vehicles"))
    brake_pipe: msg.Pipe | None = field(metadata=on("train/brake_pipe"))
    brake_pipe_tail: msg.Pipe | None = field(metadata=on("train/brake_pipe_tail"))
    brake_shoes: msg.BrakeShoes | None = field(metadata=on("train/brake_shoes"))
    disturbance: msg.Disturbance | None = field(metadata=on("train/disturbance"))
    diagnostics: msg.Diagnostic | None = field(metadata=on("/diagnostics"))


@frozen_message
class PlantMessages(PlantTruth):
    """Truth and measurement of a stamp, at a step of the supervisor with its inputs.

    The measurement is last, because it starts the step.
    """

    report: msg.TrainAhead | None = field(metadata=on(REPORT))
    ahead: msg.TrainAhead | None = field(metadata=on(AHEAD))
    odometry: msg.Odometry | None = field(metadata=on("train/odometry"))
    protection: msg.ProtectionState | None = field(metadata=on("train/protection"))
    measurement: msg.Measurement = field(metadata=on("train/measurement"))


@frozen_message
class SupervisorMessages(StageMessages):
    """Decision of the supervisor; the release is last, because it ends the step."""

    speeds: msg.SupervisedSpeeds = field(metadata=on("atp/speeds"))
    diagnostics: msg.Diagnostic | None = field(metadata=on("/diagnostics"))
    release: msg.BrakeRelease = field(metadata=on("atp/brake_release"))


@frozen_message
class ProfileStart(StageMessages):
    """Profile and speed limits at the start of a run, latched."""

    profile: msg.Trajectory = field(metadata=on("ato/profile"))
    limits: msg.Trajectory = field(metadata=on("ato/limits"))


@frozen_message
class ProfileMessages(StageMessages):
    """Reference of a stamp, after the new profile of a re-planning."""

    diagnostics: msg.Diagnostic | None = field(metadata=on("/diagnostics"))
    profile: msg.Trajectory | None = field(metadata=on("ato/profile"))
    reference: msg.Reference = field(metadata=on("ato/reference"))


@frozen_message
class ObserverMessages(StageMessages):
    """Disturbance estimate of a stamp."""

    diagnostics: msg.Diagnostic | None = field(metadata=on("/diagnostics"))
    estimate: msg.DisturbanceEstimate = field(metadata=on("ato/estimate"))


@frozen_message
class ControllerMessages(StageMessages):
    """Command of a stamp, after the brake-pipe pressure of a train with an air brake and the state of the ATO.

    The command is last, because it ends the step.
    """

    brake_pipe_command: msg.Pipe | None = field(metadata=on("ato/brake_pipe_command"))
    state: msg.AtoReport | None = field(metadata=on("ato/state"))
    diagnostics: msg.Diagnostic | None = field(metadata=on("/diagnostics"))
    command: msg.Command = field(metadata=on("ato/command"))


def without_values(measurement: msg.Measurement) -> msg.Measurement:
    """Return a measurement with NaN as values, in place of one that did not arrive."""
    names = [entry.name for entry in fields(measurement) if entry.name != "stamp"]
    return replace(measurement, **{name: np.full_like(getattr(measurement, name), np.nan) for name in names})
