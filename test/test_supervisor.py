"""Decisions of the supervisor, of the checks of the ATO and of the train's fail-safe reactions, one by one."""

from collections.abc import Sequence

import numpy as np
import pytest
from engine_runs import setup_of

from train_ato.control.assurance import AT_ONCE, AssuranceMonitor
from train_ato.control.ato_state import TAKEOVER_TIME, AtoStateMachine
from train_ato.control.plausibility import MeasurementCheck
from train_ato.loop.ato_mode import AtoMode
from train_ato.loop.train_protection import TrainProtection
from train_ato.messages.types import (
    AtoState,
    BrakeRelease,
    Measurement,
    Odometry,
    Protection,
    ProtectionState,
    SupervisedSpeeds,
)
from train_ato.scenario.setup import RunSetup
from train_ato.supervision.settings import SupervisionSpec
from train_ato.supervision.step_function import ceiling_speeds
from train_ato.supervision.supervisor import SupervisionState, Supervisor

PERIOD = 400_000_000
KMH = 3.6
CEILING = ceiling_speeds(80 / KMH)


def odometry(index: int, position: float, speed: float, since: float = 0.0) -> Odometry:
    """Return odometry with equal odometers at a supervision period."""
    return Odometry(index * PERIOD, np.full(2, position), np.full(2, speed), np.full(2, since))


def metro(*changes: str) -> RunSetup:
    return setup_of("xuzhou_metro:disturbed", *changes)


@pytest.fixture
def supervisor() -> Supervisor:
    return metro().supervisor()


def states(supervisor: Supervisor, speeds_kmh: Sequence[float], position: float = 1000.0) -> list[SupervisionState]:
    """Return the states at constant speeds of three periods each, so that the acceleration is 0 at the last one."""
    found, index = [], 0
    for speed in speeds_kmh:
        for _ in range(5):
            state = supervisor.step(odometry(index, position, speed / KMH)).state
            index += 1
        found.append(state)
    return found


def test_a_service_brake_ends_at_the_permitted_speed_and_an_emergency_brake_at_standstill() -> None:
    """Breaks if the emergency brake ends while the train moves, or the service brake above the permitted speed."""
    permitted, warning, service, emergency = (speed * KMH for speed in CEILING)
    rising = states(metro().supervisor(), [permitted + 1, warning + 0.5, service + 0.5, emergency + 0.5])
    assert [state.name for state in rising] == ["OVERSPEED", "WARNING", "SERVICE_BRAKE", "EMERGENCY_BRAKE"]
    braked = states(metro().supervisor(), [service + 0.5, warning, permitted + 0.1, permitted - 0.1])
    assert [state is SupervisionState.SERVICE_BRAKE for state in braked] == [True, True, True, False]
    stopped = states(metro().supervisor(), [emergency + 0.5, permitted - 10, 1.0, 0.0])
    assert [state is SupervisionState.EMERGENCY_BRAKE for state in stopped] == [True, True, True, False]


def test_the_releases_follow_the_state() -> None:
    """Breaks if traction is not cut off with a brake, or the emergency brake is released with the service brake."""
    supervisor = metro().supervisor()
    *_, service, emergency = (speed * KMH for speed in CEILING)
    for index in range(5):
        decision = supervisor.step(odometry(index, 1000.0, (service + 0.5) / KMH))
    assert decision.released == (False, False, True)
    for index in range(5, 10):
        decision = supervisor.step(odometry(index, 1000.0, (emergency + 0.5) / KMH))
    assert decision.released == (False, False, False)


def test_without_a_service_brake_the_supervisor_waits_for_the_emergency_limit() -> None:
    """Breaks if ``service_brake: false`` still demands the service brake."""
    *_, service, emergency = (speed * KMH for speed in CEILING)
    found = states(metro("supervision.service_brake=false").supervisor(), [service + 0.5, emergency + 0.5])
    assert found == [SupervisionState.WARNING, SupervisionState.EMERGENCY_BRAKE]


def test_the_train_is_stopped_before_the_end_of_authority(supervisor: Supervisor) -> None:
    """Breaks if the stop is not a target: at the supervised location every speed is above the limits."""
    setup = metro()
    end = float(setup.profile.position[-1]) + setup.consist.vehicles[0].length / 2 + 100.0
    assert states(supervisor, [10.0], end - 2.0) == [SupervisionState.EMERGENCY_BRAKE]
    assert states(metro().supervisor(), [10.0], end - 600.0) == [SupervisionState.NORMAL]


def test_odometry_that_is_not_finite_applies_the_emergency_brake(supervisor: Supervisor) -> None:
    """Breaks if NaN passes the comparisons with the limits, which are all false."""
    supervisor.step(odometry(0, 1000.0, 10.0))
    broken = Odometry(PERIOD, np.array([np.nan, 1004.0]), np.full(2, 10.0), np.zeros(2))
    assert supervisor.step(broken).state is SupervisionState.EMERGENCY_BRAKE


