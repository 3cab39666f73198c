"""The contract of a delay compensation: a layer between the measurement and any law.

A command sent now takes effect a delay later. The compensation chooses the state, the reference and the feed-forward
that the law receives, so that every law runs with every compensation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from plant_sim.states import frozen_for_types
from train_ato.control.contract import LawInput
from train_ato.messages.types import Array, Measurement, Reference

if TYPE_CHECKING:
    from train_ato.control.compensation.rigid import RigidForce

__all__ = ["Array", "Compensation", "CompensationInput"]


@frozen_for_types
@dataclass(frozen=True, slots=True)
class CompensationInput:
    """Inputs of one step, all of the time of a valid measurement.

    Attributes
    ----------
    measurement : Measurement
        State of the power units and of the couplers with a sensor.
    reference : Reference
        Reference of vehicle 0's centre.
    disturbance : Array, shape (units,)
        Estimate of the observer [N], > 0 forward.
    commands_in_flight : Array, shape (d, units)
        Commands sent and not yet in effect, one per tick, oldest first [N]; the last was sent a tick ago.
    pressure : float or None
        Brake-pipe pressure demanded from now on [Pa]; None without an air brake.
    force_min, force_max : Array, shape (units,)
        Limits at the measured speed [N].
    saturated : bool
        A limit cut the last command.
    horizon : int
        Number of entries of the preview that the law uses.
    lookahead_times : Array, optional
        Times after the measurement of the lookahead of the law [s]; None for a law without.
    """

    measurement: Measurement
    reference: Reference
    disturbance: Array
    commands_in_flight: Array
    pressure: float | None
    force_min: Array
    force_max: Array
    saturated: bool = False
    horizon: int = 0
    lookahead_times: Array | None = None

    @property
    def t(self) -> float:
        """Time of the measurement [s]."""
        return self.measurement.stamp * 1e-9


class Compensation(Protocol):
    """A delay compensation. The constructor takes its parameters, the model of the train and the control period [s].

    The form with keyword parameters is that of a law (:mod:`train_ato.control.contract`,
    ``examples/my_compensation.py``). Without delay and lag of the model the law receives the measured state and the
    reference of the measurement. The loop skips the step for an invalid state of the units; sensor values of couplers
    may be invalid.

    Two optional methods: ``set_brake_policy(policy)`` sets a copy of the brake policy, for a compensation that
    simulates a train; ``on_command_sent(force)`` is called with every command as it was sent [N], shape (units,).

    Three optional attributes for :mod:`train_ato.control.compensation.compatibility`: ``feedforward_only`` (True: only
    the feed-forward differs from that of `none` or `preview`), ``simulates_train`` (True: the lookahead has the force
    of a simulated train) and ``predicts`` (True: the state is that of the time at which the command takes effect).
    """

    Parameters: ClassVar[type]

    def __init__(self, parameters: Any, model: Any, period: float) -> None: ...

    def set_profile(self, rigid: RigidForce) -> None:
        """Set the profile, before the first step and after each re-planning."""

    def reset(self) -> None:
        """Clear all state but the profile."""

    def step(self, inputs: CompensationInput) -> LawInput:
        """Return the input of the law."""
