"""Learned resistance by place: estimate, convergence over runs, use by every law, files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from span_runs import Both, messages_of, setup_of

import train_ato as ta
from train_ato.api.drive import drive
from train_ato.cli import main
from train_ato.control.learned_resistance import LearnedResistance, learned_text, read_learned
from train_ato.control.train_model import LineForceTable
from train_ato.scenario.setup import RunSetup
from train_ato.studies.learn import RunAverage, residual_of, smoothed_resistance

METRO = "xuzhou_metro:disturbed"
STACKS: dict[str, dict[str, Any]] = {
    "pid": {"law": "pid", "compensation": "preview"},
    "eso": {"law": "pid", "compensation": "predictor", "observer": "eso"},
    "mpc": {"law": "mpc", "compensation": "none"},
}


def true_resistance(setup: RunSetup, places: Any) -> Any:
    """Return the line force of the plant per inertial mass [m/s²]; the nominal line is level."""
    table = LineForceTable(setup.consist, setup.line, over_length=True)
    return np.interp(places, table.begin + np.arange(table.total.size), table.total) / setup.model.inertia


@pytest.fixture(scope="module")
def learned() -> LearnedResistance:
    """Return a learned resistance of made-up waves."""
    setup, found = setup_of(METRO, {}), ta.learn(METRO, runs=1, set={"duration": 20}, progress=False).learned
    waves = tuple((0.1 * np.sin(np.arange(0.0, 8500.0, 5.0) / 80.0)).round(6).tolist())
    fits = {"line": setup.line.name, "train": setup.model.consist.name, "runs": 2, "begin": 0.0, "resistance": waves}
    return found.model_copy(update=fits)


def test_estimate_is_the_unknown_line_force_at_its_place() -> None:
    """Breaks if the estimate has a delay: 0.3 s and the lag of 0.4 s move the grades by 15 m at 22 m/s."""
    run = ta.run(METRO, set={"duration": 150, "plant.disturbances": []}, progress=False)
    places, resistance = residual_of(run.recording, run.setup.model)
    errors = {shift: np.std(resistance - true_resistance(run.setup, places - shift)) for shift in range(-20, 21, 2)}
    assert abs(min(errors, key=errors.__getitem__)) <= 2
    assert errors[0] < 0.12 * np.std(true_resistance(run.setup, places))


def test_smoothed_and_averaged_resistance() -> None:
    """Breaks if the smoother runs forward only (a sine of 20 s is late), or a gust of one of three runs is learned."""
    t = np.arange(2001) * 0.05
    wave = 0.1 * np.sin(2.0 * np.pi * t / 20.0)
    speed = 20.0 + np.concatenate(([0.0], np.cumsum(-0.05 * 0.5 * (wave[1:] + wave[:-1]))))
    noisy = speed + 0.01 * np.random.default_rng(1).standard_normal(speed.size)
    found = smoothed_resistance(noisy, np.zeros(2000), np.diff(t))
    late = [np.std(found[40:-40] - np.interp(t[:-1] + 0.025 - shift, t, wave)[40:-40]) for shift in (-0.5, 0.0, 0.5)]
    assert late[1] < 0.012 and late[1] < 0.7 * min(late[0], late[2])
    profile = setup_of(METRO, {}).profile
    average = RunAverage(profile)
    places = np.arange(0.0, float(profile.position[-1]), 1.0)
    for gust in (0.0, 0.3, 0.0):
        force = np.where((places > 1000.0) & (places < 1500.0), gust, 0.0) + 0.1
        average.add(average.estimate((places, force)))
    begin, found = average.mean()
    assert begin == 0.0 and found == pytest.approx([0.1] * len(found))


@pytest.mark.parametrize("stack", STACKS)
def test_error_converges_in_five_runs(stack: str) -> None:
    """Breaks if the learned resistance has the wrong sign, place or scale, or is not used by the law."""
    found = ta.learn(METRO, runs=5, set={"duration": 140}, progress=False, **STACKS[stack])
    errors = [metrics["speed_rmse_kmh"] for metrics in found.metrics]
    assert errors[5] < 0.35 * errors[0] and max(errors[2:]) < 1.05 * errors[1]
    assert found.learned.runs == 5 and not found.unused


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("scenario", "duration", "bound"),
    [(METRO, 70, 0.35), ("xuzhou_metro:mismatch", 70, 0.95), ("demo", 250, 1.05)],
    ids=["grades", "gain of the actuators", "waves in the couplers"],
)
def test_error_does_not_diverge_in_a_hundred_runs(scenario: str, duration: float, bound: float) -> None:
    """Breaks if errors of the model of actuators or couplers add up from run to run."""
    # Without the waves in the noise of the speed the error of demo doubles in three runs.
    found = ta.learn(scenario, runs=100, set={"duration": duration}, progress=False, **STACKS["pid"])
    errors = [metrics["speed_rmse_kmh"] for metrics in found.metrics]
    assert max(errors[1:]) < bound * errors[0]
    assert np.mean(errors[81:]) < 1.02 * np.mean(errors[6:26])


@pytest.mark.parametrize("stack", ["pid", "eso"])
def test_compiled_ticks_have_the_learned_resistance(stack: str, learned: LearnedResistance) -> None:
    """Breaks if the compiled ticks lack the learned part of line force or vehicle resistance."""
    changes = {"duration": 60, "model.learned": learned.model_dump(by_alias=True)}
    names = {key: STACKS[stack].get(key, "none") for key in ("law", "compensation", "observer")}
    both = Both(setup_of(METRO, {**changes, **names}))
    both.assert_equal(least=0.8)
    without = messages_of(setup_of(METRO, {"duration": 60, **names}), compiled=True)
    assert [row for row in without if row[0] == "ato/command"] != [
        row for row in both.compiled if row[0] == "ato/command"
    ]


def test_several_units_have_the_learned_force_at_the_front(tmp_path: Path) -> None:
    """Breaks if a unit behind the front has the learned resistance of its own place, or compiled ticks differ."""
    base = {"duration": 30, "law": "funnel", "observer": "ndo", "compensation": "none"}
    run = ta.learn("freight_consensus:realistic", runs=1, set=base, progress=False)
    waves = tuple((0.02 * np.sin(np.arange(len(run.learned.resistance)) / 6.0)).tolist())
    learned = run.learned.model_copy(update={"resistance": waves})
    setup = setup_of("freight_consensus:realistic", {**base, "model.learned": learned.model_dump(by_alias=True)})
    Both(setup).assert_equal()
    model, bare = setup.model, setup.model.without_learned
    front = float(learned.places[20])
    position, speed = front - model.offsets, np.full(model.n_units, 10.0)
    more = model.own_resistance(speed, position) - bare.own_resistance(speed, position)
    assert more.sum() == pytest.approx(model.line_force(front) - bare.line_force(front), rel=1e-9)
    assert abs(more).min() > 0.0


def test_twin_has_the_learned_force() -> None:
    """Breaks if the twin lacks the learned force, or has it twice: its own train must not have it."""
    base = {"duration": 10, "compensation": "twin", "laws.pid.kp": 0.0, "laws.pid.ki": 0.0}
    plain = ta.run("demo", set=base, progress=False)
    found = ta.learn("demo", runs=1, set={**base, "duration": 60}, progress=False).learned
    flat = found.model_copy(update={"resistance": (0.01,) * 100, "begin": -500.0, "spacing": 50.0})
    other = ta.run("demo", set={**base, "model.learned": flat.model_dump(by_alias=True)}, progress=False)
    first = np.flatnonzero(plain.recording.command.any(axis=1))[0]
    more = (other.recording.command - plain.recording.command)[first].sum()
    assert more == pytest.approx(0.01 * plain.setup.model.inertia, rel=1e-6)


def test_nodes_have_the_learned_resistance(learned: LearnedResistance, tmp_path: Path) -> None:
    """Breaks if the nodes of a graph, or a repeated run folder, lack the learned resistance."""
    file = tmp_path / "learned.yaml"
    file.write_text(learned_text(learned), encoding="utf-8")
    changes = {"duration": 5, "model.learned": str(file)}
    engine = ta.run(METRO, set=changes, progress=False, out=tmp_path / "engine")
    graph = ta.run(METRO, set=changes, mode="composed", progress=False, out=tmp_path / "graph")
    assert engine.recording.command.tobytes() == graph.recording.command.tobytes()
    file.unlink()
    assert main(["verify", str(tmp_path / "engine")]) == 0
    again = ta.run(tmp_path / "engine" / "scenario.yaml", progress=False)
    assert again.recording.command.tobytes() == engine.recording.command.tobytes()


def test_recorded_runs_give_the_same_as_repeated_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a log gives another estimate than the memory, or a file loses values."""
    short = {"duration": 25}
    result = ta.learn(METRO, runs=1, set=short, progress=False)
    file = result.save(tmp_path / "first.yaml")
    assert read_learned(file) == result.learned
    ta.run(METRO, set=short, out=tmp_path / "a", progress=False)
    ta.run(METRO, set={**short, "seed": 2, "model.learned": str(file)}, out=tmp_path / "b", progress=False)
    assert main(["learn", str(tmp_path / "a"), str(tmp_path / "b"), f"--out={tmp_path / 'both.yaml'}"]) == 0
    assert "2 runs; written to" in capsys.readouterr().out
    repeated = ta.learn(METRO, runs=2, set=short, progress=False).learned
    assert read_learned(tmp_path / "both.yaml").resistance == repeated.resistance
    more = ta.learn(METRO, runs=1, set={**short, "seed": 2, "model.learned": str(file)}, progress=False).learned
    assert more.runs == 2 and more.resistance == pytest.approx(repeated.resistance, abs=2e-6)


