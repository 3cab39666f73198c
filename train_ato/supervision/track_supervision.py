"""Supervision of a train on a line: all targets and ceiling limits, evaluated at a position and a motion.

Everything that depends on train and line only is computed once. The evaluation of a tick is a search in the limits and
a closed form per braking curve near the train.
"""

# mypy: no-warn-return-any

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import floor, inf, isnan, nan
from typing import Any, NamedTuple

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.record import Records, quantity, zeros
from train_ato.supervision.deceleration_curve import Arc
from train_ato.supervision.limits import (
    BrakingTarget,
    Target,
    TargetLimits,
    indication_location,
    release_location,
    target_speeds,
)
from train_ato.supervision.odometry import EXACT_MOTION, MotionEstimate, odometer_error, speed_measurement_error
from train_ato.supervision.settings import FixedValues
from train_ato.supervision.step_function import SupervisionSpeeds, ceiling_speeds, gradient_acceleration
from train_ato.supervision.train_model import SupervisedTrain

WIDEST_ACCELERATION, WIDEST_SPEED_ERROR, WIDEST_POSITION_ERROR = 0.5, 3.0, 2500.0
"""Acceleration [m/s²], speed error [m/s] and position errors [m] for which the begin of a target is computed.

With a wider motion all targets are evaluated.
"""
WIDEST_MOTION = MotionEstimate(WIDEST_ACCELERATION, WIDEST_SPEED_ERROR, WIDEST_POSITION_ERROR, WIDEST_POSITION_ERROR)
"""Motion of these values."""
CURVE_ENDS, NOT_INDICATED, INDICATED = -1, 0, 1
"""Results of :func:`indicated`."""


@dataclass
class Ceiling:
    """Ceiling speeds from a place on."""

    start: float = quantity("m", "begin, minus infinity for the first")
    permitted: float = quantity("m/s", "permitted speed")
    warning: float = quantity("m/s", "speed of the warning")
    service: float = quantity("m/s", "speed of the service-brake intervention")
    emergency: float = quantity("m/s", "speed of the emergency-brake intervention")


class LineLimits(NamedTuple):
    """Limits of a train on a line as records: ceilings by place, targets by location, arcs of their curves."""

    ceilings: Records[Ceiling]
    targets: Records[Target]
    arcs: Records[Arc]


@compiled
def ceiling(ceilings: Records[Ceiling], low: float, high: float) -> SupervisionSpeeds:
    """Return the ceiling speeds [m/s] of the lowest limit between two front positions [m]."""
    best = 0
    while best + 1 < ceilings.size and ceilings[best + 1].start <= low:
        best += 1
    row = best + 1
    while row < ceilings.size and ceilings[row].start <= high:
        if ceilings[row].permitted < ceilings[best].permitted:
            best = row
        row += 1
    found = ceilings[best]
    return SupervisionSpeeds(found.permitted, found.warning, found.service, found.emergency)


@compiled
def first_ahead(targets: Records[Target], foremost: float) -> int:
    """Return the number of the first target at or beyond the max safe front [m]."""
    first = 0
    while first < targets.size and targets[first].location < foremost:
        first += 1
    return first


@compiled
def is_wider(motion: MotionEstimate) -> bool:
    """Return True for a motion with an earlier begin of the targets than that of :data:`WIDEST_MOTION`."""
    if motion.acceleration > WIDEST_ACCELERATION or motion.speed_error > WIDEST_SPEED_ERROR:
        return True
    return motion.under_reading > WIDEST_POSITION_ERROR


@compiled
def released_speeds(target: Target, arcs: Records[Arc], front: float, motion: MotionEstimate) -> SupervisionSpeeds:
    """Return the speeds of one target [m/s]; they include the release speed after its start location."""
    speed = target.release
    if speed < inf:
        start = release_location(target, arcs, speed, speed_measurement_error(speed), motion.under_reading)
        if front >= start:
            return SupervisionSpeeds(speed, speed, speed, speed)
    return target_speeds(target, arcs, front, motion)


