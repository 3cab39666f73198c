"""Following files: several trains behind each other on one line, each with a scenario of its own."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from plant_sim.input_error import build_model
from plant_sim.library import read_yaml, split_name
from plant_sim.si_model import SiModel, Source, Summary, option
from plant_sim.units import Length, Number, Place, Speed, Usual
from train_ato.scenario.overlays import RefusedScenario, assign, caused_by, overlay
from train_ato.scenario.scenario import raw_scenario
from train_ato.scenario.scenario_files import FOLLOWING, shipped_following

ALL = "all"
"""Name of all trains in a change ``all.duration=600``."""
OF_THE_FILE = {
    "schema": "is that of the scenario of the train; remove it",
    "base": "is the key `scenario` of the train; remove it",
    "name": "a run has the names of file and train; remove it",
    "seed": "is that of the file for the first train, the next one for each further train; remove it, or write --seed",
}
"""Keys of a scenario that no change of a train may have, each with the remedy."""


class TrainOfFollowing(SiModel):
    """One train; the one before it in the list is the train ahead."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,59}$")] = Field(
        description="name of the train and of its run folder", examples=["t2"]
    )
    scenario: str = Field(description="SCENARIO[:variant...], as for `train-ato run`", examples=["daqin_heavy_haul"])
    set: dict[str, Any] = option({}, "changed keys of the scenario, in levels", example={"leader": {"headway": 150.0}})


class FollowingCriteria(SiModel):
    """Requirements on every train behind another one; contacts are never permitted."""

    headway_error: Annotated[Length | None, Usual(0.05, 5e3)] = option(
        None,
        "largest position error; a train should be where the train ahead was one headway earlier",
        example=2.0,
        ge=0,
    )
    headway_error_rms: Annotated[Length | None, Usual(0.005, 5e3)] = option(
        None, "root mean square of the position error", example=0.7, ge=0
    )
    headway_speed_error: Speed | None = option(
        None,
        "largest speed error; a train should be as fast as the train ahead was one headway earlier",
        example=0.2,
        ge=0,
    )
    speed_amplification: Number | None = option(
        None,
        "largest deviation of the speed from the own profile, divided by that of the train ahead. With at "
        "most 1 no disturbance grows from train to train",
        example=1.0,
        ge=0,
    )
    gap: Annotated[Place | None, Usual(0.5, 20e3)] = option(
        None, "smallest distance to the train ahead", example=50.0, ge=0
    )
    brake_interventions: int | None = option(0, "largest number of brake interventions of a train", example=0, ge=0)


class FollowingSpec(SiModel):
    """Several trains behind each other."""

    schema_: Literal["train_ato/following/1"] = Field(alias="schema", description="kind and version of the file")
    name: str = Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.+-]{0,79}$", description="name", examples=["following"])
    summary: Summary = ""
    source: Source = ""
    seed: int = option(1, "seed of the first train; each further train has the next one", ge=0, lt=2**32)
    all: dict[str, Any] = option({}, "changed keys of the scenarios of all trains", example={"duration": 600.0})
    trains: tuple[TrainOfFollowing, ...] = Field(
        min_length=2,
        description="trains, the first one in front",
        examples=[[{"name": "t1", "scenario": "daqin_heavy_haul"}, {"name": "t2", "scenario": "daqin_heavy_haul"}]],
    )
    criteria: FollowingCriteria = FollowingCriteria()

    @model_validator(mode="after")
    def _different_names(self) -> "FollowingSpec":
        name, count = Counter(train.name for train in self.trains).most_common(1)[0]
        if count > 1:
            raise ValueError(f"trains: {count} trains have the name {name}; give each its own")
        if ALL in (train.name for train in self.trains):
            raise ValueError(f"trains: '{ALL}' means all trains; give the train another name")
        return self


