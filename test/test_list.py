"""`train-ato list`: all names with one line each, and the details of one name."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from case_costs import sampled

from plant_sim.library import consist_path, line_path
from train_ato.cli import main
from train_ato.cli.list import catalogue
from train_ato.scenario.scenario import shipped_scenarios

NAMES = sorted({name for entries in catalogue().values() for name in entries})


def listed(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, dict[str, str]]:
    assert main(["list", "--json", *arguments]) == 0
    return dict(json.loads(capsys.readouterr().out))


def test_every_name_has_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a shipped name is missing or has no summary."""
    found = listed(capsys)
    assert list(found) == ["scenarios", "laws", "observers", "compensations", "consists", "lines", "expected"]
    assert all(summary and "\n" not in summary for entries in found.values() for summary in entries.values())
    assert main(["list"]) == 0
    table = capsys.readouterr().out
    assert re.search(r"crh380a_gpc:light +failed +train mass", table)
    assert [name for name in NAMES if name not in table] == []


@pytest.mark.parametrize("name", sampled(NAMES, every=3))
def test_every_listed_name_has_details(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a listed name is refused or has no summary."""
    for title, facts in listed(capsys, name).items():
        assert title.endswith(f" {name}")
        assert facts["summary"]


def test_figures_of_a_train_a_line_and_a_law(capsys: pytest.CaptureFixture[str]) -> None:
    """Values calculated by hand in test_plan_checks.py and test_plant_library.py; a parameter with unit and range."""
    train = listed(capsys, "hxd1_c80_105")["consist hxd1_c80_105"]
    assert train["balancing speed"].startswith("110 km/h at 0 per mille, 80 km/h at 2 per mille")
    assert train["steepest starting grade"] == "6.3 per mille"
    line = listed(capsys, "daqin_section")["line daqin_section"]
    assert line["grades"] == "-11.2 ... 2 per mille"
    assert line["extent"] == "from km 0 to km 52"
    assert listed(capsys, "pid")["law pid"]["filter_time"].startswith("0.0 s (0 ... 60): time constant")
    assert list(listed(capsys, "none")) == ["observer none", "compensation none"]
    assert listed(capsys, "daqin_heavy_haul:ideal")["scenario daqin_heavy_haul:ideal"]["compensation"] == "none"


def test_an_unknown_name_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "daqin_secton"]) == 2
    assert "unknown name 'daqin_secton'; did you mean 'daqin_section'?" in capsys.readouterr().err
    assert main(["list", "demo:nosuch"]) == 2
    assert "no variant 'nosuch'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("path", "name"),
    [
        (consist_path("hxd1_c80_105"), "hxd1_c80_105"),
        (line_path("daqin_section"), "daqin_section"),
        (shipped_scenarios()["crh380a_gpc"], "crh380a_gpc"),
    ],
)
def test_a_file_has_the_details_of_its_name(path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a file of a scenario, a consist or a line is refused, or shown differently from its name."""
    (file,) = listed(capsys, str(path)).values()
    (named,) = listed(capsys, name).values()
    assert {key: value for key, value in file.items() if not key.startswith(str(path))} == {
        key: value for key, value in named.items() if not key.startswith(f"{name}:")
    }


def test_a_file_of_another_kind_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a YAML file without a schema ends with a traceback."""
    for number, text in enumerate(("a: 1\n", "- 1\n", "schema: train_ato/other/1\n")):
        (tmp_path / f"{number}.yaml").write_text(text)
        assert main(["list", str(tmp_path / f"{number}.yaml")]) == 2
        assert "write one of train_ato/scenario/1, train_ato/consist/1, train_ato/line/1" in capsys.readouterr().err


def test_crh380a_gpc_runs_its_law(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the scenario of paper 004 runs another law by default, or without the preview that its law now uses."""
    facts = listed(capsys, "crh380a_gpc")["scenario crh380a_gpc"]
    assert (facts["law"], facts["compensation"]) == ("gpc", "preview")
