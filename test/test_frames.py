"""Tables of a log, loaded and exported: equal bit for bit to single decoded messages, for logs of any tool."""

import csv
import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest
from engine_runs import record_run, setup_of
from frames_logs import TICK, write_foreign, write_log, write_two_trains
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import one_line
from rosbags.interfaces import Nodetype
from test_wire import LAYOUTS, LONG, message

import train_ato
from plant_sim.alignment import Alignment
from train_ato.cli.main import main
from train_ato.log import table_files as writing
from train_ato.log import table_loading as loading
from train_ato.log import tables
from train_ato.log.bag_layout import table_name
from train_ato.log.log_writer import RunLog
from train_ato.log.mcap_records import stream
from train_ato.log.reading import read_log
from train_ato.log.recorded import read_recording
from train_ato.log.run_folder import RunFolder, read_run_folder
from train_ato.log.table_columns import column, unit_of
from train_ato.log.table_files import file_names
from train_ato.messages.cdr import layout_of, typestore
from train_ato.messages.codec import Wire
from train_ato.messages.topic import SUPERVISED, Owner
from train_ato.messages.topics import BY_NAME, EPOCH_NS, FORMER, TOPICS
from train_ato.messages.types import AtoReport, Diagnostic, Trajectory
from train_ato.messages.variable_codec import message_key

BLOCKS = {
    "train/vehicles": [("{vehicle}_position_m", "position"), ("{vehicle}_speed_m_s", "velocity"),
                   ("{vehicle}_coupler_force_n", "coupler_force")],
    "train/measurement": [("{unit}_position_m", "position"), ("{coupler}_deflection_m", "deflection"),
                          ("{unit}_speed_m_s", "velocity"), ("{coupler}_deflection_rate_m_s", "rate"),
                          ("{unit}_applied_force_n", "applied"), ("{coupler}_force_n", "force")],
    "train/brake_pipe": [("pressure_pa", "pressure")],
    "train/brake_pipe_tail": [("pressure_pa", "pressure")],
    "train/brake_shoes": [("{vehicle}_shoe_force_n", "shoe_force")],
    "train/disturbance": [("{vehicle}_disturbance_force_n", "force")],
    "train/odometry": [("{odometer}_position_m", "position"), ("{since_balise}_m", "since_balise"),
                       ("{odometer}_speed_m_s", "speed")],
    "train/protection": [("{brake_line}_active", "active")],
    "atp/brake_release": [("{brake_line}_released", "released"), ("{brake_line}_alive", "alive")],
    "atp/speeds": [("{supervised_speed}_position_m", "position"), ("{supervised_speed}_speed_m_s", "speed")],
    "ato/state": [("{ato}_state", "state"), ("{ato}_position_m", "position"), ("{ato}_speed_m_s", "velocity")],
    "ato/reference": [("position_m", "position"), ("speed_m_s", "velocity"), ("acceleration_m_s2", "acceleration")],
    "ato/estimate": [("{unit}_disturbance_force_n", "force")],
    "ato/command": [("{unit}_force_n", "force")],
    "ato/brake_pipe_command": [("pressure_pa", "pressure")],
    "/clock": [],
}  # fmt: skip
"""Names of the columns of every topic, with their fields of the dataclass."""


def bits(values) -> list[int]:
    return np.ascontiguousarray(values, dtype=np.float64).view(np.int64).tolist()


