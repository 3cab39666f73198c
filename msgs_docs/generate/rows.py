"""JSON files that the repository keeps: a line for each row, so that a change shows which rows it changes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def read_rows(path: Path) -> Any:
    """Return the rows of a file; an empty table without the file."""
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def rows_text(value: Any, levels: int = 1) -> str:
    """Return JSON with a line for each entry of the outer levels."""
    if levels == 0 or not value or not isinstance(value, (dict, list)):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, list):
        return "[\n" + ",\n".join(rows_text(entry, levels - 1) for entry in value) + "\n]"
    return "{\n" + ",\n".join(f"{json.dumps(key)}: {rows_text(value[key], levels - 1)}" for key in value) + "\n}"


def write_rows(path: Path, value: Any, levels: int = 1) -> None:
    """Write a file of rows."""
    path.write_text(rows_text(value, levels) + "\n", encoding="utf-8")
