"""Gains of a law for its train: choice, table, given values, the rule of the model, and the law `pid`."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from engine_runs import setup_of
from law_trains import HAULED, LOCOMOTIVE, SINGLE, SPRING, WAGON, consist, inputs, model

from plant_sim.library import load_consist
from train_ato.cli import main
from train_ato.control.algorithms.loop_gains import LoopGains, feedback_of, is_stable
from train_ato.control.gains import MODEL, TABLE, has_gains
from train_ato.control.laws.pid import Pid
from train_ato.control.registry import LAWS
from train_ato.control.train_model import TrainModel
from train_ato.judge import result
from train_ato.loop.engine import run_engine
from train_ato.papers.claims import Case
from train_ato.studies.check_component.random_trips import (
    FITTING_SHARE,
    GEAR_KINDS,
    Trip,
    drive_random_trip,
    random_scenario,
    random_trips,
    trips_text,
)

OWN, METRO = (str(Path(__file__).with_name("data") / name) for name in ("own_train.yaml", "metro_pid.yaml"))
"""Scenarios without gains, the first with a train that only shares its name with a shipped one."""


def two_masses(gear: dict[str, object]) -> TrainModel:
    """Return a locomotive and a wagon."""
    whole = consist({"loco": LOCOMOTIVE, "wagon": WAGON}, [("loco", 1), ("wagon", 1)], gear)
    return model(whole, delay=0.6, lag=0.2)


def test_a_train_of_the_same_name_and_a_longer_delay_take_the_rule() -> None:
    """Breaks if the name alone decides, or gains for 0.8 s control a train with 1.5 s: kp = 1/(2 (0.3+0.4+0.05) s)."""
    gains = setup_of(OWN).gains("pid")
    assert gains.source == "model" and gains.values["kp"] == pytest.approx(1.0 / 1.5)
    late = setup_of("demo", "links.command.delay=1.5").gains("pid")
    assert late.source == "model" and "up to a delay of 0.8 s" in late.reason


def test_the_first_entry_that_holds_decides_and_names_the_rule_where_it_fits_best() -> None:
    """Breaks if the entry without delay serves a train with delay or hides the other, or `model` is not the rule."""
    ideal, late = setup_of("daqin_heavy_haul:ideal"), setup_of("daqin_heavy_haul")
    rule = LAWS.get("pid").model_gains(ideal.model, ideal.control_period)  # type: ignore[attr-defined]
    assert ideal.gains("pid").values == rule
    assert (ideal.gains("pid").source, late.gains("pid").source) == ("model", "fitted")
    assert late.gains("pid").values == {"kp": 0.05, "ki": 0.001}
    assert ideal.gains("smc").values == late.gains("smc").values
    assert "the best found" in late.gains("funnel").reason and late.gains("funnel").values["feedforward"]


def test_printed_gains_are_the_defaults_of_the_parameters() -> None:
    """Breaks if a claim of a paper runs with fitted gains, or a given value replaces all fitted ones or is lost."""
    law = Case("demo", {"law": "smc"}).setup().law("smc")
    assert law.parameters == LAWS.get("smc").Parameters(gains="printed")  # type: ignore[attr-defined]
    table = {train: entry["laws"] for entry in yaml.safe_load(TABLE.read_text()) for train in entry["trains"]}
    gains = setup_of("demo", "laws.smc.ks=0.5", "laws.smc.gains=fitted").gains("smc")
    assert gains.values == {**table["hxd1_c80_105"]["smc"], "ks": 0.5, "gains": "fitted"}
    assert (gains.source, gains.reason) == ("fitted", "fitted to hxd1_c80_105; ks given")


def test_the_resolved_scenario_runs_with_the_same_gains(tmp_path: Path) -> None:
    """Breaks if a recorded run is repeated with the table of a later version, or its source changes."""
    first = setup_of("demo", "law=lag_smc", "laws.lag_smc.c1=0.2")
    path = tmp_path / "scenario.yaml"
    path.write_text(first.resolved_yaml())
    again = setup_of(str(path))
    assert set(again.scenario.laws["lag_smc"]) == {entry.name for entry in LAWS.parameters("lag_smc")}
    assert again.law("lag_smc").parameters == first.law("lag_smc").parameters  # type: ignore[attr-defined]
    assert again.gains("lag_smc").reason == first.gains("lag_smc").reason


def test_the_table_names_shipped_trains_with_their_mass_and_parameters_of_the_laws() -> None:
    """Breaks if a changed train keeps its gains in silence, or a renamed parameter stays in the table."""
    for entry in yaml.safe_load(TABLE.read_text()):
        assert {"trains", "delay", "lag", "period", "laws"} == set(entry)
        shipped = next(iter(entry["trains"]))
        assert load_consist(shipped).mass / 1e3 == pytest.approx(entry["trains"][shipped], rel=1e-6)
        for law, values in entry["laws"].items():
            assert has_gains(LAWS.get(law))
            if values != MODEL:
                LAWS.check_parameters(law, values)


def test_one_line_of_advice_names_gains_and_delay_with_a_remedy_that_works() -> None:
    """Breaks if printed gains or an uncompensated delay run in silence, or after the remedy a line remains."""
    assert setup_of(OWN, "laws.pid.gains=printed").advice() == (
        "pid: printed gains, not made for this train, delay 0.3 s and lag 0.4 s without compensation; "
        "try --set laws.pid.gains=model --compensation preview"
    )
    assert setup_of(OWN, "laws.pid.gains=model", "compensation=preview").advice() == ""
    assert setup_of(OWN, "laws.pid.kp=0.4", "compensation=preview").advice() == ""
    assert setup_of(OWN, "law=mpc").advice() == "", "mpc predicts over the delay"
    gpc = setup_of(OWN, "law=gpc").advice()
    assert gpc == "gpc: delay 0.3 s and lag 0.4 s without compensation; try --compensation preview", "its feed-forward"
    assert setup_of(OWN, "law=gpc", "laws.gpc.feedforward=false").advice() == "", "it predicts the whole command"


def test_gains_of_ones_own_have_a_line_if_they_are_unstable() -> None:
    """Breaks if the limit cycle after the run is the first word, or a predicted state counts as a late one."""
    # w (0.3 + 0.025) s + atan(0.4 w) = pi/2 at w = 2.56: kp below w sqrt(1 + 0.16 w²) = 3.66, with ki less.
    preview = "compensation=preview"
    assert setup_of(OWN, "laws.pid.kp=2.8", "laws.pid.ki=0.45", preview).advice() == ""
    assert setup_of(OWN, "laws.pid.kp=4", preview).advice() == (
        "pid: kp given, unstable or close to it with delay, lag and couplers of this train; try --set laws.pid.kp=0.667"
    )
    assert setup_of(OWN, "laws.pid.kp=4", "compensation=predictor").advice() == ""
    assert "kp given, unstable" in setup_of(OWN, "laws.pid.kp=60", "compensation=predictor").advice(), "period"
    assert "l1 given, unstable" in setup_of("xuzhou_metro", "law=smc", "laws.smc.l1=0").advice(), "34 m beyond its stop"


def test_own_values_of_a_failed_run_have_a_line_after_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], without_figure: None
) -> None:
    """Breaks if a run that its own gains lose names no key, as `mpc` and the learning rates, which state no limit."""
    given = ["--law=funnel", "--set", "laws.funnel.bias_rate=100"]
    assert main(["run", "xuzhou_metro", "--engine", f"--out={tmp_path / 'run'}", *given]) == 0
    line = "funnel: bias_rate given, and the run ended as 'limit cycle'; try --set laws.funnel.bias_rate=0.00694\n"
    assert line in capsys.readouterr().err
    before = ["--law=smc", "--set", "laws.smc.l1=0", "--set", "duration=1"]
    assert main(["run", "xuzhou_metro", "--engine", f"--out={tmp_path / 'before'}", *before]) == 0
    assert capsys.readouterr().err.count("l1 given") == 1, "said before the run alone"
    setup = setup_of("xuzhou_metro", "law=funnel", "laws.funnel.bias_rate=100")
    ended = {"controller": "funnel", "status": "done", "verdict": "failed", "changes": []}
    assert "bias_rate given, and the run failed; try" in result._doubted(setup, ended)["advice"]
    for key, other in (
        ("verdict", "passed"), ("status", "interrupted"), ("controller", "own"), ("advice", "said"), ("changes", [{}])
    ):  # fmt: skip
        assert result._doubted(setup, ended | {key: other}) == {}
    assert main(["run", "xuzhou_metro:disturbed", "--engine", f"--out={tmp_path / 'shipped'}"]) == 0
    assert "integral_limit given" not in capsys.readouterr().err, "the scenario states the cause"
    shipped = setup_of("xuzhou_metro:disturbed")
    assert result._doubted(shipped, ended | {"controller": "pid"}) == {}, "also in the summary and in compare"
    assert "integral_limit given" in result._doubted(setup_of("xuzhou_metro:disturbed", "duration=300"),
                                                     ended | {"controller": "pid"})["advice"]  # fmt: skip
    own = ("law=funnel", "laws.funnel.bias_rate=100", "faults=[{at: 1, do: stop, node: observer}]")
    assert result._doubted(setup_of("xuzhou_metro", *own), ended) == {}


@pytest.mark.parametrize(("law", "gain"), [
    ("pid", "kp"), ("smc", "ks"), ("rbf_smc", "l1"), ("rbf_switching_smc", "c"), ("fixed_time_smc", "reaching"),
    ("funnel", "k20"), ("lag_smc", "c1"), ("gpc", "n"),
])  # fmt: skip
@pytest.mark.parametrize("gains", ["model", "fitted"])
def test_the_remedy_for_unstable_gains_works(law: str, gain: str, gains: str) -> None:
    """Breaks if a law has no limit, the limit of the waves (0.084/s) is not met, or a line remains after the remedy."""
    given = [f"law={law}", f"laws.{law}.gains={gains}", "compensation=preview"]
    found = setup_of("demo", *given, f"laws.{law}.{gain}={ {'n': 5, 'c1': 0.9}.get(gain, 0.2) }").advice()
    assert found.startswith(f"{law}: {gain} given, unstable")
    remedies = [part.strip() for part in found.partition("; try ")[2].split("--set ")[1:]]
    assert setup_of("demo", *given, *remedies).advice() == ""


def test_stability_of_one_mass_and_of_two() -> None:
    """Breaks if the delay, half of the period, the integral or a mode is missing in the limit of the gains."""
    of = model(SINGLE, delay=0.8)  # by hand: kp = pi/2 over 0.85 s; the integral alone has no damping

    def stable(of: TrainModel, speed: float, position: float = 0.0, *, predicted: bool = False) -> bool:
        return is_stable(of, 0.1, feedback_of(speed, position, of.lag), predicted=predicted)

    assert stable(of, 0.99 * math.pi / 1.7) and not stable(of, 1.01 * math.pi / 1.7)
    assert stable(of, 0.99 * math.pi / 0.1, predicted=True) and not stable(of, 1.01 * math.pi / 0.1, predicted=True)
    assert not stable(of, 0.0, 0.01) and not stable(of, 0.1, -0.01)
    two = two_masses(SPRING | {"stiffness": 5e6, "damping": 5e3})
    limit = 2.0 * LoopGains.of(two, 0.1).speed  # the rule takes half of the gain at which the mode is undamped
    assert stable(two, 0.99 * limit) and not stable(two, 1.01 * limit)


@pytest.mark.parametrize(("changes", "stable", "unstable"), [
    (("law=pid", "laws.pid.gains=model"), "laws.pid.kp=0.084", "laws.pid.kp=0.0993"),
    (("law=pid", "compensation=predictor"), "laws.pid.kp=0.084", "laws.pid.kp=0.106"),
    (("law=lag_smc",), "laws.lag_smc.c1=0.5", "laws.lag_smc.c1=0.6"),
    (("law=lag_smc",), "laws.lag_smc.k_i=0.5", "laws.lag_smc.k_i=0.8"),
    (("law=smc",), "laws.smc.kappa=0.005", "laws.smc.kappa=0.15"),
    (("law=gpc",), "laws.gpc.n=12", "laws.gpc.n=7"),
])  # fmt: skip
def test_the_line_is_between_measured_runs(changes: tuple[str, ...], stable: str, unstable: str) -> None:
    """Runs of `demo`: the gains of the first kind were tracked, those of the second had limit cycles from 85 kN on."""
    assert setup_of("demo", *changes, stable).advice() == ""
    assert "unstable" in setup_of("demo", *changes, unstable).advice()


def test_a_law_and_a_scenario_list_their_gains(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if `list` does not say which gains a run would take and why."""
    assert main(["list", "smc"]) == 0 and "fitted: hxd1_c80_105" in capsys.readouterr().out
    assert main(["list", "demo"]) == 0
    assert "fitted, fitted to hxd1_c80_105: kp 0.05, ki 0.001" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("assignment", "start"),
    [
        ("laws.pid.kpp=1", "laws.pid.kpp: no such parameter"),
        ("law=smcc", "unknown law 'smcc'"),
        ("plant.lagg=1", "plant.lagg: "),
    ],
)
def test_a_wrong_option_is_named_once_without_the_shipped_file(assignment, start, capsys):
    """Breaks if a wrong `--set` blames the shipped file, lacks the block of its key, or repeats its problem."""
    assert main(["run", "demo", "--engine", "--set", assignment]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"train-ato: --set {assignment}: {start}")
    assert "demo.yaml" not in error and error.count("did you mean") == 1


