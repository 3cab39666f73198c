"""Decisions of the supervisor, of the checks of the ATO and of the train's fail-safe reactions, one by one.

Settings of the supervisor and its decisions at their edges: limits, releases, repeated brakes, reasons, ranges.
"""

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np
import pytest
from curve_trains import supervised_train
from engine_runs import setup_of
from pydantic import ValidationError

from plant_sim.si_model import unusual_values
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
from train_ato.supervision.limits import BrakingTarget
from train_ato.supervision.settings import MIN_INDICATION_TIME, FailsafeSpec, SupervisionSpec
from train_ato.supervision.step_function import ceiling_speeds
from train_ato.supervision.supervisor import SupervisionDecision, SupervisionState, Supervisor
from train_ato.supervision.track_supervision import TrackSupervision

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


@pytest.mark.parametrize(("position", "speed", "word"), [
    (1000.0, 20.0, ""), (1029.0, 20.0, ""), (1031.0, 20.0, "front at"), (1000.0, 23.5, "km/h"),
    (np.nan, 20.0, "fini"),
], ids=["equal", "within the error", "position", "speed", "not a number"])  # fmt: skip
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
    nominal = setup.scenario.links.command.longest + tick
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
    longest = round(setup.scenario.links.brake_release.longest * 1e9)
    last = (8 * tick + 1_000_000_000 + longest) // tick
    assert (1_000_000_000 + longest) % tick == 0
    assert found[last : last + 2] == [Protection.NONE, Protection.EMERGENCY_BRAKE]


@pytest.mark.parametrize(("values", "expected"), [
    ((1.0, 1.0, 1.0), Protection.NONE), ((0.0, 1.0, 1.0), Protection.COAST),
    ((0.0, 0.0, 1.0), Protection.SERVICE_BRAKE), ((0.0, 0.0, 0.0), Protection.EMERGENCY_BRAKE),
    ((1.0, 1.0, np.nan), Protection.EMERGENCY_BRAKE), ((1.0, 1.0, 0.5), Protection.EMERGENCY_BRAKE),
])  # fmt: skip
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
    with pytest.raises(ValueError, match="ato_requests: this run has no supervision; set "):
        metro("supervision.enabled=false", "ato_requests=[{at: 5, do: engage}]")
    assert setup_of("xuzhou_metro", "supervision.enabled=true").layout.supervised


PERMITTED, WARNING, SERVICE, EMERGENCY = ceiling_speeds(80 / 3.6)
PLACE = 1000.0
STANDSTILL, REPEATED = 0.1, 50.0
"""Speed of standstill [m/s]; distance of a second emergency brake that is not released [m]."""
State = SupervisionState


@cache
def track() -> TrackSupervision:
    return metro().supervisor().track


def new_supervisor() -> Supervisor:
    """Return a supervisor in its first state; the limits of the track do not change."""
    return Supervisor(track(), metro().scenario.supervision)


def steps(supervisor: Supervisor, moves: Iterable[tuple[float, float]], first: int = 0) -> list[SupervisionDecision]:
    """Return the decisions at places [m] and speeds [m/s], one per period from a first one on."""
    return [
        supervisor.step(Odometry((first + index) * 400_000_000, np.full(2, place), np.full(2, speed), np.zeros(2)))
        for index, (place, speed) in enumerate(moves)
    ]


def at(supervisor: Supervisor, *speeds: float, place: float = PLACE, first: int = 0) -> list[SupervisionDecision]:
    """Return the decisions at one place for several speeds [m/s], one period each."""
    return steps(supervisor, [(place, speed) for speed in speeds], first)


def end_of_authority() -> float:
    """Return the supervised location of the metro [m]."""
    setup = metro()
    overlap = setup.scenario.supervision.overlap
    return float(setup.profile.position[-1]) + setup.consist.vehicles[0].length / 2 + overlap


def test_a_limit_is_exceeded_above_it_only() -> None:
    """Breaks if a speed equal to a limit exceeds it: at the permitted speed the train is in order."""
    speeds = [PERMITTED, WARNING, SERVICE, EMERGENCY]
    found = [at(new_supervisor(), speed)[0] for speed in speeds]
    assert [decision.state for decision in found] == [State.NORMAL, State.OVERSPEED, State.WARNING, State.SERVICE_BRAKE]
    assert found[0].reason == ""


