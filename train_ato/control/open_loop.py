"""A driver's run as data: notches and brake-pipe reductions by time or place, without a law.

Every power unit has the force of its notch at its speed, from the ``notches`` of its vehicle type. The handle moves
notch by notch, and the force changes with the rates of the type. Nothing is fed back but speed and place.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any

from pydantic import TypeAdapter, model_validator

from plant_sim.consist import Notches
from plant_sim.input_error import one_of
from plant_sim.railway import envelope_force
from plant_sim.si_model import SiModel, option
from plant_sim.units import Place, Pressure, Time, Usual, number_text
from train_ato.control.air_brake.policy import BrakeEvent
from train_ato.control.contract import LawInput, parameter
from train_ato.control.guard import GuardedLaw

ROUNDING = 1e-9
"""Rounding of times [s]."""


class DriverAction(SiModel):
    """Action of a driver from a time or a position of vehicle 0's centre on, in the order of the list."""

    time: Time | None = option(None, "time of the action", example=60.0, ge=0)
    place: Place | None = option(None, "position of vehicle 0's centre at the action", example=1200.0)
    notch: int | None = option(None, "notch: > 0 throttle, < 0 dynamic brake, 0 idle", example=4, ge=-99, le=99)
    units: tuple[int, ...] | None = option(
        None, "numbers of the power units of the notch, front first from 0; default: all", example=(0, 1), min_length=1
    )
    reduction: Annotated[Pressure | None, Usual(10e3, 1e6)] = option(
        None, "reduction of the brake pipe; 0 releases", example=50e3, ge=0
    )

    @model_validator(mode="after")
    def _does_something(self) -> "DriverAction":
        if (self.time is None) == (self.place is None):
            raise ValueError("an action has exactly one of time and place; give one")
        if self.notch is None and self.reduction is None:
            raise ValueError("an action has neither notch nor reduction; give one of them")
        if self.units is not None and self.notch is None:
            raise ValueError("units without notch: a reduction is that of the whole train; add notch or remove units")
        return self


_ACTIONS: TypeAdapter[tuple[DriverAction, ...]] = TypeAdapter(tuple[DriverAction, ...])


def actions_text(actions: Sequence[DriverAction]) -> str:
    """Return actions as the text of the parameter of :class:`OpenLoopDriver`."""
    return json.dumps([action.model_dump(exclude_none=True) for action in actions])


def driver_reductions(actions: Sequence[DriverAction]) -> tuple[BrakeEvent, ...]:
    """Return the brake-pipe reductions of actions."""
    return tuple(
        BrakeEvent(time=action.time, place=action.place, reduction=action.reduction)
        for action in actions
        if action.reduction is not None
    )


class NotchHandle:
    """Handle of one power unit with the force of its notch.

    Parameters
    ----------
    notches
        Curves and rates of the vehicle type.
    """

    def __init__(self, notches: Notches) -> None:
        self._notches = notches
        self._rows = {
            sign: [[segment.row for segment in curve] for curve in curves]
            for sign, curves in ((1, notches.traction), (-1, notches.brake))
        }
        self.wanted = self.notch = 0
        self.force = 0.0
        self._moved = -inf

    def curve_force(self, speed: float) -> float:
        """Return the force of the present notch at a speed [N], > 0 traction."""
        if self.notch == 0:
            return 0.0
        sign = 1 if self.notch > 0 else -1
        rows = self._rows[sign][abs(self.notch) - 1]
        return sign * float(envelope_force(rows, 0, len(rows), abs(speed)))

    def step(self, t: float, speed: float, period: float) -> float:
        """Return the force at a time [s] and speed [m/s], a period [s] after the last one [N]."""
        if self.notch != self.wanted and t - self._moved >= self._notches.notch_time - ROUNDING:
            towards = 1 if self.wanted > self.notch else -1
            self.notch = self.wanted if self._notches.notch_time == 0.0 else self.notch + towards
            self._moved = t
        self.force = self._rated(self.curve_force(speed), period)
        return self.force

    def _rated(self, target: float, period: float) -> float:
        """Return the next force towards a target [N]; a change of its sign passes through 0 with both rates."""
        rise, fall = self._notches.rise or inf, self._notches.fall or inf
        left, force = period, self.force
        if force * target <= 0.0 and force != 0.0:  # down to 0 first
            needed = abs(force) / fall
            if needed > left:
                return force - fall * left * (1.0 if force > 0.0 else -1.0)
            left, force = left - needed, 0.0
        sign = 1.0 if target > 0.0 or (target == 0.0 and force > 0.0) else -1.0
        size, wanted = abs(force), abs(target)
        return sign * (min(wanted, size + rise * left) if wanted >= size else max(wanted, size - fall * left))


