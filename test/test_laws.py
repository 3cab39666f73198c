"""Laws by hand, step by step, and their registry."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from engine_runs import setup_of
from law_trains import FIVE, HAULED, HILLY, PUSHED, SINGLE, inputs, model, printed_law

from train_ato.control.contract import make_parameters, parameter, parameters_of
from train_ato.control.laws.pid import Pid
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS, Registry


def test_pid_forces_of_paper_000():
    """1e7 N/(m/s), 1 N/m, 1 N s²/m; breaks if a gain is scaled by the mass or a sign is wrong."""
    of = model(SINGLE)
    law = printed_law(
        "pid",
        {"per_mass": False, "kp": 1e7, "ki": 1.0, "kd": 1.0, "feedforward": False, "derivative_time": 0.0},
        of,
        0.05,
    )
    first = law.step(inputs(of, velocity=np.array([10.01]), position=np.array([503.0])))
    assert first.force[0] == pytest.approx(-(1e7 * 0.01 + 1.0 * 3.0), rel=1e-9)
    second = law.step(inputs(of, velocity=np.array([10.02]), position=np.array([503.0])))
    assert second.force[0] == pytest.approx(-(1e7 * 0.02 + 3.0 + 1.0 * 0.01 / 0.05), rel=1e-9)


def test_pid_per_mass_with_feedforward_and_disturbance():
    """Law: u = u_ff - d - M (kp e' + ki e); breaks if the estimate is added instead of subtracted."""
    of = model(FIVE)
    law = printed_law("pid", {"kp": 0.1, "ki": 0.01}, of, 0.1)
    out = law.step(
        inputs(
            of, velocity=np.full(5, 10.2), position=502.0 - of.offsets, feedforward=np.full(5, 7e3),
            disturbance=np.full(5, 2e3),
        )
    )  # fmt: skip
    assert out.force == pytest.approx(np.full(5, 7e3 - 2e3 - 80e3 * (0.1 * 0.2 + 0.01 * 2.0)), rel=1e-9)


@pytest.mark.parametrize("name", ["pid", "smc", "rbf_smc", "rbf_switching_smc", "fixed_time_smc", "funnel"])
def test_an_estimated_disturbance_is_subtracted_from_the_force(name):
    """Breaks if a law adds the estimate of the observer, or leaves it out."""
    of, force = model(FIVE, lag=0.4), {}
    for disturbance in (0.0, 2e3, -3e3):
        law = printed_law(name, {}, of, 0.1)
        law.step(inputs(of, velocity=np.full(5, 10.1)))
        moved = {"t": 50.1, "velocity": np.full(5, 10.1), "position": 501.0 - of.offsets}
        force[disturbance] = law.step(inputs(of, **moved, disturbance=np.full(5, disturbance))).force
    for disturbance, found in force.items():
        assert found - force[0.0] == pytest.approx(np.full(5, -disturbance), abs=1e-6)


def test_pid_integral_holds_in_saturation_and_is_clamped():
    """Breaks without anti-windup: after 100 s at the limit the integral would be 500 m; the clamp is 20 m."""
    of = model(SINGLE)
    law = printed_law("pid", {"integral": "speed", "feedforward": False, "kp": 1.0, "ki": 0.1}, of, 0.1)
    for _ in range(1000):
        stuck = law.step(inputs(of, velocity=np.array([4.0])))
    assert stuck.force[0] == 400e3 and 0 <= law.step(inputs(of)).force[0] < 80e3 * 0.1 * 0.7
    law = printed_law("pid", {"integral": "speed", "feedforward": False, "kp": 0.0, "ki": 0.01}, of, 0.1)
    for _ in range(1000):
        slow = law.step(inputs(of, velocity=np.array([9.0])))
    assert slow.force[0] == pytest.approx(80e3 * 0.01 * 20.0)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["traction", "brake"])
def test_pid_integral_at_a_limit_is_held_against_it_only(side):
    """Breaks if the anti-windup has the wrong sign: 80 t, 400 kN, kp 1/s, ki 0.1/s², sum of the speed error, 0.1 s."""
    # Errors of 6, 6 and -1 m/s: the first one gives 80 t (6 + 0.06) > 400 kN, the second is held, the third counts.
    of = model(SINGLE)
    law = printed_law("pid", {"integral": "speed", "feedforward": False, "kp": 1.0, "ki": 0.1}, of, 0.1)
    forces = [law.step(inputs(of, velocity=np.array([10.0 - side * slow]))).force[0] for slow in (6.0, 6.0, -1.0)]
    assert forces[:2] == [side * 400e3, side * 400e3]
    assert forces[2] == pytest.approx(-side * 80e3 * (1.0 - 0.1 * (0.6 - 0.1)))