def test_a_train_that_rolls_back_is_braked_after_two_metres_and_is_not_released(supervisor: Supervisor) -> None:
    """Breaks if a correction by a balise counts, or the brake ends at standstill: the train rolls again and again."""
    supervisor.step(odometry(0, 1000.0, 0.0))
    found = [supervisor.step(odometry(index, 970.0, 5.0)) for index in (1, 2)]
    assert found[-1].state is SupervisionState.NORMAL
    rolling = [supervisor.step(odometry(index, 970.0, -1.0)).state for index in range(3, 12)]
    braked = [state is SupervisionState.EMERGENCY_BRAKE for state in rolling]
    assert braked == [0.4 * count > 2.0 for count in range(1, 10)]
    stopped = [supervisor.step(odometry(index, 965.0, 0.0)).state for index in range(12, 15)]
    assert set(stopped) == {SupervisionState.EMERGENCY_BRAKE}


def measured(stamp: int, position: float, speed: float) -> Measurement:
    one, none = np.ones(1), np.zeros(0)
    return Measurement(stamp, position * one, speed * one, 0 * one, none, none, none)


def supervised(stamp: int, front: float, speed: float, limits: Sequence[float] = (50.0,) * 4) -> SupervisedSpeeds:
    return SupervisedSpeeds(stamp, np.array([front, *[front + 10.0] * 4]), np.array([speed, *limits]))


@pytest.mark.parametrize(
    ("position", "speed", "word"),
    [
        (1000.0, 20.0, ""), (1029.0, 20.0, ""), (1031.0, 20.0, "front at"), (1000.0, 23.5, "km/h"),
        (np.nan, 20.0, "fini"),
    ],
    ids=["equal", "within the error", "position", "speed", "not a number"],
)  # fmt: skip
def test_an_implausible_measurement_is_found_after_the_confirmation(position: float, speed: float, word: str) -> None:
    """Breaks if a difference counts at once, not at all, or without the error of the odometry."""
    check = MeasurementCheck(SupervisionSpec(), 10.0)
    texts = [
        check.step(measured(index * PERIOD, position - 10.0, speed), supervised(index * PERIOD, 1000.0, 20.0))
        for index in range(5)
    ]
    assert [bool(text) for text in texts] == [False, False, False, bool(word), bool(word)]
    assert word in texts[-1]


def test_a_short_difference_is_forgotten() -> None:
    """Breaks if two differences with a plausible measurement between them count as one."""
    check = MeasurementCheck(SupervisionSpec(), 0.0)
    for index in range(12):
        position = 1000.0 if index % 3 == 2 else 900.0
        speeds = supervised(index * PERIOD, 1000.0, 20.0)
        assert check.step(measured(index * PERIOD, position, 20.0), speeds) == ""


def test_the_braking_law_takes_over_before_the_warning_limit_and_gives_back_below_the_permitted_speed() -> None:
    """Breaks if the prediction over the reaction time or the margin of the return is missing."""
    monitor = AssuranceMonitor(1.0, SupervisionSpec())
    limits = (22.0, 23.0, 24.0, 25.0)
    took_over_at, speed, index = 0.0, 20.0, 0
    while not monitor.brakes:
        monitor.step(supervised(index * PERIOD, 0.0, speed, limits))
        took_over_at, speed, index = speed, speed + 0.4, index + 1
    assert 22.0 <= took_over_at <= 22.4, "at 1 m/s² the limit is 1 s ahead"
    while monitor.brakes:
        monitor.step(supervised(index * PERIOD, 0.0, speed, limits))
        speed, index = speed - 0.2, index + 1
    assert 21.2 <= speed + 0.2 < 21.5
    assert monitor.takeovers == 1


@pytest.mark.parametrize(("above", "jerk"), [(3.0, 0.25), (1.5, 1.0), (1.0, AT_ONCE)])
def test_the_ramp_of_the_braking_law_ends_before_the_intervention(above: float, jerk: float) -> None:
    """Breaks if the ramp ignores the distance to the service brake: it shrinks by 1 m/s² x 1 s, then in the ramp."""
    monitor = AssuranceMonitor(1.0, SupervisionSpec())
    for index in range(6):
        warning = 22.0 - 0.4 * index
        monitor.step(supervised(index * PERIOD, 0.0, 20.0, (warning - 1.0, warning, warning + above, 30.0)))
    assert monitor.brakes
    assert monitor.least_jerk == pytest.approx(jerk)


def test_the_braking_law_knows_its_delay_lag_and_period() -> None:
    """Breaks if a part is missing: 0.3 s of delay, 0.4 s of lag, and a period of the supervisor of 0.4 s."""
    assert metro("links.command.delay=0.3").assurance_reaction == pytest.approx(0.3 + 0.4 + 0.4)


