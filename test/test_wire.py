"""Encoded messages: equal to the reference serialiser, decoded without loss, invalid ones rejected by name."""

import dataclasses
import struct
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from train_ato.judge.run_end import RunEnd
from train_ato.messages import types
from train_ato.messages.cdr import typestore
from train_ato.messages.codec import Wire, stamp_of
from train_ato.messages.topic import SUPERVISED, TrainLayout
from train_ato.messages.topics import BY_NAME, EPOCH_NS, TOPICS, topics_of
from train_ato.messages.variable_codec import _decode_knots, decode_trajectory, encode_trajectory, status_name

LONG = TrainLayout(106, 1, (0, 52), air_brake=True, disturbed=True, supervised=True)
LAYOUTS = [LONG, TrainLayout(1, 1), TrainLayout(8, 3, (0, 1, 6)), TrainLayout(2, 2, air_brake=True)]


def message(topic: str, layout: TrainLayout, stamp: int, seed: int = 1):
    """Return a message of a topic with values that are all different."""
    random = np.random.default_rng(seed)

    def values(count: int):
        return random.normal(size=count) * 1e5

    n, u, s = layout.n_vehicles, layout.n_units, len(layout.sensors)
    makers = {
        "/clock": lambda: types.Tick(stamp),
        "train/end": lambda: RunEnd("failed", "node observer failed: it left", 7).notice(stamp),
        "recorder/progress": lambda: types.Tick(stamp),
        "train/vehicles": lambda: types.VehicleStates(stamp, values(n), values(n), values(n)),
        "train/measurement": lambda: types.Measurement(stamp, *(values(k) for k in (u, u, u, s, s, s))),
        "train/brake_pipe": lambda: types.Pipe(stamp, 550e3),
        "train/brake_pipe_tail": lambda: types.Pipe(stamp, 560e3),
        "train/brake_shoes": lambda: types.BrakeShoes(stamp, values(n)),
        "train/disturbance": lambda: types.Disturbance(stamp, values(n)),
        "ato/profile": lambda: types.Trajectory(stamp, "train", np.arange(40) * 10**8, *(values(40) for _ in range(3))),
        "ato/limits": lambda: types.Trajectory(
            stamp, "limit", np.zeros(3, np.int64), values(3), np.abs(values(3)), np.zeros(0)
        ),
        "ato/reference": lambda: types.Reference(stamp, *values(3).tolist(), stamp // 3),
        "ato/estimate": lambda: types.DisturbanceEstimate(stamp, values(u)),
        "ato/force_parts": lambda: types.ForceParts(stamp, *(values(u) for _ in range(3))),
        "ato/command": lambda: types.Command(stamp, values(u)),
        "ato/brake_pipe_command": lambda: types.Pipe(stamp, 600e3),
        "/diagnostics": lambda: types.Diagnostic(stamp, "plant", 1, "läuft", {"energy": "1.5e9", "empty": ""}),
    }
    entry = BY_NAME[topic]
    if entry.condition is SUPERVISED:
        return entry.message(stamp, **{place.field: values(len(layout.names(place.owner))) for place in entry.places})
    return makers[topic]()


def same(first, second) -> bool:
    """Return True if two messages are equal, arrays by their bits."""
    return type(first) is type(second) and all(
        np.array_equal(np.asarray(a).view(np.uint8), np.asarray(b).view(np.uint8)) and a.dtype == b.dtype
        if isinstance(a, np.ndarray)
        else a == b
        for a, b in ((getattr(first, f.name), getattr(second, f.name)) for f in dataclasses.fields(first))
    )


CASES = [(layout, topic.name) for layout in LAYOUTS for topic in TOPICS if topic.exists(layout)]


@pytest.mark.parametrize(("layout", "topic"), CASES, ids=lambda case: str(case)[:40])
def test_every_message_comes_back_bit_by_bit(layout, topic):
    """Fails if fields are exchanged, the epoch of a stamp is wrong, or an array is cut."""
    wire = Wire(layout)
    for stamp in (0, 100_000_000, 86_400_000_000_000 + 1):
        sent = message(topic, layout, stamp)
        data = wire.encode(topic, sent)
        assert stamp_of(data) == stamp
        assert same(wire.decode(topic, data), sent)


@pytest.mark.parametrize(("layout", "topic"), CASES, ids=lambda case: str(case)[:40])
def test_bytes_are_those_of_the_reference_serialiser(layout, topic):
    """The bytes are equal after rosbags reads and writes them."""
    wire, kind = Wire(layout), BY_NAME[topic].type
    data = wire.encode(topic, message(topic, layout, 5_100_000_000))
    again = bytes(typestore().serialize_cdr(typestore().deserialize_cdr(data, kind), kind))
    assert data[: len(again)] == again
    assert len(data) - len(again) < 4
    assert not any(data[len(again) :])


@pytest.mark.parametrize("name", ["train", "limit", "t", "to", "car", "line", "wagons", "locomotive"])
@pytest.mark.parametrize("knots", [1, 2, 7])
def test_profiles_do_not_depend_on_the_length_of_their_name(name, knots):
    """Fails if the offset of the knots is fixed for a name of five letters: alignment moves them by 4 bytes."""
    values = np.random.default_rng(knots).normal(size=(3, knots))
    sent = types.Trajectory(100_000_000, name, np.arange(knots) * 250_000_001, *values)
    data = encode_trajectory(sent)
    kind = "trajectory_msgs/msg/JointTrajectory"
    read = typestore().deserialize_cdr(data, kind)
    assert data == bytes(typestore().serialize_cdr(read, kind))
    assert [point.velocities[0] for point in read.points] == values[1].tolist()
    assert _decode_knots(data) is not None, "the fast way is not taken"
    assert same(decode_trajectory(data), sent)


def test_fields_carry_the_names_and_places_of_the_table():
    """A tool finds every series by name; unit and coupler values must not be swapped."""
    sent = message("train/measurement", LONG, 0)
    read = typestore().deserialize_cdr(Wire(LONG).encode("train/measurement", sent), "sensor_msgs/msg/JointState")
    assert list(read.name) == ["unit_0", "coupler_0", "coupler_52"]
    assert list(read.position) == [*sent.position, *sent.deflection]
    assert list(read.velocity) == [*sent.velocity, *sent.rate]
    assert list(read.effort) == [*sent.applied, *sent.force]
    assert read.header.stamp.sec * 10**9 + read.header.stamp.nanosec == EPOCH_NS
    knots = typestore().deserialize_cdr(
        Wire(LONG).encode("ato/profile", message("ato/profile", LONG, 0)), "trajectory_msgs/msg/JointTrajectory"
    )
    assert list(knots.joint_names) == ["train"]
    assert (knots.points[13].time_from_start.sec, knots.points[13].time_from_start.nanosec) == (1, 300_000_000)


TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"


@pytest.mark.parametrize("topic", ["ato/profile", "ato/reference"])
def test_time_from_start_counts_from_the_stamp(topic):
    """Breaks if durations count from the start of the run, or depend on the frame, or the speed limits have any."""
    wire, stamp = Wire(LONG), 12_300_000_000
    sent = message(topic, LONG, stamp)
    read = typestore().deserialize_cdr(wire.encode(topic, sent), TRAJECTORY)
    first = sent.time[0] if topic == "ato/profile" else sent.planned
    since = read.points[0].time_from_start
    assert since.sec * 10**9 + since.nanosec == first - stamp
    assert read.header.frame_id == "line"
    read.header.frame_id = ""
    assert same(wire.decode(topic, bytes(typestore().serialize_cdr(read, TRAJECTORY))), sent)
    limits = typestore().deserialize_cdr(wire.encode("ato/limits", message("ato/limits", LONG, stamp)), TRAJECTORY)
    assert all(point.time_from_start.sec == point.time_from_start.nanosec == 0 for point in limits.points)


def test_frames_are_the_line_and_the_vehicles_of_the_pressures():
    """Breaks if a tool cannot place a pressure on the train or takes a chainage for a coordinate."""
    frames = {
        topic.name: typestore()
        .deserialize_cdr(Wire(LONG).encode(topic.name, message(topic.name, LONG, 0)), topic.type)
        .header.frame_id
        for topic in topics_of(LONG)
        if "header" in typestore().types[topic.type].__dataclass_fields__
    }
    assert {name: frame for name, frame in frames.items() if frame} == {
        "train/brake_pipe": "vehicle_0", "train/brake_pipe_tail": "vehicle_105", "ato/brake_pipe_command": "vehicle_0",
        "ato/profile": "line", "ato/limits": "line", "ato/reference": "line",
    }  # fmt: skip


def test_diagnostics_are_plain_numbers_with_the_unit_in_the_key():
    """Breaks if a tool gets a list, a key without unit, hardware or part, or the program gets another key back."""
    values = {"delay": "[0.8, 0.4]", "lag": "0.4", "delay_brake": "[]", "energy_traction": "1e3", "swaps": "2"}
    sent = types.Diagnostic(0, "controller", 0, "engaged", values)
    data = Wire(LONG).encode("/diagnostics", sent)
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    (status,) = (found := typestore().deserialize_cdr(data, kind)).status
    assert (status.hardware_id, status.name) == ("ato", "controller: law")
    assert {pair.key: pair.value for pair in status.values} == {
        "delay_0_s": "0.8", "delay_1_s": "0.4", "lag_s": "0.4", "energy_traction_j": "1e3", "swaps": "2",
    }  # fmt: skip
    del values["delay_brake"]
    assert Wire(LONG).decode("/diagnostics", data) == sent
    status.name = "controller"  # an older log, or another program
    older = bytes(typestore().serialize_cdr(found, kind))
    assert Wire(LONG).decode("/diagnostics", older) == sent and status_name(older) == "controller"


@pytest.mark.parametrize(
    ("strongest", "level", "text"),
    [(0, 0, "released"), (1, 1, "traction cut off"), (2, 1, "service brake"), (3, 1, "emergency brake")],
)
def test_the_strongest_brake_is_the_status_of_a_state(strongest, level, text):
    """Breaks if a weaker brake hides a stronger one, or a brake in effect is an error of the train."""
    active = np.array([float(number <= strongest) for number in (1, 2, 3)])
    for topic, state in (
        ("train/protection", types.ProtectionState(0, active)),
        ("atp/brake_release", types.BrakeRelease(0, 1.0 - active, np.zeros(3))),
    ):
        found = typestore().deserialize_cdr(Wire(LONG).encode(topic, state), BY_NAME[topic].type)
        (status,) = found.status
        assert (status.level, status.message) == (level, text)


@settings(max_examples=60, deadline=None)
@given(
    stamp=st.integers(0, 10**15),
    force=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=3, max_size=3),
)
def test_any_finite_command_survives(stamp, force):
    """Property over all finite doubles, subnormals and -0.0 included."""
    wire = Wire(LAYOUTS[2])
    sent = types.Command(stamp, np.array(force))
    assert same(wire.decode("ato/command", wire.encode("ato/command", sent)), sent)


