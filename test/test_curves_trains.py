"""Brake models of lambda trains: limits of the conversion model, factors, and steps that meet."""

from __future__ import annotations

import pytest
from curve_trains import ONE

from train_ato.supervision.step_function import StepFunction
from train_ato.supervision.train_model import (
    LIMIT_EXPONENT,
    LIMIT_FACTOR,
    BrakePosition,
    basic_deceleration,
    check_conversion,
    lambda_brake,
    passenger_kv_int,
)


@pytest.mark.parametrize("percentage", [30.0, 250.0])
@pytest.mark.parametrize(
    ("position", "length"),
    [("PassengerTrainInP", 900.0), ("FreightTrainInP", 1500.0), ("FreightTrainInG", 1500.0)],
)
def test_the_limits_of_the_conversion_model_belong_to_it(
    percentage: float, position: BrakePosition, length: float
) -> None:
    """Breaks if a train with a limit of 3.13.3.2.1 is refused."""
    check_conversion(percentage, position, length, 200 / 3.6)


REFUSED: list[tuple[BrakePosition, float, float, float, str, str]] = [
    ("PassengerTrainInP", 29.9, 900.0, 200.0, "brake_percentage: 29.9 %", "; give 30 ... 250 %"),
    ("PassengerTrainInP", 250.1, 900.0, 200.0, "brake_percentage: 250.1 %", "; give 30 ... 250 %"),
    ("PassengerTrainInP", 100.0, 900.0, 200.1, "max_speed_kmh: 200.1 km/h", "; give at most 200 km/h"),
    ("PassengerTrainInP", 100.0, 900.1, 200.0, "length_m: 900.1 m", " of PassengerTrainInP; give at most 900 m"),
    ("FreightTrainInP", 100.0, 1500.1, 200.0, "length_m: 1500.1 m", " of FreightTrainInP; give at most 1500 m"),
    ("FreightTrainInG", 100.0, 1500.1, 200.0, "length_m: 1500.1 m", " of FreightTrainInG; give at most 1500 m"),
]


@pytest.mark.parametrize(("position", "percentage", "length", "speed_kmh", "value", "remedy"), REFUSED)
def test_trains_outside_the_conversion_model(
    position: BrakePosition, percentage: float, length: float, speed_kmh: float, value: str, remedy: str
) -> None:
    """Breaks if a train beyond a limit is accepted, or the line lacks key, value or remedy."""
    with pytest.raises(ValueError) as refused:
        check_conversion(percentage, position, length, speed_kmh / 3.6)
    assert str(refused.value) == f"{value} is outside the conversion model{remedy}, or give a gamma train"
    with pytest.raises(ValueError, match="is outside the conversion model"):
        lambda_brake(percentage, position, length, speed_kmh / 3.6, ONE, ONE, 1.0)


def test_correction_of_the_emergency_time() -> None:
    """Breaks if Kt_int does not act on T_be, or acts on T_bs."""
    full, half = (lambda_brake(100.0, "PassengerTrainInP", 300.0, 50.0, ONE, ONE, kt) for kt in (1.0, 0.5))
    assert full.emergency_time.to_standstill == pytest.approx(2.3 + 0.17 * 16)
    assert half.emergency_time.to_standstill == pytest.approx(0.5 * full.emergency_time.to_standstill)
    assert half.emergency_time.to_speed == pytest.approx(0.5 * full.emergency_time.to_speed)
    assert half.service_time == full.service_time


@pytest.mark.parametrize(("largest", "expected"), [(0.2, 0.8), (0.7, 0.8), (0.8, 0.7), (0.9, 0.6), (1.5, 0.6)])
def test_mix_of_the_passenger_subsets(largest: float, expected: float) -> None:
    """Breaks if the mix continues beyond its pivots of 0.7 and 0.9 m/s²."""
    lower, upper = StepFunction.constant(0.8), StepFunction.constant(0.6)
    assert passenger_kv_int(lower, upper, 0.7, 0.9, largest).at(10.0) == pytest.approx(expected)


@pytest.mark.parametrize("bound", [100.0, 120.0, 150.0])
def test_first_step_that_ends_at_the_bound_of_another(bound: float) -> None:
    """Breaks if a step of no width is made where V_lim is exactly 100, 120 or 150 km/h."""
    near = (bound / LIMIT_FACTOR) ** (1 / LIMIT_EXPONENT)
    exact = [near * (1 + k * 2**-52) for k in range(-64, 65)]
    percentage = next(value for value in exact if LIMIT_FACTOR * value**LIMIT_EXPONENT == bound)
    steps = basic_deceleration(percentage)
    assert steps.bounds[0] == pytest.approx(bound / 3.6)
    assert len(steps.bounds) == {100.0: 4, 120.0: 3, 150.0: 2}[bound]
