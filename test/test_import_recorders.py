"""Files of recorders as they are: units in headers, dates, unsorted rows, all faults of a file at once."""

import json
import re
import shlex
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from import_files import TRAIN, metro, recorded, refused, take, text_of

from plant_sim.library import load_consist
from plant_sim.traction import Envelope
from train_ato.api.import_csv.columns import layout_names
from train_ato.api.import_csv.layout import load_layout
from train_ato.api.import_csv.run import series_of
from train_ato.api.import_csv.table import column_name, is_units_row, moments
from train_ato.api.importing import read_recorder
from train_ato.cli.main import main

pytestmark = pytest.mark.usefixtures("without_figure")

ROOT = Path(__file__).resolve().parents[1]


def figures(result: dict) -> dict:
    keys = ("measured_rows", "simulated_s", "distance_m", "speed_max_kmh", "energy_traction_kwh")
    return {key: result[key] for key in keys}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> str:
    return recorded()


@pytest.mark.parametrize(("title", "name"), [
    ("V [km/h]", "speed_kmh"), ("v (m/s)", "speed_m_s"), ("Speed in mph", "speed_mph"),
    ("Geschwindigkeit [km/h]", "speed_kmh"), ("F [kN]", "force_kn"), ("Tractive effort [kN]", "traction_force_kn"),
    ("s [km]", "position_km"), ("t [s]", "time_s"), ("t [sec]", "time_s"), ("HLL [bar]", "brake_pipe_pressure_bar"),
    ("v_ref [km/h]", "reference_speed_kmh"), ("Front position [m]", "front_position_m"), ("Date", "timestamp"),
    ("Door", "Door"), ("V [kN]", "V [kN]"), ("V", "V"), ("speed_kmh", "speed_kmh"),
])  # fmt: skip
def test_titles_of_recorders(title: str, name: str) -> None:
    """Breaks if a quantity with its unit is not found, or a unit of another quantity is accepted."""
    assert column_name(title) == name


def test_units_in_the_header_change_no_number(plain: str, tmp_path: Path, capsys) -> None:
    """Breaks if a unit in brackets or in a row of units is lost, contradicted in silence, or converted wrongly."""
    titles = {"time_s": "t [s]", "speed_kmh": "V [km/h]", "position_m": "s [m]", "force_kn": "F (kN)"}
    head, _, body = plain.partition("\n")
    message = refused(tmp_path, capsys, f"{head}\ns,m/s,m,kN\n{body}")
    assert message.endswith("line 1, speed_kmh: the row of units below has 'm/s'; correct one of them\n")
    bracketed = ",".join(titles[name] for name in head.split(","))
    expected = figures(take(tmp_path, capsys, plain, "--out", str(tmp_path / "a")))
    rows = (f"{bracketed}\n", "Time,Speed,Position,Force\ns,[km/h],m,kN\n", f"{head}\ns,km/h,m,kN\n")
    for number, text in enumerate(f"{row}{body}" for row in rows):
        out = str(tmp_path / f"b{number}")
        assert figures(take(tmp_path, capsys, text, "--out", out)) == expected
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
    zero = "2026-01-01T00:00:00"
    found, begin = moments([text, zero])
    assert begin is not None
    wanted = datetime.fromisoformat(iso) - datetime.fromisoformat(f"{zero}+00:00")
    assert found - begin == pytest.approx(wanted.total_seconds(), abs=1e-6)


@pytest.mark.parametrize("text", ["32.03.2026 08:15", "01.13.2026 08:15", "soon", "13/13/2026 08:15", "13:00 PM"])
def test_an_impossible_date_is_refused(text: str) -> None:
    """Breaks if a day that does not exist is accepted."""
    assert moments([text]) == [None]


@pytest.mark.parametrize(("texts", "seconds"), [
    (["11:59:58 AM", "12:00:02 PM", "1:00:00 PM"], [4, 3602]),
    (["11:59:58 PM", "12:00:02 AM", "12:30:00 a.m."], [4, 1802]), (["23:59:59", "0:00:01,5", "00:01"], [2.5, 61]),
    (["11/24/2026 23:59:59", "11/25/2026 00:00:01"], [2]), (["24/11/2026 23:59:59", "25/11/2026 00:00:01"], [2]),
    (["03/01/2026 23:59:59", "03/02/2026 00:00:01"], [2]), (["03/01/2026 23:59:59", "04/01/2026 00:00:01"], [2]),
    (["1727799360", "1727799362"], [2]), (["1727799360000", "1727799361500"], [1.5]),
    (["1727799360000000", "1727799361500000"], [1.5]), (["1727799360000000000", "1727799361500000000"], [1.5]),
    (["2026/11/24 23:59:59", "2026/11/25 0:00:01"], [2]), (["24-11-2026 23:59:59", "25-11-2026 00:00:01"], [2]),
    (["11-24-2026 23:59:59", "11-25-2026 00:00:01"], [2]),
    (["2026-10-25 02:59:59+02:00", "2026-10-25 02:00:01+01:00"], [2]),
])  # fmt: skip
def test_times_of_recorders(texts: list[str], seconds: list[float]) -> None:
    """Breaks if noon, midnight, the order of day and month, or the unit of a Unix time is wrong."""
    found = [value for value in moments(texts) if value is not None]
    assert [value - found[0] for value in found[1:]] == pytest.approx(seconds)


