"""Layout for PlotJuggler 3: tabs of a run as XML, with the log and the options of its loader.

The layout opens the log without the dialog of the loader.  Messages have their header stamps as times, else the publish
times of the log, which are both simulated times.
"""

import os
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from train_ato.messages.variable_codec import message_key
from train_ato.report.quantities import BLUE, GREEN, VERMILION
from train_ato.view.layout_signals import LayoutPanel, LogSignals, Signal, panels_of

TABS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("driving", ("speed", "error", "force")),
    ("train", ("coupler", "pipe")),
    ("supervision", ("ato", "protection")),
)
"""Tabs with the keys of their panels."""
TOTALS = (
    ("energy in J", (("energy_traction", VERMILION), ("energy_regenerated", GREEN))),
    ("coupler extremes so far in N", (("coupler_draft_max", VERMILION), ("coupler_buff_max", BLUE))),
)
"""Panels with totals in the diagnostics of the plant."""
LOADER = "DataLoad MCAP"
MIN_ARRAY = 500
"""Smallest limit of the loader for the length of an array, its default."""


def plotjuggler_layout(log: LogSignals, target: Path) -> str:
    """Return the layout of a log as XML.

    Parameters
    ----------
    log
        Signals of the run.
    target
        File of the layout; the log is named relative to it.
    """
    root = ET.Element("root", version="2.3.8")
    window = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    equations: dict[str, tuple[str, Sequence[str]]] = {}
    panels = panels_of(log)
    for name, keys in TABS:
        plots = [_plot(panels[key], equations) for key in keys if key in panels]
        if name == "driving":
            plots[1:1] = _error_plot(log, equations)
        _tab(window, name, plots)
    _tab(window, "totals", _totals(log))
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.SubElement(root, "Plugins")
    _data_file(root, log, target)
    made = ET.SubElement(root, "customMathEquations")
    for name, (function, (first, *others)) in equations.items():
        snippet = ET.SubElement(made, "snippet", name=name)
        ET.SubElement(snippet, "global")
        ET.SubElement(snippet, "function").text = function
        ET.SubElement(snippet, "linked_source").text = first
        additional = ET.SubElement(snippet, "additional_sources")
        for number, other in enumerate(others, 1):
            ET.SubElement(additional, f"v{number}").text = other
    ET.SubElement(root, "snippets")
    ET.indent(root, " ")
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def series_name(signal: Signal) -> str:
    """Return the name of a signal in PlotJuggler: entries of a JointState by names, values of a status by keys."""
    if signal.series:
        return signal.series
    parts = (signal.topic, signal.joint, signal.field.replace(".", "/"))
    return "/".join(part for part in parts if part)


def _tab(window: ET.Element, name: str, plots: Sequence[ET.Element]) -> None:
    """Add a tab with plots of equal height; none without plots."""
    if not plots:
        return
    container = ET.SubElement(ET.SubElement(window, "Tab", tab_name=name, containers="1"), "Container")
    sizes = ";".join([f"{1 / len(plots):.6f}"] * len(plots))
    splitter = ET.SubElement(container, "DockSplitter", orientation="-", count=str(len(plots)), sizes=sizes)
    splitter.extend(plots)


def _area(title: str, curves: Sequence[tuple[str, str]], style: str = "Lines") -> ET.Element:
    """Return a plot with curves of (name, colour)."""
    area = ET.Element("DockArea", name=title)
    plot = ET.SubElement(area, "plot", mode="TimeSeries", style=style, flip_x="false", flip_y="false")
    ET.SubElement(plot, "limitY")
    for name, color in curves:
        ET.SubElement(plot, "curve", name=name, color=color)
    return area


def _plot(panel: LayoutPanel, equations: dict[str, tuple[str, Sequence[str]]]) -> ET.Element:
    curves = []
    for curve in panel.curves:
        name = series_name(curve.signal)
        if panel.factor != 1.0:
            scaled = f"{panel.key}: {curve.label} {panel.unit}"
            equations[scaled] = (f"return {panel.factor:g} * value", (name,))
            name = scaled
        curves.append((name, curve.color))
    title = f"{panel.title} in {panel.unit}" if panel.unit else panel.title
    return _area(title, curves, "Steps" if panel.steps else "Lines")


def _error_plot(log: LogSignals, equations: dict[str, tuple[str, Sequence[str]]]) -> list[ET.Element]:
    """Return the plot of the speed error of vehicle 0 from the reference, if the log has both."""
    train = log.joint("train/vehicles", "vehicle_0", "velocity")
    reference = log.field("ato/reference", "points[0].velocities[0]")
    if train is None or reference is None:
        return []
    name = "speed error km/h"
    equations[name] = ("return 3.6 * (value - v1)", (series_name(train), series_name(reference)))
    return [_area("speed error in km/h", [(name, BLUE)])]


def _totals(log: LogSignals) -> list[ET.Element]:
    """Return the plots of totals."""
    reports = log.reports.get("plant", {})
    plots = []
    for title, keys in TOTALS:
        found = [(reports[name], color) for key, color in keys if (name := message_key(key)) in reports]
        if found:
            plots.append(_area(title, found))
    return plots


def _data_file(root: ET.Element, log: LogSignals, target: Path) -> None:
    """Add the log with all its topics and the options of the loader."""
    topics = ";".join(sorted(log.names.values()))
    files = ET.SubElement(root, "previouslyLoaded_Datafiles")
    name = os.path.relpath(log.path.resolve(), target.resolve().parent)
    file = ET.SubElement(files, "fileInfo", filename=name, prefix="")
    ET.SubElement(file, "selected_datasources", value=topics)
    longest = max((len(names) for names in log.joints.values()), default=0)
    ET.SubElement(
        ET.SubElement(file, "plugin", ID=LOADER),
        "parameters",
        use_timestamp="1",
        use_mcap_log_time="0",
        clamp_large_arrays="0",
        max_array_size=str(max(MIN_ARRAY, longest)),
        selected_topics=topics,
    )
