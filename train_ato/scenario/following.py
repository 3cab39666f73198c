"""Following files: several trains behind each other on one line, each with a scenario of its own."""

from __future__ import annotations

from collections import Counter
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from plant_sim.input_error import build_model
from plant_sim.library import read_yaml, split_name
from plant_sim.si_model import SiModel, Source, Summary
from plant_sim.units import Length, Place, Speed
from train_ato.scenario.overlays import assign, overlay

SCHEMA = "train_ato/following/1"
ALL = "all"
"""Name of all trains in a change ``all.duration=600``."""


class TrainOfFollowing(SiModel):
    """One train; the one before it in the list is the train ahead."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,39}$")] = Field(
        description="name of the train and of its run folder", examples=["t2"]
    )
    scenario: str = Field(description="SCENARIO[:variant...], as for `train-ato run`", examples=["daqin_heavy_haul"])
    set: dict[str, Any] = Field(
        default_factory=dict,
        description="changed keys of the scenario, in levels",
        examples=[{"leader": {"headway": 150.0}}],
    )


class FollowingCriteria(SiModel):
    """Requirements on every train behind another one; contacts are never permitted."""

    headway_error: Length | None = Field(
        None, ge=0, description="largest distance from the place of the train ahead one headway before", examples=[2.0]
    )
    headway_error_rms: Length | None = Field(
        None, ge=0, description="root mean square of the same distance", examples=[0.7]
    )
    headway_speed_error: Speed | None = Field(
        None,
        ge=0,
        description="largest difference from the speed of the train ahead one headway before",
        examples=[0.2],
    )
    gap: Place | None = Field(None, ge=0, description="smallest distance to the train ahead", examples=[50.0])
    brake_interventions: int | None = Field(
        0, ge=0, description="largest number of brake interventions of a train", examples=[0]
    )


class FollowingSpec(SiModel):
    """Several trains behind each other."""

    schema_: Literal["train_ato/following/1"] = Field(alias="schema", description="kind and version of the file")
    name: str = Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.+-]{0,79}$", description="name", examples=["following"])
    summary: Summary = ""
    source: Source = ""
    seed: int = Field(1, ge=0, lt=2**32, description="seed of the first train; each further train has the next one")
    all: dict[str, Any] = Field(
        default_factory=dict, description="changed keys of the scenarios of all trains", examples=[{"duration": 600.0}]
    )
    trains: tuple[TrainOfFollowing, ...] = Field(
        min_length=2,
        description="trains, the first one in front",
        examples=[[{"name": "t1", "scenario": "daqin_heavy_haul"}, {"name": "t2", "scenario": "daqin_heavy_haul"}]],
    )
    criteria: FollowingCriteria = FollowingCriteria()

    @model_validator(mode="after")
    def _different_names(self) -> FollowingSpec:
        name, count = Counter(train.name for train in self.trains).most_common(1)[0]
        if count > 1:
            raise ValueError(f"trains: {count} trains have the name {name}; give each its own")
        if ALL in (train.name for train in self.trains):
            raise ValueError(f"trains: '{ALL}' means all trains; give the train another name")
        return self

    def scenario_of(self, number: int, folder: Path) -> dict[str, Any]:
        """Return the scenario of a train as an overlay of its base; ``folder`` is that of the file."""
        train = self.trains[number]
        stem, variants = split_name(train.scenario)
        base = f"{(folder / stem).absolute()}{variants}" if (folder / stem).is_file() else train.scenario
        own = {"base": base, "name": f"{self.name}-{train.name}", "seed": self.seed + number}
        return overlay({**own, **self.all}, train.set)


def shipped_following() -> dict[str, Path]:
    """Return the shipped following files by name."""
    folder = Path(str(files("train_ato"))) / "scenario" / "shipped" / "following"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find_following(name: str) -> Path | None:
    """Return the following file of a shipped name or a path; None for any other name."""
    path = Path(name)
    if name in shipped_following() and not path.is_file():
        return shipped_following()[name]
    if path.suffix not in (".yaml", ".yml") or not path.is_file():
        return None
    data = read_yaml(path)
    return path if isinstance(data, dict) and data.get("schema") == SCHEMA else None


def load_following(path: Path, assignments: tuple[str, ...] = (), seed: int | None = None) -> FollowingSpec:
    """Return a checked following file with changes.

    Parameters
    ----------
    path
        Following file.
    assignments
        ``TRAIN.a.b=value`` or ``all.a.b=value``, as for ``--set``.
    seed
        Seed in place of that of the file.

    Raises
    ------
    ValueError
        One line: file, key, value, problem; fix.
    """
    data = read_yaml(path)
    spec = build_model(FollowingSpec, data if seed is None else {**data, "seed": seed}, str(path))
    names = [ALL, *(train.name for train in spec.trains)]
    changes: dict[str, Any] = {}
    for text in assignments:
        name, dot, rest = text.partition("=")[0].partition(".")
        if not dot or not rest or name not in names:
            raise ValueError(f"--set {text}: begin the key with a train: {', '.join(f'{each}.' for each in names)}")
        assign(changes, text)
    trains = [train.model_copy(update={"set": overlay(train.set, changes.get(ALL, {}))}) for train in spec.trains]
    trains = [train.model_copy(update={"set": overlay(train.set, changes.get(train.name, {}))}) for train in trains]
    return spec.model_copy(update={"trains": tuple(trains)})
