"""`train-ato list`: all names with one line each, and the details of one name."""

from __future__ import annotations

import json

import pytest

from train_ato.cli import main
from train_ato.cli.list import catalogue

NAMES = sorted({name for entries in catalogue().values() for name in entries})


def listed(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, dict[str, str]]:
    assert main(["list", "--json", *arguments]) == 0
    return dict(json.loads(capsys.readouterr().out))


def test_every_name_has_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a shipped name is missing or has no summary."""
    found = listed(capsys)
    assert list(found) == ["scenarios", "laws", "observers", "compensations", "consists", "lines"]
    assert all(summary and "\n" not in summary for entries in found.values() for summary in entries.values())
    assert main(["list"]) == 0
    table = capsys.readouterr().out
    assert [name for name in NAMES if name not in table] == []


@pytest.mark.parametrize("name", NAMES)
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
