"""Limits of single targets and the choice among the targets of a line, with numbers by hand."""

import pytest
from curve_trains import FIXED, LEVEL, supervised_train

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
from train_ato.supervision.odometry import MotionEstimate, motion_estimate, speed_measurement_error
from train_ato.supervision.step_function import (
    EMERGENCY_MARGIN,
    StepFunction,
    SupervisionSpeeds,
    ceiling_speeds,
    gradient_acceleration,
    lowest_under_train,
)
from train_ato.supervision.track_supervision import WIDEST_MOTION, TrackSupervision, ceiling
from train_ato.supervision.train_model import BuildUpTime

END = BrakingTarget(1000.0, kind="EOA")
NAMES = ("permitted", "warning", "service", "emergency")


def test_an_end_of_authority_has_no_speed() -> None:
    with pytest.raises(ValueError) as refused:
        BrakingTarget(1000.0, 5.0, "EOA")
    assert str(refused.value) == "an end of authority has the target speed 0; give the kind MRSP or LOA"
    assert BrakingTarget(1000.0, 5.0, "LOA").eoa == BrakingTarget(1100.0, 0.0, "EOA", 1000.0).eoa == 1000.0


@pytest.mark.parametrize(("reached", "refused"), [(48.0, True), (53.0, True), (54.0, False)])
def test_needed_speed_is_above_the_maximum_speed(reached: float, refused: bool) -> None:
    """Breaks if a curve may end below the emergency ceiling speed of the maximum speed, 53.54 m/s."""
    assert 53.0 < 50.0 + EMERGENCY_MARGIN.above(50.0) < 54.0
    steep = StepFunction((1000.0 - reached**2 / 2,), (-1.5, 0.0))
    train = supervised_train(service=None)
    if refused:
        with pytest.raises(ValueError, match="is not stronger than the gradient"):
            TargetLimits(train, END, steep, FIXED)
    else:
        assert TargetLimits(train, END, steep, FIXED).ebd.end_speed == pytest.approx(reached)


def test_curves_reach_the_largest_compensated_speed() -> None:
    """Breaks if a curve with many steps ends below the speed with 5 m/s², the later 0.4 m/s² and an error of 10 m/s."""
    steps = StepFunction(tuple(0.5 * k for k in range(1, 400)), (1.0,) * 400)
    for cut_off in (0.0, 3.0):
        limits = TargetLimits(supervised_train(steps, t_traction_cut_off=cut_off), END, LEVEL, FIXED)
        fastest = 50.0 + EMERGENCY_MARGIN.above(50.0)
        reached = fastest + 10.0 + 5.0 * cut_off + 0.4 * (5.0 - cut_off)
        motion = MotionEstimate(acceleration=5.0, speed_error=10.0)
        travelled = (fastest + 10.0 + 2.5 * cut_off) * cut_off
        travelled += (reached - 0.2 * (5.0 - cut_off)) * (5.0 - cut_off)
        assert limits.emergency(fastest, motion) == pytest.approx(1000.0 - reached**2 / 2 - travelled)
        with pytest.raises(ValueError, match="the braking curve ends at"):
            limits.emergency(fastest + 1.0, motion)


