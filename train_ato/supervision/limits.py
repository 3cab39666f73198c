"""Supervision limits of one target: locations over the estimated speed, SUBSET-026, 3.13.9.3."""

from dataclasses import asdict, dataclass
from math import inf, isnan, nan
from typing import Any, Literal

from plant_sim.compiled import compiled
from plant_sim.record import Records, quantity, zeros
from train_ato.supervision.deceleration_curve import Arc, DecelerationCurve, advanced_speed, location_at
from train_ato.supervision.odometry import EXACT_MOTION, MotionEstimate, speed_measurement_error
from train_ato.supervision.settings import (
    INDICATION_SHARE,
    LOCKED_SERVICE_TIME,
    MAX_LATER_ACCELERATION,
    MIN_INDICATION_TIME,
    FixedValues,
)
from train_ato.supervision.step_function import EMERGENCY_MARGIN, StepFunction, SupervisionSpeeds, ceiling_speeds
from train_ato.supervision.train_model import SupervisedTrain

# mypy: no-warn-return-any


MAX_ACCELERATION, MAX_SPEED_ERROR = 5.0, 10.0
"""Largest estimated acceleration [m/s²] and speed error [m/s] for which the curves reach the compensated speed."""


@dataclass(frozen=True, slots=True)
class BrakingTarget:
    """Target of a braking curve.

    Attributes
    ----------
    location : float
        Target location [m]; of an end of authority: the supervised location (SvL).
    speed : float
        Target speed [m/s].
    kind : str
        ``MRSP`` (lower speed limit), ``LOA`` (limit of authority) or ``EOA`` (end of authority with its SvL).
    end_of_authority : float or None
        Location of the EOA [m]; default: the SvL.
    """

    location: float
    speed: float = 0.0
    kind: Literal["MRSP", "LOA", "EOA"] = "MRSP"
    end_of_authority: float | None = None

    def __post_init__(self) -> None:
        if self.kind == "EOA" and self.speed != 0.0:
            raise ValueError("an end of authority has the target speed 0; give the kind MRSP or LOA")

    @property
    def eoa(self) -> float:
        """Location of the end of authority [m]."""
        return self.location if self.end_of_authority is None else self.end_of_authority


@dataclass(frozen=True, slots=True)
class InterventionTimes:
    """Times of one target [s]: traction, rest of the emergency build-up, and the two service-brake times."""

    traction: float
    remaining: float
    bs1: float
    bs2: float
    indication: float


def intervention_times(train: SupervisedTrain, target_speed: float, fixed: FixedValues) -> InterventionTimes:
    """Return the times of a target: 3.13.9.3.2.3, 3.13.9.3.2.6, 3.13.9.3.3.3-5 and 3.13.9.3.6.2-4.

    With the service-brake feedback the times are those before its pressure falls.
    """
    t_bs = train.brake.service_time.for_target(target_speed)
    feedback = train.service_command and train.service_feedback
    bs1 = t_bs if train.service_command else 0.0
    bs2 = max(bs1, LOCKED_SERVICE_TIME) if feedback else bs1
    traction = train.t_traction_cut_off
    if train.traction_command:
        traction = max(traction - (fixed.t_warning + bs2), 0.0)
    indication = MIN_INDICATION_TIME if feedback else max(INDICATION_SHARE * t_bs, MIN_INDICATION_TIME)
    if fixed.driver_time_twice:
        indication += fixed.t_driver
    remaining = max(train.brake.emergency_time.for_target(target_speed) - traction, 0.0)
    return InterventionTimes(traction, remaining, bs1, bs2, indication)


