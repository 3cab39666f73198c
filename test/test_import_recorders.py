"""Files of recorders as they are: units in headers, dates, unsorted rows, all faults of a file at once."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from import_files import TRAIN, metro, recorded, take, text_of

from train_ato.apps.import_csv.dates import date_and_time
from train_ato.apps.import_csv.headers import column_name, is_units_row
from train_ato.cli.main import main

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ("measured_rows", "simulated_s", "distance_m", "speed_max_kmh", "energy_traction_kwh")


def figures(result: dict) -> dict:
    return {key: result[key] for key in FIGURES}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> str:
    return recorded()


@pytest.mark.parametrize(
    ("title", "name"),
    [
        ("V [km/h]", "speed_kmh"),
        ("v (m/s)", "speed_m_s"),
        ("Speed in mph", "speed_mph"),
        ("Geschwindigkeit [km/h]", "speed_kmh"),
        ("F [kN]", "force_kn"),
        ("Tractive effort [kN]", "traction_force_kn"),
        ("s [km]", "position_km"),
        ("t [s]", "time_s"),
        ("t [sec]", "time_s"),
        ("HLL [bar]", "brake_pipe_pressure_bar"),
        ("v_ref [km/h]", "reference_speed_kmh"),
        ("Front position [m]", "front_position_m"),
        ("Date", "timestamp"),
        ("Door", "Door"),
        ("V [kN]", "V [kN]"),
        ("V", "V"),
        ("speed_kmh", "speed_kmh"),
    ],
)
def test_titles_of_recorders(title: str, name: str) -> None:
    """Breaks if a quantity with its unit is not found, or a unit of another quantity is accepted."""
    assert column_name(title) == name


def test_units_in_the_header_change_no_number(plain: str, tmp_path: Path, capsys) -> None:
    """Breaks if a unit in brackets or in a row of units is lost, or converted with another factor."""
    titles = {"time_s": "t [s]", "speed_kmh": "V [km/h]", "position_m": "s [m]", "force_kn": "F (kN)"}
    head, _, body = plain.partition("\n")
    bracketed = ",".join(titles[name] for name in head.split(","))
    expected = figures(take(tmp_path, capsys, plain, "--out", str(tmp_path / "a")))
    for number, text in enumerate((f"{bracketed}\n{body}", f"Time,Speed,Position,Force\ns,[km/h],m,kN\n{body}")):
        out = str(tmp_path / f"b{number}")
        assert figures(take(tmp_path, capsys, text, "--out", out)) == expected


def test_a_row_of_units_is_no_row_of_numbers() -> None:
    """Breaks if numbers or other words are taken for units."""
    assert is_units_row(["s", "km/h", ""]) and is_units_row(["[s]", "(m/s)", "-"])
    assert not is_units_row(["0", "1", "2"]) and not is_units_row(["", ""]) and not is_units_row(["s", "door"])


@pytest.mark.parametrize(
    ("text", "iso"),
    [
        ("01.03.2026 08:15:30", "2026-03-01T08:15:30+00:00"),
        ("1.3.2026 8:15", "2026-03-01T08:15:00+00:00"),
        ("01.03.2026 08:15:30,5", "2026-03-01T08:15:30.500000+00:00"),
        ("01.03.2026, 08:15:30.25", "2026-03-01T08:15:30.250000+00:00"),
        ("2026-03-01T08:15:30.5", "2026-03-01T08:15:30.500000+00:00"),
        ("2026-03-01 08:15:30,123456789", "2026-03-01T08:15:30.123456+00:00"),
        ("2026-03-01T08:15:30.5Z", "2026-03-01T08:15:30.500000+00:00"),
        ("2026-03-01T08:15:30.5+01:00", "2026-03-01T08:15:30.500000+01:00"),
    ],
)
def test_dates(text: str, iso: str) -> None:
    """Breaks if day and month are exchanged, or the fraction is lost."""
    assert date_and_time(text).isoformat() == iso


@pytest.mark.parametrize("text", ["03/01/2026 08:15:30", "32.03.2026 08:15", "01.13.2026 08:15", "soon"])
def test_an_ambiguous_or_impossible_date_is_refused(text: str) -> None:
    """Breaks if a month is guessed, or a day that does not exist is accepted."""
    with pytest.raises(ValueError):
        date_and_time(text)


def test_rows_out_of_order(plain: str, tmp_path: Path, capsys) -> None:
    """Breaks if rows are sorted without ``--sort``, or sorting changes a number or hides its note."""
    head, *rows = plain.splitlines()
    mixed = "\n".join([head, *rows[:100], *rows[150:], *rows[100:150], rows[20], ""])
    (tmp_path / "mixed.csv").write_text(mixed)
    assert main(["import", str(tmp_path / "mixed.csv"), *TRAIN, "--out", str(tmp_path / "no")]) == 2
    assert "s before the row above; sort the rows by time, or give --sort (and 1 more rows)" in capsys.readouterr().err
    expected = figures(take(tmp_path, capsys, plain, "--out", str(tmp_path / "a")))
    found = take(tmp_path, capsys, mixed, "--sort", "--out", str(tmp_path / "b"))
    assert figures(found) == expected
    assert re.fullmatch(r"\d+ rows sorted by time, 1 repeated rows removed", found["measured_notes"])
    contradiction = f"{mixed}{rows[20].replace(rows[20].split(',')[1], '99', 1)}\n"
    (tmp_path / "two.csv").write_text(contradiction)
    assert main(["import", str(tmp_path / "two.csv"), *TRAIN, "--sort", "--out", str(tmp_path / "c")]) == 2
    assert "the same time as the row above; remove one row" in capsys.readouterr().err


def test_all_faults_are_named_at_once(tmp_path: Path, capsys) -> None:
    """Breaks if a fault hides another one, or rows of one fault fill the screen."""
    time = np.arange(0.0, 60.0, 1.0)
    speed, position, force = metro(time)
    columns = {"time_s": time, "speed_kmh": 3.6 * speed, "position_m": position, "force_kn": force / 1e3}
    lines = text_of(columns).splitlines()
    lines[0] = "time_s,speed_kmh,positon_m,force_kn"
    lines[10] = "9.0,fast,1,1"
    lines[11] = "10.0,faster,1,1"
    lines[20] = "19.0,1,1"
    lines[30] = "29.0,1,1,strong"
    (tmp_path / "bad.csv").write_text("\n".join(lines) + "\n")
    assert main(["import", str(tmp_path / "bad.csv"), *TRAIN, "--out", str(tmp_path / "run")]) == 2
    shown = capsys.readouterr()
    found = [line.removeprefix(f"train-ato: {tmp_path / 'bad.csv'}: ") for line in shown.err.splitlines()]
    assert [line.partition(";")[0] for line in found] == [
        "line 1, unknown column 'positon_m'",
        "line 21: 3 values for 4 columns",
        "line 11, speed_kmh: 'fast' is not a number (and 1 more of this kind)",
        "line 31, force_kn: 'strong' is not a number",
    ]
    assert not (tmp_path / "run").exists() and shown.out == ""


def test_faults_of_several_quantities_are_named_at_once(tmp_path: Path, capsys) -> None:
    """Breaks if the check of one quantity hides the fault of another one."""
    head = {"position_m": "reference_speed_kmh", "force_kn": "traction_force_kn"}
    text = recorded().splitlines()
    text[0] = ",".join(head.get(name, name) for name in text[0].split(","))
    text[40] = "7.8,-20.0,-3.0,0.0"
    (tmp_path / "bad.csv").write_text("\n".join(text) + "\n")
    assert main(["import", str(tmp_path / "bad.csv"), *TRAIN, "--out", str(tmp_path / "run")]) == 2
    found = capsys.readouterr().err.splitlines()
    assert [line.partition("bad.csv: ")[2].partition(" is ")[0] for line in found][:1] == ["line 41, speed_kmh: -20"]
    assert "reference_speed_kmh: " in found[1] and "traction_force_kn: " in found[2] and len(found) == 3


def test_the_sample_file_is_imported_by_the_command_in_it(tmp_path: Path, monkeypatch, capsys) -> None:
    """Breaks if the shipped file, its command or the line of the README no longer fit."""
    sample = ROOT / "examples" / "recorder.csv"
    (command,) = [line[2:] for line in sample.read_text().splitlines() if line.startswith("# train-ato import")]
    assert command in (ROOT / "README.md").read_text()
    monkeypatch.chdir(ROOT)
    assert main([*shlex.split(command)[1:], "--out", str(tmp_path / "run")]) == 0
    assert "recorded in" in capsys.readouterr().out
    assert main(["report", str(tmp_path / "run")]) == 0
