"""Law mpc for trains with hauled vehicles: modes of the couplers, their observer, gain, and runs of own trains."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from law_trains import LEVEL, LOCOMOTIVE, WAGON, consist, model

import train_ato as ta
from train_ato.cli import main
from train_ato.control.algorithms.coupler_modes import CouplerModes, bandwidth_text, eigenvalues
from train_ato.control.algorithms.train_constants import (
    MATCHED_SHARE,
    dead_time,
    default_bandwidth,
    hauling_groups,
    wave_time,
)
from train_ato.control.mpc.force_plan import ForcePlan, PlanStart
from train_ato.control.mpc.measured_motion import MOTION, ModalObserver
from train_ato.control.registry import LAWS
from train_ato.studies.check_component import checking

SPRING = {"kind": "linear", "stiffness": 10e6, "damping": 2e5}
RIGID = {"kind": "rigid"}
TABLE = {
    "kind": "table", "deflection": [0.0, 0.05, 0.1], "loading": [0.0, 2e5, 8e5], "unloading": [0.0, 1e5, 4e5],
    "slack": 0.01,
}  # fmt: skip
SMOOTHED = {
    "kind": "smoothed", "stroke": 0.1, "force_at_stroke": 8e5, "preload": 5e4, "preload_length": 0.002,
    "stiffness": 3e6, "unloading_ratio": 0.5, "slack": 0.01, "damping": 1e5, "stop_stiffness": 2e8,
    "switching_speed": 1.0,
}  # fmt: skip
TYPES = {"engine": LOCOMOTIVE, "wagon": WAGON}
HILL = {
    "schema": "train_ato/line/1", "name": "hill", "summary": "rise and fall", "end_km": 5,
    "grades": [{"at": 0, "grade_permille": 0}, {"at": 700, "grade_permille": 4}, {"at": 1200, "grade_permille": -3}],
    "speed_limits": [{"at": 0, "speed_kmh": 80}],
}  # fmt: skip


def own_run(parts, gear, wagon=WAGON, **changes):
    """Return the run of a train of one's own on the hill."""
    whole = consist({"engine": LOCOMOTIVE, "wagon": wagon}, parts, gear).model_dump(mode="json", by_alias=True)
    changes |= {
        "plant.consist": whole, "plant.line": HILL, "model.consist": whole, "model.line": HILL, "plant.lag": 0.4,
        "plant.disturbances": [],
    }  # fmt: skip
    return ta.run("demo", law="mpc", compensation="none", seed=5, set=changes, progress=False)


def _model(train, gear, delay=0.6):
    return model(consist(TYPES, train, gear), LEVEL, delay, 0.4)


def test_eigenvalues_of_a_chain():
    """A wrong rotation changes 2 - 2 cos(pi k/n) of a free chain; two masses have omega² = k (1/m + 1/n)."""
    size = 40
    matrix = 2.0 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1)
    matrix[0, 0] = matrix[-1, -1] = 1.0
    values, vectors = eigenvalues(matrix)
    assert np.sort(values) == pytest.approx(2.0 - 2.0 * np.cos(math.pi * np.arange(size) / size), abs=1e-12)
    assert np.abs(matrix @ vectors - vectors * values).max() < 1e-12
    assert np.abs(vectors.T @ vectors - np.eye(size)).max() < 1e-12
    modes = CouplerModes.of(_model([("engine", 1), ("wagon", 1)], SPRING))
    first, second = LOCOMOTIVE["mass"], WAGON["mass"]
    assert modes.omega == pytest.approx([math.sqrt(10e6 * (1 / first + 1 / second))])
    assert modes.mobility == pytest.approx([1 / first - 1 / (first + second)])
    assert modes.damping == pytest.approx(2e5 * modes.omega / (2 * 10e6))


def test_modes_have_the_response_of_the_whole_train():
    """Without the modes with the largest Hankel values the speed of a unit differs from that of the simulated chain."""
    count, period, steps = 30, 0.01, 1500
    modes = CouplerModes.of(_model([("engine", 1), ("wagon", count)], SPRING))
    mass = np.array([LOCOMOTIVE["mass"], *[WAGON["mass"]] * count])
    place, speed = np.zeros(count + 1), np.zeros(count + 1)
    u, w = np.zeros(modes.omega.size), np.zeros(modes.omega.size)
    inner, chain, found = period / 20, [], []
    for step in range(steps):
        force = 1e5 * min(1.0, step * period / 4.0)
        for _ in range(20):
            pull = SPRING["stiffness"] * np.diff(place) + SPRING["damping"] * np.diff(speed)
            speed += (
                inner * (np.append(pull, 0.0) - np.insert(pull, 0, 0.0) + np.insert(np.zeros(count), 0, force)) / mass
            )
            place += inner * speed
            w += inner * (modes.mobility * force - 2 * modes.damping * modes.omega * w - modes.omega**2 * u)
            u += inner * w
        chain.append(speed[0] - mass @ speed / mass.sum())
        found.append(w.sum())
    assert np.abs(np.array(found) - chain).max() < 0.15 * np.abs(chain).max()


