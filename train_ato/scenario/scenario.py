"""Scenario files: one YAML says all of a run; overlays make the variants.

``load("daqin_heavy_haul:ideal+disturbed")`` reads the shipped file, lays the variants over it one after the other,
applies ``--set`` and checks everything before anything starts.  Bad input raises :class:`ValueError` with one line
that names the file, the key, the value and the remedy.
"""

from __future__ import annotations

import copy
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field, ValidationError, model_validator

from plant_sim.consist import Consist
from plant_sim.input_error import close_match, explain
from plant_sim.library import StrictLoader, read_yaml
from plant_sim.line import Line
from plant_sim.plant_setup import PlantSetup
from plant_sim.units import Length, SiModel, Time
from train_ato.brake.policy import BrakeSpec
from train_ato.interventions import Intervention
from train_ato.links import LinkSpec
from train_ato.plan.settings import ReplanSpec
from train_ato.profile.spec import ProfileSpec

SCHEMA = "train_ato/scenario/1"
LARGEST_FILE = 64 * 2**20
"""Scenario files beyond this many bytes are refused."""


class PlantBlock(PlantSetup):
    """The train that is driven: data files and everything that makes it differ from the model."""

    consist: str | Consist = Field(description="name of a shipped consist, a file, or the consist itself")
    line: str | Line = Field(description="name of a shipped line, a file, or the line itself")


class ModelBlock(SiModel):
    """What laws, observers and compensations believe. What is not given is taken from the plant and its links."""

    consist: str | Consist | None = None
    line: str | Line | None = None
    delay: Time | tuple[Time, ...] | None = None
    delay_brake: Time | tuple[Time, ...] | None = None
    lag: Time | None = Field(None, ge=0)


class Links(SiModel):
    """Delays on topics; only the command is delayed unless the scenario says otherwise."""

    command: LinkSpec = LinkSpec()
    brake_pipe: LinkSpec = LinkSpec()
    measurement: LinkSpec = LinkSpec()
    reference: LinkSpec = LinkSpec()
    estimate: LinkSpec = LinkSpec()


Parameters = dict[str, dict[str, float | int | bool | str]]


class Swap(SiModel):
    """Change of the law, or of parameters of laws, while the train runs."""

    at: Time = Field(ge=0)
    controller: str | None = Field(None, description="law in charge from then on; default: the one that is")
    controllers: Parameters = Field(default_factory=dict, description="parameters of laws from then on")

    @model_validator(mode="after")
    def _changes_something(self) -> Swap:
        if self.controller is None and not any(self.controllers.values()):
            raise ValueError(f"swap at {self.at} s changes nothing; give controller or controllers")
        return self


class Score(SiModel):
    """Part of the run over which the tracking figures are taken."""

    until: Length | None = Field(None, description="position of vehicle 0's centre at which it ends")
    until_time: Time | None = Field(None, gt=0)


class Scenario(SiModel):
    """A whole run."""

    schema_: Literal["train_ato/scenario/1"] = Field(alias="schema")
    name: str = Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.:+-]{0,99}$", description="letters, digits, _ . : + -")
    summary: str = ""
    source: str = ""
    duration: Time = Field(gt=0, le=86_400)
    tick: Time = Field(0.1, ge=1e-6, le=10)
    step: Time = Field(0.005, ge=1e-6, le=0.05, description="of the plant; 5 ms is converged, see plant_sim/kernel.py")
    control_period: Time | None = Field(None, ge=1e-6, le=100, description="of the law, in ticks; default: one")
    seed: int = Field(1, ge=0, lt=2**64)
    plant: PlantBlock
    model: ModelBlock = ModelBlock()
    links: Links = Links()
    profile: ProfileSpec
    replan: ReplanSpec | None = Field(None, description="plan the rest again when force falls short; default: never")
    observer: str = "none"
    controller: str = "pid"
    compensation: str = "none"
    observers: Parameters = Field(default_factory=dict)
    controllers: Parameters = Field(default_factory=dict)
    compensations: Parameters = Field(default_factory=dict)
    hold_limit: Time = Field(
        1.0, gt=0, le=3600, description="longest time for which the last command is repeated for want of a usable one"
    )
    brake: BrakeSpec = BrakeSpec()
    swaps: tuple[Swap, ...] = ()
    interventions: tuple[Intervention, ...] = Field((), description="what is done to the train while it runs")
    score: Score = Score()

    @model_validator(mode="after")
    def _grids(self) -> Scenario:
        step, tick = round(self.step * 1e9), round(self.tick * 1e9)
        if tick % step:
            raise ValueError(
                f"tick {self.tick} s is not a multiple of step {self.step} s; choose a step that divides it"
            )
        period = round((self.control_period or self.tick) * 1e9)
        if period % tick:
            raise ValueError(f"control_period {self.control_period} s is not a multiple of tick {self.tick} s")
        if any(planned.at is None for planned in self.interventions):
            raise ValueError("interventions: one has no 'at'; say when it is done")
        if round(self.duration * 1e9) < tick:
            raise ValueError(f"duration {self.duration} s is shorter than one tick of {self.tick} s")
        return self


