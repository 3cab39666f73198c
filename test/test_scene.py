"""The train on its line and layouts for other viewers: in a log, for Foxglove, PlotJuggler and in a graph."""

import asyncio
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import answer, complaint
from engine_runs import setup_of
from frames_logs import write_foreign
from report_runs import drive, without
from rosbags.rosbag2 import Reader

from plant_sim.alignment import Alignment
from train_ato.cli import main
from train_ato.log.mcap_records import stream
from train_ato.log.reading import iter_raw
from train_ato.log.run_folder import read_run_folder
from train_ato.messages.cdr import typestore
from train_ato.messages.codec import Wire
from train_ato.messages.topics import BY_NAME, EPOCH_NS
from train_ato.messages.types import VehicleStates
from train_ato.scenario.setup import RunSetup
from train_ato.view import train_scene as scene
from train_ato.view.scene_picture import scene_at

pytestmark = pytest.mark.usefixtures("without_figure")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record 20 s of the 106-vehicle train."""
    return drive(tmp_path_factory.mktemp("scene"), "run", "demo", "--set=duration=20")


@pytest.fixture(scope="module")
def setup(run: Path) -> RunSetup:
    return read_run_folder(run)[0]


def decoded(messages) -> dict:
    """Return the messages by topic, decoded by rosbags, after a check that rosbags writes the same bytes."""
    found = {}
    for topic, data in messages:
        found[topic.name] = typestore().deserialize_cdr(data, topic.type)
        again = bytes(typestore().serialize_cdr(found[topic.name], topic.type))
        assert data[: len(again)] == again and len(data) - len(again) < 4, topic.name
    return found


def states(setup: RunSetup, head: float, force: float = 0.0) -> VehicleStates:
    offsets = np.array(setup.consist.offsets)
    coupler = np.zeros(offsets.size)
    coupler[:-1] = force
    return VehicleStates(3_200_000_000, head - offsets, np.zeros(offsets.size), coupler)


def rotated(rotation, vector) -> np.ndarray:
    """Return a vector turned by a quaternion message."""
    q = np.array([rotation.x, rotation.y, rotation.z])
    v = np.array(vector, dtype=float)
    return v + 2 * np.cross(q, np.cross(q, v) + rotation.w * v)


def test_every_vehicle_is_on_the_track_and_looks_along_it(setup: RunSetup) -> None:
    """Breaks if a vehicle is beside the track, turned to the wrong side, or nose down on a rising grade (REP 103)."""
    head = setup.line.curves[3].end + 300.0  # the train, 1284 m long, is in the curve and behind it
    found = decoded(scene.TrainScene(setup).at(states(setup, head)))
    ahead = Alignment(setup.line).at(states(setup, head + 1.0).position)
    here = Alignment(setup.line).at(states(setup, head).position)
    for number, transform in enumerate(found["/tf"].transforms[:-1]):
        assert (transform.header.frame_id, transform.child_frame_id) == ("map", f"vehicle_{number}")
        assert transform.header.stamp.sec * 10**9 + transform.header.stamp.nanosec == EPOCH_NS + 3_200_000_000
        place = transform.transform.translation
        assert (place.x, place.y, place.z) == (here.x[number], here.y[number], here.z[number])
        forward = rotated(transform.transform.rotation, (1, 0, 0))
        step = np.array([ahead.x - here.x, ahead.y - here.y, ahead.z - here.z])[:, number]
        np.testing.assert_allclose(forward, step / np.linalg.norm(step), atol=2e-3)
        np.testing.assert_allclose(rotated(transform.transform.rotation, (0, 1, 0))[2], 0.0, atol=1e-12)
    poses = found["/scene/vehicles"]
    assert poses.header.frame_id == "map" and len(poses.poses) == 106
    assert poses.poses[105].position.x == here.x[105]
    boxes = found["/scene/markers"].markers
    assert [box.id for box in boxes] == list(range(106))
    assert {box.header.frame_id for box in boxes} == {"map"}
    assert boxes[3].scale.x == pytest.approx(setup.consist.vehicles[3].length - 0.7)
    assert np.ptp(here.heading) > 0.01, "the train is on a straight: the test finds nothing"


def test_a_place_of_the_profile_is_on_the_track_by_the_frame_of_its_message(setup: RunSetup) -> None:
    """Fails if `line` has no transform, or a place of `ato/reference` is drawn away from the train."""
    head = setup.line.curves[3].end - 100.0
    first, *_, line = decoded(scene.TrainScene(setup).at(states(setup, head)))["/tf"].transforms
    frame = BY_NAME["ato/reference"].frame_id(setup.layout)
    assert (line.header.frame_id, line.child_frame_id) == (first.child_frame_id, frame)
    for place in (head, head + 20.0):
        offset = np.array([place, 0, 0]) + [getattr(line.transform.translation, axis) for axis in "xyz"]
        drawn = rotated(first.transform.rotation, rotated(line.transform.rotation, offset))
        drawn += [getattr(first.transform.translation, axis) for axis in "xyz"]
        track = Alignment(setup.line).at(np.array([place]))
        np.testing.assert_allclose(drawn, [track.x[0], track.y[0], track.z[0]], atol=1e-9 if place == head else 0.5)


def test_markers_have_the_colour_of_the_coupler_force(setup: RunSetup) -> None:
    """Breaks if draft and buff are exchanged, or the colours are those of another coupler."""
    for force, color in ((300e3, scene.DRAFT), (-300e3, scene.BUFF)):
        boxes = decoded(scene.TrainScene(setup, 300e3).at(states(setup, 11_000.0, force)))["/scene/markers"].markers
        assert (boxes[0].color.r, boxes[0].color.g, boxes[0].color.b) == pytest.approx(color)
        assert boxes[0].color.a == 1.0
    assert scene.larger_coupler_force(np.array([1.0, -3.0, 2.0, 0.0])).tolist() == [1.0, -3.0, -3.0, 2.0]
    half = scene.force_color(np.array([150e3, 0.0]), 300e3)
    np.testing.assert_allclose(half[0], (np.array(scene.DRAFT) + 0.85) / 2)
    np.testing.assert_allclose(half[1], 0.85)


def test_line_and_base_are_static_frames(setup: RunSetup) -> None:
    """Breaks if a stop, an end of the line or the base of the train has no frame, or the track is no path."""
    found = decoded(scene.TrainScene(setup).begin())
    frames = {entry.child_frame_id: entry for entry in found["/tf_static"].transforms}
    assert {"line_begin", "line_end", "base_link"} <= set(frames)
    assert sum(name.startswith("stop_") for name in frames) == len(setup.line.stops)
    assert frames["base_link"].header.frame_id == "vehicle_0"
    assert frames["base_link"].transform.rotation.w == 1.0
    end = Alignment(setup.line).at(np.array([setup.line.end]))
    assert frames["line_end"].transform.translation.y == end.y[0]
    track = found["/scene/track"].poses
    assert (track[-1].pose.position.x, track[-1].pose.position.y) == (end.x[0], end.y[0])


def test_a_line_with_coordinates_gives_a_position_fix() -> None:
    """Breaks if latitude and longitude are exchanged, or a line without coordinates has a fix."""
    plain = setup_of()
    assert scene.FIX not in scene.TrainScene(plain).topics
    line = plain.line.model_dump(by_alias=True) | {
        "coordinates": [{"at": 0, "latitude": 40, "longitude": 113}, {"at": 50_000, "latitude": 40, "longitude": 113.5}]
    }
    located = setup_of("demo", changes={"plant": {"line": line}})
    fix = decoded(scene.TrainScene(located).at(states(located, 25_000.0)))["/scene/fix"]
    assert (fix.latitude, fix.longitude) == pytest.approx((40.0, 113.25))
    assert fix.header.frame_id == "vehicle_0" and np.isnan(fix.altitude)


def test_the_rate_is_kept(run: Path, setup: RunSetup) -> None:
    """Breaks if the scene has a message for every tick, or loses its first one."""
    sampler = scene.TrainScene(setup, rate=2.0)
    stamps = [stamp for _, stamp, data in iter_raw(run, ("train/vehicles",)) if sampler.take(data)]
    assert stamps == [number * 500_000_000 for number in range(41)]


def test_the_exported_log_has_all_of_the_run_and_the_scene(run: Path, setup: RunSetup, tmp_path: Path, capsys) -> None:
    """Breaks if a message of the run is lost, the scene has other times, or the layout does not show it."""
    out, figure = tmp_path / "scene", tmp_path / "scene.png"
    told = answer(capsys, "export", str(run), "--scene", f"--out={out}", f"--figure={figure}", "--at=12")
    with Reader(out) as bag:
        counts = {connection.topic: connection.msgcount for connection in bag.connections}
        assert bag.start_time == EPOCH_NS and bag.duration - 1 == 20 * 10**9
    assert {name: counts[name] for name in (scene.TRANSFORMS.name, scene.POSES.name, scene.MARKERS.name)} == {
        "/tf": 101, "/scene/vehicles": 101, "/scene/markers": 101,
    }  # fmt: skip
    assert counts[scene.STATIC.name] == counts[scene.TRACK.name] == 1
    assert told["messages"] == 3 * 101 + 2
    added = {scene.TRANSFORMS.name, scene.STATIC.name, scene.POSES.name, scene.MARKERS.name, scene.TRACK.name}
    kept = [(m.channel.topic, m.publish_ns, m.data) for m in stream(out / "run.mcap") if m.channel.topic not in added]
    assert kept == [(m.channel.topic, m.publish_ns, m.data) for m in stream(run / "run.mcap")]
    assert figure.read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(ValueError, match="--at 21: the run has 0 to 20 s"):
        scene_at(out / "run.mcap", 21.0)
    layout = tmp_path / "layout.json"
    assert main(["layout", str(out / "run.mcap"), "--foxglove", f"--out={layout}"]) == 0
    panel = json.loads(layout.read_text())["configById"]["3D!scene"]
    assert set(panel["topics"]) <= set(counts)
    assert panel["followTf"] == "base_link"


def test_foxglove_receives_the_scene_of_a_recorded_run(run: Path) -> None:
    """Breaks if the WebSocket has no /tf with its definition, or a late subscriber gets no track."""
    pytest.importorskip("rclpy")
    from test_view_foxglove import Client

    from train_ato.view.foxglove import FoxgloveServer
    from train_ato.view.recorded import RecordedFeed

    feed = RecordedFeed(run)

    async def look(server):
        client = await Client.connect(server.url)
        await client.until(lambda: "/tf" in client.channels)
        assert client.channels["/tf"]["schemaName"] == "tf2_msgs/msg/TFMessage"
        assert "MSG: geometry_msgs/TransformStamped" in client.channels["/tf"]["schema"]
        await client.subscribe("/tf", "/scene/track", "/tf_static")
        feed.set_playing(playing=True)  # 20 s of wall time: a slow client comes before the end
        await client.until(
            lambda: (
                all(client.messages.get(name) for name in ("/scene/track", "/tf_static"))
                and len(client.messages.get("/tf", ())) >= 3
            )
        )
        return client

    with closing(FoxgloveServer(feed, 0)) as server:
        client = asyncio.run(look(server))
    _, data = client.messages["/tf"][0]
    sent = typestore().deserialize_cdr(data, scene.TRANSFORMS.type).transforms
    assert len(sent) == 106 + 1, "the vehicles and `line`"


@pytest.mark.parametrize("space", ["", "/t2"])
def test_a_live_graph_publishes_the_scene(run: Path, setup: RunSetup, space: str) -> None:
    """Breaks if the node publishes nothing, a missing tf2_msgs ends it, or if two trains have one /scene or /tf."""
    pytest.importorskip("rclpy")
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from waiting import wait_for

    from train_ato.ros.graph.assembly import executor_of
    from train_ato.ros.graph.environment import claim_domain
    from train_ato.view.scene_node import SceneNode

    with claim_domain(None) as domain, executor_of(domain, []) as (context, _):
        node = Node("scene", context=context, namespace=space, enable_rosout=False)
        plant = Node("plant", context=context, namespace=space, enable_rosout=False)
        live = SceneNode(node, scene.TrainScene(setup))
        other = Node("other", context=context, enable_rosout=False)
        other.create_publisher(JointState, "/t9/train/vehicles", 10)
        awaited = f"a publisher of {space}/train/vehicles; --namespace /t9 has one"
        wait_for(lambda: live.awaited == awaited)
        sent = plant.create_publisher(JointState, "train/vehicles", 10)
        data = Wire(setup.layout).encode("train/vehicles", states(setup, 11_000.0))
        wait_for(lambda: sent.get_subscription_count() > 0)

        def published() -> bool:
            sent.publish(data)
            live.poll()
            return live.counts[f"{space}/scene/markers"] > 0

        wait_for(published)
        assert set(live.left_out) <= {f"{space}/tf", f"{space}/tf_static"}
        assert live.counts[f"{space}/scene/track"] == 1
        shown = {place.topic_name for place in node.publishers} - {"/parameter_events"}
        assert shown == set(live.counts)
        assert not live.left and live.awaited == ""
        for used in (node, plant, other):
            used.destroy_node()


TRAINS = {"heavy": ["demo", "--observer=ndo"], "one mass": ["crh380a_funnel"], "three units": ["crh380a_gpc"]}
PATHS = [*TRAINS, "commands only", "former types"]


@pytest.fixture(scope="module")
def run_of_case(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return the function that gives the run of a case, made once."""
    made: dict[str, Path] = {}

    def folder(case: str) -> Path:
        if case not in made:
            scratch = tmp_path_factory.mktemp("layouts")
            if case in TRAINS:
                scenario, *options = TRAINS[case]
                made[case] = drive(scratch, "run", scenario, "--set=duration=3", *options)
            elif case == "former types":
                (scratch / "run.mcap").write_bytes((Path(__file__).parent / "data" / "former_types.mcap").read_bytes())
                made[case] = scratch
            else:
                topics = ["train/vehicles", "train/measurement", "/diagnostics", "train/brake_pipe", "ato/reference"]
                made[case] = without(folder("heavy"), scratch / "run", topics)
        return made[case]

    return folder


