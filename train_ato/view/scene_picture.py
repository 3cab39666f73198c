"""Picture of the train on its line, drawn from the messages of the scene in a log."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from train_ato.log.mcap_records import stream
from train_ato.messages.cdr import typestore
from train_ato.messages.topics import EPOCH_NS
from train_ato.messages.types import Array
from train_ato.program.errors import refused_unwritten
from train_ato.view.train_scene import BUFF, DRAFT, MARKERS, NEUTRAL, TRACK

WIDER = 8.0
"""Factor of the drawn width of the vehicles in the plan."""
AROUND = 0.15
"""Margin around the train, as a part of its length."""
FORMAT = 3.2
"""Width over height of the enlarged plan."""
MIN_SHOWN = 100.0
"""Smallest width of the enlarged plan [m]."""


def scene_at(log: Path, time: float) -> tuple[Any, Any, float]:
    """Return the track and the markers with the stamp nearest to a time [s], decoded, and that stamp [s]."""
    track, markers, nearest, last = None, None, np.inf, 0.0
    for message in stream(log):
        at = (message.publish_ns - EPOCH_NS) * 1e-9
        last = max(last, at)
        if message.channel.topic == TRACK.name:
            track = message
        elif message.channel.topic == MARKERS.name and abs(at - time) < nearest:
            markers, nearest = message, abs(at - time)
    if not 0.0 <= time <= last:
        raise ValueError(f"--at {time:g}: the run has 0 to {last:g} s; give one of these times")
    if track is None or markers is None:
        raise ValueError(f"{log}: has no scene; write one with `train-ato export RUN --scene`")
    decode = typestore().deserialize_cdr
    return decode(track.data, TRACK.type), decode(markers.data, MARKERS.type), (markers.publish_ns - EPOCH_NS) * 1e-9


def draw_scene(log: Path, time: float, full_force: float, target: Path) -> None:
    """Draw plan and elevation of the line with the train, and the train enlarged.

    Parameters
    ----------
    log
        Log with the scene.
    time
        Simulated time [s]; the nearest markers are drawn.
    full_force
        Coupler force with the full colour [N].
    target
        PNG, SVG or PDF file.
    """
    track, markers, at = scene_at(log, time)
    path = np.array([[entry.pose.position.x, entry.pose.position.y, entry.pose.position.z] for entry in track.poses])
    boxes = [_Box(marker) for marker in markers.markers]
    figure = Figure(figsize=(10, 9), layout="constrained")
    whole, near, side = figure.subplots(3, 1)
    centres = np.array([box.centre for box in boxes])
    for axes in (whole, near):
        axes.plot(path[:, 0], path[:, 1], color="#7f8790", linewidth=1.0)
    whole.plot(centres[:, 0], centres[:, 1], color="black", linewidth=4.0, solid_capstyle="butt")
    whole.set_title(f"plan of the line, train at {at:.1f} s")
    near.add_collection(PolyCollection([box.plan for box in boxes], facecolors=[box.color for box in boxes]))
    near.set_title(f"train in plan, vehicles {WIDER:g} times as wide")
    _around(near, centres)
    whole.set_aspect("equal", adjustable="datalim")
    near.set_aspect("equal", adjustable="box")
    for axes in (whole, near):
        axes.set(xlabel="x in m, east", ylabel="y in m, north")
    _side(side, path, boxes, centres)
    colors = LinearSegmentedColormap.from_list("coupler force", [BUFF, NEUTRAL, DRAFT])
    scale = ScalarMappable(Normalize(-full_force * 1e-3, full_force * 1e-3), colors)
    figure.colorbar(scale, ax=(near, side), label="coupler force in kN, draft > 0", shrink=0.8)
    with refused_unwritten(target, "name a writable place"):
        figure.savefig(target, dpi=110)


class _Box:
    """Vehicle as a marker: centre, corners in the plan and colour."""

    def __init__(self, marker: Any) -> None:
        position, turn = marker.pose.position, marker.pose.orientation
        self.centre = (position.x, position.y, position.z - marker.scale.z / 2)
        heading = np.arctan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
        half, aside = marker.scale.x / 2, WIDER * marker.scale.y / 2
        corners = np.array([[half, aside], [half, -aside], [-half, -aside], [-half, aside]])
        turned = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        self.plan: Array = corners @ turned + np.array(self.centre[:2])
        self.length = marker.scale.x
        self.color = (marker.color.r, marker.color.g, marker.color.b)


def _way(path: Array, way: Array, centre: Array) -> float:
    """Return the way along the track at the point nearest to a vehicle [m]; the ends go on straight."""
    steps = np.diff(path[:, :2], axis=0)
    lengths = np.hypot(*steps.T)
    along = ((centre[:2] - path[:-1, :2]) * steps).sum(axis=1) / lengths
    inside = np.clip(along, 0.0, lengths)
    inside[0], inside[-1] = min(along[0], lengths[0]), max(along[-1], 0.0)
    points = path[:-1, :2] + steps * (inside / lengths)[:, None]
    piece = int(np.hypot(*(points - centre[:2]).T).argmin())
    return float(way[piece] + inside[piece])


def _around(axes: Any, centres: Array) -> None:
    """Show the train with a margin, in the format of the figure."""
    low, high = centres[:, :2].min(axis=0), centres[:, :2].max(axis=0)
    wide, tall = (high - low) * (1 + 2 * AROUND)
    half = max(wide, FORMAT * tall, MIN_SHOWN) / 2
    middle = (low + high) / 2
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half / FORMAT, middle[1] + half / FORMAT)


def _side(axes: Any, path: Array, boxes: list[_Box], centres: Array) -> None:
    """Draw the height over the way along the track, near the train."""
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))))
    ways = np.array([_way(path, way, centre) for centre in centres])
    margin = AROUND * max(float(np.ptp(ways)), 50.0)
    shown = (way > ways.min() - 4 * margin) & (way < ways.max() + 4 * margin)
    axes.plot(way[shown], path[shown, 2], color="#7f8790", linewidth=1.0)
    axes.scatter(ways, centres[:, 2], c=[box.color for box in boxes], s=14, zorder=3)
    axes.set(xlabel="way along the track in m", ylabel="height in m")
    axes.set_title("elevation")
