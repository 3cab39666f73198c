"""Export of tables to files: recorded numbers with units for other tools, or no file."""

import csv
import json

import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest
from frames_logs import write_foreign, write_log
from test_wire import LONG

import train_ato
from train_ato.cli.main import main
from train_ato.log import table_files as writing
from train_ato.log import table_loading as loading
from train_ato.log import tables
from train_ato.log.run_folder import RunFolder
from train_ato.log.table_files import file_names
from train_ato.messages.types import Diagnostic
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    write_log(folder, LONG, 25)
    return folder


def bits(values) -> list[int]:
    return np.ascontiguousarray(values, dtype=np.float64).view(np.int64).tolist()


def test_parquet_gives_the_same_tables_with_units(run, capsys):
    """Breaks if a number loses a bit, the index is lost, or a unit is missing."""
    assert main(["export", str(run), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    frames = train_ato.load(run)
    assert {entry["topic"] for entry in told["files"]} == set(frames)
    assert told["left_out"] == {}
    for entry in told["files"]:
        path = run / "export" / entry["file"]
        assert entry["size_bytes"] == path.stat().st_size
        table, frame = pd.read_parquet(path), frames[entry["topic"]]
        assert (entry["rows"], entry["columns"]) == frame.shape
        pd.testing.assert_frame_equal(table, frame, check_exact=True)
        assert table.index.name == "time_s"
    schema = pyarrow.parquet.read_schema(run / "export" / "train_vehicles.parquet")
    assert schema.names[0] == "time_s"
    units = {name: schema.field(name).metadata[b"unit"].decode() for name in schema.names}
    assert units["time_s"] == "s"
    assert units["vehicle_17_coupler_force_n"] == "N"
    assert units["vehicle_105_speed_m_s"] == "m/s"
    assert schema.metadata[b"topic"] == b"train/vehicles"


def test_csv_loses_no_bit(run, tmp_path, capsys):
    """Breaks if numbers are rounded in the text, or a text with a comma splits a row."""
    out = tmp_path / "tables"
    assert main(["export", str(run), "--csv", "--out", str(out), "--topics", "train/vehicles", "/diagnostics"]) == 0
    assert "train_vehicles.csv" in capsys.readouterr().out
    assert sorted(path.name for path in out.iterdir()) == ["diagnostics.csv", "train_vehicles.csv"]
    frames = train_ato.load(run)
    for name, topic in (("train_vehicles", "train/vehicles"), ("diagnostics", "/diagnostics")):
        with (out / f"{name}.csv").open(newline="") as file:
            head, *rows = csv.reader(file)
        frame = frames[topic]
        assert head == ["time_s", *frame.columns]
        assert len(rows) == len(frame)
        for place, column in enumerate(head):
            values = frame.index if column == "time_s" else frame[column]
            texts = [row[place] for row in rows]
            if values.dtype.kind in "fi":
                assert bits([float(text or "nan") for text in texts]) == bits(values), column
            else:
                assert texts == ["" if pd.isna(value) else value for value in values], column


def test_both_formats_of_a_log_that_is_not_ours(tmp_path, capsys):
    """Breaks if a log of another tool cannot be exported, or omitted topics are not reported."""
    write_foreign(tmp_path / "robot.mcap")
    assert main(["export", str(tmp_path / "robot.mcap"), "--csv", "--parquet"]) == 0
    assert "omitted: /camera" in capsys.readouterr().out
    names = {path.name for path in (tmp_path / "robot-export").iterdir()}
    assert names == {
        f"{topic}.{ending}" for topic in ("imu", "rosout", "joints", "mine") for ending in ("csv", "parquet")
    }
    assert pd.read_csv(tmp_path / "robot-export" / "mine.csv")["depth"].tolist() == [3, 4]
    assert pd.read_parquet(tmp_path / "robot-export" / "rosout.parquet")["line"].tolist() == list(range(200))


def assert_parts_are_the_tables(run, out, monkeypatch, capsys, size):
    """Export a log in parts of ``size`` bytes and messages, and compare the files with the loaded tables."""
    monkeypatch.setattr(loading, "PART", size)
    monkeypatch.setattr(loading, "REPORTS_OF_PART", size)
    monkeypatch.setattr(tables, "PORTION", size)
    assert main(["export", str(run), "--out", str(out), "--json"]) == 0
    frames = train_ato.load(run)
    files = json.loads(capsys.readouterr().out)["files"]
    assert {entry["topic"] for entry in files} == {topic for topic, frame in frames.items() if len(frame)}
    for entry in files:
        table = pd.read_parquet(out / entry["file"])
        pd.testing.assert_frame_equal(table, frames[entry["topic"]], check_exact=True, check_dtype=True)


@pytest.mark.parametrize("size", [1, 30_000])
def test_a_table_in_parts_is_the_same_table(run, tmp_path, monkeypatch, capsys, size):
    """Breaks if a part is lost, exchanged, sorted by itself, or has the columns of the first part only."""
    assert_parts_are_the_tables(run, tmp_path / "ours", monkeypatch, capsys, size)
    write_foreign(tmp_path / "robot.mcap")
    assert_parts_are_the_tables(tmp_path / "robot.mcap", tmp_path / "others", monkeypatch, capsys, size)


def test_parts_with_other_columns_and_late_diagnostics_are_the_same_table(tmp_path, monkeypatch, capsys):
    """Breaks if a key that is a text once becomes numbers, keeps the form of its part, or a late message its place."""
    setup = prepare(*load_scenario("demo", ("duration=1",)))
    told = [(0, {"a": "1", "b": "2"}), (40, {"a": "x"}), (20, {"c": "3.50"}), (20, {"c": "nan", "b": "7"}), (5, {})]
    folder = RunFolder.make(tmp_path / "run", "run")
    with folder.sink(setup) as sink:
        for at, (stamp, values) in enumerate(told):
            sink.add("/diagnostics", Diagnostic(stamp * 10**9, "plan"[: 4 - at % 2], 0, "7", values), stamp * 10**9)
    assert_parts_are_the_tables(folder.path, tmp_path / "out", monkeypatch, capsys, 1)
    table = pd.read_parquet(tmp_path / "out" / "diagnostics.parquet")
    assert table.index.tolist() == [0, 5, 20, 20, 40]
    assert table["a"].dropna().to_dict() == {0.0: "1", 40.0: "x"}
    assert table["b"].tolist()[0] == 2.0 and table["message"].tolist() == ["7"] * 5


def test_a_full_disk_leaves_nothing(run, tmp_path, monkeypatch, capsys):
    """Breaks if an incomplete export remains."""
    real = writing.FORMATS["csv"]

    def full(schema, parts, path):
        if path.name.startswith("train_measurement"):
            raise OSError(28, "No space left on device")
        return real(schema, parts, path)

    monkeypatch.setitem(writing.FORMATS, "csv", full)
    assert main(["export", str(run), "--csv", "--out", str(tmp_path / "deep" / "tables")]) == 1
    assert "No space left" in capsys.readouterr().err
    assert not (tmp_path / "deep").exists()


def test_long_topic_names_become_file_names(tmp_path):
    """Breaks if a topic of 300 letters makes a file name that no file system accepts."""
    topics = ["/" + "ä" * 300, "/" + "ä" * 299 + "b"]
    names = list(file_names(topics).values())
    assert len(set(names)) == 2
    for name in names:
        (tmp_path / f"{name}.parquet").write_text("")


def test_names_of_files_do_not_meet():
    """Breaks if two topics are written into one file."""
    topics = ["/a/b_c", "/a_b/c", "a/b/c", "/"]
    assert file_names(topics) == {"/a/b_c": "a_b_c", "/a_b/c": "a_b_c_2", "a/b/c": "a_b_c_3", "/": "topic"}
