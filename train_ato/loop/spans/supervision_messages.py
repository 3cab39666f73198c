"""Messages of the steps of the supervisor in a span, from its arrays."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from train_ato.loop.recording import ATO_STATE, SUPERVISED_SPEEDS
from train_ato.loop.recording_builder import RecordingBuilder
from train_ato.loop.repeated_reports import RepeatedReport
from train_ato.loop.spans import supervision_kernel as s
from train_ato.loop.spans.stages import Stages
from train_ato.loop.spans.supervised import SupervisionArrays
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
from train_ato.supervision.odometry import MotionEstimate, speed_measurement_error
from train_ato.supervision.position_estimate import TrainMotion
from train_ato.supervision.supervisor import TARGET_NEAR, SupervisionDecision, SupervisionState, limit_text

ODOMETRY, PROTECTION, BRAKE_RELEASE = "train/odometry", "train/protection", "atp/brake_release"

NUMBERS = (("front", s.STEP_FRONT), ("position_error", s.STEP_ERROR), ("acceleration", s.STEP_ACCELERATION))
"""Numbers in the diagnostics of the supervisor, with their columns of the compiled steps."""


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
        self._stage, self._steps = stages.supervisor, arrays.steps[1 : 1 + arrays.counts[s.STEPS]]
        self._period = int(arrays.counts[s.PERIOD])
        self.ticks = np.flatnonzero(stamps % self._period == 0)
        self._stamps = stamps[self.ticks]
        seen, first = measured[self.ticks, :, 0], self._stage._count
        assert first is not None
        self._alive: Array = np.arange(first + 1, first + 1 + len(self._stamps), dtype=np.float64)
        offset = stages.setup.model.offsets[0]
        state = np.full(len(seen), float(AtoState.ENGAGED))
        self._ato = np.ascontiguousarray(np.column_stack((seen[:, 0] + offset, seen[:, 1], state)))
        self._foremost = np.ascontiguousarray(self._steps[:, [s.STEP_FRONT, *[s.STEP_FOREMOST] * 4]])
        self._speeds = self._steps[:, s.STEP_ESTIMATE : s.STEP_LIMITS + 4]
        self._states, self._reasons = self._known_states()
        self.reports = self._diagnostics(numbers=() if brief else NUMBERS)

    def at(self, number: int) -> SupervisedStep:
        """Return the messages of a step by its number."""
        row, stamp = self._steps[number], int(self._stamps[number])
        position, velocity, state = self._ato[number].reshape(3, 1)
        return SupervisedStep(
            Odometry(stamp, *row[: s.STEP_FRONT].reshape(3, 2)),
            ProtectionState(stamp, np.zeros(3)),
            SupervisedSpeeds(stamp, self._foremost[number], self._speeds[number]),
            BrakeRelease(stamp, np.ones(3), np.full(3, self._alive[number])),
            AtoReport(stamp, position, velocity, state),
        )

    def record(self, recording: RecordingBuilder) -> None:
        """Add the messages without the diagnostics to a recording as arrays."""
        stamps, count, add = self._stamps, len(self._stamps), recording.extend_rows
        rows, ato = self._steps, self._ato
        add(ODOMETRY, stamps, {"position": rows[:, :2], "speed": rows[:, 2:4], "since_balise": rows[:, 4:6]})
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
        decision, supervisor = self._decision(count - 1), stage._supervisor
        assert stage._count is not None
        stage._count += count
        stage._reported, stage._motion = decision.state, decision.motion
        stage.odometry_check.last = last[-1].odometry
        supervisor._state, supervisor._reason = decision.state, decision.reason
        supervisor._stamp, supervisor._rolled = int(self._stamps[-1]), 0.0
        return last[-1].ato

    def _known_states(self) -> tuple[list[SupervisionState], list[str]]:
        """Return state and reason of every step: those of the supervisor in Python."""
        supervisor = self._stage._supervisor
        state, reason = supervisor._state, supervisor._reason
        within = self._steps[:, s.STEP_ESTIMATE] <= self._steps[:, s.STEP_LIMITS]
        moving = self._steps[:, s.STEP_MOVING] > 0.0
        near = moving & (self._steps[:, s.STEP_INDICATED] > 0.0)
        if within.all() and not near.any():
            return [SupervisionState.NORMAL] * len(near), [""] * len(near)
        states, reasons = [], []
        above = (moving & ~within).tolist()
        for number, (allowed, indicated) in enumerate(zip(within.tolist(), near.tolist(), strict=True)):
            if allowed:
                normal = (SupervisionState.NORMAL, "")
                state, reason = (SupervisionState.INDICATION, TARGET_NEAR) if indicated else normal
            elif above[number] and state < SupervisionState.OVERSPEED:
                permitted = float(self._steps[number, s.STEP_LIMITS])
                state, reason = SupervisionState.OVERSPEED, limit_text(self._motion(number), permitted)
            states.append(state)
            reasons.append(reason)
        return states, reasons

    def _motion(self, number: int) -> TrainMotion:
        """Return the estimated motion of a step."""
        row = self._steps[number].tolist()
        speed, error = row[s.STEP_ESTIMATE], row[s.STEP_ERROR]
        estimate = MotionEstimate(row[s.STEP_ACCELERATION], speed_measurement_error(speed), error, error)
        return TrainMotion(int(self._stamps[number]), row[s.STEP_FRONT], speed, estimate)

    def _decision(self, number: int) -> SupervisionDecision:
        """Return the decision of a step."""
        speeds = SupervisionSpeeds(*self._steps[number, s.STEP_LIMITS : s.STEP_LIMITS + 4].tolist())
        return SupervisionDecision(self._states[number], self._reasons[number], speeds, self._motion(number))

    def _diagnostics(self, numbers: Sequence[tuple[str, int]]) -> list[RepeatedReport]:
        """Return the diagnostics, once a second and after a change of state, with some numbers by key and column."""
        due = (self._stamps % SECOND_NS < self._period).tolist()
        before = [self._stage._reported, *self._states]
        steps = [number for number, state in enumerate(self._states) if due[number] or state is not before[number]]
        found = []
        for _, group in groupby(steps, key=lambda number: (self._states[number], self._reasons[number])):
            same = list(group)
            stamps, rows = self._stamps[same].tolist(), self._steps[same]
            first = self._stage._diagnostic(stamps[0], self._decision(same[0]))
            found.append(RepeatedReport(first, stamps, {key: rows[:, at].tolist() for key, at in numbers}))
        return found
