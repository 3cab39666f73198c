"""Engine: failures, signals and rate; runs that keep their summary only."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pytest
from recordings import message_counts
from span_runs import setup_of
from waiting import LIMIT_S, wait_for

from train_ato.apps.sweep.row import WALL_TIMES
from train_ato.cli import main
from train_ato.control.contract import LawInput, LawOutput
from train_ato.control.registry import LAWS
from train_ato.loop.engine import TickLoop, run_engine


@dataclass(frozen=True)
class NoParameters:
    """No parameters."""


class Breaks:
    """User-defined law that raises in the middle of the run."""

    Parameters: ClassVar[type] = NoParameters

    def __init__(self, parameters: object, model: object, period: float) -> None:
        self.steps = 0

    def reset(self) -> None:
        self.steps = 0

    def step(self, inputs: LawInput) -> LawOutput:
        self.steps += 1
        if self.steps > 50:
            raise KeyError("boom")
        return LawOutput(inputs.feedforward)


def test_a_law_that_raises_fails_the_run_by_name(tmp_path, monkeypatch, capsys):
    """Breaks if a foreign exception becomes a traceback, or recorded data are lost."""
    monkeypatch.setitem(LAWS._loaded, "breaks", Breaks)
    out = tmp_path / "run"
    assert main(["run", "demo", "--engine", "--law", "breaks", "--set=duration=20", f"--out={out}"]) == 1
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith("train-ato: node controller failed: law breaks: KeyError: 'boom', ")
    assert message_counts(out)["/ato/command"] == 61, "10 steps are held, the next one finds the train at standstill"
    assert json.loads((out / "summary.json").read_text())["status"] == "failed"
    assert (out / "scenario.yaml").is_file()
    assert "boom" in (out / "log" / "controller.traceback.txt").read_text()


def test_a_broken_package_of_somebody_else_harms_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if one law that cannot be loaded makes the list, or a run with another law, impossible."""
    monkeypatch.setitem(LAWS._targets, "gone", "no_such_package:Law")
    assert "gone" in LAWS.names()
    assert "gone" not in LAWS.loadable()
    assert main(["list", "--json"]) == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_a_run_with_a_readable_log(number: signal.Signals, tmp_path: Path) -> None:
    """Breaks if the engine dies in the middle of a tick, or leaves run.mcap.partial."""
    out = tmp_path / "run"
    command = [sys.executable, "-m", "train_ato", "run", "demo", "--engine", "--rate", "20", "--out", str(out)]
    child = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env={**os.environ})
    wait_for(lambda: (out / "run.mcap.partial").exists() or child.poll() is not None)
    child.send_signal(number)
    _, errors = child.communicate(timeout=LIMIT_S)
    assert child.returncode == 1
    assert "; recorded data:" in errors.strip().splitlines()[-1]
    counts = message_counts(out)
    assert counts.get("/ato/command", 0) == counts.get("/train/measurement", 0)
    assert not (out / "run.mcap.partial").exists()
    assert main(["info", str(out), "--json"]) == 0


def test_the_rate_limits_the_engine(tmp_path: Path) -> None:
    """Breaks if the engine refuses a rate, or runs ahead of the wall clock."""
    out = tmp_path / "run"
    assert main(["run", "demo", "--engine", "--rate", "4", "--set", "duration=2", "--out", str(out)]) == 0
    assert json.loads((out / "summary.json").read_text())["wall_s"] > 0.45


FREE = {"supervision.enabled": False}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "supervised, air brake by time": (
        "daqin_heavy_haul",
        {"duration": 120, "brake.events": [{"time": 60, "reduction_kpa": 50}]},
    ),
    "overspeed and intervention": (
        "daqin_heavy_haul",
        {"duration": 150, "plant.mismatch.mass_scale": 0.6, "law": "pid", "laws.pid": {"kp": 0.6, "ki": 0.05}},
    ),
    "disturbances": (
        "daqin_heavy_haul", {"duration": 60, "plant.disturbances": [{"kind": "eq40"}], "observer": "eso"}
    ),
    "three units, no supervisor": ("crh380a_gpc:short", {**FREE, "duration": 60, "law": "funnel"}),
    "to the stop": ("xuzhou_metro", {"law": "pid"}),
    "law in Python": ("daqin_heavy_haul", {"duration": 60, "law": "gpc"}),
    "requirements": (
        "daqin_heavy_haul",
        {"duration": 110, "brake.events": [{"time": 60, "reduction_kpa": 50}],
         "criteria.requirements": {"pipe": "G (pipe_pressure_tail >= 540 kPa)", "draft": "G (coupler_draft <= 900 kN)"},
        },
    ),
}  # fmt: skip
NO_PLACE = {"at_s": None, "km": None}


def of_simulation(summary: dict[str, Any]) -> str:
    """Return a summary without wall times and places of coupler forces as text; NaN is equal to NaN."""
    criteria = [{**row, **(NO_PLACE if "coupler" in row["criterion"] else {})} for row in summary["criteria"]]
    return repr({**{key: value for key, value in summary.items() if key not in WALL_TIMES}, "criteria": criteria})


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("case", CASES)
def test_a_summary_without_recording_is_that_of_the_run(case: str, compiled: bool) -> None:
    """Breaks if a series that a metric, the outcome of tracking or a requirement reads is left out."""
    whole, brief = (
        run_engine(setup_of(*CASES[case]), compiled=compiled, summary_only=chosen) for chosen in (False, True)
    )
    assert whole.recording is not None and brief.recording is None
    assert of_simulation(whole.summary) == of_simulation(brief.summary)
    for exact, alone in zip(whole.summary["criteria"], brief.summary["criteria"], strict=True):
        assert alone["at_s"] in (exact["at_s"], None)  # unknown, but never another time


@pytest.mark.parametrize("case", ["supervised, air brake by time", "three units, no supervisor"])
def test_a_failed_run_has_the_same_totals(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the last diagnostics of the plant before a failure lack the totals: they are the metrics of the run."""
    name, changes = CASES[case]
    changed = {**changes, "law_changes": [{"at": 50, "law": "smc"}]}

    def fail(*_: Any) -> None:
        raise ArithmeticError("planned failure")

    monkeypatch.setattr("train_ato.control.laws.smc.Smc.step", fail)
    whole, brief = (run_engine(setup_of(name, changed), compiled=True, summary_only=chosen) for chosen in (False, True))
    assert whole.summary["energy_traction_kwh"] > 0.0
    assert of_simulation(whole.summary) == of_simulation(brief.summary)


def test_compiled_ticks_leave_out_what_no_summary_needs() -> None:
    """Breaks if pressures of the brake pipe, shoe forces or all vehicles are recorded for a summary."""
    setup = setup_of(*CASES["supervised, air brake by time"])
    loop = TickLoop(setup, None, compiled=True, summary_only=True)
    loop.start()
    while not loop.plant.finished:
        loop.advance()
    assert loop._spans is not None and loop._spans.ticks > 0.5 * loop.ticks
    assert {topic: set(samples.values) for topic, samples in loop.recording.finish().topics.items()} == {
        "train/vehicles": {
            "front_position",
            "front_velocity",
            "rear_position",
            "unit_position",
            "unit_velocity",
            "coupler_draft_max",
            "coupler_buff_max",
        },
        "train/measurement": set(),
        "ato/reference": {"position", "velocity", "acceleration"},
        "ato/command": {"force"},
        "ato/state": {"state"},
    }