def test_a_steady_speed_at_the_permitted_speed_is_left_to_the_law() -> None:
    """Breaks if the braking law takes over in nominal driving."""
    monitor = AssuranceMonitor(2.0, SupervisionSpec())
    for index in range(50):
        assert not monitor.step(supervised(index * PERIOD, 0.0, 22.0 + 0.1 * (index % 2), (22.0, 23.0, 24.0, 25.0)))


def test_the_states_of_the_ato_from_a_brake_to_the_next_engagement() -> None:
    """Breaks if the ATO engages by itself, while a brake is in effect, or while the train moves."""
    machine = AtoStateMachine()
    assert machine.state is AtoState.ENGAGED
    conditions = [
        (True, False, "", AtoState.ENGAGED), (True, False, "emergency brake", AtoState.DISENGAGING),
        (True, False, "", AtoState.DISENGAGING), (True, True, "emergency brake", AtoState.AVAILABLE),
        (True, True, "", AtoState.READY), (True, False, "", AtoState.AVAILABLE),
        (False, True, "", AtoState.NOT_AVAILABLE), (True, True, "", AtoState.READY),
    ]  # fmt: skip
    for stamp, (valid, standstill, locked, expected) in enumerate(conditions):
        if machine.state is not AtoState.READY:
            with pytest.raises(ValueError, match="wait for this state"):
                machine.request(stamp, "engage", standstill=True)
        machine.update(stamp, valid=valid, standstill=standstill, locked=locked)
        assert machine.state is expected
    machine.request(10, "engage", standstill=True)
    assert machine.state is AtoState.ENGAGED


def test_a_failure_lasts_until_a_reset_at_standstill() -> None:
    """Breaks if a failed ATO recovers by itself, or is reset while the train moves."""
    machine = AtoStateMachine()
    machine.fail(0, "the law gave nothing")
    machine.update(1, valid=True, standstill=True, locked="")
    assert machine.state is AtoState.FAILURE
    with pytest.raises(ValueError, match="wait for standstill"):
        machine.request(2, "reset", standstill=False)
    machine.request(3, "reset", standstill=True)
    machine.update(4, valid=True, standstill=True, locked="")
    assert machine.state is AtoState.READY


def test_a_disengaged_ato_coasts_for_the_takeover_time_and_a_failed_one_brakes_at_once() -> None:
    """Breaks if a driver has no time to take over, or a train without a driver rolls on."""
    coasting, failed = AtoStateMachine(), AtoStateMachine()
    failed.fail(0, "the law gave nothing")
    assert failed.brakes(0)
    coasting.request(0, "disengage", standstill=False)
    assert [coasting.brakes(round(s * 1e9)) for s in (0.0, TAKEOVER_TIME - 0.1, TAKEOVER_TIME)] == [False, False, True]


def test_an_engagement_without_a_profile_in_time_is_a_failure() -> None:
    """Breaks if an engaged ATO without a profile drives, waits without an end, or fails before 10 s."""
    setup = metro()
    mode = AtoMode(setup)
    place = 1000.0 - float(setup.model.offsets[0]) - setup.consist.vehicles[0].length / 2
    mode.machine.request(0, "disengage", standstill=True)
    late = 50_000_000_000
    found = []
    for stamp in (late - PERIOD, late, late + PERIOD, late + 10_000_000_000, late + 10_000_000_000 + PERIOD):
        if stamp == late:
            mode.request("engage")
        mode.update(measured(stamp, place, 0.0), ProtectionState(stamp, np.zeros(3)), supervised(stamp, 1000.0, 0.0))
        found.append((mode.machine.state, mode.awaits_profile, mode.drives))
    waits = (AtoState.ENGAGED, True, False)
    assert found == [(AtoState.READY, False, False), *[waits] * 3, (AtoState.FAILURE, False, False)]
    assert mode.machine.reason.startswith("no profile from the present place")


def released(stamp: int, *values: float) -> BrakeRelease:
    return BrakeRelease(stamp, np.array(values or (1.0, 1.0, 1.0)), np.full(3, float(stamp)))


def reactions(protection: TrainProtection, begin: int, end: int, tick: int, **silent: int) -> list[Protection]:
    """Return the reaction of every tick; ``command`` and ``release`` are silent from these ticks on."""
    found = []
    for index in range(begin, end):
        stamp = index * tick
        if index < silent.get("command", end):
            protection.on_command(stamp)
        if index % 8 == 0 and index < silent.get("release", end):
            protection.on_release(released(stamp))
        found.append(protection.step(stamp, standstill=False))
    return found


