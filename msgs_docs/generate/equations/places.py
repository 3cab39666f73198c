"""Places of the equations in the code: file and line from the source."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from typing import Any


def source_line(place: str, root: Path) -> tuple[str, int]:
    """Return the path from the top folder and the line of a place.

    Parameters
    ----------
    place
        ``module:qualified.name``, or ``folder/file:text``.
    root
        Top folder of the repository.

    Raises
    ------
    ValueError
        If the module, the name, the file or the text does not exist.
    """
    where, _, name = place.partition(":")
    if "/" in where:
        return where, _line_of_text(root / where, name, place)
    try:
        found: Any = importlib.import_module(where)
        for part in name.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"place '{place}': {error}; name a function or class") from None
    found = getattr(found, "fget", None) or getattr(found, "py_func", found)  # a property, a compiled function
    try:
        path, line = Path(inspect.getsourcefile(found) or ""), inspect.getsourcelines(found)[1]
    except TypeError:
        raise ValueError(f"place '{place}' has no source; name a function or class") from None
    return str(path.resolve().relative_to(root)), line


def _line_of_text(path: Path, text: str, place: str) -> int:
    """Return the line of the first occurrence of a text in a file."""
    if not path.is_file():
        raise ValueError(f"place '{place}': no such file; correct it")
    content = path.read_text(encoding="utf-8")
    if not text or text not in content:
        raise ValueError(f"place '{place}': the file does not contain this text; correct it")
    return content[: content.index(text)].count("\n") + 1