def contents(run: Path) -> dict[str, Any]:
    """Return the last message of every topic, and under ``told`` the values of the statuses by PlotJuggler name."""
    path = run / "run.mcap" if run.is_dir() else run
    last = {message.channel.topic: (message.data, message.schema.name) for message in stream(path)}
    found = {topic: typestore().deserialize_cdr(data, kind) for topic, (data, kind) in last.items()}
    found["told"] = {
        "/".join(filter(None, (message.channel.topic, status.hardware_id, status.name, pair.key))): pair.value
        for message in stream(path)
        if message.schema.name == "diagnostic_msgs/msg/DiagnosticArray"
        for status in typestore().deserialize_cdr(message.data, message.schema.name).status
        for pair in status.values
    }
    return found


def written(run: Path, folder: Path, viewer: str) -> Path:
    target = folder / ("layout.xml" if viewer == "plotjuggler" else "layout.json")
    assert main(["layout", str(run), f"--{viewer}", f"--out={target}"]) == 0
    return target


def foxglove_value(messages: dict[str, Any], path: str) -> Any:
    """Follow a message path such as ``/train/vehicles.effort[0].@mul(0.001)``."""
    topic, *parts = re.sub(r"\.@mul\([\d.]+\)$", "", path).split(".")
    value = messages[topic]
    for part in parts:
        name, index = re.fullmatch(r"(\w+)(?:\[(\d+|:)\])?", part).groups()
        value = getattr(value, name)
        value = value if index in (None, ":") else value[int(index)]
    return value