def test_rigid_couplers_have_no_modes():
    """Bodies joined by rigid couplers are one, and two equal units do not excite the odd modes of their train."""
    rigid = _model([("engine", 1), ("wagon", 5)], RIGID)
    assert wave_time(rigid) == 0.0 and CouplerModes.of(rigid).omega.size == 0
    table = CouplerModes.of(_model([("engine", 1), ("wagon", 5)], TABLE))
    assert 1 <= table.omega.size <= 4 and np.all(table.damping > 0.02)
    assert CouplerModes.of(_model([("engine", 2)], SPRING)).omega.size == 0
    whole = _model([("engine", 1), ("wagon", 1), ("engine", 1)], SPRING)
    assert CouplerModes.of(whole).omega == pytest.approx([math.sqrt(10e6 * (1 / 184e3 + 2 / 100e3))])


def test_observer_separates_a_wave_from_the_speed_of_the_train():
    """A wave in the speed of the unit that the loop cannot damp is not fed back as a speed error."""
    of = _model([("engine", 1), ("wagon", 14)], SPRING, delay=1.0)
    modes = CouplerModes.of(of)
    observer = ModalObserver(0.1, 0.3, wave_time(of), speed_noise=0.02, modes=modes, dead_time=dead_time(of))
    fast = float(modes.omega[-1])
    assert fast * dead_time(of) > 0.5 * math.pi
    seen = []
    for step in range(600):
        wave = 0.05 * math.sin(fast * 0.1 * step)
        observer.step(-0.05 / fast * math.cos(fast * 0.1 * step), wave, 0.0)
        seen.append(observer.speed_error)
    assert np.abs(seen[300:]).max() < 0.2 * 0.05
    assert len(observer._mean) == MOTION + 2 * modes.omega.size


def test_a_law_that_begins_in_motion_takes_the_stretch_of_its_train_for_no_wave():
    """Breaks if the modes begin without the stretch by the force: a swap then has twice the error and more."""
    of = _model([("engine", 1), ("wagon", 14)], SPRING)
    modes, force = CouplerModes.of(of), 3e5
    observer = ModalObserver(0.1, 0.3, wave_time(of), speed_noise=0.02, modes=modes, dead_time=dead_time(of))
    observer.stand(0.2, 10.0, 50.0, 10.0, moving=True, force=force)
    seen = []
    for _ in range(100):
        observer.step(0.2, 0.0, 0.0, force=force)
        seen.append((observer.position_error, observer.speed_error))
    assert np.abs(np.array(seen)[:, 1]).max() < 1e-9 and np.ptp(np.array(seen)[:, 0]) < 1e-9


def test_noise_of_the_speed_is_no_wave_of_a_short_train():
    """A train of three vehicles has small waves: with those of a long one the estimate follows the noise."""
    of = _model([("wagon", 1), ("engine", 1), ("wagon", 1)], SPRING)
    observer = ModalObserver(
        0.1, 0.5, wave_time(of), speed_noise=0.025, modes=CouplerModes.of(of), dead_time=dead_time(of)
    )  # fmt: skip
    seen = []
    for noise in np.random.default_rng(1).normal(0.0, 0.025, 1000):
        observer.step(0.0, noise, 0.0)
        seen.append(observer.speed_error)
    assert np.abs(np.diff(seen[300:])).mean() < 0.003  # 0.0055 with the waves of a long train


def test_waves_that_outlast_the_feedback_are_not_fed_back():
    """A mode at 1.1 rad/s, undamped for .8 s of delay, was fed back: lost at 1.2 s, couplers over 4 000 kN."""
    # For two bodies b² M = n/m: the feedback changes the damping rate by at most g n/(2 m A), A² = 1 + omega² Ta².
    of = _model([("engine", 1), ("wagon", 1)], SPRING)
    modes = CouplerModes.of(of)
    omega, ratio = float(modes.omega[0]), WAGON["mass"] / LOCOMOTIVE["mass"]
    largest = 2.0 / ratio * float(modes.damping[0]) * omega * math.hypot(1.0, 0.4 * omega)
    assert not modes.outlast(0.99 * largest, of.inertia, 0.4)
    assert modes.outlast(1.01 * largest, of.inertia, 0.4)


