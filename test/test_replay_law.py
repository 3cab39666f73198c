"""Law on recorded inputs: both outputs as numbers, table and figure."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from engine_runs import record_run
from matplotlib.image import imread
from report_runs import without

from train_ato.apps.replay.open_loop import replay_open_loop
from train_ato.cli.main import main
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import load_scenario

SECONDS = 40


@pytest.fixture(scope="module")
def setup():
    return prepare(*load_scenario("demo", (f"duration={SECONDS}",)))


@pytest.fixture(scope="module")
def run(setup, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_run(setup, tmp_path_factory.mktemp("replay") / "run")


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
    changes = ("duration=40", "ato_requests=[{at: 20, do: disengage}]",
               "interventions=[{at: 32, do: emergency_brake}]")  # fmt: skip
    setup = prepare(*load_scenario("demo", changes))
    result = replay_open_loop(setup, record_run(setup, tmp_path / "run"))
    assert result.summary()["equal_ticks"] == setup.ticks
    assert (result.recorded[220:240] == 0.0).all()


def test_a_log_without_the_supervisor_is_replayed_as_driven(setup, run, tmp_path):
    """Breaks if the replay waits for messages that the log does not have, as that of a measured run."""
    cut = without(run, tmp_path / "cut", {"train/protection", "atp/speeds"})
    result = replay_open_loop(setup, cut)
    assert result.summary()["equal_ticks"] == setup.ticks


def test_another_gain_is_seen(run):
    changed = prepare(*load_scenario("demo", (f"duration={SECONDS}", "laws.pid={kp: 3.0e+5}")))
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
    for text in (
        "pid, recorded",
        "smc, replayed",
        "difference, rms in kN",
        "replay-smc.png",
        "Open loop",
    ):
        assert text in shown
    assert main(["replay", str(run), "--law", "pid", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["difference_max_kn"], summary["equal_ticks"]) == (0, SECONDS * 10)
    assert summary["figure"] == str(run / "replay-pid.png")
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


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--law", "pidd"), "did you mean 'pid'"),
        (("--law", "smc", "--set", "laws.smc.gain=1"), "gain"),
        (("--law", "smc", "--set", "tick=0.2"), "--set: train, sensors and tick of a recording"),
        (("--law", "smc", "--out", "figure.bmp"), "use .png, .svg, .pdf"),
        (("--law", "smc", "--out", "nowhere/figure.png"), ": no folder "),
        (("--law", "smc", "--out", __file__ + ".png/../../conftest.png"), ": no folder "),
        (("--law", "smc", "--rate", "2"), "--rate: no effect with --law"),
        (("--law", "smc", "--loop"), "--loop: no effect with --law"),
        (("--set", "seed=2"), "add --law NAME"),
        (("--out", "figure.png"), "add --law NAME"),
    ],
)
def test_bad_input_is_one_line(run, capsys, arguments, says):
    assert main(["replay", str(run), *arguments]) == 2
    captured = capsys.readouterr()
    assert says in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""


def test_an_existing_figure_is_not_overwritten_where_it_was_named(run, tmp_path, capsys):
    figure = tmp_path / "mine.png"
    figure.write_bytes(b"mine")
    assert main(["replay", str(run), "--law", "smc", "--out", str(figure)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert figure.read_bytes() == b"mine"


def test_a_log_without_a_scenario_is_refused(tmp_path, capsys):
    from test_replay_log import other

    assert main(["replay", str(other(tmp_path / "other.mcap")), "--law", "smc"]) == 2
    assert "no scenario.yaml is attached" in capsys.readouterr().err
