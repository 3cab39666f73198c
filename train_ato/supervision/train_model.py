"""Brake model of a supervised train: conversion of the brake percentage (lambda), or decelerations given (gamma).

SUBSET-026, 3.13.3, 3.13.6 and A.3.7-A.3.9.
"""

from dataclasses import dataclass
from typing import Literal

from plant_sim.units import KMH
from train_ato.supervision.step_function import StepFunction

BrakePosition = Literal["PassengerTrainInP", "FreightTrainInP", "FreightTrainInG"]
LAMBDA_MIN, LAMBDA_MAX = 30.0, 250.0
"""Brake percentages of the conversion model [%]: 3.13.3.2.1 b)."""
CONVERSION_MAX_SPEED = 200.0 / KMH
"""Largest maximum train speed of the conversion model [m/s]: 3.13.3.2.1 a)."""
CONVERSION_MAX_LENGTH: dict[str, float] = {
    "PassengerTrainInP": 900.0, "FreightTrainInP": 1500.0, "FreightTrainInG": 1500.0,
}  # fmt: skip
"""Largest train length of the conversion model [m]: 3.13.3.2.1 c)."""
LAMBDA_SERVICE_MAX = 135.0
"""Largest brake percentage for the service brake [%]: A.3.7.1."""
LIMIT_FACTOR, LIMIT_EXPONENT = 16.85, 0.428
"""First step of the basic deceleration ends at factor · lambda ** exponent [km/h]: A.3.7.3."""
FIRST_SLOPE, FIRST_OFFSET = 0.0075, 0.076
"""First step of the basic deceleration, slope · lambda + offset [m/s²]: A.3.7.4."""
POLYNOMIALS: tuple[tuple[float, tuple[float, float, float, float]], ...] = (
    (100.0, (-6.30e-7, 6.10e-5, 4.72e-3, 0.0663)),
    (120.0, (2.73e-7, -4.54e-6, 5.14e-3, 0.1300)),
    (150.0, (5.58e-8, -6.76e-6, 5.81e-3, 0.0479)),
    (180.0, (3.00e-8, -3.85e-6, 5.52e-3, 0.0480)),
    (float("inf"), (3.23e-9, 1.66e-6, 5.06e-3, 0.0559)),
)
"""Upper bound [km/h] and coefficients of lambda³ ... lambda⁰ of the further steps: A.3.7.5, A.3.7.6."""
LONG_TRAIN = 900.0
"""Length above which freight trains have other build-up coefficients [m]: A.3.8, A.3.9."""
MIN_LENGTH = 400.0
"""Shortest length in the build-up times with a lower bound of the length [m]: A.3.8, A.3.9."""
TARGET_SPEED_SHARE: dict[str, float] = {"PassengerTrainInP": 0.20, "FreightTrainInP": 0.20, "FreightTrainInG": 0.16}
"""C_t of the correction 1 + C_t of build-up times for target speeds above 0: A.3.8.5."""
_LONG_EMERGENCY, _LONG_SERVICE = (-0.40, 1.60, 0.03), (10.50, 0.32, 0.18)
EMERGENCY_TIMES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], float]] = {
    "PassengerTrainInP": ((2.30, 0.00, 0.17), (2.30, 0.00, 0.17), MIN_LENGTH),
    "FreightTrainInP": ((2.30, 0.00, 0.17), _LONG_EMERGENCY, MIN_LENGTH),
    "FreightTrainInG": ((12.00, 0.00, 0.05), _LONG_EMERGENCY, 0.0),
}
"""Coefficients up to 900 m and beyond, and shortest length [m], of the emergency brake: A.3.8.1-A.3.8.3."""
SERVICE_TIMES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], float]] = {
    "PassengerTrainInP": ((3.00, 1.50, 0.10), (3.00, 1.50, 0.10), 0.0),
    "FreightTrainInP": ((3.00, 2.77, 0.00), _LONG_SERVICE, 0.0),
    "FreightTrainInG": ((3.00, 2.77, 0.00), _LONG_SERVICE, MIN_LENGTH),
}
"""As above for the full service brake: A.3.9.1-A.3.9.3."""


@dataclass(frozen=True, slots=True)
class BuildUpTime:
    """Equivalent brake build-up time [s] for a target speed of 0 and for one above 0."""

    to_standstill: float
    to_speed: float

    def for_target(self, speed: float) -> float:
        """Return the time [s] for a target speed."""
        return self.to_speed if speed > 0 else self.to_standstill


@dataclass(frozen=True, slots=True)
class BrakeModel:
    """Decelerations [m/s²] over the speed [m/s], and build-up times, of the full brakes of a train.

    Attributes
    ----------
    safe : StepFunction
        Safe deceleration of the emergency brake, ``A_brake_safe``.
    service : StepFunction or None
        Deceleration of the full service brake, ``A_brake_service``; None if it is unknown.
    emergency_time, service_time : BuildUpTime
        ``T_be`` and ``T_bs``.
    """

    safe: StepFunction
    service: StepFunction | None
    emergency_time: BuildUpTime
    service_time: BuildUpTime


@dataclass(frozen=True, slots=True)
class SupervisedTrain:
    """Train data of the speed and distance monitoring.

    Attributes
    ----------
    length, max_speed : float
        Length [m] and maximum speed [m/s].
    brake : BrakeModel
        Brake model.
    m_rotating_nom : float or None
        Nominal rotating mass [% of the mass]; None if it is unknown.
    service_command, service_feedback, traction_command : bool
        Interfaces: service-brake command, service-brake feedback, traction cut-off command.
    t_traction_cut_off : float
        Time from the command to the end of the traction [s].
    """

    length: float
    max_speed: float
    brake: BrakeModel
    m_rotating_nom: float | None = None
    service_command: bool = False
    service_feedback: bool = False
    traction_command: bool = False
    t_traction_cut_off: float = 0.0