@dataclass
class Target:
    """Constants of the limits of one target, and its curves as parts of an array of arcs."""

    location: float = quantity("m", "target location")
    speed: float = quantity("m/s", "target speed")
    is_end: bool = quantity("", "end of authority")
    speed_limit: float = quantity("m/s", "speed limit before the target")
    traction: float = quantity("s", "time with traction")
    remaining: float = quantity("s", "rest of the build-up time of the emergency brake")
    bs1: float = quantity("s", "build-up time of the service brake for SBI1")
    bs2: float = quantity("s", "build-up time of the service brake for SBI2")
    t_warning: float = quantity("s", "time between warning and service-brake intervention")
    t_driver: float = quantity("s", "time between permitted speed and service-brake intervention")
    indication: float = quantity("s", "time between indication and permitted speed")
    ebd_first: int = quantity("", "first arc of the EBD")
    ebd_end: int = quantity("", "end of its arcs")
    ebd_top: float = quantity("m/s", "largest speed of the EBD")
    sbd_first: int = quantity("", "first arc of the SBD")
    sbd_end: int = quantity("", "end of its arcs, the first one without an SBD")
    sbd_top: float = quantity("m/s", "largest speed of the SBD")
    permitted: float = quantity("m/s", "lowest permitted speed")
    warning: float = quantity("m/s", "lowest speed of the warning")
    service: float = quantity("m/s", "lowest speed of the service-brake intervention")
    emergency: float = quantity("m/s", "lowest speed of the emergency-brake intervention")
    begin: float = quantity("m", "smallest begin of the indication of this target and all later ones")
    release: float = quantity("m/s", "release speed; infinite: none")


@compiled
def rises(target: Target, motion: MotionEstimate) -> tuple[float, float]:
    """Return the rise of the speed in the traction time and in the rest of the build-up time [m/s]."""
    later = motion.later_acceleration
    if isnan(later):
        later = motion.acceleration
    raised = max(motion.acceleration, 0.0) * target.traction
    return raised, min(max(later, 0.0), MAX_LATER_ACCELERATION) * target.remaining


@compiled
def emergency_location(
    target: Target, arcs: Records[Arc], speed: float, error: float, first: float, later: float
) -> tuple[float, float]:
    """Return the location of the emergency-brake intervention, EBI [m], and ``V_bec`` [m/s]: 3.13.9.3.2.10-12.

    ``error`` is the error of the speed, ``first`` and ``later`` are its :func:`rises` [m/s]. A location that the curve
    does not have is NaN.
    """
    now = speed + error
    compensated = max(now + first, target.speed)
    distance = max(now + first / 2.0, target.speed) * target.traction + (compensated + later / 2.0) * target.remaining
    curve = arcs[target.ebd_first : target.ebd_end]
    return location_at(curve, target.ebd_top, compensated + later) - distance, compensated + later


@compiled
def service_location(
    target: Target, arcs: Records[Arc], speed: float, error: float, first: float, later: float, under_reading: float
) -> float:
    """Return the location of the more restrictive service-brake intervention, SBI [m], NaN without one.

    For an end of authority SBI1 is compared at the estimated front and SBI2 at the max safe front.
    """
    found = emergency_location(target, arcs, speed, error, first, later)[0] - speed * target.bs2
    if target.sbd_end > target.sbd_first:
        curve = arcs[target.sbd_first : target.sbd_end]
        other = location_at(curve, target.sbd_top, speed) - speed * target.bs1
        if isnan(other):
            return nan
        return min(found, other + under_reading)
    return found


@compiled
def indication_location(target: Target, arcs: Records[Arc], speed: float, motion: MotionEstimate) -> float:
    """Return the location of the indication [m]: 3.13.9.3.6; above the speed limit that at the speed limit."""
    capped = min(speed, max(target.speed_limit, target.speed))
    first, later = rises(target, motion)
    found = service_location(target, arcs, capped, motion.speed_error, first, later, motion.under_reading)
    return found - capped * (target.t_driver + target.indication)


