"""Files beside the pages: JSON with a line for each row, so that a change shows its rows; texts of the pages."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from plant_sim.library import read_yaml
from plant_sim.units import number_text


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


def row_line(*cells: object) -> str:
    """Return the line of a table with some cells, whose bars are escaped."""
    return "| " + " | ".join(re.sub(r"(?<!\\)\|", r"\\|", str(cell)) for cell in cells) + " |"


def parameter_cell(value: object) -> str:
    """Return the value of a parameter as the text of a cell."""
    if isinstance(value, bool):
        return str(value).lower()
    return number_text(value) if isinstance(value, (int, float)) else str(value) or "-"


def table_lines(heads: Sequence[str], rows: Iterable[Iterable[object]]) -> list[str]:
    """Return the lines of a table."""
    return [row_line(*heads), "|---" * len(heads) + "|", *(row_line(*cells) for cells in rows)]


def unmeasured_rows(kind: str, name: str, wanted: Mapping[str, object], found: Mapping[str, Any]) -> list[str]:
    """Return one line per row of a table without current figures, and per leftover.

    Parameters
    ----------
    kind, name
        Kind of the rows, and name of their table for ``--measure``.
    wanted
        What determines the run of every row, by its name.
    found
        Measured figures by the name of the row; ``run`` of each is what determined its run.
    """
    remedy = f"run python -m msgs_docs.generate --measure {name}"
    old = [row for row, run in wanted.items() if found.get(row, {}).get("run") != run]
    lines = [f"{kind} '{row}': not measured; {remedy}" for row in old]
    return lines + [f"{kind} '{row}': no such row; {remedy}" for row in found.keys() - wanted.keys()]


def texts(name: str) -> Any:
    """Return the content of ``NAME.yaml`` beside the modules: rows and texts of a page."""
    return read_yaml(Path(__file__).with_name(f"{name}.yaml"))


def page_text(name: str, **parts: object) -> str:
    """Return a page: the Jinja template ``NAME.txt`` with its parts; a list is the lines of a table."""
    pages = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        finalize=lambda part: "\n".join(part) if isinstance(part, list) else part,
    )
    return pages.get_template(f"{name}.txt").render(parts).rstrip("\n") + "\n"
