"""Commands in place of those of the law: repeated ones up to a limit, and those at standstill.

The holding brake of the plant acts below the holding speed while no unit has a positive demand.
"""

from __future__ import annotations

from train_ato.control.compensation.rigid import ProfileLike
from train_ato.control.component_fault import ComponentFailed
from train_ato.control.train_model import STANDSTILL_SPEED, TrainModel
from train_ato.errors import RunFailed
from train_ato.messages.types import Measurement, Reference

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
        self._reason, self._by_component = reason, by_component

    def resume(self) -> None:
        """End the gap after a valid command."""
        self.in_a_row = 0

    def check_limit(self) -> None:
        """Fail the run at the limit.

        Raises
        ------
        RunFailed
            One line with the last reason and the number of steps; :class:`ComponentFailed` for a fault of a component.
        """
        if self.in_a_row >= self._max_steps:
            seconds = self.in_a_row * self._period
            steps = f"in {self.in_a_row} consecutive steps ({seconds:g} s, hold_limit)"
            if self._by_component:
                raise ComponentFailed(f"{self._reason}; the last command was repeated {steps}")
            raise RunFailed(f"{self._reason} {steps}")


RELEASE_FORCE = 1.0
"""Demand that releases the holding brake for a departure on a falling grade without traction [N]."""


def command_at_standstill(
    demand: list[float],
    measurement: Measurement,
    reference: Reference,
    profile: ProfileLike,
    model: TrainModel,
    *,
    delay_to_effect: float,
) -> list[float]:
    """Return the demand of every unit [N]; that of a train at standstill is 0 N if the profile is at rest, too.

    The profile is at rest now and after the command delay [s].  A departure on a falling grade without a positive
    demand releases the holding brake.
    """
    if not stands(measurement):
        return demand
    position, velocity, acceleration, _ = profile.at(measurement.stamp * 1e-9 + delay_to_effect)
    if reference.velocity == reference.acceleration == velocity == 0.0:
        return [0.0] * len(demand)
    departs = velocity > 0.0 and acceleration >= 0.0 and not model.reversing
    if departs and max(demand) <= 0.0 and model.rigid_force(position, 0.0, acceleration) < 0.0:
        return [RELEASE_FORCE] * len(demand)
    return demand


def stands(measurement: Measurement) -> bool:
    """Return True if all units are slower than :data:`STANDSTILL_SPEED`."""
    fastest: float = max(map(abs, measurement.velocity.tolist()))
    return fastest < STANDSTILL_SPEED
