"""The driver's run that the heavy-haul reference is made from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from train_ato.cli import main
from train_ato.profile.driver import average_speed
from train_ato.scenario.scenario import shipped_scenarios

SHIPPED = shipped_scenarios()["daqin_heavy_haul"]


@pytest.mark.campaign
def test_shipped_profile_is_what_the_command_makes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if plant, line or driver change and the shipped reference or its brake events do not."""
    out = tmp_path / "driver.csv"
    arguments = ["driver", "daqin_section", "hxd1_c80_105", "--until-km", "45", "--out", str(out), "--json"]
    assert main(arguments) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["events"] == yaml.safe_load(SHIPPED.read_text())["brake"]["events"]
    made, shipped = (
        np.loadtxt(path, delimiter=",", comments=("#", "time")) for path in (out, SHIPPED.parent / "daqin_driver.csv")
    )
    np.testing.assert_allclose(made, shipped, rtol=0, atol=1e-5)


def test_reference_keeps_the_limits_of_the_line() -> None:
    """At most 79.3 km/h of 80, four applications, from rest to 45 km."""
    profile = np.loadtxt(SHIPPED.parent / "daqin_driver.csv", delimiter=",", comments=("#", "time"))
    events = yaml.safe_load(SHIPPED.read_text())["brake"]["events"]
    assert 70 < 3.6 * profile[:, 2].max() < 79.3
    assert profile[0, 2] == 0
    assert profile[-1, 1] == pytest.approx(45_000, abs=50)
    assert [event["reduction_kpa"] for event in events] == [50, 0] * 4
    assert np.diff([event["time"] for event in events[::2]]).min() >= 160


def test_average_keeps_a_ramp_and_spreads_a_step_over_three_windows() -> None:
    """Breaks if the average shifts in time or is taken once instead of three times."""
    ramp = np.arange(300) * 0.1
    np.testing.assert_allclose(average_speed(ramp, 0.1, 5.0)[80:-80], ramp[80:-80], atol=1e-9)
    step = np.where(np.arange(400) < 200, 0.0, 1.0)
    smooth = average_speed(step, 0.1, 5.0)
    moving = np.flatnonzero((smooth > 1e-9) & (smooth < 1 - 1e-9))
    assert 140 <= moving.size <= 153
    assert smooth[199] + smooth[200] == pytest.approx(1.0, abs=1e-9)


def test_a_train_without_an_air_brake_is_driven(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the driver needs an air brake, or names brake events of a train without one."""
    out = tmp_path / "metro.csv"
    assert main(["driver", "xuzhou_metro_test", "xuzhou_metro_3", "--until-km", "1", f"--out={out}"]) == 0
    assert "brake" not in capsys.readouterr().out
    made = np.loadtxt(out, delimiter=",", comments=("#", "time"))
    assert made[0, 2] == 0 and made[-1, 1] == pytest.approx(1000, abs=20)
    assert 3.6 * made[:, 2].max() < 75