def test_the_reaction_to_missing_commands_rises_with_their_age() -> None:
    """Breaks if a bound is exchanged or the delay of the link is not part of the age."""
    setup = metro()
    tick, failsafe = setup.tick, setup.scenario.supervision.failsafe
    found = reactions(TrainProtection(setup), 0, 300, setup.tick_ns, command=100)
    nominal = setup.links.command.longest + tick
    ages = [(index - 99) * tick for index in range(300)]
    for age, level in zip(ages, found, strict=True):
        excess = age - nominal
        bounds = (failsafe.hold, failsafe.coast, failsafe.service)
        if min(abs(excess - bound) for bound in bounds) > 2 * tick:
            assert level == sum(excess > bound for bound in bounds), f"age {age:.2f} s"
    assert set(found) == set(Protection)


def test_a_node_that_does_not_return_applies_the_service_brake_at_once() -> None:
    """Breaks if a known loss waits for the age of the commands, or a new command ends its brake."""
    setup = metro()
    protection = TrainProtection(setup)
    reactions(protection, 0, 20, setup.tick_ns)
    protection.lose("node observer: its process was ended")
    assert set(reactions(protection, 20, 60, setup.tick_ns)) == {Protection.SERVICE_BRAKE}
    assert protection.reason == "node observer: its process was ended"
    late = reactions(protection, 60, 300, setup.tick_ns, command=60)
    assert late[-1] is Protection.EMERGENCY_BRAKE


def test_a_missing_brake_release_applies_the_emergency_brake_until_standstill() -> None:
    """Breaks if the plant trusts an old release, or ends the brake of a moving train with the next one."""
    setup = metro()
    protection = TrainProtection(setup)
    found = reactions(protection, 0, 60, setup.tick_ns, release=40)
    first = found.index(Protection.EMERGENCY_BRAKE)
    assert (first - 32) * setup.tick <= setup.scenario.supervision.period + 2.5 * setup.tick
    stamp = 60 * setup.tick_ns
    protection.on_command(stamp)
    protection.on_release(released(stamp))
    assert protection.step(stamp, standstill=False) is Protection.EMERGENCY_BRAKE
    assert protection.step(stamp, standstill=True) is Protection.NONE
    departed = reactions(protection, 61, 100, setup.tick_ns)
    assert set(departed) == {Protection.NONE}, "the standstill has ended the reaction"


def test_an_age_equal_to_a_bound_is_permitted() -> None:
    """Breaks with >= in place of >: a reaction one tick before its bound is exceeded; ages in whole nanoseconds."""
    setup = metro("supervision.failsafe={hold: 1, coast: 2, service: 3, release: 1}", "links.command.delay=0.3")
    tick, bounds = setup.tick_ns, [1_000_000_000, 2_000_000_000, 3_000_000_000]
    found = reactions(TrainProtection(setup), 0, 120, tick, command=10)
    nominal = 300_000_000 + tick
    excess = [(index - 9) * tick - nominal for index in range(120)]
    assert [level for level, at in zip(found, excess, strict=True) if at in bounds] == [0, 1, 2]
    after = [level for level, at in zip(found, excess, strict=True) if at - tick in bounds]
    assert after == [Protection.COAST, Protection.SERVICE_BRAKE, Protection.EMERGENCY_BRAKE]
    found = reactions(TrainProtection(setup), 0, 60, tick, release=9)  # the last one has the stamp of tick 8
    longest = round(setup.links.brake_release.longest * 1e9)
    last = (8 * tick + 1_000_000_000 + longest) // tick
    assert (1_000_000_000 + longest) % tick == 0
    assert found[last : last + 2] == [Protection.NONE, Protection.EMERGENCY_BRAKE]


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ((1.0, 1.0, 1.0), Protection.NONE), ((0.0, 1.0, 1.0), Protection.COAST),
        ((0.0, 0.0, 1.0), Protection.SERVICE_BRAKE), ((0.0, 0.0, 0.0), Protection.EMERGENCY_BRAKE),
        ((1.0, 1.0, np.nan), Protection.EMERGENCY_BRAKE), ((1.0, 1.0, 0.5), Protection.EMERGENCY_BRAKE),
    ],
)  # fmt: skip
def test_only_the_exact_value_releases(values: tuple[float, ...], expected: Protection) -> None:
    """Breaks if a damaged release holds a brake off (fail-safe polarity)."""
    protection = TrainProtection(metro())
    protection.on_command(0)
    protection.on_release(released(0, *values))
    assert protection.step(0, standstill=False) is expected


def test_a_run_without_limits_has_no_supervisor() -> None:
    """Breaks if the supervision is on where the line has no speed limit, or off where it has one."""
    assert metro().layout.supervised and not setup_of("xuzhou_metro").layout.supervised
    assert not metro("supervision.enabled=false").layout.supervised
    assert setup_of("xuzhou_metro", "supervision.enabled=true").layout.supervised
