"""Verdicts of benchmarks: a narrow miss is reported and passes, a wide miss fails."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

BENCH = Path(__file__).resolve().parents[1] / "bench"
sys.path.insert(0, str(BENCH))
import figures  # noqa: E402


def loaded(path: Path, name: str) -> ModuleType:
    """Return the module of a script."""
    spec = importlib.util.spec_from_file_location(name, path)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


command = loaded(BENCH / "__main__.py", "bench_command")


@pytest.mark.parametrize(("value", "at_least", "verdict", "status"), [
    (100.0, False, "met", 0), (120.0, False, "missed", 0), (151.0, False, "missed widely", 1),
    (100.0, True, "met", 0), (70.0, True, "missed", 0), (66.0, True, "missed widely", 1),
])  # fmt: skip
def test_verdict_and_exit_status(value, at_least, verdict, status, capsys):
    """Breaks if an upper bound counts as a lower one, or a wide miss gives exit status 0."""
    goal = figures.Goal("something", value, 100.0, "us", at_least=at_least)
    assert figures.judge([figures.Goal("else", 1.0, 2.0), goal]) == status
    sign = "least" if at_least else "most"
    assert capsys.readouterr().out.splitlines()[1] == f"something: {value:.4g} us, goal at {sign} 100: {verdict}"


def test_figures_of_a_script_are_collected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a figure loses its floor, its ratio or its verdict on the way to the command."""
    file = tmp_path / "figures.jsonl"
    monkeypatch.setenv(figures.FILE, str(file))
    figures.judge([figures.Goal("a", 3.0, 4.0, "s", beside="floor", beside_value=1.5)], quiet=True)
    figures.publish(figures.Figure("lost", 1.0, bound=0.0), figures.Figure("plain", 2.0, "us"))
    a, lost, plain = map(json.loads, file.read_text().splitlines())
    assert (a["ratio"], a["verdict"], a["beside"]) == (2.0, "met", "floor")
    assert (lost["verdict"], lost["ratio"]) == ("missed widely", None) and plain["verdict"] == ""


@pytest.mark.parametrize("name", command.BENCHMARKS)
def test_every_benchmark_is_a_script_that_publishes(name: str) -> None:
    """Breaks if a row of the registry has no script, its script reports no figure, or needs a name that is gone."""
    path = BENCH / f"{name}.py"
    text = path.read_text(encoding="utf-8")
    assert "publish(" in text or "judge(" in text
    if name == "composed":
        pytest.importorskip("rclpy")
    loaded(path, f"bench_{name}")


@pytest.mark.parametrize("name", command.BENCHMARKS)
def test_every_benchmark_runs(name: str) -> None:
    """Breaks if a benchmark ends early, or has no figure; the figures themselves are those of a loaded machine."""
    if name == "composed":
        pytest.importorskip("rclpy")
    words = [sys.executable, "-m", "bench", "--only", name, "--quick", "--json"]
    ended = subprocess.run(words, cwd=BENCH.parent, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert {figure["benchmark"] for figure in json.loads(ended.stdout)["figures"]} == {name}


def test_a_missed_goal_has_exit_status_0_and_a_failed_script_1(tmp_path, monkeypatch, capfd):
    """Breaks if a missed goal fails the command or is not printed, or a failed script passes."""
    (tmp_path / "slow.py").write_text(
        f"import sys; sys.path.insert(0, {str(BENCH)!r})\n"
        "from figures import Goal, judge\nsys.exit(judge([Goal('time', 9.0, 1.0, 's')]))\n"
    )
    (tmp_path / "broken.py").write_text("raise RuntimeError('no')\n")
    monkeypatch.setattr(command, "HERE", tmp_path)
    monkeypatch.setattr(command, "BENCHMARKS", {"slow": (), "broken": ()})
    assert command.main(["--only", "slow"]) == 0
    assert "time: 9 s, goal at most 1: missed widely" in capfd.readouterr().out
    assert command.main(["--json"]) == 1
    out, err = capfd.readouterr()
    found = json.loads(out)
    assert (found["failed"], [figure["what"] for figure in found["figures"]]) == (["broken"], ["time"])
    assert "RuntimeError: no" in err and command.main(["--only", "none"]) == 2
