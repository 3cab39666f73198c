"""Text of ``summary.json``: write, read, and check of the keys that commands use."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from plant_sim.data_text import parse_json
from plant_sim.input_error import explain, kind_of


class RecordedChange(BaseModel):
    """Row of ``changes``: time [s], name and value of a change during the run."""

    model_config = ConfigDict(extra="allow", strict=True)

    at_s: float
    name: str
    value: bool | int | float | str | dict[str, bool | int | float | str]
    planned: bool | None = None


class RecordedSummary(BaseModel):
    """Keys of a summary that commands use; all others are values of a table."""

    model_config = ConfigDict(extra="allow", strict=True)

    changes: list[RecordedChange] = []
    scenario: str = ""
    controller: str = ""
    observer: str = ""
    compensation: str = ""
    status: str = "done"
    failure: str | None = None
    mode: str | None = None
    way: str | None = None


def summary_text(summary: dict[str, Any]) -> str:
    """Return the JSON text of a summary."""
    return json.dumps(summary, indent=2, ensure_ascii=False) + "\n"


def parse_summary(file: Path, text: bytes) -> dict[str, Any]:
    """Return the content of a ``summary.json``; the key ``way`` of earlier versions is read as ``mode``.

    Raises
    ------
    ValueError
        One line with file, key and value: not JSON, or a key of another type.
    """
    try:
        summary = parse_json(text)
    except ValueError as error:
        raise ValueError(f"{file}: is not JSON ({error}); remove the file; the log is complete") from None
    if not isinstance(summary, dict):
        raise ValueError(f"{file}: holds {kind_of(summary)}, not metrics by name; remove the file")
    try:
        RecordedSummary.model_validate(summary)
    except ValidationError as error:
        fault = explain(error, file, RecordedSummary).lines[0]
        raise ValueError(f"{fault}; remove the file; the log is complete") from None
    return {"mode" if key == "way" else key: value for key, value in summary.items()}
