"""Contract between the loop and a control law.

A law is a class with parameters, ``reset()`` and ``step(LawInput) -> LawOutput``.  It uses no ROS, no file and no clock
but ``LawInput.t``.  Two forms are accepted:

* keyword parameters, ``MyLaw(gain=0.1)``: every keyword of the constructor has a default and is kept in an attribute of
  the same name, as in a dataclass (``examples/my_law.py``). An optional method ``bind(model, period)`` is called with
  the train and the control period before the first step.
* a separate parameter dataclass: :class:`Law` below.

Observers and delay compensations have the same two forms.

Every field of input and output is described here once. :func:`make_parameters` is the only check of names, types and
ranges of parameters from a user.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from numbers import Real
from typing import Any, ClassVar, Protocol

import numpy as np

from plant_sim.input_error import close_match
from plant_sim.states import frozen_message
from plant_sim.units import number_text
from train_ato.messages.types import Array

__all__ = [
    "NO_LOOKAHEAD", "Array", "Law", "LawInput", "LawOutput", "LawPlan", "Lookahead", "NoParameters", "Parameter",
    "Preview", "ProfileLike", "RefusedParameter", "choice", "flag", "make_parameters", "parameter", "parameters_of",
]  # fmt: skip


@frozen_message
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


@frozen_message
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


@frozen_message
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


@frozen_message
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


@frozen_message
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
    """Return the parameters of a parameter dataclass, in order.

    Raises
    ------
    ValueError
        If it is none, or has a field without a declaration.
    """
    if not is_dataclass(dataclass_type):
        raise ValueError(
            f"Parameters = {dataclass_type}: is no dataclass; write @dataclass(frozen=True) above its class"
        )
    for entry in fields(dataclass_type):
        if "parameter" not in entry.metadata:
            raise ValueError(
                f"class {dataclass_type.__qualname__}: field '{entry.name}' is not declared; write {entry.name}: "
                f"{getattr(entry.type, '__name__', entry.type)} = parameter(...)"
            )
    return tuple(
        replace(entry.metadata["parameter"], name=entry.name, default=entry.default) for entry in fields(dataclass_type)
    )


class ProfileLike(Protocol):
    """Interface of a speed profile: evenly spaced knots and values at any time."""

    @property
    def time(self) -> Array:
        """Times of the knots [s], evenly spaced."""

    @property
    def position(self) -> Array:
        """Position of vehicle 0's centre [m]."""

    @property
    def velocity(self) -> Array:
        """Speed [m/s]."""

    @property
    def acceleration(self) -> Array:
        """Acceleration [m/s²]."""

    def at(self, t: float) -> tuple[float, float, float, float]:
        """Return position, speed, acceleration and jerk at a time [m, m/s, m/s², m/s³]."""

    def jerk(self) -> Array:
        """Return the jerk between the knots [m/s³]."""

    def window(self, t: float, count: int, period: float) -> tuple[Array, Array, Array]:
        """Return position, speed and acceleration at ``count`` times from ``t`` on, each of shape (count,)."""

    def at_times(self, t: Array) -> tuple[Array, Array, Array]:
        """Return position, speed and acceleration at many times [s], each of the shape of ``t``."""


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


class RefusedParameter(ValueError):
    """A parameter of a component that does not fit the train.

    Attributes
    ----------
    reason
        Parameter, value and problem.
    remedy
        Accepted setting ``parameter: value`` of the component.
    other
        Another remedy; "" for none.
    block
        Block of the component in a scenario, for example ``laws.smc``.
    """

    def __init__(self, reason: str, remedy: str, other: str = "", block: str = "") -> None:
        super().__init__(reason, remedy, other, block)
        self.reason, self.remedy, self.other, self.block = reason, remedy, other, block

    def of(self, kind: str, name: str) -> RefusedParameter:
        """Return the same refusal with kind and name of the component."""
        return RefusedParameter(f"{kind} '{name}': {self.reason}", self.remedy, self.other, f"{kind}s.{name}")

    def with_remedy_only(self) -> RefusedParameter:
        """Return the same refusal without the other remedy."""
        return RefusedParameter(self.reason, self.remedy, "", self.block)

    def __str__(self) -> str:
        setting = f"set {self.block}.{self.remedy}" if self.block else f"set {self.remedy}"
        return f"{self.reason}; {f'{self.other}, or ' if self.other else ''}{setting}"


def make_parameters(dataclass_type: type, values: Mapping[str, Any], owner: str) -> Any:
    """Return a parameter dataclass with ``values`` in place of the defaults.

    Parameters
    ----------
    dataclass_type
        Frozen dataclass whose fields are declared by :func:`train_ato.control.contract.parameter`.
    values
        Parameter name to value.
    owner
        Name of the component in messages: ``smc`` in ``smc.ks``.

    Raises
    ------
    ValueError
        For an unknown name, a wrong type, or a value that is out of range or not finite: one line with the remedy.
    """
    known = {entry.name: entry for entry in parameters_of(dataclass_type)}
    checked = {}
    for name, value in values.items():
        if name not in known:
            listed = ", ".join(known) or "none"
            raise ValueError(f"{owner}.{name}: no such parameter{close_match(name, known)}; {owner} has: {listed}")
        checked[name] = _checked(known[name], value, f"{owner}.{name}")
    for entry in known.values():
        default, (low, high) = entry.default, _bounds(entry)
        if isinstance(default, str) and (default not in entry.choices if entry.choices else entry.unit):
            wanted = f"none of {', '.join(entry.choices)}" if entry.choices else f"a text with the unit {entry.unit}"
            raise ValueError(f"{owner}.{entry.name}: default {default!r} is {wanted}; correct it")
        if not isinstance(default, Real) or isinstance(default, bool) or low <= default <= high:
            continue
        bounds = f"{number_text(low)} ... {number_text(high)}"
        text = f"{owner}.{entry.name}: default {number_text(default)} is outside {bounds}"
        raise ValueError(f"{text}; correct one of them")
    return dataclass_type(**checked)


def _checked(entry: Parameter, value: Any, key: str) -> Any:
    if isinstance(entry.default, bool):
        if not isinstance(value, bool):
            raise ValueError(f"{key}: {value!r} is not true or false; write true or false")
        return value
    if isinstance(entry.default, str):
        if entry.choices and value not in entry.choices:
            raise ValueError(
                f"{key}: {value!r} is not allowed{close_match(str(value), entry.choices)}; choose from: "
                + ", ".join(entry.choices)
            )
        return str(value)
    return _checked_number(entry, value, key)


def _bounds(entry: Parameter) -> tuple[float, float]:
    """Return the range of a number; a whole one has 64 bits, as in a parameter of ROS."""
    least, most = (-(2**63), 2**63 - 1) if isinstance(entry.default, int) else (-math.inf, math.inf)
    return max(entry.low, least), min(entry.high, most)


def _checked_number(entry: Parameter, value: Any, key: str) -> float | int:
    low, high = _bounds(entry)
    bounds = f"{number_text(low)} ... {number_text(high)}"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{key}: {value!r} is not a number; give {bounds} {entry.unit}".rstrip())
    if not math.isfinite(value) or not low <= value <= high:
        raise ValueError(f"{key}: {number_text(value)} is outside {bounds} {entry.unit}".rstrip())
    if isinstance(entry.default, int):
        if value != int(value):
            raise ValueError(f"{key}: {number_text(value)} is not a whole number; give {bounds}")
        return int(value)
    return float(value)
