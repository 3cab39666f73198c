"""The contract between the loop and a control law.

A law is a class with a parameter dataclass, ``reset()`` and ``step(LawInput) -> LawOutput``.  It knows no ROS, no
file and no clock but ``LawInput.t``.  ``docs`` of every field stand here once.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, ClassVar, Protocol

from train_ato.types import Array

__all__ = ["Array", "Law", "LawInput", "LawOutput", "Parameter", "Preview", "parameter", "parameters_of"]


@dataclass(frozen=True, slots=True)
class Preview:
    """Reference ahead at the control period; entry 0 is the time the command acts.

    Attributes
    ----------
    position, velocity, acceleration : Array, shape (h,)
        m, m/s, m/s² of vehicle 0's centre; beyond the profile's end it holds.
    """

    position: Array
    velocity: Array
    acceleration: Array


@dataclass(frozen=True, slots=True)
class LawInput:
    """All a law may know in one step. Arrays are over power units, front first.

    Attributes
    ----------
    t : float
        Simulation time of the measurement [s].
    position, velocity : Array
        Measured (or, under a predicting compensation, predicted) state of every power unit [m, m/s].
    applied : Array
        Force that acts on every unit at the time of the state above, after delay, lag and limit [N].
    reference_position, reference_velocity, reference_acceleration : Array
        Reference of every unit (its own nominal offset taken off) at the time of the state above [m, m/s, m/s²].
    lead : float
        Time from the state above to the time the command will act [s].
    acting_acceleration, acting_jerk : float
        Reference acceleration and jerk at the time the command will act [m/s², m/s³].
    feedforward : Array
        Force of every unit that makes the nominal model follow the reference at the acting time, air brake and
        grade included [N]; laws that bring their own equivalent control may leave it.
    preview : Preview
        Reference from the acting time on.
    disturbance : Array
        Estimate of the observer [N], > 0 forward.
    deflection, rate, coupler_force : Array
        Couplers that carry a sensor [m, m/s, N], in the order of ``model.sensors``.
    shoe_force : Array
        Air-brake force on every unit's own vehicle as the model predicts it for the time of the state above [N],
        > 0 retards.
    train_shoe_force : float
        The same on the whole train [N].
    under_way : Array, shape (d, units)
        Commands already sent and not yet acting, oldest first [N].
    force_min, force_max : Array
        Limits at the present speed [N].
    saturated : bool
        The last command was cut by a limit: integrators and weights should hold.
    """

    t: float
    position: Array
    velocity: Array
    applied: Array
    reference_position: Array
    reference_velocity: Array
    reference_acceleration: Array
    lead: float
    acting_acceleration: float
    acting_jerk: float
    feedforward: Array
    preview: Preview
    disturbance: Array
    deflection: Array
    rate: Array
    coupler_force: Array
    shoe_force: Array
    train_shoe_force: float
    under_way: Array
    force_min: Array
    force_max: Array
    saturated: bool


@dataclass(frozen=True, slots=True)
class LawOutput:
    """Force demand of every unit [N] and, if the law brakes with air, the brake-pipe pressure demanded [Pa].

    ``held`` says why the law found no force and ``force`` is only the last one again; empty, as always when all is
    well, if it is the law's own.  Such steps are counted, and a law that goes on like that ends the run.
    """

    force: Array
    brake_pipe: float | None = None
    held: str = ""


@dataclass(frozen=True, slots=True)
class Parameter:
    """Description of one parameter: from it come ROS descriptors, validation and the documentation."""

    name: str
    default: float | int | bool | str
    unit: str
    low: float
    high: float
    meaning: str
    choices: tuple[str, ...] = ()


def parameter(default: Any, unit: str, low: float, high: float, meaning: str, *, choices: tuple[str, ...] = ()) -> Any:
    """Declare one field of a parameter dataclass: default, unit, allowed range, one line of meaning.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Parameters:
    ...     kp: float = parameter(1e6, "N/(m/s)", 0.0, 1e9, "gain on the speed error")
    """
    from dataclasses import field

    return field(
        default=default,
        metadata={"unit": unit, "low": low, "high": high, "meaning": meaning, "choices": choices},
    )


def parameters_of(dataclass_type: type) -> tuple[Parameter, ...]:
    """List the parameters that a parameter dataclass declares, in order."""
    return tuple(
        Parameter(
            name=entry.name,
            default=entry.default,  # type: ignore[arg-type]
            unit=entry.metadata["unit"],
            low=entry.metadata["low"],
            high=entry.metadata["high"],
            meaning=entry.metadata["meaning"],
            choices=tuple(entry.metadata["choices"]),
        )
        for entry in fields(dataclass_type)
    )


class Law(Protocol):
    """A control law.

    ``Parameters`` is a frozen dataclass whose fields were made by :func:`parameter`.  The constructor takes the
    parameters, the model of the train and the control period [s]; it raises :class:`ValueError` with a reason when
    the law makes no sense on that train.

    An optional method ``missed()`` is called instead of ``step()`` where no measurement could be used and the last
    command is repeated: what bridges samples (a difference quotient, a sampled model) must know of the gap.

    An optional attribute ``horizon`` (default 0) is the number of entries of ``LawInput.preview`` the law wants.  Two
    more are the law's words for a refusal, where a compensation would do nothing or the same thing twice:
    ``leaves_feedforward`` (why ``LawInput.feedforward`` is not looked at, and what to set) and ``predicts_delay``
    (likewise, for a law that looks over the delay itself).
    """

    Parameters: ClassVar[type]

    def __init__(self, parameters: Any, model: Any, period: float) -> None: ...

    def reset(self) -> None:
        """Forget everything learnt and stored."""

    def step(self, inputs: LawInput) -> LawOutput:
        """Return the force demand for one control period."""
