"""Braking curves and limits against SUBSET-026, 3.13, a small-step integration, and numbers by hand."""

import math
from math import inf

import numpy as np
import pytest
from curve_trains import FIXED, LEVEL, ONE
from curve_trains import supervised_train as train
from hypothesis import given
from hypothesis import strategies as st

from train_ato.supervision import deceleration_curve, train_model
from train_ato.supervision.deceleration_curve import DecelerationCurve, advanced_speed
from train_ato.supervision.limits import (
    BrakingTarget,
    InterventionTimes,
    TargetLimits,
    intervention_times,
    release_speed,
    release_start,
    trip_location,
)
from train_ato.supervision.odometry import MotionEstimate, motion_estimate, odometer_error, speed_measurement_error
from train_ato.supervision.settings import FixedValues
from train_ato.supervision.step_function import (
    EMERGENCY_MARGIN,
    StepFunction,
    SupervisionSpeeds,
    ceiling_speeds,
    gradient_acceleration,
    lowest_under_train,
)
from train_ato.supervision.track_supervision import (
    WIDEST_MOTION,
    TrackSupervision,
    ceiling,
    limits_under_train,
    speeds_to_end,
)


@pytest.mark.parametrize(
    ("limit", "warning", "service", "emergency"),
    [(0, 4, 5.5, 7.5), (110, 4, 5.5, 7.5), (125, 4.5, 6.175, 8.625), (160, 5, 7.75, 11.25), (300, 5, 10, 15)],
)
def test_ceiling_margins(limit: float, warning: float, service: float, emergency: float) -> None:
    """Breaks if a margin of A.3.1 or its speed range is wrong."""
    speeds = ceiling_speeds(limit / 3.6)
    found = [3.6 * speed - limit for speed in (speeds.permitted, speeds.warning, speeds.service, speeds.emergency)]
    assert found == pytest.approx([0, warning, service, emergency])


@pytest.mark.parametrize(("command", "feedback", "traction", "cut_off", "expected"), [
    # expected: T_traction, T_berem, T_bs1, T_bs2, indication before the permitted speed [s]; T_be 5 s, T_bs 6 s
    (False, False, False, 0.0, (0, 5, 0, 0, 5)), (False, False, False, 3.0, (3, 2, 0, 0, 5)),
    (False, False, False, 7.0, (7, 0, 0, 0, 5)), (False, False, True, 3.0, (1, 4, 0, 0, 5)),
    (True, False, True, 3.0, (0, 5, 6, 6, 5)), (True, False, True, 10.0, (2, 3, 6, 6, 5)),
    (True, True, False, 1.0, (1, 4, 6, 6, 5)),
])  # fmt: skip
def test_times_of_the_interfaces(command, feedback, traction, cut_off, expected):
    """Breaks if an interface combination of 3.13.9.3.2.3 or 3.13.9.3.3.3-5 gives other times."""
    given_train = train(
        service_command=command, service_feedback=feedback, traction_command=traction, t_traction_cut_off=cut_off
    )
    times = intervention_times(given_train, 0.0, FIXED)
    found = (times.traction, times.remaining, times.bs1, times.bs2, times.indication)
    assert found == pytest.approx(expected)


def test_feedback_has_two_seconds_from_the_service_to_the_emergency_brake() -> None:
    """Breaks if T_bs2 is below 2 s with feedback (3.13.9.3.3.4.1), or this raises T_bs1 or a train without feedback."""
    end, speed = BrakingTarget(1000.0, kind="EOA"), 50 / 3.6
    gaps = {}
    for feedback in (True, False):
        short = train(service_time=1.0, service_command=True, service_feedback=feedback)
        limits = TargetLimits(short, end, LEVEL, FIXED)
        gaps[feedback] = limits.emergency(speed) - limits.service_from_ebd(speed)
        assert limits.sbd.location(speed) - limits.service_from_sbd(speed) == pytest.approx(speed)
    assert gaps == pytest.approx({True: 27.78, False: 13.89}, abs=0.005)
    delayed = train(service_time=1.0, service_command=True, service_feedback=True, traction_command=True,
                    t_traction_cut_off=7.0)  # fmt: skip
    assert intervention_times(delayed, 0.0, FIXED).traction == pytest.approx(7.0 - (2.0 + 2.0))


def test_limits_with_acceleration_and_speed_error() -> None:
    """Breaks if V_bec or D_bec of 3.13.9.3.2.10 is wrong, or the acceleration after the traction exceeds 0.4 m/s²."""
    limits = TargetLimits(train(t_traction_cut_off=2.0), BrakingTarget(1000.0, kind="EOA"), LEVEL, FIXED)
    motion = MotionEstimate(acceleration=0.5, speed_error=1.0)
    speed = 20.0  # V_delta1 = 0.5 · 2, V_delta2 = 0.4 · 3
    reached = 20.0 + 1.0 + 1.0 + 1.2
    travelled = (20.0 + 1.0 + 0.5) * 2.0 + (20.0 + 1.0 + 1.0 + 0.6) * 3.0
    assert limits.emergency(speed, motion) == pytest.approx(1000.0 - reached**2 / 2 - travelled)
    second = MotionEstimate(acceleration=0.5, speed_error=1.0, later_acceleration=0.1)  # V_delta2 = 0.1 · 3
    travelled = (20.0 + 1.0 + 0.5) * 2.0 + (20.0 + 1.0 + 1.0 + 0.15) * 3.0
    assert limits.emergency(speed, second) == pytest.approx(1000.0 - 22.3**2 / 2 - travelled)
    assert limits.emergency(speed, MotionEstimate(acceleration=-0.5)) == limits.emergency(speed)