def test_pid_clamps_the_position_error_and_filters_the_speed_error() -> None:
    """Breaks if a train far behind gets the force of one far ahead, or the newest error has the weight of old ones."""
    of = model(SINGLE)
    law = LAWS.make("pid", {"kp": 0.0, "ki": 0.001, "integral_limit": 20.0}, of, 0.1)
    level = law.step(inputs(of)).force[0]
    forces = [
        law.step(inputs(of, position=np.array([500.0 + e]))).force[0] - level for e in (-100.0, -20.0, 10.0, 99.0)
    ]
    assert forces == pytest.approx([of.inertia * 0.001 * e for e in (20.0, 20.0, -10.0, -20.0)])
    of = model(SINGLE)
    law = LAWS.make("pid", {"kp": 0.05, "ki": 0.0, "filter_time": 1.0}, of, 0.1)
    level = law.step(inputs(of)).force[0]
    forces = [law.step(inputs(of, velocity=np.array([11.0]))).force[0] - level for _ in range(2)]
    assert forces == pytest.approx([-0.05 * of.inertia * (1.0 - math.exp(-0.1 * n)) for n in (1, 2)])


def test_gains_follow_the_rule_within_their_limits() -> None:
    """Breaks if a part of the dead time is missing, waves or noise have no limit, or a metro misses its window."""
    assert Pid.model_gains(setup_of(METRO).model, 0.1) == {"kp": pytest.approx(0.625), "ki": pytest.approx(0.625 / 6.4)}
    found = Pid.model_gains(setup_of("daqin_heavy_haul").model, 0.1)
    assert found["kp"] == pytest.approx(0.071, rel=0.05)
    assert found["ki"] == pytest.approx(found["kp"] ** 2 / 4)
    loop = LoopGains.of(model(SINGLE, delay=0.8, lag=0.3), 0.1)
    assert loop.dead_time == pytest.approx(1.2) and loop.speed == pytest.approx(1 / 2.4)
    assert loop.position == pytest.approx(1 / 2.4 / 9.6)
    assert LoopGains.of(model(SINGLE), 0.1).speed == 1.0
    damped = model(HAULED, delay=0.6, lag=0.3)
    rigid = consist({"loco": LOCOMOTIVE, "wagon": WAGON}, [("loco", 1), ("wagon", 4)], {"kind": "rigid"})
    assert LoopGains.of(damped, 0.1).speed < 0.5 * LoopGains.of(model(rigid, delay=0.6, lag=0.3), 0.1).speed
    summary = run_engine(setup_of(METRO, "laws.pid.gains=model")).summary
    assert abs(summary["stop_error_m"]) < 0.15  # half of the stop window of platform doors of +-0.3 m


