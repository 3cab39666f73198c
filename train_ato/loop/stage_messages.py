"""Messages of the stages of the loop, by name and in the order of publication."""

from dataclasses import fields, replace
from typing import Any, ClassVar

import numpy as np

from plant_sim.states import frozen_message
from train_ato.messages import types as msg
from train_ato.messages.topics import AHEAD, REPORT

SECOND_NS = 1_000_000_000
"""Period of the diagnostics [ns]: every node sends them at the first stamp of a simulated second."""

Published = list[tuple[str, Any]]
"""Topic names and messages in the order of publication."""


class StageMessages:
    """Messages of a stage; None for those that a step does not send."""

    __slots__ = ()
    order: ClassVar[dict[str, str]]
    """Topic by field, in the order of publication."""

    def published(self) -> Published:
        """Return the messages in the order of publication."""
        return [(topic, sent) for name, topic in self.order.items() if (sent := getattr(self, name)) is not None]


@frozen_message
class PlantTruth(StageMessages):
    """True state of the train at a stamp."""

    clock: msg.Tick
    vehicles: msg.VehicleStates
    brake_pipe: msg.Pipe | None
    brake_pipe_tail: msg.Pipe | None
    brake_shoes: msg.BrakeShoes | None
    disturbance: msg.Disturbance | None
    diagnostics: msg.Diagnostic | None
    order: ClassVar[dict[str, str]] = {
        "clock": "/clock", "vehicles": "train/vehicles", "brake_pipe": "train/brake_pipe",
        "brake_pipe_tail": "train/brake_pipe_tail", "brake_shoes": "train/brake_shoes",
        "disturbance": "train/disturbance", "diagnostics": "/diagnostics",
    }  # fmt: skip


@frozen_message
class PlantMessages(PlantTruth):
    """Truth and measurement of a stamp, at a step of the supervisor with its inputs.

    The measurement is last, because it starts the step.
    """

    measurement: msg.Measurement
    odometry: msg.Odometry | None = None
    protection: msg.ProtectionState | None = None
    report: msg.TrainAhead | None = None
    ahead: msg.TrainAhead | None = None
    order: ClassVar[dict[str, str]] = {
        **PlantTruth.order, "report": REPORT, "ahead": AHEAD, "odometry": "train/odometry",
        "protection": "train/protection", "measurement": "train/measurement",
    }  # fmt: skip


@frozen_message
class SupervisorMessages(StageMessages):
    """Decision of the supervisor; the release is last, because it ends the step."""

    release: msg.BrakeRelease
    speeds: msg.SupervisedSpeeds
    diagnostics: msg.Diagnostic | None = None
    order: ClassVar[dict[str, str]] = {
        "speeds": "atp/speeds", "diagnostics": "/diagnostics", "release": "atp/brake_release"
    }  # fmt: skip


@frozen_message
class ProfileStart(StageMessages):
    """Profile and speed limits at the start of a run, latched."""

    profile: msg.Trajectory
    limits: msg.Trajectory
    order: ClassVar[dict[str, str]] = {"profile": "ato/profile", "limits": "ato/limits"}


@frozen_message
class ProfileMessages(StageMessages):
    """Reference of a stamp, after the new profile of a re-planning."""

    reference: msg.Reference
    profile: msg.Trajectory | None = None
    diagnostics: msg.Diagnostic | None = None
    order: ClassVar[dict[str, str]] = {
        "diagnostics": "/diagnostics", "profile": "ato/profile", "reference": "ato/reference"
    }  # fmt: skip


@frozen_message
class ObserverMessages(StageMessages):
    """Disturbance estimate of a stamp."""

    estimate: msg.DisturbanceEstimate
    diagnostics: msg.Diagnostic | None = None
    order: ClassVar[dict[str, str]] = {"diagnostics": "/diagnostics", "estimate": "ato/estimate"}


@frozen_message
class ControllerMessages(StageMessages):
    """Command of a stamp, after the brake-pipe pressure of a train with an air brake and the state of the ATO.

    The command is last, because it ends the step.
    """

    command: msg.Command
    brake_pipe_command: msg.Pipe | None = None
    diagnostics: msg.Diagnostic | None = None
    state: msg.AtoReport | None = None
    order: ClassVar[dict[str, str]] = {
        "brake_pipe_command": "ato/brake_pipe_command",
        "state": "ato/state",
        "diagnostics": "/diagnostics",
        "command": "ato/command",
    }


def without_values(measurement: msg.Measurement) -> msg.Measurement:
    """Return a measurement with NaN as values, in place of one that did not arrive."""
    names = [entry.name for entry in fields(measurement) if entry.name != "stamp"]
    return replace(measurement, **{name: np.full_like(getattr(measurement, name), np.nan) for name in names})
