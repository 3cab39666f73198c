"""Simulated time as a function of a wall time set by the test."""

import math

import pytest

from train_ato.apps.replay.playback import ReplayClock


class Wall:
    """Wall clock set by the test."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def wall() -> Wall:
    return Wall()


def test_time_flows_by_the_rate_and_a_change_of_it_does_not_jump(wall):
    clock = ReplayClock(2.0, False, wall)
    wall.now += 3
    assert clock.now == 6
    assert clock.until(10) == 2
    clock.set_rate(0.5)
    assert clock.now == 6
    assert clock.until(10) == 8
    wall.now += 8
    assert (clock.now, clock.until(10), clock.until(9)) == (10, 0, 0)


def test_time_stands_in_a_pause_and_goes_on_from_there(wall):
    clock = ReplayClock(1.0, False, wall)
    wall.now += 5
    clock.set_paused(True)
    wall.now += 100
    assert (clock.now, clock.until(5)) == (5, math.inf)
    clock.reached(7)
    assert clock.now == 7
    clock.set_rate(10)
    clock.set_paused(False)
    assert clock.until(8) == pytest.approx(0.1)


def test_a_jump_with_a_delay(wall):
    """The delay is in wall time, at any rate; a pause does not change it."""
    for rate in (4.0, math.inf):
        clock = ReplayClock(rate, False, wall)
        clock.jump(20, delay=3)
        wall.now += 1
        assert (clock.now, clock.until(20)) == (20, 2)
        clock.set_paused(True)
        clock.set_paused(False)
        wall.now += 2
        assert clock.until(20) == 0


def test_as_fast_as_possible_time_follows_the_messages(wall):
    clock = ReplayClock(math.inf, False, wall)
    wall.now += 50
    assert (clock.now, clock.until(1e9)) == (0, 0)
    clock.reached(12)
    assert clock.now == 12
    clock.set_rate(1.0)
    wall.now += 1
    assert clock.now == 13


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_rate_that_is_none_is_refused(wall, rate):
    clock = ReplayClock(1.0, False, wall)
    with pytest.raises(ValueError, match="above 0"):
        clock.set_rate(rate)
    assert clock.rate == 1.0