WITH_RULE = tuple(name for name in LAWS.names() if hasattr(LAWS.get(name), "model_gains"))
SEEDS = (1, 2)
"""Seeds of the random trains."""


def test_gains_of_mpc_are_its_default() -> None:
    """Breaks if a law has no rule, or `gains: model` of mpc differs from its default or takes a given value."""
    train = model(HAULED, delay=0.6, lag=0.3)
    assert LAWS.gains("mpc", {}, train, 0.1).values == {}
    named = LAWS.gains("mpc", {"gains": "model", "omega": 0.2}, train, 0.1)
    assert named.values == {"gains": "model", "omega": 0.2}
    assert (named.source, named.reason) == ("model", f"computed from the model of {train.consist.name}; omega given")
    assert LAWS.make("mpc", {"gains": "model"}, train, 0.1).omega == LAWS.make("mpc", {}, train, 0.1).omega > 0.0
    with pytest.raises(ValueError, match="gains"):
        LAWS.check_parameters("mpc", {"gains": "printed"})
    assert set(LAWS.names()) == set(WITH_RULE)


def test_mode_of_two_vehicles_limits_the_gain() -> None:
    """Breaks if the part of the unit in the mode, its damping or the lag is wrong in the limit of a two-mass train."""
    # w² = k (1/m1 + 1/m2), zeta w = c w²/(2 k), part m2/m1 of the unit; w theta is beyond half a turn.
    train = two_masses(SPRING | {"stiffness": 5e6, "damping": 5e3})
    m1, m2 = (vehicle.mass * vehicle.rotating_mass_factor for vehicle in train.consist.vehicles)
    squared = 5e6 * (1 / m1 + 1 / m2)
    limit = 2 * 0.5 * (5e3 / 5e6 * squared / 2) * math.sqrt(1 + squared * 0.2**2) / (m2 / m1)
    assert 1.2 * math.sqrt(squared) * 0.65 > math.pi and limit < 1 / 1.8
    assert LoopGains.of(train, 0.1).speed == pytest.approx(limit, rel=1e-6)


