"""Import of measured runs: run folder and profile, their use by the other commands, and refused files."""

import json
import re
from datetime import datetime, timedelta

import numpy as np
import pytest
import yaml
from commands import answer, complaint
from hypothesis import given, settings
from hypothesis import strategies as st
from import_files import BRAKE, CRUISE, TOP, TRAIN, metro, recorded, refused, take, text_of

import train_ato
from train_ato.api.import_csv import run as measured_run
from train_ato.api.import_csv.columns import Column
from train_ato.api.import_csv.run import _checked_pressure
from train_ato.api.import_csv.samples import ColumnSamples
from train_ato.cli.main import main
from train_ato.profile.file import read_profile

pytestmark = pytest.mark.usefixtures("without_figure")


def test_a_run_of_ours_comes_back_the_same(tmp_path, capsys):
    """Breaks if export and import change speed, position or force, or the profile without averaging."""
    run, tables = tmp_path / "ours", tmp_path / "tables"
    scenario = ["demo", "--engine", "--set", "duration=60", "--set", "plant.sensors={couplers: [0]}"]
    main(["run", *scenario, "--out", str(run)])
    main(["export", str(run), "--csv", "--topics", "train/measurement", "--out", str(tables)])
    capsys.readouterr()
    ignored = ["--ignore", "coupler_0_deflection_m", "coupler_0_deflection_rate_m_s", "coupler_0_force_n"]
    train = ["--consist", "hxd1_c80_105", "--line", "daqin_section"]
    text = (tables / "train_measurement.csv").read_text()
    told = take(tmp_path, capsys, text, *ignored, "--smooth", "0", train=train)
    before, after = (train_ato.load(folder)["train/measurement"] for folder in (run, tmp_path / "imported"))
    for column in ("unit_0_position_m", "unit_0_speed_m_s", "unit_0_applied_force_n"):
        assert np.allclose(after[column], before[column].iloc[:-1], rtol=0, atol=1e-7), column
    profile = read_profile(tmp_path / "imported" / "profile.csv")
    truth = train_ato.load(run, ["train/vehicles"])["train/vehicles"]
    count = len(profile)
    assert np.abs(profile.velocity - truth["vehicle_0_speed_m_s"].to_numpy()[:count]).max() < 2e-3
    assert np.abs(profile.position - truth["vehicle_0_position_m"].to_numpy()[:count]).max() < 0.05
    assert told["measured_profile"] == "the speed as it is"
    energy = json.loads((run / "summary.json").read_text())["energy_traction_kwh"]
    assert told["energy_traction_kwh"] == pytest.approx(energy, rel=0.01)


def test_a_coarse_recorder_gives_a_profile_that_can_be_driven(tmp_path, capsys):
    """Breaks if steps of whole km/h and 10 m at 1 Hz, with decimal commas, become accelerations of the train."""
    time = np.arange(0.0, 121.0)
    v, x, f = metro(time)
    rows = text_of(
        {"Zeit": time, "v [km/h]": np.round(3.6 * v), "km": np.round(x + 3 * np.sin(time), -1) / 1e3, "F": f / 1e3},
        ";",
        3,
    )
    text = "# Aufzeichnung 4711\n\n" + rows.replace(".", ",").replace(",000;", ";")
    names = ["Zeit:=time_s", "v [km/h]:=speed_kmh", "km:=position_km", "F:=force_kn"]
    told = take(tmp_path, capsys, text, "--rename", *names)
    profile = read_profile(tmp_path / "imported" / "profile.csv")
    truth = metro(profile.time)
    assert np.sqrt(np.mean((profile.velocity - truth[0]) ** 2)) < 0.25
    assert np.abs(profile.position - truth[1]).max() < 5.0
    assert -1.0 < profile.acceleration.min() < -0.6 and 0.7 < profile.acceleration.max() < 1.1
    cruise = (profile.time > CRUISE[0] + 5) & (profile.time < CRUISE[1] - 5)
    assert np.abs(profile.acceleration[cruise]).max() < 0.03 and not profile.ends_rolling
    assert told["measured_rows"] == 121
    scenario, again = str(tmp_path / "imported" / "scenario.yaml"), str(tmp_path / "again")
    driven = answer(capsys, "run", scenario, "--engine", "--out", again)
    assert driven["speed_rmse_kmh"] < 0.5 and abs(driven["stop_error_m"]) < 0.5


