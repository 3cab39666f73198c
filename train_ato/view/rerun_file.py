"""Copies of a log with the scene of the train: for the Rerun viewer with all numbers, for others as one file."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from plant_sim.alignment import Alignment
from train_ato.log.bag_layout import qos_profiles, qos_text, table_name
from train_ato.log.definitions import definition
from train_ato.log.log_writer import LogFile
from train_ato.log.mcap_records import Progress, stream
from train_ato.log.reading import attachments, iter_raw, log_file, read_wall_time
from train_ato.log.table_loading import Frames
from train_ato.log.whole_file import writing
from train_ato.messages.cdr import SECOND
from train_ato.messages.codec import Wire
from train_ato.messages.topics import BY_NAME, EPOCH_NS
from train_ato.messages.types import Array
from train_ato.scenario.setup import RunSetup
from train_ato.view.train_scene import (
    DEFAULT_RATE,
    GAP,
    HEIGHT,
    MIN_SCALE,
    VEHICLES,
    WIDTH,
    SceneTopic,
    TrainScene,
    force_color,
    larger_coupler_force,
)


def write_scene_log(
    run: Path, setup: RunSetup, folder: Path, rate: float = DEFAULT_RATE, progress: Progress | None = None
) -> tuple[int, float, float]:
    """Copy a log into an existing folder, with the scene after the states of the vehicles.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    setup
        Train and line of the run.
    folder
        Folder of the new log, without one.
    rate
        Messages of the scene per simulated second.
    progress
        Receiver of the fraction of the log that is read.

    Returns
    -------
    tuple of int, float, float
        Messages of the scene, coupler force with the full colour [N], time of the largest coupler force [s].
    """
    path = log_file(run)
    force, worst = largest_force(run, setup)
    force = max(force, MIN_SCALE)
    drawn = TrainScene(setup, force, rate)
    wall_time = read_wall_time(path)
    log = LogFile(folder, attachments(path), wall_time=wall_time)
    numbers: dict[int, int] = {}
    scene = {topic.name: scene_channel(log, topic) for topic in drawn.topics}
    count = 0
    try:
        for topic, data in drawn.begin():
            log.write(scene[topic.name], EPOCH_NS, EPOCH_NS, data)
            count += 1
        for message in stream(path, progress=progress):
            number = message.channel.id
            if number not in numbers:
                numbers[number] = log.copy(message.channel, message.schema)
            log.write(numbers[number], message.publish_ns, message.publish_ns, message.data)
            if table_name(message.channel.topic) == VEHICLES:
                for topic, data in drawn.take(message.data):
                    log.write(scene[topic.name], message.publish_ns, message.publish_ns, data)
                    count += 1
    finally:
        log.close()
    return count, force, worst


def scene_channel(log: LogFile, topic: SceneTopic) -> int:
    """Add a topic of the scene to a log; return its number."""
    known = definition(topic.type)
    profile = qos_profiles(BY_NAME["ato/limits" if topic.latched else VEHICLES])
    return log.channel(topic.name, topic.type, known.text, known.hash, qos_text(profile))


def largest_force(run: Path, setup: RunSetup) -> tuple[float, float]:
    """Return the largest coupler force in the states of the vehicles of a log [N], and its time [s]."""
    wire, found = Wire(setup.layout), (-1.0, 0.0)
    for _, stamp, data in iter_raw(run, (VEHICLES,)):
        force = float(np.abs(wire.decode(VEHICLES, data).coupler_force).max(initial=0.0))
        if force > found[0]:
            found = (force, stamp * 1e-9)
    if found[0] < 0.0:
        raise ValueError(f"{run}: has no states of the vehicles ({VEHICLES}); name the log of a simulated run")
    return found


TIMELINE = "simulated_time"
MAX_COLUMNS = 40
"""Largest number of columns of a table that is drawn as curves; the vehicles of a longer train are in the scene."""
MISSING = "the package rerun-sdk is not installed; install it with `pip install rerun-sdk` (Python 3.11 or later)"


def write_rerun(
    run: Path, setup: RunSetup, frames: Frames, path: Path, *, rate: float, progress: Callable[[float, str], None]
) -> int:
    """Write the recording of a run; return its number of curves.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    setup
        Train and line of the run.
    frames
        Tables of the run.
    path
        New file, ``*.rrd``.
    rate
        States of the vehicles per simulated second.
    progress
        Receiver of the completed fraction, 0 to 1, and the current part.

    Raises
    ------
    ValueError
        If the package is not installed, or the log has no state of the vehicles.
    OSError
        With the name of the file: it cannot be written.
    """
    try:
        import rerun
    except ImportError:
        raise ValueError(MISSING) from None
    recording = rerun.RecordingStream("train_ato", recording_id=setup.scenario.name)
    stream = recording.binary_stream()  # type: ignore[misc]  # the writer of the package waits for ever on a full disk
    curves = [
        (f"{topic}/{name}", times, column)
        for topic, frame in frames.items()
        if 0 < frame.shape[1] <= MAX_COLUMNS
        for times in [np.asarray(frame.index, dtype=np.float64)]
        for name, column in _numbers(frame)
    ]
    _send_scene(rerun, recording, run, setup, rate=rate, progress=lambda share: progress(0.7 * share, "scene"))
    for number, (name, times, values) in enumerate(curves):
        recording.send_columns(
            name, indexes=[rerun.TimeColumn(TIMELINE, duration=times)], columns=rerun.Scalars.columns(scalars=values)
        )
        progress(0.7 + 0.3 * (number + 1) / len(curves), name)
    with writing(path):
        path.write_bytes(stream.read() or b"")
    recording.disconnect()
    return len(curves)


def _send_scene(
    rerun: Any, recording: Any, run: Path, setup: RunSetup, *, rate: float, progress: Callable[[float], None]
) -> None:
    """Send the track once, and the vehicles as boxes in the colour of their larger coupler force."""
    full = max(largest_force(run, setup)[0], MIN_SCALE)
    alignment, wire = Alignment(setup.line), Wire(setup.layout)
    drawn = alignment.at(alignment.drawn_places())
    recording.log("scene", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log("scene/track", rerun.LineStrips3D([np.column_stack((drawn.x, drawn.y, drawn.z))]), static=True)
    lengths = np.array([vehicle.length - GAP for vehicle in setup.consist.vehicles])
    half = np.column_stack((lengths / 2, np.full(lengths.size, WIDTH / 2), np.full(lengths.size, HEIGHT / 2)))
    period, last = round(SECOND / rate), -1
    for _, stamp, data in iter_raw(run, (VEHICLES,)):
        if stamp // period == last:
            continue
        last = stamp // period
        states = wire.decode(VEHICLES, data)
        pose = alignment.at(states.position)
        turn = np.column_stack(pose.quaternion)
        recording.set_time(TIMELINE, duration=stamp * 1e-9)
        centers = np.column_stack((pose.x, pose.y, pose.z + HEIGHT / 2))
        colors = force_color(larger_coupler_force(states.coupler_force), full)
        recording.log(
            "scene/vehicles",
            rerun.Boxes3D(centers=centers, half_sizes=half, quaternions=turn, colors=colors, fill_mode="solid"),
        )
        progress(min(1.0, stamp * 1e-9 / setup.scenario.duration))


def _numbers(frame: pd.DataFrame) -> list[tuple[str, Array]]:
    """Return the numeric columns of a table."""
    return [
        (str(name), frame[name].to_numpy(dtype=np.float64))
        for name in frame.columns
        if pd.api.types.is_numeric_dtype(frame[name].dtype)
    ]
