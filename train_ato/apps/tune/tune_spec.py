"""File of ``train-ato tune --over``: ranges of the gains and variations of the scenarios."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from plant_sim.library import read_yaml
from train_ato.apps.sweep.dimensions import Dimension, read_dimensions
from train_ato.apps.tune.gain_runs import FIXED_KEYS

KEYS = ("over", "variations")


@dataclass(frozen=True)
class TuneSpec:
    """Content of the file.

    Attributes
    ----------
    path
        The file, for messages; "" without one.
    over
        Ranges or values of the gains.
    variations
        Changes of the scenarios, each for one more run of every scenario and seed.
    """

    path: str = ""
    over: tuple[Dimension, ...] = ()
    variations: tuple[dict[str, Any], ...] = ()


def read_tune_spec(path: Path) -> TuneSpec:
    """Read ranges and variations.

    Raises
    ------
    ValueError
        One line: file, key, problem, remedy.
    """
    if not path.is_file():
        raise ValueError(f"--over {path}: no such file; name a YAML file with a block over:")
    data = read_yaml(path)
    if not isinstance(data, Mapping) or not data:
        raise ValueError(f"{path}: no mapping of keys; add a block over:")
    if unknown := [str(key) for key in data if key not in KEYS]:
        raise ValueError(f"{path}: unknown key '{unknown[0]}'; use {' and '.join(KEYS)}")
    over = read_dimensions(data["over"], f"{path}: over") if "over" in data else ()
    return TuneSpec(str(path), over, _variations(data.get("variations", []), f"{path}: variations"))


def _variations(data: Any, where: str) -> tuple[dict[str, Any], ...]:
    if not isinstance(data, list):
        raise ValueError(f"{where}: not a list; write - {{plant.mismatch.mass_scale: 0.8}}")
    found = []
    for number, entry in enumerate(data, 1):
        if not isinstance(entry, Mapping) or not entry:
            raise ValueError(f"{where}: entry {number}: not a mapping; write - {{plant.mismatch.mass_scale: 0.8}}")
        for key in entry:
            if str(key).partition(".")[0] in FIXED_KEYS:
                raise ValueError(f"{where}: entry {number}: {key}: law and seed have their own options; remove it")
        found.append({str(key): value for key, value in entry.items()})
    return tuple(found)
