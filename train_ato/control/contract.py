"""Contract between the loop and a control law.

A law is a class with parameters, ``reset()`` and ``step(LawInput) -> LawOutput``.  It uses no ROS, no file and no clock
but ``LawInput.t``.  Two forms are accepted:

* keyword parameters, ``MyLaw(gain=0.1)``: every keyword of the constructor has a default and is kept in an attribute of
  the same name, as in a dataclass (``examples/my_law.py``). An optional method ``bind(model, period)`` is called with
  the train and the control period before the first step.
* a separate parameter dataclass: :class:`Law` below.

Observers and delay compensations have the same two forms.

Every field of input and output is described here once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Protocol

import numpy as np

from plant_sim.states import frozen_for_types
from train_ato.messages.types import Array

__all__ = [
    "NO_LOOKAHEAD", "Array", "Law", "LawInput", "LawOutput", "LawPlan", "Lookahead", "NoParameters", "Parameter",
    "Preview", "choice", "flag", "parameter", "parameters_of",
]  # fmt: skip


@frozen_for_types
@dataclass(frozen=True, slots=True)
class Preview:
    """Reference samples, one per control period, from the time of effect of the command.

    Attributes
    ----------
    position, velocity, acceleration : Array, shape (h,)
        Of vehicle 0's centre [m, m/s, m/s²]; the last value holds beyond the end of the profile.
    """

    position: Array
    velocity: Array
    acceleration: Array


@frozen_for_types
@dataclass(frozen=True, slots=True)
class Lookahead:
    """Reference and known forces at the times that a law names in ``lookahead_times``.

    Attributes
    ----------
    position, velocity, acceleration : Array, shape (h,)
        Of vehicle 0's centre at the time of the measurement plus every entry of ``lookahead_times`` [m, m/s, m/s²].
    resistance : Array, shape (h,)
        Running and line resistance of the nominal train there, and the shoe force known from the brake-pipe commands
        so far [N], > 0 retards.
    speed_limit : Array, shape (h,)
        Lowest speed limit of the line over the whole train with vehicle 0's centre there [m/s]; behind a train ahead at
        most the permitted speed of the supervisor up to the moving end of authority, 0 from there on.
    force_min, force_max : Array, shape (h, units)
        Limits of every unit there, at the speed of the reference, with neutral sections, power limits and adhesion of
        the line [N].
    simulated_force : Array, shape (k,), k <= h
        Total force of a simulated train on this reference [N] at the first of these times, until the last command takes
        effect. Empty if the compensation simulates no train.
    position_max : float
        Largest place of vehicle 0's centre before the moving end of authority, with the largest error of the odometer
        [m]; infinite without a train ahead.
    """

    position: Array
    velocity: Array
    acceleration: Array
    resistance: Array
    speed_limit: Array = field(default_factory=lambda: np.zeros(0))
    force_min: Array = field(default_factory=lambda: np.zeros((0, 0)))
    force_max: Array = field(default_factory=lambda: np.zeros((0, 0)))
    simulated_force: Array = field(default_factory=lambda: np.zeros(0))
    position_max: float = math.inf


NO_LOOKAHEAD = Lookahead(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0))
"""Lookahead of a law without ``lookahead_times``."""


@frozen_for_types
@dataclass(frozen=True, slots=True)
class LawInput:
    """Inputs of a law in one step. Arrays have one entry per power unit, front first.

    Attributes
    ----------
    t : float
        Simulation time of the measurement [s].
    position, velocity : Array
        State of every power unit [m, m/s]: measured, or predicted by a predicting compensation.
    applied : Array
        Force on every unit at the time of the state, after delay, lag and limit [N].
    reference_position, reference_velocity, reference_acceleration : Array
        Reference of every unit, its nominal offset subtracted, at the time of the state [m, m/s, m/s²].
    delay_to_effect : float
        Time from the state to the effect of the command [s].
    acceleration_at_effect, jerk_at_effect : float
        Reference acceleration and jerk at the time at which the command takes effect [m/s², m/s³].
    feedforward : Array
        Force of every unit with which the nominal model follows the reference when the command takes effect, air
        brake and grade included [N].
    preview : Preview
        Reference from the effect of the command on.
    disturbance : Array
        Estimate of the observer [N], > 0 forward.
    deflection, rate, coupler_force : Array
        Couplers that carry a sensor [m, m/s, N], in the order of ``model.sensors``.
    shoe_force : Array
        Air-brake force on every unit's own vehicle, predicted by the model for the time of the state [N], > 0 retards.
    train_shoe_force : float
        Air-brake force on the whole train, for the same time [N], > 0 retards.
    commands_in_flight : Array, shape (d, units)
        Commands sent and not yet in effect, one per tick, oldest first [N].
    force_min, force_max : Array
        Limits at the measured speed [N].
    saturated : bool
        The last command was at a limit.
    lookahead : Lookahead
        Reference and known forces at the times that the law names in ``lookahead_times``, from the measurement on.
    """

    t: float
    position: Array
    velocity: Array
    applied: Array
    reference_position: Array
    reference_velocity: Array
    reference_acceleration: Array
    delay_to_effect: float
    acceleration_at_effect: float
    jerk_at_effect: float
    feedforward: Array
    preview: Preview
    disturbance: Array
    deflection: Array
    rate: Array
    coupler_force: Array
    shoe_force: Array
    train_shoe_force: float
    commands_in_flight: Array
    force_min: Array
    force_max: Array
    saturated: bool
    lookahead: Lookahead = NO_LOOKAHEAD


@frozen_for_types
@dataclass(frozen=True, slots=True)
class LawPlan:
    """Planned motion and force of a law that looks ahead. The log and the live page have the newest one once a second.

    Attributes
    ----------
    times : Array, shape (k,)
        Times after the measurement [s], rising; the first is the effect of the command.
    position, speed : Array, shape (k,)
        Planned motion of vehicle 0's centre [m, m/s].
    force : Array, shape (k,)
        Planned force demand of the train [N].
    slack : Array, shape (k,)
        Excess of the planned speed over the speed that the law permits [m/s], >= 0.
    status : str
        Result of the solver: ``solved``, or the reason for which an earlier plan goes on.
    """

    times: Array
    position: Array
    speed: Array
    force: Array
    slack: Array
    status: str


@frozen_for_types
@dataclass(frozen=True, slots=True)
class LawOutput:
    """Output of a law in one step.

    Attributes
    ----------
    force : Array, shape (units,)
        Force demand of every unit [N].
    brake_pipe : float or None
        Brake-pipe pressure demanded [Pa]; None leaves it to the brake policy.
    held : str
        Reason for which ``force`` repeats the previous demand; empty for a new demand. The loop counts such steps and
        ends the run after ``hold_limit``.
    plan : LawPlan or None
        Plan that the force begins; None for a law without a plan.
    """

    force: Array
    brake_pipe: float | None = None
    held: str = ""
    plan: LawPlan | None = None


@dataclass(frozen=True, slots=True)
class Parameter:
    """Declaration of one parameter: source of its ROS descriptor, its validation and its documentation."""

    name: str
    default: float | int | bool | str
    unit: str
    low: float
    high: float
    meaning: str
    choices: tuple[str, ...] = ()


def parameter(default: Any, unit: str, low: float, high: float, meaning: str, *, choices: tuple[str, ...] = ()) -> Any:
    """Declare one field of a parameter dataclass.

    Parameters
    ----------
    default
        Default value; its type is the type of the parameter.
    unit
        SI unit; empty for a switch or a choice.
    low, high
        Allowed range of a number.
    meaning
        One line of description.
    choices
        Allowed words of a choice.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Parameters:
    ...     kp: float = parameter(1e6, "N/(m/s)", 0.0, 1e9, "gain on the speed error")
    """
    declared = Parameter("", default, unit, low, high, meaning, choices)
    return field(default=default, metadata={"parameter": declared})


def choice(meaning: str, *choices: str, default: str = "") -> Any:
    """Declare one field of a parameter dataclass that is one of some words, by default the first one."""
    return parameter(default or choices[0], "", 0, 0, meaning, choices=choices)


def flag(meaning: str, *, default: bool) -> Any:
    """Declare one field of a parameter dataclass that is true or false."""
    return parameter(default, "", 0, 1, meaning)


def parameters_of(dataclass_type: type) -> tuple[Parameter, ...]:
    """Return the parameters of a parameter dataclass, in order."""
    return tuple(
        replace(entry.metadata["parameter"], name=entry.name, default=entry.default) for entry in fields(dataclass_type)
    )


@dataclass(frozen=True)
class NoParameters:
    """Parameters of a component that has none."""


class Law(Protocol):
    """A control law.

    ``Parameters`` is a frozen dataclass whose fields are declared by :func:`parameter`. The constructor takes the
    parameters, the model of the train and the control period [s]; it raises :class:`ValueError` with the reason if the
    law cannot control that train.

    An optional method ``on_missed_sample()`` is called instead of ``step()`` if the measurement is not valid and the
    last command is repeated: difference quotients and sampled models must not bridge the gap.

    After a change of the law or of its parameters during a run, an optional method ``take_over(inputs, force)`` is
    called once before ``step()``. It sets integrals, filters and predictions so that the demand begins at ``force``,
    the last command [N]. With or without this method the demand begins there. For 3 s, and until the law is reached, it
    changes in a tick by at most jerk of the profile x inertia x share x tick. ``force_min`` and ``force_max`` are then
    within this reach. The reference of another law begins in the state of the train and joins the profile within 20 s
    (:mod:`train_ato.control.takeover`).

    A law that raises or does not return gets no further step: the train brakes to standstill, and the run fails.

    Optional attributes:

    * ``horizon`` (int, default 0): number of entries of ``LawInput.preview`` that the law uses;
    * ``lookahead_times`` (Array, default empty): times after the measurement of ``LawInput.lookahead`` [s], rising;
    * ``feedback()``: gains on the errors of speed [1/s] and position [1/s²] near the reference, or None. Own gains that
      are unstable on the train have a line before the run;
    * ``diagnostics()``: counts and states of the law as text, for the topic ``/diagnostics``;
    * ``uses_feedforward`` (bool, default True): the output depends on ``LawInput.feedforward``;
    * ``feedforward_hint`` (str): setting under which the law uses it, ``parameter: value``; empty if there is none;
    * ``follows_simulation`` (bool, default False): the output depends on ``Lookahead.simulated_force``;
    * ``predicts_delay`` (bool, default False): the law predicts its state over the delay by itself;
    * ``delay_hint`` (str): setting under which it does not, ``parameter: value``; empty if there is none.
    """

    Parameters: ClassVar[type]

    def __init__(self, parameters: Any, model: Any, period: float) -> None: ...

    def reset(self) -> None:
        """Clear all learnt and stored state."""

    def step(self, inputs: LawInput) -> LawOutput:
        """Return the force demand for one control period."""
