"""Observation of the environment by name and unit: the knowledge of the onboard ATO, not the truth.

After a lost measurement its values are NaN, as for a law.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from train_ato.control.algorithms.limits_ahead import LimitsAhead
from train_ato.control.command_history import CommandHistory
from train_ato.control.parameters import closest
from train_ato.loop.controller import ControllerStage, Received
from train_ato.loop.setup import RunSetup
from train_ato.messages.layout import FIXED_NAMES, Owner
from train_ato.messages.types import Array, Measurement

DISTANCES = (0.0, 50.0, 100.0, 200.0, 400.0, 800.0, 1600.0)
"""Distances ahead of vehicle 0's centre for limits and gradients [m]."""
STEEPEST = 300.0
"""Bound of the gradients [per mille]."""
MAX_DEFLECTION, MAX_COUPLER_FORCE = 10.0, 1e8
"""Bounds of the deflection [m] and of the force [N] of a coupler."""
MAX_ACCELERATION = 10.0
"""Bound of the acceleration of the reference [m/s²]."""
MARGIN = 2.0
"""Bound of speeds and forces over the largest of train and line."""
UNKNOWN = np.full(3, np.nan)
"""Reference before its first message has arrived."""
BRAKES = FIXED_NAMES[Owner.BRAKE_LINE]
LIMITS = FIXED_NAMES[Owner.SUPERVISED_SPEED][1:]


@dataclass
class Known:
    """Knowledge of the ATO at a step.

    Attributes
    ----------
    received : Received
        Messages that have arrived.
    in_flight : Array, shape (d, units)
        Commands sent and not yet in effect [N].
    engaged : bool
        True if the ATO is engaged: the force of the caller drives.
    brakes, limits : Array
        Newest traction cut-off, service and emergency brake (1: in effect), and supervised speed limits [m/s].
    direction : float
        Direction of the reference along the line, at rest that of the last motion: 1 or -1.
    """

    received: Received
    in_flight: Array
    engaged: bool = True
    brakes: Array = field(default_factory=lambda: np.zeros(len(BRAKES)))
    limits: Array = field(default_factory=lambda: np.zeros(len(LIMITS)))
    direction: float = 1.0

    @property
    def measurement(self) -> Measurement:
        """Newest measurement."""
        return self.received.measurement

    @property
    def reference(self) -> Array:
        """Position [m], speed [m/s] and acceleration [m/s²] of vehicle 0's centre."""
        found = self.received.reference
        return UNKNOWN if found is None else np.array((found.position, found.velocity, found.acceleration))

    @classmethod
    def of(cls, controller: ControllerStage) -> Known:
        """Return the knowledge at the first step."""
        return cls(controller.received, controller.in_flight)

    def take(self, controller: ControllerStage) -> None:
        """Take the messages of a step; those of the supervisor are kept between its steps."""
        received = self.received = controller.received
        self.in_flight = controller.in_flight
        self.engaged = controller.ato.drives and not controller.ato.assured
        if received.protection is not None:
            self.brakes = received.protection.active
        if received.speeds is not None:
            self.limits = received.speeds.speed[1:]
        if received.reference is not None and received.reference.velocity != 0.0:
            self.direction = float(np.sign(received.reference.velocity))


@dataclass(frozen=True)
class Quantity:
    """One quantity of the observation.

    Attributes
    ----------
    name, unit, meaning : str
        Name, unit of the values, and description.
    low, high : Array, shape (k,)
        Bounds of its values, from train and line.
    read : callable
        Returns its values, shape (k,).
    """

    name: str
    unit: str
    meaning: str
    low: Array
    high: Array
    read: Callable[[Known], Array] = field(repr=False)


def observed(setup: RunSetup, names: Sequence[str] | None = None) -> dict[str, Quantity]:
    """Return quantities of a run by name, in the order of the flat vector.

    Parameters
    ----------
    setup
        Prepared run.
    names
        Chosen quantities; None: all that the run has.

    Raises
    ------
    ValueError
        For an unknown name.
    """
    found = (*_of_train(setup), *_of_line(setup), *_of_supervisor(setup))
    known = {entry.name: entry for entry in found if entry.low.size}
    for name in names or ():
        if name not in known:
            raise ValueError(f"observe: unknown quantity '{name}'{closest(name, tuple(known))}; use {', '.join(known)}")
    return known if names is None else {name: known[name] for name in names}


def _within(name: str, unit: str, meaning: str, bound: Array, read: Callable[[Known], Array]) -> Quantity:
    return Quantity(name, unit, meaning, -bound, bound, read)


