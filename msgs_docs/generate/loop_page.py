"""Generate the page of the loop for the site: delays, lags and limits in one picture, signs and frames in a table."""

from __future__ import annotations

import json
from typing import Any

from msgs_docs.generate.reference_pages import as_cell, as_code, as_table
from msgs_docs.generate.schemas import schema_text

PICTURE = """
train --1 sensors--> 2 measurement link --+--> profile --3 reference link--+
  ^                                       +--> observer --4 estimate link--+--> 5 law, held command
  |                                       +--------------------------------+           |
  |                                                                                    |
  +-- 7 actuator: gain, dead band, envelope, adhesion, rate, lag <-- 6 command link <--+
  |
  +-- 8 air brake: wave along the train, cylinders <-- brake pipe link <-- brake policy
  |
  +-- 9 supervisor: odometry, braking curves --brake release link--> the train brakes without it
"""
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
SIGNS: tuple[tuple[str, str, str], ...] = (
    ("position", "centre of a vehicle, mostly of vehicle 0, the first one", "increases in running direction"),
    ("place of a stop, of a limit, of the planner", "front of the train", "increases in running direction"),
    ("speed, acceleration", "vehicle along the line", "> 0 in running direction"),
    ("speed error, position error", "train minus reference", "> 0: too fast, ahead"),
    ("stop error", "front of the train minus target", "> 0 beyond the target"),
    ("delay of an arrival", "arrival minus planned arrival", "> 0 late"),
    ("force, command, disturbance", "power unit or vehicle", "> 0 forward: traction; < 0: electric brake"),
    ("coupler force", "coupler behind a vehicle", "> 0 draft (tension), < 0 buff (compression)"),
    ("grade", "line", "> 0 uphill"),
    ("reduction of the brake pipe", "below the charged pressure", "> 0 brakes"),
)
"""Quantity, place or frame, and sign."""


def loop_page() -> str:
    """Return the page of the loop."""
    schema = json.loads(schema_text("scenario"))
    rows = []
    for part, keys in PARTS:
        for key in keys:
            value = key_of(schema, key)
            default = as_code(value["default"]) if "default" in value else ""
            rows.append((part, f"`{key}`", as_cell(value.get("description", "")), default))
    return (
        "# The loop with every delay, lag and limit\n\nThe envelope, the masses and the air brake are keys of the "
        "[train](../reference/keys_consist.md), all others of the [scenario](../reference/keys_scenario.md).\n\n"
        f"```text{PICTURE}```\n\n{as_table(('part', 'key', 'meaning', 'default'), rows)}\n"
        "The dead time of a unit is the delay of its command, its lag and a control period; compensations use that of "
        "the model.\n\n## Signs and frames\n\n"
        f"{as_table(('quantity', 'place or frame', 'sign'), [tuple(map(as_cell, row)) for row in SIGNS])}\n"
        "Units are SI; another unit is a suffix of the name. Time is the time of the simulation from its begin.\n"
    )


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
