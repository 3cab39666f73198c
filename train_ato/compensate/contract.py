"""The contract of a delay compensation: a layer between the measurement and any law.

A command sent now acts a delay later. The compensation decides which state, which reference and which feed-forward
the law is shown, so that every law can be run with every compensation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.compensate.rigid import RigidForce

__all__ = ["Array", "Compensation", "Situation", "View"]


@dataclass(frozen=True, slots=True)
class Situation:
    """What is known at the time of a sound measurement.

    Attributes
    ----------
    t : float
        Time of the measurement [s].
    position, velocity, applied : Array, shape (units,)
        Measured state [m, m/s] and acting force [N].
    disturbance : Array, shape (units,)
        The observer's estimate [N].
    under_way : Array, shape (d, units)
        Commands sent and not yet acting, one per tick, oldest first [N]; the last was sent a tick ago.
    reference : tuple of float
        Position, velocity, acceleration of vehicle 0's centre now [m, m/s, m/s²].
    pressure : float or None
        Brake-pipe pressure demanded from now on [Pa]; None without an air brake.
    """

    t: float
    position: Array
    velocity: Array
    applied: Array
    disturbance: Array
    under_way: Array
    reference: tuple[float, float, float]
    pressure: float | None


@dataclass(frozen=True, slots=True)
class View:
    """What the law is shown; the meaning of every entry stands at :class:`train_ato.control.contract.LawInput`."""

    position: Array
    velocity: Array
    applied: Array
    reference_position: Array
    reference_velocity: Array
    reference_acceleration: Array
    acting_time: float
    lead: float
    acting_acceleration: float
    acting_jerk: float
    feedforward: Array
    shoe_force: Array
    train_shoe_force: float
    coupler_force: Array | None = None


class Compensation(Protocol):
    """A delay compensation. The constructor takes its parameters, the model of the train and the control period [s].

    One that runs a train of its own may have ``set_brake_policy(policy)``: it is handed a fresh copy of the policy;
    one that wants to know every command as it was sent may have ``sent(force)``.

    Two optional attributes say what it gives, for :mod:`train_ato.compensate.fit`: ``feedforward_only`` (True: nothing
    but the feed-forward differs from what `none` or `preview` show) and ``predicts`` (True: the state is that of the
    time the command acts).
    """

    Parameters: ClassVar[type]

    def __init__(self, parameters: Any, model: Any, period: float) -> None: ...

    def set_profile(self, rigid: RigidForce) -> None:
        """Take a new profile; called before the first step and when the profile was planned anew."""

    def reset(self) -> None:
        """Forget everything but the profile."""

    def see(self, now: Situation) -> View:
        """Return what the law is shown."""