def test_limits_are_not_below_the_ceiling_of_the_target() -> None:
    """Breaks if the speeds beyond a target with a speed fall below its ceiling speeds, or an end has such a floor."""
    target = TargetLimits(supervised_train(), BrakingTarget(1000.0, 20.0), LEVEL, FIXED)
    assert target.speeds(1e4) == target.floor == ceiling_speeds(20.0)
    assert TargetLimits(supervised_train(), END, LEVEL, FIXED).speeds(1e4) == SupervisionSpeeds(0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("service_time", [1.0, 6.0])
@pytest.mark.parametrize("command", [True, False])
@pytest.mark.parametrize("svl", [1000.0, 5000.0])
def test_speeds_invert_the_locations_of_an_end(service_time: float, command: bool, svl: float) -> None:
    """Breaks if SBD or EBD are evaluated with other times or at another front for speeds than for locations."""
    train = supervised_train(service_time=service_time, service_command=command)
    limits = TargetLimits(train, BrakingTarget(svl, 0.0, "EOA", 1000.0), LEVEL, FIXED)
    motion = MotionEstimate(0.2, 1.0, 30.0, 50.0)
    for speed in (5.0, 20.0, 45.0):
        for name in NAMES:
            front = getattr(limits, name)(speed, motion) - motion.under_reading
            assert getattr(limits.speeds(front, motion), name) == pytest.approx(speed, abs=1e-6), (name, speed)


@pytest.mark.parametrize(("feedback", "indication"), [(False, 8.0), (True, 5.0)])
def test_slow_service_brake_and_its_feedback(feedback: bool, indication: float) -> None:
    """Breaks if the indication time is not 0.8 T_bs, or 5 s with the service-brake feedback."""
    train = supervised_train(service_time=10.0, service_command=True, service_feedback=feedback)
    assert intervention_times(train, 0.0, FIXED).indication == indication


def test_build_up_time_of_a_low_target_speed() -> None:
    time = BuildUpTime(3.0, 4.0)
    assert [time.for_target(speed) for speed in (0.0, 0.1, 1.0, 20.0)] == [3.0, 4.0, 4.0, 4.0]


def test_indication_uses_the_motion() -> None:
    """Breaks if the indication is that of exact odometry."""
    limits = TargetLimits(supervised_train(), END, LEVEL, FIXED)
    motion = MotionEstimate(0.2, 1.0, 30.0)
    assert limits.indication(20.0, motion) == pytest.approx(limits.service(20.0, motion) - 20.0 * (4.0 + 5.0))


def test_service_curve_without_a_service_brake() -> None:
    """Breaks if the message lacks the name of the missing value."""
    with pytest.raises(ValueError) as refused:
        TargetLimits(supervised_train(service=None), END, LEVEL, FIXED).service_curve()
    assert str(refused.value) == "A_brake_service: the curves SBD and SBI1 need a service deceleration; give it"


def test_curve_beyond_its_end() -> None:
    """Breaks if the advanced speed beyond the curve is above 0."""
    curve = DecelerationCurve(1000.0, 0.0, StepFunction.constant(1.0), LEVEL, needed_speed=30.0, top_speed=40.0)
    assert advanced_speed(curve.arcs, 1200.0, 0.0, 0.0, 0.0) == 0.0
    assert advanced_speed(curve.arcs, 1200.0, 2.0, 3.0, 5.0) == -5.0


def test_largest_value_of_steps() -> None:
    """Breaks if the step that holds at the place is left out, or one above it counts."""
    steps = StepFunction((10.0, 20.0, 30.0), (1.0, 2.0, 3.0, 4.0))
    assert [steps.largest_up_to(place) for place in (5.0, 10.0, 10.1, 20.0, 25.0, 99.0)] == [1, 1, 2, 2, 3, 4]


def test_odometer_error_has_the_accuracy_of_the_balise() -> None:
    motion = motion_estimate(20.0, 0.0, 100.0, 3.0)
    assert (motion.under_reading, motion.over_reading) == (13.0, 13.0)


def test_trip_behind_the_reference_has_the_offset_alone() -> None:
    """Breaks if a reference beyond the end changes the predicted confidence interval."""
    assert trip_location(1000.0, 1005.0) == trip_location(1000.0, 1000.0) == 1010.0


@pytest.mark.parametrize(("svl", "from_sbd"), [(1000.0, False), (5000.0, True)])
@pytest.mark.parametrize("inhibit", [False, True])
def test_start_of_the_release_speed(svl: float, from_sbd: bool, inhibit: bool) -> None:
    """Breaks if the start is that of the present acceleration and speed error, or of another front."""
    limits = TargetLimits(supervised_train(), BrakingTarget(svl, 0.0, "EOA", 1000.0), LEVEL, FIXED)
    motion = MotionEstimate(0.3, 2.0, 30.0, 50.0)
    reached = 10.0 + (0.0 if inhibit else speed_measurement_error(10.0))
    start = 1000.0 - 10.0**2 / 1.4 if from_sbd else 1000.0 - reached**2 / 2 - 5.0 * reached - 30.0
    words = {"inhibit_compensation": True} if inhibit else {}
    assert release_start(limits, 10.0, motion, **words) == pytest.approx(start)


def test_release_speed_of_a_lower_speed_limit() -> None:
    limits = TargetLimits(supervised_train(), BrakingTarget(1000.0, 10.0), LEVEL, FIXED)
    assert release_speed(limits, 2000.0) == 10.0


def test_targets_of_a_line() -> None:
    """Breaks if a target has another speed or limit before it, or an equal speed, the maximum or the end is one."""
    limits = [(0.0, 60.0), (1000.0, 55.0), (2000.0, 30.0), (3000.0, 20.0), (4000.0, 10.0)]
    line = TrackSupervision(supervised_train(), [], limits, BrakingTarget(4000.0, kind="EOA"))
    found = [(entry.target.location, entry.target.speed, entry.speed_limit) for entry in line.targets]
    assert found == [(2000.0, 30.0, 50.0), (3000.0, 20.0, 30.0), (4000.0, 0.0, 50.0)]
    open_end = TrackSupervision(supervised_train(), [], limits, None)
    assert [entry.target.location for entry in open_end.targets] == [2000.0, 3000.0, 4000.0]
    assert open_end.evaluate(9e3) == ceiling_speeds(10.0)
    assert TrackSupervision(supervised_train(), [], [], None).evaluate(1e3) == ceiling_speeds(50.0)


def test_level_before_the_first_gradient() -> None:
    """Breaks if a first downhill gradient acts before its start."""
    lowest = lowest_under_train([(1000.0, -10.0), (1100.0, 5.0)], 300.0)
    assert [lowest.at(place) for place in (-1e4, 900.0, 1000.0, 1001.0, 1400.0, 1401.0)] == [0, 0, 0, -10, -10, 5]


def test_rotating_mass_of_slight_grades() -> None:
    slight = gradient_acceleration([(0.0, 0.5), (1000.0, -0.5)], 100.0, None, FIXED)
    assert slight.at(500.0) == pytest.approx(9.81 * 0.5 / 1150)
    assert slight.at(2000.0) == pytest.approx(-9.81 * 0.5 / 1020)


def test_rotating_mass_of_the_train_is_used() -> None:
    """Breaks if the gradients of a line have the fixed rotating masses in place of the nominal one."""
    grades = [(0.0, -10.0)]
    line = TrackSupervision(supervised_train(m_rotating_nom=10.0), grades, [], END)
    alone = TargetLimits(supervised_train(), END, gradient_acceleration(grades, 200.0, 10.0, FIXED), FIXED)
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
        line = TrackSupervision(supervised_train(service=service), grades, [], END)
        assert line.without_service_curve == reason
        alone = TrackSupervision(supervised_train(service=None), grades, [], END)
        assert (line.targets[0].sbd is None) == (reason is not None)
        assert (line.evaluate(600.0) == alone.evaluate(600.0)) == (reason is not None)
        assert line.evaluate(600.0).emergency == alone.evaluate(600.0).emergency < 30.0


def test_steps_that_are_not_ordered() -> None:
    """Breaks if equal or falling bounds, or a missing value, make a step function."""
    with pytest.raises(ValueError) as refused:
        StepFunction((1.0,), (5.0,))
    assert str(refused.value) == "1 bounds need 2 values, not 1"
    for bounds in ((2.0, 2.0), (2.0, 1.0)):
        with pytest.raises(ValueError) as refused:
            StepFunction(bounds, (5.0, 6.0, 7.0))
        assert str(refused.value) == "bounds of a step function must rise; sort them"


def test_train_without_interfaces() -> None:
    """Breaks if a train has a service-brake feedback or a traction cut-off time that was not given."""
    alone = intervention_times(supervised_train(service_time=10.0), 0.0, FIXED)
    assert alone == InterventionTimes(0.0, 5.0, 0.0, 0.0, 8.0)
    command = intervention_times(supervised_train(service_time=10.0, service_command=True), 0.0, FIXED)
    assert command == InterventionTimes(0.0, 5.0, 10.0, 10.0, 8.0)


def test_exact_odometry_has_no_error() -> None:
    """Breaks if a motion without errors has a distance to its min safe or max safe front."""
    line = TrackSupervision(supervised_train(), [], [(0.0, 30.0), (1000.0, 40.0), (3000.0, 30.0)], None)
    places = (1199.9, 1200.1, 2999.9)
    assert [ceiling(line.records.ceilings, place, place).permitted for place in places] == [30.0, 40.0, 40.0]
    assert line.evaluate(1200.1).emergency == ceiling_speeds(40.0).emergency


def test_ceiling_between_two_positions() -> None:
    """Breaks if a limit between min safe and max safe front is lost, or one beyond them counts."""
    limits = [(1000.0, 40.0), (2000.0, 10.0), (2100.0, 30.0), (3000.0, 5.0)]
    line = TrackSupervision(supervised_train(), [], limits, None)
    expected = {(0, 900): 50, (900, 1100): 40, (1100, 1200): 40, (1900, 2050): 10, (1900, 2900): 10, (2350, 2900): 30}
    assert {key: round(ceiling(line.records.ceilings, *key).permitted, 9) for key in expected} == expected


def test_an_end_that_is_the_only_target_stays_supervised() -> None:
    """Breaks if a train beyond its only target has the ceiling speeds."""
    line = TrackSupervision(supervised_train(), [], [], END)
    assert line.evaluate(1100.0) == SupervisionSpeeds(0.0, 0.0, 0.0, 0.0)


def test_a_later_target_with_an_earlier_begin() -> None:
    """Breaks if a small step before a large one hides the large one, or a curve that ends early hides its target."""
    steps = TrackSupervision(supervised_train(), [], [(0.0, 45.0), (3000.0, 44.0), (3100.0, 5.0)], None)
    assert steps.evaluate(2000.0) == steps.targets[-1].speeds(2000.0)
    steep = 1000.0 - 54.0**2 / 2  # the curve ends at 54 m/s, below the compensated speed of the widest motion
    grades = [(steep - 5000.0, -200.0), (steep - 200.0, 0.0)]
    short = TrackSupervision(supervised_train(service=None), grades, [], END)
    assert 53.9 < short.targets[0].ebd.end_speed < 54.1
    with pytest.raises(ValueError, match="the braking curve ends at"):
        short.targets[0].indication(50.0, WIDEST_MOTION)
    assert short.evaluate(600.0).emergency < 25.0


STEPS = [[(0.0, 45.0), (3000.0, 30.0), (3500.0, 25.0), (9000.0, 10.0)], [(0.0, 45.0), (9000.0, 44.0), (9100.0, 5.0)]]


@pytest.mark.parametrize("limits", STEPS)
@pytest.mark.parametrize("cut_off", [0.0, 20.0])
def test_begin_of_the_targets_covers_the_widest_motion(limits: list[tuple[float, float]], cut_off: float) -> None:
    """Breaks if the begin of a target is that of a smaller motion, or of an earlier target with a later begin."""
    line = TrackSupervision(supervised_train(t_traction_cut_off=cut_off), [], limits, None)
    for front in range(-3000, 6000, 50):
        every = [ceiling(line.records.ceilings, front - 2500.0, front + 2500.0)]
        every += [t.speeds(front, WIDEST_MOTION) for t in line.targets if front + 2500.0 <= t.target.location]
        lowest = tuple(min(getattr(speeds, name) for speeds in every) for name in NAMES)
        assert line.evaluate(front, WIDEST_MOTION) == lowest


def test_release_speed_of_a_line() -> None:
    """Breaks if the release speed begins elsewhere than its start, or a passed speed limit lowers it."""
    train = supervised_train()
    limits = [(0.0, 40.0), (500.0, 3.0), (600.0, 40.0)]
    line = TrackSupervision(train, [], limits, END, release=4.0)
    assert line.evaluate(1005.0) == SupervisionSpeeds(4.0, 4.0, 4.0, 4.0)
    for motion in (MotionEstimate(), MotionEstimate(0.3, 1.0, 60.0, 20.0)):
        start = release_start(line.targets[-1], 4.0, motion)
        assert start > 850.0
        assert line.evaluate(start, motion).service == 4.0
        before = line.evaluate(start - 0.1, motion)
        assert before == line.targets[-1].speeds(start - 0.1, motion)
        assert before.emergency != 4.0