@compiled
def target_speeds(target: Target, arcs: Records[Arc], front: float, motion: MotionEstimate) -> SupervisionSpeeds:
    """Return the speeds of the limits of a target [m/s] for an estimated front position [m].

    They are the speeds at which a train at constant speed passes each limit at this position, not below the ceiling
    speeds of the target.
    """
    first, later = rises(target, motion)
    error, place, braking = motion.speed_error, front + motion.under_reading, target.traction + target.remaining
    gain = error + first + later
    shift = (error + first / 2.0) * target.traction + (error + first + later / 2.0) * target.remaining
    curve, service = arcs[target.ebd_first : target.ebd_end], braking + target.bs2
    permitted = advanced_speed(curve, place, service + target.t_driver, gain, shift)
    warning = advanced_speed(curve, place, service + target.t_warning, gain, shift)
    emergency = advanced_speed(curve, place, braking, gain, shift)
    stopping = emergency if target.bs2 == 0.0 else advanced_speed(curve, place, service, gain, shift)
    if target.sbd_end > target.sbd_first:
        curve = arcs[target.sbd_first : target.sbd_end]
        permitted = min(permitted, advanced_speed(curve, front, target.bs1 + target.t_driver, 0.0, 0.0))
        warning = min(warning, advanced_speed(curve, front, target.bs1 + target.t_warning, 0.0, 0.0))
        stopping = min(stopping, advanced_speed(curve, front, target.bs1, 0.0, 0.0))
    return SupervisionSpeeds(
        max(permitted, target.permitted),
        max(warning, target.warning),
        max(stopping, target.service),
        max(emergency, target.emergency),
    )


