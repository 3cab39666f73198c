"""A law without a valid force: the last command is repeated, counted and reported, up to a limit."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from law_trains import HAULED, SINGLE, asked, measured, model, profile, stack

from train_ato.cli import main
from train_ato.control.contract import LawInput, LawOutput
from train_ato.control.laws.pid import Pid
from train_ato.control.registry import LAWS
from train_ato.log.reading import read_log
from train_ato.messages.codec import Wire
from train_ato.program.errors import RunFailed
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare

pytestmark = pytest.mark.usefixtures("without_figure")

TICK = 100_000_000


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


def drive(control, of, along, count, spoil=lambda k, seen: seen):
    """Run a train along the reference; return the forces."""
    forces = []
    for k in range(count):
        reference, estimate = asked(of, along, k * TICK)
        seen = measured(of, k * TICK, reference.position, reference.velocity, 0.0)
        forces.append(control.step(spoil(k, seen), reference, estimate)[0])
    return np.array(forces)


@pytest.mark.parametrize(
    ("law", "first", "said"),
    [
        ("silent", 50, r"law silent: step\(\) returned \[nan\] N; .* in 10 consecutive steps \(1 s, hold_limit\)"),
        ("overflowing", 51,
         r"law 'overflowing' repeated its last force \(computed \[inf\] N\); .* in 10 consecutive steps"),
        ("short", 0, r"law short: step\(\) returned \[\] N, shape \(0,\); .* in 10 consecutive steps"),
    ],
)  # fmt: skip
def test_invalid_forces_are_held_for_a_second_and_no_longer(law, first, said):
    """Breaks if the last force is held for ever, or the line lacks the law or the count."""
    of, along = model(SINGLE), profile()
    control = stack(of, law, along=along)
    forces = drive(control, of, along, first + 10)
    assert (forces[first:] == (forces[first - 1] if first else 0.0)).all()
    assert control.diagnostics()["held_steps"] == "10"
    assert control.holding
    with pytest.raises(RunFailed, match=said):
        drive(control, of, along, 1)


def test_less_than_the_limit_is_counted_and_tolerated():
    """Nine invalid steps: the law continues with the tenth, and the count of the next gap starts at 0."""
    of, along = model(SINGLE), profile()
    control = stack(of, "brief", along=along)
    forces = drive(control, of, along, 200)
    usual = drive(stack(of, "pid", along=along), of, along, 200)
    assert (forces[50:59] == forces[49]).all()
    assert (forces[59:] == usual[59:]).all()
    assert control.diagnostics()["held_steps"] == "9"
    assert not control.holding


@pytest.mark.parametrize("gap", [1, 9])
def test_a_gap_in_the_measurement_is_tolerated_and_a_lost_sensor_is_not(gap):
    """NaN speeds for up to 0.9 s are counted; for ever the run fails and names the measurement."""
    of, along = model(SINGLE), profile()

    def spoil(k, seen):
        seen.velocity[:] = math.nan if 50 <= k < 50 + gap or k >= 100 else seen.velocity
        return seen

    control = stack(of, along=along)
    drive(control, of, along, 100, spoil)
    assert control.diagnostics()["held_steps"] == control.diagnostics()["unsound_measurements"] == str(gap)
    with pytest.raises(RunFailed, match="no valid measurement of the power units in 10 consecutive steps"):
        drive(control, of, along, 200, lambda k, seen: spoil(100, seen))


def test_a_dead_coupler_sensor_is_named():
    """The state is valid, the coupler force of `smc` is not: the guard names the input."""
    of, along = model(HAULED, sensors=(0,)), profile(pull=0.1)
    control = stack(of, "smc", along=along)
    reference, estimate = asked(of, along, 0)
    seen = measured(of, 0, reference.position, reference.velocity, 0.0)
    seen.force[:] = math.nan
    for _ in range(10):
        control.step(seen, reference, estimate)
    with pytest.raises(RunFailed, match=r"law 'smc' repeated its last force \(invalid inputs: coupler_force\) in 10"):
        control.step(seen, reference, estimate)


def test_a_slow_law_is_allowed_three_steps():
    """At a period of 2 s one NaN exceeds the limit of 1 s: three steps are allowed."""
    of, along = model(SINGLE), profile()
    control = stack(of, "short", along=along, period=2.0)
    drive(control, of, along, 41)
    with pytest.raises(RunFailed, match=r"in 3 consecutive steps \(6 s, hold_limit\)"):
        drive(control, of, along, 1)


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
    wire = Wire(prepare(*load_scenario("demo", (ALONE.removeprefix("--set="),))).layout)
    reports = [m for _, _, m in read_log(out, wire.decode, ("/diagnostics",)) if m.node == "controller"]
    assert [m.values["held_steps"] for m in reports if m.level == 1] == [str(k) for k in range(1, 11)]


def test_the_graph_ends_the_same_way(tmp_path: Path) -> None:
    """Breaks if the controller node ignores the failure, or reports another count than the engine."""
    from train_ato.ros.graph.runner import run_graph

    setup = prepare(*load_scenario("demo", ("duration=30", ALONE.removeprefix("--set=")), {"law": "silent"}))
    outcome = run_graph(setup, tmp_path, mode="composed")
    assert outcome.failure is not None
    assert outcome.failure.startswith(BEGIN) and outcome.failure.endswith(END)
    assert outcome.summary["held_steps"] == 10


def test_the_limit_is_a_key_of_the_scenario(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if hold_limit is not used, not checked, or a short gap is not reported on the screen."""
    run = ["run", "demo", "--law", "silent", "--engine", "--set=duration=7"]
    assert main([*run, "--set=hold_limit=5", f"--out={tmp_path / 'run'}"]) == 0
    assert "in 20 ticks the last command was repeated" in capsys.readouterr().out
    assert main([*run, "--set=hold_limit=0", f"--out={tmp_path / 'none'}"]) == 2
    assert "hold_limit" in capsys.readouterr().err