@compiled
def most_restrictive(track: LineLimits, front: float, motion: MotionEstimate) -> SupervisionSpeeds:
    """Return the most restrictive speeds of the limits [m/s] at an estimated front position [m]."""
    foremost, targets = front + motion.under_reading, track.targets
    speeds = ceiling(track.ceilings, front - motion.over_reading, foremost)
    first = first_ahead(targets, foremost)
    if first == targets.size > 0 and targets[first - 1].is_end:
        first -= 1  # an end of authority stays supervised when the train has passed it
    for index in range(first, targets.size):
        if front < targets[index].begin and not is_wider(motion):
            break
        found = released_speeds(targets[index], track.arcs, front, motion)
        speeds = SupervisionSpeeds(
            min(speeds.permitted, found.permitted),
            min(speeds.warning, found.warning),
            min(speeds.service, found.service),
            min(speeds.emergency, found.emergency),
        )
    return speeds


@compiled
def speeds_to_end(targets: Any, arcs: Any, fronts: Any, balise_spacing: float) -> Any:
    """Return the permitted speeds up to the end of authority [m/s] at front positions [m]; infinite without an end.

    The train has a constant speed, and the largest error of its odometer since a balise.
    """
    found, last = np.full(fronts.size, inf), targets.size - 1
    if last >= 0 and targets[last].is_end:
        for k in range(fronts.size):
            error = odometer_error(fronts[k] - balise_spacing * floor(fronts[k] / balise_spacing))
            motion = MotionEstimate(0.0, speed_measurement_error(0.0), error, error, nan)
            found[k] = released_speeds(targets[last], arcs, fronts[k], motion).permitted
    return found


@compiled
def indicated(track: LineLimits, front: float, speed: float, motion: MotionEstimate) -> int:
    """Return ``INDICATED`` beyond the indication of a target, ``CURVE_ENDS`` for a curve that ends below the speed."""
    foremost, targets = front + motion.under_reading, track.targets
    for index in range(first_ahead(targets, foremost), targets.size):
        target = targets[index]
        if front < target.begin and not is_wider(motion):
            return NOT_INDICATED
        if speed > target.speed:
            place = indication_location(target, track.arcs, speed, motion)
            if isnan(place):
                return CURVE_ENDS
            if foremost >= place:
                return INDICATED
    return NOT_INDICATED


def limits_under_train(limits: Sequence[tuple[float, float]], length: float) -> list[tuple[float, float]]:
    """Return the most restrictive speed profile over the front position: 3.13.7.

    Parameters
    ----------
    limits
        Pairs of start [m] and speed limit [m/s] by rising start; a limit holds for the whole length of the train.
    length
        Length of the train [m].
    """
    if not limits:
        return []
    ends = [start for start, _ in limits[1:]] + [float("inf")]
    pieces = [(start, end + length, speed) for (start, speed), end in zip(limits, ends, strict=True)]
    places = sorted({place for start, end, _ in pieces for place in (start, end) if place != float("inf")})
    profile: list[tuple[float, float]] = []
    for place in places:
        speed = min(speed for start, end, speed in pieces if start <= place < end)
        if not profile or profile[-1][1] != speed:
            profile.append((place, speed))
    return profile


