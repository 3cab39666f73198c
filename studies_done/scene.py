"""CPU time of the scene of the 106-vehicle train: a message set with templates and with rosbags.

    python studies_done/scene.py

A set is /tf, the poses and the markers at one stamp. The comparison builds the same markers field by field.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Figure, publish

from train_ato.view.train_scene import DEFAULT_RATE, MARKERS, TrainScene
from train_ato.scenario.setup import prepare
from train_ato.messages.cdr import typestore
from train_ato.messages.types import VehicleStates
from train_ato.scenario.scenario import load_scenario

SETS = 200
ROUNDS = 5


def cpu_ms(action: Callable[[], object], count: int) -> float:
    """Return the CPU time of one call [ms], the best of some rounds."""
    best = np.inf
    for _ in range(ROUNDS):
        begin = time.process_time()
        for _ in range(count):
            action()
        best = min(best, time.process_time() - begin)
    return 1e3 * best / count


def main() -> None:
    """Measure and print."""
    setup = prepare(*load_scenario("demo"))
    scene = TrainScene(setup, 500e3)
    offsets = np.array(setup.consist.offsets)
    states = VehicleStates(0, 11_000.0 - offsets, np.zeros(106), np.linspace(-400e3, 400e3, 106))
    messages = {topic.name: data for topic, data in scene.at(states)}
    markers = typestore().deserialize_cdr(messages[MARKERS.name], MARKERS.type)

    def by_fields() -> bytes:
        for marker in markers.markers:
            marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = 1.0, 2.0, 3.0
            marker.color.r, marker.color.g, marker.color.b = 0.1, 0.2, 0.3
        return bytes(typestore().serialize_cdr(markers, MARKERS.type))

    ours = cpu_ms(lambda: scene.at(states), SETS)
    result = {
        "set_ms": ours,
        "cpu_per_simulated_second_ms": ours * DEFAULT_RATE,
        "markers_alone_by_fields_ms": cpu_ms(by_fields, 20),
        "bytes_of_a_set": sum(map(len, messages.values())),
    }
    publish(Figure("message set of the scene", ours, "ms", "markers by fields", result["markers_alone_by_fields_ms"]))
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
