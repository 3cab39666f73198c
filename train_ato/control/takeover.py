"""Change of who commands the train: the demand begins at the last force and follows with limited jerk.

The largest change of the demand of a unit in one tick is jerk x inertia x share x tick. The jerk is that of the
profile, at most ``limits.jerk`` of the scenario: a recorded profile has jumps of the acceleration.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from plant_sim.elementary import plain_sum
from plant_sim.gears import RigidGear
from train_ato.control.algorithms.train_constants import mean_stiffness
from train_ato.control.contract import LawInput, ProfileLike
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array

DEFAULT_JERK = 0.5
"""Largest jerk of a takeover without a limit in the scenario [m/s³]; the default of a plan."""
TRANSITION_TIME = 3.0
"""Time after a change of the law for which the largest change holds, and of a takeover by the full brake [s]."""
DOUBLING_TIME = 1.0
"""Time in which the largest change doubles after ``TRANSITION_TIME``, if the law is still not reached [s]."""
JOINING_TIME = 20.0
"""Time in which the speed error at a change of the law is removed, if there is time for it [s]."""
JOINING_SPEED = 0.14
"""Largest speed error of this motion [m/s]: 0.5 km/h, the excess speed that the shipped scenarios permit."""
MIDDLE_SPEED = 1.5
"""Largest speed of the motion that removes a position error, in its middle, over position per time."""
MAX_JOINING = 112.0
"""Longest time in which the position error is removed [s].