def shipped_scenarios() -> dict[str, Path]:
    """Return the shipped scenario files by name."""
    folder = Path(str(files("train_ato"))) / "scenarios"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def _read(path: Path) -> dict[str, Any]:
    if path.is_file() and path.stat().st_size > LARGEST_FILE:
        raise ValueError(f"{path}: larger than {LARGEST_FILE} bytes; not a scenario")
    data = read_yaml(path)
    if not isinstance(data, dict):
        raise ValueError(f"{path}: a scenario is a mapping of keys, this is {type(data).__name__}")
    return data


def overlay(base: dict[str, Any], change: dict[str, Any]) -> dict[str, Any]:
    """Lay a change over a mapping: mappings merge, ``null`` removes a key, everything else replaces."""
    result = dict(base)
    for key, value in change.items():
        if value is None:
            result.pop(key, None)
        elif isinstance(value, dict) and isinstance(result.get(key), dict):
            result[key] = overlay(result[key], value)
        else:
            result[key] = copy.deepcopy(value)
    return result


def find(name: str) -> tuple[Path, str | None]:
    """Split ``SCENARIO[:variant[+variant...]]`` into a file and its variants.

    Raises
    ------
    ValueError
        If there is neither a shipped scenario nor a file of that name.
    """
    stem, colon, variant = name.partition(":")
    path = Path(stem)
    if not (path.suffix in (".yaml", ".yml") or path.is_file()):
        shipped = shipped_scenarios()
        if stem not in shipped:
            raise ValueError(f"unknown scenario '{stem}'{close_match(stem, shipped)}; `train-ato list` names all")
        path = shipped[stem]
    elif not path.is_file():
        raise ValueError(f"{path}: no such file; name a scenario file or one that `train-ato list` shows")
    return path, variant if colon else None


def _with_base(path: Path, above: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Read a scenario file laid over its base, variants still inside."""
    data = _read(path)
    base = data.pop("base", None)
    if base is None:
        return data
    beside = path.parent / str(base)
    below, _ = find(str(beside) if beside.is_file() else str(base))
    if below in (path, *above):
        raise ValueError(f"{path}: base: {base}: a scenario cannot be laid over itself")
    return overlay(_with_base(below, (path, *above)), data)


def raw(name: str) -> tuple[Path, dict[str, Any]]:
    """Read a scenario with its base and variants laid over each other, unchecked."""
    path, variant = find(name)
    data = _with_base(path)
    variants = data.pop("variants", {}) or {}
    for part in variant.split("+") if variant is not None else ():
        if part not in variants:
            known = ", ".join(sorted(variants)) or "none"
            raise ValueError(f"{path}: no variant '{part}'{close_match(part, variants)}; it has: {known}")
        data = overlay(data, {key: value for key, value in variants[part].items() if key != "summary"})
    if variant is not None:
        data["name"] = f"{data.get('name', path.stem)}:{variant}"
    return path, data


def variants_of(path: Path) -> dict[str, str]:
    """Return the variants that a scenario file offers, with their one-line summaries."""
    variants = _with_base(path).get("variants") or {}
    return {name: str(change.get("summary", "")) for name, change in variants.items()}


def assign(data: dict[str, Any], text: str) -> None:
    """Apply one ``--set a.b=value`` to a raw scenario, the value written as YAML.

    Raises
    ------
    ValueError
        If the text is no assignment or the key runs through something that is no mapping.
    """
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise ValueError(f"--set {text}: write it as key.key=value, for example --set plant.lag=0.4")
    *path, last = key.split(".")
    target = data
    for part in path:
        target = target.setdefault(part, {})
        if not isinstance(target, dict):
            raise ValueError(f"--set {text}: '{part}' is a value, not a block of keys")
    try:
        target[last] = yaml.load(value, Loader=StrictLoader)
    except yaml.YAMLError:
        raise ValueError(f"--set {text}: '{value}' is not valid YAML") from None


def check(data: dict[str, Any], source: str | Path) -> Scenario:
    """Turn a raw scenario into a checked one.

    Raises
    ------
    ValueError
        One line: file, key, value, remedy.
    """
    if data.get("schema") != SCHEMA:
        raise ValueError(f"{source}: schema: {data.get('schema')!r}: this version reads '{SCHEMA}'; write that line")
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise ValueError(explain(error, source, Scenario)) from None


def load(name: str, assignments: tuple[str, ...] = (), changes: dict[str, Any] | None = None) -> tuple[Scenario, Path]:
    """Read, overlay and check a scenario.

    Parameters
    ----------
    name
        ``SCENARIO[:variant[+variant...]]``, a shipped name or a file.
    assignments
        ``a.b=value`` texts of ``--set``.
    changes
        A last overlay, from the command line's options.

    Returns
    -------
    scenario, path
        The checked scenario and the file it came from (its folder is where relative file names start).
    """
    path, data = raw(name)
    for text in assignments:
        assign(data, text)
    data = overlay(data, changes or {})
    return check(data, path), path
