"""Example messages of every topic, from short runs of a heavy-haul train with a train ahead."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

import train_ato as ta
from plant_sim.states import Odometry
from train_ato.loop.engine import run_engine
from train_ato.loop.run_end import RunEnd
from train_ato.loop.train_ahead import ReportSender
from train_ato.messages.codec.cdr import typestore
from train_ato.messages.codec.codec import Wire
from train_ato.messages.topics import END_TOPIC, REPORT, TOPICS
from train_ato.messages.types import Tick

SHOWN = 3
"""Number of the entries of a list that an example shows."""
RUN = {
    "base": "daqin_heavy_haul",
    "duration": 20.0,
    "plant": {"disturbances": [{"kind": "paper001"}]},
    "supervision": {"enabled": True},
    "leader": {"train": "/t1"},
}


class _Last:
    """Receiver of the messages of a run that has the last one of each topic."""

    def __init__(self) -> None:
        self.messages: dict[str, Any] = {}

    def add(self, topic: str, message: object, stamp: int) -> None:
        """Take a message of a stamp [ns]."""
        self.messages[topic] = message

    def add_ticks(self, block: Any) -> bool:
        """Refuse a block of ticks: its messages come one by one."""
        return False


@cache
def examples() -> dict[str, str]:
    """Return an example of the messages of every topic as YAML, in the form of ``ros2 topic echo``."""
    setup = ta.scenario(RUN).prepare().reporting()
    front = setup.profile.position[0] + 3000.0
    end = setup.ticks * setup.tick_ns
    sender, stamps = ReportSender(setup), range(0, end + 1, setup.supervision_ticks * setup.tick_ns)
    reports = [sender.message(Odometry(stamp, np.full(2, front), np.full(2, 20.0), np.zeros(2))) for stamp in stamps]
    setup, last = replace(setup, ahead=tuple(reports)), _Last()
    run_engine(setup, sink=last)
    found = last.messages | {
        REPORT: reports[-1],
        END_TOPIC: RunEnd.judged(setup.ticks, setup.ticks, None, None).notice(end),
        "recorder/progress": Tick(end),
    }
    wire, store = Wire(setup.layout), typestore()
    return {
        topic.name: "\n".join(_echo(store.deserialize_cdr(wire.encode(topic.name, found[topic.name]), topic.type)))
        for topic in TOPICS
        if topic.name in found
    }


def _echo(message: Any, indent: str = "") -> Iterator[str]:
    """Yield the lines of a message; a long list ends with its length."""
    for field in dataclasses.fields(message):
        if field.name.startswith("__") or field.name.isupper():  # a constant of the type
            continue
        value = getattr(message, field.name)
        if dataclasses.is_dataclass(value):
            yield f"{indent}{field.name}:"
            yield from _echo(value, f"{indent}  ")
        elif isinstance(value, (list, np.ndarray)):
            yield from _echo_list(field.name, list(value), indent)
        else:
            yield f"{indent}{field.name}: {_text(value)}"


def _echo_list(name: str, values: list[Any], indent: str) -> Iterator[str]:
    rest = f"  # {len(values)} in all" if len(values) > SHOWN else ""
    if not values or not dataclasses.is_dataclass(values[0]):
        yield f"{indent}{name}: [{', '.join(map(_text, values[:SHOWN]))}{', ...' if rest else ''}]{rest}"
        return
    yield f"{indent}{name}:{rest}"
    for value in values[:SHOWN]:
        lines = list(_echo(value, f"{indent}  "))
        yield f"{indent}- {lines[0].lstrip()}"
        yield from lines[1:]


def _text(value: Any) -> str:
    if isinstance(value, str):
        return f"'{value}'"
    return f"{value + 0.0:.6g}" if isinstance(value, float) else str(value)