def test_target_speed_above_zero() -> None:
    """Breaks if the EBD does not cross the ceiling speed at the target, or V_bec falls below the target speed."""
    target = 60 / 3.6
    limits = TargetLimits(train(), BrakingTarget(1000.0, target), LEVEL, FIXED)
    assert limits.ebd.location(67.5 / 3.6) == pytest.approx(1000.0)
    assert limits.ebd.speed(1000.0) == pytest.approx(67.5 / 3.6)
    assert limits.emergency(40 / 3.6) == limits.emergency(target)
    assert limits.permitted(target) == pytest.approx(1000.0 + (67.5**2 - 60**2) / 3.6**2 / 2 - 9 * target)
    weak = TargetLimits(train(emergency=0.1), BrakingTarget(1000.0, target), LEVEL, FIXED)
    assert weak.service(target) - 4 * target > weak.permitted(target) == 1000.0


def test_end_of_authority_uses_the_more_restrictive_curve() -> None:
    """Breaks if SBI1 is lost, the SvL behind the EOA does not relax SBI2, or the indication follows an overspeed."""
    both = TargetLimits(train(), BrakingTarget(1000.0, kind="EOA", end_of_authority=900.0), LEVEL, FIXED)
    assert both.service_from_sbd(20.0) == pytest.approx(900.0 - 400 / 1.4)
    assert both.service_from_ebd(20.0) == pytest.approx(1000.0 - 200.0 - 100.0)
    assert both.service(20.0) == both.service_from_sbd(20.0)
    assert both.service(5.0) == pytest.approx(900.0 - 25 / 1.4)
    motion = MotionEstimate(under_reading=120.0, over_reading=120.0)
    assert both.service(20.0, motion) == both.service_from_ebd(20.0, motion)  # max safe front before estimated front
    alone = TargetLimits(train(service=None), BrakingTarget(1000.0, kind="EOA", end_of_authority=900.0), LEVEL, FIXED)
    assert alone.sbd is None and alone.service(20.0) == alone.service_from_ebd(20.0)
    with pytest.raises(ValueError, match="SBD and SBI1 need a service deceleration"):
        alone.service_from_sbd(20.0)
    limits = TargetLimits(train(), BrakingTarget(1000.0), LEVEL, FIXED, 30.0)
    assert limits.indication(35.0) == limits.indication(30.0) < limits.indication(29.0)
    later = TargetLimits(train(), BrakingTarget(1000.0), LEVEL, FixedValues(driver_time_twice=True), 30.0)
    assert limits.indication(20.0) - later.indication(20.0) == pytest.approx(4.0 * 20.0)


def test_lowest_grade_under_the_train_and_rotating_mass() -> None:
    """Breaks if the rear is not compensated, or the masses for uphill, downhill or a nominal value are exchanged."""
    grades = [(1000.0, 5.0), (1500.0, -10.0), (1600.0, 20.0)]
    lowest = lowest_under_train(grades, 300.0)
    places = {900: 0, 1200: 0, 1299: 0, 1301: 5, 1499: 5, 1501: -10, 1899: -10, 1901: 20}
    assert {place: lowest.at(place) for place in places} == places
    free = gradient_acceleration(grades, 300.0, None, FIXED)
    assert free.at(2000.0) == pytest.approx(9.81 * 20 / 1150) and free.at(1600.0) == pytest.approx(-9.81 * 10 / 1020)
    nominal = gradient_acceleration(grades, 300.0, 6.0, FIXED)
    assert nominal.at(2000.0) == pytest.approx(9.81 * 20 / 1060) and nominal.at(1600.0) == pytest.approx(
        -9.81 * 10 / 1060
    )


GRADES = st.lists(
    st.tuples(st.floats(0, 5000), st.floats(-20, 20)), min_size=0, max_size=8, unique_by=lambda g: round(g[0], 3)
).map(sorted)
STEPS = st.lists(st.tuples(st.floats(1, 60), st.floats(0.4, 1.5)), max_size=6, unique_by=lambda s: round(s[0], 3))


@given(GRADES, STEPS, st.floats(10, 800), st.floats(0, 30))
def test_curve_against_small_steps(grades, steps, length, foot):
    """Breaks if an arc begins or ends at a wrong speed or location, or takes a deceleration of its neighbour."""
    ordered = sorted(steps)
    brake = StepFunction(tuple(speed for speed, _ in ordered), (0.9, *(value for _, value in ordered)))
    gradient = gradient_acceleration(grades, length, None, FIXED)
    curve = DecelerationCurve(5000.0, foot, brake, gradient, needed_speed=62.0, top_speed=70.0)
    place, square, dx = 5000.0, foot * foot, 0.5
    while square < 60.0**2 and place > -5000.0:
        middle = math.sqrt(square)
        square += 2.0 * dx * (brake.above(middle)[0] + gradient.at(place - dx / 2))
        place -= dx
        assert abs(curve.speed(place) - math.sqrt(square)) <= 0.05 + 1.5 * dx / max(middle, 0.5)
    for speed in (foot, 31.0, 55.0):
        if speed >= foot:
            assert curve.speed(curve.location(speed)) == pytest.approx(speed, abs=1e-6)