@pytest.mark.parametrize(
    ("speed", "reason"),
    [
        (PERMITTED + 0.1, "80.4 km/h at 1000 m, limit 80.0 km/h"),
        (WARNING + 0.1, "84.4 km/h at 1000 m, limit 84.0 km/h"),
        (SERVICE + 0.1, "85.9 km/h at 1000 m, limit 85.5 km/h"),
        (EMERGENCY + 0.1, "87.9 km/h at 1000 m, limit 87.5 km/h"),
    ],
    ids=["overspeed", "warning", "service brake", "emergency brake"],
)
def test_the_reason_has_speed_place_and_limit(speed: float, reason: str, supervisor: Supervisor) -> None:
    """Breaks if the reason has another limit, or m/s; it stays while the state is the same."""
    first, second = at(supervisor, speed, speed + 0.01)
    assert (first.reason, second.reason) == (reason, reason)
    assert first.own.known and first.own.speed == speed


def test_overspeed_and_warning_end_at_the_permitted_speed(supervisor: Supervisor) -> None:
    """Breaks if they end above it, or never; 3.13.10.3."""
    found = at(supervisor, WARNING + 0.1, PERMITTED + 0.01, PERMITTED, PERMITTED + 0.1, PERMITTED)
    expected = [State.WARNING, State.WARNING, State.NORMAL, State.OVERSPEED, State.NORMAL]
    assert [decision.state for decision in found] == expected
    assert found[-1].reason == "" and supervisor.interventions == 0


def test_each_brake_counts_as_one_intervention(supervisor: Supervisor) -> None:
    """Breaks if a rise from service to emergency brake counts twice, or a second brake does not count."""
    at(supervisor, SERVICE + 0.1, EMERGENCY + 0.1, PERMITTED, 0.0)
    assert supervisor.interventions == 1
    at(supervisor, 0.0, SERVICE + 0.1, PERMITTED, place=PLACE + 200.0, first=4)
    assert supervisor.interventions == 2


def test_standstill_ends_a_service_brake_beyond_the_permitted_speed_but_no_overspeed(supervisor: Supervisor) -> None:
    """Breaks if a service brake beyond the end of authority is never released, or the states change their rules."""
    beyond, slow = end_of_authority() + 1.0, STANDSTILL / 2
    assert [one.state for one in steps(supervisor, [(PLACE, SERVICE + 0.1), (beyond, slow)])][-1] is State.NORMAL
    other = new_supervisor()
    assert [one.state for one in steps(other, [(PLACE, PERMITTED + 0.1), (beyond, slow)])][-1] is State.OVERSPEED


def test_the_speed_of_standstill_is_a_movement(supervisor: Supervisor) -> None:
    """Breaks if a train at exactly this speed is released, or passes the end of authority."""
    braked = at(supervisor, EMERGENCY + 0.1, STANDSTILL, STANDSTILL * 0.99)
    assert [one.state for one in braked] == [State.EMERGENCY_BRAKE, State.EMERGENCY_BRAKE, State.NORMAL]
    beyond = at(new_supervisor(), STANDSTILL, place=end_of_authority() + 1.0)
    assert beyond[0].state is State.EMERGENCY_BRAKE


@pytest.mark.parametrize(("distance", "released"), [(10.0, False), (REPEATED, True), (200.0, True)])
def test_a_second_emergency_brake_at_the_same_place_is_not_released(distance, released, supervisor):
    """Breaks if the ATO repeats a brake near the end of the first one, or far ones add up."""
    again = PLACE + distance
    at(supervisor, EMERGENCY + 0.1, 0.0)
    second = steps(supervisor, [(again, EMERGENCY + 0.1), (again, 0.0)], first=2)
    assert [one.state for one in second] == [State.EMERGENCY_BRAKE, State.NORMAL if released else State.EMERGENCY_BRAKE]


def test_a_brake_that_is_not_released_stays_so_on_its_way(supervisor: Supervisor) -> None:
    """Breaks if the condition is forgotten while the train, still above the limit, leaves the place."""
    at(supervisor, EMERGENCY + 0.1, 0.0)
    fast = EMERGENCY + 0.1
    second = steps(supervisor, [(PLACE + 10.0, fast), (PLACE + 200.0, fast), (PLACE + 300.0, 0.0)], first=2)
    assert {one.state for one in second} == {State.EMERGENCY_BRAKE}


