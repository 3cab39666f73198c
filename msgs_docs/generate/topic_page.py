"""Documentation of the topics, made from the topic table.

``python -m train_ato.topic_docs`` writes ``msgs_docs/topics.md`` again; a test fails when it is older than the table.
"""

from __future__ import annotations

from pathlib import Path

from train_ato.topics import DIAGNOSTIC_UNITS, TOPICS, Topic

PAGE = Path("msgs_docs", "topics.md")
"""Where it is written, below the top of the repository, where the command is started."""


def page() -> str:
    """Return the page."""
    lines = [
        "# Topics",
        "",
        "Made from `train_ato/topics.py` by `python -m train_ato.topic_docs`; do not edit by hand.",
        "",
        "| topic | type | from | to | rate | QoS | meaning |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [_row(topic) for topic in TOPICS]
    for topic in TOPICS:
        lines += ["", f"## `{topic.name}`", "", f"{topic.meaning[0].upper()}{topic.meaning[1:]}.", ""]
        lines += ["| field | unit | meaning |", "|---|---|---|"]
        lines += [f"| `{field}` | {unit or '-'} | {meaning or '-'} |" for field, unit, meaning in topic.fields]
        if topic.name == "/diagnostics":
            lines += _units()
    return "\n".join(lines) + "\n"


def _units() -> list[str]:
    """Return which values of the diagnostics have which unit."""
    by_unit: dict[str, list[str]] = {}
    for key, unit in DIAGNOSTIC_UNITS.items():
        by_unit.setdefault(unit, []).append(f"`{key}`")
    return ["", "Keys with a unit:", "", *(f"* {unit}: {', '.join(keys)}" for unit, keys in by_unit.items())]


def _row(topic: Topic) -> str:
    senders = ", ".join(role.value for role in topic.publishers)
    readers = ", ".join(role.value for role in topic.readers) or ("recorder" if topic.recorded else "-")
    qos = f"reliable, {'transient local' if topic.latched else 'volatile'}, depth {topic.depth}"
    return f"| `{topic.name}` | `{topic.type}` | {senders} | {readers} | {topic.rate.value} | {qos} | {topic.meaning} |"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
