"""File of ``train-ato tune --over``: ranges and start values of the gains, variations of the scenarios."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from plant_sim.library import read_yaml
from train_ato.apps.sweep.dimensions import Dimension, read_dimensions
from train_ato.apps.tune.gain_runs import FIXED_KEYS

KEYS = ("over", "start", "variations")


@dataclass(frozen=True)
class TuneSpec:
    """Content of the file.

    Attributes
    ----------
    path
        The file, for messages; "" without one.
    over
        Ranges or values of the parameters.
    start
        Values at which the search begins; the others begin at that of the scenario.
    variations
        Changes of the scenarios, each for one more run of every scenario and seed.
    """

    path: str = ""
    over: tuple[Dimension, ...] = ()
    start: Mapping[str, Any] = field(default_factory=dict)
    variations: tuple[dict[str, Any], ...] = ()


NO_SPEC = TuneSpec()
"""Content of no file."""


def read_tune_spec(source: str | Path | Mapping[str, Any]) -> TuneSpec:
    """Read ranges, start values and variations of a file, or of a mapping with the same keys.

    Raises
    ------
    ValueError
        One line: file, key, problem, remedy.
    """
    if isinstance(source, Mapping):
        data, path = source, "over"
    else:
        if not Path(source).is_file():
            raise ValueError(f"--over {source}: no such file; name a YAML file with a block over:")
        data, path = read_yaml(Path(source)), str(source)
    if not isinstance(data, Mapping) or not data:
        raise ValueError(f"{path}: no mapping of keys; add a block over:")
    if unknown := [str(key) for key in data if key not in KEYS]:
        raise ValueError(f"{path}: unknown key '{unknown[0]}'; use {', '.join(KEYS)}")
    over = read_dimensions(data["over"], f"{path}: over") if "over" in data else ()
    start = data.get("start", {})
    if not isinstance(start, Mapping):
        raise ValueError(f"{path}: start: {start!r} is no mapping; write start: {{kp: 0.1}}")
    return TuneSpec(path, over, dict(start), _variations(data.get("variations", []), f"{path}: variations"))


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
