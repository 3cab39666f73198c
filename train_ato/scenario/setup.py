"""Prepared run: data, model and profile of a scenario, validated before the run starts."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from plant_sim.consist import Consist
from plant_sim.data_text import TextDumper
from plant_sim.line import Line, line_for
from plant_sim.plant_setup import Jump
from plant_sim.train import Train
from plant_sim.units import number_text
from train_ato.control.air_brake.policy import make_brake_policy
from train_ato.control.air_brake.record_policy import BrakePolicy
from train_ato.control.algorithms.loop_gains import is_unstable
from train_ato.control.component_fault import refused_at_start
from train_ato.control.contract import Law
from train_ato.control.force_distribution import ForceDistribution, PlannedDisplacement
from train_ato.control.gains import Gains, advice
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS, GivenComponent, Registry, started
from train_ato.control.train_model import STANDSTILL_SPEED, TrainModel
from train_ato.messages.topic import TrainLayout
from train_ato.messages.topics import BY_NAME
from train_ato.messages.types import Array, TrainAhead
from train_ato.profile.profile import Profile
from train_ato.scenario import scenario_data
from train_ato.scenario.changes import effective_stamp
from train_ato.scenario.formula import parse_formula, signals_of
from train_ato.scenario.interventions import Intervention, TrainJumpNow
from train_ato.scenario.scenario import Scenario
from train_ato.scenario.signals import unavailable_signal
from train_ato.scenario.supervised_plan import SpeedCeiling, profile_within
from train_ato.supervision.supervisor import Supervisor
from train_ato.supervision.train_report import TrainReport, parse_reports

if TYPE_CHECKING:
    from train_ato.profile.planner.replanner import Replanner

_texts = scenario_data.PartCache(256)
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
    data["profile"] = _texts.get(
        scenario_data.profile_key(profile, folder), lambda: dict(sorted(profile.inlined(folder).items()))
    )
    return data


def _block_yaml(key: str, value: Any) -> str:
    """Return a top-level key of a resolved scenario with its value as YAML."""
    if not isinstance(value, dict) or not value:
        return _yaml_of({key: value})
    parts = [_yaml_of({key: {name: entry}}) for name, entry in value.items()]
    return f"{key}:\n" + "".join(part.partition("\n")[2] for part in parts)


def _yaml_of(value: dict[str, Any]) -> str:
    """Return plain data as YAML, without anchors for shared parts."""

    def dumped() -> str:
        plain = json.loads(json.dumps(value))
        return str(yaml.dump(plain, Dumper=TextDumper, sort_keys=False, allow_unicode=True, width=120))

    return _texts.get(value, dumped)


def check_replan(scenario: Scenario, layout: TrainLayout) -> None:
    """Check that the scenario permits re-planning."""
    if scenario.replan is None:
        return
    if scenario.brake.policy != "none":
        events = " and remove brake.events" if scenario.brake.events else ""
        raise ValueError(
            f"replan: not possible with brake.policy {scenario.brake.policy}, because plans do not include its "
            f"air brake; remove replan, or set brake.policy: none{events}"
        )
    if not layout.n_units:
        raise ValueError("replan: the train has no power unit; remove replan")
    plan = scenario.profile.plan
    if scenario.replan.catch_up and (plan is None or not plan.has_timetable):
        raise ValueError(
            "replan: catch_up: true: the profile has no timetable; add profile.plan.time, .allowance or .points"
        )


def check_forwards(scenario: Scenario, profile: Profile) -> None:
    """Check that a profile that may be planned again has no part that runs backwards, which a plan would leave out."""
    back = np.flatnonzero(profile.velocity < -STANDSTILL_SPEED)
    if scenario.replan is not None and back.size:
        begin = number_text(float(profile.time[back[0]]))
        raise ValueError(f"replan: the profile runs backwards at {begin} s, and a plan runs forwards; remove replan")


def check_leader(setup: RunSetup) -> None:
    """Check the reports of the train ahead, and that the run can use them."""
    spec = setup.scenario.leader
    if spec is None:
        return
    if spec.train and (spec.reports or not setup.layout.supervised):
        remedy = "remove leader.reports" if spec.reports else "set supervision.enabled: true"
        raise ValueError(f"leader.train: {spec.train}: live reports come with the odometry of the supervisor; {remedy}")
    try:
        reports = setup.leader_reports
    except ValueError as error:
        raise ValueError(f"leader.reports: {error}") from None
    if reports and reports[0].problem:
        raise ValueError(f"leader.reports: line 2: {reports[0].problem}; correct the first report")
    if spec.authority is not None and not setup.layout.supervised:
        raise ValueError(
            f"leader.authority: {spec.authority}: the run has no supervisor; set supervision.enabled: true or "
            "leader.authority: null"
        )
    if setup.scenario.replan is not None and spec.headway is not None:
        raise ValueError("replan: the profile follows the train ahead; remove replan or leader.headway")


def check_requirements(scenario: Scenario, layout: TrainLayout, line: Line) -> None:
    """Check that the run has the signals of its requirements."""
    for name, text in (scenario.criteria.requirements or {}).items():
        if reason := unavailable_signal(signals_of(parse_formula(text)), layout, line):
            raise ValueError(f"criteria.requirements.{name}: {reason}")


def check_evaluation(scenario: Scenario, profile: Profile) -> None:
    """Check that the evaluation does not end before the first motion: an error of no tick would be 0."""
    evaluation, start, train = scenario.evaluation, float(profile.position[0]), scenario.plant.start
    if evaluation.until is not None and evaluation.until <= start:
        raise ValueError(
            f"evaluation.until: {number_text(evaluation.until)} m: the profile begins at {number_text(start)} m; give "
            "a place beyond it, or remove the key"
        )
    moves = np.flatnonzero(profile.velocity)
    at_rest = moves.size and moves[0] and not any(train.speeds or (train.speed,))
    rest = float(profile.time[moves[0] - 1]) if at_rest else 0.0
    if evaluation.until_time is not None and evaluation.until_time <= rest:
        raise ValueError(
            f"evaluation.until_time: {number_text(evaluation.until_time)} s: the profile begins to move at "
            f"{number_text(rest)} s; give a later time, or remove the key"
        )


def without_effect(scenario: Scenario) -> str:
    """Return a line on the first part of a scenario that has no effect on its run; "" without one.

    Start and limits of phases beside a plan, also from the base of the scenario, come first. Then come planned entries
    that the run does not reach by its time.
    """
    profile = scenario.profile
    limits = () if profile.append else sorted(profile.limits.model_fields_set & {"acceleration", "deceleration"})
    unused = {"start": "begin, a place of the front"} if profile.start is not None else {}
    unused |= {f"limits.{key}": key for key in limits}
    if profile.plan and unused:
        key, other = next(iter(unused.items()))
        return f"profile.{key}: it has no effect on a plan; write profile.plan.{other}"
    lists: dict[tuple[str, str], Iterable[Any]] = {
        ("profile.driver", "action"): scenario.profile.driver or (),
        ("law_changes", "change"): scenario.law_changes,
        ("interventions", "intervention"): scenario.interventions,
        ("ato_requests", "request"): scenario.ato_requests,
        ("faults", "fault"): scenario.faults,
        ("brake.events", "event"): scenario.brake.events,
        ("plant.jumps", "jump"): scenario.plant.jumps,
        ("plant.disturbances", "disturbance"): scenario.plant.disturbances,
        ("plant.sensors.freeze", "freeze"): scenario.plant.sensors.freeze,
        ("plant.sensors.wheel_slip", "slip"): scenario.plant.sensors.wheel_slip,
    }
    entries = [
        (f"{key}.{n}", what, vars(entry)) for (key, what), listed in lists.items() for n, entry in enumerate(listed)
    ]
    entries += [(f"links.{name}.jump", "jump", vars(link.jump)) for name, link in scenario.links if link.jump]
    for key, what, values in entries:
        time = next((values[name] for name in ("at", "time", "begin") if values.get(name) is not None), 0.0)
        time += (values.get("shift") or 0.0) if "begin" in values else 0.0
        if time >= scenario.duration:
            return (
                f"{key}: the run ends at {number_text(scenario.duration)} s, before the {what} at "
                f"{number_text(time)} s; lengthen duration or remove the {what}"
            )
    return ""


def check_parameters(scenario: Scenario) -> None:
    """Check names and values of the parameters of all laws, observers and compensations at the start."""
    blocks = {"laws": LAWS, "observers": OBSERVERS, "compensations": COMPENSATIONS}
    for block, registry in blocks.items():
        for name, values in getattr(scenario, block).items():
            try:
                registry.check_parameters(name, values)
            except ValueError as error:
                message = str(error)
                raise ValueError(f"{block}.{message}" if message.startswith(f"{name}.") else message) from None


@dataclass(frozen=True)
class RunSetup:
    """A validated run: choices of the scenario by their names in a run, data, time grids and nominal model.

    Attributes
    ----------
    scenario : Scenario
        Checked scenario with current names of parameters.
    consist, line : Consist, Line
        Train and line of the plant.
    model : TrainModel
        Nominal model of laws, observers and compensations.
    step_ns, tick_ns : int
        Plant step and tick [ns].
    ticks : int
        Number of ticks of the run.
    profile : Profile
        Speed profile with knots at the tick.
    given : Mapping
        Objects given to :func:`train_ato.run` by kind of component; they run as long as their keywords hold.
    ahead : tuple of TrainAhead
        Recorded reports of the train ahead, in a repeated run with ``leader.train``.
    """

    scenario: Scenario
    folder: Path
    consist: Consist
    line: Line
    model: TrainModel
    profile: Profile
    layout: TrainLayout
    step_ns: int
    tick_ns: int
    ticks: int

    given: Mapping[str, GivenComponent] = field(default_factory=dict)
    ahead: tuple[TrainAhead, ...] = ()

    @property
    def observer_parameters(self) -> dict[str, Any]:
        """Parameters of the observer that differ from its defaults."""
        return self.scenario.observers.get(self.scenario.observer, {})

    @property
    def laws(self) -> tuple[str, ...]:
        """Names of the laws this run can change to: the registered ones, and each ``module:Class`` of the scenario."""
        named = [self.scenario.law, *self.scenario.laws]
        for change in self.scenario.law_changes:
            named += [change.law or self.scenario.law, *change.laws]
        return tuple(dict.fromkeys((*LAWS.loadable(), *named)))

    @property
    def compensation_parameters(self) -> dict[str, Any]:
        """Parameters of the compensation that differ from its defaults."""
        return self.scenario.compensations.get(self.scenario.compensation, {})

    def component(self, registry: Registry, name: str, values: Mapping[str, Any], period: float) -> Any:
        """Return a component at the start of the run: an object given to :func:`train_ato.run`, or a new one."""
        given = self.given.get(registry.kind)
        if given is not None and given.name == name and given.values == values:
            with refused_at_start(registry.kind, name, given.component):
                return started(given.component, self.model, period, given.values)
        return registry.make(name, values, self.model, period)

    @property
    def tick(self) -> float:
        """Period of the loop [s]."""
        return self.tick_ns * 1e-9

    @cached_property
    def leader_reports(self) -> tuple[TrainReport, ...]:
        """Reports of the train ahead; none for those that come live."""
        spec = self.scenario.leader
        return () if spec is None or spec.train else parse_reports(spec.reports)

    @cached_property
    def supervision_ticks(self) -> int:
        """Number of ticks of a supervision period."""
        return max(1, -(-round(self.scenario.supervision.period * 1e9) // self.tick_ns))

    @cached_property
    def _supervision_ns(self) -> int:
        """Period of the supervisor [ns]; 0 without one."""
        return self.supervision_ticks * self.tick_ns if self.layout.supervised else 0

    def supervised_at(self, stamp: int) -> bool:
        """Return True if the supervisor takes a step at a stamp [ns]."""
        return self._supervision_ns != 0 and stamp % self._supervision_ns == 0

    @cached_property
    def assurance_reaction(self) -> float:
        """Time from the decision of the run-time assurance to the effect of its brake [s]."""
        delay = float(self.model.delay_brake.max()) if self.model.n_units else 0.0
        return delay + self.model.lag + self.supervision_ticks * self.tick

    @property
    def control_period(self) -> float:
        """Period of the law [s]."""
        return self.scenario.control_period or self.tick

    def law(self, name: str, values: Mapping[str, Any] | None = None) -> Law:
        """Return a law of this run with the parameters of the scenario, or with others."""
        if values is None:
            values = self.scenario.laws.get(name, {})
        return scenario_data.fitting_law(name, values, self.model, self.control_period, self.scenario.compensation)

    def gains(self, name: str, values: Mapping[str, Any] | None = None) -> Gains:
        """Return the parameters of a law in this run, with those of the scenario or with others given."""
        if values is None:
            values = self.scenario.laws.get(name, {})
        return LAWS.gains(name, values, self.model, self.control_period)

    def reporting(self) -> RunSetup:
        """Return the run as one of several trains in a domain: with a supervisor it reports to the train behind it."""
        return replace(self, layout=replace(self.layout, reports=self.layout.supervised))

    def advice(self, name: str | None = None, values: Mapping[str, Any] | None = None) -> str:
        """Return a line with the remedy for a law that does not fit the train or its delay; "" if it fits.

        Default: the law at the start with the parameters of the scenario. For a driver's run, which has no law: that
        of :func:`without_effect`.
        """
        if name is None and self.scenario.profile.driver is not None:
            return without_effect(self.scenario)
        name = self.scenario.law if name is None else name
        law, gains = self.law(name, values), self.gains(name, values)
        given = self.compensation_parameters
        predicted = getattr(COMPENSATIONS.get(self.scenario.compensation), "predicts", False)
        judged = not predicted or (self.scenario.compensation == "predictor" and given.get("train", "rigid") == "rigid")
        unstable = bool(gains.own) and judged and is_unstable(law, self.model, self.control_period, predicted=predicted)
        return advice(name, law, gains, self.model, self.control_period, self.scenario.compensation, unstable=unstable)

    def train(self) -> Train:
        """Return the train at its start."""
        try:
            plant, seed = self.scenario.plant, self.scenario.seed
            return Train(self.consist, self.line, plant, step_ns=self.step_ns, tick_ns=self.tick_ns, seed=seed)
        except ValueError as error:
            raise ValueError(f"plant: {error}") from None

    def check_intervention(self, intervention: Intervention) -> None:
        """Check an intervention for this train and its topics."""
        topic = getattr(intervention, "topic", None)
        if topic is not None and not BY_NAME[topic].exists(self.layout):
            raise ValueError(f"{intervention.do}: this run has no {topic}; use another topic")
        if isinstance(intervention, TrainJumpNow):
            self.train().add_jump(Jump(at=0.0, what=intervention.what, factor=intervention.factor))

    def brake_policy(self) -> BrakePolicy:
        """Return a fresh policy of the air brake."""
        return make_brake_policy(self.scenario.brake, self.model, self.line, self.profile)

    def force_distribution(self) -> ForceDistribution | None:
        """Return the distribution of the force over the power units; None for the fixed shares of the model."""
        shares = self.scenario.force_shares
        return None if shares is None else ForceDistribution(shares, self.model.share.tolist())

    def planned_displacement(self) -> PlannedDisplacement | None:
        """Return the planned displacements of the power units; None without any."""
        planned = self.scenario.unit_displacements
        return None if planned is None else PlannedDisplacement(planned, self.model.n_units)

    def supervisor(self) -> Supervisor:
        """Return the supervisor of the train on its line, up to the stop at the end of the profile."""
        reaction = (self.supervision_ticks + 1) * self.tick + self.scenario.links.brake_release.longest
        return scenario_data.line_supervisor(self.scenario, self.consist, self.line, self.profile, reaction)

    def replanner(self, profile: Profile | None = None) -> Replanner | None:
        """Return the replanner of a profile, by default the first one; None without ``replan:`` in the scenario."""
        spec = self.scenario.replan
        if spec is None:
            return None
        from train_ato.profile.planner.replanner import Replanner  # a late import: it compiles kernels

        replanner = Replanner(spec, profile or self.profile, self.model, self.scenario.profile.plan, self.profile)
        replanner.warm_up()
        return replanner

    def resolved_yaml(self) -> str:
        """Return the scenario as YAML with the content of all its files; it reproduces the run."""
        return "".join(_block_yaml(key, value) for key, value in self._resolved_data.items())

    def fingerprint(self) -> dict[str, str]:
        """Return a hash of every top-level key of the resolved scenario; equal runs have equal hashes."""
        texts = {key: json.dumps(value, sort_keys=True) for key, value in self._resolved_data.items()}
        return {key: hashlib.sha256(text.encode()).hexdigest()[:8] for key, text in texts.items()}

    def _all_values(self, law: str) -> dict[str, Any]:
        """Return every parameter of a law with a choice of gains, otherwise those that are given."""
        gains = self.gains(law)
        defaults = {entry.name: entry.default for entry in LAWS.parameters(law)} if gains.source else {}
        return {**defaults, **gains.values}

    @cached_property
    def _resolved_data(self) -> dict[str, Any]:
        later = (law for change in self.scenario.law_changes for law in (change.law, *change.laws) if law)
        laws = {**self.scenario.laws, **{law: self._all_values(law) for law in (self.scenario.law, *later)}}
        scenario = self.scenario.model_copy(update={"laws": laws})
        return resolved_data(scenario, self.folder, self.consist, self.line, self.model)


def prepare(
    scenario: Scenario, path: Path, parts: scenario_data.PartCache | None = None, *, recorded: bool = False
) -> RunSetup:
    """Return the prepared run of a scenario: load data, build model and profile, check their combination.

    Parameters
    ----------
    scenario, path
        Checked scenario, and its file.
    parts
        Parts of former runs, reused where the values that determine them are equal; default: none.
    recorded
        The scenario is that of a recorded run, whose evaluation may have no tick.
    """
    try:
        setup = _prepare(scenario, path.parent, parts or scenario_data.PartCache())
        if not recorded:
            check_evaluation(setup.scenario, setup.profile)
            check_forwards(setup.scenario, setup.profile)
        return setup
    except ValueError as error:
        message = str(error)
        raise ValueError(message if message.startswith(str(path)) else f"{path}: {message}") from None
    except ArithmeticError as error:
        raise ValueError(f"{path}: a number is too large or too small ({error}); correct it") from None


def _prepare(scenario: Scenario, folder: Path, parts: scenario_data.PartCache) -> RunSetup:
    scenario = scenario_data.with_driver(scenario)
    consist = scenario_data.scenario_consist(scenario.plant.consist, folder, parts)
    line = line_for(scenario_data.scenario_line(scenario.plant.line, folder, parts), consist.categories, consist.rating)
    layout = scenario_data.scenario_layout(scenario, consist, line)
    tick_ns, step_ns = round(scenario.tick * 1e9), round(scenario.step * 1e9)
    model = scenario_data.nominal_model(scenario, consist, line, layout, folder, parts)
    scenario = scenario_data.with_departure(scenario, model)
    profile = scenario_data.scenario_profile(scenario, consist, line, tick_ns, folder, parts)
    setup = RunSetup(
        scenario=scenario_data.with_start(scenario, float(profile.position[0]), float(profile.velocity[0])),
        folder=folder,
        consist=consist,
        line=line,
        model=model,
        profile=profile,
        layout=layout,
        step_ns=step_ns,
        tick_ns=tick_ns,
        ticks=round(scenario.duration * 1e9) // tick_ns,
    )
    _check_choices(setup)
    return _within_supervision(setup, parts)


def _within_supervision(setup: RunSetup, parts: scenario_data.PartCache) -> RunSetup:
    """Return the run with its planned profile below the limits of the supervisor."""
    scenario, margin = setup.scenario, setup.scenario.supervision.plan_margin
    if not setup.layout.supervised or margin is None or scenario.profile.plan is None:
        return setup
    ceiling = SpeedCeiling(
        setup.supervisor().track,
        setup.consist.vehicles[0].length / 2.0,
        scenario.plant.odometry.balise_spacing,
        setup.assurance_reaction,
        margin,
    )

    def plan(below: tuple[Array, Array]) -> Profile:
        return scenario_data.scenario_profile(
            scenario, setup.consist, setup.line, setup.tick_ns, setup.folder, parts, below
        )

    return replace(setup, profile=profile_within(ceiling, setup.profile, plan))


def _check_choices(setup: RunSetup) -> None:
    """Check the combination: create train, laws, observer, compensation and brake policy once."""
    check_replan(setup.scenario, setup.layout)
    check_requirements(setup.scenario, setup.layout, setup.line)
    check_parameters(setup.scenario)
    check_leader(setup)
    _check_laws(setup)
    OBSERVERS.make(setup.scenario.observer, setup.observer_parameters, setup.model, setup.tick)
    COMPENSATIONS.make(setup.scenario.compensation, setup.compensation_parameters, setup.model, setup.control_period)
    setup.brake_policy()
    setup.force_distribution()
    setup.planned_displacement()
    setup.train()
    for intervention in setup.scenario.interventions:
        setup.check_intervention(intervention)
    if setup.layout.supervised:
        setup.supervisor()
    elif setup.scenario.ato_requests:
        raise ValueError("ato_requests: this run has no supervision; set supervision.enabled: true or remove them")


def _check_laws(setup: RunSetup) -> None:
    """Create the initial law, and every law with the parameters after the planned changes of each step."""
    law, blocks = setup.scenario.law, {name: dict(values) for name, values in setup.scenario.laws.items()}
    setup.law(law, blocks.get(law, {}))
    planned = sorted(setup.scenario.law_changes, key=lambda change: change.at)
    for _, changes in groupby(planned, key=lambda change: effective_stamp(change, setup.tick_ns)):
        for change in changes:
            law = change.law or law
            LAWS.get(law)
            for name, values in change.laws.items():
                LAWS.check_parameters(name, values)
                blocks.setdefault(name, {}).update(values)
        setup.law(law, blocks.get(law, {}))
