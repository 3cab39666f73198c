"""Engine: failures, signals, rate and runs with their summary only; plan of a law in log and page."""

import dataclasses
import json
import math
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from engine_runs import record_run
from programs import begun
from recordings import message_counts
from span_runs import Both, setup_of
from waiting import LIMIT_S, wait_for

from plant_sim.units import KMH
from train_ato.cli import main
from train_ato.control.contract import LawInput, LawOutput, LawPlan, parameter
from train_ato.control.plan_text import STATUS, TimedPlan, plan_from_text, plan_to_text
from train_ato.control.registry import LAWS
from train_ato.judge.recording_builder import reduced
from train_ato.log.recorded import open_recording
from train_ato.loop.engine import TickLoop, run_engine
from train_ato.studies.sweep.row import WALL_TIMES
from train_ato.view.facts import PLAN_LASTS, plan_columns, plan_words
from train_ato.view.recorded import RecordedFeed

pytestmark = pytest.mark.usefixtures("without_figure")


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


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_plant_that_diverges_fails_a_run_without_a_log():
    """Breaks if such a run returns metrics that are not numbers, as its only word."""
    failure = run_engine(setup_of("demo", {"plant.mismatch.mass_scale": 0.001, "duration": 20})).failure
    said = "the position of the train is not finite; shorten step, or mend masses and draft gears"
    assert failure == f"node plant failed: {said}"


def test_a_broken_package_of_somebody_else_harms_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if one law that cannot be loaded makes the list, or a run with another law, impossible."""
    monkeypatch.setitem(LAWS._targets, "gone", "no_such_package:Law")
    assert "gone" in LAWS.names() and "gone" not in LAWS.loadable()
    assert main(["list", "--json"]) == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_a_run_with_a_readable_log(number: signal.Signals, tmp_path: Path) -> None:
    """Breaks if the engine dies in the middle of a tick, or leaves run.mcap.partial."""
    out = tmp_path / "run"
    child = begun("run", "demo", "--engine", "--rate=20", f"--out={out}")
    wait_for(lambda: (out / "run.mcap.partial").exists() or child.poll() is not None)
    child.send_signal(number)
    _, errors = child.communicate(timeout=LIMIT_S)
    assert child.returncode == 1 and "; recorded data:" in errors.strip().splitlines()[-1]
    counts = message_counts(out)
    assert counts.get("/ato/command", 0) == counts.get("/train/measurement", 0)
    assert not (out / "run.mcap.partial").exists() and main(["info", str(out), "--json"]) == 0


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
    assert loop._spans.ticks > 0.5 * loop.ticks
    assert {topic: set(samples.values) for topic, samples in loop.recording.finish().topics.items()} == {
        "train/vehicles": {
            "front_position", "front_velocity", "rear_position", "unit_position", "unit_velocity", "coupler_draft_max",
            "coupler_buff_max",
        },
        "train/measurement": set(),
        "ato/reference": {"position", "velocity", "acceleration"},
        "ato/command": {"force"},
        "ato/state": {"state"},
    }  # fmt: skip


def test_the_samples_of_a_recording_by_the_number_of_vehicles() -> None:
    """Breaks if the extremes of a coupler, the samples of four vehicles, or a total of some units is left out."""
    forces = np.array([[5.0, -7.0, 2.0, 4.0], [1.0, 3.0, -9.0, 0.0]])
    coupler = {"coupler_draft_max": [[5.0], [3.0]], "coupler_buff_max": [[-7.0], [-9.0]]}
    expected = {1: {}, 2: {"coupler_draft_max": [[5.0], [3.0]], "coupler_buff_max": [[-7.0], [1.0]]},
                4: {**coupler, "coupler_samples": [[5.0, -7.0, 2.0], [1.0, 3.0, -9.0]]}}  # fmt: skip
    for count, values in expected.items():
        kept = reduced("train/vehicles", {"coupler_force": forces[:, :count]}, [0])
        assert {name: part.tolist() for name, part in kept.items()} == values
    assert "coupler_samples" not in reduced("train/vehicles", {"coupler_force": forces[:, :3]}, [0])
    kept = reduced("train/disturbance", {"force": forces}, [0, 2])
    assert kept["total"].tolist() == [[4.0], [-5.0]] and kept["unit_force"].tolist() == [[5.0, 2.0], [1.0, -9.0]]
    assert set(reduced("train/disturbance", {"force": forces[:, :2]}, [0, 1])) == {"unit_force"}


HERE = "test_engine"
MPC = {**FREE, "duration": 6, "law": "mpc", "compensation": "none"}


@dataclasses.dataclass
class Planner:
    """Feed-forward, with a plan from a time on; every second step without one if so chosen."""

    begin: float = parameter(2.5, "s", 0.0, 100.0, "time of the first plan")
    often: bool = parameter(True, "", 0, 1, "a plan at every step")

    def reset(self) -> None:
        self.steps = 0

    def bind(self, model, period) -> None:
        self.period = period

    def step(self, inputs: LawInput) -> LawOutput:
        self.steps += 1
        if inputs.t < self.begin or (not self.often and self.steps % 2):
            return LawOutput(inputs.feedforward)
        times = np.array([1.0, 2.0])
        position, speed = inputs.reference_position[0] + times, inputs.reference_velocity[0] + 0.0 * times
        force = np.full(2, inputs.feedforward.sum())
        return LawOutput(
            inputs.feedforward, plan=LawPlan(times, position, speed, force, np.zeros(2), f"step {self.steps}")
        )


PLAN = LawPlan(
    np.array([1.0, 2.5]), np.array([10.0, 40.0]), np.array([20.0, 20.5]), np.array([-1e5, 1.25e5]),
    np.array([0.0, 0.5]), "iterations",
)  # fmt: skip


def test_a_plan_is_read_as_it_was_written_and_shown_while_it_lasts() -> None:
    """Breaks if a key, digit or time of a plan is lost, an old one stays on the page, or all laws have one."""
    found = plan_from_text(plan_to_text(TimedPlan(100.0, PLAN)))
    for entry in dataclasses.fields(LawPlan):
        value = getattr(PLAN, entry.name)
        assert np.all(getattr(found.plan, entry.name) == (value + 100.0 if entry.name == "times" else value))
    assert plan_to_text(TimedPlan(0.0, PLAN), held=True)[STATUS] == "held"
    last = float(PLAN.times[0]) + PLAN_LASTS
    assert plan_words(PLAN, last - 0.1) == "plan iterations, 1.8 km/h above the limit"
    assert plan_words(PLAN, last + 0.1) == plan_words(None, 0.0) == ""
    recording = run_engine(setup_of("demo", {**FREE, "duration": 5})).recording
    assert not [key for key in recording.diagnostics["controller"].values if key.startswith("plan.")]
    assert math.isfinite(recording.diagnostics["controller"].time[-1])


@pytest.mark.parametrize(
    "spoilt", [{"plan.speed": "1 x"}, {"plan.speed": "1"}, {"plan.speed": "1 nan"}, {STATUS: None}]
)
def test_an_invalid_plan_is_not_read(spoilt) -> None:
    """Breaks if a plan of a user's law with another form reaches the page as a traceback."""
    assert plan_from_text({**plan_to_text(TimedPlan(0.0, PLAN)), **spoilt}) is None