def test_springs_without_dampers_have_gains() -> None:
    """Breaks if an undamped mode has the gain 0: 137 m behind on a trip of a freight train, and no `gpc` at all."""
    # By hand as before, with a damping ratio of .001.
    bare = {"kind": "linear", "stiffness": 5e6}
    train = two_masses(bare)
    m1, m2 = (vehicle.mass * vehicle.rotating_mass_factor for vehicle in train.consist.vehicles)
    squared = 5e6 * (1 / m1 + 1 / m2)
    limit = 0.001 * math.sqrt(squared) * math.sqrt(1 + squared * 0.2**2) / (m2 / m1)
    assert LoopGains.of(train, 0.1).speed == pytest.approx(limit, rel=1e-6)
    for gear in (bare, bare | {"slack": 0.01}):
        hauled = model(
            consist({"loco": LOCOMOTIVE, "wagon": WAGON}, [("loco", 1), ("wagon", 9)], gear), delay=0.6, lag=0.2
        )
        for name in WITH_RULE:
            LAWS.make(name, {"gains": "model"}, hauled, 0.1)


@pytest.mark.parametrize("name", WITH_RULE)
def test_gains_are_parameters_of_the_law(name: str) -> None:
    """Breaks if a rule names no parameter of the law, or is outside of its range, up to 10 s of delay."""
    law = LAWS.get(name)
    for train in (SINGLE, HAULED):
        for delay in (0.0, 0.5, 10.0):
            of = model(train, delay=delay, lag=0.5)
            given = law.model_gains(of, 0.1)
            LAWS.check_parameters(name, given)
            law(law.Parameters(**given), of, 0.1)