def test_the_profile_fits_into_another_scenario(tmp_path, capsys):
    """Breaks if the option printed by the import does not work."""
    (tmp_path / "run.csv").write_text(recorded(end=60.0))
    out = tmp_path / "imported"
    assert main(["import", str(tmp_path / "run.csv"), *TRAIN, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    found = re.search(r"--set '(profile=\{.*\})'", printed)
    assert found is not None, printed
    assert "allow_rolling_end: true" in found[1]
    other = ["xuzhou_metro", "--set", found[1], "--set", "duration=60", "--set", "plant.line=level"]
    status = main(["run", *other, "--engine", "--json", "--out", str(tmp_path / "b")])
    captured = capsys.readouterr()
    assert status == 0, captured.err
    assert json.loads(captured.out)["speed_rmse_kmh"] < 1.0


def test_what_reads_runs_reads_a_measured_one(tmp_path, capsys):
    """Breaks if info, replay, report, compare or export refuse it, or verify has no reason for its refusal."""
    v, _, f = metro(np.arange(0.0, 100.1, 0.2))
    text = recorded(0.2, 100.0, reference_speed_kmh=3.6 * v + 0.36, command_force_kn=f / 1e3 + 1)
    take(tmp_path, capsys, text)
    run = str(tmp_path / "imported")
    info = answer(capsys, "info", run)
    assert info["controller"] == "measured" and info["status"] == "done"
    assert info["speed_rmse_kmh"] == pytest.approx(0.36, abs=0.01)
    assert info["command_variation_kn_per_s"] > 0 and info["coupler_draft_max_kn"] is None
    assert info["stop_error_m"] is None
    frames = train_ato.load(run)
    assert "train/vehicles" not in frames, "vehicles were not measured"
    assert np.allclose(frames["ato/command"]["unit_0_force_n"].iloc[::2], f[:-1] + 1000.0, atol=1e-6)
    assert np.allclose(frames["ato/reference"]["speed_m_s"].iloc[::2], v[:-1] + 0.1, atol=1e-9)
    assert answer(capsys, "replay", run, "--law", "pid")["ticks"] == len(frames["ato/command"])
    assert main(["report", run, "--json"]) == 0
    assert (tmp_path / "imported" / "report.html").stat().st_size > 10_000
    assert "a measured run cannot be repeated" in complaint(capsys, "verify", run)
    scenario = str(tmp_path / "imported" / "scenario.yaml")
    assert main(["compare", scenario, "--laws", "pid", "--json", "--out", str(tmp_path / "c")]) == 0
    assert main(["export", run, "--json"]) == 0


def test_noise_at_standstill_makes_no_motion(tmp_path, capsys):
    """Breaks if single steps of the resolution at a stop move the profile, or a measured run has no stop."""
    time = np.arange(0.0, 141.0)
    v, x, f = metro(time)
    speed = np.round(3.6 * v, 1)
    speed[[110, 115, 116, 120]] = (0.1, 0.1, -0.1, 0.1)  # noise after the stop at 105.2 s
    take(
        tmp_path, capsys, text_of({"time_s": time, "speed_kmh": speed, "position_m": x, "force_kn": f / 1e3}, digits=1)
    )
    profile = np.genfromtxt(tmp_path / "imported" / "profile.csv", delimiter=",", skip_header=3)
    assert not profile[profile[:, 0] > 106.5, 2].any() and np.ptp(profile[profile[:, 0] > 106.5, 1]) == 0
    assert profile[3, 2] == 0 and profile[60, 2] > 0  # and a slow begin of the motion is kept
    driven = train_ato.run(tmp_path / "imported" / "scenario.yaml", law="pid")
    (row,) = train_ato.difference(tmp_path / "imported", driven).stops.to_dict("records")
    assert row["arrival_s"] == pytest.approx(CRUISE[1] + TOP / BRAKE, abs=1.5)
    assert abs(row["difference_arrival_s"]) < 2 and abs(row["difference_stop_m"]) < 0.5


def test_a_law_beside_a_measured_run_is_not_compared_with_a_law(tmp_path, capsys):
    """Breaks if the recorded output has the name of the law of the scenario."""
    take(tmp_path, capsys, recorded(0.2, 60.0))
    run = str(tmp_path / "imported")
    assert main(["replay", run, "--law", "pid"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "force at the wheel, measured" in said and "pid, recorded" not in said
    assert answer(capsys, "replay", run, "--law", "pid")["recorded_controller"] == "measured"
    other = tmp_path / "demanded"
    other.mkdir()
    take(other, capsys, recorded(0.2, 60.0, command_force_kn=np.zeros(301)))
    assert main(["replay", str(other / "imported"), "--law", "pid"]) == 0
    assert "demand, measured" in " ".join(capsys.readouterr().out.split())


def test_the_log_of_a_measured_run_alone_says_that_it_is_one(tmp_path, capsys):
    """Breaks if the log without its folder is verified or reported as a run of the law of the scenario."""
    take(tmp_path, capsys, recorded(0.2, 60.0))
    log = (tmp_path / "imported" / "run.mcap").rename(tmp_path / "alone.mcap")
    assert "a measured run cannot be repeated" in complaint(capsys, "verify", str(log))
    assert answer(capsys, "replay", str(log), "--law", "pid")["recorded_controller"] == "measured"
    assert main(["report", str(log), "--json", "--out", str(tmp_path / "alone.html")]) == 0
    page = (tmp_path / "alone.html").read_text()
    assert "measured run" in page and "the command was not measured" in page
    log.rename(tmp_path / "imported" / "run.mcap")
    (tmp_path / "imported" / "summary.json").unlink()
    assert "a measured run cannot be repeated" in complaint(capsys, "verify", str(tmp_path / "imported"))


def test_uneven_rows_are_read_linearly_at_the_tick(tmp_path, capsys):
    """Breaks if rows are treated as evenly spaced, or values are held between them."""
    time = np.sort(np.random.default_rng(3).uniform(0.1, 99.9, 400))
    time = np.concatenate(([0.0], time[np.diff(time, prepend=0.0) > 0.01], [100.0])) + 1234.5
    v, x, f = metro(time - 1234.5)
    text = text_of({"time_s": time, "speed_m_s": v, "position_m": x, "force_n": f})
    told = take(tmp_path, capsys, text, "--smooth", "0", "--tick", "0.05")
    table = train_ato.load(tmp_path / "imported")["train/measurement"]
    assert len(table) == 2000
    for column, values in (("unit_0_speed_m_s", v), ("unit_0_position_m", x), ("unit_0_applied_force_n", f)):
        expected = np.interp(np.asarray(table.index), time - 1234.5, values)
        assert np.allclose(table[column], expected, rtol=0, atol=1e-6), column
    assert told["simulated_s"] == 100.0
    assert told["measured_largest_gap_s"] == pytest.approx(np.diff(time).max())


SPELLED = {
    "time": {"time_s": 1.0, "time_ms": 1e3, "time_min": 1 / 60, "time_h": 1 / 3600},
    "speed": {"speed_m_s": 1.0, "speed_kmh": 3.6, "speed_mph": 1 / 0.44704, "unit_0_speed_kmh": 3.6},
    "place": {"position_m": 1.0, "position_km": 1e-3, "unit_0_position_m": 1.0, "front_position_km": 1e-3},
    "force": {"force_n": 1.0, "force_kn": 1e-3, "unit_0_force_mn": 1e-6, "unit_0_applied_force_n": 1.0},
}


@pytest.mark.parametrize(tuple(SPELLED), list(zip(*SPELLED.values(), strict=True)))
def test_units_are_those_of_the_names(tmp_path, capsys, time, speed, place, force):
    """Breaks if a factor is inverted or the front is used as the centre of vehicle 0."""
    moments = np.arange(0.0, 40.1, 0.5)
    v, x, f = metro(moments)
    x = x + 59.0 if place.startswith("front") else x  # half of the metro's 118 m
    columns = {time: moments, speed: v, place: x, force: f}
    factors = {name: factor for names in SPELLED.values() for name, factor in names.items()}
    take(tmp_path, capsys, text_of({name: values * factors[name] for name, values in columns.items()}))
    table = train_ato.load(tmp_path / "imported")["train/measurement"].iloc[::5]
    v, x, f = metro(moments[:-1])
    assert np.allclose(table["unit_0_speed_m_s"], v, atol=1e-6)
    assert np.allclose(table["unit_0_position_m"], x, atol=1e-5)
    assert np.allclose(table["unit_0_applied_force_n"], f, atol=1e-2)


def test_moments_traction_and_brake_apart_empty_cells(tmp_path, capsys):
    """Breaks if time of day, separate traction and brake, or a channel in every fifth row is read wrongly."""
    time = np.arange(0.0, 120.2, 0.2)
    v, x, f = metro(time)
    begin = datetime(2026, 3, 1, 23, 59, 30)
    moments = [(begin + timedelta(seconds=float(t))).isoformat(timespec="milliseconds") for t in time]
    slow = [repr(float(value)) if row % 5 == 0 else "" for row, value in enumerate(x)]
    columns = {
        "timestamp": moments, "speed_m_s": v, "position_m": slow,
        "traction_force_kn": np.maximum(f, 0) / 1e3, "brake_force_kn": np.maximum(-f, 0) / 1e3,
    }  # fmt: skip
    told = take(tmp_path, capsys, text_of(columns))
    table = train_ato.load(tmp_path / "imported")["train/measurement"].iloc[::2]
    assert np.allclose(table["unit_0_applied_force_n"], f[:-1], atol=1e-6)
    assert np.allclose(table["unit_0_position_m"], x[:-1], atol=0.2)
    assert re.search(r"position_m: 480 empty cells bridged, the first in line 3, at most 1 s", told["measured_notes"])


def test_a_gauge_pressure_is_refused(tmp_path, capsys):
    """Breaks if a charged pipe of 5 bar, or 72.5 psi, beside the atmosphere becomes a brake application of 1 bar."""
    time = np.arange(0.0, 60.1, 0.5)
    v, x, f = metro(time)
    columns = {"time_s": time, "speed_m_s": v / 4, "position_km": 10 + (x - 500) / 4000, "force_n": 4 * f}
    file = tmp_path / "gauge.csv"
    for unit, charged in (("bar", 5.0), ("psi", 72.5), ("kpa", 498.7)):
        file.write_text(text_of({**columns, f"brake_pipe_pressure_{unit}": np.full(time.size, charged)}))
        words = [
            "import", str(file), "--consist", "hxd1_c80_210", "--line", "daqin_section", "--out", str(tmp_path / "i"),
        ]  # fmt: skip
        told = complaint(capsys, *words)
        assert f"column 'brake_pipe_pressure_{unit}': at most" in told and "probably a gauge pressure" in told
        assert "add 101.3 kPa" in told and not (tmp_path / "i").exists()


def test_several_units_and_the_brake_pipe(tmp_path, capsys):
    """Breaks if a total force is not distributed, forces per unit change, or units have wrong positions."""
    time = np.arange(0.0, 60.1, 0.5)
    v, x, f = metro(time)
    f = 4 * f  # a force that a train of this mass needs
    base = {"time_s": time, "speed_m_s": v / 4, "position_km": 10 + (x - 500) / 4000}
    train = ["--consist", "hxd1_c80_210", "--line", "daqin_section"]
    pressure = np.interp(time, [0, 30, 40], [6.0, 6.0, 5.5])
    told = take(tmp_path, capsys, text_of({**base, "force_n": f, "brake_pipe_pressure_bar": pressure}), train=train)
    assert "brake_pipe_pressure_bar: absolute pressure, at most 600 kPa" in told["measured_notes"]
    assert "kPa are charged; check the unit" not in told["measured_notes"]
    wrong = ColumnSamples(Column("BP", "brake_pipe_pressure", 1.0), time, 1e3 * pressure, np.arange(time.size))
    assert _checked_pressure(wrong, 600e3, tmp_path).endswith("600 kPa are charged; check the unit in the column name")
    frames = train_ato.load(tmp_path / "imported")
    table = frames["train/measurement"]
    assert np.allclose(table["unit_0_applied_force_n"], table["unit_1_applied_force_n"])
    assert np.allclose((table["unit_0_applied_force_n"] + table["unit_1_applied_force_n"]).iloc[::5], f[:-1], atol=1e-6)
    assert (table["unit_0_position_m"] - table["unit_1_position_m"]).between(1200, 1400).all()
    assert frames["train/brake_pipe"]["pressure_pa"].iloc[-1] == pytest.approx(550e3)
    brake = yaml.safe_load((tmp_path / "imported" / "scenario.yaml").read_text())["brake"]
    assert brake["policy"] == "planned", "the scenario repeats the air brake of the driver"
    assert [event["reduction"] for event in brake["events"]] == [1e4, 2e4, 3e4, 4e4, 5e4]
    assert all(31 <= event["time"] <= 40 for event in brake["events"])
    other = tmp_path / "b"
    other.mkdir()
    apart = {**base, "unit_0_force_kn": f / 1e3, "unit_1_force_kn": np.full(time.size, 7.0)}
    take(other, capsys, text_of(apart), train=train)
    table = train_ato.load(other / "imported")["train/measurement"]
    assert np.allclose(table["unit_1_applied_force_n"], 7000.0)


def test_the_profile_alone_needs_no_force(tmp_path, capsys):
    """Breaks if a file with only a speed is refused, or --from-km has no effect."""
    (tmp_path / "gps.csv").write_text(recorded())
    out = tmp_path / "p.csv"
    options = ["--profile-only", "--ignore", "force_kn", "position_m", "--from-km", "12.5", "--out", str(out)]
    told = answer(capsys, "import", str(tmp_path / "gps.csv"), *TRAIN, *options)
    assert read_profile(out).position[0] == pytest.approx(12_500 - 59)
    assert told["distance_m"] == pytest.approx(metro(120.0)[1] - 500, rel=1e-3)
    assert "the unit of 'speed_kmh' (1.2 km at up to 54 km/h): no places, no force" in told["measured_notes"][0]
    assert "exists already" in complaint(capsys, "import", str(tmp_path / "gps.csv"), *TRAIN, *options)


def test_a_missing_file_and_a_taken_folder(tmp_path, capsys, monkeypatch):
    """Breaks if an existing folder is overwritten, or a partial run folder remains after a full disk."""
    assert main(["import", str(tmp_path / "no.csv"), *TRAIN]) == 2
    assert re.search(r"no\.csv: cannot be read .No such file", capsys.readouterr().err)
    (tmp_path / "run.csv").write_text(recorded())
    (tmp_path / "imported").mkdir()
    assert main(["import", str(tmp_path / "run.csv"), *TRAIN, "--out", str(tmp_path / "imported")]) == 2
    assert "exists already" in capsys.readouterr().err
    assert list((tmp_path / "imported").iterdir()) == []

    def full(setup, series, sink, progress):
        sink.add("/clock", measured_run.Tick(0), 0)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("train_ato.api.importing.write_messages", full)
    (tmp_path / "run.csv").write_text(recorded())
    assert main(["import", str(tmp_path / "run.csv"), *TRAIN, "--out", str(tmp_path / "deep" / "run")]) == 1
    assert "No space left" in capsys.readouterr().err and not (tmp_path / "deep").exists()


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
