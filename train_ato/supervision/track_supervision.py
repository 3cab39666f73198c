"""Supervision of a train on a line: all targets and ceiling limits, evaluated at a position and a motion.

Everything that depends on train and line only is computed once. The evaluation of a tick is a search in the limits and
a closed form per braking curve near the train.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import replace

from train_ato.supervision.ceiling import SupervisionSpeeds, ceiling_speeds
from train_ato.supervision.fixed_values import FixedValues
from train_ato.supervision.gradient import gradient_acceleration
from train_ato.supervision.limits import BrakingTarget, TargetLimits
from train_ato.supervision.odometry import EXACT_MOTION, MotionEstimate
from train_ato.supervision.release_speed import release_start
from train_ato.supervision.step_function import StepFunction
from train_ato.supervision.train_model import SupervisedTrain

WIDEST_MOTION = MotionEstimate(0.5, 3.0, 2500.0, 2500.0)
"""Motion for which the begin of a target is computed: acceleration [m/s²], speed error [m/s], position errors [m].

With a wider motion all targets are evaluated.
"""


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
    fixed
        Fixed values.
    release
        Release speed near the end of authority [m/s]; None: none is supervised.

    Attributes
    ----------
    targets : list of TargetLimits
        Lower speed limits and the end of authority, by rising location.
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
        fixed: FixedValues | None = None,
        release: float | None = None,
    ) -> None:
        self.train, fixed = train, fixed or FixedValues()
        profile = [
            (place, min(speed, train.max_speed)) for place, speed in limits_under_train(speed_limits, train.length)
        ]
        self._starts = [place for place, _ in profile]
        self._ceilings = [ceiling_speeds(speed) for speed in (train.max_speed, *(speed for _, speed in profile))]
        gradient = gradient_acceleration(grades, train.length, train.m_rotating_nom, fixed)
        self.targets: list[TargetLimits] = []
        previous = train.max_speed
        for place, speed in profile:
            if speed < previous and (end is None or place < end.location):
                target = BrakingTarget(place, speed)
                self.targets.append(TargetLimits(train, target, gradient, fixed, previous))
            previous = speed
        self.without_service_curve: str | None = None
        if end is not None:
            self.targets.append(self._end_limits(end, gradient, fixed))
        self._release = None if release is None else SupervisionSpeeds(release, release, release, release)
        self._locations = [limits.target.location for limits in self.targets]
        self._begins = self._begins_of_rest(self._ceilings[0].emergency)

    def _begins_of_rest(self, top: float) -> list[float]:
        """Return the smallest begin of the indication [m] of each target and all later ones, at a top speed [m/s]."""
        begins: list[float] = []
        for limits in reversed(self.targets):
            try:
                begin = limits.indication(top, WIDEST_MOTION) - WIDEST_MOTION.under_reading
            except ValueError:  # the curve ends below the compensated speed
                begin = -float("inf")
            begins.append(min([begin, *begins[-1:]]))
        return begins[::-1]

    def _end_limits(self, end: BrakingTarget, gradient: StepFunction, fixed: FixedValues) -> TargetLimits:
        """Return the limits of the end of authority; without SBD if the service brake is missing or too weak."""
        train = self.train
        if train.brake.service is None:
            self.without_service_curve = "the train has no service deceleration"
            return TargetLimits(train, end, gradient, fixed)
        try:
            return TargetLimits(train, end, gradient, fixed)
        except ValueError as error:
            self.without_service_curve = str(error)
            alone = replace(train, brake=replace(train.brake, service=None))
            return TargetLimits(alone, end, gradient, fixed)

    def ceiling(self, low: float, high: float) -> SupervisionSpeeds:
        """Return the ceiling speeds [m/s] of the lowest limit between two front positions [m]."""
        first, last = bisect_right(self._starts, low), bisect_right(self._starts, high)
        return self._ceilings[first] if first == last else min(self._ceilings[first : last + 1], key=_permitted)

    def evaluate(self, front: float, motion: MotionEstimate = EXACT_MOTION) -> SupervisionSpeeds:
        """Return the most restrictive speeds of the limits [m/s] at an estimated front position [m].

        Parameters
        ----------
        front
            Estimated position of the front [m].
        motion
            Acceleration and errors of the odometry.
        """
        foremost = front + motion.under_reading
        speeds = self.ceiling(front - motion.over_reading, foremost)
        first = bisect_left(self._locations, foremost)
        if first == len(self.targets) > 0 and self.targets[-1].target.kind == "EOA":
            first -= 1  # an end of authority stays supervised when the train has passed it
        for index in range(first, len(self.targets)):
            if front < self._begins[index] and not _wider(motion):
                break
            found = self._target_speeds(self.targets[index], front, motion)
            speeds = SupervisionSpeeds(
                min(speeds.permitted, found.permitted),
                min(speeds.warning, found.warning),
                min(speeds.service, found.service),
                min(speeds.emergency, found.emergency),
            )
        return speeds

    def indicates(self, front: float, speed: float, motion: MotionEstimate = EXACT_MOTION) -> bool:
        """Return True if the train has passed the indication of a target.

        Parameters
        ----------
        front, speed
            Estimated front position [m] and speed [m/s].
        motion
            Acceleration and errors of the odometry.
        """
        foremost = front + motion.under_reading
        for index in range(bisect_left(self._locations, foremost), len(self.targets)):
            if front < self._begins[index] and not _wider(motion):
                return False
            limits = self.targets[index]
            if speed > limits.target.speed and foremost >= limits.indication(speed, motion):
                return True
        return False

    def _target_speeds(self, limits: TargetLimits, front: float, motion: MotionEstimate) -> SupervisionSpeeds:
        """Return the speeds of one target; the release speed from its start location on."""
        release = self._release
        if release is None or limits.target.kind != "EOA":
            return limits.speeds(front, motion)
        if front >= release_start(limits, release.emergency, motion):
            return release
        return limits.speeds(front, motion)


def _wider(motion: MotionEstimate) -> bool:
    """Return True for a motion with an earlier begin of the targets than that of ``WIDEST_MOTION``."""
    return (
        motion.acceleration > WIDEST_MOTION.acceleration
        or motion.speed_error > WIDEST_MOTION.speed_error
        or motion.under_reading > WIDEST_MOTION.under_reading
    )


def _permitted(speeds: SupervisionSpeeds) -> float:
    return speeds.permitted
