"""Control stack: guards, repeated output and limit, change of the law without a jump, feed-forward, brake policy."""

import dataclasses
import json
import math
from pathlib import Path
from types import SimpleNamespace

import law_trains as lt
import numpy as np
import pytest
from engine_runs import setup_of
from plant_trains import line_of

from train_ato.cli import main
from train_ato.control.air_brake.policy import BrakeSpec, make_brake_policy
from train_ato.control.contract import LawInput, LawOutput
from train_ato.control.laws.pid import Pid
from train_ato.control.registry import LAWS
from train_ato.log.reading import read_log
from train_ato.messages.codec import Wire
from train_ato.program.errors import RunFailed

TICK = 100_000_000


def run(control, of, along, count, error=0.0, start=0, spoil=lambda k, seen: seen):
    """Run a train along the reference with a speed error and spoilt inputs; return forces and the last pressure."""
    forces, pressure = [], None
    for k in range(start, start + count):
        reference, estimate = lt.asked(of, along, k * TICK)
        seen = lt.measured(of, k * TICK, reference.position, reference.velocity + error, 0.0)
        force, pressure = control.step(spoil(k, seen), reference, estimate)
        forces.append(force)
    return np.array(forces), pressure


def test_feedforward_is_newtons_law_on_the_hill():
    """M a + R(v) + grade over the whole run; breaks if a term is missing or the table of the line is shifted."""
    of, along = lt.model(lt.SINGLE, lt.HILLY), lt.profile()
    forces, _ = run(lt.stack(of, along=along), of, along, 1500)
    k = np.arange(1500)
    expected = [of.rigid_force(along.position[i], along.velocity[i], along.acceleration[i]) for i in k]
    assert forces[:, 0] == pytest.approx(np.array(expected), abs=1e-6 * 80e3)
    assert np.ptp(expected) > 30e3


def test_preview_inverts_delay_and_lag():
    """Through 0.8 s of delay and 0.4 s of lag, the force of the preview arrives as the needed force."""
    of, along = lt.model(lt.SINGLE, lt.LEVEL, delay=0.8, lag=0.4), lt.profile()
    needed, _ = run(lt.stack(of, along=along), of, along, 1400)
    sent, _ = run(lt.stack(of, compensation="preview", along=along), of, along, 1400)
    acting, now = np.zeros(1400), float(needed[8, 0])
    keep = np.exp(-0.1 / 0.4)
    for k in range(8, 1400):
        acting[k] = now
        now = sent[k - 8, 0] + (now - sent[k - 8, 0]) * keep
    led = np.abs(acting - needed[:, 0])[60:].max()
    late = np.abs(np.roll(needed[:, 0], 12) - needed[:, 0])[60:].max()
    assert led < 0.06 * late and late > 1e3


def test_delay_by_the_sign_of_the_command():
    """A braking unit uses its brake delay, a driving unit its traction delay."""
    of, along = lt.model(lt.SINGLE, lt.LEVEL, delay=1.0, delay_brake=0.5), lt.profile()
    sent, _ = run(lt.stack(of, compensation="preview", along=along), of, along, 1700)
    needed = np.append(run(lt.stack(of, along=along), of, along, 1700)[0][:, 0], np.zeros(20))
    pulling, braking = slice(10, 300), slice(1500, 1600)
    assert sent[pulling, 0] == pytest.approx(needed[20:310], abs=1.0)
    assert sent[braking, 0] == pytest.approx(needed[1505:1605], abs=1.0) and needed[1505] < -1e3


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("field", ["position", "velocity", "applied"])
def test_an_invalid_measurement_repeats_the_last_command(wrong, field):
    """Breaks if a NaN, an infinity or an impossible value reaches the law, or the law does not continue afterwards."""
    of, along = lt.model(lt.FIVE), lt.profile()
    control, other = lt.stack(of, along=along), lt.stack(of, along=along)
    before, _ = run(control, of, along, 50)
    run(other, of, along, 50)
    reference, estimate = lt.asked(of, along, 50 * TICK)
    good = lt.measured(of, 50 * TICK, reference.position, reference.velocity, 0.0)
    bad = dataclasses.replace(good, **{field: np.where(np.arange(5) == 2, wrong, getattr(good, field))})
    held, _ = control.step(bad, reference, estimate)
    assert (held == before[-1]).all()
    other.step(good, reference, estimate)
    after, _ = run(control, of, along, 5, start=51)
    expected, _ = run(other, of, along, 5, start=51)
    assert (after == expected).all() and control.diagnostics()["unsound_measurements"] == "1"


