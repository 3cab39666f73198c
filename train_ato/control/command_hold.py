"""Commands in place of those of the law: repeated ones up to a limit, and those at standstill.

The holding brake of the plant acts below the holding speed while no unit has a positive demand.
"""

from typing import Any

import numpy as np

from plant_sim.compiled import compiled
from train_ato.control.component_fault import ComponentFailed, printable
from train_ato.control.train_model import RELEASE_FORCE, TrainModel, stands
from train_ato.messages.types import Array
from train_ato.program.errors import RunFailed

MIN_HELD_STEPS = 3
"""Consecutive steps that are allowed for any period of the law."""


class CommandHold:
    """Counter of the steps that repeat the last command because no valid new one exists.

    Parameters
    ----------
    limit
        Maximum time of consecutive repeated steps [s].
    period
        Period of the law [s].

    Attributes
    ----------
    total, in_a_row : int
        Repeated steps of the run, and of the present gap.
    """

    def __init__(self, limit: float, period: float) -> None:
        self._max_steps = max(MIN_HELD_STEPS, round(limit / period))
        self._period = period
        self._reason, self._by_component = "", False
        self.total = 0
        self.in_a_row = 0

    def hold(self, reason: str, *, by_component: bool = False) -> None:
        """Count one repeated step with its reason; ``by_component`` for a fault of a law or a compensation."""
        self.total += 1
        self.in_a_row += 1
        self._reason, self._by_component = printable(reason), by_component

    def check_limit(self, cause: BaseException | None = None) -> None:
        """Fail the run at the limit; ``cause`` is the error of a component.

        Raises
        ------
        RunFailed
            One line with the last reason and the number of steps; :class:`ComponentFailed` for a fault of a component.
        """
        if self.in_a_row >= self._max_steps:
            seconds = self.in_a_row * self._period
            steps = f"in {self.in_a_row} consecutive steps ({seconds:g} s, hold_limit)"
            if self._by_component:
                raise ComponentFailed(f"{self._reason}; the last command was repeated {steps}") from cause
            raise RunFailed(f"{self._reason} {steps}")


@compiled
def _pulls_nowhere(force: Array) -> bool:
    """Return True if no demand is positive; ``max`` of an array would load scipy with the kernel, 0.1 s."""
    none = True
    for demand in force:
        none &= demand <= 0.0
    return none


@compiled
def command_at_standstill(force: Array, velocity: Array, rests: bool, departs: bool) -> None:
    """Change the command of every unit [N] at standstill: 0 if the profile rests, a positive one if it departs."""
    if (rests or (departs and _pulls_nowhere(force))) and stands(velocity):
        force[:] = 0.0 if rests else RELEASE_FORCE


def profile_at_standstill(speed: Array, acceleration: Array, later: tuple[Array, ...], model: TrainModel) -> Any:
    """Return True for a profile at rest now and after the command delay, and for a departure by the train's weight.

    Parameters
    ----------
    speed, acceleration : Array, shape (times,)
        Of the profile now [m/s, m/s²].
    later : tuple of Array, shape (times,)
        Position, speed and acceleration after the command delay [m, m/s, m/s²].
    model
        The nominal train: on a falling grade it departs without traction.

    Returns
    -------
    Array of bool, shape (2, times)
        Rests, and departs.
    """
    place, speed_then, acceleration_then = later
    departs = (speed_then > 0.0) & (acceleration_then >= 0.0) & (not model.reversing)
    departs[departs] = model.inertia * acceleration_then[departs] + model.line_forces(place[departs]) < 0.0
    return np.array(((speed == 0.0) & (acceleration == 0.0) & (speed_then == 0.0), departs))