@dataclass
class OpenLoopDriver(GuardedLaw):
    """Forces of a schedule of notches, in the place of a law."""

    actions: str = parameter("[]", "", 0, 0, "actions of the driver, JSON")
    open_loop = True

    def bind(self, model: Any, period: float) -> None:
        """Take the train and the period [s].

        Raises
        ------
        ValueError
            If a power unit has no notches, if an action falls behind the one before it, or if an action needs a notch,
            a unit, a brake or a place that train and line do not have.
        """
        super().bind(model, period)
        self._actions = _ACTIONS.validate_json(self.actions)
        self._notches = []
        if not model.units:
            raise ValueError("profile.driver: the train has no power unit; add notches to a vehicle type")
        for unit in model.units:
            notches = model.consist.vehicles[unit].notches
            if notches is None:
                raise ValueError(f"profile.driver: vehicle {unit} is a power unit without notches; add notches")
            self._notches.append(notches)
        reached = {"time": 0.0, "place": model.line.begin}
        for number, action in enumerate(self._actions):
            key = f"profile.driver.{number}"
            self._check_brake(key, action)
            for name, last in reached.items():
                at = getattr(action, name)
                if at is not None and at < last:
                    raise ValueError(
                        f"{key}.{name} = {number_text(at)}: lies before {number_text(last)}, that of an earlier action "
                        f"or of the begin; let {name}s rise"
                    )
                reached[name] = last if at is None else at
            if reached["place"] > model.line.end:
                raise ValueError(
                    f"{key}.place = {number_text(reached['place'])}: beyond the end of the line, "
                    f"{number_text(model.line.end)} m; give a place on it"
                )
            for unit in action.units or range(self.n):
                self._check_unit(key, action, unit)
        self.clear_state()

    def _check_brake(self, key: str, action: DriverAction) -> None:
        """Check the reduction of an action."""
        brake = self.model.consist.air_brake
        if action.reduction is not None and brake is None:
            raise ValueError(f"{key}.reduction: the consist has no air_brake; remove it")
        if action.reduction is not None and brake is not None and action.reduction > brake.charged:
            raise ValueError(
                f"{key}.reduction = {number_text(action.reduction)} Pa: exceeds the charged "
                f"{number_text(brake.charged)} Pa; lower it"
            )

    def _check_unit(self, key: str, action: DriverAction, unit: int) -> None:
        """Check unit and notch of an action."""
        if not 0 <= unit < self.n:
            raise ValueError(f"{key}.units: {unit} is not one of the {self.n} power units; {one_of(self.n)}")
        notches = self._notches[unit]
        low, high = -len(notches.brake), len(notches.traction)
        if action.notch is not None and not low <= action.notch <= high:
            raise ValueError(f"{key}.notch: power unit {unit} has no notch {action.notch}; give {low} ... {high}")

    def clear_state(self) -> None:
        """Put every handle on notch 0."""
        self._handles = [NotchHandle(notches) for notches in self._notches]
        self._following = 0

    def reset(self) -> None:
        """Clear all state, also before a train is known."""
        if hasattr(self, "_notches"):
            super().reset()

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force of every unit [N]."""
        return self.forces(inputs.t, self.model.front(inputs.position), inputs.velocity.tolist())

    def forces(self, t: float, place: float, speeds: list[float]) -> list[float]:
        """Return the force of every unit [N] at a time [s], a place of vehicle 0's centre [m], and speeds [m/s]."""
        while self._following < len(self._actions):
            action = self._actions[self._following]
            due = t >= action.time - ROUNDING if action.time is not None else place >= float(action.place or 0.0)
            if not due:
                break
            self._following += 1
            for unit in action.units or range(self.n):
                if action.notch is not None:
                    self._handles[unit].wanted = action.notch
        pairs = zip(self._handles, speeds, strict=True)
        return [handle.step(t, speed, self.period) for handle, speed in pairs]
