"""Layouts for runs of several trains: every path gives numbers of the log, at simulated times."""

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frames_logs import write_foreign
from report_runs import drive, without

from train_ato.cli import main
from train_ato.log.mcap_records import stream
from train_ato.messages.cdr import typestore

pytestmark = pytest.mark.usefixtures("without_figure")

TRAINS = {"heavy": ["demo", "--observer=ndo"], "one mass": ["crh380a_funnel"], "three units": ["crh380a_gpc"]}
CASES = [*TRAINS, "commands only", "former types"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
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
@pytest.mark.parametrize("case", CASES)
def test_every_path_of_foxglove_gives_numbers(case: str, viewer: str, run, tmp_path: Path) -> None:
    """Breaks if a path names a topic, a field or a vehicle that is not in the log: its plot stays empty."""
    # Studio 1.87, the last open version, has no multiplication: a path with one gives no value there.
    messages = contents(run(case))
    layout = json.loads(written(run(case), tmp_path, viewer).read_text(encoding="utf-8"))
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


@pytest.mark.parametrize("case", CASES)
def test_every_curve_of_plotjuggler_gives_numbers(case: str, run, tmp_path: Path) -> None:
    """Breaks if a curve or an equation names something that the log lacks, or the loader takes other times."""
    messages = contents(run(case))
    target = written(run(case), tmp_path, "plotjuggler")
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
    log = run(case) / "run.mcap" if run(case).is_dir() else run(case)
    assert (target.parent / file.get("filename")).resolve().samefile(log)
    (options,) = file.iter("parameters")
    assert (options.get("use_timestamp"), options.get("use_mcap_log_time")) == ("1", "0")
    assert set(options.get("selected_topics").split(";")) == set(messages) - {"told"}
    assert root.find("use_relative_time_offset").get("enabled") == "1"


def test_files_and_gauge_of_a_layout(run, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the range of the gauge is that of another train, or a file is replaced or not beside the log."""
    panels = json.loads(written(run("one mass"), tmp_path, "foxglove").read_text())["configById"]
    assert panels["Gauge!speed"]["maxValue"] == 310, "the profile has 300 km/h"
    folder = run("three units")
    capsys.readouterr()  # what the run has printed, if this is the first case with it
    assert main(["layout", str(folder), "--foxglove", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["layout"] == str(folder / "foxglove.json") and "/train/vehicles" in found["topics"]
    assert main(["layout", str(folder), "--foxglove"]) == 2
    assert "exists already; give another file with --out" in capsys.readouterr().err


def test_a_log_without_a_run_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the layout of a foreign log is empty, or a crash."""
    write_foreign(tmp_path / "robot.mcap")
    assert main(["layout", str(tmp_path / "robot.mcap"), "--plotjuggler"]) == 2
    assert "has no message of a run; name the log of a run" in capsys.readouterr().err
