"""Supervision limits of one target: locations over the estimated speed, SUBSET-026, 3.13.9.3."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from train_ato.supervision.ceiling import EMERGENCY_MARGIN, SupervisionSpeeds, ceiling_speeds
from train_ato.supervision.deceleration_curve import DecelerationCurve
from train_ato.supervision.fixed_values import (
    INDICATION_SHARE,
    LOCKED_SERVICE_TIME,
    MAX_LATER_ACCELERATION,
    MIN_INDICATION_TIME,
    FixedValues,
)
from train_ato.supervision.odometry import EXACT_MOTION, MotionEstimate
from train_ato.supervision.step_function import StepFunction
from train_ato.supervision.train_model import SupervisedTrain

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
        self.times = intervention_times(train, target.speed, fixed)
        needed = max(train.max_speed, target.speed) + EMERGENCY_MARGIN.above(train.max_speed)
        rise = MAX_ACCELERATION * self.times.traction + MAX_LATER_ACCELERATION * self.times.remaining
        self._speeds = (needed, needed + MAX_SPEED_ERROR + rise)
        foot = 0.0 if target.kind == "EOA" else target.speed + EMERGENCY_MARGIN.above(target.speed)
        self.ebd = DecelerationCurve(target.location, foot, train.brake.safe, gradient, *self._speeds)
        self._gradient = gradient
        self.sbd = None if train.brake.service is None or target.kind != "EOA" else self.service_curve()
        self.floor = SupervisionSpeeds(0.0, 0.0, 0.0, 0.0) if target.kind == "EOA" else ceiling_speeds(target.speed)

    def _rises(self, motion: MotionEstimate) -> tuple[float, float]:
        """Return the rise of the speed in the traction time and in the rest of the build-up time [m/s]."""
        first = motion.acceleration
        later = first if motion.later_acceleration is None else motion.later_acceleration
        return (
            max(first, 0.0) * self.times.traction,
            min(max(later, 0.0), MAX_LATER_ACCELERATION) * self.times.remaining,
        )

    def compensation(self, motion: MotionEstimate) -> tuple[float, float]:
        """Return the rise of the speed [m/s], and the distance that does not depend on the speed [m], until the EBD.

        ``V_bec`` is the estimated speed plus the rise, ``D_bec`` the estimated speed times ``T_traction + T_berem``
        plus the distance, for speeds that are not below the target speed: 3.13.9.3.2.10.
        """
        times, error = self.times, motion.speed_error
        first, later = self._rises(motion)
        distance = (error + first / 2.0) * times.traction + (error + first + later / 2.0) * times.remaining
        return error + first + later, distance

    def emergency(self, speed: float, motion: MotionEstimate = EXACT_MOTION) -> float:
        """Return the location of the emergency-brake intervention, EBI [m]: 3.13.9.3.2.10-12."""
        times, low = self.times, self.target.speed
        first, later = self._rises(motion)
        now = speed + motion.speed_error
        compensated = max(now + first, low)
        distance = max(now + first / 2.0, low) * times.traction + (compensated + later / 2.0) * times.remaining
        return self.ebd.location(compensated + later) - distance

    def service_from_ebd(self, speed: float, motion: MotionEstimate = EXACT_MOTION) -> float:
        """Return the location of the service-brake intervention from the EBD, SBI2 [m]: 3.13.9.3.3.2."""
        return self.emergency(speed, motion) - speed * self.times.bs2

    def service_from_sbd(self, speed: float) -> float:
        """Return the location of the service-brake intervention from the SBD, SBI1 [m]: 3.13.9.3.3.1.

        Raises
        ------
        ValueError
            If the train has no service deceleration.
        """
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
        return DecelerationCurve(self.target.eoa, 0.0, service, self._gradient, *self._speeds)

    def service(self, speed: float, motion: MotionEstimate = EXACT_MOTION) -> float:
        """Return the location of the more restrictive service-brake intervention, SBI [m].

        For an end of authority SBI1 is compared at the estimated front and SBI2 at the max safe front.
        """
        found = self.service_from_ebd(speed, motion)
        if self.sbd is not None:
            found = min(found, self.service_from_sbd(speed) + motion.under_reading)
        return found

    def warning(self, speed: float, motion: MotionEstimate = EXACT_MOTION) -> float:
        """Return the location of the warning [m]: 3.13.9.3.4."""
        return self.service(speed, motion) - speed * self.fixed.t_warning

    def permitted(self, speed: float, motion: MotionEstimate = EXACT_MOTION) -> float:
        """Return the location of the permitted speed [m], not beyond the target: 3.13.9.3.5.1."""
        return min(self.service(speed, motion) - speed * self.fixed.t_driver, self.target.location)

    def indication(self, speed: float, motion: MotionEstimate = EXACT_MOTION) -> float:
        """Return the location of the indication [m]: 3.13.9.3.6; above the speed limit that at the speed limit."""
        capped = min(speed, max(self.speed_limit, self.target.speed))
        time = self.fixed.t_driver + self.times.indication
        return self.service(capped, motion) - capped * time

    def speeds(self, front: float, motion: MotionEstimate = EXACT_MOTION) -> SupervisionSpeeds:
        """Return the speeds of the limits [m/s] for an estimated front position [m].

        They are the speeds at which a train at constant speed passes each limit at this position, not below the
        ceiling speeds of the target.
        """
        gain, shift = self.compensation(motion)
        times, fixed, curve, floor = self.times, self.fixed, self.ebd, self.floor
        place = front + motion.under_reading
        braking = times.traction + times.remaining
        service = braking + times.bs2
        permitted = curve.advanced_speed(place, service + fixed.t_driver, gain, shift)
        warning = curve.advanced_speed(place, service + fixed.t_warning, gain, shift)
        emergency = curve.advanced_speed(place, braking, gain, shift)
        stopping = emergency if times.bs2 == 0.0 else curve.advanced_speed(place, service, gain, shift)
        if self.sbd is not None:
            permitted = min(permitted, self.sbd.advanced_speed(front, times.bs1 + fixed.t_driver, 0.0, 0.0))
            warning = min(warning, self.sbd.advanced_speed(front, times.bs1 + fixed.t_warning, 0.0, 0.0))
            stopping = min(stopping, self.sbd.advanced_speed(front, times.bs1, 0.0, 0.0))
        return SupervisionSpeeds(
            max(permitted, floor.permitted),
            max(warning, floor.warning),
            max(stopping, floor.service),
            max(emergency, floor.emergency),
        )
