"""Copy of a log with the scene, for viewers that open one file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from train_ato.apps.scene.sampling import VEHICLES, SceneSampler
from train_ato.apps.scene.train_scene import DEFAULT_RATE, LEAST_SCALE, SceneTopic
from train_ato.log.bag_layout import qos_profiles, qos_text, table_name
from train_ato.log.definitions import definition
from train_ato.log.reading import Progress, attachments, iter_raw, log_file, stream
from train_ato.log.run_log import LogFile
from train_ato.log.wall_time import read_wall_time
from train_ato.loop.setup import RunSetup
from train_ato.messages.codec.codec import Wire
from train_ato.messages.topics import BY_NAME, EPOCH_NS


@dataclass(frozen=True)
class SceneLog:
    """Written scene.

    Attributes
    ----------
    messages : int
        Number of its messages.
    force : float
        Coupler force with the full colour [N].
    worst : float
        Time of the largest coupler force [s].
    """

    messages: int
    force: float
    worst: float


def write_scene_log(
    run: Path, setup: RunSetup, folder: Path, rate: float = DEFAULT_RATE, progress: Progress | None = None
) -> SceneLog:
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
    SceneLog
        Messages of the scene, and the largest coupler force.

    Raises
    ------
    ValueError
        If the log is damaged, or has no state of the vehicles.
    """
    path = log_file(run)
    force, worst = largest_force(run, setup)
    force = max(force, LEAST_SCALE)
    sampler = SceneSampler(setup, rate, force)
    wall_time = read_wall_time(path)
    log = LogFile(folder, attachments(path), wall_time=wall_time)
    numbers: dict[int, int] = {}
    scene = {topic.name: scene_channel(log, topic) for topic in sampler.scene.topics}
    count = 0
    try:
        for topic, data in sampler.scene.begin():
            log.write(scene[topic.name], EPOCH_NS, EPOCH_NS, data)
            count += 1
        for message in stream(path, progress=progress):
            number = message.channel.id
            if number not in numbers:
                numbers[number] = log.copy(message.channel, message.schema)
            log.write(numbers[number], message.publish_ns, message.publish_ns, message.data)
            if table_name(message.channel.topic) == VEHICLES:
                for topic, data in sampler.take(message.data):
                    log.write(scene[topic.name], message.publish_ns, message.publish_ns, data)
                    count += 1
    finally:
        log.close()
    return SceneLog(count, force, worst)


def scene_channel(log: LogFile, topic: SceneTopic) -> int:
    """Add a topic of the scene to a log; return its number."""
    known = definition(topic.type)
    profile = qos_profiles(BY_NAME["ato/limits" if topic.latched else VEHICLES])
    return log.channel(topic.name, topic.type, known.text, known.hash, qos_text(profile))


def largest_force(run: Path, setup: RunSetup) -> tuple[float, float]:
    """Return the largest coupler force in the states of the vehicles of a log [N], and its time [s].

    Raises
    ------
    ValueError
        If the log has no state of the vehicles, as that of a measured run.
    """
    wire, found = Wire(setup.layout), (-1.0, 0.0)
    for _, stamp, data in iter_raw(run, (VEHICLES,)):
        force = float(np.abs(wire.decode(VEHICLES, data).coupler_force).max(initial=0.0))
        if force > found[0]:
            found = (force, stamp * 1e-9)
    if found[0] < 0.0:
        raise ValueError(f"{run}: has no states of the vehicles ({VEHICLES}); name the log of a simulated run")
    return found