def _of_train(setup: RunSetup) -> Iterator[Quantity]:
    """Measurement, reference, errors, estimate, force limits and commands in flight."""
    model, offsets = setup.model, setup.model.offsets
    begin, end = setup.line.begin - 2.0 * setup.consist.length, setup.line.end + setup.consist.length
    one, each, sensors = np.ones(1), np.ones(model.n_units), np.ones(len(setup.layout.sensors))
    limits = [limit.speed for limit in setup.line.restricted_limits]
    fastest = MARGIN * max([float(np.abs(setup.profile.velocity).max()), *limits])
    least = -np.array([envelope.largest() for envelope in model.brake])
    most = np.array([envelope.largest() for envelope in model.traction])
    forces = MARGIN * np.maximum(most, -least)
    flight = CommandHistory(model, setup.tick).in_flight().shape[0]
    length = end - begin
    yield Quantity("time", "s", "time since the start", 0.0 * one, setup.ticks * setup.tick * one,
                   lambda k: np.array((k.measurement.stamp * 1e-9,)))  # fmt: skip
    yield Quantity("position", "m", "measured centre of every unit along the line", begin * each, end * each,
                   lambda k: k.measurement.position)  # fmt: skip
    yield _within("speed", "m/s", "measured speed of every unit", fastest * each, lambda k: k.measurement.velocity)
    yield _within("force", "N", "measured force of every unit", forces, lambda k: k.measurement.applied)
    yield _within("coupler_deflection", "m", "measured deflection of every coupler with a sensor, > 0 draft",
                  MAX_DEFLECTION * sensors, lambda k: k.measurement.deflection)  # fmt: skip
    yield _within("coupler_rate", "m/s", "measured rate of the deflection", fastest * sensors,
                  lambda k: k.measurement.rate)  # fmt: skip
    yield _within("coupler_force", "N", "measured force, > 0 draft", MAX_COUPLER_FORCE * sensors,
                  lambda k: k.measurement.force)  # fmt: skip
    yield Quantity("reference_position", "m", "reference of vehicle 0's centre", begin * one, end * one,
                   lambda k: k.reference[:1])  # fmt: skip
    yield _within("reference_speed", "m/s", "its speed", fastest * one, lambda k: k.reference[1:2])
    yield _within("reference_acceleration", "m/s²", "its acceleration", MAX_ACCELERATION * one,
                  lambda k: k.reference[2:])  # fmt: skip
    yield _within("position_error", "m", "position minus reference of every unit", length * each,
                  lambda k: k.measurement.position + offsets - k.reference[0])  # fmt: skip
    yield _within("speed_error", "m/s", "speed minus reference of every unit", 2.0 * fastest * each,
                  lambda k: k.measurement.velocity - k.reference[1])  # fmt: skip
    yield _within("disturbance", "N", "estimate of the observer, > 0 forward", MAX_COUPLER_FORCE * each,
                  lambda k: 0.0 * offsets if k.received.estimate is None else k.received.estimate.force)  # fmt: skip
    yield Quantity("force_min", "N", "limit of every unit at its speed in braking", least, 0.0 * each,
                   lambda k: model.force_limits(k.measurement.velocity)[0])  # fmt: skip
    yield Quantity("force_max", "N", "limit of every unit at its speed in traction", 0.0 * each, most,
                   lambda k: model.force_limits(k.measurement.velocity)[1])  # fmt: skip
    yield Quantity("commands_in_flight", "N", "commands sent and not yet in effect, oldest first, unit by unit",
                   np.tile(least, flight), np.tile(most, flight), lambda k: k.in_flight.ravel())  # fmt: skip


def _of_line(setup: RunSetup) -> Iterator[Quantity]:
    """Way to the end, limits and gradients at :data:`DISTANCES` ahead."""
    model, line, end = setup.model, setup.line, float(setup.profile.position[-1])
    ahead, weight, offset = LimitsAhead(model), model.mass * setup.consist.gravity, float(model.offsets[0])
    limits = [limit.speed for limit in line.restricted_limits]
    most = np.full(len(DISTANCES), max(limits, default=0.0))
    distances = np.array(DISTANCES)

    def places(known: Known) -> Array:
        return np.asarray(known.measurement.position[0] + offset + known.direction * distances)

    def gradients(known: Known) -> Array:
        ahead = places(known)
        if not np.isfinite(ahead[0]):
            return ahead
        return np.array([1e3 / weight * model.line_force(place) for place in ahead.tolist()])

    length = np.array((line.end - line.begin + 3.0 * setup.consist.length,))
    yield _within("distance_to_end", "m", "way of vehicle 0's centre to the end of the profile", length,
                  lambda k: k.direction * (end - offset - k.measurement.position[:1]))  # fmt: skip
    if limits:
        yield Quantity("limits_ahead", "m/s", f"lowest limit over the train {DISTANCES} m ahead", 0.0 * most, most,
                       lambda k: ahead.speed_limit(places(k)))  # fmt: skip
    yield _within("gradients_ahead", "per mille", f"grade, curve and tunnel over the train {DISTANCES} m ahead",
                  STEEPEST + 0.0 * most, gradients)  # fmt: skip


def _of_supervisor(setup: RunSetup) -> Iterator[Quantity]:
    """State of the ATO, brakes and limits of the supervisor; nothing without one."""
    if not setup.layout.supervised:
        return
    limits_of_line = [limit.speed for limit in setup.line.restricted_limits]
    fastest = MARGIN * max([float(np.abs(setup.profile.velocity).max()), *limits_of_line])
    brakes, limits = np.ones(len(BRAKES)), np.ones(len(LIMITS))
    yield Quantity("ato_engaged", "", "1: the force of the caller drives", np.zeros(1), np.ones(1),
                   lambda k: np.array((float(k.engaged),)))  # fmt: skip
    yield Quantity("brakes", "", "1: in effect; traction cut-off, service brake, emergency brake", 0.0 * brakes, brakes,
                   lambda k: k.brakes)  # fmt: skip
    yield Quantity("supervised_limits", "m/s", f"limits of the supervisor: {', '.join(LIMITS)}", 0.0 * limits,
                   fastest * limits, lambda k: k.limits)  # fmt: skip


def flat_vector(values: dict[str, Array]) -> Array:
    """Return an observation as one vector."""
    return np.concatenate(list(values.values()))
