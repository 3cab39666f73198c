"""Time at a force limit: the demand was at or beyond a limit, clipped by the controller or by the train."""

from __future__ import annotations

import numpy as np

from train_ato.loop.recording import Recording
from train_ato.loop.setup import RunSetup
from train_ato.messages.types import Array


def time_at_force_limit(setup: RunSetup | None, recording: Recording) -> tuple[Array, Array] | None:
    """Return times [s] and the time at a force limit since the start [s], shape (k,) each; None without diagnostics.

    The plant counts demands beyond the limits of the train, the controller commands at the limits of its model. A
    command that the law or the controller has clipped is not beyond the limit of the train, and a limit of the train
    below that of the model does not clip the command. Both counts are in the diagnostics once a second. In each of
    these seconds the larger one counts, because a demand beyond both limits is in both. The count of the controller is
    moved by the nominal delay of the command and a tick: it includes the step at its stamp.
    """
    plant = recording.reported("plant", "saturated")
    steps = recording.reported("controller", "saturated_steps")
    if steps is not None and setup is not None:
        delay = float(np.mean(setup.model.delay))
        controller = (steps[0] + delay + setup.tick, steps[1] * setup.control_period)
        if plant is None:
            return controller
        time = plant[0]
        increments = [_increments(time, *series) for series in (plant, controller)]
        return time, np.cumsum(np.maximum(*increments))
    return plant


def _increments(time: Array, at: Array, count: Array) -> Array:
    """Return the increase of a count until each time; a count that starts again after a restart of its node goes on."""
    rising = np.cumsum(np.maximum(0.0, np.diff(count, prepend=0.0)))
    values = np.interp(time, at, rising)
    values[-1] = rising[-1]  # the last command has no effect within the run, and the count has no later report
    return np.diff(values, prepend=0.0)