@pytest.mark.parametrize(
    ("scenario", "key"),
    [("xuzhou_metro", "line"), ("xuzhou_metro:disturbed+lighter", "train"), ("xuzhou_metro:disturbed+other", "model")],
)
def test_foreign_line_train_and_model_are_refused(scenario, key, learned, tmp_path, capsys):
    """Breaks if a resistance of another line or train drives this one."""
    file = tmp_path / "learned.yaml"
    file.write_text(learned_text(learned), encoding="utf-8")
    name, _, variant = scenario.partition("+")
    more = {"": [], "lighter": ["--set=model.consist=crh380a_one_mass"], "other": ["--set=model.line=daqin_section"]}
    options = [f"--set=model.learned={file}", *more[variant], f"--out={tmp_path / 'run'}", "--engine"]
    assert main(["run", name, *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"model.learned: {file}: {key}: learned" in line and "learn again" in line
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"resistance": [0.0, 0.7]}, "0.7 m/s² is beyond +-0.5"),
        ({"resistance": [0.0, "x"]}, "resistance = [0.0, 'x']"),
        ({"spacing": 0}, "spacing = 0"),
        ({"schema": "train_ato/profile/1"}, "make the file with `train-ato learn`"),
        ({"speed": 1}, "unknown key"),
    ],
)
def test_bad_files_are_refused_in_one_line(change, words, learned, tmp_path, capsys):
    """Breaks if a wrong value reaches the force of the train."""
    file = tmp_path / "learned.yaml"
    file.write_text(yaml.safe_dump({**learned.model_dump(by_alias=True, mode="json"), **change}), encoding="utf-8")
    assert main(["run", METRO, "--engine", f"--set=model.learned={file}", f"--out={tmp_path / 'run'}"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert str(file) in line and words in line


@pytest.mark.usefixtures("without_figure")
def test_runs_with_brake_interventions_are_not_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the force of the supervisor's brake, which is not measured, is learned as a grade."""
    run = ta.run(METRO, set={"duration": 20}, out=tmp_path / "run", progress=False)
    summary = (run.path / "summary.json").read_text(encoding="utf-8")
    assert '"brake_interventions": 0' in summary
    (run.path / "summary.json").write_text(
        summary.replace('"brake_interventions": 0', '"brake_interventions": 1'), encoding="utf-8"
    )
    assert main(["learn", str(run.path), f"--out={tmp_path / 'learned.yaml'}"]) == 2
    assert "the supervisor has braked 1 times" in capsys.readouterr().err


def test_ctrl_c_keeps_the_finished_runs(tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if Ctrl-C loses the result of the finished runs, or an interrupted first run writes a file."""
    begun: list[int] = []

    def interrupted(*arguments: Any, **options: Any) -> Any:
        begun.append(1)
        if len(begun) in (3, 4):
            raise KeyboardInterrupt
        return drive(*arguments, **options)

    monkeypatch.setattr("train_ato.studies.learn.drive", interrupted)
    for name, message in (("some", "has the result of 2 runs"), ("none", "nothing is learned")):
        file = tmp_path / f"{name}.yaml"
        assert main(["learn", METRO, "--runs", "5", "--set", "duration=20", "--out", str(file)]) == 1
        assert message in capsys.readouterr().err
    assert read_learned(tmp_path / "some.yaml").runs == 2 and not (tmp_path / "none.yaml").exists()
