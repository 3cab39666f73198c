"""Supervisor, train protection and mode of the ATO before and after compiled ticks without effect of the supervisor."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_sim.odometry import Odometers
from train_ato.loop.spans import supervision_kernel as s
from train_ato.loop.spans.packed_track import TrackArrays, packed_track
from train_ato.loop.spans.stages import Stages
from train_ato.loop.train_protection import Protection
from train_ato.messages.types import Array, AtoState
from train_ato.supervision.supervisor import STANDSTILL_SPEED, SupervisionState

Past = deque[tuple[int, float]]


class SupervisionArrays(NamedTuple):
    """Arrays of the compiled steps, by the entries of :mod:`train_ato.loop.spans.supervision_kernel`."""

    counts: NDArray[np.int64]
    constant: Array
    odometers: Array
    stamps: NDArray[np.int64]
    speeds: Array
    track: TrackArrays
    steps: Array


class SupervisedTicks:
    """Supervision of the compiled ticks of a run.

    Parameters
    ----------
    stages
        Setup and stages of the loop; without a supervisor the compiled ticks have no step of it.
    """

    def __init__(self, stages: Stages) -> None:
        self._stages = stages
        self._idle = stages.supervisor is None
        self._period = 0
        self._track: TrackArrays
        none = np.zeros(0)
        if stages.supervisor is None:
            self._constant: Array = none
            self._track = (none, np.zeros((0, 4)), np.zeros((0, 0)), np.zeros((0, 3)), none)
            return
        setup, odometers = stages.setup, stages.plant._odometers
        assert odometers is not None
        self._period = setup.supervision_ticks * setup.tick_ns
        self._track = packed_track(stages.supervisor._supervisor.track)
        check, assurance = stages.controller.ato._check, stages.controller.ato.assurance
        self._constant = np.array((
            odometers._wheel, odometers._radar, odometers._spacing, stages.plant._half,
            -1.0 if assurance is None else assurance._reaction, 0.0 if assurance is None else assurance._limit - 1.0,
            check._spec.speed_difference, check._spec.position_difference, check._front_offset,
        ))  # fmt: skip

    @property
    def is_quiet(self) -> bool:
        """True if neither supervisor nor train protection nor the mode of the ATO changes the commands."""
        plant, controller = self._stages.plant, self._stages.controller
        protection = plant.protection
        if protection.requested or protection.level is not Protection.NONE or plant._reported is not Protection.NONE:
            return False
        if plant.lost or plant._outage_changed or controller._outage or controller._takeover or controller._error:
            return False
        if self._stages.supervisor is None:
            return True
        stamp, stage, ato, profile = plant.stamp, self._stages.supervisor, controller.ato, self._stages.profile
        supervisor = stage._supervisor
        if stage._count is None or supervisor._stamp is None or not profile._engaged or profile._joins:
            return False
        if supervisor._state >= SupervisionState.SERVICE_BRAKE or ato.machine.state is not AtoState.ENGAGED:
            return False
        if ato.awaits_profile or ato.assured or ato._check._since is not None:
            return False
        if any(round(request.at * 1e9) <= stamp and request.do == "disengage" for request in ato._waiting):
            return False
        return protection.is_idle(stamp, self._period) and self._past() is not None

    def next_request(self, stamp: int) -> list[int]:
        """Return the stamps of the requests to the ATO after a stamp [ns]."""
        return [at for request in self._stages.controller.ato._waiting if (at := round(request.at * 1e9)) > stamp]

    def _past(self) -> tuple[Past, int, int] | None:
        """Return the speeds of estimate and assurance with the first one of each; None for different ones."""
        stage, assurance = self._stages.supervisor, self._stages.controller.ato.assurance
        assert stage is not None
        past = stage._supervisor._estimator._past
        other = past if assurance is None else assurance._past
        longer, shorter = (past, other) if len(past) >= len(other) else (other, past)
        if not shorter or list(longer)[len(longer) - len(shorter) :] != list(shorter):
            return None
        return longer, len(longer) - len(past), len(longer) - len(other)

    def arrays(self, ticks: int) -> SupervisionArrays:
        """Return the arrays of a span in the present states of the stages."""
        count: NDArray[np.int64] = np.zeros(6, dtype=np.int64)
        most = 1 if self._idle else 2 + ticks * self._stages.setup.tick_ns // self._period
        steps, stage = np.zeros((most, s.STEP_COLUMNS)), self._stages.supervisor
        if stage is None:
            stamps: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
            return SupervisionArrays(count, self._constant, np.zeros(6), stamps, np.zeros(0), self._track, steps)
        found, last = self._past(), stage.odometry_check.last
        assert found is not None
        assert last is not None
        past, first, rated = found
        count[:] = (self._period, 0, last.stamp, first, rated, len(past))
        stamps, speeds = np.zeros(len(past) + most, dtype=np.int64), np.zeros(len(past) + most)
        stamps[: len(past)], speeds[: len(past)] = zip(*past, strict=True)
        steps[0, : s.STEP_FRONT] = (*last.position, *last.speed, *last.since_balise)
        odometers: Any = self._stages.plant._odometers
        values = (odometers._origin, *odometers._counted, *odometers._since, odometers._front)
        return SupervisionArrays(count, self._constant, np.array(values), stamps, speeds, self._track, steps)

    def store(self, arrays: SupervisionArrays, first: int, ticks: int) -> None:
        """Set the states of plant, supervisor and ATO to those after some ticks from a stamp [ns] on."""
        stages = self._stages
        if stages.supervisor is None:
            return
        stages.plant.protection.pass_ticks(first, ticks)
        odometers: Any = stages.plant._odometers
        _store_odometers(odometers, arrays.odometers.tolist())
        steps = int(arrays.counts[s.STEPS])
        if not steps:
            return
        ato = stages.controller.ato
        end = int(arrays.counts[s.END])
        past = list(zip(arrays.stamps[:end].tolist(), arrays.speeds[:end].tolist(), strict=True))
        stages.supervisor._supervisor._estimator._past = deque(past[arrays.counts[s.FIRST_ESTIMATED] :])
        if ato.assurance is not None:
            ato.assurance._past = deque(past[arrays.counts[s.FIRST_RATED] :])
            ato.assurance.service_limit = float(arrays.steps[steps, s.STEP_LIMITS + 2])
        ato._speed, ato.standstill = past[-1][1], past[-1][1] < STANDSTILL_SPEED


def _store_odometers(odometers: Odometers, values: list[float]) -> None:
    odometers._origin = values[s.ORIGIN]
    odometers._counted = values[s.COUNTED], values[s.COUNTED_RADAR]
    odometers._since = values[s.SINCE], values[s.SINCE_RADAR]
    odometers._front = values[s.TRUE_FRONT]