def test_output_stays_inside_the_limits_at_the_present_speed():
    """An error of 9 m/s demands far more than 400 kN."""
    of, along = lt.model(lt.SINGLE), lt.profile()
    control = lt.stack(of, parameters={"kp": 5.0}, along=along)
    forces, _ = run(control, of, along, 100, error=-9.0)
    assert forces.max() == 400e3 and int(control.diagnostics()["saturated_steps"]) > 50


def test_a_change_of_the_law_begins_at_the_last_command_and_keeps_the_jerk_of_the_profile():
    """Breaks if the first output is another one, a tick exceeds jerk x inertia x tick, or the law is not reached."""
    of, along = lt.model(lt.SINGLE), lt.profile()
    control, alone = (lt.stack(of, "pid", {"kp": kp}, along=along) for kp in (0.05, 0.8))
    before, _ = run(control, of, along, 200, error=-0.4)
    run(alone, of, along, 200, error=-0.4)
    largest = np.percentile(np.abs(along.jerk())[along.jerk() != 0.0], 99) * of.inertia * of.tick
    control.swap("pid", {"kp": 0.8})
    after, _ = run(control, of, along, 100, error=-0.4, start=200)
    new, _ = run(alone, of, along, 100, error=-0.4, start=200)
    assert after[0, 0] == before[-1, 0] and abs(new[0, 0] - before[-1, 0]) > 20e3
    assert np.abs(np.diff(after[:31, 0])).max() <= 1.05 * largest and (after[-5:] == new[-5:]).all()


def test_a_law_that_ignores_the_limits_keeps_the_bound_too():
    """Breaks if only laws of this project are limited: a user's law without a base class jumps by 200 kN."""
    of, along = lt.model(lt.SINGLE), lt.profile()
    control = lt.stack(of, along=along)
    run(control, of, along, 100)
    jumping = SimpleNamespace(step=lambda seen: LawOutput(np.array([200e3 if seen.t % 0.2 < 0.1 else -200e3])))
    control._make_law = lambda *_: jumping
    control.swap("pid", {})
    forces, _ = run(control, of, along, 30, start=100)
    largest = np.percentile(np.abs(along.jerk())[along.jerk() != 0.0], 99) * of.inertia * of.tick
    assert np.abs(np.diff(forces[:, 0])).max() <= 1.05 * largest


def test_a_law_that_writes_into_its_inputs_moves_no_limit_and_no_part_of_the_force():
    """Breaks if limits or parts of the force are those of the inputs, or speeds of other units are read from memory."""
    of, along = lt.model(lt.SINGLE), lt.profile()
    control, given = lt.stack(of, along=along), []

    def writing(seen):
        given[:] = seen.feedforward.copy(), seen.disturbance.copy()
        seen.force_max *= 10.0
        seen.feedforward[:], seen.disturbance[:] = 1.0, 1.0
        return LawOutput(np.array([3e6]))

    control._make_law = lambda *_: SimpleNamespace(step=writing)
    control.swap("pid", {})
    forces, _ = run(control, of, along, 300)
    assert forces.max() == 400e3 and control.fed == tuple(given)
    with pytest.raises(ValueError, match="2 speeds for 1 power units; give one for each unit"):
        of.force_limits(np.zeros(2))


