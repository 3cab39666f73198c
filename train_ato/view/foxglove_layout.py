"""Layout for Foxglove: panels of a run as JSON.

The last open version, Foxglove Studio 1.87, and its successors have no multiplication in message paths.  Their layout
therefore has the units of the messages (SI).
"""

import json
import math
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from plant_sim.units import KMH
from train_ato.view.layout_signals import DIAGNOSTICS, LayoutPanel, LogSignals, Signal, panels_of
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
        config = _filled(
            "transitions",
            paths=[_filled("transition", value=message_path(curve.signal), label=curve.label) for curve in states],
        )
        groups["states"] = _add(configured, "StateTransitions!protection", config)
    if DIAGNOSTICS in log.names:
        groups["nodes"] = _nodes(configured, log)
    if log.scene or scene:
        topics = {MARKERS.name: {"visible": True}, TRACK.name: {"visible": True}, POSES.name: {"visible": False}}
        groups["scene"] = _add(configured, "3D!scene", _filled("scene", followTf=BASE, topics=topics))
    sides = [[groups[key] for key in side if key in groups] for side in (LEFT, RIGHT)]
    there = [_column(side) for side in sides if side]
    layout = _split("row", there[0], there[1], 62) if len(there) == 2 else there[0]
    content = _filled("layout", configById=configured, layout=layout)
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def message_path(signal: Signal, factor: float = 1.0) -> str:
    """Return the message path of a signal, with a multiplication unless ``factor`` is 1."""
    entry = "" if signal.index is None else f"[{signal.index}]"
    return f"{signal.topic}.{signal.field}{entry}" + ("" if factor == 1.0 else f".@mul({factor:g})")


def _add(configured: dict[str, dict[str, Any]], name: str, config: dict[str, Any]) -> str:
    configured[name] = config
    return name


@cache
def _parts() -> dict[str, dict[str, Any]]:
    """Return the fixed configuration of each part of a layout; null where a value of the run comes."""
    parts: dict[str, dict[str, Any]] = json.loads((files("train_ato") / "view/page.foxglove.json").read_text("utf-8"))
    return parts


def _filled(part: str, **values: Any) -> dict[str, Any]:
    """Return a part of a layout with its values of the run."""
    return {**_parts()[part], **values}


def _plot(panel: LayoutPanel, *, studio_1: bool) -> dict[str, Any]:
    factor, unit = (1.0, panel.si_unit) if studio_1 else (panel.factor, panel.unit)
    paths = []
    for curve in panel.curves:
        path = message_path(curve.signal, factor)
        if panel.along:
            path = message_path(curve.signal) + "[:]" + ("" if factor == 1.0 else f".@mul({factor:g})")
        stamp = "receiveTime" if panel.along else "headerStamp"
        paths.append(_filled("curve", value=path, label=curve.label, color=curve.color, timestampMethod=stamp))
    plot = _filled("plot", foxglovePanelTitle=f"{panel.title} in {unit}", paths=paths, yAxisLabel=unit)
    if not panel.along:
        return {**plot, "timeWindowMode": "automatic"}
    return {**plot, "xAxisVal": "index", "isSynced": False, "xAxisLabel": "vehicle, 0 in front"}


def _gauge(panel: LayoutPanel, log: LogSignals, *, studio_1: bool) -> dict[str, Any]:
    """Return a gauge of the train's speed to a multiple of ten above the top speed of the run."""
    factor, unit = (1.0, "m/s") if studio_1 else (KMH, "km/h")
    path = message_path(panel.curves[-1].signal, factor)
    top = 10 * math.ceil((log.top_speed * factor + GAUGE_MARGIN) / 10)
    return _filled("gauge", foxglovePanelTitle=f"speed in {unit}", path=path, maxValue=top)


def _nodes(configured: dict[str, dict[str, Any]], log: LogSignals) -> Node:
    topic = log.names[DIAGNOSTICS]
    parts: list[Node] = [_add(configured, "DiagnosticSummary!nodes", _filled("summary", topicToRender=topic))]
    for node in STATUS_OF:
        if node in log.statuses:
            hardware, name = log.statuses[node]
            chosen = {"topicToRender": topic, "selectedHardwareId": hardware, "selectedName": name}
            config = _filled("status", foxglovePanelTitle=node, **chosen)
            parts.append(_add(configured, f"DiagnosticStatusPanel!{node}", config))
    if len(parts) == 1:
        return parts[0]
    return _split("row", parts[0], _column(parts[1:]), 45)


def _split(direction: str, first: Node, second: Node, percentage: float) -> Node:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def _column(parts: Sequence[Node]) -> Node:
    """Return panels of equal height, the first one on top."""
    if len(parts) == 1:
        return parts[0]
    return _split("column", parts[0], _column(parts[1:]), round(100 / len(parts), 1))