def assert_equal(frames, run, layout) -> None:
    """Compare tables with the slow decoder, message by message and bit by bit."""
    slow: dict[str, list] = {}
    for topic, _, decoded in read_log(run, Wire(layout).decode):
        slow.setdefault(topic, []).append(decoded)
    assert set(slow) == set(frames)
    for topic, messages in slow.items():
        table = frames[topic]
        if topic == "/diagnostics":
            assert_diagnostics(table, messages)
        elif topic in ("ato/profile", "ato/limits"):
            assert_trajectories(table, messages)
        else:
            assert bits(table.index) == bits([entry.stamp * 1e-9 for entry in messages])
            expected = {
                name: values
                for pattern, field in BLOCKS[topic]
                for name, values in _entries(pattern, [getattr(m, field) for m in messages], layout)
            }
            assert [name for name in table.columns if name not in ("planned_s", "clock_s")] == list(expected)
            for name, values in expected.items():
                assert bits(table[name]) == bits(values), name
            if topic == "ato/reference":
                assert bits(table["planned_s"]) == bits([entry.planned * 1e-9 for entry in messages])


def _entries(pattern, rows, layout):
    values = np.array(rows)
    if "{" not in pattern:
        return [(pattern, values)]
    kind = pattern[1 : pattern.index("}")]
    return [(pattern.format(**{kind: name}), values[:, index]) for index, name in enumerate(layout.names(Owner(kind)))]


def assert_trajectories(table, messages) -> None:
    knots = [(m, k) for m in messages for k in range(m.time.size)]
    assert bits(table.index) == bits([m.time[k] * 1e-9 for m, k in knots])
    for name, field in (("position_m", "position"), ("speed_m_s", "velocity"), ("acceleration_m_s2", "acceleration")):
        if getattr(messages[0], field).size:
            assert bits(table[name]) == bits([getattr(m, field)[k] for m, k in knots])
        else:
            assert name not in table
    if "planned_s" in table:
        assert bits(table["planned_s"]) == bits([m.stamp * 1e-9 for m, _ in knots])


def assert_diagnostics(table, messages) -> None:
    messages = sorted(messages, key=lambda m: (m.stamp, m.node))
    assert bits(table.index) == bits([m.stamp * 1e-9 for m in messages])
    assert table["node"].tolist() == [m.node for m in messages]
    assert table["level"].tolist() == [m.level for m in messages]
    assert table["message"].tolist() == [m.message for m in messages]
    for (_, row), decoded in zip(table.iterrows(), messages, strict=True):
        said = {name: value for name, value in row.items() if name not in ("node", "level", "message")}
        expected = {message_key(key): value for key, value in decoded.values.items()}
        for name, value in said.items():
            if name not in expected:
                assert pd.isna(value), name
            elif isinstance(value, str):
                assert value == expected[name]
            else:
                assert bits([value]) == bits([float(expected[name])]), name


@pytest.mark.parametrize("layout", LAYOUTS, ids=str)
def test_tables_hold_what_was_written_bit_by_bit(tmp_path, layout):
    """Breaks if a column has the numbers of another one, a stamp is wrong, or the names of the layout are lost."""
    write_log(tmp_path, layout, 60)
    assert_equal(train_ato.load(tmp_path), tmp_path, layout)


@pytest.mark.parametrize("name", ["daqin_heavy_haul:disturbed+noise", "freight_consensus", "crh380a_funnel:replanned"])
def test_a_run_of_the_engine_opens_with_the_same_bits(tmp_path, name):
    """Breaks if a real log has another layout: several units, disturbances, a planned stop."""
    setup = setup_of(name, changes={"duration": 12.0})
    run = record_run(setup, tmp_path / "run")
    frames = train_ato.load(run)
    assert_equal(frames, run, setup.layout)
    said = frames["/diagnostics"]
    numbers = {str(key) for key in said.columns[said.dtypes == np.float64]}
    counts = {"unsound_measurements", "saturated_steps", "swaps", "commands_lost", "knots", "replans", "refusals",
              "held_steps", "unsound_estimates", "brake_interventions", "takeovers"}  # fmt: skip
    assert all(unit_of(key) or key in counts for key in numbers), numbers - counts


FORMER_LOG = Path(__file__).parent / "data" / "former_types.mcap"
"""Log of the time when states, counters and distances were in a JointState; the releases are lost at 2 s."""