@pytest.mark.parametrize(("outlast", "quarter"), [(False, 1.0), (True, 1.5)])
def test_a_wave_is_fed_back_if_the_loop_damps_it(outlast, quarter):
    """Breaks if a wave that outlasts the feedback is lost although it is damped: 89 vehicles roll 1.44 m too far."""
    modes = CouplerModes.of(_model([("engine", 1), ("wagon", 1)], SPRING))
    turn = 0.5 * math.pi / float(modes.omega[0]) / quarter
    for part, kept in ((0.99, []), (1.01, [MOTION])):
        observer = ModalObserver(0.1, 0.1, 5.0, speed_noise=0.02, modes=modes, dead_time=part * turn, outlast=outlast)
        assert observer._not_fed_back == kept


@pytest.mark.parametrize(
    ("train", "mass", "gear", "delays", "wrong", "largest"),
    [
        ((1, 100, 1), 40e3, {"stiffness": 15e6, "damping": 3e5}, (0.8, 1.2), {}, 500.0),
        ((2, 45, 0), 90e3, {"stiffness": 9.4e6, "damping": 1e5}, (0.9, 0.9), {"mass_scale": 1.15}, 700.0),
    ],
    ids=["longer delay", "wrong mass"],
)
def test_long_train_in_linear_gears(train, mass, gear, delays, wrong, largest):
    """Lost at 1.5 times the delay of the model, and 9 721 kN with the same variance for all modes."""
    front, wagons, rear = train
    parts = [(kind, count) for kind, count in (("engine", front), ("wagon", wagons), ("engine", rear)) if count]
    run = own_run(parts, {"kind": "linear", **gear}, {**WAGON, "mass": mass}, **{
        "duration": 300, "links.command.delay": delays[1], "model.delay": delays[0], "plant.mismatch": wrong,
        "profile.start": 1500.0, "profile.limits": {"jerk": 0.1, "acceleration": 0.07, "deceleration": 0.07},
        "profile.phases": [{"cruise_for": 3}, {"accelerate_to_kmh": 35}, {"cruise_for": 120}, {"brake_to": 0}],
    })  # fmt: skip
    assert run.metrics["tracking"] == "tracked" and run.metrics["coupler_draft_max_kn"] < largest


def test_a_stop_is_a_constraint_only_while_the_waves_have_time():
    """Breaks if the last seconds before a stop have a larger gain than the couplers permit (29 s for 170 vehicles)."""
    for train, waves in (([("engine", 1), ("wagon", 100)], True), ([("engine", 1)], False)):
        of, zeros = _model(train, SPRING), np.zeros(200)
        plan = ForcePlan(
            of, 0.1, omega=0.1, lookahead=120.0, nodes=32, jerk=1.0, overspeed=0.1, coupler_limit=0.0
        )  # fmt: skip
        plan.set_delays(np.full((2, 1), 0.6), 6, 8, 0.1, 1.0)
        n = plan.nodes.size
        rest = SimpleNamespace(position=zeros, velocity=zeros, acceleration=zeros, force_max=zeros[:0])
        start = PlanStart(
            zeros, np.ones((2, n)), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, (-1e5, 1e5), 1.0, 0.0, of.inertia, 1.0, False,
            False,
        )  # fmt: skip
        plan.decide(start, rest, simulated=False)
        # By hand: 3 over two thirds of the wave impedance m/T_w, T_w = sqrt(m n/k), over the inertia.
        time = 4.5 * of.inertia * math.sqrt(of.mass * 101 / 10e6) / of.mass if waves else 0.0
        assert (plan.allowed[7 * n :] < 0.0).tolist() == (plan.nodes >= time).tolist()
        assert 0 < np.count_nonzero(plan.nodes < time) < n or not waves


def test_gain_is_a_part_of_the_wave_impedance():
    """The two locomotives at the front act on one side; at both ends each has its own half of the train."""
    front = _model([("engine", 2), ("wagon", 100)], SPRING)
    both = _model([("engine", 1), ("wagon", 100), ("engine", 1)], SPRING)
    assert hauling_groups(front) == [(1.0, 1)] and hauling_groups(both) == [(0.5, 1), (0.5, 1)]
    impedance = front.mass / wave_time(front)
    assert 2.0 * default_bandwidth(front).omega * front.inertia == pytest.approx(MATCHED_SHARE * impedance, rel=0.1)
    assert default_bandwidth(both).omega == pytest.approx(2.0 * default_bandwidth(front).omega, rel=0.01)
    short = _model([("engine", 1), ("wagon", 20)], TABLE, delay=1.5)
    assert 2.0 * default_bandwidth(short).omega * short.inertia < 0.8 * MATCHED_SHARE * short.mass / wave_time(short)


