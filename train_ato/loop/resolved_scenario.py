"""Resolved scenario: a scenario with the content of all its files, as plain data, YAML and hashes."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import yaml

from plant_sim.consist import Consist
from plant_sim.data_text import TextDumper
from plant_sim.line import Line
from train_ato.control.train_model import TrainModel
from train_ato.loop.part_cache import PartCache
from train_ato.loop.scenario_data import profile_key
from train_ato.scenario.scenario import Scenario

__all__ = ["key_hashes", "resolved_data", "resolved_text"]

_texts = PartCache(256)
"""Profiles and YAML of parts of resolved scenarios; the runs of a study have most of it in common."""


def resolved_data(scenario: Scenario, folder: Path, consist: Consist, line: Line, model: TrainModel) -> dict[str, Any]:
    """Return the plain data of a scenario in a folder, with its train, line and nominal model in place of files."""
    data = scenario.model_dump(mode="json", by_alias=True, exclude_none=True, exclude_defaults=False)
    data["plant"]["consist"] = consist.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    data["plant"]["line"] = line.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    for key in ("consist", "line"):
        if getattr(scenario.model, key) is not None:
            part = getattr(model, key)
            data["model"][key] = part.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    if model.learned is not None:
        data["model"]["learned"] = model.learned.model_dump(mode="json", by_alias=True)
    if scenario.replan is not None:
        data["replan"] = scenario.replan.model_dump(mode="json", by_alias=True, exclude_unset=True)
    profile = scenario.profile
    data["profile"] = _texts.get(profile_key(profile, folder), lambda: dict(sorted(profile.inlined(folder).items())))
    return data


def resolved_text(data: dict[str, Any]) -> str:
    """Return the data of a resolved scenario as YAML."""
    return "".join(_block_yaml(key, value) for key, value in data.items())


def key_hashes(data: dict[str, Any]) -> dict[str, str]:
    """Return a hash of every top-level key of a resolved scenario."""
    texts = {key: json.dumps(value, sort_keys=True) for key, value in data.items()}
    return {key: hashlib.sha256(text.encode()).hexdigest()[:8] for key, text in texts.items()}


def _block_yaml(key: str, value: Any) -> str:
    """Return a top-level key of a resolved scenario with its value as YAML."""
    if not isinstance(value, dict) or not value:
        return _yaml_of({key: value})
    parts = [_yaml_of({key: {name: entry}}) for name, entry in value.items()]
    return f"{key}:\n" + "".join(part.partition("\n")[2] for part in parts)


def _yaml_of(value: dict[str, Any]) -> str:
    """Return plain data as YAML, without anchors for shared parts."""
    return _texts.get(value, lambda: _dumped(json.loads(json.dumps(value))))


def _dumped(value: dict[str, Any]) -> str:
    text: str = yaml.dump(value, Dumper=TextDumper, sort_keys=False, allow_unicode=True, width=120)
    return text
