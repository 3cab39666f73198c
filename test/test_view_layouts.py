"""Shipped layouts against the messages of a real log: every path gives numbers."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from report_runs import drive

from train_ato.log.reading import stream
from train_ato.messages.codec.cdr import typestore

LAYOUTS = files("train_ato") / "apps" / "view" / "layouts"


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the last message of every topic of the heavy-haul train with its air brake and an observer."""
    run: Path = drive(tmp_path_factory.mktemp("layouts"), "run", "demo", "--set=duration=3", "--observer=ndo")
    last = {message.channel.topic: (message.data, message.schema.name) for message in stream(run / "run.mcap")}
    found = {topic: typestore().deserialize_cdr(data, kind) for topic, (data, kind) in last.items()}
    said = [message for message in stream(run / "run.mcap") if message.channel.topic == "/diagnostics"]
    found["told"] = {
        "/".join(filter(None, ("/diagnostics", status.hardware_id, status.name, pair.key))): pair.value
        for message in said
        for status in typestore().deserialize_cdr(message.data, message.schema.name).status
        for pair in status.values
    }
    return found


def value_at(messages: dict[str, Any], path: str) -> Any:
    """Follow a Foxglove message path such as ``/train/vehicles.effort[0].@mul(0.001)``."""
    topic, *parts = re.sub(r"\.@mul\([\d.]+\)$", "", path).split(".")
    value = messages[topic]
    for part in parts:
        name, index = re.fullmatch(r"(\w+)(?:\[(\d+|:)\])?", part).groups()
        value = getattr(value, name)
        value = value if index in (None, ":") else value[int(index)]
    return value


def joint_value(messages: dict[str, Any], path: str) -> float:
    """Follow a PlotJuggler name: ``/train/vehicles/vehicle_26/effort``, ``/train/brake_pipe/fluid_pressure``."""
    if path in messages["told"]:  # and a DiagnosticArray by hardware, node and key
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


def test_every_path_of_the_foxglove_layout_leads_to_numbers(messages: dict[str, Any]) -> None:
    """Breaks if a field or a vehicle in the layout is not in the messages: its plot would stay empty."""
    layout = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))["configById"].values()
    paths = [series["value"] for panel in layout for series in panel.get("paths", ())]
    paths += [panel["path"] for panel in layout if "path" in panel]
    assert len(paths) > 10
    for path in paths:
        found = value_at(messages, path)
        assert isinstance(found, float) or len(found) > 100, path
    assert {panel["topicToRender"] for panel in layout if "topicToRender" in panel} <= set(messages)


def test_every_curve_of_the_plotjuggler_layout_leads_to_numbers(messages: dict[str, Any]) -> None:
    """Breaks if a curve or an equation names a field or a vehicle that is not in the messages."""
    root = ET.fromstring((LAYOUTS / "plotjuggler.xml").read_text(encoding="utf-8"))
    made = {snippet.get("name") for snippet in root.iter("snippet")}
    paths = {curve.get("name") for curve in root.iter("curve")} - made
    paths |= {node.text for node in root.iter("linked_source")}
    paths |= {node.text for more in root.iter("additional_sources") for node in more}
    assert len(paths) > 10
    for path in sorted(path for path in paths if path):
        assert isinstance(joint_value(messages, path), float), path
