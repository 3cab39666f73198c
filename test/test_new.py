"""Files of one's own: ``train-ato new`` and the templates of ``examples/metro``."""

from pathlib import Path

import pytest

import train_ato as ta
from train_ato.cli.main import main
from train_ato.cli.new import CODE_KINDS


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write and read in a folder of the test, from which own modules are found too."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.parametrize(
    ("files", "arguments"),
    [
        (["train a"], "plan level a.yaml --to-km 3 --no-bound"),
        (["line b"], "plan b.yaml xuzhou_metro_3 --no-bound"),
        (["scenario c", "journey d"], "plan line.yaml train.yaml --journey d.yaml --no-bound"),
        (["train e --like xuzhou_metro_3", "line f --like level"], "plan f.yaml e.yaml --to-km 3 --no-bound"),
    ],
)
def test_a_new_file_is_planned(files: list[str], arguments: str) -> None:
    for new in files:
        assert main(["new", *new.split()]) == 0
    assert main(arguments.split()) == 0


@pytest.mark.parametrize("law", ["pid", "smc"])
def test_a_new_scenario_stops_within_a_tenth_of_a_metre(law: str) -> None:
    """Breaks if the example of an own metro misses a stop, or a criterion, with default gains."""
    assert main(["new", "scenario", "mine"]) == 0
    run = ta.run("mine.yaml", law=law, progress=False)
    assert run.metrics["verdict"] == "passed", run.metrics["criteria"]
    errors = [stop["beyond_m"] for stop in run.metrics["stops"]]
    assert len(errors) == 4 and max(map(abs, errors)) < 0.1


def test_a_scenario_like_a_shipped_one_has_its_profile() -> None:
    """Breaks if the file of a driver's profile is not copied beside the scenario that names it."""
    assert main(["new", "scenario", "mine", "--like", "daqin_heavy_haul"]) == 0
    assert Path("daqin_driver.csv").is_file() and ta.scenario("mine.yaml").name == "mine"


@pytest.mark.parametrize("kind", CODE_KINDS)
@pytest.mark.parametrize("like", [False, True])
def test_new_code_drives(kind: str, like: bool, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a template is not renamed, or a shipped law, observer or compensation does not run as a copy."""
    first = {"law": "pid", "observer": "eso", "compensation": "preview"}[kind]
    assert main(["new", kind, f"{'copied' if like else 'own'}_{kind}", *(["--like", first] if like else [])]) == 0
    (target,) = [word for word in capsys.readouterr().out.split() if ":" in word and word != "next:"]
    run = ta.run("demo", set={"duration": 20}, progress=False, **{kind: target})
    assert run.metrics["tracking"] == "tracked"