def test_pid_does_not_bridge_a_gap_and_starts_again_cleared():
    """Breaks if the difference quotient spans a missed sample (80 kN), or a start keeps filters or integral."""
    of = model(SINGLE)
    gains = {"kp": 1.0, "ki": 0.0, "kd": 2.5, "derivative_time": 0.0, "feedforward": False}
    law = printed_law("pid", gains, of, 0.1)
    speeds = (10.01, math.nan, 10.05, 10.06)
    forces = [law.step(inputs(of, velocity=np.array([speed]))).force[0] for speed in speeds]
    assert forces == pytest.approx([-800.0, -800.0, -4000.0, -4800.0 - 80e3 * 2.5 * 0.1])
    of = model(SINGLE)
    gains = {"kp": 1.0, "ki": 0.1, "kd": 1.0, "integral": "speed", "feedforward": False}
    law = printed_law("pid", {**gains, "filter_time": 1.0, "derivative_time": 1.0}, of, 0.1)
    for speed in (11.0, 11.5, 12.0):
        law.step(inputs(of, velocity=np.array([speed])))
    law.clear_state()
    assert law.step(inputs(of, velocity=np.array([10.5]))).force[0] == pytest.approx(-80e3 * (0.5 + 0.1 * 0.05))


def test_smc_of_paper_000_by_hand():
    """(19), (21), (22) on the locomotive with the force of its first coupler; breaks on any wrong term."""
    of = model(HAULED, HILLY, sensors=(0,))
    law = printed_law("smc", {"ks": 0.0}, of, 0.1)
    e, de = 0.2, -0.05
    out = law.step(
        inputs(
            of, t=1.0, position=np.array([2000.0 + e]), velocity=np.array([10.0 + de]),
            reference_position=np.array([2000.0]), acceleration_at_effect=0.03, coupler_force=np.array([250e3]),
            shoe_force=np.array([1e3]), disturbance=np.array([500.0]), force_max=np.array([760e3]),
        )
    )  # fmt: skip
    kmh = 3.6 * (10.0 + de)
    specific = 1.20 + 0.0065 * kmh + 0.000279 * kmh**2 + 4.0
    f = 250e3 + 184e3 * 9.81e-3 * specific + 1e3
    surface = de + e
    reaching = 0.005 * abs(surface) ** 5 + 0.05 * math.tanh(e / 2)
    expected = f / 1.01 + 184e3 * 0.03 - 500.0 - 184e3 * (de + 0.1 * e + reaching)
    assert out.force[0] == pytest.approx(expected, rel=2e-6)


def test_smc_integral_reaching_and_feedforward():
    """The integral is the trapezoid of e from the second step on, plus ks S; a feed-forward has the whole mass."""
    of = model(SINGLE)
    law = printed_law("smc", {"ks": 0.5, "kappa": 0.0, "xi": 0.0, "l2": 0.2}, of, 0.1)
    law.step(inputs(of, position=np.array([500.1])))
    out = law.step(inputs(of, position=np.array([500.3])))
    own = 80e3 * (1.176e-2 + 7.7616e-4 * 10 + 1.6e-5 * 100) / 1.01
    surface = 0.3 + 0.2 * 0.5 * (0.1 + 0.3) * 0.1
    assert out.force[0] == pytest.approx(own - 80e3 * (0.2 * 0.3 + 0.5 * surface), rel=1e-9)
    of = model(HAULED)
    law = printed_law(
        "smc", {"equivalent": "feedforward", "l1": 0.07, "l2": 0.002, "ks": 0.05, "phi": 0.1, "xi": 0.0}, of, 0.1
    )
    out = law.step(inputs(of, velocity=np.array([10.1]), feedforward=np.array([90e3]), force_max=np.array([760e3])))
    assert out.force[0] == pytest.approx(90e3 - 584e3 * (0.07 * 0.1 + 0.05 * 0.1), rel=1e-9)


ALL = [(kind, name) for kind in (LAWS, OBSERVERS, COMPENSATIONS) for name in kind.names()]