def test_a_refused_swap_leaves_the_old_law_running():
    """Breaks if a rejected swap changes the stack."""
    of, along = lt.model(lt.SINGLE), lt.profile()
    control, other = lt.stack(of, along=along), lt.stack(of, along=along)
    run(control, of, along, 20)
    run(other, of, along, 20)
    with pytest.raises(ValueError, match=r"pid\.kp"):
        control.swap("pid", {"kp": -1.0})
    assert (run(control, of, along, 20, start=20)[0] == run(other, of, along, 20, start=20)[0]).all()


def test_longer_period_holds_the_output():
    """A law at 0.5 s with a tick of 0.1 s computes in every fifth tick; 0.25 s is rejected; same inputs, same bits."""
    of, along = lt.model(lt.SINGLE), lt.profile()
    forces, _ = run(lt.stack(of, along=along, period=0.5), of, along, 100)
    full, _ = run(lt.stack(of, along=along), of, along, 100)
    assert (forces[:, 0] == np.repeat(full[::5, 0], 5)).all()
    with pytest.raises(ValueError, match=r"control_period: 0\.25 s is not a multiple of the tick 0\.1 s"):
        lt.stack(of, along=along, period=0.25)
    of, along = lt.model(lt.FIVE, lt.HILLY, delay=0.7, lag=0.4), lt.profile()
    first, _ = run(lt.stack(of, compensation="preview", along=along), of, along, 300, 0.03)
    second, _ = run(lt.stack(of, compensation="preview", along=along), of, along, 300, 0.03)
    assert first.tobytes() == second.tobytes()


SHOES = {
    "loco": lt.LOCOMOTIVE | {"shoes": {"count": 32, "force": 6.93e3, "friction": 0.441}},
    "wagon": lt.WAGON | {"shoes": {"count": 8, "force": 16.18e3, "friction": 0.481}},
}
BRAKED = lt.consist(SHOES, [("loco", 1), ("wagon", 4)], {"kind": "linear", "stiffness": 20e6}, air_brake={})


def test_planned_brake_is_demanded_and_taken_off_the_feedforward():
    """50 kPa at 40 s: demand of 550 kPa, and a locomotive force reduced by that of the shoes."""
    of, along = lt.model(BRAKED), lt.profile()
    spec = BrakeSpec.model_validate({"policy": "planned", "events": [{"time": 40.0, "reduction_kpa": 50}]})
    braked, pressure = run(lt.stack(of, along=along, brake=spec), of, along, 800)
    free, charged = run(lt.stack(of, along=along), of, along, 800)
    assert (pressure, charged) == (550e3, 600e3) and (braked[:400] == free[:400]).all()
    speed = 3.6 * along.velocity[799]
    full = (
        0.17
        * (2 * speed + 150)
        / (3 * speed + 150)
        * sum(
            count * 1e3 * force * factor * (force + 200) / (4 * force + 200)
            for count, force, factor in [(32, 6.93, 0.441), (4 * 8, 16.18, 0.481)]
        )
    )
    assert braked[-1, 0] - free[-1, 0] == pytest.approx(full, rel=1e-3)


def test_brake_rules_of_paper_000():
    """Applied above 60 km/h before four steep pieces, released 10 km/h lower, not within 160 s, not without a pipe."""
    falls = [{"at": 5000 + 600 * i, "grade": -0.009 - 0.0005 * (i % 2)} for i in range(12)]
    line = line_of(40e3, grades=[*falls, {"at": 12200, "grade": 0.0}])
    of = lt.model(BRAKED, line)
    policy = make_brake_policy(BrakeSpec.model_validate({"policy": "trigger"}), of, line)
    assert policy.step(0.0, 4000.0, 59 / 3.6) == 600e3
    assert policy.step(1.0, 4600.0, 70 / 3.6) == 600e3
    assert policy.step(2.0, 4905.0, 70 / 3.6) == 550e3
    assert policy.step(30.0, 5500.0, 61 / 3.6) == 550e3
    assert policy.step(40.0, 5600.0, 60.4 / 3.6) == 600e3
    assert policy.step(161.0, 6190.0, 70 / 3.6) == 600e3
    assert policy.step(162.0, 6190.0, 70 / 3.6) == 550e3
    of = lt.model(lt.HAULED)
    with pytest.raises(ValueError, match=r"the consist has no air_brake; set brake\.policy: none"):
        make_brake_policy(BrakeSpec.model_validate({"policy": "trigger"}), of, of.line)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"policy": "planned"}, "policy planned needs events"),
        ({"events": [{"time": 1, "reduction": 5e4}]}, "set brake.policy: planned"),
        ({"policy": "planned", "events": [{"reduction": 5e4}]}, "exactly one of time and place"),
    ],
)
def test_wrong_brake_plans_are_refused(spec, message):
    with pytest.raises(ValueError, match=message):
        BrakeSpec.model_validate(spec)


