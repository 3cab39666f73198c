"""Range of the force of a train that stops, stands or departs, for a plant whose holding brake acts without traction.

Below the holding speed the holding brake acts at once and fully as soon as no unit has a positive demand, and releases
at the first positive demand. Three rules follow, with speed v and acceleration a predicted for the time of effect of
the command, and the demand F:

* **Rest.** The reference is at rest and the train stops within ``STOP_WINDOW``: F <= 0. A force that holds the train
  on a rising grade, or that follows the noise, would keep the holding brake off and move the train.
* **Roll-out.** The last brake force decays through the lag while a demand of ``RELEASE_FORCE`` keeps the holding brake
  off, for 0 < v < ``ROLL_OUT_SPEED`` and a < -``LAST_DECELERATION``. Otherwise the holding brake stops the train from
  the holding speed with about 1 m/s².
* **Departure.** If a train at standstill would roll back, it stays in the holding brake until the reference departs at
  the time of effect. Then the force reaches its reference within a control period, if the limits permit:
  F = F_e - M e_a/(1 - e^(-h/Ta)), with the force F_e and the error e_a of the acceleration at the time of effect.

With hauled vehicles there is no traction from a reference speed of ``STANDSTILL_SPEED`` down to the stop: the vehicles
stop one by one. A train with a reversing drive has none of these rules, since a negative demand drives it backwards.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from train_ato.control.standstill import RELEASE_FORCE
from train_ato.control.train_model import STANDSTILL_SPEED

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel
    from train_ato.messages.types import Array

STOP_WINDOW = 0.1
"""Distance from the target within which the train is not moved again [m]."""
ROLL_OUT_SPEED = 0.08
"""Speed below which the brake force decays [m/s]: the holding speed and an error of the prediction."""
LAST_DECELERATION = 0.03
"""Deceleration up to which the train rolls out [m/s²]."""
ROLL_BACK = 0.02
"""Backward acceleration of a train that would roll back at its departure [m/s²]."""
FREE = (-math.inf, math.inf)
"""Range without a limit [N]."""


class StandstillForce:
    """Range of the total force near standstill.

    Parameters
    ----------
    model
        The nominal train.
    period
        Control period [s].
    """

    def __init__(self, model: TrainModel, period: float) -> None:
        self._hauls = len(model.consist.vehicles) > model.n_units
        self._reversing = model.reversing
        self._release = RELEASE_FORCE * model.n_units if model.lag > 0.0 else 0.0
        self._gained = 1.0 - math.exp(-period / model.lag) if model.lag > 0.0 else 1.0

    def range(
        self, motion: Array, reference: tuple[float, float, float], stands: bool, force: float, inertia: float
    ) -> tuple[float, float]:
        """Return the smallest and largest total force [N].

        Parameters
        ----------
        motion : Array, shape (4,)
            Errors of position [m] and speed [m/s], disturbance and error of the acceleration [m/s²] at the time of
            effect.
        reference
            Speed [m/s] and acceleration [m/s²] of the reference at the time of effect, and its speed a node later.
        stands
            True if the train is at standstill now.
        force
            Total force at the time of effect [N].
        inertia
            Mass with rotating parts [kg].
        """
        now, _, later = reference
        stops = now < STANDSTILL_SPEED and later <= now
        if self._hauls:
            return (-math.inf, 0.0) if stops else FREE
        if self._reversing:
            return FREE
        speed, acceleration = now + float(motion[1]), reference[1] + float(motion[3])
        if later > now:
            return self._departure(now, acceleration, force - inertia * float(motion[3]), force) if stands else FREE
        if not stands and 0.0 < speed < ROLL_OUT_SPEED and acceleration < -LAST_DECELERATION and self._release:
            return self._release, self._release
        return (-math.inf, 0.0) if now == 0.0 and abs(float(motion[0])) < STOP_WINDOW else FREE

    def _departure(self, reference: float, acceleration: float, needed: float, force: float) -> tuple[float, float]:
        """Return the range for a departure from a reference speed [m/s] that needs a force [N]."""
        if acceleration > -ROLL_BACK or needed <= 0.0:
            return FREE
        if reference == 0.0:
            return -math.inf, 0.0
        return force + (needed - force) / self._gained, math.inf