@dataclass(frozen=True)
class Sample:
    gain: float = parameter(1.0, "1/s", 0.0, 10.0, "a gain")
    count: int = parameter(3, "1", 1, 9, "a number")
    on: bool = parameter(True, "", 0, 1, "a switch")
    mode: str = parameter("slow", "", 0, 0, "a choice", choices=("slow", "fast"))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"gian": 1.0}, r"x\.gian: no such parameter; did you mean 'gain'\?; x has: gain, count, on, mode"),
        ({"gain": float("nan")}, r"x\.gain: nan is outside 0 \.\.\. 10 1/s"),
        ({"gain": 11}, r"x\.gain: 11 is outside 0 \.\.\. 10 1/s"),
        ({"gain": "1"}, r"x\.gain: '1' is not a number"),
        ({"gain": True}, r"x\.gain: True is not a number"),
        ({"count": 2.5}, r"x\.count: 2\.5 is not a whole number"),
        ({"on": 1}, r"x\.on: 1 is not true or false"),
        ({"mode": "fats"}, r"x\.mode: 'fats' is not allowed; did you mean 'fast'\?; choose from: slow, fast"),
    ],
)
def test_wrong_parameters_are_refused(values, message):
    """Breaks if a check is missing or the message lacks key, value or remedy."""
    with pytest.raises(ValueError, match=message):
        make_parameters(Sample, values, "x")


def test_right_parameters_keep_their_types():
    """Breaks if an integer for a float is rejected, or a count becomes a float."""
    made = make_parameters(Sample, {"gain": 2, "count": 4.0, "on": False, "mode": "fast"}, "x")
    assert made == Sample(2.0, 4, False, "fast") and isinstance(made.gain, float)
    assert isinstance(made.count, int)


@pytest.mark.parametrize(("kind", "name"), ALL, ids=[f"{kind.kind}-{name}" for kind, name in ALL])
def test_every_registered_component_is_described(kind, name):
    """Breaks if a default is outside its range, or a unit, a description or a docstring is missing."""
    assert len(kind.summary(name)) > 10
    for entry in parameters_of(kind.get(name).Parameters):
        assert entry.meaning, entry.name
        if isinstance(entry.default, str):
            assert entry.default in entry.choices
        elif not isinstance(entry.default, bool):
            assert entry.low <= entry.default <= entry.high, entry.name


def test_names_of_the_registry():
    """Breaks if a misspelt law has no hint, a name is registered twice, or used classes change the list of names."""
    with pytest.raises(ValueError, match=r"unknown law 'smcc'; did you mean 'smc'\?; known: .*pid"):
        LAWS.make("smcc", {}, None, 0.1)
    with pytest.raises(ValueError, match=r"smc\.kss: no such parameter.*'ks'"):
        LAWS.check_parameters("smc", {"kss": 1.0})
    laws = Registry("law", "none.such", {})
    laws.register("mine", Pid)
    of = model(SINGLE)
    assert laws.make("mine", {"feedforward": False}, of, 0.1).step(inputs(of)).force[0] == 0.0
    with pytest.raises(ValueError, match="'mine' is registered already"):
        laws.register("mine", Pid)
    before = LAWS.names()
    name = LAWS.name_of(Unregistered)
    assert name == f"{__name__}:Unregistered" and LAWS.get(name) is Unregistered
    assert LAWS.names() == before and name not in LAWS.loadable()
    assert name in setup_of("demo", "duration=1", changes={"law": name}).laws


def test_other_packages_register_by_entry_point(tmp_path, monkeypatch):
    """Breaks if entry points are ignored, are not seen after an installation, or a broken one gives a traceback."""
    monkeypatch.syspath_prepend(tmp_path)
    laws = Registry("law", "train_ato.controllers", {"smc": "train_ato.control.laws.smc:Smc"})
    assert laws.names() == ("smc",)
    installed = tmp_path / "theirs-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    names = ("theirs = train_ato.control.laws.pid:Pid", "broken = no_such_module:Law", "smc = no_such_module:Law")
    (installed / "entry_points.txt").write_text("\n".join(("[train_ato.controllers]", *names)))
    assert laws.names() == ("broken", "smc", "theirs") and laws.get("theirs") is Pid
    assert laws.get("smc").__name__ == "Smc"
    with pytest.raises(ValueError, match="law 'broken': module 'no_such_module' cannot be imported"):
        laws.get("broken")


def test_a_law_rejects_an_unsuitable_train_with_the_reason():
    """Breaks if smc accepts a hauled train without the sensor of its first coupler, or rejects one with it."""
    with pytest.raises(
        ValueError, match=r"law 'smc': equivalent: measured needs the force of coupler_0, or a unit of 184 t"
    ):
        LAWS.make("smc", {"gains": "printed"}, model(HAULED), 0.1)
    LAWS.make("smc", {"gains": "printed"}, model(HAULED, sensors=(0,)), 0.1)
    LAWS.make("smc", {}, model(SINGLE), 0.1)
    LAWS.make("smc", {}, model(FIVE), 0.1)
    with pytest.raises(ValueError, match=r"observer 'ndo': .*coupler_0, coupler_3; fit the sensors"):
        OBSERVERS.make("ndo", {"scope": "vehicle"}, model(PUSHED), 0.1)


class Unregistered(Pid):
    """Law that no test registers."""
