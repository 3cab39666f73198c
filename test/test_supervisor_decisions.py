"""Decisions and settings of the supervisor at their edges: limits, releases, repeated brakes, reasons, ranges."""

from collections.abc import Iterable
from functools import cache

import numpy as np
import pytest
from curve_trains import supervised_train
from engine_runs import setup_of
from pydantic import ValidationError

from plant_sim.si_model import unusual_values
from train_ato.messages.types import Odometry
from train_ato.scenario.setup import RunSetup
from train_ato.supervision.limits import BrakingTarget
from train_ato.supervision.settings import MIN_INDICATION_TIME, FailsafeSpec, SupervisionSpec
from train_ato.supervision.step_function import ceiling_speeds
from train_ato.supervision.supervisor import SupervisionDecision, SupervisionState, Supervisor
from train_ato.supervision.track_supervision import TrackSupervision

PERMITTED, WARNING, SERVICE, EMERGENCY = ceiling_speeds(80 / 3.6)
PLACE = 1000.0
STANDSTILL, REPEATED = 0.1, 50.0
"""Speed of standstill [m/s]; distance of a second emergency brake that is not released [m]."""
State = SupervisionState


@cache
def metro() -> RunSetup:
    return setup_of("xuzhou_metro:disturbed")


@cache
def track() -> TrackSupervision:
    return metro().supervisor().track


def new_supervisor() -> Supervisor:
    """Return a supervisor in its first state; the limits of the track do not change."""
    return Supervisor(track(), metro().scenario.supervision)


@pytest.fixture
def supervisor() -> Supervisor:
    return new_supervisor()


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
    assert first.motion is not None and first.motion.speed == speed


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


def test_the_indication_precedes_the_permitted_speed_by_its_time() -> None:
    """Breaks if no indication is given, or later than 5 s before the permitted speed: 3.13.9.3.6."""
    end, speed = end_of_authority(), 60 / 3.6
    places = np.arange(end - 1500.0, end - 50.0, 2.0)
    found = [at(new_supervisor(), speed, place=float(place))[0] for place in places]
    kinds = [one.state for one in found]
    assert kinds == sorted(kinds) and kinds[0] is State.NORMAL
    indicated, exceeded = kinds.index(State.INDICATION), kinds.index(State.OVERSPEED)
    assert (places[exceeded] - places[indicated] + 2.0) / speed >= MIN_INDICATION_TIME
    assert found[indicated].reason == "a target is near"


def test_limits_and_indication_use_the_acceleration_of_the_train() -> None:
    """Breaks if the estimated motion is left out: an accelerating train must brake earlier."""
    end, speed = end_of_authority(), 60 / 3.6

    def states(acceleration: float) -> list[State]:
        found = []
        for place in np.arange(end - 1500.0, end - 50.0, 2.0):
            supervisor = new_supervisor()
            moves = [(float(place), speed - acceleration * 0.4 * late) for late in (3, 2, 1, 0)]
            decision = steps(supervisor, moves)[-1]
            motion = decision.motion
            assert motion is not None
            assert decision.speeds == supervisor.track.evaluate(motion.front, motion.estimate)
            found.append(decision.state)
        return found

    steady, faster = states(0.0), states(0.5)
    for kind in (State.INDICATION, State.OVERSPEED):
        assert (steady.index(kind) - faster.index(kind)) * 2.0 > 0.0


def test_without_odometry_the_emergency_brake_acts_with_its_reason(supervisor: Supervisor) -> None:
    """Breaks if a missing odometry raises, or the decision has limits or a motion from before."""
    at(supervisor, 10.0)
    decision = supervisor.step(None)
    assert (decision.state, decision.reason) == (State.EMERGENCY_BRAKE, "no valid odometry")
    assert tuple(decision.speeds) == (0.0, 0.0, 0.0, 0.0) and decision.motion is None
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
