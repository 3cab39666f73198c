"""Replay of a law against a recording, and the clock of a replay."""

import json
import math
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from engine_runs import record_run, setup_of
from matplotlib.image import imread
from report_runs import without

from train_ato.cli import main
from train_ato.playback.open_loop import replay_open_loop
from train_ato.playback.playback import ReplayClock
from train_ato.playback.replaying import output_names

SECONDS = 40


@pytest.fixture(scope="module")
def setup():
    return setup_of("demo", f"duration={SECONDS}")


@pytest.fixture(scope="module")
def run(demo_run) -> Path:
    return demo_run(f"duration={SECONDS}")


def test_the_recorded_law_gives_the_recorded_outputs_bit_by_bit(setup, run):
    """Fails if the controller depends on more than its inputs: a clock, a global, the plant."""
    result = replay_open_loop(setup, run)
    assert result.stamp.tolist() == [k * setup.tick_ns for k in range(setup.ticks)]
    assert np.array_equal(result.recorded, result.replayed)
    assert np.array_equal(result.recorded_pipe, result.replayed_pipe)
    assert result.recorded_pipe.size == setup.ticks
    assert result.summary()["equal_ticks"] == setup.ticks


def test_the_outputs_of_a_disengaged_ato_are_equal_too(tmp_path):
    """Breaks if the states of the ATO, a takeover or a request are not repeated on the recorded inputs."""
    disengage, brake = "ato_requests=[{at: 20, do: disengage}]", "interventions=[{at: 32, do: emergency_brake}]"
    setup = setup_of("demo", "duration=40", disengage, brake)
    result = replay_open_loop(setup, record_run(setup, tmp_path / "run"))
    assert result.summary()["equal_ticks"] == setup.ticks
    assert (result.recorded[220:240] == 0.0).all()


def test_a_log_without_the_supervisor_is_replayed_as_driven(setup, run, tmp_path):
    """Breaks if the replay waits for messages that the log does not have, as that of a measured run."""
    cut = without(run, tmp_path / "cut", {"train/protection", "atp/speeds"})
    assert replay_open_loop(setup, cut).summary()["equal_ticks"] == setup.ticks


def test_another_gain_is_seen(run):
    changed = setup_of("demo", f"duration={SECONDS}", "laws.pid={kp: 3.0e+5}")
    result = replay_open_loop(changed, run)
    summary = result.summary()
    assert summary["difference_max_kn"] > 0.01
    assert 0 < summary["difference_rms_kn"] <= summary["difference_max_kn"]
    worst = int(np.abs(result.difference).max(axis=1).argmax())
    assert summary["difference_max_at_s"] == pytest.approx(result.stamp[worst] * 1e-9)
    assert summary["replayed"]["force_max_kn"] == pytest.approx(result.replayed.sum(axis=1).max() / 1e3)


def test_the_command_shows_both_outputs_and_draws_them(run, capsys):
    """The figure is written beside the log; with another law its content differs."""
    assert main(["replay", str(run), "--law", "smc"]) == 0
    shown = capsys.readouterr().out
    for text in ("pid, recorded", "smc, replayed", "difference, rms in kN", "replay-smc.png", "Open loop"):
        assert text in shown
    assert main(["replay", str(run), "--law", "pid", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["difference_max_kn"], summary["equal_ticks"]) == (0, SECONDS * 10)
    assert summary["figure"] == str(run / "replay-pid.png")
    setup = setup_of("demo", f"duration={SECONDS}")
    swap = {"controller": "pid", "changes": [{"at_s": 614.0, "name": "controller", "value": "smc"}]}
    assert output_names(setup, swap, "mpc") == ("pid → smc at 614 s, recorded", "mpc, replayed")
    figures = [imread(run / f"replay-{name}.png") for name in ("smc", "pid")]
    assert all(figure.shape[0] > 500 and figure.std() > 0.05 for figure in figures)
    assert not np.array_equal(*figures)


def test_a_log_alone_is_enough(run, tmp_path, capsys):
    """The scenario is an attachment of the log."""
    shutil.copy(run / "run.mcap", tmp_path / "alone.mcap")
    figure = tmp_path / "both.svg"
    arguments = ["replay", str(tmp_path / "alone.mcap"), "--law", "smc", "--out", str(figure), "--json"]
    assert main(arguments) == 0
    alone = json.loads(capsys.readouterr().out)
    assert figure.read_text().startswith("<?xml")
    assert main(["replay", str(run), "--law", "smc", "--json"]) == 0
    beside = json.loads(capsys.readouterr().out)
    for key in ("run", "figure"):
        assert alone.pop(key) != beside.pop(key)
    assert alone == beside


def test_a_log_without_a_scenario_is_refused(tmp_path, capsys):
    from test_replay_log import other

    assert main(["replay", str(other(tmp_path / "other.mcap")), "--law", "smc"]) == 2
    assert "no scenario.yaml is attached" in capsys.readouterr().err


@pytest.fixture
def wall() -> SimpleNamespace:
    """Give a wall clock that the test sets."""
    return SimpleNamespace(now=1000.0)


def test_time_flows_by_the_rate_and_a_change_of_it_does_not_jump(wall):
    clock = ReplayClock(2.0, paused=False, steady=lambda: wall.now)
    wall.now += 3
    assert clock.now == 6
    assert clock.until(10) == 2
    clock.set_rate(0.5)
    assert clock.now == 6
    assert clock.until(10) == 8
    wall.now += 8
    assert (clock.now, clock.until(10), clock.until(9)) == (10, 0, 0)


def test_time_stands_in_a_pause_and_goes_on_from_there(wall):
    clock = ReplayClock(1.0, paused=False, steady=lambda: wall.now)
    wall.now += 5
    clock.set_paused(True)
    wall.now += 100
    assert (clock.now, clock.until(5)) == (5, math.inf)
    clock.reached(7)
    assert clock.now == 7
    clock.set_rate(10)
    clock.set_paused(False)
    assert clock.until(8) == pytest.approx(0.1)


def test_a_jump_with_a_delay(wall):
    """The delay is in wall time, at any rate; a pause does not change it."""
    for rate in (4.0, math.inf):
        clock = ReplayClock(rate, paused=False, steady=lambda: wall.now)
        clock.jump(20, delay=3)
        wall.now += 1
        assert (clock.now, clock.until(20)) == (20, 2)
        clock.set_paused(True)
        clock.set_paused(False)
        wall.now += 2
        assert clock.until(20) == 0


def test_as_fast_as_possible_time_follows_the_messages(wall):
    clock = ReplayClock(math.inf, paused=False, steady=lambda: wall.now)
    wall.now += 50
    assert (clock.now, clock.until(1e9)) == (0, 0)
    clock.reached(12)
    assert clock.now == 12
    clock.set_rate(1.0)
    wall.now += 1
    assert clock.now == 13


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_rate_that_is_none_is_refused(wall, rate):
    clock = ReplayClock(1.0, paused=False, steady=lambda: wall.now)
    with pytest.raises(ValueError, match="above 0"):
        clock.set_rate(rate)
    assert clock.rate == 1.0
