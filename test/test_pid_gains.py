"""Gains of the PID from the model of the train."""

from __future__ import annotations

from pathlib import Path

import pytest

from train_ato.control.laws.pid import Pid, PidParameters
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


def test_gains_follow_the_rule(metro: str) -> None:
    """Breaks if a part of the dead time is missing: theta = 0.3 + 0.4 + 0.1 s, kp = 1/1.6, ki = kp/6.4."""
    model = prepare(*load_scenario(metro)).model
    assert Pid.model_gains(model, 0.1) == {"kp": pytest.approx(0.625), "ki": pytest.approx(0.625 / 6.4)}


def test_elastic_couplers_limit_the_gains() -> None:
    """Breaks if the dead time of 1.3 s alone decides: kp of 0.38 excites the wave in the couplers of 106 vehicles."""
    model = prepare(*load_scenario("daqin_heavy_haul")).model
    defaults = PidParameters()
    assert Pid.model_gains(model, 0.1) == {"kp": defaults.kp, "ki": defaults.ki}


def test_a_metro_stops_within_the_window(metro: str) -> None:
    """Breaks with the default gains: 0.44 m."""
    summary = run_engine(prepare(*load_scenario(metro, ("laws.pid.gains=model",)))).summary
    assert abs(summary["stop_error_m"]) < STOP_WINDOW