def test_a_log_of_the_former_types_is_read_as_one_of_today(tmp_path):
    """Breaks if an older log loses a topic or a column, has other numbers, or cannot be verified."""
    types = {message.channel.topic: message.schema.name for message in stream(FORMER_LOG)}
    assert [name for name in FORMER if types.get(f"/{name}") == "sensor_msgs/msg/JointState"] == [
        "train/odometry", "train/protection", "atp/brake_release", "ato/state",
    ]  # fmt: skip
    setup, _ = read_run_folder(FORMER_LOG)
    run = record_run(setup, tmp_path / "run")
    before, after = train_ato.load(FORMER_LOG), train_ato.load(run)
    assert set(before) == set(after)
    for topic in set(after) - {"/diagnostics"}:
        pd.testing.assert_frame_equal(before[topic], after[topic], check_like=True, rtol=1e-6)
    assert before["train/protection"]["emergency_brake_active"].tolist() == [0.0] * 6 + [1.0] * 4
    assert before["ato/state"]["ato_state"].tolist() == [3.0] * 6 + [4.0, 4.0, 1.0, 1.0]
    former, today = (read_recording(log, setup) for log in (FORMER_LOG, run))
    for topic, samples in today.topics.items():
        for name, values in samples.values.items():
            np.testing.assert_allclose(former.topics[topic].values[name], values, rtol=1e-6, err_msg=f"{topic} {name}")
    found = train_ato.verify(FORMER_LOG, relative=1e-6)
    assert found.equal, found.first


def test_every_number_of_the_topic_table_has_a_column():
    loaded = set()
    for topic in TOPICS:
        for place in topic.places:
            unit = topic.description(place).unit
            if unit or topic.condition is SUPERVISED:
                owner = LONG.names(place.owner)[0] if place.owner else ""
                name = topic.column(place, owner) if topic.has_states else column(topic, place.path, owner)
                assert unit_of(name) == (unit if name else ""), name
                loaded.add((topic.name, place.field))
        fields = {entry.name for entry in dataclasses.fields(topic.message)} - {"stamp", "name"}
        if topic.message not in (Trajectory, Diagnostic):
            assert {field for name, field in loaded if name == topic.name} >= fields, topic.name


def test_topics_are_chosen_by_either_name(tmp_path):
    """Breaks if a selection changes the numbers or adds topics, or a wrong one has no line of its own."""
    write_log(tmp_path, LONG, 20)
    whole = train_ato.load(tmp_path)
    some = train_ato.load(tmp_path / "run.mcap", topics=["ato/command", "/train/vehicles", "/clock"])
    assert set(some) == {"ato/command", "train/vehicles", "/clock"}
    for topic, table in some.items():
        pd.testing.assert_frame_equal(table, whole[topic], check_exact=True)
    assert whole["/ato/command"] is whole["ato/command"]
    with pytest.raises(KeyError, match=r"no table 'train/vehiclez'; did you mean 'train/vehicles'"):
        whole["train/vehiclez"]
    for topics, text in (
        (["ato/comand"], r"run\.mcap: holds no topic 'ato/comand'; did you mean '/ato/command'\? \(it has"),
        ("ato/command", r"'ato/command' is one name; give a list"),
    ):
        with one_line(text):
            train_ato.load(tmp_path, topics=topics)