def test_padding_and_byte_order_of_other_publishers_do_not_matter():
    """Padding of other publishers is undefined; a reader that compares all bytes would reject their messages."""
    wire = Wire(LAYOUTS[2])
    sent = message("ato/command", LAYOUTS[2], 700_000_000)
    data = bytearray(wire.encode("ato/command", sent))
    gap = data.index(b"unit_0\x00") + 7
    data[gap] = 0xAA
    assert same(wire.decode("ato/command", bytes(data)), sent)
    swapped = b"\x00\x00\x00\x00" + struct.pack(">iI", EPOCH_NS // 10**9, 700_000_000)
    assert stamp_of(swapped) == 700_000_000
    assert wire.decode("/clock", swapped) == types.Tick(700_000_000)


def _header():
    kinds = typestore().types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=EPOCH_NS // 10**9, nanosec=0)
    return kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="map")


def _joint_state(names, **fields):
    arrays = {field: np.array(fields.get(field, []), dtype=float) for field in ("position", "velocity", "effort")}
    whole = typestore().types["sensor_msgs/msg/JointState"](header=_header(), name=names, **arrays)
    return bytes(typestore().serialize_cdr(whole, "sensor_msgs/msg/JointState"))


def test_another_frame_and_unused_fields_are_accepted():
    """A foreign controller may fill fields that are not in the table."""
    data = _joint_state(["unit_0"], position=[1.0], effort=[5.0])
    assert Wire(LONG).decode("ato/command", data).force.tolist() == [5.0]


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (_joint_state(["unit_1"], effort=[1.0]), r"names \['unit_1'\] where \['unit_0'\] are due; `train-ato list"),
        (_joint_state([*"abcdefgh"], effort=[1.0] * 8), r"names \['a', 'b', 'c', ... 'h'\] \(8\) where"),
        (_joint_state(["unit_0", "unit_1"], effort=[1.0, 2.0]), "names"),
        (_joint_state(["unit_0"], effort=[]), "effort has 0 values where 1 are due"),
        (_joint_state(["unit_0"], effort=[float("nan")]), "not finite: nan"),
        (_joint_state(["unit_0"], effort=[float("-inf")]), "not finite: -inf"),
        (b"\x00\x01\x00\x00" + bytes(3), "not a sensor_msgs/msg/JointState"),
        (b"", "not a sensor_msgs/msg/JointState"),
    ],
)
def test_wrong_commands_are_refused_by_name(data, says):
    with pytest.raises(ValueError, match="^ato/command: .*" + says):
        Wire(LONG).decode("ato/command", data)


