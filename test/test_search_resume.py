"""Searches whose next run depends on the former ones: after a kill the same command goes on where they were."""

import fcntl
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from test_falsify import CHEAP

from train_ato.api.series_folder import RUNS, KeptRuns, SearchFolder
from train_ato.cli.main import main
from train_ato.studies import learn
from train_ato.studies.falsify import study
from train_ato.studies.tune import gain_space


class Killed(BaseException):
    """End of a process in the middle of a run."""


class Search(NamedTuple):
    """Command with the place of its runs, the files of its result, and an option that makes it another search."""

    words: tuple[str, ...]
    module: Any
    run: str
    files: tuple[str, ...]
    other: tuple[str, ...]
    kept: str = ""


SEARCHES = {
    "tune": Search(
        ("--law", "pid", "--parameters", "kp", "--runs", "12", "--held-out-seeds", "5"),
        gain_space, "run_engine", ("tuned.yaml", "table.csv", "history.csv", "tune.json"), ("--search-seed", "2"),
    ),
    "falsify": Search(
        ("--requirement", "G speed < 1000 km/h", "--over", "over.yaml", "--runs", "5"),
        study, "run_engine", ("runs.csv", "falsify.json"), ("--seed", "2"),
    ),
    "learn": Search(("--runs", "4"), learn, "drive", ("",), ("--spacing", "7"), ".runs"),
}  # fmt: skip


@pytest.mark.parametrize("command", SEARCHES)
def test_a_killed_search_goes_on(command, tmp_path, monkeypatch, capsys):
    """Breaks if finished runs are run again, the result is another one, or the results of another search are used."""
    monkeypatch.chdir(tmp_path)
    Path("cheap.yaml").write_text(json.dumps(CHEAP))
    Path("over.yaml").write_text("over: {plant.mismatch.mass_scale: {from: 0.9, to: 1.3}}\n")
    search = SEARCHES[command]
    run: Callable[..., Any] = getattr(search.module, search.run)
    calls, last = 0, 10_000

    def counted(*arguments: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > last:
            raise Killed
        return run(*arguments, **options)

    monkeypatch.setattr(search.module, search.run, counted)

    def words(out: str, *more: str) -> list[str]:
        return [command, "cheap.yaml", *search.words, "--out", out, *more]

    assert main(words("whole.yaml")) == 0
    needed, calls, last = calls, 0, 3
    with pytest.raises(Killed):
        main(words("cut.yaml"))
    kept = Path(f"cut.yaml{search.kept}")
    with (kept / RUNS).open("a") as file:
        file.write('{"run": 4, "inp')  # the line that the killed process was writing
    assert main(words("cut.yaml", *search.other)) == 2
    assert "cut.yaml" in (said := capsys.readouterr().err) and "cannot be continued: the specification" in said
    with (kept / RUNS).open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert main(words("cut.yaml")) == 2
    assert "another search writes into it" in capsys.readouterr().err
    calls, last = 0, 10_000
    assert main(words("cut.yaml")) == 0
    assert calls == needed - 3
    for name in search.files:
        assert Path("cut.yaml", name).read_text() == Path("whole.yaml", name).read_text()
    assert not search.kept or not kept.exists()


def test_a_finished_search_goes_on_with_more_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the budget is part of the search: its runs would be lost when it was too small."""
    monkeypatch.chdir(tmp_path)
    Path("cheap.yaml").write_text(json.dumps(CHEAP))
    words = ["tune", "cheap.yaml", "--law", "pid", "--parameters", "kp", "--out"]
    assert main([*words, "more", "--runs", "6"]) == main([*words, "more", "--runs", "12"]) == 0
    assert main([*words, "once", "--runs", "12"]) == 0
    assert Path("more/history.csv").read_text() == Path("once/history.csv").read_text()


def test_results_are_found_by_their_input(tmp_path: Path) -> None:
    """Breaks if values that are no finite numbers, or equal in a few digits, are taken for others."""
    with SearchFolder(tmp_path).kept("falsify", {}, "") as kept:
        kept.add({"a": 0.1 + 0.2, "b": "nan"}, [float("nan"), ""])
        kept.add((1, None), {"value": float("inf")})
    with SearchFolder(tmp_path).kept("falsify", {}, "") as kept:
        assert isinstance(kept, KeptRuns) and len(kept) == 2
        assert str(kept.find({"a": 0.30000000000000004, "b": "nan"})) == "[nan, '']"
        assert kept.find({"a": 0.3, "b": "nan"}) is None
        assert kept.find([1, None]) == {"value": float("inf")}