def basic_deceleration(percentage: float) -> StepFunction:
    """Return the basic deceleration [m/s²] over the speed [m/s] for a brake percentage [%]: A.3.7.3-A.3.7.6.

    Parameters
    ----------
    percentage
        Brake percentage [%].
    """
    limit = LIMIT_FACTOR * percentage**LIMIT_EXPONENT
    bounds, values = [limit], [FIRST_SLOPE * percentage + FIRST_OFFSET]
    for upper, (a3, a2, a1, a0) in POLYNOMIALS:
        if limit < upper:
            values.append(a3 * percentage**3 + a2 * percentage**2 + a1 * percentage + a0)
            bounds.append(upper)
    return StepFunction(tuple(bound / KMH for bound in bounds[:-1]), tuple(values))


def _basic_time(
    table: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], float]],
    position: BrakePosition,
    length: float,
    factor: float = 1.0,
) -> BuildUpTime:
    """Return a + b L/100 + c (L/100)² with the coefficients of a table, times a factor: A.3.8, A.3.9."""
    short, long, shortest = table[position]
    a, b, c = long if length > LONG_TRAIN else short
    hundreds = max(length, shortest) / 100.0
    time = factor * (a + b * hundreds + c * hundreds**2)
    return BuildUpTime(time, (1.0 + TARGET_SPEED_SHARE[position]) * time)


def check_conversion(percentage: float, position: BrakePosition, length: float, max_speed: float) -> None:
    """Raise ValueError if the conversion model is not applicable: 3.13.3.2.1.

    Parameters
    ----------
    percentage
        Brake percentage [%].
    position, length, max_speed
        Brake position, train length [m], maximum train speed [m/s].
    """
    longest = CONVERSION_MAX_LENGTH[position]
    remedy = "give a gamma train"
    if not LAMBDA_MIN <= percentage <= LAMBDA_MAX:
        raise ValueError(
            f"brake_percentage: {percentage:g} % is outside the conversion model; give {LAMBDA_MIN:g} ... "
            f"{LAMBDA_MAX:g} %, or {remedy}"
        )
    if max_speed > CONVERSION_MAX_SPEED * (1 + 1e-9):
        raise ValueError(
            f"max_speed_kmh: {max_speed * KMH:g} km/h is outside the conversion model; give at most "
            f"{CONVERSION_MAX_SPEED * KMH:g} km/h, or {remedy}"
        )
    if length > longest:
        raise ValueError(
            f"length_m: {length:g} m is outside the conversion model of {position}; give at most {longest:g} m, "
            f"or {remedy}"
        )


def lambda_brake(
    percentage: float,
    position: BrakePosition,
    length: float,
    max_speed: float,
    *,
    kv_int: StepFunction,
    kr_int: StepFunction,
    kt_int: float,
) -> BrakeModel:
    """Return the brake model of a train with a brake percentage (lambda train).

    Parameters
    ----------
    percentage, position, length, max_speed
        As in :func:`check_conversion`.
    kv_int, kr_int
        Integrated correction factors over the speed [m/s] and over the train length [m]: 3.13.2.3.7.
    kt_int
        Integrated correction factor of the emergency build-up time.

    Raises
    ------
    ValueError
        If the conversion model is not applicable; one line: key, value, remedy.
    """
    check_conversion(percentage, position, length, max_speed)
    kr = kr_int.at(length)
    return BrakeModel(
        basic_deceleration(percentage).combine(kv_int, lambda a, kv: kv * kr * a),
        basic_deceleration(min(percentage, LAMBDA_SERVICE_MAX)),
        _basic_time(EMERGENCY_TIMES, position, length, kt_int),
        _basic_time(SERVICE_TIMES, position, length),
    )


def passenger_kv_int(
    lower: StepFunction, upper: StepFunction, lower_pivot: float, upper_pivot: float, largest: float
) -> StepFunction:
    """Return ``Kv_int`` of passenger trains between its subsets a and b: 3.13.6.2.1.8.1.

    Parameters
    ----------
    lower, upper
        Subsets a and b over the speed [m/s].
    lower_pivot, upper_pivot
        ``A_P12`` and ``A_P23`` [m/s²].
    largest
        Largest emergency-brake deceleration up to the maximum speed, ``A_ebmax`` [m/s²].
    """
    share = min(max((largest - lower_pivot) / (upper_pivot - lower_pivot), 0.0), 1.0)
    return lower.combine(upper, lambda a, b: a + share * (b - a))


def gamma_brake(
    emergency: StepFunction,
    emergency_time: float,
    service: StepFunction | None,
    service_time: float,
    *,
    kdry: StepFunction,
    kwet: StepFunction,
    adhesion: float,
) -> BrakeModel:
    """Return the brake model of a train with given decelerations (gamma train): 3.13.6.2.1.4.

    Parameters
    ----------
    emergency, service
        ``A_brake_emergency`` and ``A_brake_service`` [m/s²] over the speed [m/s].
    emergency_time, service_time
        Equivalent build-up times [s].
    kdry, kwet
        Rolling-stock correction factors ``Kdry_rst`` and ``Kwet_rst`` over the speed.
    adhesion
        Weight of dry adhesion ``M_NVAVADH``, 0 (wet) to 1 (dry).
    """
    factor = kdry.combine(kwet, lambda dry, wet: dry * (wet + adhesion * (1.0 - wet)))
    return BrakeModel(
        emergency.combine(factor, lambda a, k: a * k),
        service,
        BuildUpTime(emergency_time, emergency_time),
        BuildUpTime(service_time, service_time),
    )
