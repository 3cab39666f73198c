"""Generate the page of the loop for the site: delays, lags and limits in one picture, signs and frames in a table."""

from __future__ import annotations

import json
from typing import Any

from msgs_docs.generate.reference_pages import as_cell, as_code, as_table
from msgs_docs.generate.rows import page_text
from msgs_docs.generate.schemas import schema_text

PARTS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("1 sensors", ("plant.sensors.position_noise", "plant.sensors.velocity_noise", "plant.sensors.position_quantum",
                   "plant.sensors.velocity_quantum", "plant.sensors.position_bias", "plant.sensors.velocity_bias")),
    ("2 measurement link", ("links.measurement.delay", "links.measurement.jitter", "links.measurement.loss")),
    ("3 reference link", ("links.reference.delay",)),
    ("4 estimate link", ("links.estimate.delay",)),
    ("5 law", ("tick", "control_period", "hold_limit")),
    ("6 command link", ("links.command.delay", "links.command.delay_brake", "links.command.varying",
                        "links.command.jitter", "links.command.loss", "links.command.jump")),
    ("7 actuator", ("plant.mismatch.actuator_gain", "plant.dead_band", "plant.force_limit", "plant.adhesion",
                    "plant.rate_limit", "plant.lag")),
    ("8 air brake", ("links.brake_pipe.delay",)),
    ("9 supervisor", ("supervision.period", "links.brake_release.delay", "supervision.failsafe.hold",
                      "supervision.failsafe.coast", "supervision.failsafe.service", "supervision.failsafe.release")),
    ("model of the law", ("model.delay", "model.delay_brake", "model.lag")),
)  # fmt: skip
"""Keys of a scenario by part of the loop."""


def loop_page() -> str:
    """Return the page of the loop."""
    schema = json.loads(schema_text("scenario"))
    rows = []
    for part, keys in PARTS:
        for key in keys:
            value = key_of(schema, key)
            default = as_code(value["default"]) if "default" in value else ""
            rows.append((part, f"`{key}`", as_cell(value.get("description", "")), default))
    return page_text("loop", keys=as_table(("part", "key", "meaning", "default"), rows))


def key_of(schema: dict[str, Any], path: str) -> dict[str, Any]:
    """Return the schema of the key of a scenario at a dotted path.

    Raises
    ------
    KeyError
        If a scenario has no such key.
    """
    block: dict[str, Any] = schema
    for name in path.split("."):
        for part in (block, *block.get("anyOf", ())):
            if "$ref" in part:
                block = schema["$defs"][part["$ref"].rpartition("/")[2]]
        block = block["properties"][name]
    return block
