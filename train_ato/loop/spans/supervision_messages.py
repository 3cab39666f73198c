"""Messages of the steps of the supervisor in a span, from its arrays."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_sim.odometry import odometry_of
from train_ato.loop.recording import ATO_STATE, SUPERVISED_SPEEDS
from train_ato.loop.recording_builder import RecordingBuilder
from train_ato.loop.repeated_reports import RepeatedReport
from train_ato.loop.spans.stages import Stages
from train_ato.loop.spans.supervision_kernel import SupervisionArrays
from train_ato.loop.stage_messages import SECOND_NS
from train_ato.messages.types import (
    Array,
    AtoReport,
    AtoState,
    BrakeRelease,
    Odometry,
    ProtectionState,
    SupervisedSpeeds,
)
from train_ato.supervision.ceiling import SupervisionSpeeds
from train_ato.supervision.supervisor import SupervisionDecision, SupervisionState

ODOMETRY, PROTECTION, BRAKE_RELEASE = "train/odometry", "train/protection", "atp/brake_release"

NUMBERS = ("front", "position_error", "acceleration")
"""Numbers in the diagnostics of the supervisor."""
TEXTS = ["state", "reason", "reason_speed", "reason_front", "reason_limit"]
"""Fields of a step from which the texts of the diagnostics follow."""


class SupervisedStep(NamedTuple):
    """Messages of a step of the supervisor, without its diagnostics."""

    odometry: Odometry
    protection: ProtectionState
    speeds: SupervisedSpeeds
    release: BrakeRelease
    ato: AtoReport


class SupervisionMessages:
    """Messages of the steps of the supervisor in the ticks of one span.

    Parameters
    ----------
    stages
        Setup and stages of the loop; the supervisor is in its state before the span.
    arrays
        Results of the compiled steps.
    stamps : Array of int, shape (ticks,)
        Stamps of the ticks [ns].
    measured : Array, shape (ticks, 3, units)
        Position [m], speed [m/s] and force [N] of every tick.
    brief
        True for diagnostics with the numbers of the first one of equal texts.

    Attributes
    ----------
    ticks : Array of int, shape (steps,)
        Numbers of the ticks with a step.
    reports : list of RepeatedReport
        Diagnostics of the supervisor.
    """

    def __init__(
        self,
        stages: Stages,
        arrays: SupervisionArrays,
        stamps: NDArray[np.int64],
        measured: Array,
        *,
        brief: bool = False,
    ) -> None:
        assert stages.supervisor is not None
        self._stages = stages
        records: Any = arrays
        count, self._period = (int(records.states.run[name][0]) for name in ("steps", "period"))
        self._stage, self._steps, self._readings = stages.supervisor, records.steps[:count], records.readings[:count]
        self.ticks = np.flatnonzero(stamps % self._period == 0)
        self._stamps = stamps[self.ticks]
        seen, first = measured[self.ticks, :, 0], self._stage._count
        assert first is not None
        self._alive: Array = np.arange(first + 1, first + 1 + len(self._stamps), dtype=np.float64)
        offset = stages.setup.model.offsets[0]
        state = np.full(len(seen), float(AtoState.ENGAGED))
        self._ato = np.ascontiguousarray(np.column_stack((seen[:, 0] + offset, seen[:, 1], state)))
        front = self._steps["front"]
        foremost = front + self._steps["position_error"]
        self._foremost = np.ascontiguousarray(np.column_stack((front, *[foremost] * 4)))
        limits = (self._steps[name] for name in SupervisionSpeeds._fields)
        self._speeds = np.ascontiguousarray(np.column_stack((self._steps["speed"], *limits)))
        self.reports = self._diagnostics(() if brief else NUMBERS)

    def at(self, number: int) -> SupervisedStep:
        """Return the messages of a step by its number."""
        stamp = int(self._stamps[number])
        position, velocity, state = self._ato[number].reshape(3, 1)
        return SupervisedStep(
            odometry_of(self._readings[number]),
            ProtectionState(stamp, np.zeros(3)),
            SupervisedSpeeds(stamp, self._foremost[number], self._speeds[number]),
            BrakeRelease(stamp, np.ones(3), np.full(3, self._alive[number])),
            AtoReport(stamp, position, velocity, state),
        )

    def record(self, recording: RecordingBuilder) -> None:
        """Add the messages without the diagnostics to a recording as arrays."""
        stamps, count, add = self._stamps, len(self._stamps), recording.extend_rows
        ato = self._ato
        add(ODOMETRY, stamps, {name: self._readings[name] for name in ("position", "speed", "since_balise")})
        add(PROTECTION, stamps, {"active": np.zeros((count, 3))})
        add(SUPERVISED_SPEEDS, stamps, {"position": self._foremost, "speed": self._speeds})
        add(BRAKE_RELEASE, stamps, {"released": np.ones((count, 3)), "alive": np.repeat(self._alive[:, None], 3, 1)})
        add(ATO_STATE, stamps, {"position": ato[:, :1], "velocity": ato[:, 1:2], "state": ato[:, 2:]})

    def record_state(self, recording: RecordingBuilder) -> None:
        """Add the states of the ATO to a recording for the summary."""
        recording.extend_reduced(ATO_STATE, self._stamps, {"state": self._ato[:, 2:]})

    @property
    def numbers(self) -> dict[int, int]:
        """Number of the step by the number of its tick."""
        return {index: number for number, index in enumerate(self.ticks.tolist())}

    def store(self, ato: AtoReport | None) -> AtoReport | None:
        """Set the supervisor, its stage and the receiving ends to their states after the last step.

        Parameters
        ----------
        ato
            Report of the ATO at the step before the span, which the profile receives first.

        Returns
        -------
        AtoReport or None
            Report at the last step.
        """
        stage, count = self._stage, len(self._stamps)
        if not count:
            return ato
        last = [self.at(number) for number in range(max(count - 2, 0), count)]
        reports = [ato] * (count < 3) + [self.at(number).ato for number in range(max(count - 3, 0), count - 1)]
        inputs = self._stages.controller._inputs
        inputs.accept(PROTECTION, count, [step.protection for step in last])
        inputs.accept(SUPERVISED_SPEEDS, count, [step.speeds for step in last])
        self._stages.plant._inputs.accept(BRAKE_RELEASE, count, [step.release for step in last])
        self._stages.plant.protection.on_release(last[-1].release)
        self._stages.plant.alive_check.problem(last[-1].release)
        self._stages.profile._inputs.accept(ATO_STATE, count, [report for report in reports if report][-2:])
        stage._inputs.accept(ODOMETRY, count, [step.odometry for step in last])
        assert stage._count is not None
        stage._count += count
        stage._reported = SupervisionState(self._steps["state"][-1])
        return last[-1].ato

    def _diagnostics(self, numbers: Sequence[str]) -> list[RepeatedReport]:
        """Return the diagnostics, once a second and after a change of state, with some numbers by key."""
        states = self._steps["state"]
        changed = np.diff(states, prepend=int(self._stage._reported)) != 0
        steps = np.flatnonzero(changed | (self._stamps % SECOND_NS < self._period)).tolist()
        texts, found = self._steps[TEXTS].tolist(), []
        for _, group in groupby(steps, key=texts.__getitem__):
            same = list(group)
            stamps, rows = self._stamps[same].tolist(), self._steps[same]
            first = self._stage._diagnostic(stamps[0], SupervisionDecision(rows[0]))
            found.append(RepeatedReport(first, stamps, {key: rows[key].tolist() for key in numbers}))
        return found