pytestmark = pytest.mark.usefixtures("without_figure")


class Silent(Pid):
    """Returns NaN in the steps of ``silent``, without the guard of the laws here."""

    silent: range = range(50, 10**9)

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)  # type: ignore[arg-type]
        self.steps = 0

    def step(self, inputs: LawInput) -> LawOutput:
        self.steps += 1
        return LawOutput(np.full(self.n, math.nan)) if self.steps - 1 in self.silent else super().step(inputs)


class Brief(Silent):
    """Returns NaN once for just less than the limit."""

    silent = range(50, 59)


class Overflowing(Pid):
    """Computes infinities from 5 s on; the guard repeats the last force."""

    def demand(self, inputs: LawInput) -> list[float]:
        return [math.inf] * self.n if inputs.t > 5.0 else super().demand(inputs)


class Short(Silent):
    """Returns an empty force."""

    def step(self, inputs: LawInput) -> LawOutput:
        return LawOutput(np.zeros(0))


@pytest.fixture(autouse=True)
def _laws(monkeypatch: pytest.MonkeyPatch) -> None:
    for law in (Silent, Brief, Overflowing, Short):
        monkeypatch.setitem(LAWS._loaded, law.__name__.lower(), law)


@pytest.mark.parametrize(("law", "first", "said"), [
    ("silent", 50, r"law silent: step\(\) returned \[nan\] N; .* in 10 consecutive steps \(1 s, hold_limit\)"),
    ("overflowing", 51,
     r"law 'overflowing' repeated its last force \(computed \[inf\] N, .*stack\.py:\d+\); .* in 10 consecutive"),
    ("short", 0, r"law short: step\(\) returned \[\] N, shape \(0,\); .* in 10 consecutive steps"),
])  # fmt: skip
def test_invalid_forces_are_held_for_a_second_and_no_longer(law, first, said):
    """Breaks if the last force is held for ever, or the line lacks the law or the count."""
    of, along = lt.model(lt.SINGLE), lt.profile()
    control = lt.stack(of, law, along=along)
    forces, _ = run(control, of, along, first + 10)
    assert (forces[first:] == (forces[first - 1] if first else 0.0)).all()
    assert control.diagnostics()["held_steps"] == "10" and control.hold.in_a_row
    with pytest.raises(RunFailed, match=said):
        run(control, of, along, 1)


def test_less_than_the_limit_is_counted_and_tolerated():
    """Nine invalid steps: the law continues with the tenth, and the count of the next gap starts at 0."""
    of, along = lt.model(lt.SINGLE), lt.profile()
    control = lt.stack(of, "brief", along=along)
    forces, _ = run(control, of, along, 200)
    usual, _ = run(lt.stack(of, "pid", along=along), of, along, 200)
    assert (forces[50:59] == forces[49]).all() and (forces[59:] == usual[59:]).all()
    assert control.diagnostics()["held_steps"] == "9" and not control.hold.in_a_row