def test_random_trains_have_the_stated_range() -> None:
    """Breaks if the random trains lack long trains, several units, a draft gear, or the delays of the promise."""
    data = [random_scenario(seed, number) for seed in SEEDS for number in range(20)]
    trains = [each["plant"]["consist"]["train"] for each in data]
    delays = np.array([each["links"]["command"]["delay"] for each in data])
    lags = np.array([each["plant"]["lag"] for each in data])
    assert {each["plant"]["consist"]["draft_gears"]["gear"]["kind"] for each in data} == set(GEAR_KINDS)
    assert min(map(len, trains)) == 1 and 80 < max(map(len, trains)) <= 100
    assert max(sum(part["type"] == "engine" for part in train) for train in trains if len(train) > 20) > 2
    assert 0.1 <= delays.min() < 0.2 and 1.1 < delays.max() <= 1.2
    assert 0.2 <= lags.min() < lags.max() <= 0.6


RANDOM = [(name, SEEDS[0], number) for name, number in zip(WITH_RULE, itertools.cycle((0, 7, 12)), strict=False)]


@pytest.mark.parametrize(("name", "seed", "number"), [*RANDOM, ("mpc", 1, 3), ("mpc", 1, 11), ("pid", 4, 11)])
def test_a_random_train(name: str, seed: int, number: int) -> None:
    """Breaks if a law oscillates, is taken over, or misses the stop by .4 m: metro trains and freight."""
    # The last three break with the whole friction of smoothed gears (a limit cycle of 51 kN with 49 vehicles), without
    # the feedback of a free mode (.49 m short of its place with 89), or with a plan that departs early: kp of pid is
    # .015/s for 82 wagons and 1.1 s, 3.7 m short.
    trip = drive_random_trip(name, seed, number)
    assert trip.fits and trip.stop < 0.4, f"{trip.train}: {trip.result}"


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_RULE)
def test_random_trains(name: str) -> None:
    """Breaks if more than one trip of 20 with the gains of the model does not fit."""
    trips = [trip for seed in SEEDS for trip in random_trips(name, 20, seed)]
    assert not any(trip.refused for trip in trips)
    assert sum(trip.fits for trip in trips) >= FITTING_SHARE * len(trips), trips_text(trips)[1]


