"""Layout for Foxglove: panels of a run as JSON.

The last open version, Foxglove Studio 1.87, and its successors have no multiplication in message paths.  Their layout
therefore has the units of the messages (SI).
"""

import json
import math
from collections.abc import Sequence
from typing import Any

from plant_sim.units import KMH
from train_ato.view.layout_signals import DIAGNOSTICS, LayoutCurve, LayoutPanel, LogSignals, Signal, panels_of
from train_ato.view.train_scene import BASE, MARKERS, POSES, TRACK

LEFT = ("speed", "states", "force", "coupler", "pipe")
RIGHT = ("scene", "along", "shoes", "nodes")
STATUS_OF = ("supervisor", "controller")
"""Nodes with a panel of their own for the diagnostics."""
GAUGE_MARGIN = 1.0
"""Least distance of the end of the gauge from the top speed, in its unit."""

Node = str | dict[str, Any]
"""Panel, or split of two parts."""


def foxglove_layout(log: LogSignals, *, studio_1: bool = False, scene: bool = False) -> str:
    """Return the layout of a log as JSON.

    Parameters
    ----------
    log
        Signals of the run.
    studio_1
        For Foxglove Studio 1.87 and its successors: SI units.
    scene
        With the train on its line, also for a log without it: ``view --foxglove`` sends it.
    """
    panels = panels_of(log)
    configured: dict[str, dict[str, Any]] = {}
    groups: dict[str, Node] = {}
    for key in ("force", "coupler", "pipe", "along", "shoes"):
        if key in panels:
            groups[key] = _add(configured, f"Plot!{key}", _plot(panels[key], studio_1=studio_1))
    if "speed" in panels:
        plot = _add(configured, f"Plot!{panels['speed'].key}", _plot(panels["speed"], studio_1=studio_1))
        gauge = _add(configured, "Gauge!speed", _gauge(panels["speed"], log, studio_1=studio_1))
        groups["speed"] = _split("row", gauge, plot, 24)
    states = [curve for key in ("ato", "protection") if key in panels for curve in panels[key].curves]
    if states:
        config = {"isSynced": True, "paths": [_transition(curve) for curve in states]}
        groups["states"] = _add(configured, "StateTransitions!protection", _titled("ATO and train protection", config))
    if DIAGNOSTICS in log.names:
        groups["nodes"] = _nodes(configured, log)
    if log.scene or scene:
        groups["scene"] = _add(configured, "3D!scene", _scene())
    columns = [_column([groups[key] for key in side if key in groups]) for side in (LEFT, RIGHT)]
    there = [column for column in columns if column is not None]
    layout = _split("row", there[0], there[1], 62) if len(there) == 2 else there[0]
    content = {
        "configById": configured,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def message_path(signal: Signal, factor: float = 1.0) -> str:
    """Return the message path of a signal, with a multiplication unless ``factor`` is 1."""
    entry = "" if signal.index is None else f"[{signal.index}]"
    return f"{signal.topic}.{signal.field}{entry}" + ("" if factor == 1.0 else f".@mul({factor:g})")


def _add(configured: dict[str, dict[str, Any]], name: str, config: dict[str, Any]) -> str:
    configured[name] = config
    return name


def _titled(title: str, config: dict[str, Any]) -> dict[str, Any]:
    return {"foxglovePanelTitle": title, **config}


def _plot(panel: LayoutPanel, *, studio_1: bool) -> dict[str, Any]:
    factor, unit = (1.0, panel.si_unit) if studio_1 else (panel.factor, panel.unit)
    paths = []
    for curve in panel.curves:
        path = message_path(curve.signal, factor)
        if panel.along:
            path = message_path(curve.signal) + "[:]" + ("" if factor == 1.0 else f".@mul({factor:g})")
        paths.append(
            {
                "value": path,
                "enabled": True,
                "label": curve.label,
                "color": curve.color,
                "timestampMethod": "receiveTime" if panel.along else "headerStamp",
                "showLine": True,
                "lineSize": 1.5,
            }
        )
    config = {
        "paths": paths,
        "xAxisVal": "index" if panel.along else "timestamp",
        "yAxisLabel": unit,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": not panel.along,
        "sidebarDimension": 240,
    }
    more = {"xAxisLabel": "vehicle, 0 in front"} if panel.along else {"timeWindowMode": "automatic"}
    return _titled(f"{panel.title} in {unit}", {**config, **more})


def _transition(curve: LayoutCurve) -> dict[str, Any]:
    return {
        "value": message_path(curve.signal),
        "enabled": True,
        "label": curve.label,
        "timestampMethod": "headerStamp",
    }


def _gauge(panel: LayoutPanel, log: LogSignals, *, studio_1: bool) -> dict[str, Any]:
    """Return a gauge of the train's speed to a multiple of ten above the top speed of the run."""
    factor, unit = (1.0, "m/s") if studio_1 else (KMH, "km/h")
    config = {
        "path": message_path(panel.curves[-1].signal, factor),
        "minValue": 0,
        "maxValue": 10 * math.ceil((log.top_speed * factor + GAUGE_MARGIN) / 10),
        "colorMode": "colormap",
        "colorMap": "turbo",
        "gradient": ["#0072b2", "#d55e00"],
        "reverse": False,
    }
    return _titled(f"speed in {unit}", config)


def _scene() -> dict[str, Any]:
    """Return a 3D panel that follows the head of the train."""
    config = {
        "cameraState": {
            "perspective": True,
            "distance": 250.0,
            "phi": 55.0,
            "thetaOffset": 60.0,
            "target": [0, 0, 0],
            "targetOffset": [-60, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.5,
            "far": 50000,
        },
        "followMode": "follow-pose",
        "followTf": BASE,
        "scene": {},
        "transforms": {},
        "topics": {MARKERS.name: {"visible": True}, TRACK.name: {"visible": True}, POSES.name: {"visible": False}},
        "layers": {},
    }
    return _titled("train on the line, red draft, blue buff", config)


def _nodes(configured: dict[str, dict[str, Any]], log: LogSignals) -> Node:
    topic = log.names[DIAGNOSTICS]
    summary = {"minLevel": 0, "pinnedIds": [], "hardwareIdFilter": "", "topicToRender": topic, "sortByLevel": True}
    parts: list[Node] = [_add(configured, "DiagnosticSummary!nodes", _titled("nodes", summary))]
    for node in STATUS_OF:
        if node in log.statuses:
            hardware, name = log.statuses[node]
            config = {
                "topicToRender": topic,
                "selectedHardwareId": hardware,
                "selectedName": name,
                "collapsedSections": [],
            }
            parts.append(_add(configured, f"DiagnosticStatusPanel!{node}", _titled(node, config)))
    if len(parts) == 1:
        return parts[0]
    return _split("row", parts[0], _column(parts[1:]) or parts[1], 45)


def _split(direction: str, first: Node, second: Node, percentage: float) -> Node:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def _column(parts: Sequence[Node]) -> Node | None:
    """Return panels of equal height, the first one on top; None without one."""
    if not parts:
        return None
    if len(parts) == 1:
        return parts[0]
    rest = _column(parts[1:])
    assert rest is not None
    return _split("column", parts[0], rest, round(100 / len(parts), 1))