@pytest.mark.parametrize("gap", [1, 9])
def test_a_gap_in_the_measurement_is_tolerated_and_a_lost_sensor_is_not(gap):
    """NaN speeds for up to 0.9 s are counted; for ever the run fails and names the measurement."""
    of, along = lt.model(lt.SINGLE), lt.profile()

    def spoil(k, seen):
        seen.velocity[:] = math.nan if 50 <= k < 50 + gap or k >= 100 else seen.velocity
        return seen

    control = lt.stack(of, along=along)
    run(control, of, along, 100, spoil=spoil)
    assert control.diagnostics()["held_steps"] == control.diagnostics()["unsound_measurements"] == str(gap)
    with pytest.raises(RunFailed, match="no valid measurement of the power units in 10 consecutive steps"):
        run(control, of, along, 200, spoil=lambda k, seen: spoil(100, seen))


def test_a_dead_coupler_sensor_is_named():
    """The state is valid, the coupler force of `smc` is not: the guard names the input."""
    of, along = lt.model(lt.HAULED, sensors=(0,)), lt.profile(pull=0.1)
    control = lt.stack(of, "smc", along=along)
    reference, estimate = lt.asked(of, along, 0)
    seen = lt.measured(of, 0, reference.position, reference.velocity, 0.0)
    seen.force[:] = math.nan
    for _ in range(10):
        control.step(seen, reference, estimate)
    with pytest.raises(RunFailed, match=r"law 'smc' repeated its last force \(invalid inputs: coupler_force\) in 10"):
        control.step(seen, reference, estimate)


def test_a_slow_law_is_allowed_three_steps():
    """At a period of 2 s one NaN exceeds the limit of 1 s: three steps are allowed."""
    of, along = lt.model(lt.SINGLE), lt.profile()
    control = lt.stack(of, "short", along=along, period=2.0)
    run(control, of, along, 41)
    with pytest.raises(RunFailed, match=r"in 3 consecutive steps \(6 s, hold_limit\)"):
        run(control, of, along, 1)


ALONE = "--set=supervision.enabled=false"
"""With a supervisor the train is stopped first (test_ato_engagement.py)."""
BEGIN = "node controller failed: law silent: step() returned [nan] N; return LawOutput(force=array of 1), "
END = "; the last command was repeated in 10 consecutive steps (1 s, hold_limit)"


def test_the_run_fails_in_one_line_and_keeps_its_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if such a run ends with status 0, or log or summary lacks the failure."""
    out = tmp_path / "run"
    assert main(["run", "demo", "--law", "silent", "--set=duration=30", ALONE, f"--out={out}", "--engine"]) == 1
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith(f"train-ato: {BEGIN}") and said.endswith(END) and f"{Path(__file__).name}:" in said
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["status"], summary["held_steps"], summary["ticks"]) == ("failed", 10, 61)
    wire = Wire(setup_of("demo", ALONE.removeprefix("--set=")).layout)
    reports = [m for _, _, m in read_log(out, wire.decode, ("/diagnostics",)) if m.node == "controller"]
    assert [m.values["held_steps"] for m in reports if m.level == 1] == [str(k) for k in range(1, 11)]


def test_the_graph_ends_the_same_way(tmp_path: Path) -> None:
    """Breaks if the controller node ignores the failure, or reports another count than the engine."""
    from train_ato.ros.graph.runner import run_graph

    setup = setup_of("demo", "duration=30", ALONE.removeprefix("--set="), changes={"law": "silent"})
    outcome = run_graph(setup, tmp_path, mode="composed")
    assert outcome.failure.startswith(BEGIN) and outcome.failure.endswith(END)
    assert outcome.summary["held_steps"] == 10


def test_the_limit_is_a_key_of_the_scenario(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if hold_limit is not used, not checked, or a short gap is not reported on the screen."""
    run = ["run", "demo", "--law", "silent", "--engine", "--set=duration=7"]
    assert main([*run, "--set=hold_limit=5", f"--out={tmp_path / 'run'}"]) == 0
    assert "in 20 ticks the last command was repeated" in capsys.readouterr().out
    assert main([*run, "--set=hold_limit=0", f"--out={tmp_path / 'none'}"]) == 2
    assert "hold_limit" in capsys.readouterr().err