@pytest.mark.parametrize(
    ("topic", "wrong", "says"),
    [
        ("ato/command", types.Command(0, np.array([np.nan])), "effort is not finite: nan"),
        ("ato/command", types.Command(0, np.zeros(2)), "1 are due|\\[1\\] are due"),
        ("ato/command", types.Command(0, np.zeros(1, dtype=np.float32)), "float32, not float64"),
        ("ato/estimate", types.DisturbanceEstimate(0, np.array([1], dtype=np.int64)), "int64, not float64"),
        ("ato/reference", types.Reference(0, 1.0, float("inf"), 0.0), "velocities is not finite"),
        ("ato/profile", types.Trajectory(0, "train", np.arange(3), np.zeros(3), np.zeros(2), np.zeros(3)), "velocity"),
        ("ato/profile", types.Trajectory(0, "t", np.arange(1), np.array([np.nan]), np.zeros(1), np.zeros(1)), "finite"),
    ],
)
def test_a_wrong_message_is_never_sent(topic, wrong, says):
    """An int64 array has the size of a float64 array: without the type check wrong numbers would be sent."""
    with pytest.raises(ValueError, match=says):
        Wire(LONG).encode(topic, wrong)


STATES = "diagnostic_msgs/msg/DiagnosticArray"


def _states(*pairs, statuses=1):
    """Return states as another program sends them: without texts, with a frame."""
    kinds = typestore().types
    values = [kinds["diagnostic_msgs/msg/KeyValue"](key=key, value=value) for key, value in pairs]
    status = kinds["diagnostic_msgs/msg/DiagnosticStatus"](level=0, name="", message="", hardware_id="", values=values)
    return bytes(typestore().serialize_cdr(kinds[STATES](header=_header(), status=[status] * statuses), STATES))