The largest one, ``JOINING_SPEED`` x ``JOINING_TIME`` / 1.5, then causes a speed error of 0.025 m/s, half of the noise
of a speed sensor. That of a small one stays below the errors of precise laws, which a fixed speed would not.
"""
MIN_COMMANDS = 4
"""Least number of commands with a mean that lasts."""
MIN_LOAD = 1e-6
"""Part of the force of a train from which on a coupler is loaded, but for rounding."""
HALVINGS = 10
"""Halvings of the interval of the part of the largest change with which a demand changes early."""
AGREED = 0.999
"""Part of the largest change within which a demand is reached: a law that obeys its limits can be at the whole."""


def transition_jerk(profile: ProfileLike, limit: float) -> float:
    """Return the jerk of a takeover [m/s³]: that of the profile without its rarest per cent, at most a limit [m/s³]."""
    size = np.abs(profile.jerk())
    largest = float(size.max(initial=0.0))
    return min(float(np.percentile(size[size > 1e-3 * largest], 99.0)), limit) if largest > 0.0 else limit


def largest_change(model: TrainModel, jerk: float) -> Array:
    """Return the largest change of the demand of every unit in one tick [N]: jerk x inertia x share x tick."""
    return np.asarray(jerk * model.tick * model.inertia * model.share)


class TakeoverRamp:
    """Demand of the power units from the present force to the brake.

    The largest change follows from the jerk. It is at least large enough to reach the first wanted demand within
    ``TRANSITION_TIME``, because the brake of a heavy train with a smooth profile must not take a minute. It is larger
    still if a limit demands it.

    Parameters
    ----------
    model
        The nominal train.
    jerk
        Jerk of the train by the change of the demand [m/s³].
    force : Array, shape (units,), or None
        Force at the begin [N]; None: the first measured one.
    least_jerk
        Jerk that a limit demands [m/s³]; it does not count for the return of the law.

    Attributes
    ----------
    change : Array, shape (units,)
        Largest change in one tick without ``least_jerk`` [N].
    ended : bool
        True after the demand has reached the wanted one.
    """

    def __init__(self, model: TrainModel, jerk: float, force: Array | None = None, least_jerk: float = 0.0) -> None:
        self.change = largest_change(model, jerk)
        self._least = largest_change(model, least_jerk)
        self._share_of_time = model.tick / TRANSITION_TIME
        self._begun = False
        self._force = force
        self.ended = False

    def step(self, wanted: Array, applied: Array, highest: Array | float = np.inf) -> Array:
        """Return the demand of one tick [N].

        Parameters
        ----------
        wanted, applied : Array, shape (units,)
            Final demand, and measured force of every unit [N].
        highest : Array, shape (units,), or float
            Largest demand [N]: that of a law which brakes more.
        """
        if self._force is None:
            self._force = np.where(np.isfinite(applied), applied, 0.0)
        change = wanted - self._force
        if not self._begun:
            self._begun = True
            self.change = np.maximum(self.change, self._share_of_time * np.abs(change))
        most = np.maximum(self.change, self._least)
        self.ended = bool((np.abs(change) <= most).all())
        self._force = np.minimum(wanted if self.ended else self._force + np.clip(change, -most, most), highest)
        return self._force.copy()


class LawTransition:
    """Demand of the power units from the last command to the demand of a new law.

    The first demand is the last command. For ``TRANSITION_TIME`` the demand changes by at most the largest change, and
    then until the law is reached; meanwhile the largest change doubles in every ``DOUBLING_TIME``. A corner of the
    profile in this time begins earlier, see :meth:`early`.

    Parameters
    ----------
    change : Array, shape (units,)
        Largest change in one tick [N].
    tick
        Period of the loop [s].

    Attributes
    ----------
    lasting : int
        Ticks of ``TRANSITION_TIME``.
    beyond : Array, shape (units,), or None
        Difference between the demand of the law and the force of the profile at the begin of an early change [N].
    ended : bool
        True after the demand of the law has been reached.
    """

    def __init__(self, change: Array, tick: float) -> None:
        self._change, self._tick = change, tick
        self.lasting = round(TRANSITION_TIME / tick)
        self._ticks = 0
        self._aim: Array | None = None
        self.beyond: Array | None = None
        self._early = False
        self.ended = False

    @property
    def is_bounded(self) -> bool:
        """True for ``TRANSITION_TIME``, in which the largest change does not grow."""
        return self._ticks < self.lasting

    def reach(self, ticks: int) -> Array:
        """Return the largest change over the next ticks [N], shape (units,); 0 at the first: the last command holds."""
        if not self._ticks:
            return 0.0 * self._change
        later = max(0.0, (self._ticks - self.lasting) * self._tick)
        return np.asarray(ticks * min(2.0 ** (later / DOUBLING_TIME), 1e6) * self._change)

    def early(self, last: Array, wanted: Array, moves: Array, ticks: int) -> Array:
        """Return the part of the largest change that a demand takes now, before a corner of the profile, -1 ... 1.

        At a corner, for example at a departure, the wanted force changes faster than the largest change. An early
        change gains speed before the corner. This gain is half of the speed that the unit lacks afterwards until it has
        caught up. The speed is then as much too high at the corner as it is too low in the end. This makes the largest
        error smallest.

        Parameters
        ----------
        last : Array, shape (units,)
            Last command [N].
        wanted : Array, shape (ticks, units)
            Demands of the next ticks [N].
        moves : Array, shape (ticks, units)
            True if the profile moves at the effect of the demand; a train at rest lacks no force.
        ticks
            Ticks between two steps of the law.

        Returns
        -------
        Array, shape (units,)
            Part with the sign of the change; after this step the change is the largest one.
        """
        least, most = np.zeros(last.shape), np.ones(last.shape)
        rising, falling = (self._lacking(sign * (wanted - last), moves, most, ticks) for sign in (1.0, -1.0))
        sign, whole = np.where(rising >= falling, 1.0, -1.0), np.maximum(rising, falling)
        toward = sign * (wanted - last)
        begins = (whole > -np.inf) & (self._lacking(toward, moves, least, ticks) >= 0.0)
        self._early = bool(begins.any())
        least = np.where(whole >= 0.0, most, least)
        for _ in range(HALVINGS if self._early else 0):
            middle = 0.5 * (least + most)
            lacks = self._lacking(toward, moves, middle, ticks) >= 0.0
            least, most = np.where(lacks, middle, least), np.where(lacks, most, middle)
        return np.asarray(np.where(begins, sign * most, 0.0))

    def _lacking(self, wanted: Array, moves: Array, part: Array, ticks: int) -> Array:
        """Return the sum of the forces that a demand lacks which rises from 0 now, less twice the gained ones [N].

        It is negative if the demand lacks none.

        The demand takes a part of the largest change for some ticks, and then the whole. The sum is from the next tick
        on until the demand has caught up.
        """
        passed = np.arange(1.0, len(wanted) + 1.0)[:, None]
        lack = wanted - (np.minimum(passed, ticks) * part + np.maximum(passed - ticks, 0.0)) * self._change
        behind = np.logical_and(moves, lack > 0.0)
        begun = np.logical_or.accumulate(behind)
        caught_up = np.logical_or.accumulate(begun & (lack <= 0.0))
        lacking = np.where(behind & ~caught_up, lack, 0.0).sum(axis=0)
        gained = np.where(~caught_up, np.maximum(-lack, 0.0), 0.0).sum(axis=0)
        return np.asarray(np.where(lacking > 0.0, lacking - 2.0 * gained, -np.inf))

    def step(self, aim: list[float] | None, last: list[float], ticks: int) -> list[float]:
        """Return the demand of one tick [N].

        Parameters
        ----------
        aim
            New demand of the law [N]; None between two steps of the law.
        last
            Last command [N].
        ticks
            Ticks between two steps of the law.
        """
        now = np.array(last)
        if aim is not None:
            self._aim = np.array(aim)
            close = bool((np.abs(self._aim - now) <= AGREED * self.reach(ticks)).all())
            self.ended = close and self._ticks >= self.lasting and not self._early
            self._early = False
        if self._aim is None or self.ended:
            return last if aim is None else aim
        change = self.reach(1)
        self._ticks += 1
        sent: list[float] = (now + np.clip(self._aim - now, -change, change)).tolist()
        return sent


class JoinedReference:
    """Reference of a new law: it begins in the present state of the train and joins the profile without a jump.

    Without this a law that leaves a position error to its successor would cause a speed error that neither law has
    alone. The difference from the profile is the sum of two cubics of the time. One begins with the error of the
    position, the other with the error of the speed, up to the size that keeps ``JOINING_SPEED`` over ``JOINING_TIME``.
    Both end at 0 with slope 0. The cubic of the speed ends after ``JOINING_TIME``. The speed of the other cubic is
    largest in its middle, 1.5 times position over time. So it lasts as long as there is time, at most ``MAX_JOINING``.

    With its errors the new law would lose the force that the old law had found in them, for example against a wind. It
    is in the disturbance of the inputs, and fades as the errors come back.

    Parameters
    ----------
    inputs
        Input of the law at its first step.
    share : Array, shape (units,)
        Part of a total force for every unit.
    profile
        The speed profile: the difference ends before its next standstill.
    lasting : Array, shape (units,)
        Force that the old law added to the nominal train and to the observer and that lasts [N].
    """

    def __init__(self, inputs: LawInput, share: Array, profile: ProfileLike, lasting: Array) -> None:
        self._force = lasting
        _, speeds, _ = profile.at_times(inputs.t + np.arange(MAX_JOINING / 0.8 + 1.0))
        rests = np.flatnonzero(speeds == 0.0)
        self._until_place = 0.8 * float(rests[0]) if rests.size else MAX_JOINING
        self._begin, self._lasting, self._share = inputs.t, min(self._until_place, JOINING_TIME), share
        largest = JOINING_SPEED * self._lasting / MIDDLE_SPEED
        self._place = np.clip(inputs.position - inputs.reference_position, -largest, largest)
        self._speed = np.clip(inputs.velocity - inputs.reference_velocity, -JOINING_SPEED, JOINING_SPEED)

    def has_joined(self, t: float) -> bool:
        """Return True if the difference has ended at a time [s]."""
        return t >= self._begin + self._until_place

    def _difference(self, t: Array | float) -> tuple[Array, Array]:
        """Return the difference of position and speed for every unit [m, m/s], shape (times, units)."""
        passed = np.atleast_1d(t)[:, None] - self._begin
        s, p = (np.clip(passed / lasting, 0.0, 1.0) for lasting in (self._lasting, self._until_place))
        place = self._place * (1.0 - p) ** 2 * (1.0 + 2.0 * p) + self._lasting * self._speed * s * (1.0 - s) ** 2
        return place, (1.0 - s) * (1.0 - 3.0 * s) * self._speed - 6.0 * p * (1.0 - p) * self._place / self._until_place

    def of(self, inputs: LawInput, period: float, lookahead_times: Array | None) -> LawInput:
        """Return the inputs with this reference, for the control period [s] and the times of the lookahead [s]."""

        def of_train(part: Any, times: Array) -> Any:
            places, speeds = ((change * self._share).sum(axis=1) for change in self._difference(times))
            return replace(part, position=part.position + places, velocity=part.velocity + speeds)

        (place,), (speed,) = self._difference(inputs.t)
        preview, ahead = inputs.preview, inputs.lookahead
        if count := preview.velocity.size:
            preview = of_train(preview, inputs.t + inputs.delay_to_effect + period * np.arange(float(count)))
        if ahead.velocity.size and lookahead_times is not None:
            ahead = of_train(ahead, inputs.t + lookahead_times)
        s = min(max((inputs.t - self._begin) / self._until_place, 0.0), 1.0)
        return replace(
            inputs, reference_position=inputs.reference_position + place,
            reference_velocity=inputs.reference_velocity + speed, preview=preview, lookahead=ahead,
            disturbance=inputs.disturbance - (1.0 - s) ** 2 * (1.0 + 2.0 * s) * self._force,
        )  # fmt: skip


def is_far(place: float, speed: float) -> bool:
    """Return True for errors of place [m] and speed [m/s] beyond those that the reference of a new law takes up."""
    return abs(speed) > JOINING_SPEED or abs(place) > JOINING_SPEED * JOINING_TIME / MIDDLE_SPEED


def lasting_force(commands: Array, nominal: Array) -> Array:
    """Return the part of the last commands that lasts [N], shape (units,): their mean beyond the nominal force.

    It is reduced by the part that noise or chattering explains, (1 - variance/mean²).

    Parameters
    ----------
    commands, nominal : Array, shape (ticks, units)
        Last commands, and force of the nominal train at their effects [N].
    """
    beyond = commands - nominal
    if len(beyond) < MIN_COMMANDS:
        return np.zeros(commands.shape[1])
    mean, spread = beyond.mean(axis=0), beyond.var(axis=0)
    return np.asarray(mean * np.clip(1.0 - spread / np.maximum(mean * mean, 1e-9), 0.0, 1.0))


def stretches(model: TrainModel, profile: ProfileLike, t: float) -> bool:
    """Return True at a time [s] of a departure at which the last vehicles do not move with the train yet.

    The way of the units until then is at most the slack of the loaded couplers and their stretch. A coupler has the
    force of the profile on the vehicles behind it, less that of the units there. Meanwhile the force of the units is
    that of the vehicles in motion.
    """
    places, speeds, accelerations = profile.at_times(t - np.arange(MAX_JOINING))
    rests = np.flatnonzero(speeds == 0.0)
    if not rests.size or not rests[0]:
        return False
    shares = np.array([vehicle.mass for vehicle in model.consist.vehicles]) / model.mass
    shares[list(model.units)] -= model.share
    force = abs(model.rigid_force(float(places[0]), float(speeds[0]), float(accelerations[0])))
    loads = force * np.abs(np.cumsum(shares))[:-1]
    loaded = zip(loads.tolist(), model.consist.gears, strict=True)
    ways = [
        gear.slack + load / mean_stiffness(gear)
        for load, gear in loaded
        if not isinstance(gear, RigidGear) and load > MIN_LOAD * force
    ]
    return bool(places[0] - places[rests[0]] < plain_sum(ways))
