"""Range of the force of a train that stops or departs; rules: `msgs_docs/mpc_derivation.md`."""

import math

from plant_sim.elementary import plain_sum
from train_ato.control.algorithms.train_constants import train_class
from train_ato.control.mpc.predictive_plan import RelativeMotion
from train_ato.control.train_model import RELEASE_FORCE, STANDSTILL_SPEED, TrainModel

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
        self._hauls = train_class(model).hauls
        self._reversing = model.reversing
        self._share: list[float] = model.share.tolist()
        self._release = RELEASE_FORCE * model.n_units
        self._lag = model.lag
        self._gained = 1.0 - math.exp(-period / model.lag) if model.lag > 0.0 else 1.0
        self.reset()

    def reset(self) -> None:
        """End a roll-out."""
        self._rolls_out = False

    def limited(
        self, wanted: list[float], motion: RelativeMotion, reference: tuple[float, float, float], inertia: float,
        force: float, *, at_rest: bool,
    ) -> list[float]:  # fmt: skip
        """Return the force of every unit in the range of the total force [N]; arguments as in :meth:`range`.

        The holding brake keeps a train at rest that need not be pulled.
        """
        if at_rest and not self._hauls and not self._reversing and plain_sum(wanted) <= 0.0:
            return [0.0] * len(wanted)
        low, high = self.range(motion, reference, inertia, force, at_rest=at_rest)
        return [min(max(each, low * share), high * share) for each, share in zip(wanted, self._share, strict=True)]

    def range(
        self,
        motion: RelativeMotion,
        reference: tuple[float, float, float],
        inertia: float,
        force: float,
        *,
        at_rest: bool,
    ) -> tuple[float, float]:
        """Return the smallest and largest total force [N]; the train is ``at_rest`` if it is at standstill now.

        ``motion`` is that at the time of effect, ``force`` the total force then [N]. ``reference`` is speed [m/s] and
        acceleration [m/s²] then, and the speed a node later. ``inertia`` is the mass with rotating parts [kg].
        """
        now, _, later = reference
        if self._hauls:
            if at_rest and now == 0.0:
                return 0.0, 0.0
            ends = now == 0.0 or (now < STANDSTILL_SPEED and motion.position_error >= 0.0)
            return (-math.inf, 0.0) if ends and later <= now else FREE
        if self._reversing:
            return FREE
        speed, acceleration = now + motion.speed_error, reference[1] + motion.acceleration_error
        self._rolls_out = self._rolls_out and later <= now and not at_rest
        waits = now == 0.0 and abs(motion.position_error) < STOP_WINDOW and (at_rest or later == 0.0)
        if waits and at_rest:
            return 0.0, 0.0
        if later > now:
            if not at_rest or acceleration > -ROLL_BACK:
                return FREE
            return force - inertia * motion.acceleration_error / self._gained, math.inf
        if not at_rest and speed > 0.0 and self._lag > 0.0:
            enough = speed < (ROLL_OUT_SPEED if speed < -acceleration * self._lag else STANDSTILL_SPEED)
            if enough and acceleration < -LAST_DECELERATION:
                self._rolls_out = True
                return self._release, (self._release if now == 0.0 else math.inf)
            if self._rolls_out and speed < STANDSTILL_SPEED:
                return -math.inf, 0.0
        return (-math.inf, 0.0) if waits else FREE