def test_a_killed_run_names_the_remedy(tmp_path):
    """Breaks if an incomplete log is shown as a complete one."""
    write_log(tmp_path, LONG, 50)
    whole = (tmp_path / "run.mcap").read_bytes()
    (tmp_path / "run.mcap").rename(tmp_path / "run.mcap.partial")
    for run in (tmp_path, tmp_path / "run.mcap.partial"):
        with pytest.raises(ValueError, match=r"run\.mcap\.partial: .*train-ato recover"):
            train_ato.load(run)
    with pytest.raises(ValueError, match="no such log"):
        train_ato.load(tmp_path / "elsewhere")
    for name, content in (("cut", whole[: len(whole) // 2]), ("text", b"time_s,speed\n" * 99)):
        (tmp_path / name).write_bytes(content)
        says = "no log: a text; name the log" if name == "text" else "damaged or no log: .*no message in it is readable"
        with one_line(f"{name}: {says}"):
            train_ato.load(tmp_path / name)


def test_padding_byte_order_and_the_order_of_names_are_free(tmp_path):
    """Padding of rclpy is undefined; another publisher may use big-endian numbers or another order of names."""
    types, wire = typestore(), Wire(LAYOUTS[2])
    joint_state = types.types["sensor_msgs/msg/JointState"]
    log = RunLog(tmp_path, [BY_NAME["train/measurement"]])
    sent = []
    for tick in range(12):
        seen = message("train/measurement", LAYOUTS[2], tick * TICK, seed=tick)
        data = wire.encode("train/measurement", seen)
        layout = layout_of(types, joint_state.__msgtype__, data)
        if tick % 4 == 1:
            loose = np.ones(len(data), dtype=bool)
            loose[layout.fixed == 255] = False
            for leaf in layout.leaves:
                if leaf.dtype is not None:
                    size = leaf.dtype.itemsize * (1 if leaf.count is None else leaf.count)
                    loose[leaf.start : leaf.start + size] = False
            assert loose.any()
            data = np.where(loose, 0xAB, np.frombuffer(data, np.uint8)).astype(np.uint8).tobytes()
        elif tick % 4:
            entry = types.deserialize_cdr(data, joint_state.__msgtype__)
            order = np.random.default_rng(tick).permutation(len(entry.name)) if tick % 4 == 2 else np.arange(6)
            entry.name = [entry.name[i] for i in order]
            for field in ("position", "velocity", "effort"):
                setattr(entry, field, getattr(entry, field)[order])
            data = bytes(types.serialize_cdr(entry, joint_state.__msgtype__, little_endian=tick % 4 != 3))
        log.add("train/measurement", EPOCH_NS + seen.stamp, EPOCH_NS + seen.stamp, data)
        sent.append(seen)
    log.close()
    table = train_ato.load(tmp_path)["train/measurement"]
    assert bits(table.index) == bits([entry.stamp * 1e-9 for entry in sent])
    for unit in range(3):
        assert bits(table[f"unit_{unit}_speed_m_s"]) == bits([entry.velocity[unit] for entry in sent])
    for index, coupler in enumerate(LAYOUTS[2].names(Owner.COUPLER)):
        assert bits(table[f"{coupler}_force_n"]) == bits([entry.force[index] for entry in sent])


def test_two_trains_in_one_log_do_not_mix(tmp_path):
    """Breaks if the topics of two namespaces are put into one table."""
    write_two_trains(tmp_path)
    frames = train_ato.load(tmp_path)
    assert set(frames) == {"/one/ato/command", "/two/ato/command"}
    assert frames["/one/ato/command"]["unit_0_force_n"].tolist() == [1.0, 2.0, 3.0]
    assert frames["/two/ato/command"]["unit_0_force_n"].tolist() == [-1.0, -2.0, -3.0]
    assert all(table_name(name) == "ato/command" for name in frames)


def test_logs_of_others_open_too(tmp_path):
    """Breaks if a foreign topic is read as one of the topic table, or stops the reading of the others."""
    write_foreign(tmp_path / "robot.mcap")
    frames = train_ato.load(tmp_path / "robot.mcap")
    assert set(frames) == {"/imu", "/rosout", "/joints", "/mine"}
    assert set(frames.left_out) == {"/camera", "/proto", "/broken"}
    assert "array of 3000 numbers" in frames.left_out["/camera"]
    assert frames["/imu"].index.tolist() == pytest.approx([0.0, 0.25, 0.5])
    assert frames["/imu"]["angular_velocity_z"].tolist() == [0.0, 0.5, 1.0]
    assert frames["/imu"]["orientation_covariance_8"].tolist() == [8.0] * 3
    assert frames["/imu"]["header_stamp_ns"].tolist() == [10**18, 10**18 + 250_000_000, 10**18 + 500_000_000]
    assert frames["/rosout"]["msg"].tolist() == [f"line {'x' * k}" for k in range(200)]
    assert frames["/joints"]["elbow_position"].tolist() == [1.0, 2.0]
    assert frames["/mine"]["depth"].tolist() == [3, 4]
    assert frames["/mine"]["depth"].dtype == np.int32
    for topic in ("/camera", "/proto"):
        with pytest.raises(ValueError, match=topic):
            train_ato.load(tmp_path / "robot.mcap", topics=[topic])


def _value(types, described, draw):
    """Return a random value of a field."""
    kind, detail = described
    if kind == Nodetype.BASE:
        if detail[0] == "string":
            return draw(st.text(alphabet="aZ_0é", max_size=5))
        if detail[0] == "bool":
            return draw(st.booleans())
        if detail[0].startswith("float"):
            return draw(st.floats(-1e6, 1e6, width=32))
        return draw(st.integers(0, 100))
    if kind == Nodetype.NAME:
        return _message(types, detail, draw)
    element, size = detail
    count = size if kind == Nodetype.ARRAY else draw(st.integers(0, 3))
    entries = [_value(types, element, draw) for _ in range(count)]
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        name = {"byte": "uint8", "char": "uint8"}.get(element[1][0], element[1][0])
        return np.array(entries, dtype=np.dtype(name))
    return entries


def _message(types, name, draw):
    values = {field: _value(types, described, draw) for field, described in types.fielddefs[name][1]}
    return types.types[name](**values)


def _at(content, path):
    for part in path.replace("[", ".[").split("."):
        content = content[int(part[1:-1])] if part.startswith("[") else getattr(content, part)
    return content


@settings(max_examples=300)
@given(st.data())
def test_a_layout_finds_every_part_of_any_message(data):
    """Compare with rosbags: one wrong rule of alignment shifts all following numbers."""
    types = typestore()
    names = sorted(name for name in types.fielddefs if "wstring" not in str(types.fielddefs[name]).lower())
    name = data.draw(st.sampled_from(names))
    content = _message(types, name, data.draw)
    raw = bytes(types.serialize_cdr(content, name, little_endian=data.draw(st.booleans())))
    layout = layout_of(types, name, raw)
    rows = np.frombuffer(raw * 2, np.uint8).reshape(2, -1)
    assert layout.fits(rows).all()
    records = rows.view(layout.dtype)[:, 0]
    for leaf in layout.leaves:
        expected = _at(content, leaf.path)
        if leaf.dtype is None:
            assert leaf.text == expected
        elif leaf.is_time:
            assert [tuple(entry) for entry in records[leaf.path]] == [(expected.sec, expected.nanosec)] * 2
        else:
            assert np.array_equal(records[leaf.path][1], expected), leaf.path


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    write_log(folder, LONG, 25)
    return folder


def test_parquet_gives_the_same_tables_with_units(run, capsys):
    """Breaks if a number loses a bit, the index is lost, or a unit is missing."""
    assert main(["export", str(run), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    frames = train_ato.load(run)
    assert {entry["topic"] for entry in told["files"]} == set(frames) and told["left_out"] == {}
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
    assert units["time_s"] == "s" and units["vehicle_17_coupler_force_n"] == "N"
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
        assert head == ["time_s", *frame.columns] and len(rows) == len(frame)
        for place, key in enumerate(head):
            values = frame.index if key == "time_s" else frame[key]
            texts = [row[place] for row in rows]
            if values.dtype.kind in "fi":
                assert bits([float(text or "nan") for text in texts]) == bits(values), key
            else:
                assert texts == ["" if pd.isna(value) else value for value in values], key


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


def test_parts_with_other_columns_and_late_messages_are_the_same_table(tmp_path, monkeypatch, capsys):
    """Breaks if a key that is a text once becomes numbers, keeps the form of its part, or a late message its place."""
    setup = setup_of("demo", "duration=1")
    told = [(0, {"a": "1", "b": "2"}), (40, {"a": "x"}), (20, {"c": "3.50"}), (20, {"c": "nan", "b": "7"}), (5, {})]
    folder = RunFolder.make(tmp_path / "run", "run")
    with folder.sink(setup) as sink:
        for at, (stamp, values) in enumerate(told):
            sink.add("/diagnostics", Diagnostic(stamp * 10**9, "plan"[: 4 - at % 2], 0, "7", values), stamp * 10**9)
        for stamp in (2 * 10**9, 10**9):
            sink.add("ato/state", AtoReport(stamp, *np.zeros((3, 1))), stamp)
    assert train_ato.load(folder.path)["ato/state"].index.tolist() == [1, 2]
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
    assert "No space left" in capsys.readouterr().err and not (tmp_path / "deep").exists()


def test_names_of_files_are_short_and_do_not_meet(tmp_path):
    """Breaks if 300 letters make a file name that no file system accepts, or two topics are written into one file."""
    topics = ["/" + "ä" * 300, "/" + "ä" * 299 + "b"]
    names = list(file_names(topics).values())
    assert len(set(names)) == 2
    for name in names:
        (tmp_path / f"{name}.parquet").write_text("")
    topics = ["/a/b_c", "/a_b/c", "a/b/c", "/"]
    assert file_names(topics) == {"/a/b_c": "a_b_c", "/a_b/c": "a_b_c_2", "a/b/c": "a_b_c_3", "/": "topic"}


def test_a_recording_for_rerun_has_the_numbers_of_the_log(demo_run, tmp_path):
    """Breaks if a curve has another time or value than the log, or a box is not at its vehicle."""
    run = demo_run("duration=20")
    chunk = pytest.importorskip("rerun.chunk", reason="needs pip install rerun-sdk, Python 3.11 or later")
    assert main(["export", str(run), "--rerun", "--out", str(tmp_path / "out")]) == 0
    chunks: dict[str, list] = {}  # a slow machine writes several for one path
    for entry in chunk.RrdReader(tmp_path / "out" / "run.rrd").stream():
        if not entry.is_static:
            chunks.setdefault(entry.entity_path, []).append(entry.to_record_batch())
    found = {path: pyarrow.Table.from_batches(batches).sort_by("simulated_time") for path, batches in chunks.items()}
    table = train_ato.open_run(run)["train/measurement"]
    speed = next(batch for path, batch in found.items() if path.endswith("train/measurement/unit_0_speed_m_s"))
    assert speed["simulated_time"].cast("int64").to_numpy() == pytest.approx(table.index.to_numpy() * 1e9)
    values = [entry[0] for entry in speed["Scalars:scalars"].to_pylist()]
    assert values == table["unit_0_speed_m_s"].tolist()
    assert not any("train/vehicles" in path for path in found), "a table of 424 columns is no set of curves"
    boxes, states = found["/scene/vehicles"], train_ato.open_run(run)["train/vehicles"]
    assert boxes.num_rows == 20 * 5 + 1
    positions = states[[name for name in states if str(name).endswith("position_m")]].to_numpy()[-1]
    track = Alignment(read_run_folder(run)[0].line).at(positions)
    centers = np.array(boxes["Boxes3D:centers"].to_pylist()[-1])
    assert centers[:, :2] == pytest.approx(np.column_stack((track.x, track.y)), abs=1e-3)


def test_the_missing_package_of_rerun_is_named(demo_run, tmp_path, monkeypatch, capsys):
    """Breaks if the base installation without the viewer's package ends in a traceback."""
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(["export", str(demo_run("duration=20")), "--rerun", "--out", str(tmp_path / "out")]) == 2
    assert "pip install rerun-sdk" in capsys.readouterr().err and not (tmp_path / "out").exists()