@given(GRADES, st.floats(0, 0.6), st.floats(0, 3), st.sampled_from([0.0, 10.0]), st.floats(12, 45))
def test_speeds_invert_the_locations(grades, acceleration, error, target_speed, speed):
    gradient = gradient_acceleration(grades, 200.0, None, FIXED)
    supervised = train(service_command=True, traction_command=True, t_traction_cut_off=9.0, service=None)
    limits = TargetLimits(supervised, BrakingTarget(5000.0, target_speed), gradient, FIXED)
    motion = MotionEstimate(acceleration, error, 30.0, 30.0)
    for name in ("permitted", "warning", "service", "emergency"):
        location = getattr(limits, name)(speed, motion)
        if name == "permitted" and location >= 5000.0:
            continue  # limited to the target location
        found = getattr(limits.speeds(location - 30.0, motion), name)
        assert found == pytest.approx(max(speed, getattr(limits.floor, name)), abs=1e-6)


def test_a_curve_ends_where_the_gradient_is_stronger() -> None:
    """Breaks if a steep grade far behind or beyond the target refuses the curve, or one inside it does not."""
    weak = StepFunction.constant(0.3)
    steep = gradient_acceleration([(0.0, -40.0), (1000.0, 0.0), (3000.0, -40.0)], 100.0, 0.0, FIXED)
    short = DecelerationCurve(2900.0, 0.0, weak, steep, needed_speed=30.0, top_speed=60.0)
    assert short.end_speed == pytest.approx(math.sqrt(2 * 0.3 * 1800.0)) and short.location(30.0) == pytest.approx(1400)
    with pytest.raises(ValueError, match=r"the braking curve ends at 118\.3 km/h"):
        short.location(33.0)
    with pytest.raises(ValueError, match="is not stronger than the gradient"):
        DecelerationCurve(2900.0, 0.0, weak, steep, needed_speed=33.0, top_speed=60.0)
    beyond = DecelerationCurve(2999.0, 10.0, weak, steep, needed_speed=20.0, top_speed=60.0)
    assert beyond.location(10.0) == 2999.0
    with pytest.raises(ValueError, match="beyond its target the gradient is stronger"):
        beyond.location(5.0)


def test_release_speed_and_odometry() -> None:
    """Breaks if build-up, trip location, speed error or limit are not in the release speed, or odometry is wrong."""
    limits = TargetLimits(train(), BrakingTarget(1100.0, kind="EOA", end_of_authority=1000.0), LEVEL, FIXED)
    assert trip_location(1000.0, 700.0) == pytest.approx(1040.0)
    assert trip_location(1000.0, 700.0, balise_accuracy=3.0) == pytest.approx(1046.0)
    wide = MotionEstimate(under_reading=40.0, over_reading=30.0)
    assert trip_location(1000.0, 700.0, wide) == pytest.approx(1070.0)
    exact = release_speed(limits, 1040.0, inhibit_compensation=True)
    assert 1040.0 + 5.0 * exact + exact**2 / 2 == pytest.approx(1100.0)
    careful = release_speed(limits, 1040.0)
    faster = careful + 2 / 3.6
    assert 1040.0 + 5.0 * faster + faster**2 / 2 == pytest.approx(1100.0)
    assert release_speed(limits, 1100.0) == 0.0
    slow = TargetLimits(train(), limits.target, LEVEL, FIXED, speed_limit=1.5)
    assert release_speed(slow, 1040.0) == 1.5 < careful
    start = release_start(limits, exact, inhibit_compensation=True)
    assert start == pytest.approx(min(1000 - exact**2 / 1.4, 1100 - exact**2 / 2 - 5 * exact))
    assert odometer_error(1000.0) == 55.0 and odometer_error(0.0, 3.0) == 8.0
    assert [3.6 * speed_measurement_error(v / 3.6) for v in (0, 30, 265, 500)] == pytest.approx([2, 2, 7, 12])
    motion = motion_estimate(100 / 3.6, 0.1, 500.0)
    assert (motion.acceleration, motion.under_reading, motion.over_reading) == (0.1, 30.0, 30.0)


def test_supervision_of_a_line() -> None:
    """Breaks if target or ceiling is lost, a passed one stays, release is early, or a rise acts before the rear."""
    end = BrakingTarget(5000.0, kind="EOA")
    limits = [(0.0, 40.0), (2000.0, 20.0), (2500.0, 40.0)]
    supervision = TrackSupervision(train(), [(0.0, 0.0)], limits, end)
    assert [entry.target.location for entry in supervision.targets] == [0.0, 2000.0, 5000.0]
    assert supervision.evaluate(500.0).permitted == 40.0
    assert 20.0 < supervision.evaluate(1500.0).permitted < 40.0
    assert supervision.evaluate(2300.0).permitted == 20.0
    assert supervision.evaluate(2690.0).permitted == 20.0  # the rear has not passed the end of the restriction
    assert supervision.evaluate(2710.0).permitted > 30.0
    assert supervision.evaluate(4990.0).emergency < 5.0
    assert supervision.evaluate(5000.1).emergency == supervision.evaluate(5200.0).emergency == 0.0
    before = [supervision.evaluate(place, MotionEstimate(under_reading=50.0)) for place in (1700.0, 4500.0)]
    after = [supervision.evaluate(place) for place in (1750.0, 4550.0)]
    assert [a.emergency for a in before] == pytest.approx([a.emergency for a in after])
    released = TrackSupervision(train(), [(0.0, 0.0)], limits, end, release=4.0)
    assert released.evaluate(4995.0).emergency == 4.0
    assert released.evaluate(4500.0) == supervision.evaluate(4500.0)
    assert limits_under_train([(0, 30), (1000, 20), (1500, 40)], 200) == [(0, 30), (1000, 20), (1700, 40)]
    assert limits_under_train([(0, 30), (1000, 20), (1100, 40), (1150, 10)], 200) == [(0, 30), (1000, 20), (1150, 10)]
    assert limits_under_train([], 200) == []


