"""Plan of a law: in the log once a second in every mode of a run, with the same texts, and on the live page."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from engine_runs import record_run
from span_runs import Both, setup_of

from plant_sim.units import KMH
from train_ato.apps.view.facts import PLAN_LASTS, plan_columns, plan_words
from train_ato.apps.view.recorded import RecordedFeed
from train_ato.control.contract import LawInput, LawOutput, LawPlan, parameter
from train_ato.control.plan_text import STATUS, TimedPlan, plan_from_text, plan_to_text
from train_ato.log.recorded import open_recording
from train_ato.loop.engine import run_engine

HERE = "test_law_plan"
FREE = {"supervision.enabled": False}
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


def test_a_plan_is_read_as_it_was_written() -> None:
    """Breaks if a key, a digit of a number or the time of the measurement is lost."""
    found = plan_from_text(plan_to_text(TimedPlan(100.0, PLAN)))
    assert found is not None
    for entry in dataclasses.fields(LawPlan):
        value = getattr(PLAN, entry.name)
        assert np.all(getattr(found.plan, entry.name) == (value + 100.0 if entry.name == "times" else value))
    assert plan_to_text(TimedPlan(0.0, PLAN), held=True)[STATUS] == "held"


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
    case = "demo", {**FREE, "duration": 30, "law": f"{HERE}:Planner", **changes}
    both = Both(setup_of(*case))
    both.assert_equal(least=0.0 if "control_period" in changes else 0.4)
    status = both.recording.diagnostics["controller"].texts(STATUS)
    assert status[0] is None
    assert len({text for text in status if text is not None}) > 20


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
    assert set(plans[STATUS]) == {"solved"}
    assert plans == _plans(graph)
    recording = open_recording(run)
    reference = recording.topics["ato/reference"]
    row = next(k for k, time in enumerate(recording.diagnostics["controller"].time) if time == 3.0)
    found = plan_from_text({key: texts[row] for key, texts in plans.items()})
    assert found is not None
    assert found.plan.times[0] == pytest.approx(4.2)
    near = found.plan.times < 5.9
    expected = np.interp(found.plan.times[near], reference.time, reference["velocity"][:, 0])
    assert np.abs(found.plan.speed[near] - expected).max() < 0.05
    feed = RecordedFeed(run)
    feed.seek(3.05)
    assert feed.frame is not None
    assert feed.frame.now["law"] == ["mpc, plan solved"]
    shown = plan_columns(feed.frame.moment.plan, 3.05, feed.facts)
    assert shown["place"] == pytest.approx((found.plan.position + feed.facts.nose) / 1e3)
    assert shown["speed"] == pytest.approx(KMH * found.plan.speed)


def test_an_old_plan_is_not_shown() -> None:
    """Breaks if the plan of a law that does not drive any more stays on the page."""
    last = float(PLAN.times[0]) + PLAN_LASTS
    assert plan_words(PLAN, last - 0.1) == "plan iterations, 1.8 km/h above the limit"
    assert plan_words(PLAN, last + 0.1) == plan_words(None, 0.0) == ""


def test_a_law_without_a_plan_has_none_in_its_log() -> None:
    """Breaks if the logs of all laws change."""
    recording = run_engine(setup_of("demo", {**FREE, "duration": 5})).recording
    assert recording is not None
    assert not [key for key in recording.diagnostics["controller"].values if key.startswith("plan.")]
    assert math.isfinite(recording.diagnostics["controller"].time[-1])
