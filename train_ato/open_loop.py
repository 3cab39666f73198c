"""A law on recorded inputs: what it would have commanded where the recorded one drove.

The loop is open: measurement, reference and estimate are those of the log whatever the law commands.  With the law
and the parameters of the run the commands are equal bit for bit; a change of code or gains shows as a difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.nodes.inputs import StepInputs
from train_ato.record.reading import read_log
from train_ato.roles.controller import ControllerRole
from train_ato.roles.trajectories import profile_of
from train_ato.run_setup import RunSetup
from train_ato.types import Array
from train_ato.wire import Wire

INPUTS = {
    "ato/profile": "profile",
    "train/measurement": "measurement",
    "ato/reference": "reference",
    "ato/estimate": "estimate",
}


@dataclass(frozen=True)
class OpenLoop:
    """Commands of a law on recorded inputs.

    Attributes
    ----------
    stamp : array of int64, shape (k,)
        Stamps [ns].
    recorded, replayed : Array, shape (k, units)
        Force demand in the log and of the law [N].
    """

    stamp: NDArray[np.int64]
    recorded: Array
    replayed: Array

    @property
    def difference(self) -> Array:
        """Replayed minus recorded [N], shape (k, units)."""
        return self.replayed - self.recorded

    def summary(self) -> dict[str, Any]:
        """Return figures of the difference in kN and where it is largest."""
        difference = self.difference / 1e3
        size = np.abs(difference).max(axis=1)
        worst = int(size.argmax())
        return {
            "ticks": int(self.stamp.size),
            "equal_ticks": int((size == 0).sum()),
            "difference_rms_kn": float(np.sqrt((difference**2).mean())),
            "difference_max_kn": float(size[worst]),
            "difference_max_at_s": float(self.stamp[worst]) * 1e-9,
            "difference_mean_kn": float(difference.mean()),
        }


def replay_open_loop(setup: RunSetup, run: Path) -> OpenLoop:
    """Drive a fresh controller with the recorded inputs of a run.

    Parameters
    ----------
    setup
        The run's setup, with the law and parameters to try.
    run
        Run folder or MCAP file.

    Raises
    ------
    ValueError
        If the log lacks an input, or a law refuses it.
    """
    role = ControllerRole(setup)
    inputs = StepInputs()
    recorded: dict[int, Array] = {}
    stamps: list[int] = []
    forces: list[Array] = []
    driven = False
    for topic, stamp, message in read_log(run, Wire(setup.shape).decode, (*INPUTS, "ato/command")):
        if topic == "ato/command":
            recorded[stamp] = message.force
            continue
        driven = driven or topic == "ato/profile"
        if not driven:
            raise ValueError(f"{run}: ato/profile does not come before {topic}; the log is not that of a whole run")
        for profile, complete in inputs.put(INPUTS[topic], message):
            if profile is not None:
                role.set_profile(profile_of(profile))
            command, _, _ = role.step(*complete)
            stamps.append(command.stamp)
            forces.append(command.force)
    common = [index for index, stamp in enumerate(stamps) if stamp in recorded]
    if not common:
        raise ValueError(f"{run}: no stamp has measurement, reference, estimate and command; nothing to compare")
    return OpenLoop(
        np.array([stamps[index] for index in common], dtype=np.int64),
        np.array([recorded[stamps[index]] for index in common]),
        np.array([forces[index] for index in common]),
    )
