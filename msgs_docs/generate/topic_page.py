"""Generate ``msgs_docs/topics.md`` from the topic table."""

from __future__ import annotations

from pathlib import Path

from msgs_docs.generate.example_messages import examples
from plant_sim.units import unit_suffix
from train_ato.messages.codec.variable import HARDWARE, LISTED, message_key
from train_ato.messages.topic import FIXED_NAMES, Owner
from train_ato.messages.topics import DIAGNOSTIC_UNITS, TOPICS, Place, Topic
from train_ato.messages.types import Diagnostic

PAGE = Path("msgs_docs", "topics.md")
"""Path of the page in the repository."""


def page() -> str:
    """Return the text of the page."""
    lines = [
        "# Topics",
        "",
        "Made from `train_ato/messages/topics.py` by `python -m msgs_docs.generate`; do not edit by hand.",
        "",
        "| topic | type | from | subscribers besides the recorder | rate | QoS | meaning |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [_row(topic) for topic in TOPICS]
    lines += [
        "",
        "Below, `field` is the field of the ROS message and `column` that of the [tables](tables.md) of a log; `I` is",
        "the number in the name of a vehicle, power unit or sensor, `NAME` one of the listed names. Fields that are",
        "not listed are empty or 0. Below each table is a message of a heavy-haul train in a namespace, behind another",
        "train, in the form of `ros2 topic echo`. A long list is cut.",
    ]
    for topic in TOPICS:
        lines += [
            "",
            f"## `{topic.name}`",
            "",
            f"{topic.meaning[0].upper()}{topic.meaning[1:]}{_condition(topic)}.",
            "",
        ]
        lines += ["| field | column | unit | meaning |", "|---|---|---|---|", *_fields(topic)]
        if topic.message is Diagnostic:
            lines += _units()
        if example := examples().get(topic.name):
            lines += ["", "```yaml", example, "```"]
    return "\n".join(lines) + "\n"


def _fields(topic: Topic) -> list[str]:
    rows = []
    if topic.owners:
        names = "; ".join(f"{_names(owner)}: {owner.meaning}" for owner in topic.owners)
        rows.append(f"| `name` | - | - | {names} |")
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
    owner = f"{_prefix(place.owner)}_" if place.owner else ""
    name = f"`{owner}{found.column}{unit_suffix(found.unit)}`" if found.column else "one for each key"
    return f"| `{place.path}` | {name} | {found.unit or '-'} | {found.meaning or '-'} |"


def _units() -> list[str]:
    """Return the lines with ``hardware_id`` and the keys of the diagnostics by unit."""
    by_unit: dict[str, list[str]] = {}
    for key, unit in DIAGNOSTIC_UNITS.items():
        listed = f"`{key}_I{unit_suffix(unit)}`"
        by_unit.setdefault(unit, []).append(listed if key in LISTED else f"`{message_key(key)}`")
    of_unit: dict[str, list[str]] = {}
    for node, name in HARDWARE.items():
        of_unit.setdefault(name, []).append(node)
    hardware = ", ".join(f"`{name}` ({', '.join(nodes)})" for name, nodes in of_unit.items())
    return [
        "",
        f"`status[].hardware_id` is the unit of the vehicle: {hardware}. A value with",
        "a unit is a plain number, and its key ends with the unit (`I`: number of the power unit).",
        "Keys with a unit:",
        "",
        *(f"* {unit}: {', '.join(keys)}" for unit, keys in by_unit.items()),
    ]


def _condition(topic: Topic) -> str:
    return f" ({topic.condition.text})" if topic.condition.text else ""


def _row(topic: Topic) -> str:
    senders = ", ".join(role.value for role in topic.publishers)
    readers = ", ".join(role.value for role in topic.readers) or "-"
    qos = f"reliable, {'transient local' if topic.latched else 'volatile'}, depth {topic.depth}"
    meaning = topic.meaning + _condition(topic)
    return f"| `{topic.name}` | `{topic.type}` | {senders} | {readers} | {topic.rate.value} | {qos} | {meaning} |"