@pytest.mark.parametrize("gear", [SPRING, RIGID, TABLE], ids=["linear", "rigid", "table"])
@pytest.mark.parametrize("train", [[("engine", 1), ("wagon", 12)], [("engine", 1), ("wagon", 12), ("engine", 1)]])
def test_own_train_stops_at_its_target_without_a_limit_cycle(gear, train):
    """A unit speed that is fed back as the speed of the train excites the couplers later: 150 to 250 kN/s."""
    # The noise of the speed has up to 47 kN/s here.
    run = own_run(train, gear, **{
        "duration": 170, "links.command.delay": 0.8, "model.delay": 0.8, "plant.sensors.velocity_noise": 0.01,
        "profile.start": 500.0, "profile.limits": {"jerk": 0.1, "acceleration": 0.2, "deceleration": 0.2},
        "profile.phases": [
            {"cruise_for": 3}, {"accelerate_to_kmh": 40}, {"cruise_for": 30}, {"brake_to": 0}, {"cruise_for": 10},
        ],
    })  # fmt: skip
    assert run.metrics["tracking"] == "tracked" and abs(run.metrics["stop_error_m"]) < 0.1
    assert run.metrics["command_variation_kn_per_s"] < 80.0


def test_the_condition_that_limits_the_bandwidth_is_named(capsys, monkeypatch):
    """Breaks if another condition than the smallest is named, or list of a train or check-law say another one."""
    # By hand: .9 over 1.2 s of delay and lag; a third of the impedance m/T_w over the inertia, T_w = sqrt(m n/k); for
    # the unloading ratio of one half zeta = 1/(3 pi), so x = tanh(T_w/(6 t_d)) with t_d = 1.9 s.
    whole, table = _model([("engine", 1), ("wagon", 100)], SPRING), _model([("engine", 1), ("wagon", 20)], TABLE, 1.5)
    impedance = whole.mass / math.sqrt(whole.mass * 101 / 10e6)
    way = math.sqrt(table.mass * 21 / 8e6)
    # A wave with 760 kN in 8 MN/m has a speed of pi/(2 T_w) x .095 m: its part of 1 m/s acts. Springs have no friction.
    smooth, slack = _model([("engine", 1), ("wagon", 20)], SMOOTHED, 1.5), SPRING | {"slack": 0.01}
    part = 0.095 * math.pi / (2.0 * way)
    cases = (
        (_model([("engine", 1)], RIGID, 0.8), 0.75, "delay and lag"),
        (_model([("engine", 1)], RIGID, 0.0), 1.5, "the law itself, delay and couplers permit more"),
        (whole, impedance / (3.0 * whole.inertia), "wave impedance of the couplers"),
        (table, 0.5 * math.tanh(way / 11.4) * table.mass / (way * table.inertia), "loss of waves in gear"),
        (smooth, 0.5 * math.tanh(part * way / 11.4) * table.mass / (way * table.inertia), "loss of waves in gear"),
        (
            _model([("engine", 1), ("wagon", 100)], slack),
            impedance / (3.0 * whole.inertia),
            "wave impedance of the couplers",
        ),
    )
    for train, omega, limit in cases:
        assert default_bandwidth(train) == (pytest.approx(omega, rel=1e-6), limit)
        assert LAWS.make("mpc", {}, train, 0.1).omega == default_bandwidth(train).omega
    assert "0.75 rad/s, limited by: delay and lag" in LAWS.gains("mpc", {}, cases[0][0], 0.1).reason
    # About k pi/T_w, .32, .65, .97 and 1.3 rad/s, against a quarter of a turn in 1.5 times 1 s.
    assert bandwidth_text(whole).endswith("the couplers damp waves little, the law 3 of 4 kinds of waves")
    assert main(["list", "hxd1_c80_105"]) == 0
    assert "delay and lag 1 s: bandwidth 0.035 rad/s, limited by: wave impedance" in capsys.readouterr().out
    monkeypatch.setitem(checking.KINDS, "law", replace(checking.KINDS["law"], tests={}))
    found = [each.detail for each in checking.check_component("law", "mpc") if each.test == "gains of the model"]
    assert found[-1] == "delay 0 s, lag 0 s: bandwidth 0.035 rad/s, limited by: wave impedance of the couplers"