@pytest.mark.parametrize(
    "motion",
    [
        MotionEstimate(0.3, 1.0, 40.0, 25.0),
        MotionEstimate(0.3, 1.0, 3000.0, 25.0),
        MotionEstimate(4.0, 1.0, 2500.0, 25.0),
        MotionEstimate(0.3, 9.0, 2500.0, 25.0),
    ],
)
def test_every_target_within_reach_is_evaluated(motion: MotionEstimate) -> None:
    """Breaks if a target is skipped whose limits are lower than the ceiling, at any position, also for wide errors."""
    limits = [(0.0, 45.0), (3000.0, 30.0), (3500.0, 25.0), (3600.0, 40.0), (6000.0, 10.0), (9000.0, 45.0)]
    supervision = TrackSupervision(
        train(service_command=True, t_traction_cut_off=5.0),
        [(0.0, 0.0), (5000.0, -15.0)],
        limits,
        BrakingTarget(12e3, kind="EOA"),
    )
    for place in range(-2000, 12500, 37):
        found = supervision.evaluate(float(place), motion)
        every = [ceiling(supervision.records.ceilings, place - motion.over_reading, place + motion.under_reading)]
        every += [
            entry.speeds(float(place), motion)
            for entry in supervision.targets
            if place + motion.under_reading <= entry.target.location or entry.target.kind == "EOA"
        ]
        for name in ("permitted", "warning", "service", "emergency"):
            assert getattr(found, name) == min(getattr(speeds, name) for speeds in every), (place, name)


def test_arcs_beyond_the_crossing_at_a_step_of_the_brake() -> None:
    """Breaks if the curve below the crossing speed has the brake of another speed."""
    brake = StepFunction((10.0,), (1.0, 2.0))
    curve = DecelerationCurve(1000.0, 20.0, brake, LEVEL, needed_speed=30.0, top_speed=40.0)
    assert [curve.location(speed) for speed in (20.0, 10.0, 0.0)] == [1000.0, 1075.0, 1125.0]
    assert curve.speed(1037.5) == pytest.approx(math.sqrt(250.0))
    assert curve.speed(1100.0) == pytest.approx(math.sqrt(50.0))
    assert curve.location(30.0) == pytest.approx(1000.0 - (900.0 - 400.0) / 4)


@pytest.mark.parametrize(
    ("bound", "stop"), [(1050.0, 1050 + 300 / 4), (1199.9, 1199.9 + 0.2 / 4), (1200.0, 1200.0), (1300.0, 1200.0)]
)
def test_arcs_beyond_the_crossing_at_a_step_of_the_gradient(bound: float, stop: float) -> None:
    """Breaks if the gradient beyond the crossing has no effect, or the last arc before the standstill is lost."""
    curve = DecelerationCurve(1000.0, 20.0, ONE, StepFunction((bound,), (0.0, 1.0)), needed_speed=30.0, top_speed=40.0)
    assert curve.location(0.0) == pytest.approx(stop, abs=1e-9)
    assert curve.speed(1040.0) == pytest.approx(math.sqrt(320.0))
    assert curve.speed(stop) == pytest.approx(0.0, abs=1e-6)


