"""Messages of the stages of the loop, by name and in the order of publication."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from plant_sim.states import frozen_for_types
from train_ato.messages.types import (
    AtoReport,
    BrakeRelease,
    BrakeShoes,
    Command,
    Diagnostic,
    Disturbance,
    DisturbanceEstimate,
    Measurement,
    Odometry,
    Pipe,
    ProtectionState,
    Reference,
    SupervisedSpeeds,
    Tick,
    Trajectory,
    VehicleStates,
)

SECOND_NS = 1_000_000_000

Published = list[tuple[str, Any]]
"""Topic names and messages in the order of publication."""


def _present(*messages: tuple[str, Any]) -> Published:
    """Return the messages that are not None."""
    return [entry for entry in messages if entry[1] is not None]


@frozen_for_types
@dataclass(frozen=True, slots=True)
class PlantTruth:
    """True state of the train at a stamp; after the last tick without a measurement."""

    clock: Tick
    vehicles: VehicleStates
    brake_pipe: Pipe | None
    brake_pipe_tail: Pipe | None
    brake_shoes: BrakeShoes | None
    disturbance: Disturbance | None
    diagnostics: Diagnostic | None

    def published(self) -> Published:
        """Return the messages in the order of publication."""
        return _present(
            ("/clock", self.clock),
            ("train/vehicles", self.vehicles),
            ("train/brake_pipe", self.brake_pipe),
            ("train/brake_pipe_tail", self.brake_pipe_tail),
            ("train/brake_shoes", self.brake_shoes),
            ("train/disturbance", self.disturbance),
            ("/diagnostics", self.diagnostics),
        )


@frozen_for_types
@dataclass(frozen=True, slots=True)
class PlantMessages:
    """Truth and measurement of a stamp, at a step of the supervisor with its inputs."""

    truth: PlantTruth
    measurement: Measurement
    odometry: Odometry | None = None
    protection: ProtectionState | None = None

    def published(self) -> Published:
        """Return the messages in the order of publication; the measurement is last, because it starts the step."""
        inputs = _present(("train/odometry", self.odometry), ("train/protection", self.protection))
        return [*self.truth.published(), *inputs, ("train/measurement", self.measurement)]


@frozen_for_types
@dataclass(frozen=True, slots=True)
class SupervisorMessages:
    """Decision of the supervisor."""

    release: BrakeRelease
    speeds: SupervisedSpeeds
    diagnostics: Diagnostic | None = None

    def published(self) -> Published:
        """Return the messages in the order of publication; the release is last, because it ends the step."""
        return _present(
            ("atp/speeds", self.speeds), ("/diagnostics", self.diagnostics), ("atp/brake_release", self.release)
        )


@frozen_for_types
@dataclass(frozen=True, slots=True)
class ProfileStart:
    """Profile and speed limits at the start of a run, latched."""

    profile: Trajectory
    limits: Trajectory

    def published(self) -> Published:
        """Return the messages in the order of publication."""
        return [("ato/profile", self.profile), ("ato/limits", self.limits)]


@frozen_for_types
@dataclass(frozen=True, slots=True)
class ProfileMessages:
    """Reference of a stamp, with the new profile after re-planning."""

    reference: Reference
    profile: Trajectory | None = None
    diagnostics: Diagnostic | None = None

    def published(self) -> Published:
        """Return the messages in the order of publication; a new profile is before its first reference."""
        return _present(
            ("/diagnostics", self.diagnostics), ("ato/profile", self.profile), ("ato/reference", self.reference)
        )


@frozen_for_types
@dataclass(frozen=True, slots=True)
class ObserverMessages:
    """Disturbance estimate of a stamp."""

    estimate: DisturbanceEstimate
    diagnostics: Diagnostic | None = None

    def published(self) -> Published:
        """Return the messages in the order of publication."""
        return _present(("/diagnostics", self.diagnostics), ("ato/estimate", self.estimate))


@frozen_for_types
@dataclass(frozen=True, slots=True)
class ControllerMessages:
    """Command of a stamp, with the brake-pipe pressure of a train with an air brake and the state of the ATO."""

    command: Command
    brake_pipe_command: Pipe | None = None
    diagnostics: Diagnostic | None = None
    state: AtoReport | None = None

    def published(self) -> Published:
        """Return the messages in the order of publication; the command is last, because it ends the step."""
        return _present(
            ("ato/brake_pipe_command", self.brake_pipe_command),
            ("ato/state", self.state),
            ("/diagnostics", self.diagnostics),
            ("ato/command", self.command),
        )


def without_values(measurement: Measurement) -> Measurement:
    """Return a measurement with NaN as values, in place of one that did not arrive."""
    names = [entry.name for entry in fields(measurement) if entry.name != "stamp"]
    return replace(measurement, **{name: np.full_like(getattr(measurement, name), np.nan) for name in names})


def stamped(message: Any, stamp: int) -> Any:
    """Return a delayed message with the stamp of its use [ns]."""
    return message if message.stamp == stamp else replace(message, stamp=stamp)


def diagnostics_due(stamp: int, tick_ns: int) -> bool:
    """Return True once a second: at the first stamp [ns] of every simulated second."""
    return stamp % SECOND_NS < tick_ns