class TrackSupervision:
    """Supervision limits of a train over a line.

    Parameters
    ----------
    train
        Train data.
    grades
        Pairs of start [m] and grade [‰, > 0 uphill].
    speed_limits
        Pairs of start [m] and speed limit [m/s] by rising start; before the first one the maximum speed holds.
    end
        End of authority and supervised location.
    release
        Release speed near the end of authority [m/s]; None: none is supervised.

    Attributes
    ----------
    targets : list of TargetLimits
        Lower speed limits and the end of authority, by rising location.
    records : LineLimits
        All limits as records.
    without_service_curve : str or None
        Reason of a missing service-brake curve to the end of authority, which the emergency-brake curve then
        supervises alone; None if there is one.

    Raises
    ------
    ValueError
        If the brake is weaker than the gradient in front of a target.
    """

    def __init__(
        self,
        train: SupervisedTrain,
        grades: Sequence[tuple[float, float]],
        speed_limits: Sequence[tuple[float, float]],
        end: BrakingTarget | None,
        *,
        release: float | None = None,
    ) -> None:
        self.train, self._fixed = train, FixedValues()
        profile = [
            (place, min(speed, train.max_speed)) for place, speed in limits_under_train(speed_limits, train.length)
        ]
        ceilings = zeros(Ceiling, 1 + len(profile))
        for record, (place, speed) in zip(ceilings, [(-inf, train.max_speed), *profile], strict=True):
            record["start"] = place
            for name, value in ceiling_speeds(speed)._asdict().items():
                record[name] = value
        self._ceilings, self._limits_by_place = ceilings, profile
        self._gradient = gradient_acceleration(grades, train.length, train.m_rotating_nom, self._fixed)
        self._release = inf if release is None else release
        self._known: dict[float, TargetLimits] = {}
        self.targets: list[TargetLimits] = []
        self.without_service_curve: str | None = None
        self.records: LineLimits
        self.move_end(end)

    @property
    def end(self) -> float:
        """Present end of authority [m], infinite without one."""
        last = self.targets[-1].target if self.targets else None
        return last.location if last is not None and last.kind == "EOA" else inf

    def move_end(self, end: BrakingTarget | None) -> None:
        """Replace the end of authority; the limits of the line remain, those beyond it do not hold."""
        self.targets, previous = [], self.train.max_speed
        for place, speed in self._limits_by_place:
            if speed < previous and (end is None or place < end.location):
                if place not in self._known:
                    target = BrakingTarget(place, speed)
                    self._known[place] = TargetLimits(self.train, target, self._gradient, self._fixed, previous)
                self.targets.append(self._known[place])
            previous = speed
        self.without_service_curve = None
        if end is not None:
            self.targets.append(self._end_limits(end))
        arcs = zeros(Arc, sum(limits.arcs.size for limits in self.targets))
        self.records = LineLimits(self._ceilings, zeros(Target, len(self.targets)), arcs)
        self._join_targets()

    def _join_targets(self) -> None:
        """Fill the records of the targets; a begin is the smallest one of this target and all later ones [m]."""
        targets: Any = self.records.targets
        arcs: Any = self.records.arcs
        end, begin, top = arcs.size, inf, float(self._ceilings["emergency"][0])
        for index, limits in reversed(list(enumerate(self.targets))):
            first = end - limits.arcs.size
            arcs[first:end] = limits.arcs
            try:
                begin = min(limits.indication(top, WIDEST_MOTION) - WIDEST_POSITION_ERROR, begin)
            except ValueError:  # the curve ends below the compensated speed
                begin = -inf
            targets[index : index + 1] = limits.record
            record = targets[index]
            for name in ("ebd_first", "ebd_end", "sbd_first", "sbd_end"):
                record[name] += first
            record["begin"], record["release"] = begin, self._release if record["is_end"] else inf
            end = first

    def _end_limits(self, end: BrakingTarget) -> TargetLimits:
        """Return the limits of the end of authority; without SBD if the service brake is missing or too weak."""
        if self.train.brake.service is None:
            self.without_service_curve = "the train has no service deceleration"
        try:
            return TargetLimits(self.train, end, self._gradient, self._fixed)
        except ValueError as error:
            self.without_service_curve = str(error)
            alone = replace(self.train, brake=replace(self.train.brake, service=None))
            return TargetLimits(alone, end, self._gradient, self._fixed)

    def evaluate(self, front: float, motion: MotionEstimate = EXACT_MOTION) -> SupervisionSpeeds:
        """Return the most restrictive speeds of the limits [m/s] at an estimated front position [m].

        Parameters
        ----------
        front
            Estimated position of the front [m].
        motion
            Acceleration and errors of the odometry.
        """
        found: SupervisionSpeeds = most_restrictive(self.records, front, motion)
        return found

    def indicates(self, front: float, speed: float, motion: MotionEstimate = EXACT_MOTION) -> bool:
        """Return True if the train has passed the indication of a target.

        Parameters
        ----------
        front, speed
            Estimated front position [m] and speed [m/s].
        motion
            Acceleration and errors of the odometry.
        """
        found: int = indicated(self.records, front, speed, motion)
        if found == CURVE_ENDS:
            for limits in self.targets:
                limits.indication(speed, motion)
        return found == INDICATED