def plotjuggler_value(messages: dict[str, Any], path: str) -> float:
    """Follow a PlotJuggler name: ``/train/vehicles/vehicle_26/effort``, ``/train/brake_pipe/fluid_pressure``."""
    if path in messages["told"]:  # a DiagnosticArray by hardware, node and key
        return float(messages["told"][path])
    topic = max((name for name in messages if path.startswith(f"{name}/")), key=len)
    message, rest = messages[topic], path[len(topic) + 1 :].split("/")
    if len(rest) == 2 and hasattr(message, "name"):  # it takes a JointState apart by the names of its joints
        return float(getattr(message, rest[1])[list(message.name).index(rest[0])])
    for part in rest:
        name, index = re.fullmatch(r"(\w+?)(?:\[(\d+)\])?", part).groups()
        message = getattr(message, name)
        message = message if index is None else message[int(index)]
    return float(message)


@pytest.mark.parametrize("viewer", ["foxglove", "studio"])
@pytest.mark.parametrize("case", PATHS)
def test_every_path_of_foxglove_gives_numbers(case: str, viewer: str, run_of_case, tmp_path: Path) -> None:
    """Breaks if a path names a topic, a field or a vehicle that is not in the log: its plot stays empty."""
    # Studio 1.87, the last open version, has no multiplication: a path with one gives no value there.
    messages = contents(run_of_case(case))
    text = written(run_of_case(case), tmp_path, viewer).read_text(encoding="utf-8")
    assert "null" not in text, "a value of page.foxglove.json that no run fills"
    layout = json.loads(text)
    panels = layout["configById"]
    paths = [series for panel in panels.values() for series in panel.get("paths", ())]
    values = [path["value"] for path in paths] + [panel["path"] for panel in panels.values() if "path" in panel]
    assert len(values) >= (2 if case == "commands only" else 8)
    for value in values:
        found = foxglove_value(messages, value)
        if value.startswith(("/ato/state.status", "/train/protection.status")):  # texts: a name, 0 or 1
            assert found == ("engaged" if "state" in value else "0"), value
            continue
        assert isinstance(found, float) or (isinstance(found, np.ndarray) and found.size > 1), value
        assert viewer == "foxglove" or "@" not in value
    for path in paths:  # a header stamp is used where there is one, so log times have no effect
        along = path["value"].partition(".@")[0].endswith("[:]")
        assert path["timestampMethod"] == ("receiveTime" if along else "headerStamp")
        assert hasattr(messages[path["value"].partition(".")[0]], "header")
    status = {(entry.hardware_id, entry.name) for entry in getattr(messages.get("/diagnostics"), "status", ())}
    status |= {tuple(name.split("/")[2:4]) for name in messages["told"] if name.count("/") == 4}
    for panel in panels.values():
        assert panel.get("topicToRender", "/diagnostics") == "/diagnostics"
        if panel.get("selectedHardwareId"):
            assert (panel["selectedHardwareId"], panel["selectedName"]) in status

    def arranged(node: Any) -> set[str]:
        return {node} if isinstance(node, str) else arranged(node["first"]) | arranged(node["second"])

    assert arranged(layout["layout"]) == set(panels)