def test_states_are_named_and_counters_are_plain_numbers():
    """Breaks if a tool shows the state of another time, or a reader takes the words for the values."""
    wire = Wire(LONG)
    sent = types.BrakeRelease(10**8, np.array([0.0, 1.0, 1.0]), np.full(3, 1e6))
    data = wire.encode("atp/brake_release", sent)
    (status,) = typestore().deserialize_cdr(data, STATES).status
    assert (status.level, status.name, status.message, status.hardware_id) == (
        1, "supervisor: release", "traction cut off", "atp",
    )  # fmt: skip
    assert {pair.key: pair.value for pair in status.values} == {
        "traction_released": "0", "service_brake_released": "1", "emergency_brake_released": "1",
        "traction_alive": "1000000", "service_brake_alive": "1000000", "emergency_brake_alive": "1000000",
    }  # fmt: skip
    assert same(wire.decode("atp/brake_release", data.replace(b"cut off", b"cut OFF")), sent)
    for state in types.AtoState:
        report = types.AtoReport(0, np.array([-0.0]), np.array([np.nan]), np.array([float(state)]))
        data = wire.encode("ato/state", report)
        assert same(wire.decode("ato/state", data), report)
        assert typestore().deserialize_cdr(data, STATES).status[0].message == state.text


def test_states_of_another_program_are_read_by_their_keys():
    """Breaks if another order, text or frame is refused, or the state of the ATO needs its motion."""
    wire = Wire(LONG)
    keys = ("traction", "service_brake", "emergency_brake")
    data = _states(*((f"{key}_alive", " 7.0") for key in keys), *((f"{key}_released", "1") for key in keys))
    assert same(wire.decode("atp/brake_release", data), types.BrakeRelease(0, np.ones(3), np.full(3, 7.0)))
    report = wire.decode("ato/state", _states(("ato_state", "3")))
    assert report.state.tolist() == [3.0] and np.isnan(report.position[0])


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (
            _states(("traction_active", "1"), ("service_brake_active", "0")),
            "emergency_brake_active: missing or not finite$",
        ),
        (_states(*((f"{key}_active", "True") for key in ("traction", "service_brake"))), "to float: 'True'"),
        (_states(statuses=0), "missing"),
        (_states(statuses=2), "missing"),
        (_joint_state(["traction"], position=[1.0]), "not a diagnostic_msgs/msg/DiagnosticArray"),
        (b"", "not a diagnostic_msgs/msg/DiagnosticArray|hold no stamp"),
    ],
)
def test_wrong_states_are_refused_by_name(data, says):
    """Breaks if a missing or a wrong state counts as a released brake."""
    with pytest.raises(ValueError, match="^train/protection: .*" + says):
        Wire(LONG).decode("train/protection", data)