def metro_rows(**columns: Callable[[float, float, float, float], str]) -> list[list[str]]:
    """Return a header and rows of columns made of time, speed, position and force [SI]."""
    time = np.arange(0.0, 120.5, 1.0)
    rows = zip(time, *metro(time), strict=True)
    return [list(columns), *([make(*row) for make in columns.values()] for row in rows)]


CLOCK = "{:02d}:{:02d}:{:02d}"


def metro_text(**columns: Callable[[float, float, float, float], str]) -> str:
    return "".join(",".join(row) + "\n" for row in metro_rows(**columns))


def clock(t: float) -> str:
    """Return the time of day of a run that passes midnight."""
    second = (86_340 + int(t)) % 86_400
    return CLOCK.format(second // 3600, second // 60 % 60, second % 60)


SPEED = {"speed_kmh": lambda t, v, x, f: f"{3.6 * v:.4f}"}
PLACE = {"position_m": lambda t, v, x, f: f"{x:.3f}"}
FORCE = {"force_kn": lambda t, v, x, f: f"{f / 1e3:.3f}"}
TIME = {"time_s": lambda t, v, x, f: f"{t:.1f}"}
LAYOUTS: dict[str, tuple[dict[str, Any], str, str]] = {
    "clock": ({"time": lambda t, v, x, f: clock(t)} | SPEED | PLACE | FORCE, ",", ""),
    "date and clock": (
        {"Date": lambda t, v, x, f: "11/24/2026" if t < 60 else "11/25/2026", "Time": lambda t, v, x, f: clock(t)}
        | SPEED | PLACE | FORCE, ";", "",
    ),
    "unix": ({"timestamp": lambda t, v, x, f: f"{1727799360000 + 1000 * t:.0f}"} | SPEED | PLACE | FORCE, ",", ""),
    "sep": (TIME | SPEED | PLACE | FORCE, "|", "sep=|\n"),
    "km plus m": (
        TIME | SPEED | {"position_km": lambda t, v, x, f: f"{int(x // 1000)}+{x % 1000:07.3f}"} | FORCE, ";", "",
    ),
    "us": (
        TIME | {"Speed [mph]": lambda t, v, x, f: f"{v / 0.44704:.4f}"}
        | {"Milepost [mi]": lambda t, v, x, f: f"{x / 1609.344:.6f}"}
        | {"F [klbf]": lambda t, v, x, f: f"{f / 4448.22:.5f}"}, ",", "",
    ),
    "feet": (
        TIME | SPEED | {"position_ft": lambda t, v, x, f: f"{x / 0.3048:.3f}"}
        | {"force_lbf": lambda t, v, x, f: f"{f / 4.44822:.2f}"}, ",", "",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", [*LAYOUTS, "quoted"])
def test_layouts_of_recorders_are_the_same_run(name: str, tmp_path: Path, capsys) -> None:
    """Breaks if a layout is refused, or a unit, a time of day or a decimal comma changes the run."""
    columns, separator, first = LAYOUTS.get(name, (TIME | SPEED | PLACE | FORCE, ",", ""))
    rows = metro_rows(**columns)
    if name == "quoted":
        rows = [[f'"{cell.replace(".", ",")}"' for cell in row] for row in rows]
    text = first + "".join(separator.join(row) + "\n" for row in rows)
    found = take(tmp_path, capsys, text, "--profile-only", "--out", str(tmp_path / "p.csv"))
    assert found["simulated_s"] == pytest.approx(120)
    assert found["distance_m"] == pytest.approx(metro(120.0)[1] - metro(0.0)[1], abs=0.5)
    assert found["speed_max_kmh"] == pytest.approx(54, abs=0.3)
    if name in ("us", "feet"):
        coarse = np.arange(0.0, 120.5, 1.0)
        v, f = (np.interp(np.arange(0.0, 120.05, 0.1), coarse, metro(coarse)[k]) for k in (0, 2))
        power = np.maximum(v * f, 0.0)
        work = 0.1 * float((power[1:] + power[:-1]).sum()) / 2
        whole = take(tmp_path, capsys, text, "--out", str(tmp_path / "whole"))
        assert whole["energy_traction_kwh"] == pytest.approx(work / 3.6e6, rel=1e-3)


def test_falling_kilometres_run_on_the_reversed_line(tmp_path: Path, capsys) -> None:
    """Breaks if falling positions are refused without a remedy that works, or are not mirrored with the line."""
    line = tmp_path / "line.yaml"
    line.write_text("{schema: train_ato/line/1, name: l, begin_km: 80, end_km: 90}")
    falling = TIME | SPEED | {"position_km": lambda t, v, x, f: f"{88 - x / 1000:.5f}"} | FORCE
    text = metro_text(**falling)
    (tmp_path / "down.csv").write_text(text)
    train = ["--consist", "xuzhou_metro_3", "--line", str(line)]
    assert main(["import", str(tmp_path / "down.csv"), *train, "--out", str(tmp_path / "a")]) == 2
    assert "positions fall, from 87.5 to" in (err := capsys.readouterr().err) and "--line LINE:reverse" in err
    train[-1] += ":reverse"
    found = take(tmp_path, capsys, text, "--out", str(tmp_path / "b"), train=train)
    assert found["distance_m"] == pytest.approx(metro(120.0)[1] - metro(0.0)[1], abs=0.5)
    assert "falling kilometres, mirrored" in found["measured_notes"]
    first = float((tmp_path / "b" / "profile.csv").read_text().splitlines()[3].split(",")[1])
    assert first == pytest.approx(170e3 - 87.5e3, abs=20), "begin + end of the line less the position"


def test_kilometres_of_posts_are_places_on_a_line_with_chainage(tmp_path: Path) -> None:
    """Breaks if kilometres that fall and jump are refused, or read as distances."""
    line = tmp_path / "line.yaml"
    sections = "[{begin: 84500, end: 83200}, {begin: 83250, end: 77000}]"
    line.write_text(f"{{schema: train_ato/line/1, name: l, end: 7550, chainage: {sections}}}")
    time = np.arange(0.0, 120.5, 1.0)
    v, x, f = metro(time)
    post = np.where(x < 1300, 84500 - x, 83250 - (x - 1300))
    rows = {"time_s": time, "speed_kmh": 3.6 * v, "position_m": post, "force_kn": f / 1e3}
    (tmp_path / "posts.csv").write_text(text_of(rows))
    found = read_recorder(tmp_path / "posts.csv", train="xuzhou_metro_3", line=line).found
    assert x.max() > 1400
    np.testing.assert_allclose(found.position.values, x, atol=1e-6)
    assert "position_m: kilometres of the posts of line 'l'" in found.notes
    with pytest.raises(
        ValueError, match=r"against the direction of line 'l:reverse', from 84\+000 to .*without :reverse"
    ):
        read_recorder(tmp_path / "posts.csv", train="xuzhou_metro_3", line=f"{line}:reverse")
    start = {"from_km": "83+000", "ignore": ["position_m"]}
    found = read_recorder(tmp_path / "posts.csv", train="xuzhou_metro_3", line=line, **start)
    assert found.setup.profile.position[0] == pytest.approx(1550 - 59), "250 m beyond the jump at 1 300 m; 59: half"
    (tmp_path / "posts.csv").write_text(text_of(rows | {"position_m": post + 9000}))
    with pytest.raises(ValueError, match="positions fall, from"):
        read_recorder(tmp_path / "posts.csv", train="xuzhou_metro_3", line=line)


@pytest.mark.parametrize("leap", [-60.0, 60.0, 180.0])
def test_a_leap_of_the_odometer_is_refused_at_its_line(leap: float, tmp_path: Path, capsys) -> None:
    """Breaks if positions that the speed contradicts are imported, as one of 180 m in 5.8 km was."""
    time = np.arange(0.0, 120.5, 1.0)
    v, x, f = metro(time)
    rows = {"time_s": time, "speed_kmh": 3.6 * v, "position_m": np.where(time > 50, x + leap, x), "force_kn": f / 1e3}
    err = refused(tmp_path, capsys, text_of(rows))
    assert "rec.csv: line 53, position_m: " in err
    assert leap < 0 or "a leap of the odometer; correct the positions" in err
    take(tmp_path, capsys, text_of(rows), "--ignore", "position_m")


@pytest.mark.parametrize(
    ("factor", "status", "message"),
    [
        (1e-3, 2, "line 7, force_kn: the force does 0.00"),
        (1 / 4.45, 0, "the force does 1."),
        (0.7, 0, ""),
        (1.4, 0, ""),
    ],
)
def test_the_work_of_the_force_is_compared_with_the_speed(factor, status, message, tmp_path, capsys):
    """Breaks if a force in kN under the name of N is imported without a word, or another load is refused."""
    time = np.arange(0.0, 120.5, 1.0)
    v, x, f = metro(time)
    rows = {"time_s": time, "speed_kmh": 3.6 * v, "position_m": x, "force_kn": factor * f / 1e3}
    (tmp_path / "work.csv").write_text(text_of(rows))
    assert main(["import", str(tmp_path / "work.csv"), *TRAIN, "--out", str(tmp_path / "a")]) == status
    printed = capsys.readouterr()
    assert message in printed.err + printed.out
    assert bool(message) == ("kWh for its speed and resistance" in printed.err + printed.out)


def brake_as(unit: float, name: str) -> dict[str, Any]:
    return {name: lambda t, v, x, f: f"{max(-f, 0.0) / unit:.4f}"}


TRACTION = {"traction_force_kn": lambda t, v, x, f: f"{max(f, 0.0) / 1e3:.3f}"}
NOTED: list[tuple[dict[str, Any], str]] = [
    (SPEED | {"position_m": lambda t, v, x, f: f"{x + 30 * (t > 50):.3f}"} | FORCE,
     "line 53, position_m: 44.999 m since the row above, 29.9998 m beside 'speed_kmh'"),
    (SPEED | {"position_m": lambda t, v, x, f: f"{500 + 1.05 * (x - 500):.3f}"} | FORCE,
     "position_m: covers 1.261 km, the integral of 'speed_kmh' is 1.201 km; read as it is"),
    (SPEED | {"position_km": lambda t, v, x, f: f"{(x + 180 * (t > 50)) / 1e3:.1f}"} | FORCE,
     "position_km: covers 1.4"),
    (SPEED | PLACE | TRACTION | brake_as(1e3, "brake_force_n"), "brake_force_n: brake of at most 0.1267 kN"),
    (SPEED | PLACE | FORCE | {"command_force_n": FORCE["force_kn"]}, "command_force_n: traction of at most 0.1448 kN"),
    (SPEED | PLACE | FORCE | {"reference_speed_m_s": SPEED["speed_kmh"]},
     "reference_speed_m_s: at most 194.39 km/h, the train runs 53.9971 km/h"),
    (SPEED | PLACE | {"force_kn": lambda t, v, x, f: f"{abs(f) / 1e3:.3f}"},
     "line 87, force_kn: 47 % of the work of the traction is done while the train brakes"),
    (SPEED | PLACE | {"force_kn": lambda t, v, x, f: f"{metro(t - 10)[2] / 1e3:.3f}"},
     "force_kn: fits to the speed 10 s earlier (mean mismatch "),
    (SPEED | PLACE | {"force_kn": lambda t, v, x, f: f"{metro(t - 2)[2] / 1e3:.3f}"}, ""),
    (SPEED | PLACE | FORCE, ""),
    (SPEED | PLACE | TRACTION | brake_as(1e3, "brake_force_kn"), ""),
    (SPEED | {"position_km": lambda t, v, x, f: f"{x / 1e3:.1f}"} | FORCE, ""),
]  # fmt: skip


@pytest.mark.parametrize(("columns", "note"), NOTED)
def test_what_speed_and_traction_do_not_show_is_noted(
    columns: dict[str, Any], note: str, tmp_path: Path, capsys
) -> None:
    """Breaks if a small leap, a wheel diameter or a wrong unit beside right ones is imported without a word."""
    notes = take(tmp_path, capsys, metro_text(**TIME, **columns)).get("measured_notes") or ""
    assert note in notes and bool(note) == bool(notes)


@pytest.mark.parametrize(("columns", "parts"), [
    (SPEED, []),
    (SPEED | {"position_m": lambda t, v, x, f: f"{x - 29:.3f}"}, []),
    ({"speed_kmh": lambda t, v, x, f: f"{v / 0.44704:.3f}"}, ["455 m beside the nearest stop", "the force does"]),
    ({"speed_mph": SPEED["speed_kmh"]}, ["86.9 km/h at km 0.762, where", "732 m beside the nearest stop"]),
    (SPEED | {"position_m": lambda t, v, x, f: f"{x + 400:.3f}"}, ["at km 2.160, 429 m beside the nearest stop"]),
    (SPEED | {"position_m": lambda t, v, x, f: f"{x + 120:.3f}"}, ["149 m beyond the stop of line 'l' at all 2"]),
    (SPEED | PLACE, ["stands 29 m beyond the stop of line 'l' at all 2 halts"]),
])  # fmt: skip
def test_a_speed_in_another_unit_and_other_places_are_noted(columns, parts, tmp_path: Path) -> None:
    """Breaks if a speed in mph under the name of km/h, or a place far from the stops, is imported without a word."""
    line = "schema: train_ato/line/1\nname: l\nend: 3e3\nspeed_limits: [{at: 0, speed_kmh: 60}]\nstops: [{at: 530},"
    (tmp_path / "line.yaml").write_text(f"{line} {{at: 1731}}]")
    (tmp_path / "a.csv").write_text(metro_text(**TIME, **columns, **FORCE))
    start = None if "position_m" in columns else 0.53
    line = tmp_path / "line.yaml"
    read = read_recorder(tmp_path / "a.csv", train="xuzhou_metro_3", line=line, from_km=start)
    series_of(read.found, read.setup)
    notes = " ".join(read.found.notes)
    assert bool(parts) == bool(notes) and all(part in notes for part in parts), notes


@pytest.mark.parametrize(("stop", "note"), [(1731, ""), (1740, ""), (1790, "59 m before its stop at km 1.790, unlike")])
def test_one_halt_beside_its_stop_is_noted(stop: int, note: str, tmp_path: Path) -> None:
    """Breaks if one wrong place among right ones is imported without a word."""
    stops = [530, stop, 2932, 4133]
    (tmp_path / "line.yaml").write_text(
        f"schema: train_ato/line/1\nname: l\nend: 5e3\nstops: {[{'at': at} for at in stops]}"
    )
    speed, place, force = metro(np.arange(0.0, 120.0))
    length = place[-1] - place[0]
    whole = {
        "time_s": np.arange(360.0), "speed_kmh": 3.6 * np.tile(speed, 3), "force_kn": np.tile(force, 3) / 1e3,
        "position_m": np.concatenate([place - 29 + k * length for k in range(3)]),
    }  # fmt: skip
    (tmp_path / "a.csv").write_text(text_of(whole))
    read = read_recorder(tmp_path / "a.csv", train="xuzhou_metro_3", line=tmp_path / "line.yaml")
    notes = " ".join(read.found.notes)
    assert note in notes and bool(note) == bool(notes), notes


@pytest.mark.parametrize(("first", "time", "message"), [
    ("Recorder 7\n", TIME["time_s"], "line 1: one column, 'Recorder 7', above rows of 3; remove the lines above"),
    ("", lambda t, v, x, f: CLOCK.format(2 + (t < 60), int(t) // 60 % 60, int(t) % 60),
     "the clock was set back by an hour: write date and time with the zone"),
    ("", lambda t, v, x, f: CLOCK.format(1 + (t > 60), int(t) // 60 % 60, int(t) % 60),
     "if the clock was set forward by an hour, write date and time with the zone"),
    ("", lambda t, v, x, f: f"{int(t) // 60:02d}:{int(t) % 60:02d}", "08:15 is read as hours and minutes"),
])  # fmt: skip
def test_a_refused_layout_has_a_remedy_that_works(first: str, time: Any, message: str, tmp_path: Path, capsys) -> None:
    """Breaks if ``--sort`` is advised for the end of summer time, or a heading is called an unknown column."""
    text = metro_text(**TIME, **SPEED, **FORCE) if first else metro_text(timestamp=time, **SPEED, **FORCE)
    assert message in refused(tmp_path, capsys, first + text)


def test_the_other_sign_of_a_force_is_named(tmp_path: Path, capsys) -> None:
    """Breaks if a force with traction below 0 is called a matter of its unit."""
    text = metro_text(**TIME, **SPEED, **PLACE, force_kn=lambda t, v, x, f: f"{-f / 1e3:.3f}")
    assert "it does 5.50182 kWh with the other sign: traction is > 0" in refused(tmp_path, capsys, text)


def test_rows_out_of_order(plain: str, tmp_path: Path, capsys) -> None:
    """Breaks if rows are sorted without ``--sort``, or sorting changes a number or hides its note."""
    head, *rows = plain.splitlines()
    mixed = "\n".join([head, *rows[:100], *rows[150:], *rows[100:150], rows[20], ""])
    message = "s before the row above; sort the rows by time, or give --sort (and 1 more rows)"
    assert message in refused(tmp_path, capsys, mixed)
    contradiction = f"{mixed}{rows[20].replace(rows[20].split(',')[1], '99', 1)}\n"
    message = "the same time as the row above; remove one row"
    assert message in refused(tmp_path, capsys, contradiction, "--sort")
    expected = figures(take(tmp_path, capsys, plain, "--out", str(tmp_path / "a")))
    found = take(tmp_path, capsys, mixed, "--sort", "--out", str(tmp_path / "b"))
    assert figures(found) == expected
    assert re.fullmatch(r"\d+ rows sorted by time, 1 repeated rows removed", found["measured_notes"])


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
    err = refused(tmp_path, capsys, "\n".join(lines) + "\n", faults=4)
    found = [line.removeprefix(f"train-ato: {tmp_path / 'rec.csv'}: ") for line in err.splitlines()]
    assert [line.replace("; correct it", "").partition(";")[0] for line in found] == [
        "line 1, unknown column 'positon_m'",
        "line 21: 3 values for 4 columns",
        "line 11, speed_kmh: 'fast' is not a number (and 1 more of this kind)",
        "line 31, force_kn: 'strong' is not a number",
    ]


def test_faults_of_several_quantities_are_named_at_once(tmp_path: Path, capsys) -> None:
    """Breaks if the check of one quantity hides the fault of another one."""
    head = {"position_m": "reference_speed_kmh", "force_kn": "traction_force_kn"}
    text = recorded().splitlines()
    text[0] = ",".join(head.get(name, name) for name in text[0].split(","))
    text[40] = "7.8,-20.0,-3.0,0.0"
    found = refused(tmp_path, capsys, "\n".join(text) + "\n", faults=3).splitlines()
    assert found[0].partition("rec.csv: ")[2].startswith("line 41, speed_kmh: -20 is ")
    assert "reference_speed_kmh: " in found[1] and "traction_force_kn: " in found[2]


def test_the_sample_file_is_imported_by_the_command_in_it(tmp_path: Path, monkeypatch, capsys) -> None:
    """Breaks if the shipped file, its command or the line of the guide no longer fit."""
    sample = ROOT / "examples" / "recorder.csv"
    (command,) = [line[2:] for line in sample.read_text().splitlines() if line.startswith("# train-ato import")]
    assert command in (ROOT / "msgs_docs" / "guide.md").read_text()
    monkeypatch.chdir(ROOT)
    assert main([*shlex.split(command)[1:], "--out", str(tmp_path / "run")]) == 0
    assert "recorded in" in capsys.readouterr().out and main(["report", str(tmp_path / "run")]) == 0


def morning(t: float) -> str:
    """Return the time of day of a run from 8 o'clock on."""
    return CLOCK.format(8, int(t) // 60, int(t) % 60)


US = {
    "Date": lambda t, v, x, f: "11/24/2026" if t < 60 else "11/25/2026", "Time": lambda t, v, x, f: clock(t),
    "Speed [mph]": lambda t, v, x, f: f"{v / 0.44704:.4f}", "Milepost [mi]": lambda t, v, x, f: f"{x / 1609.344:.6f}",
    "Notch": lambda t, v, x, f: "8" if f > 0 else "Idle", "Dynamic": lambda t, v, x, f: "4.0" if f < 0 else "",
    "BP [psi]": lambda t, v, x, f: "72.3", "Horn": lambda t, v, x, f: "off",
}  # fmt: skip
RECORDERS: dict[str, tuple[dict[str, Any], str]] = {
    "us_locomotive": (US, ";"),
    "jru_german": (
        {"Datum": lambda t, v, x, f: "24.11.2026", "Uhrzeit": lambda t, v, x, f: morning(t),
         "Geschwindigkeit [km/h]": lambda t, v, x, f: f"{3.6 * v:.4f}".replace(".", ","),
         "Weg [km]": lambda t, v, x, f: f"{x / 1e3:.6f}".replace(".", ","),
         "Zugkraft [kN]": lambda t, v, x, f: f"{f / 1e3:.3f}".replace(".", ","), "PZB": lambda t, v, x, f: "aus"}, ";",
    ),
    "etcs_jru": (
        {"DATE": lambda t, v, x, f: "2026-11-24", "TIME": lambda t, v, x, f: morning(t),
         "V_TRAIN": lambda t, v, x, f: f"{3.6 * v:.4f}", "D_TRAIN": lambda t, v, x, f: f"{x:.3f}",
         "V_PERMIT": lambda t, v, x, f: "60", "M_MODE": lambda t, v, x, f: "FS"}, ",",
    ),
    "osrd_export": (
        {"op": lambda t, v, x, f: "stop", "time": lambda t, v, x, f: clock(t),
         "seconds": lambda t, v, x, f: f"{1727799360 + t:.0f}",
         "position": lambda t, v, x, f: f"{x / 1e3:.6f}".replace(".", ","),
         "speed": lambda t, v, x, f: f"{3.6 * v:.4f}".replace(".", ",")}, ";",
    ),
    "bve_blackbox": (
        {"Time": lambda t, v, x, f: f"{t:.3f}", "Position": lambda t, v, x, f: f"{x:.3f}",
         "Speed": lambda t, v, x, f: f"{v:.4f}", "PowerSafety": lambda t, v, x, f: "4" if f > 0 else "0",
         "BrakeSafety": lambda t, v, x, f: "4" if f < 0 else "0", "Event": lambda t, v, x, f: ""}, ",",
    ),
}  # fmt: skip
"""Made-up files in the layouts that are shipped."""


def recorder_file(path: Path, name: str, **changes: Callable[[float, float, float, float], str]) -> Path:
    columns, separator = RECORDERS[name]
    rows = metro_rows(**(columns | changes))
    path.write_text("".join(separator.join(row) + "\n" for row in rows))
    return path


@pytest.mark.parametrize("name", layout_names())
def test_a_shipped_layout_reads_the_files_of_its_recorder(name: str, tmp_path: Path) -> None:
    """Breaks if a title, a unit, a notch or a time of a layout is wrong, or a layout is shipped without a file."""
    file = recorder_file(tmp_path / "rec.csv", name)
    pipe = name == "us_locomotive"
    train, line = ("hxd1_c80_105", "daqin_section") if pipe else ("xuzhou_metro_3", "level")
    made = read_recorder(file, train=train, line=line, layout=name)
    profile, found = made.setup.profile, made.found
    assert profile.end == pytest.approx(120) and found.speed.values.max() == pytest.approx(15, abs=1e-3)
    assert profile.position[-1] - profile.position[0] == pytest.approx(metro(120.0)[1] - metro(0.0)[1], abs=0.5)
    if pipe:
        assert found.pressure.values[0] == pytest.approx(72.3 * 6894.757 + 101_325)
    if name in ("us_locomotive", "bve_blackbox"):
        consist = load_consist(train)
        units = [consist.vehicles[unit] for unit in consist.power_units]
        command, force = found.command[None].values, found.force[None].values
        for t, share in ((10, 1.0), (40, 0.0), (95, -0.5)):
            v = float(metro(float(t))[0])
            assert (metro(float(t))[2] > 0) == (share > 0)
            envelopes = [Envelope(unit.traction if share > 0 else unit.brake) for unit in units]
            by_hand = share * sum(envelope.force(v) for envelope in envelopes) if metro(float(t))[2] or not share else 0
            assert command[t] == pytest.approx(by_hand, rel=1e-3) and force[t] == command[t]
        assert "without a measured force in the file, the force" in " ".join(found.notes)


@pytest.mark.parametrize("name", ["jru_german", "bve_blackbox"])
def test_a_file_with_forces_becomes_a_run_a_report_and_a_table(name: str, tmp_path: Path, capsys) -> None:
    """Breaks if a step refuses the file, or its table in US units is not the same run when it is imported again."""
    file = recorder_file(tmp_path / "rec.csv", name)
    on = ["--train", "xuzhou_metro_3", "--line", "level", "--json"]
    out = [str(tmp_path / key) for key in ("run", "again")]
    assert main(["import", str(file), "--layout", name, *on, "--out", out[0]]) == 0
    first = json.loads(capsys.readouterr().out)
    assert main(["report", out[0]]) == 0
    tables = ["--csv", "--units", "us", "--topics", "train/measurement", "--out", str(tmp_path / "tables")]
    assert main(["export", out[0], *tables]) == 0
    capsys.readouterr()
    assert main(["import", str(tmp_path / "tables" / "train_measurement.csv"), *on, "--out", out[1]]) == 0
    again = json.loads(capsys.readouterr().out)
    for key in ("energy_traction_kwh", "distance_m", "speed_max_kmh"):
        assert again[key] == pytest.approx(first[key], rel=2e-3), key


OWN_LAYOUT = """
schema: train_ato/recorder/1
name: mine
skip_lines: 1
separator: ";"
columns: {Spd: speed_kmh, Clock: timestamp, HL: brake_pipe_pressure_bar, Kraft: force_kn}
date: Day
gauge: true
notches: {Handle: {B1: -1, N: 0, P1: 0.5}}
ignore: [Door]
"""


def test_a_layout_of_the_user(tmp_path: Path, capsys) -> None:
    """Breaks if a key of a layout has no effect, or a notch that it does not have is read."""
    columns = {
        "Day": lambda t, v, x, f: "24.11.2026", "Clock": lambda t, v, x, f: morning(t),
        "Spd": lambda t, v, x, f: f"{3.6 * v:.4f}", "Kraft": lambda t, v, x, f: f"{f / 1e3:.3f}",
        "Handle": lambda t, v, x, f: {5.0: "P1", 30.0: "n", 90.0: "B1"}.get(t, "" if t else "N"),
        "Door": lambda t, v, x, f: "shut",
    }  # fmt: skip
    rows = [";".join(row) for row in metro_rows(**columns)]
    file, layout = tmp_path / "rec.csv", tmp_path / "mine.yaml"
    file.write_text("Recorder 7, car 12\n" + "\n".join(rows) + "\n")
    layout.write_text(OWN_LAYOUT)
    words = ["import", str(file), "--train", "xuzhou_metro_3", "--line", "level", "--layout", str(layout)]
    assert main([*words, "--out", str(tmp_path / "p.csv"), "--profile-only"]) == 0
    assert "Handle: share of the largest force at the speed; it is the demand\n" in capsys.readouterr().err
    found = read_recorder(file, train="xuzhou_metro_3", line="level", layout=layout).found
    command = found.command[None].values
    traction, brake = (
        Envelope(getattr(load_consist("xuzhou_metro_3").vehicles[0], kind)) for kind in ("traction", "brake")
    )
    assert command[:5] == pytest.approx([0] * 5) and command[20] == pytest.approx(
        0.5 * traction.force(found.speed.values[20])
    )
    assert command[31] == 0 and command[95] == pytest.approx(-brake.force(found.speed.values[95]), rel=1e-3)
    assert found.force[None].values[10] == pytest.approx(metro(10.0)[2], abs=1)
    changes = {
        "skip_lines: 1": "skip_lines: 0", "P1: 0.5": "P2: 0.5", "P1: 0.5}": "P1: 5}", "date: Day": "date: Dai",
        "ignore: [Door]": "ignore: []", "separator": "separater", "Spd: speed_kmh": "Spd: speed",
    }  # fmt: skip
    for before, after in changes.items():
        layout.write_text(OWN_LAYOUT.replace(before, after))
        assert main([*words, "--out", str(tmp_path / "q.csv"), "--profile-only"]) == 2, after
        told = capsys.readouterr().err
        assert told and "Traceback" not in told and not (tmp_path / "q.csv").exists()
        if after.startswith("P2"):
            assert "'P1' is no notch of the layout (B1, N, P2); add it there" in told
    layout.write_text(OWN_LAYOUT.replace("ignore: [Door]", "ignore_others: true"))
    assert read_recorder(file, train="xuzhou_metro_3", line="level", layout=layout).found.end == 120


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("Door]", "Door, Spd]", "'Spd' is in columns and in ignore"),
        ("{Spd", "{Handle: command_force_kn, Spd", "'Handle' is in columns and in notches"),
        ("P1: 0.5", "P1: 0.5, p1: 0.9", "notches: Handle: one notch twice, as B1, N, P1, p1"),
        ("Spd: speed_kmh", "Spd: speed_kn", "columns: Spd: 'speed_kn' is no column of train_ato"),
    ],
)
def test_a_layout_with_two_meanings_is_refused(tmp_path: Path, before: str, after: str, message: str) -> None:
    """Breaks if one of two meanings of a title, or of two shares of a notch, is taken without a word."""
    (tmp_path / "mine.yaml").write_text(OWN_LAYOUT.replace(before, after))
    with pytest.raises(ValueError, match=message) as caught:
        load_layout(str(tmp_path / "mine.yaml"))
    assert "\n" not in str(caught.value)


def test_a_layout_that_is_not_known_is_refused(tmp_path: Path, capsys) -> None:
    """Breaks if a misspelt layout is read as none."""
    err = refused(tmp_path, capsys, "time_s,speed_kmh\n0,1\n1,2\n", "--profile-only", "--layout", "us_locomotiv")
    assert "did you mean 'us_locomotive'?" in err
