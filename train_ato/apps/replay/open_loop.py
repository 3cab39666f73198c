"""A law on recorded inputs: what it would have commanded where the recorded one drove.

The loop is open: measurement, reference and estimate are those of the log whatever the law commands.  With the law
and the parameters of the run the commands are equal bit for bit; a change of code or gains shows as a difference.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.failure import RunFailed
from train_ato.interrupt import interruptible
from train_ato.nodes.inputs import StepInputs
from train_ato.outcome import Progress
from train_ato.record.reading import read_log
from train_ato.roles.controller import ControllerRole
from train_ato.roles.trajectories import profile_of
from train_ato.run_setup import RunSetup
from train_ato.types import Array, Command, Measurement, Pipe, Reference
from train_ato.wire import Wire

INPUTS = {
    "ato/profile": "profile",
    "train/measurement": "measurement",
    "ato/reference": "reference",
    "ato/estimate": "estimate",
}
OUTPUTS = ("ato/command", "ato/brake_pipe")
_TELL_EVERY = 100


@dataclass(frozen=True)
class OpenLoop:
    """Outputs of a law on recorded inputs, and those in the log; k ticks.

    Attributes
    ----------
    stamp : array of int64, shape (k,)
        Stamps [ns].
    velocity, reference : Array, shape (k,)
        Measured speed of the first power unit and speed of the reference [m/s].
    recorded, replayed : Array, shape (k, units)
        Force demand in the log and of the law [N].
    recorded_pipe, replayed_pipe : Array, shape (k,)
        Brake-pipe pressure demanded in the log and by the law [Pa]; empty without an air brake.
    """

    stamp: NDArray[np.int64]
    velocity: Array
    reference: Array
    recorded: Array
    replayed: Array
    recorded_pipe: Array
    replayed_pipe: Array

    @property
    def difference(self) -> Array:
        """Replayed minus recorded [N], shape (k, units)."""
        return self.replayed - self.recorded

    def summary(self) -> dict[str, Any]:
        """Return figures of both outputs and of their difference, and where that is largest; kN, kPa and s."""
        difference = self.difference / 1e3
        size = np.abs(difference).max(axis=1)
        pipe = (self.replayed_pipe - self.recorded_pipe) / 1e3
        equal = (size == 0) & (pipe == 0) if pipe.size else size == 0
        worst = int(size.argmax())
        return {
            "ticks": int(self.stamp.size),
            "equal_ticks": int(equal.sum()),
            "recorded": _force_figures(self.recorded, self.stamp),
            "replayed": _force_figures(self.replayed, self.stamp),
            "difference_rms_kn": float(np.sqrt((difference**2).mean())),
            "difference_max_kn": float(size[worst]),
            "difference_max_at_s": round(float(self.stamp[worst]) * 1e-9, 9),
            "difference_mean_kn": float(difference.mean()),
            **({"brake_pipe_difference_max_kpa": float(np.abs(pipe).max())} if pipe.size else {}),
        }


def _force_figures(force: Array, stamp: NDArray[np.int64]) -> dict[str, float]:
    """Return figures of the force of all units: extremes and rms in kN, mean change in kN/s."""
    total = force.sum(axis=1) / 1e3
    span = float(stamp[-1] - stamp[0]) * 1e-9
    return {
        "force_max_kn": float(total.max()),
        "force_min_kn": float(total.min()),
        "force_rms_kn": float(np.sqrt((total**2).mean())),
        "variation_kn_per_s": float(np.abs(np.diff(total)).sum() / span) if span > 0 else 0.0,
    }


@dataclass
class _Outputs:
    """What was commanded, by stamp."""

    force: dict[int, Array] = field(default_factory=dict)
    pipe: dict[int, float] = field(default_factory=dict)

    def take(self, message: Command | Pipe) -> None:
        if isinstance(message, Pipe):
            self.pipe[message.stamp] = message.pressure
        else:
            self.force[message.stamp] = message.force

    def pressures(self, stamps: list[int]) -> Array:
        return np.array([self.pipe[stamp] for stamp in stamps]) if self.pipe else np.empty(0)


def replay_open_loop(setup: RunSetup, run: Path, progress: Callable[[Progress], None] | None = None) -> OpenLoop:
    """Drive a fresh controller with the recorded inputs of a run.

    Parameters
    ----------
    setup
        The run's setup, with the law and parameters to try.
    run
        Run folder or MCAP file.
    progress
        Takes how far it is.

    Raises
    ------
    ValueError
        If the log lacks an input, or a law refuses it.
    RunFailed
        After Ctrl-C.
    """
    role = ControllerRole(setup)
    inputs = StepInputs()
    recorded, replayed = _Outputs(), _Outputs()
    seen: dict[int, tuple[Measurement, Reference]] = {}
    begin = time.monotonic()
    with interruptible() as interrupt:
        for topic, _, message in read_log(run, Wire(setup.shape).decode, (*INPUTS, *OUTPUTS)):
            if topic in OUTPUTS:
                recorded.take(message)
                continue
            for profile, complete in inputs.put(INPUTS[topic], message):
                if profile is not None:
                    role.set_profile(profile_of(profile))
                command, pipe, _ = role.step(*complete)
                seen[command.stamp] = complete[:2]
                replayed.take(command)
                if pipe is not None:
                    replayed.take(pipe)
                if progress is not None and len(seen) % _TELL_EVERY == 0:
                    progress(Progress(command.stamp * 1e-9, setup.ticks * setup.tick, time.monotonic() - begin))
            if interrupt.asked:
                raise RunFailed("interrupted; nothing is written")
    return _joined(run, seen, recorded, replayed)


def _joined(
    run: Path, seen: dict[int, tuple[Measurement, Reference]], recorded: _Outputs, replayed: _Outputs
) -> OpenLoop:
    """Put both outputs side by side, at the stamps that have both; a measured run says no demand of the brake pipe."""
    pipes = bool(recorded.pipe and replayed.pipe)
    common = [stamp for stamp in seen if stamp in recorded.force and (not pipes or stamp in recorded.pipe)]
    if not common:
        raise ValueError(
            f"{run}: no stamp has a profile, measurement, reference, estimate and command; nothing to compare"
        )
    return OpenLoop(
        stamp=np.array(common, dtype=np.int64),
        velocity=np.array([seen[stamp][0].velocity[0] for stamp in common]),
        reference=np.array([seen[stamp][1].velocity for stamp in common]),
        recorded=np.array([recorded.force[stamp] for stamp in common]),
        replayed=np.array([replayed.force[stamp] for stamp in common]),
        recorded_pipe=recorded.pressures(common) if pipes else np.empty(0),
        replayed_pipe=replayed.pressures(common) if pipes else np.empty(0),
    )