def test_gains_that_do_not_fit_fail() -> None:
    """Breaks if the judgement passes any trip, or a train that rolls 30 s after its arrival counts as tracked."""
    trips = random_trips("pid", 1, values={"kp": 5.0, "ki": 1.0})
    assert not trips[0].fits and trips_text(trips)[0] is False
    # The couplers of 12 vehicles swing with 2 s after two accelerations 4 s apart: 1.12 km/h too fast with kp .02/s, by
    # the profile alone. The rule has kp .093/s, half of the limit, which leaves half of the damping of the swing: 1.25
    # km/h, and from 1.2 km/h on the braking law takes over. A third of the limit has 1.19 km/h, a quarter 1.16, and no
    # share down to a tenth suffices for `lag_smc` (1.28). Train 11 has the price of a quarter: a stop of .42 m for .06.
    trip = drive_random_trip("pid", SEEDS[0], 6)
    assert (trip.fits, trip.stop) == (False, math.inf)
    assert trip.result.startswith("not stopped: moving, 9.63 m behind, 10 s after a planned arrival")
    assert "did not stop (limit 0.5)" in trip.result
    assert "1 takeover of the braking law" in trip.result


@pytest.mark.parametrize(("fitting", "passed"), [(19, True), (18, False)])
def test_share_of_trips(fitting: int, passed: bool) -> None:
    """Breaks if less than 95 % pass, if a refused train counts as driven, or if the worst train is not named."""
    trips = [Trip(f"train {number}", False, number < fitting, 0.1, "text") for number in range(20)]
    trips.append(Trip("train 20", True, False, math.inf, "refused"))
    found, text = trips_text(trips)
    assert found is passed
    assert text.startswith(f"{fitting} of 20 fit, 1 refused; worst: train {fitting}")
