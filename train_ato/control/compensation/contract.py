"""The contract of a delay compensation: a layer between the measurement and any law.

A command sent now takes effect a delay later. The compensation chooses the state, the reference and the feed-forward
that the law receives, so that every law runs with every compensation.
"""

from collections.abc import Callable
from typing import Any, ClassVar, Protocol

from plant_sim.states import frozen_message
from train_ato.control.compensation.rigid import RigidForce
from train_ato.control.contract import LawInput
from train_ato.messages.types import Array, Measurement, Reference


@frozen_message
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
    authority : callable, optional
        Returns the largest place [m] and the permitted speeds [m/s] at places [m] of vehicle 0's centre, up to the
        moving end of authority; None without a train ahead.
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
    authority: Callable[[Array], tuple[float, Array]] | None = None

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

    Two methods are optional. ``set_brake_policy(policy)`` sets a copy of the brake policy, for a compensation that
    simulates a train. ``on_command_sent(force)`` is called with every command as it was sent [N], shape (units,).

    Three attributes for :mod:`train_ato.control.compensation.contract` are optional. ``feedforward_only`` is True if
    only the feed-forward differs from `none` or `preview`. ``simulates_train`` is True if the lookahead has the force
    of a simulated train. ``predicts`` is True if the state belongs to the time at which the command takes effect.
    """

    Parameters: ClassVar[type]

    def __init__(self, parameters: Any, model: Any, period: float) -> None: ...

    def set_profile(self, rigid: RigidForce) -> None:
        """Set the profile, before the first step and after each re-planning."""

    def reset(self) -> None:
        """Clear all state but the profile."""

    def step(self, inputs: CompensationInput) -> LawInput:
        """Return the input of the law."""


def check_compatible(law_name: str, law: Any, name: str, compensation: Any) -> None:
    """Reject a law and a compensation that do nothing together or predict the delay twice.

    Parameters
    ----------
    law_name, law
        Name and law; its attributes ``uses_feedforward``, ``follows_simulation``, ``predicts_delay`` and hints are read
        (:class:`train_ato.control.contract.Law`).
    name, compensation
        Name and compensation, or its class; its attributes ``feedforward_only``, ``simulates_train``, ``predicts``
        are read
        (:class:`train_ato.control.compensation.contract.Compensation`).
    """
    pair = f"law '{law_name}' with compensation '{name}'"
    predicting = getattr(law, "predicts_delay", False)
    follows = getattr(law, "follows_simulation", False) and getattr(compensation, "simulates_train", False)
    if getattr(compensation, "feedforward_only", False) and not (getattr(law, "uses_feedforward", True) or follows):
        remedy = _remedy(law_name, getattr(law, "feedforward_hint", ""), predicting=predicting)
        raise ValueError(f"{pair}: '{name}' gives only a feed-forward, and this law does not use it; {remedy}")
    if getattr(compensation, "predicts", False) and predicting:
        remedy = _remedy(law_name, getattr(law, "delay_hint", ""), predicting=predicting)
        raise ValueError(f"{pair}: '{name}' predicts the state over the delay, and so does this law; {remedy}")


def _remedy(law_name: str, hint: str, *, predicting: bool) -> str:
    """Return the accepted settings as text: the ``hint`` of the law, and compensations that predict nothing twice."""
    setting = f"set laws.{law_name}.{hint}" if hint else "set law: pid (--law pid)"
    others = "none or preview" if predicting else "none, preview or predictor"
    return f"{setting}, or compensation: {others} (--compensation none)"
