"""Invalid files for the import: errors of one line with file, row, column and remedy, without output."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from import_files import TRAIN, recorded, refused, take

from train_ato.cli.main import main
from train_ato.profile.file import read_profile

FORCE = "time_s,speed_kmh,force_kn"
GOOD = [f"{t},{min(t, 30) * 2},{50 if t < 30 else 5}" for t in range(41)]


def rows(*lines: str, head: str = FORCE) -> str:
    return "\n".join((head, *lines)) + "\n"


def under(head: str) -> str:
    """Return the valid rows under other column names."""
    return rows(*GOOD, head=head)


def beside(name: str, value) -> str:
    """Return the valid rows with another column, a function ``value`` of the row number."""
    return rows(*(f"{line},{value(t)}" for t, line in enumerate(GOOD)), head=f"{FORCE},{name}")


def but(number: int, line: str) -> str:
    """Return the valid rows with one replaced line; the column names are line 1."""
    return rows(*GOOD[: number - 2], line, *GOOD[number - 1 :])


def every(row) -> str:
    """Return rows from a function of the row number."""
    return rows(*(row(t) for t in range(41)))


FILES = [  # columns
    (under("time_s,sped_kmh,force_kn"), r"unknown column 'sped_kmh'; did you mean 'speed_kmh'"),
    (under("time_s,Sped [km/h],force_kn"), r"unknown column 'Sped \[km/h\]'; did you mean 'speed_kmh'\?"),
    (under("time_s,speed,force_kn"), r"'speed' has no unit; name it speed_m_s or speed_kmh"),
    (beside("door", lambda t: 7), r"'door'.*--ignore 'door'"),
    (under("time_s,reference_speed_kmh,force_kn"), r"no speed column; name one"),
    (under("reference_speed_kmh,speed_kmh,force_kn"), r"no time column"),
    (under("time_s,speed_kmh,reference_speed_kmh"), r"no force column.*--profile-only"),
    (under("time_s,speed_kmh,speed_kmh"), r"'speed_kmh' appears twice"),
    (under("time_s,speed_kmh,speed_m_s"), r"'speed_kmh' and 'speed_m_s' are the same quantity"),
    (under("time_s,,force_kn"), r"column 2 has no name"),
    (under("timestamp,speed_kmh,force_kn"), r"line 2, timestamp: '0' is not a date and time"),
    (beside("timestamp", lambda t: "2026-01-01"), r"are both the time"),
    (beside("brake_force_kn", lambda t: 1), r"are both the force"),
    (rows("0,1,2,3", "1,1,2,3", head="time_s,speed_kmh,position_m,front_position_m"), r"are both the position"),
    (
        rows("0,1,2,3", "1,1,2,3", head="time_s,speed_kmh,force_n,unit_0_force_n"),
        r"is the sum of all power units.*; remove one",
    ),
    (under("time_s,speed_kmh,unit_0_door"), r"'unit_0_door': not a quantity of a power unit; use"),
    (beside("brake_pipe_pressure_kpa", lambda t: 600), r"'brake_pipe_pressure_kpa': train .* has no air brake"),
    (every(lambda t: f"{t},{t},"), r"column 'force_kn' is empty"),
    # rows
    (but(12, "3,20,50"), r"line 12, time_s: 6 s before the row above"),
    (but(12, "9,20,50"), r"line 12, time_s: the same time as the row above"),
    (but(12, ",20,50"), r"line 12, time_s: is empty"),
    (rows(*GOOD[:10], *GOOD[20:]), r"line 12, time_s: 11 s after the row above.*--largest-gap 11"),
    (rows(*GOOD[:10], *(f"{t},{t * 2}," for t in range(10, 20)), *GOOD[20:]),
     r"line 22, force_kn: 11 s after the last value, in line 11"),
    (rows(*GOOD[:30], *(f"{t},60," for t in range(30, 41))), r"line 42, force_kn: 11 s after the last value"),
    (but(7, "5,fast,50"), r"line 7, speed_kmh: 'fast' is not a number"),
    (but(7, "5,1_0,50"), r"line 7, speed_kmh: '1_0' is not a number"),
    (but(7, "5,inf,50"), r"line 7, speed_kmh: 'inf' is not a number"),
    (but(7, "5,1e999,50"), r"line 7, speed_kmh: '1e999' is too large"),
    (but(7, "5,10"), r"line 7: 2 values for 3 columns"),
    (but(7, "5,10,5,50"), r"line 7: 4 values for 3 columns"),
    (but(7, '5,"1,250",50'), r"line 7, speed_kmh: '1,250' may be 1\.250 or 1250; write it without a comma"),
    (every(lambda t: f"{t}.5\t{t}\t{'1,050' if t == 20 else 50}").replace(FORCE, FORCE.replace(",", "\t")),
     r"line 22, force_kn: '1,050' has a comma and '0\.5' a point; write all numbers with one decimal mark"),
    (but(7, "5,-12,50"), r"line 7, speed_kmh: -12 is negative"),
    (every(lambda t: f"{t},{t * 25},50"), r"line \d+, speed_kmh: .* faster than any train; check the unit"),
    (but(20, "18,100,50"), r"line 20, speed_kmh: 100 is an impossible jump"),
    (under("time_s,speed_kmh,brake_force_kn").replace("20,40,50", "20,40,-3"),
     r"line 22, brake_force_kn: -3 is negative; .*'brake_force_kn:=force_kn'"),
    (every(lambda t: f"{t},{t},50000"), r"line 2, force_kn: 50000 kN is .* times the maximum of train"),
    (beside("position_m", lambda t: 900 - t), r"position_m: positions fall, from 0\.9 to 0\.86 km: .*LINE:reverse, or"),
    (beside("position_m", lambda t: 900 + 10 * t - (9 if 5 < t < 7 else 0) * 10),
     r"line 8, position_m: 870 is behind an earlier position"),
    (beside("position_m", lambda t: 90 * t),
     r"'position_m' covers 3\.600 km, the integral of 'speed_kmh' is 0\.4.*check the units"),
    (beside("reference_speed_kmh", lambda t: -t), r"line 3, reference_speed_kmh: -1 is negative"),
    (every(lambda t: f"{t},0,0"), r"'speed_kmh': the train does not move"),
    # files
    (rows("0,10,5"), r"1 rows of numbers; give at least two"),
    (rows(), r"0 rows of numbers"),
    (rows("0,10,5", "0.05,10,5"), r"0\.05 s is too short"),
    ("", r"no column names"),
    ("# nothing\n\n", r"no column names"),
    (b"\x00\x01\x02" * 50, r"not a text file"),
    (b"\xff\xfe\x00", r"unknown column|no column names"),
]  # fmt: skip
"""Invalid columns, rows and files."""
OPTIONS = [
    (["--rename", "v:=speed_kmh"], r"--rename v: no such column; the file has time_s"),
    (["--rename", "v"], r"--rename v: not a renaming; write from:=to"),
    (["--ignore", "door"], r"--ignore door: no such column"),
    (
        ["--from-km", "299.9"],
        r"front to km 300\.\d+ .* the end of line .* check the unit of 'speed_kmh', --from-km and",
    ),
    (["--from-km", "nan"], r"--from-km: 'nan' is out of range; give a finite number"),
    (["--from-km", "84+500"], r"'84\+500': line 'level' has no chainage; write the distance in kilometres"),
    (["--tick", "0.033"], r"--tick 0\.033: out of range; give a multiple of 0\.005 s"),
    (["--largest-gap", "nan"], r"--largest-gap nan: out of range; give more than 0 s"),
    (["--smooth", "1e9"], r"--smooth 1000000000\.0: out of range; give 0 to 60 s"),
    (["--name", "../x"], r"rec\.csv: name = '\.\./x'"),
    (["--consist", "hxd1_c80_15"], r"train 'hxd1_c80_15' is neither shipped"),
    (["--line", "levle"], r"line 'levle' is neither shipped.*did you mean 'level'"),
]
"""Invalid options for valid rows."""
HOSTILE = [*((text, [], message) for text, message in FILES), *((rows(*GOOD), *case) for case in OPTIONS)]
PIECES = [b"", b",", b"\n", b"-", b"e9", b"nan", b'"', b";", b"#", b"\xff", b"0", b"time_s"]


@pytest.mark.parametrize(("text", "options", "message"), HOSTILE, ids=[case[2][:40] for case in HOSTILE])
def test_what_cannot_be_is_refused_by_its_line(tmp_path, capsys, text, options, message):
    """Breaks if invalid input is imported or causes a traceback."""
    assert re.search(message, refused(tmp_path, capsys, text, *options))


def test_a_unit_that_the_train_does_not_have_and_the_missing_one_are_two_faults(tmp_path, capsys):
    """Breaks if only the first of several faults is named, or a fault has more than one line."""
    text = under("time_s,speed_kmh,unit_4_force_kn")
    first, second = refused(tmp_path, capsys, text, faults=2).splitlines()
    assert "'unit_4_force_kn': the train has 1 power units" in first
    assert "force of unit 0 is missing" in second


def test_the_good_rows_of_that_table_are_good(tmp_path, capsys):
    """Breaks if the valid rows are refused; then the cases above would test nothing."""
    assert take(tmp_path, capsys, rows(*GOOD))["measured_rows"] == 41
    assert take(tmp_path, capsys, rows(*GOOD[:10], *GOOD[20:]), "--largest-gap", "11", "--out", str(tmp_path / "b"))


@settings(max_examples=100)
@given(st.data())
def test_no_file_brings_a_traceback(tmp_path_factory, data):
    """Breaks if changed, removed or doubled bytes cause neither a profile nor an error of one line."""
    folder = tmp_path_factory.mktemp("fuzz")
    raw = bytearray(recorded(1.0, 40.0).encode())
    for _ in range(data.draw(st.integers(1, 6))):
        place = data.draw(st.integers(0, len(raw) - 1))
        raw[place : place + data.draw(st.integers(0, 3))] = data.draw(st.sampled_from(PIECES))
    (folder / "rec.csv").write_bytes(raw)
    options = ["--profile-only", "--out", str(folder / "p.csv"), "--json"]
    status = main(["import", str(folder / "rec.csv"), *TRAIN, *options])
    assert status in (0, 2) and (folder / "p.csv").exists() == (status == 0)
    if status == 0:
        profile = read_profile(folder / "p.csv")
        assert np.isfinite(profile.velocity).all() and profile.velocity.min() >= 0
