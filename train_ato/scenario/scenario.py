"""Scenario files: one YAML file defines a run, its variants are overlays.

``load_scenario("daqin_heavy_haul:ideal+disturbed")`` reads the shipped file, applies the overlays of the variants in
this order and the assignments of ``--set``, and validates the result before the run starts.  Bad input raises
:class:`ValueError` with one line: file, key, value, problem; fix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from plant_sim.consist import Consist
from plant_sim.formats.fields import print_assumption
from plant_sim.input_error import build_model, explain
from plant_sim.line import Line
from plant_sim.plant_setup import MAX_LAG, PlantSetup
from plant_sim.si_model import SiModel, Source, Summary, option, unusual_values
from plant_sim.units import Place, Time, Usual, number_text
from train_ato.control.air_brake.policy import BrakeSpec
from train_ato.control.force_distribution import DisplacementAt, SharesAt
from train_ato.control.learned_resistance import LearnedResistance
from train_ato.messages.delay_lines import LinkSpec
from train_ato.messages.faults import Fault
from train_ato.profile.planner.settings import ReplanSpec
from train_ato.scenario.criteria import Criteria, Expectation
from train_ato.scenario.interventions import AtoRequest, Intervention
from train_ato.scenario.leader import LeaderSpec
from train_ato.scenario.overlays import assign, caused_by, overlay
from train_ato.scenario.profile_spec import ProfileSpec
from train_ato.scenario.scenario_files import FOLLOWING, SCHEMA, find, with_base, with_variants
from train_ato.supervision.settings import SupervisionSpec

MAX_TICKS = 10_000_000
"""Maximum number of ticks of a run, 24 h at 0.01 s; the series for the metrics are kept in memory."""


class PlantBlock(PlantSetup):
    """The simulated train: data files and differences from the model."""

    consist: str | Consist = Field(
        description="name of a shipped consist, a file, or the consist itself", examples=["demo"]
    )
    line: str | Line = Field(description="name of a shipped line, a file, or the line itself", examples=["demo"])


class ModelBlock(SiModel):
    """Nominal model of laws, observers and compensations; defaults: plant and links."""

    consist: str | Consist | None = option(
        None,
        "train of the model: a shipped name, a file, or the consist itself; default: as in the plant",
        example="demo",
    )
    line: str | Line | None = option(
        None, "line of the model: a shipped name, a file, or the line itself; default: as in the plant", example="demo"
    )
    delay: Annotated[Time | tuple[Time, ...] | None, Usual(1e-3, 60)] = option(
        None, "delay of commands in the model: one, or one per unit; default: as in the links", example=0.3
    )
    delay_brake: Annotated[Time | tuple[Time, ...] | None, Usual(1e-3, 60)] = option(
        None, "delay of commands below 0 in the model; default: as in the links", example=0.5
    )
    lag: Annotated[Time | None, Usual(1e-3, 60)] = option(
        None, "time constant of the actuators in the model; default: as in the plant", example=0.3, ge=0, le=MAX_LAG
    )
    learned: str | LearnedResistance | None = option(
        None, "resistance by place from former runs, a file of `train-ato learn`; default: none", example="learned.yaml"
    )


class Links(SiModel):
    """Delays of topics."""

    command: LinkSpec = option(LinkSpec(), "delay from the command of the law to the drives", example={"delay": 0.3})
    brake_pipe: LinkSpec = option(LinkSpec(), "delay from the command to the brake pipe", example={"delay": 0.5})
    measurement: LinkSpec = option(LinkSpec(), "delay from the sensors to observer and law", example={"delay": 0.1})
    reference: LinkSpec = option(LinkSpec(), "delay from the profile to the law", example={"delay": 0.1})
    estimate: LinkSpec = option(LinkSpec(), "delay from the observer to the law", example={"delay": 0.1})
    brake_release: LinkSpec = option(LinkSpec(), "delay from the supervisor to the train", example={"delay": 0.1})

    @model_validator(mode="after")
    def _one_delay_each(self) -> Links:
        """Check the delays of all topics but the command, whose number of units is that of the train."""
        for name in type(self).model_fields:
            if name != "command":
                getattr(self, name).per_unit(1, name)
        return self


Parameters = dict[str, dict[str, bool | int | float | str]]  # pydantic 2.7 writes the first kind that fits


class LawChange(SiModel):
    """Change of the control law or of law parameters during the run."""

    at: Time = Field(ge=0, description="time of the change", examples=[60.0])
    law: str | None = option(None, "law from this time on; default: no change", example="mpc")
    laws: Parameters = option({}, "parameters of laws from this time on", example={"pid": {"kp": 0.5}})

    @model_validator(mode="after")
    def _changes_something(self) -> LawChange:
        if self.law is None and not any(self.laws.values()):
            raise ValueError(f"change of the law at {self.at} s has no effect; give law or laws")
        return self


class Evaluation(SiModel):
    """Part of the run used for the tracking metrics."""

    until: Place | None = option(None, "position of vehicle 0's centre at which the evaluation ends", example=1200.0)
    until_time: Time | None = option(None, "time at which the evaluation ends", example=300.0, gt=0)
    couplers: bool = option(False, "extremes and force cycles (rainflow) of every coupler in the summary")


class Scenario(SiModel):
    """Definition of a run."""

    schema_: Literal["train_ato/scenario/1"] = Field(alias="schema", description="kind and version of the file")
    name: str = Field(
        pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.:+-]{0,99}$",
        description="name in lists, logs and reports: letters, digits, _ . : + -",
        examples=["metro"],
    )
    summary: Summary = ""
    source: Source = ""
    duration: Time = Field(gt=0, le=86_400, description="duration of the run", examples=[600.0])
    tick: Time = option(0.1, "period of the loop and of its messages", ge=1e-6, le=10)
    step: Time = option(
        0.005, "step of the plant: 5 ms for all draft gears, 10 ms for linear and clip", ge=1e-6, le=0.05
    )
    control_period: Time | None = option(
        None, "period of the law, a multiple of tick; default: tick", example=0.2, ge=1e-6, le=100
    )
    seed: int = option(1, "seed of all random numbers of the run", ge=0, lt=2**64)
    plant: PlantBlock
    model: ModelBlock = ModelBlock()
    links: Links = Links()
    profile: ProfileSpec
    leader: LeaderSpec | None = option(None, "the train ahead; default: none")
    replan: ReplanSpec | None = option(None, "re-planning after a lack of force; default: none")
    observer: str = option("none", "observer, by its name in `train-ato list`")
    law: str = option("pid", "control law, by its name in `train-ato list`")
    compensation: str = option("none", "compensation of the delay, by its name in `train-ato list`")
    observers: Parameters = option(
        {}, "parameters of observers, by observer and parameter", example={"eso": {"omega": 2.0}}
    )
    laws: Parameters = option({}, "parameters of laws, by law and parameter", example={"pid": {"gains": "model"}})
    compensations: Parameters = option(
        {}, "parameters of compensations, by compensation and parameter", example={"preview": {"lag": True}}
    )
    hold_limit: Annotated[Time, Usual(0.01, 120)] = option(
        1.0, "longest time for which the last command is repeated without a valid new one", gt=0, le=3600
    )
    brake: BrakeSpec = option(BrakeSpec(), "air brake in service", example={"policy": "trigger"})
    force_shares: tuple[SharesAt, ...] | None = option(
        None,
        "shares of the power units by place; default: in proportion to their traction",
        example=[{"at": 0.0, "shares": [0.6, 0.4]}],
        min_length=1,
    )
    unit_displacements: tuple[DisplacementAt, ...] | None = option(
        None, "planned motion of the power units against the profile, which the law does not correct", min_length=1
    )
    law_changes: tuple[LawChange, ...] = option(
        (), "changes of the law or of its parameters during the run", example=[{"at": 60.0, "law": "mpc"}]
    )
    interventions: tuple[Intervention, ...] = option(
        (),
        "interventions on the train during the run",
        example=[{"at": 60.0, "do": "gust", "acceleration": -0.05, "duration": 20.0}],
    )
    faults: tuple[Fault, ...] = option(
        (),
        "faults of messages and nodes during the run",
        example=[{"do": "drop", "topic": "ato/command", "begin": 60.0, "end": 62.0}],
    )
    supervision: SupervisionSpec = SupervisionSpec()
    ato_requests: tuple[AtoRequest, ...] = option((), "requests to the ATO during the run")
    evaluation: Evaluation = Evaluation()
    criteria: Criteria = option(Criteria(), "requirements on the run, for its verdict")

    @model_validator(mode="after")
    def _grids(self) -> Scenario:
        step, tick = round(self.step * 1e9), round(self.tick * 1e9)
        if tick % step:
            raise ValueError(
                f"tick {self.tick} s is not a multiple of step {self.step} s; choose a step that divides it"
            )
        period = round((self.control_period or self.tick) * 1e9)
        if period % tick:
            raise ValueError(
                f"control_period {self.control_period} s is not a multiple of tick {self.tick} s; change one of them"
            )
        if any(planned.at is None for planned in self.interventions):
            raise ValueError("interventions: an entry has no 'at'; add its time")
        if round(self.duration * 1e9) > MAX_TICKS * tick:
            raise ValueError(
                f"duration {self.duration} s has {number_text(self.duration / self.tick, 3)} ticks of "
                f"{self.tick} s, at most {MAX_TICKS}; shorten it or increase tick"
            )
        if round(self.duration * 1e9) < tick:
            raise ValueError(f"duration {self.duration} s is shorter than one tick of {self.tick} s; increase it")
        return self


def raw_scenario(name: str | Mapping[str, Any]) -> tuple[Path, dict[str, Any]]:
    """Return a scenario with its base and variants applied, not validated; files of a mapping are in this folder."""
    path, variant = find(name) if isinstance(name, str) else (Path("scenario"), None)
    whole = with_base(path, given=None if isinstance(name, str) else name)
    _expectation_in(path, whole, variant)
    data = with_variants(path, whole, variant)
    for key in ("variants", "expect"):
        data.pop(key, None)
    if variant is not None:
        data["name"] = f"{data.get('name', path.stem)}:{variant}"
    return path, data


def expectation_of(name: str) -> Expectation | None:
    """Return the expected verdict of ``SCENARIO[:variant]``; None for a name without one, as with two variants.

    Raises
    ------
    ValueError
        For an unknown name or a bad block ``expect``, in one line.
    """
    path, variant = find(name)
    return _expectation_in(path, with_base(path), variant)


def states_verdict(scenario: Scenario) -> bool:
    """Return True for an unchanged shipped scenario with an expected verdict; a run has its start with a place."""
    try:
        expected, (shipped, _) = expectation_of(scenario.name), load_scenario(scenario.name)
    except ValueError:
        return False
    plant = shipped.plant.model_copy(update={"start": scenario.plant.start})
    return expected is not None and shipped.model_copy(update={"plant": plant}) == scenario


def _expectation_in(path: Path, data: Mapping[str, Any], variant: str | None) -> Expectation | None:
    """Return the checked block ``expect`` of a scenario, or of its variant: each states its own."""
    block = data if variant is None else (data.get("variants") or {}).get(variant) or {}
    given = block.get("expect")
    if given is None:
        return None
    where = str(path) if variant is None else f"{path}: variants.{variant}"
    return build_model(Expectation, {"verdict": given} if isinstance(given, str) else given, f"{where}: expect")


def check_scenario(data: dict[str, Any], source: str | Path) -> Scenario:
    """Return a validated scenario.

    Raises
    ------
    ValueError
        One line: file, key, value, problem; fix.
    """
    if data.get("schema") != SCHEMA:
        from plant_sim.formats.reading import kinds_of

        if held := kinds_of(data):
            what, kind = next(iter(held.items()))
            key = "line" if what == "line" else "consist"
            raise ValueError(
                f"{source}: holds a {what} ({kind}), no scenario; name it as plant.{key} in one (train-ato "
                "new scenario NAME)"
            )
        if str(data.get("schema")).startswith(FOLLOWING):
            raise ValueError(f"{source}: holds trains behind each other, no scenario; only `train-ato run` takes it")
        raise ValueError(f"{source}: schema: {data.get('schema')!r}: not supported; write '{SCHEMA}'")
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise explain(error, source, Scenario, data) from None


def load_scenario(
    name: str, assignments: tuple[str, ...] = (), changes: dict[str, Any] | None = None
) -> tuple[Scenario, Path]:
    """Return a scenario with overlays applied, validated, and its file.

    Parameters
    ----------
    name
        ``SCENARIO[:variant[+variant...]]``, shipped name or file.
    assignments
        ``a.b=value`` texts of ``--set``.
    changes
        Last overlay, from the options of the command line.

    Returns
    -------
    scenario, path
        Validated scenario; its file, whose folder is the base of relative file names.
    """
    path, data = raw_scenario(name)
    for text in assignments:
        assign(data, text)
    data = overlay(data, changes or {})
    try:
        scenario = check_scenario(data, path)
    except ValueError as error:
        raise caused_by(error, path, changes_of(assignments, changes or {})) from None
    for text in unusual_values(scenario):
        if not text.startswith("plant.mismatch."):  # meant to be unusual
            print_assumption(f"{name}: {text}; check its unit")
    return scenario, path


def changes_of(assignments: Sequence[str], options: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return key and spelling of the changes on a command line: of ``--set``, and of options named as their keys."""
    found = [(text.partition("=")[0].strip(), f"--set {text}") for text in assignments]
    return found + [(key, f"--{key} {value}") for key, value in options.items()]