class TargetLimits:
    """Braking curves and supervision limits of one target.

    All locations are those of the front of the train: of the max safe front for limits from the EBD, of the estimated
    front for limits from the SBD.

    Parameters
    ----------
    train, target, gradient, fixed
        Train data, target, deceleration by the gradient [m/s²] over the front position [m], fixed values.
    speed_limit
        Speed limit before the target, ``V_MRSP`` [m/s]; the indication is that at this speed for higher speeds.

    Attributes
    ----------
    ebd : DecelerationCurve
        Emergency-brake deceleration curve.
    sbd : DecelerationCurve or None
        Service-brake deceleration curve of an end of authority; None for other targets, and without a service
        deceleration.
    times : InterventionTimes
        Times of this target.
    arcs : Array of :class:`train_ato.supervision.deceleration_curve.Arc`
        Arcs of the EBD, then of the SBD.
    record : Array of :class:`Target`, shape (1,)
        Constants of the limits.

    Raises
    ------
    ValueError
        If the brake is weaker than the gradient.
    """

    def __init__(
        self,
        train: SupervisedTrain,
        target: BrakingTarget,
        gradient: StepFunction,
        fixed: FixedValues,
        speed_limit: float | None = None,
    ) -> None:
        self.train, self.target, self.fixed = train, target, fixed
        self.speed_limit = train.max_speed if speed_limit is None else min(speed_limit, train.max_speed)
        self.times = times = intervention_times(train, target.speed, fixed)
        needed = max(train.max_speed, target.speed) + EMERGENCY_MARGIN.above(train.max_speed)
        rise = MAX_ACCELERATION * times.traction + MAX_LATER_ACCELERATION * times.remaining
        self._speeds = {"needed_speed": needed, "top_speed": needed + MAX_SPEED_ERROR + rise}
        foot = 0.0 if target.kind == "EOA" else target.speed + EMERGENCY_MARGIN.above(target.speed)
        self.ebd = DecelerationCurve(target.location, foot, train.brake.safe, gradient, **self._speeds)
        self._gradient = gradient
        self.sbd = None if train.brake.service is None or target.kind != "EOA" else self.service_curve()
        self.floor = SupervisionSpeeds(0.0, 0.0, 0.0, 0.0) if target.kind == "EOA" else ceiling_speeds(target.speed)
        first, second = self.ebd.arcs, self.ebd.arcs[:0] if self.sbd is None else self.sbd.arcs
        self.arcs = zeros(Arc, first.size + second.size)
        self.arcs[: first.size], self.arcs[first.size :] = first, second
        values = {
            "location": target.location, "is_end": target.kind == "EOA", "speed_limit": self.speed_limit,
            **asdict(times), "t_warning": fixed.t_warning, "t_driver": fixed.t_driver, **self.floor._asdict(),
            "speed": target.speed, "ebd_end": first.size, "ebd_top": self.ebd.end_speed,
            "sbd_first": first.size, "sbd_end": self.arcs.size, "begin": -inf, "release": inf,
            "sbd_top": 0.0 if self.sbd is None else self.sbd.end_speed,
        }  # fmt: skip
        self.record = zeros(Target, 1)
        for name, value in values.items():
            self.record[name] = value

    def emergency(self, speed: float, motion: MotionEstimate = EXACT_MOTION) -> float:
        """Return the location of the emergency-brake intervention, EBI [m]: 3.13.9.3.2.10-12."""
        target = self.record[0]
        found, reached = emergency_location(target, self.arcs, speed, motion.speed_error, *rises(target, motion))
        if isnan(found):
            raise self.ebd.refusal(reached)
        return float(found)

    def service_from_ebd(self, speed: float, motion: MotionEstimate = EXACT_MOTION) -> float:
        """Return the location of the service-brake intervention from the EBD, SBI2 [m]: 3.13.9.3.3.2."""
        return self.emergency(speed, motion) - speed * self.times.bs2

    def service_from_sbd(self, speed: float) -> float:
        """Return the location of the service-brake intervention from the SBD, SBI1 [m]: 3.13.9.3.3.1."""
        curve = self.service_curve() if self.sbd is None else self.sbd
        return curve.location(speed) - speed * self.times.bs1

    def service_curve(self) -> DecelerationCurve:
        """Return the service-brake deceleration curve, SBD, to the end of authority or to the target.

        Raises
        ------
        ValueError
            If the train has no service deceleration, or it is weaker than the gradient.
        """
        service = self.train.brake.service
        if service is None:
            raise ValueError("A_brake_service: the curves SBD and SBI1 need a service deceleration; give it")
        return DecelerationCurve(self.target.eoa, 0.0, service, self._gradient, **self._speeds)

    def service(self, speed: float, motion: MotionEstimate = EXACT_MOTION) -> float:
        """Return the location of the more restrictive service-brake intervention, SBI [m].

        For an end of authority SBI1 is compared at the estimated front and SBI2 at the max safe front.
        """
        later = motion.speed_error, *rises(self.record[0], motion), motion.under_reading
        return self._found(service_location(self.record[0], self.arcs, speed, *later), speed, motion)

    def _found(self, location: float, speed: float, motion: MotionEstimate) -> float:
        """Return a location [m]; raise the error of the curve that does not have the speed [m/s]."""
        if isnan(location):
            self.emergency(speed, motion)
            self.service_from_sbd(speed)
        return location

    def warning(self, speed: float, motion: MotionEstimate = EXACT_MOTION) -> float:
        """Return the location of the warning [m]: 3.13.9.3.4."""
        return self.service(speed, motion) - speed * self.fixed.t_warning

    def permitted(self, speed: float, motion: MotionEstimate = EXACT_MOTION) -> float:
        """Return the location of the permitted speed [m], not beyond the target: 3.13.9.3.5.1."""
        return min(self.service(speed, motion) - speed * self.fixed.t_driver, self.target.location)

    def indication(self, speed: float, motion: MotionEstimate = EXACT_MOTION) -> float:
        """Return the location of the indication [m]: 3.13.9.3.6; above the speed limit that at the speed limit."""
        found = indication_location(self.record[0], self.arcs, speed, motion)
        return self._found(found, min(speed, max(self.speed_limit, self.target.speed)), motion)

    def speeds(self, front: float, motion: MotionEstimate = EXACT_MOTION) -> SupervisionSpeeds:
        """Return the speeds of the limits [m/s] for an estimated front position [m]: :func:`target_speeds`."""
        found: SupervisionSpeeds = target_speeds(self.record[0], self.arcs, front, motion)
        return found


