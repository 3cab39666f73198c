"""Odometry of the supervisor: the odometers of the train, their plausibility, and the estimate of the motion."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from plant_sim.odometry import Odometers, OdometryReading, write_reading
from plant_sim.plant_setup import OdometrySpec, WheelSlip
from plant_sim.record import zeros
from train_ato.messages.types import Odometry
from train_ato.supervision import odometry as odo
from train_ato.supervision.supervisor import SupervisorState

PERIOD = 0.4


def odometry(
    time: float, positions: float | tuple[float, float], speeds: float | tuple[float, float], since: float = 0.0
) -> Odometry:
    """Return odometry of wheel and radar at a time [s]; one value counts for both."""
    return Odometry(
        round(time * 1e9), *(np.broadcast_to(value, 2).astype(float) for value in (positions, speeds, since))
    )


def odometers(*slips: WheelSlip, error: float = 0.0) -> Odometers:
    spec = OdometrySpec(wheel_error=error, radar_error=error, balise_spacing=500.0)
    return Odometers(spec, slips, 10.0, seed=1)


def test_exact_odometers_count_the_distance_from_the_last_balise() -> None:
    """Breaks if a balise does not set the position, or a movement backwards counts as a passed balise."""
    exact = odometers()
    steps = [(10.0, 0.0), (499.0, 489.0), (501.0, 1.0), (499.0, 3.0), (1700.0, 200.0)]
    for stamp, (front, since) in enumerate(steps):
        exact.move(stamp, front)
        found = exact.observe(stamp, 7.0)
        assert found.position.tolist() == pytest.approx([front] * 2), front
        assert found.speed.tolist() == [7.0, 7.0]
        assert found.since_balise.tolist() == pytest.approx([since] * 2), front


def test_an_error_grows_with_the_distance_from_the_balise() -> None:
    """Breaks if the errors are not relative, differ in time, or remain after a balise."""
    wrong = odometers(error=0.05)
    wrong.move(0, 410.0)
    first = wrong.observe(0, 10.0)
    factors = (first.position - 10.0) / 400.0
    assert np.all(abs(factors - 1.0) <= 0.05) and factors[0] != factors[1]
    assert first.speed.tolist() == pytest.approx((10.0 * factors).tolist())
    wrong.move(1, 500.0)
    assert wrong.observe(1, 10.0).position.tolist() == [500.0, 500.0]
    wrong.move(2, 600.0)
    last = wrong.observe(2, 10.0)
    assert last.position.tolist() == pytest.approx((500.0 + 100.0 * factors).tolist())
    assert last.since_balise.tolist() == pytest.approx((100.0 * factors).tolist())


def test_a_slip_acts_on_the_wheel_of_the_first_unit_while_it_lasts() -> None:
    """Breaks if the radar slips, the slip of another unit counts, or a slip has no begin or end."""
    slipping = odometers(
        WheelSlip(begin=1.0, end=2.0, slip=0.5), WheelSlip(begin=0.0, end=9.0, slip=3.0, unit=1), error=0.0
    )
    counted = [10.0]
    for time in (0.9, 1.0, 1.9, 2.0):
        slipping.move(round(time * 1e9), 10.0 * (len(counted) + 1))
        found = slipping.observe(round(time * 1e9), 10.0)
        assert found.position[1] == pytest.approx(10.0 * (len(counted) + 1))
        assert found.speed.tolist() == [15.0 if 1.0 <= time < 2.0 else 10.0, 10.0]
        counted.append(float(found.position[0]))
    assert [after - before for before, after in pairwise(counted)] == pytest.approx([10.0, 15.0, 15.0, 10.0])


def checked(*steps: Odometry) -> list[str]:
    """Return the problems of odometry in the order of its steps."""
    check = odo.OdometryCheck()
    return [check.problem(step) for step in steps]


@pytest.mark.parametrize(("speed", "span"), [(20.0, 0.4), (-3.0, 0.4), (0.0, 0.4), (50.0, 10.0)])
def test_a_distance_that_follows_from_the_speed_is_plausible(speed: float, span: float) -> None:
    """Breaks if a moving train is braked, at any speed, direction or period."""
    steps = [odometry(k * span, 100.0 + k * span * speed, speed, 10.0 + k * span * abs(speed)) for k in range(4)]
    assert checked(*steps) == [""] * 4


@pytest.mark.parametrize(("beside", "valid"), [(1.3, True), (1.5, False), (-1.3, True), (-1.5, False)])
def test_a_jump_is_found_beyond_the_tolerance(beside: float, valid: bool) -> None:
    """Breaks if the tolerance is not 1 m and 5 % of the distance (8 m: 1.4 m in all), ahead or behind."""
    moved = 20.0 * PERIOD + beside
    found = checked(odometry(0.0, 100.0, 20.0, 10.0), odometry(PERIOD, 100.0 + moved, 20.0, 10.0 + moved))[1]
    assert (found == "") is valid
    assert valid or found == f"moved by {moved:.1f} m in 0.4 s at 72.0 km/h"


def test_a_problem_is_told_with_the_values_of_the_wheel() -> None:
    """Breaks if the text mixes wheel and radar or counts the time from 0, or a jump without a balise is frozen."""
    first, second = odometry(7.0, (100.0, 50.0), 20.0, 10.0), odometry(7.4, (120.0, 90.0), (20.0, 21.0), 30.0)
    assert checked(first, second)[1] == "moved by 20.0 m in 0.4 s at 72.0 km/h"
    frozen = odometry(7.4, (100.0, 50.0), (20.0, 21.0), 10.0)
    assert checked(first, frozen)[1] == "moved by 0.0 m in 0.4 s at 72.0 km/h"
    still = odometry(7.01, (100.0, 50.0), (20.0, 21.0), 10.0)
    assert checked(first, still)[1] == "frozen at 72.0 km/h"
    assert checked(first, odometry(7.4, (110.0, 60.0), 20.0, 10.0))[1] == "moved by 10.0 m in 0.4 s at 72.0 km/h"


@pytest.mark.parametrize(
    ("before", "after", "moved"),
    [(20.0, 10.0, 4.0), (20.0, 10.0, 8.0), (10.0, 20.0, 8.0), (10.0, 20.0, 4.0), (0.0, 40.0, 17.7), (40.0, 0.0, -1.7)],
)
def test_the_distance_is_between_those_of_both_speeds(before: float, after: float, moved: float) -> None:
    """Breaks if a brake or an acceleration counts as a jump, because one end of the step only is compared."""
    steps = odometry(0.0, 100.0, before, 10.0), odometry(PERIOD, 100.0 + moved, after, 10.0 + moved)
    assert checked(*steps) == ["", ""]


@pytest.mark.parametrize(("speed", "frozen"), [(20.0, True), (-20.0, True), (0.11, True), (0.1, False), (0.0, False)])
def test_a_distance_that_does_not_change_at_speed_is_frozen(speed: float, frozen: bool) -> None:
    """Breaks if frozen odometry passes because the step is within the tolerance of a short period."""
    span = 0.01
    found = checked(odometry(0.0, 100.0, speed, 10.0), odometry(span, 100.0, speed, 10.0))[1]
    assert found == (f"frozen at {speed * 3.6:.1f} km/h" if frozen else "")


def test_one_plausible_odometer_is_enough() -> None:
    """Breaks if locked wheels apply the emergency brake, or two wrong odometers are used."""
    first, step = odometry(0.0, 100.0, 20.0, 10.0), 20.0 * PERIOD
    places = (100.0, 100.0 + step), (100.0 + step, 100.0), (90.0, 130.0)
    found = [checked(first, odometry(PERIOD, place, (20.0, 20.0), 10.0 + step))[1] for place in places]
    assert found[:2] == ["", ""] and found[2] != ""


def test_a_refused_odometry_is_not_the_base_of_the_next_one() -> None:
    """Breaks if a foreign message is refused once and the following ones of the same sender are used."""
    first = odometry(0.0, 100.0, 20.0, 10.0)
    foreign = [odometry(PERIOD * k, 900.0 + 8.0 * k, 20.0, 10.0 + 8.0 * k) for k in (1, 2)]
    true = odometry(3 * PERIOD, 124.0, 20.0, 34.0)
    found = checked(first, *foreign, true)
    assert [text != "" for text in found] == [False, True, True, False]


@pytest.mark.parametrize(("correction", "valid"), [(0.999, True), (-0.999, True), (1.001, False), (-1.001, False)])
def test_a_balise_corrects_the_position_by_the_error_of_the_odometer(correction: float, valid: bool) -> None:
    """Breaks if the correction at a balise applies the brake, or any jump passes with a shorter distance."""
    step, since = 20.0 * PERIOD, 400.0
    largest = odo.odometer_error(since) + 1.0 + 0.05 * step
    jump = odometry(PERIOD, 100.0 + step + correction * largest, 20.0, 3.0)
    assert (checked(odometry(0.0, 100.0, 20.0, since), jump)[1] == "") is valid


def estimated(*steps: Odometry) -> list[Any]:
    """Return the estimates after odometry in the order of its steps; None without one."""
    own, past, reading, found = zeros(SupervisorState, 1), odo.past_speeds(), zeros(OdometryReading, 1), []
    for step in steps:
        write_reading(reading, step)
        found.append(own[0].copy() if odo.estimate_motion(own[0], past, reading[0]) else None)
    return found


def test_the_larger_odometer_counts() -> None:
    """Breaks if locked wheels hide the motion of the radar, or a train that rolls back has the slower speed or +."""
    values = np.array([[900.0, 1000.0], [0.0, 20.0], [10.0, 110.0]])
    for positions, speeds, since in (values, values[:, ::-1]):  # wheel and radar, either may be the larger one
        (motion,) = estimated(Odometry(0, positions, speeds, since))
        assert motion[["stamp", "front", "speed"]].tolist() == (0, 1000.0, 20.0)
        assert motion["position_error"] == pytest.approx(5.0 + 0.05 * 110.0)
        assert (motion["speed_error"], motion["acceleration"]) == (odo.speed_measurement_error(20.0), 0.0)
    (back,) = estimated(odometry(0.0, 0.0, (-1.0, -2.0)))
    assert (back["speed"], back["speed_error"]) == (-2.0, odo.speed_measurement_error(2.0))


@pytest.mark.parametrize("place", range(6))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_gives_no_estimate(place: int, value: float) -> None:
    """Breaks if one of the six values is not checked."""
    values = np.full(6, 1.0)
    values[place] = value
    refused, motion = estimated(Odometry(0, values[:2], values[2:4], values[4:]), odometry(PERIOD, 1.0, 1.0))
    assert refused is None and motion["acceleration"] == 0.0, "refused odometry is part of the mean"


def test_the_acceleration_is_the_mean_of_the_last_periods() -> None:
    """Breaks if the time base or the sign is wrong, or the time of the mean is not 1.2 s."""
    speeds = [0.0, 4.0, 5.0, 7.0, 10.0, 14.0, 19.0, 18.0, 12.0, 13.0, 11.0, 3.0]
    found = estimated(*(odometry(7.0 + PERIOD * k, 0.0, speed) for k, speed in enumerate(speeds)))
    periods = round(odo.ACCELERATION_TIME / PERIOD)
    expected = [0.0]
    for k in range(1, len(speeds)):
        first = max(0, k - periods)
        expected.append((speeds[k] - speeds[first]) / (PERIOD * (k - first)))
    assert periods == 3
    assert [motion["acceleration"] for motion in found] == pytest.approx(expected)
    slow = estimated(*(odometry(2.0 * k, 0.0, float(k * k)) for k in range(5)))  # periods longer than the time
    assert [motion["acceleration"] for motion in slow] == pytest.approx([0.0, 0.5, 1.5, 2.5, 3.5])


def test_the_speeds_of_the_mean_have_room() -> None:
    """Breaks if more speeds than there is room for are lost in another order than that of their times."""
    own, past = zeros(SupervisorState, 1)[0], zeros(odo.PastSpeed, 4)
    firsts = [odo.add_speed(own, past, stamp * 1_000_000, float(stamp)).speed for stamp in range(11)]
    assert firsts == [0.0] * 4 + [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