def test_ends_of_a_curve(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a deceleration of 0 has a curve, the needed speed is refused, or arcs exceed top speed or number."""
    before, beyond = StepFunction((900.0,), (-1.0, 0.0)), StepFunction((1000.0,), (0.0, -1.0))
    with pytest.raises(ValueError, match=r"the brake \(1 m/s² at 50.91 km/h\) is not stronger"):
        DecelerationCurve(1000.0, 0.0, ONE, before, needed_speed=20.0, top_speed=40.0)
    short = DecelerationCurve(1000.0, 0.0, ONE, before, needed_speed=14.0, top_speed=40.0)
    assert short.end_speed == pytest.approx(math.sqrt(200.0))
    assert DecelerationCurve(1000.0, 20.0, ONE, beyond, needed_speed=30.0, top_speed=40.0).arcs["speed"].tolist() == [
        20.0
    ]
    none_above = StepFunction((30.0,), (1.0, 0.0))
    assert DecelerationCurve(1000.0, 0.0, none_above, LEVEL, needed_speed=30.0, top_speed=60.0).end_speed == 30.0
    more_above = StepFunction((30.0,), (1.0, 2.0))
    assert DecelerationCurve(1000.0, 0.0, more_above, LEVEL, needed_speed=20.0, top_speed=30.0).end_speed == 30.0
    assert DecelerationCurve(1000.0, 0.0, more_above, LEVEL, needed_speed=20.0, top_speed=30.1).end_speed == math.inf
    steps = StepFunction((10.0, 20.0, 30.0), (1.0, 1.1, 1.2, 1.3))
    monkeypatch.setattr(deceleration_curve, "MAX_PIECES", 4)
    assert len(DecelerationCurve(1000.0, 0.0, steps, LEVEL, needed_speed=40.0, top_speed=60.0).arcs) == 4
    monkeypatch.setattr(deceleration_curve, "MAX_PIECES", 3)
    with pytest.raises(ValueError) as refused:
        DecelerationCurve(1000.0, 0.0, steps, LEVEL, needed_speed=40.0, top_speed=60.0)
    assert str(refused.value) == "more than 3 arcs of a braking curve; simplify the gradients"


def test_speeds_outside_the_curve() -> None:
    """Breaks if a speed beyond an end has a location, the end has none, or a message has other speeds."""
    between = StepFunction((900.0, 1000.0), (-2.0, 0.0, -2.0))
    curve = DecelerationCurve(1000.0, 10.0, ONE, between, needed_speed=15.0, top_speed=40.0)
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


@pytest.mark.parametrize("percentage", [30.0, 250.0])
@pytest.mark.parametrize(
    ("position", "length"), [("PassengerTrainInP", 900.0), ("FreightTrainInP", 1500.0), ("FreightTrainInG", 1500.0)]
)
def test_the_limits_of_the_conversion_model_belong_to_it(percentage, position, length):
    """Breaks if a train with a limit of 3.13.3.2.1 is refused."""
    train_model.check_conversion(percentage, position, length, 200 / 3.6)


@pytest.mark.parametrize(
    ("position", "percentage", "length", "speed_kmh", "value", "remedy"),
    [
        ("PassengerTrainInP", 29.9, 900.0, 200.0, "brake_percentage: 29.9 %", "; give 30 ... 250 %"),
        ("PassengerTrainInP", 250.1, 900.0, 200.0, "brake_percentage: 250.1 %", "; give 30 ... 250 %"),
        ("PassengerTrainInP", 100.0, 900.0, 200.1, "max_speed_kmh: 200.1 km/h", "; give at most 200 km/h"),
        ("PassengerTrainInP", 100.0, 900.1, 200.0, "length_m: 900.1 m", " of PassengerTrainInP; give at most 900 m"),
        ("FreightTrainInP", 100.0, 1500.1, 200.0, "length_m: 1500.1 m", " of FreightTrainInP; give at most 1500 m"),
        ("FreightTrainInG", 100.0, 1500.1, 200.0, "length_m: 1500.1 m", " of FreightTrainInG; give at most 1500 m"),
    ],
)
def test_trains_outside_the_conversion_model(position, percentage, length, speed_kmh, value, remedy):
    """Breaks if a train beyond a limit is accepted, or the line lacks key, value or remedy."""
    with pytest.raises(ValueError) as refused:
        train_model.check_conversion(percentage, position, length, speed_kmh / 3.6)
    assert str(refused.value) == f"{value} is outside the conversion model{remedy}, or give a gamma train"
    with pytest.raises(ValueError, match="is outside the conversion model"):
        train_model.lambda_brake(percentage, position, length, speed_kmh / 3.6, kv_int=ONE, kr_int=ONE, kt_int=1.0)


def test_corrections_of_time_and_deceleration() -> None:
    """Breaks if Kt_int does not act on T_be, or acts on T_bs, or the mix continues beyond its pivots."""
    full, half = (
        train_model.lambda_brake(100.0, "PassengerTrainInP", 300.0, 50.0, kv_int=ONE, kr_int=ONE, kt_int=kt)
        for kt in (1.0, 0.5)
    )
    assert full.emergency_time.to_standstill == pytest.approx(2.3 + 0.17 * 16)
    assert half.emergency_time.to_standstill == pytest.approx(0.5 * full.emergency_time.to_standstill)
    assert half.emergency_time.to_speed == pytest.approx(0.5 * full.emergency_time.to_speed)
    assert half.service_time == full.service_time
    lower, upper = StepFunction.constant(0.8), StepFunction.constant(0.6)
    for largest, expected in ((0.2, 0.8), (0.7, 0.8), (0.8, 0.7), (0.9, 0.6), (1.5, 0.6)):
        assert train_model.passenger_kv_int(lower, upper, 0.7, 0.9, largest).at(10.0) == pytest.approx(expected), (
            largest
        )


@pytest.mark.parametrize("bound", [100.0, 120.0, 150.0])
def test_first_step_that_ends_at_the_bound_of_another(bound: float) -> None:
    """Breaks if a step of no width is made where V_lim is exactly 100, 120 or 150 km/h."""
    near = (bound / train_model.LIMIT_FACTOR) ** (1 / train_model.LIMIT_EXPONENT)
    exact = [near * (1 + k * 2**-52) for k in range(-64, 65)]
    percentage = next(value for value in exact if train_model.LIMIT_FACTOR * value**train_model.LIMIT_EXPONENT == bound)
    steps = train_model.basic_deceleration(percentage)
    assert steps.bounds[0] == pytest.approx(bound / 3.6)
    assert len(steps.bounds) == {100.0: 4, 120.0: 3, 150.0: 2}[bound]


END = BrakingTarget(1000.0, kind="EOA")
NAMES = ("permitted", "warning", "service", "emergency")


def test_refusals_have_value_and_remedy() -> None:
    """Breaks if an end has a speed, steps are not ordered, or the message lacks the name of a missing value."""
    with pytest.raises(ValueError) as refused:
        BrakingTarget(1000.0, 5.0, "EOA")
    assert str(refused.value) == "an end of authority has the target speed 0; give the kind MRSP or LOA"
    assert BrakingTarget(1000.0, 5.0, "LOA").eoa == BrakingTarget(1100.0, 0.0, "EOA", 1000.0).eoa == 1000.0
    with pytest.raises(ValueError) as refused:
        TargetLimits(train(service=None), END, LEVEL, FIXED).service_curve()
    assert str(refused.value) == "A_brake_service: the curves SBD and SBI1 need a service deceleration; give it"
    with pytest.raises(ValueError) as refused:
        StepFunction((1.0,), (5.0,))
    assert str(refused.value) == "1 bounds need 2 values, not 1"
    for bounds in ((2.0, 2.0), (2.0, 1.0)):
        with pytest.raises(ValueError) as refused:
            StepFunction(bounds, (5.0, 6.0, 7.0))
        assert str(refused.value) == "bounds of a step function must rise; sort them"


@pytest.mark.parametrize(("reached", "refused"), [(48.0, True), (53.0, True), (54.0, False)])
def test_needed_speed_is_above_the_maximum_speed(reached: float, refused: bool) -> None:
    """Breaks if a curve may end below the emergency ceiling speed of the maximum speed, 53.54 m/s."""
    assert 53.0 < 50.0 + EMERGENCY_MARGIN.above(50.0) < 54.0
    steep = StepFunction((1000.0 - reached**2 / 2,), (-1.5, 0.0))
    given_train = train(service=None)
    if refused:
        with pytest.raises(ValueError, match="is not stronger than the gradient"):
            TargetLimits(given_train, END, steep, FIXED)
    else:
        assert TargetLimits(given_train, END, steep, FIXED).ebd.end_speed == pytest.approx(reached)


def test_curves_reach_the_largest_compensated_speed() -> None:
    """Breaks if a curve with many steps ends below the speed with 5 m/s², the later 0.4 m/s² and an error of 10 m/s."""
    steps = StepFunction(tuple(0.5 * k for k in range(1, 400)), (1.0,) * 400)
    for cut_off in (0.0, 3.0):
        limits = TargetLimits(train(steps, t_traction_cut_off=cut_off), END, LEVEL, FIXED)
        fastest = 50.0 + EMERGENCY_MARGIN.above(50.0)
        reached = fastest + 10.0 + 5.0 * cut_off + 0.4 * (5.0 - cut_off)
        motion = MotionEstimate(acceleration=5.0, speed_error=10.0)
        travelled = (fastest + 10.0 + 2.5 * cut_off) * cut_off
        travelled += (reached - 0.2 * (5.0 - cut_off)) * (5.0 - cut_off)
        assert limits.emergency(fastest, motion) == pytest.approx(1000.0 - reached**2 / 2 - travelled)
        with pytest.raises(ValueError, match="the braking curve ends at"):
            limits.emergency(fastest + 1.0, motion)


def test_floor_and_indication_of_a_target() -> None:
    """Breaks if speeds beyond a target fall below its ceiling speeds, or the indication is that of exact odometry."""
    target = TargetLimits(train(), BrakingTarget(1000.0, 20.0), LEVEL, FIXED)
    assert target.speeds(1e4) == target.floor == ceiling_speeds(20.0)
    assert TargetLimits(train(), END, LEVEL, FIXED).speeds(1e4) == SupervisionSpeeds(0.0, 0.0, 0.0, 0.0)
    limits = TargetLimits(train(), END, LEVEL, FIXED)
    motion = MotionEstimate(0.2, 1.0, 30.0)
    assert limits.indication(20.0, motion) == pytest.approx(limits.service(20.0, motion) - 20.0 * (4.0 + 5.0))


@pytest.mark.parametrize("service_time", [1.0, 6.0])
@pytest.mark.parametrize("command", [True, False])
@pytest.mark.parametrize("svl", [1000.0, 5000.0])
def test_speeds_invert_the_locations_of_an_end(service_time: float, command: bool, svl: float) -> None:
    """Breaks if SBD or EBD are evaluated with other times or at another front for speeds than for locations."""
    given_train = train(service_time=service_time, service_command=command)
    limits = TargetLimits(given_train, BrakingTarget(svl, 0.0, "EOA", 1000.0), LEVEL, FIXED)
    motion = MotionEstimate(0.2, 1.0, 30.0, 50.0)
    for speed in (5.0, 20.0, 45.0):
        for name in NAMES:
            front = getattr(limits, name)(speed, motion) - motion.under_reading
            assert getattr(limits.speeds(front, motion), name) == pytest.approx(speed, abs=1e-6), (name, speed)


def test_parts_of_the_limits_by_hand() -> None:
    """Breaks if build-up, end of a curve, step, odometer error, trip, first gradient or rotating mass is wrong."""
    time = train_model.BuildUpTime(3.0, 4.0)
    assert [time.for_target(speed) for speed in (0.0, 0.1, 1.0, 20.0)] == [3.0, 4.0, 4.0, 4.0]
    curve = DecelerationCurve(1000.0, 0.0, StepFunction.constant(1.0), LEVEL, needed_speed=30.0, top_speed=40.0)
    assert advanced_speed(curve.arcs, 1200.0, 0.0, 0.0, 0.0) == 0.0
    assert advanced_speed(curve.arcs, 1200.0, 2.0, 3.0, 5.0) == -5.0
    steps = StepFunction((10.0, 20.0, 30.0), (1.0, 2.0, 3.0, 4.0))
    assert [steps.largest_up_to(place) for place in (5.0, 10.0, 10.1, 20.0, 25.0, 99.0)] == [1, 1, 2, 2, 3, 4]
    motion = motion_estimate(20.0, 0.0, 100.0, 3.0)
    assert (motion.under_reading, motion.over_reading) == (13.0, 13.0)
    assert trip_location(1000.0, 1005.0) == trip_location(1000.0, 1000.0) == 1010.0
    lowest = lowest_under_train([(1000.0, -10.0), (1100.0, 5.0)], 300.0)
    assert [lowest.at(place) for place in (-1e4, 900.0, 1000.0, 1001.0, 1400.0, 1401.0)] == [0, 0, 0, -10, -10, 5]
    slight = gradient_acceleration([(0.0, 0.5), (1000.0, -0.5)], 100.0, None, FIXED)
    assert slight.at(500.0) == pytest.approx(9.81 * 0.5 / 1150)
    assert slight.at(2000.0) == pytest.approx(-9.81 * 0.5 / 1020)


@pytest.mark.parametrize(("svl", "from_sbd"), [(1000.0, False), (5000.0, True)])
@pytest.mark.parametrize("inhibit", [False, True])
def test_start_of_the_release_speed(svl: float, from_sbd: bool, inhibit: bool) -> None:
    """Breaks if the start is that of the present acceleration and speed error, or of another front."""
    limits = TargetLimits(train(), BrakingTarget(svl, 0.0, "EOA", 1000.0), LEVEL, FIXED)
    motion = MotionEstimate(0.3, 2.0, 30.0, 50.0)
    reached = 10.0 + (0.0 if inhibit else speed_measurement_error(10.0))
    start = 1000.0 - 10.0**2 / 1.4 if from_sbd else 1000.0 - reached**2 / 2 - 5.0 * reached - 30.0
    words = {"inhibit_compensation": True} if inhibit else {}
    assert release_start(limits, 10.0, motion, **words) == pytest.approx(start)


def test_targets_of_a_line() -> None:
    """Breaks if a target has another speed, an equal speed is one, an end is passed, or a fixed mass is used."""
    limits = [(0.0, 60.0), (1000.0, 55.0), (2000.0, 30.0), (3000.0, 20.0), (4000.0, 10.0)]
    line = TrackSupervision(train(), [], limits, BrakingTarget(4000.0, kind="EOA"))
    found = [(entry.target.location, entry.target.speed, entry.speed_limit) for entry in line.targets]
    assert found == [(2000.0, 30.0, 50.0), (3000.0, 20.0, 30.0), (4000.0, 0.0, 50.0)]
    open_end = TrackSupervision(train(), [], limits, None)
    assert [entry.target.location for entry in open_end.targets] == [2000.0, 3000.0, 4000.0]
    assert open_end.evaluate(9e3) == ceiling_speeds(10.0)
    assert TrackSupervision(train(), [], [], None).evaluate(1e3) == ceiling_speeds(50.0)
    line = TrackSupervision(train(), [], [], END)
    assert line.evaluate(1100.0) == SupervisionSpeeds(0.0, 0.0, 0.0, 0.0)
    grades = [(0.0, -10.0)]
    line = TrackSupervision(train(m_rotating_nom=10.0), grades, [], END)
    alone = TargetLimits(train(), END, gradient_acceleration(grades, 200.0, 10.0, FIXED), FIXED)
    assert line.targets[0].emergency(20.0) == alone.emergency(20.0)


def test_reason_of_a_missing_service_curve() -> None:
    """Breaks if the reason is lost, or the emergency-brake curve does not supervise the end alone."""
    grades = [(0.0, -20.0)]
    for service, reason in (
        (0.7, None),
        (None, "the train has no service deceleration"),
        (0.1, "the brake (0.1 m/s² at 0 km/h) is not stronger than the gradient (0.1924 m/s² at 1000 m): no braking"
              " curve; give a stronger brake or a smaller gradient"),
    ):  # fmt: skip
        line = TrackSupervision(train(service=service), grades, [], END)
        assert line.without_service_curve == reason
        alone = TrackSupervision(train(service=None), grades, [], END)
        assert (line.targets[0].sbd is None) == (reason is not None)
        assert (line.evaluate(600.0) == alone.evaluate(600.0)) == (reason is not None)
        assert line.evaluate(600.0).emergency == alone.evaluate(600.0).emergency < 30.0


def test_train_without_interfaces() -> None:
    """Breaks if a feedback or cut-off time that was not given acts, or the indication is not 0.8 T_bs or 5 s."""
    for words, times in (
        ({}, (0.0, 5.0, 0.0, 0.0, 8.0)),
        ({"service_command": True}, (0.0, 5.0, 10.0, 10.0, 8.0)),
        ({"service_command": True, "service_feedback": True}, (0.0, 5.0, 10.0, 10.0, 5.0)),
    ):
        given_train = train(service_time=10.0, **words)
        assert intervention_times(given_train, 0.0, FIXED) == InterventionTimes(*times), words


def test_ceiling_under_the_confidence_interval() -> None:
    """Breaks if exact odometry has a distance, a limit between min and max safe front is lost, or one beyond counts."""
    line = TrackSupervision(train(), [], [(0.0, 30.0), (1000.0, 40.0), (3000.0, 30.0)], None)
    places = (1199.9, 1200.1, 2999.9)
    assert [ceiling(line.records.ceilings, place, place).permitted for place in places] == [30.0, 40.0, 40.0]
    assert line.evaluate(1200.1).emergency == ceiling_speeds(40.0).emergency
    limits = [(1000.0, 40.0), (2000.0, 10.0), (2100.0, 30.0), (3000.0, 5.0)]
    line = TrackSupervision(train(), [], limits, None)
    expected = {(0, 900): 50, (900, 1100): 40, (1100, 1200): 40, (1900, 2050): 10, (1900, 2900): 10, (2350, 2900): 30}
    assert {key: round(ceiling(line.records.ceilings, *key).permitted, 9) for key in expected} == expected


def test_a_later_target_with_an_earlier_begin() -> None:
    """Breaks if a small step before a large one hides the large one, or a curve that ends early hides its target."""
    steps = TrackSupervision(train(), [], [(0.0, 45.0), (3000.0, 44.0), (3100.0, 5.0)], None)
    assert steps.evaluate(2000.0) == steps.targets[-1].speeds(2000.0)
    steep = 1000.0 - 54.0**2 / 2  # the curve ends at 54 m/s, below the compensated speed of the widest motion
    grades = [(steep - 5000.0, -200.0), (steep - 200.0, 0.0)]
    short = TrackSupervision(train(service=None), grades, [], END)
    assert 53.9 < short.targets[0].ebd.end_speed < 54.1
    with pytest.raises(ValueError, match="the braking curve ends at"):
        short.targets[0].indication(50.0, WIDEST_MOTION)
    assert short.evaluate(600.0).emergency < 25.0
    behind = TrackSupervision(train(service=None), grades, [(0.0, 50.0), (900.0, 20.0)], END)
    assert list(behind.records.targets["begin"]) == [-inf, -inf]


def test_the_indication_of_a_line_is_that_of_its_targets() -> None:
    """Breaks if the indication is not that of motion and speed, or a curve that ends below the speed has no reason."""
    line, motion = TrackSupervision(train(), [], [(0.0, 45.0), (3000.0, 30.0)], END), MotionEstimate(0.2, 1.0, 30.0)
    place = line.targets[-1].indication(20.0, motion) - motion.under_reading
    assert not line.indicates(place - 0.1, 20.0, motion) and line.indicates(place + 0.1, 20.0, motion)
    exact = line.targets[-1].indication(20.0)
    assert exact - place > 50.0 and not line.indicates(exact - 0.1, 20.0) and line.indicates(exact + 0.1, 20.0)
    steep = TrackSupervision(train(service=None), [(-5458.0, -200.0), (-658.0, 0.0)], [], END)
    with pytest.raises(ValueError, match=r"the braking curve ends at 19\d\.\d km/h"):
        steep.indicates(0.0, 50.0, MotionEstimate(0.0, 5.0))


def test_speeds_to_the_end_have_the_error_since_the_last_balise() -> None:
    """Breaks if the error is not 5 m + 5 % of the distance from a balise, or a limit of the line counts as the end."""
    for release in (None, 4.0):
        line = TrackSupervision(train(), [], [(0.0, 45.0), (500.0, 30.0)], END, release=release)
        fronts, errors = np.array([-50.0, 250.0, 700.0, 990.0]), (17.5, 17.5, 10.0, 9.5)  # balises every 300 m
        end = line.targets[-1]
        expected = [
            end.speeds(front, MotionEstimate(0.0, 2.0 / 3.6, error, error)).permitted
            for front, error in zip(fronts, errors, strict=True)
        ]
        expected[-1] = 0.0 if release is None else release
        found = speeds_to_end(line.records.targets, line.records.arcs, fronts, 300.0)
        np.testing.assert_allclose(found, expected, atol=1e-9)
        assert all(np.diff(found) < 0)
    alone = TrackSupervision(train(), [], [], END).records
    assert speeds_to_end(alone.targets, alone.arcs, fronts, 300.0)[-1] == 0.0
    for limits in ([], [(0.0, 45.0), (500.0, 30.0)]):
        open_end = TrackSupervision(train(), [], limits, None).records
        assert list(speeds_to_end(open_end.targets, open_end.arcs, fronts, 300.0)) == [inf] * 4


@pytest.mark.parametrize(
    "limits",
    [[(0.0, 45.0), (3000.0, 30.0), (3500.0, 25.0), (9000.0, 10.0)], [(0.0, 45.0), (9000.0, 44.0), (9100.0, 5.0)]],
)
@pytest.mark.parametrize("cut_off", [0.0, 20.0])
def test_begin_of_the_targets_covers_the_widest_motion(limits: list[tuple[float, float]], cut_off: float) -> None:
    """Breaks if the begin of a target is that of a smaller motion, or of an earlier target with a later begin."""
    line = TrackSupervision(train(t_traction_cut_off=cut_off), [], limits, None)
    for front in range(-3000, 6000, 50):
        every = [ceiling(line.records.ceilings, front - 2500.0, front + 2500.0)]
        every += [t.speeds(front, WIDEST_MOTION) for t in line.targets if front + 2500.0 <= t.target.location]
        lowest = tuple(min(getattr(speeds, name) for speeds in every) for name in NAMES)
        assert line.evaluate(front, WIDEST_MOTION) == lowest
    top = ceiling_speeds(50.0).emergency
    begins = [target.indication(top, WIDEST_MOTION) - 2500.0 for target in line.targets]
    assert list(line.records.targets["begin"]) == [min(begins[k:]) for k in range(len(begins))]


def test_release_speed_of_a_line() -> None:
    """Breaks if the release speed begins elsewhere than its start, or a passed speed limit lowers it."""
    given_train = train()
    limits = [(0.0, 40.0), (500.0, 3.0), (600.0, 40.0)]
    line = TrackSupervision(given_train, [], limits, END, release=4.0)
    assert line.evaluate(1005.0) == SupervisionSpeeds(4.0, 4.0, 4.0, 4.0)
    assert line.evaluate(499.0).permitted == line.targets[1].speeds(499.0).permitted < 4.0
    for motion in (MotionEstimate(), MotionEstimate(0.3, 1.0, 60.0, 20.0)):
        start = release_start(line.targets[-1], 4.0, motion)
        assert start > 850.0 and line.evaluate(start, motion).service == 4.0
        before = line.evaluate(start - 0.1, motion)
        assert before == line.targets[-1].speeds(start - 0.1, motion) and before.emergency != 4.0
    limits = TargetLimits(train(), BrakingTarget(1000.0, 10.0), LEVEL, FIXED)
    assert release_speed(limits, 2000.0) == 10.0
