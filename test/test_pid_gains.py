"""Gains of the PID from the model of the train."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from law_trains import SINGLE, inputs, model

from train_ato.control.laws.pid import Pid
from train_ato.control.registry import LAWS
from train_ato.loop.engine import run_engine
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import load_scenario

METRO = """\
schema: train_ato/scenario/1
name: metro_pid
summary: planned metro run
tick: 0.1
step: 0.005
seed: 1
duration: 600
plant: {consist: xuzhou_metro_3, line: xuzhou_metro_test, lag: 0.4}
links: {command: {delay: 0.3}}
profile: {plan: {}}
law: pid
compensation: preview
"""
STOP_WINDOW = 0.15
"""Half of the stop window of platform doors of +-0.3 m [m]; the other half is for the error of the measurement."""


@pytest.fixture
def metro(tmp_path: Path) -> str:
    """Return the file of a metro scenario without gains."""
    path = tmp_path / "metro.yaml"
    path.write_text(METRO)
    return str(path)


def test_the_position_error_is_clamped_on_both_sides() -> None:
    """Breaks if a train far behind gets the force of one far ahead: 80 t x 0.001 1/s² x 20 m are 1.6 kN."""
    of = model(SINGLE)
    law = LAWS.make("pid", {"kp": 0.0, "ki": 0.001, "integral_limit": 20.0}, of, 0.1)
    level = law.step(inputs(of)).force[0]
    forces = [
        law.step(inputs(of, position=np.array([500.0 + e]))).force[0] - level for e in (-100.0, -20.0, 10.0, 99.0)
    ]
    assert forces == pytest.approx([of.inertia * 0.001 * e for e in (20.0, 20.0, -10.0, -20.0)])


def test_the_filter_of_the_speed_error_is_a_low_pass() -> None:
    """Breaks if the newest error has the weight of the old ones: 1 - exp(-0.1 s / 1 s) = 0.095."""
    of = model(SINGLE)
    law = LAWS.make("pid", {"kp": 0.05, "ki": 0.0, "filter_time": 1.0}, of, 0.1)
    level = law.step(inputs(of)).force[0]
    forces = [law.step(inputs(of, velocity=np.array([11.0]))).force[0] - level for _ in range(2)]
    assert forces == pytest.approx([-0.05 * of.inertia * (1.0 - math.exp(-0.1 * n)) for n in (1, 2)])


def test_gains_follow_the_rule(metro: str) -> None:
    """Breaks if a part of the dead time is missing: theta = 0.3 + 0.4 + 0.1 s, kp = 1/1.6, ki = kp/6.4."""
    model = prepare(*load_scenario(metro)).model
    assert Pid.model_gains(model, 0.1) == {"kp": pytest.approx(0.625), "ki": pytest.approx(0.625 / 6.4)}


def test_elastic_couplers_limit_the_gains() -> None:
    """Breaks if the dead time of 1.3 s alone decides: kp of 0.38 excites the wave in the couplers of 106 vehicles."""
    model = prepare(*load_scenario("daqin_heavy_haul")).model
    found = Pid.model_gains(model, 0.1)
    assert found["kp"] == pytest.approx(0.071, rel=0.05)
    assert found["ki"] == pytest.approx(found["kp"] ** 2 / 4)


def test_a_metro_stops_within_the_window(metro: str) -> None:
    """Breaks with the default gains: 0.44 m."""
    summary = run_engine(prepare(*load_scenario(metro, ("laws.pid.gains=model",)))).summary
    assert abs(summary["stop_error_m"]) < STOP_WINDOW