def first_places(acceleration: float) -> tuple[float, float, list[SupervisionDecision]]:
    """Return the first places of indication and overspeed on a grid before the stop [m], and decisions on the way."""
    end, speed = end_of_authority(), 60 / 3.6

    def decide(index: int) -> SupervisionDecision:
        supervisor = new_supervisor()
        place = end - 1500.0 + 2.0 * index
        decision = steps(supervisor, [(place, speed - acceleration * 0.4 * late) for late in (3, 2, 1, 0)])[-1]
        assert decision.own.known and decision.speeds == supervisor.track.evaluate(decision.own.front, decision.motion)
        return decision

    indication, overspeed = (
        bisect_left(range(725), kind, key=lambda index: decide(index).state)
        for kind in (State.INDICATION, State.OVERSPEED)
    )
    places = sorted({*range(0, 725, 25), indication - 1, indication, overspeed - 1, overspeed})
    found = [decide(index) for index in places]
    assert {State.INDICATION, State.OVERSPEED} <= {one.state for one in found}
    return indication * 2.0, overspeed * 2.0, found


def test_the_indication_precedes_the_permitted_speed_by_its_time() -> None:
    """Breaks if no indication is given, or later than 5 s before the permitted speed: 3.13.9.3.6."""
    indicated, exceeded, found = first_places(0.0)
    kinds = [one.state for one in found]
    assert kinds == sorted(kinds) and kinds[0] is State.NORMAL
    assert (exceeded - indicated + 2.0) / (60 / 3.6) >= MIN_INDICATION_TIME
    assert found[kinds.index(State.INDICATION)].reason == "a target is near"


def test_limits_and_indication_use_the_acceleration_of_the_train() -> None:
    """Breaks if the estimated motion is left out: an accelerating train must brake earlier."""
    steady, faster = first_places(0.0), first_places(0.5)
    assert faster[0] < steady[0] and faster[1] < steady[1]


def test_without_odometry_the_emergency_brake_acts_with_its_reason(supervisor: Supervisor) -> None:
    """Breaks if a missing odometry raises, or the decision has limits or a motion from before."""
    at(supervisor, 10.0)
    decision = supervisor.step(None)
    assert (decision.state, decision.reason) == (State.EMERGENCY_BRAKE, "no valid odometry")
    assert tuple(decision.speeds) == (0.0, 0.0, 0.0, 0.0) and not decision.own.known
    assert supervisor.state["reason_limit"] == 0.0


def test_a_restarted_supervisor_brakes_until_standstill(supervisor: Supervisor) -> None:
    """Breaks if a new process of the node releases the brakes of a moving train."""
    supervisor.join()
    found = at(supervisor, 10.0, 5.0, 0.0, first=500)
    assert [one.state for one in found] == [State.EMERGENCY_BRAKE, State.EMERGENCY_BRAKE, State.NORMAL]
    assert (found[0].reason, found[-1].reason) == ("node supervisor restarted", "")
    assert supervisor.interventions == 1
    supervisor.join()  # the train may roll back slowly meanwhile: its time without a supervisor is no distance
    assert [one.state for one in at(supervisor, -1.0, 0.0, first=900)] == [State.EMERGENCY_BRAKE, State.NORMAL]


def test_a_speed_without_a_curve_is_an_error_where_no_limit_is_exceeded() -> None:
    """Breaks if a curve that ends below the speed goes unnoticed, or stops a run that is braked anyway."""
    grades = [(-5458.0, -200.0), (-658.0, 0.0)]
    steep = TrackSupervision(
        supervised_train(service=None, t_traction_cut_off=3.0), grades, [], BrakingTarget(1000.0, kind="EOA")
    )
    braked = steps(Supervisor(steep, SupervisionSpec()), [(0.0, 52.0)] * 3 + [(0.0, 60.0)])
    assert [one.state for one in braked] == [State.EMERGENCY_BRAKE] * 4
    far = -3000.0
    assert steep.evaluate(far).permitted > 49.9
    with pytest.raises(ValueError, match=r"the braking curve ends at"):
        steps(Supervisor(steep, SupervisionSpec()), [(far, 46.0)] * 3 + [(far, 49.9)])


