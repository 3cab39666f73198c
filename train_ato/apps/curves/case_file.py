"""Case file of braking curves (JSON): inputs, and the speeds of each curve.

A file holds one case (``inputs``, ``curves``) or several by name.
"""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import BeforeValidator, Field, model_validator

from plant_sim.data_text import parse_json
from plant_sim.input_error import build_model, kind_of
from plant_sim.si_model import SiModel
from train_ato.apps.curves.case_inputs import CurveInputs

MAX_FILE_SIZE = 16 * 2**20
"""Largest case file [bytes]."""
CURVE_NAMES = ("EBD", "SBD", "EBI", "SBI1", "SBI2", "SBI", "Warning", "Permitted", "Indication")
"""Names of the curves of a case, from the target backwards."""
MAX_ROW_SPEED = 600.0
"""Largest speed of a curve [km/h]."""


def _row(value: Any) -> tuple[float, float | None]:
    """Return speed [km/h] and distance [m] or None of a row.

    Raises
    ------
    ValueError
        If the row is neither a speed nor a pair of finite numbers.
    """
    entries = list(value) if isinstance(value, (list, tuple)) and len(value) == 2 else [value]
    if any(isinstance(entry, bool) or not isinstance(entry, (int, float)) or not isfinite(entry) for entry in entries):
        raise ValueError(f"row {str(value)[:60]} is no speed in km/h and no [speed, distance]; give finite numbers")
    if not 0 <= entries[0] <= MAX_ROW_SPEED:
        raise ValueError(f"row {str(value)[:60]} has a speed out of range; give 0 to {MAX_ROW_SPEED:g} km/h")
    return float(entries[0]), float(entries[1]) if len(entries) == 2 else None


Row = Annotated[tuple[float, float | None], BeforeValidator(_row)]


class CurveCase(SiModel):
    """One case: inputs, and for each curve its speeds [km/h], or pairs of speed and distance for a comparison."""

    inputs: CurveInputs
    curves: dict[str, tuple[Row, ...]] = Field(min_length=1)

    @model_validator(mode="after")
    def _known_curves(self) -> CurveCase:
        for name in self.curves:
            if name not in CURVE_NAMES:
                raise ValueError(f"curves: '{name}' is none of {', '.join(CURVE_NAMES)}; correct it")
        return self

    def speeds(self, name: str) -> list[float]:
        """Return the speeds of a curve [km/h]."""
        return [speed for speed, _ in self.curves[name]]

    @property
    def has_distances(self) -> bool:
        """True if a curve of the file has a distance."""
        return any(distance is not None for rows in self.curves.values() for _, distance in rows)

    def distances(self, name: str) -> list[float | None]:
        """Return the distances of a curve in the file [m]; None for a speed without one."""
        return [distance for _, distance in self.curves[name]]


class CaseFile(NamedTuple):
    """Cases of a file by name; ``bare`` if it holds one without a name, which has here the name of the file."""

    cases: dict[str, CurveCase]
    bare: bool


def read_cases(path: Path) -> CaseFile:
    """Return the cases of a file.

    Raises
    ------
    ValueError
        One line: file, case, key, value, problem; fix.
    """
    data = _read_json(path)
    if "inputs" in data or "curves" in data:
        return CaseFile({path.stem: build_model(CurveCase, data, str(path))}, True)
    if not data:
        raise ValueError(f"{path}: no case; give 'inputs' and 'curves', or cases by name")
    return CaseFile({name: build_model(CurveCase, case, f"{path}: {name}") for name, case in data.items()}, False)


def _read_json(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MAX_FILE_SIZE:
            raise ValueError(f"larger than {MAX_FILE_SIZE} bytes")
        data = parse_json(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}; name a JSON file of cases") from None
    except ValueError as error:
        raise ValueError(f"{path}: not valid JSON: {' '.join(str(error).split())[:200]}; correct it") from None
    if not isinstance(data, dict):
        raise ValueError(f"{path}: holds {kind_of(data)} in place of cases; give 'inputs' and 'curves'")
    return data