TRIP_OFFSET, TRIP_SHARE = 10.0, 0.10
"""Confidence interval predicted for the end of authority: offset [m], and part of its distance to the reference."""
ITERATIONS = 60
"""Halvings of the speed interval; beyond the resolution of a float."""


@compiled
def release_location(target: Target, arcs: Records[Arc], speed: float, error: float, under_reading: float) -> Any:
    """Return the estimated front position at which the supervision of a release speed begins [m]: 3.13.9.4.6."""
    return service_location(target, arcs, speed, error, 0.0, 0.0, under_reading) - under_reading


def trip_location(
    eoa: float, reference: float, motion: MotionEstimate = EXACT_MOTION, balise_accuracy: float = 0.0
) -> float:
    """Return the largest front position at the trip of an end of authority, ``d_tripEOA`` [m]: 3.13.9.4.8.2, level 2.

    Parameters
    ----------
    eoa
        Location of the end of authority [m].
    reference
        On-board reference location [m]: the last balise, not the front (3.13.1.4). The odometer error grows from there.
    motion
        Confidence of the position now.
    balise_accuracy
        Accuracy of the location of the last balise [m].
    """
    predicted = 2.0 * balise_accuracy + TRIP_OFFSET + TRIP_SHARE * max(eoa - reference, 0.0)
    return eoa + max(predicted, motion.under_reading + motion.over_reading)


def release_speed(
    limits: TargetLimits, trip: float, speed_error: float = 0.0, *, inhibit_compensation: bool = False
) -> float:
    """Return the release speed [m/s] that stops the train before the target after a trip: 3.13.9.4.8-9, level 2.

    Parameters
    ----------
    limits
        Limits of the supervised location, or of a lower speed limit between the trip location and it.
    trip
        Trip location [m].
    speed_error
        Speed under-reading amount ``V_ura`` [m/s].
    inhibit_compensation
        True if the national value inhibits the compensation of the speed error.

    Returns
    -------
    float
        Largest speed with EBD(trip + D_bec) at least as high as the compensated speed, not above the speed limit of
        the limits; the target speed if there is none above it.
    """
    train = limits.train
    build_up = train.brake.emergency_time.for_target(limits.target.speed)
    time = max(train.t_traction_cut_off, build_up)  # T_traction + T_berem, without traction cut-off command

    def stops(speed: float) -> bool:
        error = 0.0 if inhibit_compensation else max(speed_measurement_error(speed), speed_error)
        return limits.ebd.speed(trip + (speed + error) * time) >= speed + error

    low, high = limits.target.speed, max(limits.speed_limit, limits.target.speed)
    if not stops(low):
        return low
    if stops(high):
        return high
    for _ in range(ITERATIONS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if stops(middle) else (low, middle)
    return low


def release_start(
    limits: TargetLimits, speed: float, motion: MotionEstimate = EXACT_MOTION, *, inhibit_compensation: bool = False
) -> float:
    """Return the estimated front position at which the supervision of the release speed begins [m]: 3.13.9.4.6.

    Parameters
    ----------
    limits
        Limits of the end of authority.
    speed
        Release speed [m/s].
    motion
        Confidence of the position; its acceleration and speed error are replaced by 0 and f41 of the release speed.
    inhibit_compensation
        As in :func:`release_speed`.
    """
    error = 0.0 if inhibit_compensation else speed_measurement_error(speed)
    found = release_location(limits.record[0], limits.arcs, speed, error, motion.under_reading)
    if isnan(found):
        limits.service(speed, MotionEstimate(0.0, error, motion.under_reading, motion.over_reading))
    return float(found)
