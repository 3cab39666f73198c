"""A law that finds no force: the last command is held, counted and reported, and not for ever."""

from __future__ import annotations

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
from train_ato.failure import RunFailed
from train_ato.record.reading import read_log
from train_ato.run_setup import prepare
from train_ato.scenario import load
from train_ato.wire import Wire

TICK = 100_000_000


class Silent(Pid):
    """Answers NaN in the steps of ``silent``, without the guard that the laws here have."""

    silent: range = range(50, 10**9)

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)  # type: ignore[arg-type]
        self.steps = 0

    def step(self, inputs: LawInput) -> LawOutput:
        self.steps += 1
        return LawOutput(np.full(self.n, math.nan)) if self.steps - 1 in self.silent else super().step(inputs)


class Brief(Silent):
    """Is silent once, then for just less than the limit."""

    silent = range(50, 59)


class Overflowing(Pid):
    """One of ours whose own arithmetic fails for good: the guard holds."""

    def demand(self, inputs: LawInput) -> list[float]:
        return [math.inf] * self.n if inputs.t > 5.0 else super().demand(inputs)


class Short(Silent):
    """Forgets a unit."""

    def step(self, inputs: LawInput) -> LawOutput:
        return LawOutput(np.zeros(0))


@pytest.fixture(autouse=True)
def _laws(monkeypatch: pytest.MonkeyPatch) -> None:
    for law in (Silent, Brief, Overflowing, Short):
        monkeypatch.setitem(LAWS._loaded, law.__name__.lower(), law)


def drive(control, of, along, count, spoil=lambda k, seen: seen):
    """Let a train run along the reference; return the forces."""
    forces = []
    for k in range(count):
        reference, estimate = asked(of, along, k * TICK)
        seen = measured(of, k * TICK, reference.position, reference.velocity, 0.0)
        forces.append(control.step(spoil(k, seen), reference, estimate)[0])
    return np.array(forces)


@pytest.mark.parametrize(
    ("law", "first", "said"),
    [
        ("silent", 50, r"law 'silent' answered \[nan\] N in 10 consecutive steps \(1 s, hold_limit\)"),
        ("overflowing", 51, r"law 'overflowing' found no force \(its result was \[inf\] N\) in 10 consecutive steps"),
        ("short", 0, r"law 'short' answered \[\] N in 10 consecutive steps"),
    ],
)
def test_a_law_without_an_answer_is_held_for_a_second_and_no_longer(law, first, said):
    """Breaks if the last force is held for ever, or the line names neither the law nor the count."""
    of, along = model(SINGLE), profile()
    control = stack(of, law, along=along)
    forces = drive(control, of, along, first + 10)
    assert (forces[first:] == (forces[first - 1] if first else 0.0)).all()
    assert control.diagnostics()["held_steps"] == "10"
    assert control.holding
    with pytest.raises(RunFailed, match=said):
        drive(control, of, along, 1)


def test_less_than_the_limit_is_forgiven_and_counted():
    """Nine steps of silence: the law goes on from the tenth, and the next gap starts from nothing."""
    of, along = model(SINGLE), profile()
    control = stack(of, "brief", along=along)
    forces = drive(control, of, along, 200)
    usual = drive(stack(of, "pid", along=along), of, along, 200)
    assert (forces[50:59] == forces[49]).all()
    assert (forces[59:] == usual[59:]).all()
    assert control.diagnostics()["held_steps"] == "9"
    assert not control.holding


@pytest.mark.parametrize("gap", [1, 9])
def test_a_gap_in_the_measurement_is_forgiven_and_a_lost_sensor_is_not(gap):
    """NaN speeds once or for 0.9 s: held and counted; for good: the run fails and says that it was the measurement."""
    of, along = model(SINGLE), profile()

    def spoil(k, seen):
        seen.velocity[:] = math.nan if 50 <= k < 50 + gap or k >= 100 else seen.velocity
        return seen

    control = stack(of, along=along)
    drive(control, of, along, 100, spoil)
    assert control.diagnostics()["held_steps"] == control.diagnostics()["unsound_measurements"] == str(gap)
    with pytest.raises(RunFailed, match="no measurement of the power units could be used in 10 consecutive steps"):
        drive(control, of, along, 200, lambda k, seen: spoil(100, seen))


def test_a_dead_coupler_sensor_is_named():
    """The state is measured, the force that `smc` needs is not: the guard says which input it lacks."""
    of, along = model(HAULED, sensors=(0,)), profile(pull=0.1)
    control = stack(of, "smc", along=along)
    reference, estimate = asked(of, along, 0)
    seen = measured(of, 0, reference.position, reference.velocity, 0.0)
    seen.force[:] = math.nan
    for _ in range(10):
        control.step(seen, reference, estimate)
    with pytest.raises(RunFailed, match=r"law 'smc' found no force \(unusable inputs: coupler_force\) in 10"):
        control.step(seen, reference, estimate)


def test_a_slow_law_is_always_forgiven_a_few_steps():
    """At a period of 2 s one NaN would already be longer than the limit of 1 s: three steps are forgiven."""
    of, along = model(SINGLE), profile()
    control = stack(of, "short", along=along, period=2.0)
    drive(control, of, along, 41)
    with pytest.raises(RunFailed, match=r"in 3 consecutive steps \(6 s, hold_limit\)"):
        drive(control, of, along, 1)


LINE = "node controller failed: law 'silent' answered [nan] N in 10 consecutive steps (1 s, hold_limit)"


def test_the_run_fails_in_one_line_and_keeps_its_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a run whose law went silent ends with status 0, or neither log nor summary tell of it."""
    out = tmp_path / "run"
    assert main(["run", "demo", "--controller", "silent", "--set=duration=30", f"--out={out}", "--engine"]) == 1
    assert capsys.readouterr().err.strip().splitlines()[-1] == f"train-ato: {LINE}"
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["status"], summary["held_steps"], summary["ticks"]) == ("failed", 10, 60)
    wire = Wire(prepare(*load("demo")).shape)
    reports = [m for _, _, m in read_log(out, wire.decode, ("/diagnostics",)) if m.node == "controller"]
    assert [m.values["held_steps"] for m in reports if m.level == 1] == [str(k) for k in range(1, 11)]


def test_the_graph_ends_the_same_way(tmp_path: Path) -> None:
    """Breaks if the controller's node lets the failure pass, or reports another count than the engine."""
    from train_ato.graph.runner import run_graph

    setup = prepare(*load("demo", ("duration=30",), {"controller": "silent"}))
    outcome = run_graph(setup, tmp_path, way="composed")
    assert outcome.failure == LINE
    assert outcome.summary["held_steps"] == 10


def test_the_limit_is_a_key_of_the_scenario(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if hold_limit is not passed on, not checked, or a short silence is not reported on the screen."""
    run = ["run", "demo", "--controller", "silent", "--engine", "--set=duration=7", f"--out={tmp_path / 'run'}"]
    assert main([*run, "--set=hold_limit=5"]) == 0
    assert "in 20 steps the last command was repeated" in capsys.readouterr().out
    assert main([*run, "--set=hold_limit=0"]) == 2
    assert "hold_limit" in capsys.readouterr().err
