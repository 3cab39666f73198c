"""Runs that the tests of the report draw, and logs with parts of them missing."""

import shutil
from collections.abc import Collection
from pathlib import Path

from engine_runs import no_figure

from train_ato.cli import main
from train_ato.log.bag_layout import table_name
from train_ato.log.log_writer import LogFile
from train_ato.log.mcap_records import stream

EVENTFUL = [
    "--set=duration=70",
    "--set=plant.disturbances=[{kind: gust, begin: 12, end: 18, acceleration: -0.02}]",
    "--set=plant.sensors={couplers: [0], velocity_noise: 0.005, freeze: [{unit: 0, begin: 52, end: 53}]}",
    "--set=law_changes=[{at: 30, law: smc}, {at: 40.5, law: pid}]",
    "--set=brake={policy: planned, events: [{time: 45, reduction_kpa: 50}, {time: 60, reduction_kpa: 0}]}",
    "--set=links.command={delay: 0.8, jump: {at: 35, add: 0.4}}",
    "--set=interventions=[{do: gust, at: 48, acceleration: 0.01, duration: 3}, {do: emergency_brake, at: 66.2}]",
    "--observer=ndo",
]
"""70 s of the 106-vehicle train with a gust, a frozen measurement, two swaps, an air brake and a longer delay;
then a second gust and the emergency brake."""


def drive(folder: Path, name: str, scenario: str, *options: str) -> Path:
    """Drive a run in the engine and return its folder."""
    out = folder / name
    with no_figure():
        assert main(["run", scenario, "--engine", "--json", f"--out={out}", *options]) == 0
    return out


def without(run: Path, folder: Path, topics: Collection[str]) -> Path:
    """Copy a run with some of its topics left out of the log."""
    folder.mkdir()
    for name in ("scenario.yaml", "summary.json"):
        shutil.copy(run / name, folder / name)
    copy_messages(run / "run.mcap", LogFile(folder), topics)
    return folder


def copy_messages(source: Path, log: LogFile, left_out: Collection[str] = ()) -> None:
    """Write the messages of a log, but those of some topics, into a new one, and close it."""
    numbers: dict[str, int] = {}
    for message in stream(source):
        topic, schema, entries = message.channel.topic, message.schema, message.channel.metadata
        if table_name(topic) not in left_out:
            if topic not in numbers:
                more = (entries["topic_type_hash"], entries["offered_qos_profiles"])
                numbers[topic] = log.channel(topic, schema.name, schema.data.decode(), *more)
            log.write(numbers[topic], message.publish_ns, message.log_ns, message.data)
    log.close()