@pytest.mark.parametrize("forwards", [0.0, 0.5])
def test_a_stop_or_a_movement_forwards_ends_the_distance_of_a_roll_back(forwards: float) -> None:
    """Breaks if two short movements backwards with a stop between them count as one long one."""
    back, supervisor = -1.0, new_supervisor()
    found = at(supervisor, 0.0, *[back] * 4, forwards, *[back] * 5, back)
    assert [one.state for one in found[:-1]] == [State.NORMAL] * (len(found) - 1)
    assert found[-1].state is State.EMERGENCY_BRAKE
    assert found[-1].reason == "the train rolled back 2.4 m"


def test_the_first_movement_backwards_counts_from_its_first_period(supervisor: Supervisor) -> None:
    """Breaks if the distance begins with another value than zero, or before the first odometry."""
    found = at(supervisor, *[-1.0] * 7, first=3)
    assert [one.state for one in found] == [State.NORMAL] * 6 + [State.EMERGENCY_BRAKE]


RANGES = [
    # model, key, smallest and largest accepted value (None: no bound), refused values
    (SupervisionSpec, "period", (0.001, 2.0), (0.0009, 2.001)),
    (SupervisionSpec, "overlap", (0.0, 1e5), (-0.001, 100_000.1)),
    (SupervisionSpec, "kdry", (0.001, 1.0), (0.0, 1.001)), (SupervisionSpec, "roll_away", (0.001, None), (0.0,)),
    (SupervisionSpec, "speed_difference", (0.001, None), (0.0,)),
    (SupervisionSpec, "position_difference", (0.001, None), (0.0,)),
    (SupervisionSpec, "confirmation", (0.0, None), (-0.001,)),
    (SupervisionSpec, "assurance_margin", (0.0, None), (-0.001,)),
    (SupervisionSpec, "plan_margin", (0.0, None), (-0.001,)), (FailsafeSpec, "hold", (0.0, None), (-0.001,)),
    (FailsafeSpec, "coast", (0.0, None), (-0.001,)), (FailsafeSpec, "service", (0.0, None), (-0.001,)),
    (FailsafeSpec, "release", (0.001, None), (0.0,)),
]  # fmt: skip


def test_defaults() -> None:
    """Breaks if a default is changed without its entry here: the figures of every shipped run depend on it."""
    assert SupervisionSpec().model_dump() == {
        "enabled": None, "period": 0.4, "overlap": 100.0, "kdry": 0.8, "service_brake": True, "service_curve": False,
        "roll_away": 2.0, "speed_difference": 2.0, "position_difference": 20.0, "confirmation": 1.0, "assurance": True,
        "assurance_limit": "warning", "assurance_margin": 0.5, "plan_margin": 0.5,
        "failsafe": {"hold": 0.5, "coast": 1.0, "service": 5.0, "release": None},
    }  # fmt: skip


@pytest.mark.parametrize(("model", "key", "accepted", "refused"), RANGES, ids=[row[1] for row in RANGES])
def test_ranges(model, key, accepted, refused):
    """Breaks if a bound of a setting moves or is left out."""
    for value in accepted:
        if value is not None:
            assert getattr(model.model_validate({key: value}), key) == value
    for value in refused:
        with pytest.raises(ValidationError, match=key):
            model.model_validate({key: value})


@pytest.mark.parametrize(
    ("key", "low", "high"), [("overlap", 1.0, 5e3), ("roll_away", 0.05, 20.0), ("position_difference", 0.5, 1e3)]
)
def test_usual_magnitudes(key: str, low: float, high: float) -> None:
    """Breaks if a distance in another unit has no note, or a usual one has one."""
    for value, noted in ((low, False), (high, False), (0.99 * low, True), (1.01 * high, True)):
        notes = list(unusual_values(SupervisionSpec.model_validate({key: value})))
        assert [note.startswith(f"{key} = ") for note in notes] == [True] * noted, value


def test_states_by_severity() -> None:
    """Breaks if a state of a recorded run changes its number: the log and the page have numbers."""
    names = ["NORMAL", "INDICATION", "OVERSPEED", "WARNING", "SERVICE_BRAKE", "EMERGENCY_BRAKE"]
    assert [(state.name, state.value) for state in SupervisionState] == list(zip(names, range(6), strict=True))
    assert SupervisionState.SERVICE_BRAKE.text == "service brake"