@pytest.mark.parametrize("changes", [
    {}, {f"laws.{HERE}:Planner.often": False}, {"control_period": 0.2},
], ids=["every step", "every second step", "slow control"])  # fmt: skip
def test_a_plan_in_compiled_ticks_is_that_of_python(changes) -> None:
    """Breaks if a report of a compiled span has the plan of another tick, or none."""
    both = Both(setup_of("demo", {**FREE, "duration": 30, "law": f"{HERE}:Planner", **changes}))
    both.assert_equal(least=0.0 if "control_period" in changes else 0.4)
    status = both.recording.diagnostics["controller"].texts(STATUS)
    assert status[0] is None and len({text for text in status if text is not None}) > 20


def _plans(run):
    """Return the texts of the plans in the log of a run, by key."""
    series = open_recording(run).diagnostics["controller"]
    return {key: series.texts(key) for key in plan_to_text(TimedPlan(0.0, PLAN))}


def test_engine_and_graph_record_the_same_plan(tmp_path) -> None:
    """Breaks if a mode of a run loses the plan, or it has other bits there."""
    pytest.importorskip("rclpy")
    from train_ato.ros.graph.runner import run_graph

    setup = setup_of("crh380a_gpc:short", MPC)
    run = record_run(setup, tmp_path / "engine")
    (graph := tmp_path / "graph").mkdir()
    assert run_graph(setup, graph, mode="composed").failure is None
    plans = _plans(run)
    assert set(plans[STATUS]) == {"solved"} and plans == _plans(graph)
    recording = open_recording(run)
    reference = recording.topics["ato/reference"]
    row = next(k for k, time in enumerate(recording.diagnostics["controller"].time) if time == 3.0)
    found = plan_from_text({key: texts[row] for key, texts in plans.items()})
    assert found.plan.times[0] == pytest.approx(4.2)
    near = found.plan.times < 5.9
    expected = np.interp(found.plan.times[near], reference.time, reference["velocity"][:, 0])
    assert np.abs(found.plan.speed[near] - expected).max() < 0.05
    feed = RecordedFeed(run)
    feed.seek(3.05)
    assert feed.frame is not None and feed.frame.now["law"] == ["mpc, plan solved"]
    shown = plan_columns(feed.frame.moment.plan, 3.05, feed.facts)
    assert shown["place"] == pytest.approx((found.plan.position + feed.facts.nose) / 1e3)
    assert shown["speed"] == pytest.approx(KMH * found.plan.speed)
