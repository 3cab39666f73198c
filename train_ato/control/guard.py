"""Guard of the laws: validity of inputs, finite output inside the limits.

An input that is not finite or physically impossible is not used: the last demand is repeated, and the law continues
with the next valid input.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from struct import Struct
from typing import Any

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import mean_over_units
from plant_sim.record import Records, dtype_of, quantity, zeros
from train_ato.control.contract import LawInput, LawOutput, LawPlan, Lookahead, Preview
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array, Measurement
from train_ato.messages.validity import MAX_FORCE, MAX_POSITION, MAX_SPEED

MAX_DELAY = 100.0
"""Largest valid delay of a command [s]."""


@dataclass
class LawNow:
    """Inputs of a step for the whole train."""

    t: float = quantity("s", "time of the measurement")
    acceleration_at_effect: float = quantity("m/s²", "reference acceleration at the effect of the command")
    jerk_at_effect: float = quantity("m/s³", "reference jerk at the effect of the command")
    delay_to_effect: float = quantity("s", "time from the state to the effect of the command")
    line_force: float = quantity("N", "line force on the train, > 0 retards")
    train_shoe_force: float = quantity("N", "shoe force on the train, > 0 retards")
    sensed_force: float = quantity("N", "sum of the magnitudes of all measured coupler forces")


@dataclass
class LawUnit:
    """Inputs of a step for one power unit, and the outputs of the last step."""

    position: float = quantity("m", "position")
    velocity: float = quantity("m/s", "speed")
    applied: float = quantity("N", "acting force")
    reference_position: float = quantity("m", "reference less the nominal offset of the unit")
    reference_velocity: float = quantity("m/s", "reference of the speed")
    reference_acceleration: float = quantity("m/s²", "reference of the acceleration")
    feedforward: float = quantity("N", "force of the nominal model on the reference")
    disturbance: float = quantity("N", "estimate of the observer, > 0 forward")
    force_min: float = quantity("N", "lowest force at the measured speed")
    force_max: float = quantity("N", "largest force at the measured speed")
    shoe_force: float = quantity("N", "shoe force on the unit's vehicle, > 0 retards")
    coupler_force: float = quantity("N", "coupler force against the motion of the unit's vehicle")
    resistance: float = quantity("N", "running and line resistance of the unit's vehicle")
    share: float = quantity("1", "part of a force of the train")
    wanted: float = quantity("N", "demand of the law before the limits")
    force: float = quantity("N", "command of the last step, inside the limits")
    saturated: bool = quantity("", "the last demand was beyond a limit")
    shifted: bool = quantity("", "the other units give the force that one of them lacks")


@compiled
def are_valid(all_now: Records[LawNow], units: Records[LawUnit]) -> bool:
    """Return True if all inputs are finite and physically possible: a NaN makes a comparison of sums false."""
    now = all_now[0]
    speeds = abs(now.acceleration_at_effect) + abs(now.jerk_at_effect)
    places, forces, ordered = 0.0, abs(now.train_shoe_force) + now.sensed_force, True
    for x in units:
        speeds += abs(x.velocity) + abs(x.reference_velocity) + abs(x.reference_acceleration)
        places += abs(x.position) + abs(x.reference_position)
        forces += abs(x.force_min) + abs(x.force_max) + abs(x.feedforward) + abs(x.disturbance)
        forces += abs(x.applied) + abs(x.shoe_force)
        ordered &= x.force_min <= x.force_max
    possible = speeds <= MAX_SPEED * units.size and places <= MAX_POSITION and forces <= MAX_FORCE
    return possible and ordered and abs(now.t) <= MAX_POSITION and 0.0 <= now.delay_to_effect <= MAX_DELAY


@compiled
def limit_demands(units: Records[LawUnit]) -> bool:
    """Limit the demands of all units; return False, without a change, if one is not finite."""
    for x in units:
        if not isfinite(x.wanted):
            return False
    for x in units:
        x.force = x.force_min if x.wanted < x.force_min else x.force_max if x.wanted > x.force_max else x.wanted
        x.saturated = x.force != x.wanted
    if units[0].shifted:
        _shift_rest(units)
    return True


@compiled
def _shift_rest(units: Records[LawUnit]) -> None:
    """Give the force that units at a limit lack to the others, in proportion to their room."""
    rest, room = 0.0, 0.0
    for x in units:
        rest += x.wanted - x.force
    for x in units:
        room += (x.force_max if rest > 0.0 else x.force_min) - x.force
    if rest == 0.0 or room == 0.0:
        return
    part = min(rest / room, 1.0)
    for x in units:
        x.force += part * ((x.force_max if rest > 0.0 else x.force_min) - x.force)
        x.saturated = part == 1.0


@compiled
def limit_commands(units: Records[LawUnit]) -> int:
    """Limit the demands as :func:`limit_demands`; return 1 with a command at a limit, 0 without, -1 for no change."""
    if not limit_demands(units):
        return -1
    found = 0
    for x in units:
        found |= x.force != 0.0 and not x.force_min < x.force < x.force_max
    return found


GIVEN = (
    "position", "velocity", "applied", "reference_position", "reference_velocity", "reference_acceleration",
    "feedforward", "disturbance", "force_min", "force_max", "shoe_force",
)  # fmt: skip
"""Inputs of the units with the same name in the contract and in the record, whose first fields they are."""
_pack_unit, _pack_now = (Struct(f"{len(names)}d").pack_into for names in (GIVEN, dtype_of(LawNow).fields or ()))


def all_within(values: Array, bound: float) -> bool:
    """Return True if all entries are finite and at most ``bound`` in magnitude."""
    for value in values.tolist():  # noqa: SIM110  (0.35 us less than all() with a generator, ten calls per tick)
        if not -bound <= value <= bound:
            return False
    return True


def is_valid_state(state: Measurement) -> bool:
    """Return True if position, speed and force of every unit are finite and physically possible."""
    return (
        all_within(state.position, MAX_POSITION)
        and all_within(state.velocity, MAX_SPEED)
        and all_within(state.applied, MAX_FORCE)
    )


def is_valid_preview(preview: Preview) -> bool:
    """Return True if a preview is finite and physically possible; an empty one is valid."""
    count = preview.velocity.size
    return not count or (
        sum(map(abs, preview.position.tolist())) <= MAX_POSITION * count
        and sum(map(abs, preview.velocity.tolist())) <= MAX_SPEED * count
        and sum(map(abs, preview.acceleration.tolist())) <= MAX_SPEED * count
    )


@compiled
def _are_within(arrays: Any, bound: float) -> bool:
    """Return True if all values of a tuple of arrays are finite and at most ``bound`` in magnitude."""
    found = True
    for values in arrays:
        for value in values:
            found &= abs(value) <= bound
    return found


def is_valid_lookahead(lookahead: Lookahead) -> bool:
    """Return True if a lookahead is finite and physically possible; an empty one is valid."""
    a = lookahead
    return not a.velocity.size or bool(
        a.position_max >= -MAX_POSITION
        and _are_within((a.position,), MAX_POSITION)
        and _are_within((a.velocity, a.acceleration, a.speed_limit), MAX_SPEED)
        and _are_within((a.resistance, a.force_min.ravel(), a.force_max.ravel(), a.simulated_force), MAX_FORCE)
    )


def write_inputs(i: LawInput, now: Any, units: Any, line_force: float = 0.0) -> bool:
    """Write the inputs of a law and the line force [N] in its records; return False for a wrong part that they lack."""
    for u in range(units.size):  # 0.7 us a unit; 10 assignments to fields take 3
        _pack_unit(
            units, u * units.itemsize, i.position.item(u), i.velocity.item(u), i.applied.item(u),
            i.reference_position.item(u), i.reference_velocity.item(u), i.reference_acceleration.item(u),
            i.feedforward.item(u), i.disturbance.item(u), i.force_min.item(u), i.force_max.item(u),
            i.shoe_force.item(u),
        )  # fmt: skip
    sensed = 0.0
    for force in i.coupler_force.tolist():
        sensed += abs(force)
    _pack_now(
        now, 0, i.t, i.acceleration_at_effect, i.jerk_at_effect, i.delay_to_effect, line_force, i.train_shoe_force,
        sensed,
    )  # fmt: skip
    return is_valid_preview(i.preview) and is_valid_lookahead(i.lookahead)


def is_valid(inputs: LawInput) -> bool:
    """Return True if all inputs of a law are finite and physically possible."""
    now, units = zeros(LawNow, 1), zeros(LawUnit, inputs.position.size)
    return write_inputs(inputs, now, units) and bool(are_valid(now, units))


def invalid_inputs(inputs: LawInput) -> list[str]:
    """Return the names of the inputs that make :func:`is_valid` False."""
    bounds = {"t": MAX_POSITION, "position": MAX_POSITION, "reference_position": MAX_POSITION}
    bounds |= dict.fromkeys(
        ("velocity", "reference_velocity", "reference_acceleration", "acceleration_at_effect", "jerk_at_effect"),
        MAX_SPEED,
    )
    bounds |= dict.fromkeys(
        ("feedforward", "disturbance", "applied", "coupler_force", "shoe_force", "train_shoe_force"), MAX_FORCE
    )
    found = [name for name, bound in bounds.items() if not all_within(np.atleast_1d(getattr(inputs, name)), bound)]
    if not 0.0 <= inputs.delay_to_effect <= MAX_DELAY:
        found.append("delay_to_effect")
    if not is_valid_preview(inputs.preview):
        found.append("preview")
    if not is_valid_lookahead(inputs.lookahead):
        found.append("lookahead")
    limits = valid_limits(inputs.force_min.tolist(), inputs.force_max.tolist())
    return found or ["their sum" if limits else "force_min, force_max"]


def valid_limits(low: Sequence[float], high: Sequence[float]) -> bool:
    """Return True if the limits are finite and ordered."""
    return all(-MAX_FORCE <= a <= b <= MAX_FORCE for a, b in zip(low, high, strict=True))


class GuardedLaw:
    """Base of the laws: a subclass computes ``demand()``, this class checks inputs and limits the output.

    Parameters
    ----------
    parameters
        Parameters of the law.
    model
        The nominal train.
    period
        Control period [s].

    Attributes
    ----------
    saturated : list of bool
        Units whose last demand was beyond a limit; integrators and weights are held meanwhile.
    horizon : int
        Number of entries of the preview that the law uses.
    uses_feedforward, feedforward_hint, predicts_delay, delay_hint
        See :class:`train_ato.control.contract.Law`.
    share : list of float
        Part of a total force for every unit.
    """

    horizon = 0
    uses_feedforward = True
    feedforward_hint = ""
    predicts_delay = False
    delay_hint = ""

    def __init__(self, parameters: Any, model: TrainModel, period: float) -> None:
        self.parameters = parameters
        GuardedLaw.bind(self, model, period)

    def bind(self, model: TrainModel, period: float) -> None:
        """Set the model and the control period [s]; a law with keyword parameters is initialised only here."""
        self.model = model
        self.period = period
        self.n = model.n_units
        self.share: list[float] = model.share.tolist()
        self.saturated = [False] * self.n
        self._last_force = [0.0] * self.n
        self._records = zeros(LawNow, 1), zeros(LawUnit, self.n)
        self._records[1]["share"], self._records[1]["shifted"] = model.share, model.uneven

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force demand of every unit [N] for valid inputs."""
        raise TypeError(f"{type(self).__name__} has no demand()")

    def clear_state(self) -> None:
        """Clear the state of the law."""

    def planned(self) -> LawPlan | None:
        """Return the plan of the last demand; None for a law without a plan."""
        return None

    def mean(self, values: list[float]) -> float:
        """Return the mean over the units, weighted by their shares."""
        return values[0] if len(values) == 1 else mean_over_units(self.share, values)

    def on_missed_sample(self) -> None:
        """Handle a missed sample: difference quotients must not bridge it."""

    def reset(self) -> None:
        """Clear all state, including the last demand."""
        if "_records" not in vars(self):
            raise TypeError("its bind() does not call super().bind(model, period)")
        self.clear_state()
        units = self._records[1].size  # a law may count its steps in self.n
        self.saturated, self._last_force = [False] * units, [0.0] * units

    def take_over(self, inputs: LawInput, force: Array) -> None:
        """Begin at the last command [N], shape (units,), in place of 0; laws with integrals set these in addition."""
        self._last_force = force.tolist()

    def step(self, inputs: LawInput) -> LawOutput:
        """Return the force demand of every unit [N], finite and inside the limits."""
        now, units = self._records
        if not (write_inputs(inputs, now, units) and are_valid(now, units)):
            self.on_missed_sample()
            return self._hold(inputs, f"invalid inputs: {', '.join(invalid_inputs(inputs))}")
        wanted = self.demand(inputs)
        try:
            given = np.asarray(wanted)
        except ValueError:  # rows of several lengths
            given = np.array(wanted, dtype=object)
        if given.shape != units.shape or given.dtype.kind not in "fiu":  # one number would count for every unit
            return LawOutput(given)  # the loop refuses it with the place of demand()
        units["wanted"] = given
        if not limit_demands(units):
            self.clear_state()
            return self._hold(inputs, f"computed {str(wanted)[:60]} N")
        self._last_force, self.saturated = units["force"].tolist(), units["saturated"].tolist()
        return LawOutput(np.array(self._last_force), plan=self.planned())

    def _hold(self, inputs: LawInput, reason: str) -> LawOutput:
        """Return the last demand, inside the limits if these are valid."""
        low, high, force = inputs.force_min.tolist(), inputs.force_max.tolist(), self._last_force
        return LawOutput(np.array(within_limits(force, low, high) if valid_limits(low, high) else force), held=reason)


def within_limits(force: list[float], low: list[float], high: list[float]) -> list[float]:
    """Return forces clipped to the limits of their units [N]."""
    return [min(max(each, least), most) for each, least, most in zip(force, low, high, strict=True)]
