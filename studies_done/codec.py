"""Time of encoding and decoding the messages of a long train, compared with rosbags in the same run.

    python studies_done/codec.py

A row is one topic of a train with 106 vehicles, one power unit and an air brake: microseconds for a message with the
codec of the topic table and with the serialiser of ``rosbags``, and their ratio.  Both are timed in turns; the best
time counts.  The exit status is 1 if the ratio of ``train/vehicles`` is far below its goal (see figures.py).
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Figure, Goal, judge, publish
import numpy as np

from train_ato.messages.cdr import typestore
from train_ato.messages.codec import Wire
from train_ato.messages.topic import TrainLayout
from train_ato.messages.topics import BY_NAME, Topic, tick_topics

LAYOUT = TrainLayout(106, 1, (0, 52), air_brake=True, disturbed=True)
CHARGED = "train/vehicles"
"""Topic of the goal: the longest message of a tick."""
LEAST = 10.0
"""Least ratio of encoding and decoding together."""
TURNS, REPEATS = 40, 100


def message_of(topic: Topic) -> Any:
    """Return a message of a topic with numbers of typical size."""
    random = np.random.default_rng(1)
    values: dict[str, Any] = {"stamp": 123_400_000_000}
    owners = {place.field: place.owner for place in topic.places}
    for entry in dataclasses.fields(topic.message):
        if entry.name != "stamp":
            owner = owners[entry.name]
            single = 7 if entry.name == "planned" else 550e3
            values[entry.name] = single if owner is None else random.normal(size=len(LAYOUT.names(owner))) * 1e5
    return topic.message(**values)


def timed(actions: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Return the best time of each action [us], measured in turns."""
    best = dict.fromkeys(actions, float("inf"))
    for _ in range(TURNS):
        for name, action in actions.items():
            begin = time.perf_counter()
            for _ in range(REPEATS):
                action()
            best[name] = min(best[name], time.perf_counter() - begin)
    return {name: 1e6 * seconds / REPEATS for name, seconds in best.items()}


def row(topic: Topic, wire: Wire) -> dict[str, float]:
    """Return the times of one topic [us]."""
    types, name = typestore(), topic.name
    message = message_of(topic)
    data = wire.encode(name, message)
    decoded = types.deserialize_cdr(data, topic.type)
    return timed(
        {
            "encode": lambda: wire.encode(name, message),
            "encode, rosbags": lambda: types.serialize_cdr(decoded, topic.type),
            "decode": lambda: wire.decode(name, data),
            "decode, rosbags": lambda: types.deserialize_cdr(data, topic.type),
        }
    )


def main() -> int:
    """Print the table and the goal; return the exit status."""
    wire = Wire(LAYOUT)
    titles = ("encode", "rosbags", "ratio", "decode", "rosbags", "ratio")
    print(f"{'us a message':24s} {' '.join(f'{title:>8s}' for title in titles)}")
    reached = 0.0
    for name in tick_topics(LAYOUT):
        found = row(BY_NAME[name], wire)
        cells: list[float] = []
        for action in ("encode", "decode"):
            ours, theirs = found[action], found[f"{action}, rosbags"]
            cells += [ours, theirs, theirs / ours]
        print(f"{name:24s} {' '.join(f'{cell:8.2f}' for cell in cells)}")
        ours, theirs = cells[0] + cells[3], cells[1] + cells[4]
        publish(Figure(f"{name}, encoded and decoded", ours, "us", "rosbags", theirs))
        if name == CHARGED:
            reached = (cells[1] + cells[4]) / (cells[0] + cells[3])
    print(f"{CHARGED}: {reached:.1f} times as fast as rosbags")
    return judge((Goal(f"time of rosbags for {CHARGED} over ours", reached, LEAST, "", at_least=True),))


if __name__ == "__main__":
    sys.exit(main())