@dataclass(frozen=True)
class FollowingFile:
    """Checked following file with the changes of a command line.

    Attributes
    ----------
    spec : FollowingSpec
        Content with the changes.
    path : Path
        File.
    assignments : tuple of str
        Changes, as ``TRAIN.a.b=value``.
    """

    spec: FollowingSpec
    path: Path
    assignments: tuple[str, ...] = ()

    def scenario_of(self, number: int) -> dict[str, Any]:
        """Return the scenario of a train as an overlay of its base."""
        train = self.spec.trains[number]
        stem, variants = split_name(train.scenario)
        beside = self.path.parent / stem
        base = f"{beside.absolute()}{variants}" if beside.is_file() else train.scenario
        try:
            raw_scenario(base)
        except ValueError as error:
            raise ValueError(f"scenario = {train.scenario!r}: {error}") from None
        own = {"base": base, "name": f"{self.spec.name}-{train.name}", "seed": self.spec.seed + number}
        return overlay({**own, **self.spec.all}, train.set)

    def refusal(self, number: int, error: ValueError) -> RefusedScenario:
        """Return the refusal of a train with the option that caused it, or with file and train."""
        name = self.spec.trains[number].name
        where = f"{self.path}: {name}"
        lines = (f"{where}: {line.removeprefix('scenario: ')}" for line in str(error).split("\n"))
        parts = [(text, *text.partition("=")[0].strip().partition(".")[::2]) for text in self.assignments]
        changes = [(key, f"--set {text}") for text, train, key in parts if train in (ALL, name)]
        return caused_by(ValueError("\n".join(lines)), Path(where), changes)


def find_following(name: str) -> Path | None:
    """Return the following file of a shipped name or a path; None for any other name."""
    path = Path(name)
    if name in shipped_following() and not path.is_file():
        return shipped_following()[name]
    if path.suffix not in (".yaml", ".yml") or not path.is_file():
        return None
    data = read_yaml(path)
    return path if isinstance(data, dict) and str(data.get("schema")).startswith(FOLLOWING) else None


def _check_changes(changes: Mapping[str, Any], where: str, *, first: bool) -> None:
    """Refuse a change of a key that each train has from the file itself, or a leader that is none."""
    for key in (name for name in changes if name in OF_THE_FILE):
        raise ValueError(f"{where}{key} = {changes[key]!r}: {OF_THE_FILE[key]}")
    leader = changes.get("leader")
    if leader is not None and first:
        raise ValueError(f"{where}leader: the first train has no train ahead; remove it")
    if leader is not None and not isinstance(leader, dict):
        raise ValueError(f"{where}leader = {leader!r}: is no block of keys; write leader: {{headway: 150}}")
    if leader and "reports" in leader:
        raise ValueError(f"{where}leader.reports: they are those of the train ahead; remove them")


def load_following(path: Path, assignments: tuple[str, ...] = (), seed: int | None = None) -> FollowingFile:
    """Return a checked following file with changes.

    Parameters
    ----------
    path
        Following file.
    assignments
        ``TRAIN.a.b=value`` or ``all.a.b=value``, as for ``--set``.
    seed
        Seed in place of that of the file.
    """
    data = read_yaml(path)
    try:
        spec = build_model(FollowingSpec, data if seed is None else {**data, "seed": seed}, str(path))
    except ValueError as error:
        raise caused_by(error, path, [] if seed is None else [("seed", f"--seed {seed}")]) from None
    _check_changes(spec.all, f"{path}: {ALL}.", first=True)
    names = [train.name for train in spec.trains]
    for train in spec.trains:
        _check_changes(train.set, f"{path}: {train.name}: set.", first=train is spec.trains[0])
    changes: dict[str, Any] = {}
    for text in assignments:
        name, dot, rest = text.partition("=")[0].partition(".")
        if not dot or not rest or name not in (ALL, *names):
            raise ValueError(f"--set {text}: begin the key with a train: {', '.join(f'{x}.' for x in (ALL, *names))}")
        change: dict[str, Any] = {}
        assign(change, text)
        _check_changes(change[name], f"--set {text}: ", first=name in (ALL, names[0]))
        changes = overlay(changes, change)
    trains = tuple(
        train.model_copy(update={"set": overlay(overlay(train.set, changes.get(ALL, {})), changes.get(train.name, {}))})
        for train in spec.trains
    )
    return FollowingFile(spec.model_copy(update={"trains": trains}), path, assignments)