def test_reports_of_former_logs_have_their_time_in_seconds():
    """Breaks if a run behind a live train, recorded before, cannot be repeated."""
    wire = Wire(dataclasses.replace(LONG, reports=True, behind=True))
    names, stamp = ["front", "rear", "stop"], 400_000_000
    former = _joint_state(names, position=[9.0, 1.0, 3.0], velocity=[2.0] * 3, effort=[0.4] * 3)
    found = wire.decode("train/ahead", former)
    assert (found.stamp, found.position.tolist(), found.speed.tolist(), found.time) == (0, [9, 1, 3], [2] * 3, stamp)
    last = wire.decode(
        "train/report", _joint_state(names, **dict.fromkeys(("position", "velocity", "effort"), [np.nan] * 3))
    )
    assert np.isnan(last.position).all() and last.time == 0
    data = wire.encode("train/ahead", types.TrainAhead(5 * stamp, found.position, found.speed, stamp))
    assert same(wire.decode("train/ahead", data), types.TrainAhead(5 * stamp, found.position, found.speed, stamp))
    (point,) = (read := typestore().deserialize_cdr(data, TRAJECTORY)).points
    assert read.joint_names == names and point.time_from_start.sec * 10**9 + point.time_from_start.nanosec == -4 * stamp


def test_topics_exist_only_where_there_is_something_to_tell():
    plain = Wire(LAYOUTS[1])
    with pytest.raises(KeyError):
        plain.encode("ato/brake_pipe_command", types.Pipe(0, 6e5))
    assert {topic.name for topic in topics_of(LONG)} - {topic.name for topic in topics_of(LAYOUTS[1])} == {
        "train/brake_pipe", "train/brake_pipe_tail", "train/brake_shoes", "train/disturbance", "train/odometry",
        "train/protection", "atp/brake_release", "atp/speeds", "ato/state", "ato/brake_pipe_command",
    }  # fmt: skip


def test_equal_bytes_are_decoded_once_and_others_again():
    """Breaks if a node receives the message before: the bytes differ in one number only, with the same stamp."""
    wire = Wire(LAYOUTS[2])
    sent = [types.Command(10**8, np.array([1.0, 2.0, value])) for value in (3.0, 4.0)]
    first, second = (wire.encode("ato/command", one) for one in sent)
    assert wire.decode_shared("ato/command", first) is wire.decode_shared("ato/command", bytes(bytearray(first)))
    assert same(wire.decode_shared("ato/command", second), sent[1])
    assert same(wire.decode_shared("ato/command", first), sent[0])
    assert wire.decode("ato/command", first) is not wire.decode("ato/command", first)


def test_a_long_profile_is_not_kept_after_it_is_decoded():
    """Breaks if a run of a day keeps the bytes of its profile, 56 of each knot, beside what the nodes need."""
    wire, column = Wire(LAYOUTS[0]), np.arange(10_000.0)
    data = wire.encode("ato/profile", types.Trajectory(0, "train", np.arange(10_000) * 10**8, column, column, column))
    references = sys.getrefcount(data)
    assert wire.decode_shared("ato/profile", data).time.size == 10_000
    assert sys.getrefcount(data) == references
