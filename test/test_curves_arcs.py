"""Arcs of deceleration curves at steps of brake and gradient, and ends of curves, with numbers by hand."""

from __future__ import annotations

import math

import pytest
from curve_trains import LEVEL, ONE

from train_ato.supervision import deceleration_curve
from train_ato.supervision.deceleration_curve import DecelerationCurve
from train_ato.supervision.step_function import StepFunction


def test_arcs_beyond_the_crossing_at_a_step_of_the_brake() -> None:
    """Breaks if the curve below the crossing speed has the brake of another speed."""
    brake = StepFunction((10.0,), (1.0, 2.0))
    curve = DecelerationCurve(1000.0, 20.0, brake, LEVEL, 30.0, 40.0)
    assert [curve.location(speed) for speed in (20.0, 10.0, 0.0)] == [1000.0, 1075.0, 1125.0]
    assert curve.speed(1037.5) == pytest.approx(math.sqrt(250.0))
    assert curve.speed(1100.0) == pytest.approx(math.sqrt(50.0))
    assert curve.location(30.0) == pytest.approx(1000.0 - (900.0 - 400.0) / 4)


@pytest.mark.parametrize(
    ("bound", "stop"), [(1050.0, 1050 + 300 / 4), (1199.9, 1199.9 + 0.2 / 4), (1200.0, 1200.0), (1300.0, 1200.0)]
)
def test_arcs_beyond_the_crossing_at_a_step_of_the_gradient(bound: float, stop: float) -> None:
    """Breaks if the gradient beyond the crossing has no effect, or the last arc before the standstill is lost."""
    curve = DecelerationCurve(1000.0, 20.0, ONE, StepFunction((bound,), (0.0, 1.0)), 30.0, 40.0)
    assert curve.location(0.0) == pytest.approx(stop, abs=1e-9)
    assert curve.speed(1040.0) == pytest.approx(math.sqrt(320.0))
    assert curve.speed(stop) == pytest.approx(0.0, abs=1e-6)


def test_gradient_as_strong_as_the_brake() -> None:
    """Breaks if a deceleration of exactly 0 gives a curve, or another error than that of a weak brake."""
    before, beyond = StepFunction((900.0,), (-1.0, 0.0)), StepFunction((1000.0,), (0.0, -1.0))
    with pytest.raises(ValueError, match=r"the brake \(1 m/s² at 50.91 km/h\) is not stronger"):
        DecelerationCurve(1000.0, 0.0, ONE, before, 20.0, 40.0)
    short = DecelerationCurve(1000.0, 0.0, ONE, before, 14.0, 40.0)
    assert short.end_speed == pytest.approx(math.sqrt(200.0))
    assert DecelerationCurve(1000.0, 20.0, ONE, beyond, 30.0, 40.0).arcs["speed"].tolist() == [20.0]


def test_curve_ends_exactly_at_the_needed_and_at_the_top_speed() -> None:
    """Breaks if a curve that reaches the needed speed is refused, or has arcs above the top speed."""
    none_above = StepFunction((30.0,), (1.0, 0.0))
    assert DecelerationCurve(1000.0, 0.0, none_above, LEVEL, 30.0, 60.0).end_speed == 30.0
    more_above = StepFunction((30.0,), (1.0, 2.0))
    assert DecelerationCurve(1000.0, 0.0, more_above, LEVEL, 20.0, 30.0).end_speed == 30.0
    assert DecelerationCurve(1000.0, 0.0, more_above, LEVEL, 20.0, 30.1).end_speed == math.inf


def test_number_of_arcs_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if one arc more than the limit is accepted, or a curve with as many is refused."""
    steps = StepFunction((10.0, 20.0, 30.0), (1.0, 1.1, 1.2, 1.3))
    monkeypatch.setattr(deceleration_curve, "MAX_PIECES", 4)
    assert len(DecelerationCurve(1000.0, 0.0, steps, LEVEL, 40.0, 60.0).arcs) == 4
    monkeypatch.setattr(deceleration_curve, "MAX_PIECES", 3)
    with pytest.raises(ValueError) as refused:
        DecelerationCurve(1000.0, 0.0, steps, LEVEL, 40.0, 60.0)
    assert str(refused.value) == "more than 3 arcs of a braking curve; simplify the gradients"


def test_speeds_outside_the_curve() -> None:
    """Breaks if a speed beyond an end has a location, the end has none, or a message has other speeds."""
    between = StepFunction((900.0, 1000.0), (-2.0, 0.0, -2.0))
    curve = DecelerationCurve(1000.0, 10.0, ONE, between, 15.0, 40.0)
    end = math.sqrt(300.0)
    assert curve.location(10.0) == 1000.0 and curve.location(curve.end_speed) == pytest.approx(900.0)
    upper = f"the braking curve ends at {3.6 * end:.4g} km/h; give lower speeds than {3.6 * end + 0.36:.4g} km/h"
    lower = (
        "the braking curve ends at 36 km/h, beyond its target the gradient is stronger than the brake; give speeds "
        "above that, not 34.2 km/h"
    )
    for speed, text in ((end + 0.1, upper), (9.5, lower)):
        with pytest.raises(ValueError) as refused:
            curve.location(speed)
        assert str(refused.value) == text
