"""Files of other kinds: the format is named, with the formats that are read in its place."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

LINE_FORMATS = "train_ato YAML, railtoolkit YAML, TTOBench JSON, OSRD JSON, railML 3"
TRAIN_FORMATS = "train_ato YAML, railtoolkit YAML, TTOBench JSON"

_BY_ENDING = {
    ".gpx": "GPX", ".kml": "KML", ".osm": "OpenStreetMap XML", ".csv": "a table (CSV)", ".tsv": "a table (TSV)",
    ".xlsx": "a table (Excel)", ".ods": "a table (OpenDocument)", ".txt": "plain text", ".pdf": "PDF",
}  # fmt: skip
_BY_KEYS: tuple[tuple[str, str, str], ...] = (
    ("effort_curves", "a rolling stock of OSRD", "train"),
    ("idx_next", "a network of ALTRIOS", "line"),
    ("elevs", "a network of ALTRIOS", "line"),
    ("elev_meters", "a list of heights of ALTRIOS", "line"),
    ("loco_vec", "a locomotive consist of ALTRIOS", "train"),
    ("loco_type", "a locomotive of ALTRIOS", "train"),
    ("car_type", "a rail vehicle of ALTRIOS", "train"),
    ("n_cars_by_type", "a train of ALTRIOS", "train"),
    ("loco_con", "a train simulation of ALTRIOS", "train"),
    ("coordinates", "GeoJSON", "line"),
    ("features", "GeoJSON", "line"),
    ("elements", "OpenStreetMap JSON", "line"),
)
"""Key that a format alone has, the format, and the content of the file."""
_READ = {"train": (TRAIN_FORMATS, "consist"), "line": (LINE_FORMATS, "line")}


def kind_by_ending(path: Path) -> str | None:
    """Return the format of a file without keys and values, by its ending."""
    return _BY_ENDING.get(path.suffix.lower())


def kind_by_keys(data: Any) -> tuple[str, str]:
    """Return the format of data that are not read, and ``train`` or ``line``; empty for an unknown one.

    Examples
    --------
    >>> kind_by_keys([{"idx_curr": 1, "idx_next": 2}])
    ('a network of ALTRIOS', 'line')
    """
    entries = data if isinstance(data, list) else [data]
    if isinstance(data, dict) and len(data) == 1:  # the whole below one name
        (below,) = data.values()
        entries = [data, *(below if isinstance(below, list) else [below])]
    keys = {str(key) for entry in entries[:3] if isinstance(entry, dict) for key in entry}
    return next(((kind, what) for key, kind, what in _BY_KEYS if key in keys), ("", ""))


def refuse_foreign(data: Mapping[str, Any], place: str, what: str, kinds: Mapping[str, str]) -> None:
    """Refuse data that are no ``train`` or ``line`` of a supported format.

    Parameters
    ----------
    kinds
        Format of the data, as ``train`` or ``line``.

    Raises
    ------
    ValueError
        One line with file, format and remedy.
    """
    other = "train" if what == "line" else "line"
    if other in kinds:
        raise ValueError(f"{place}: holds a {other} ({kinds[other]}), no {what}; exchange them")
    kind, held = kind_by_keys(data)
    if kind:
        raise ValueError(f"{place}: {kind} is not read; {formats_read(held)}")
    schema = str(data.get("schema", ""))
    formats, own = _READ[what]
    raise ValueError(
        f"{place}: schema = '{schema[:60]}': no supported {what} format ({formats}); "
        f"begin a train_ato file with 'schema: train_ato/{own}/1'"
    )


def formats_read(what: str) -> str:
    """Return the remedy for a ``train`` or ``line`` of another format."""
    formats, own = _READ[what]
    return f"a {what} is read from {formats}; write its figures in one of these (own format: train_ato/{own}/1)"
