"""Generate ``msgs_docs/topics.md`` from the topic table."""

import dataclasses
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import train_ato as ta
from msgs_docs.generate.rows import page_text, table_lines
from plant_sim.states import Odometry
from plant_sim.units import unit_suffix
from train_ato.judge.run_end import RunEnd
from train_ato.loop.engine import Sink, TickLoop, run_engine
from train_ato.loop.train_ahead import ReportSender
from train_ato.messages.cdr import typestore
from train_ato.messages.codec import Wire
from train_ato.messages.topic import FIXED_NAMES, Owner
from train_ato.messages.topics import DIAGNOSTIC_UNITS, END_TOPIC, FORCE_PARTS, REPORT, TOPICS, Place, Topic
from train_ato.messages.types import Tick
from train_ato.messages.variable_codec import HARDWARE, LISTED, STATUS_NAMES, message_key

SHOWN = 3
"""Number of the entries of a list that an example shows."""
RUN = {
    "base": "daqin_heavy_haul",
    "duration": 20.0,
    "plant": {"disturbances": [{"kind": "paper001"}]},
    "supervision": {"enabled": True},
    "leader": {"train": "/t1"},
}


class _Last(Sink):
    """Receiver of the messages of a run that has the last one of each topic."""

    loop: TickLoop

    def __init__(self) -> None:
        self.messages: dict[str, Any] = {}

    def keep(self, loop: TickLoop) -> bool:
        """Keep the loop of the run, and end it at no tick."""
        self.loop = loop
        return False

    def add(self, topic: str, message: object, stamp: int) -> None:
        """Take a message of a stamp [ns]."""
        self.messages[topic] = message


@cache
def examples() -> dict[str, str]:
    """Return an example of the messages of every topic as YAML, in the form of ``ros2 topic echo``."""
    setup = ta.scenario(RUN).prepare().reporting()
    front = setup.profile.position[0] + 3000.0
    end = setup.ticks * setup.tick_ns
    sender, stamps = ReportSender(setup), range(0, end + 1, setup.supervision_ticks * setup.tick_ns)
    reports = [sender.message(Odometry(stamp, np.full(2, front), np.full(2, 20.0), np.zeros(2))) for stamp in stamps]
    setup, last = replace(setup, ahead=tuple(reports)), _Last()
    run_engine(setup, sink=last, on_tick=last.keep)
    found = last.messages | {
        REPORT: reports[-1],
        END_TOPIC: RunEnd.judged(setup.ticks, setup.ticks, None, None).notice(end),
        "recorder/progress": Tick(end),
        FORCE_PARTS: last.loop.controller.force_parts(last.messages["ato/command"]),
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


PAGE = Path("msgs_docs", "topics.md")
HEADS = ("topic", "type", "from", "subscribers besides the recorder", "rate", "QoS", "meaning")


def page() -> str:
    """Return the text of the page."""
    units: dict[str, list[str]] = {}
    for key, unit in DIAGNOSTIC_UNITS.items():
        listed = f"`{key}_I{unit_suffix(unit)}`"
        units.setdefault(unit, []).append(listed if key in LISTED else f"`{message_key(key)}`")
    nodes: dict[str, list[str]] = {}
    for node, name in HARDWARE.items():
        nodes.setdefault(name, []).append(node)
    return page_text(
        "topics",
        table=table_lines(HEADS, map(_row, TOPICS)),
        topics=TOPICS,
        meaning=lambda topic: f"{topic.meaning[0].upper()}{topic.meaning[1:]}{_condition(topic)}.",
        fields=_fields,
        parts=", ".join(f"`{name}`" for name in STATUS_NAMES.values()),
        hardware=", ".join(f"`{name}` ({', '.join(nodes)})" for name, nodes in nodes.items()),
        units=units,
        examples=examples(),
    )


def _fields(topic: Topic) -> list[str]:
    rows = table_lines(("field", "column", "unit", "meaning"), ())
    if topic.has_states:
        (owner,) = topic.owners
        each = f", with each of {_names(owner)} in place of `NAME`: {owner.meaning}" if _prefix(owner) == "NAME" else ""
        rows.append(f"| `status[0].values[].key` | - | - | name of the column{each} |")
    elif topic.owners:
        names = "; ".join(f"{_names(owner)}: {owner.meaning}" for owner in topic.owners)
        rows.append(f"| `{topic.names_path}` | - | - | {names} |")
    if topic.has_states:
        rows.append("| `status[0].message` | - | - | the values in words; `level` 1 or 2 for a brake or a failure |")
    if topic.frame != "":
        rows.append(f"| `header.frame_id` | - | - | {_frame(topic)} |")
    rows += [
        f"| `{path}` | - | - | constant text {', '.join(f'`{text}`' for text in texts)} |"
        for path, texts in topic.texts
    ]
    return rows + [_field(topic, place) for place in topic.places]


def _frame(topic: Topic) -> str:
    """Return the frame of the header as text."""
    if isinstance(topic.frame, str):
        return f"`{topic.frame}`: positions are chainages"
    return "the vehicle of the pressure: " + ("`vehicle_0`" if topic.frame == 0 else "the last one, `vehicle_I`")


def _names(owner: Owner) -> str:
    """Return the names of the parts of a train as text."""
    return ", ".join(f"`{name}`" for name in FIXED_NAMES.get(owner, (f"{owner.value}_I",)))


def _prefix(owner: Owner) -> str:
    """Return the first part of the columns of a kind of part: its only name, ``NAME`` for several."""
    names = FIXED_NAMES.get(owner, (f"{owner.value}_I",))
    return names[0] if len(names) == 1 else "NAME"


def _field(topic: Topic, place: Place) -> str:
    found = topic.description(place)
    if place is not next(other for other in topic.places if other.field == place.field):
        return f"| `{place.path}` | - | {found.unit} | the same again, because a JointState has one value per name |"
    if place.owner and FIXED_NAMES.get(place.owner, ("",))[0].endswith(f"_{found.column}"):
        return f"| `{place.path}` | `NAME{unit_suffix(found.unit)}` | {found.unit} | {found.meaning} |"
    name = (
        f"`{topic.column(place, _prefix(place.owner) if place.owner else '')}`" if found.column else "one for each key"
    )
    path = "status[0].values[].value" if topic.has_states else place.path
    return f"| `{path}` | {name} | {found.unit or '-'} | {found.meaning or '-'} |"


def _condition(topic: Topic) -> str:
    return f" ({topic.condition.text})" if topic.condition.text else ""


def _row(topic: Topic) -> tuple[str, ...]:
    senders = ", ".join(role.value for role in topic.publishers)
    readers = ", ".join(role.value for role in topic.readers) or "-"
    qos = f"reliable, {'transient local' if topic.latched else 'volatile'}, depth {topic.depth}"
    meaning = topic.meaning + _condition(topic)
    return f"`{topic.name}`", f"`{topic.type}`", senders, readers, topic.rate.value, qos, meaning