@pytest.mark.parametrize("case", PATHS)
def test_every_curve_of_plotjuggler_gives_numbers(case: str, run_of_case, tmp_path: Path) -> None:
    """Breaks if a curve or an equation names something that the log lacks, or the loader takes other times."""
    messages = contents(run_of_case(case))
    target = written(run_of_case(case), tmp_path, "plotjuggler")
    root = ET.fromstring(target.read_text(encoding="utf-8"))
    made = {snippet.get("name") for snippet in root.iter("snippet")}
    curves = {curve.get("name") for curve in root.iter("curve")}
    sources = {node.text for node in root.iter("linked_source")}
    sources |= {node.text for more in root.iter("additional_sources") for node in more}
    assert made <= curves
    paths = (curves - made) | sources
    assert len(paths) >= (2 if case == "commands only" else 5)
    for path in sorted(paths):
        assert isinstance(plotjuggler_value(messages, path), float), path
    (file,) = root.iter("fileInfo")
    log = run_of_case(case) / "run.mcap" if run_of_case(case).is_dir() else run_of_case(case)
    assert (target.parent / file.get("filename")).resolve().samefile(log)
    (options,) = file.iter("parameters")
    assert (options.get("use_timestamp"), options.get("use_mcap_log_time")) == ("1", "0")
    assert set(options.get("selected_topics").split(";")) == set(messages) - {"told"}
    assert root.find("use_relative_time_offset").get("enabled") == "1"


def test_files_and_gauge_of_a_layout(run_of_case, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the range of the gauge is that of another train, or a file is replaced or not beside the log."""
    panels = json.loads(written(run_of_case("one mass"), tmp_path, "foxglove").read_text())["configById"]
    assert panels["Gauge!speed"]["maxValue"] == 310, "the profile has 300 km/h"
    folder = run_of_case("three units")
    capsys.readouterr()  # what the run has printed, if this is the first case with it
    found = answer(capsys, "layout", str(folder), "--foxglove")
    assert found["layout"] == str(folder / "foxglove.json") and "/train/vehicles" in found["topics"]
    assert "exists already; give another file with --out" in complaint(capsys, "layout", str(folder), "--foxglove")


def test_a_log_without_a_run_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the layout of a foreign log is empty, or a crash."""
    write_foreign(tmp_path / "robot.mcap")
    assert main(["layout", str(tmp_path / "robot.mcap"), "--plotjuggler"]) == 2
    assert "has no message of a run; name the log of a run" in capsys.readouterr().err
