"""Prepared run: data, model and profile of a scenario, validated before the run starts."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.plant_setup import Jump
from plant_sim.train import Train
from train_ato.control.air_brake.policy import BrakePolicy, make_brake_policy
from train_ato.control.compensation.compatibility import check_compatible
from train_ato.control.contract import Law
from train_ato.control.force_distribution import ForceDistribution
from train_ato.control.parameters import RefusedParameter
from train_ato.control.planned_displacement import PlannedDisplacement
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS
from train_ato.control.train_model import TrainModel
from train_ato.loop.part_cache import PartCache, file_state
from train_ato.loop.scenario_data import data_key, nominal_model, scenario_consist, scenario_line, with_start_position
from train_ato.loop.signal_check import unavailable_signal
from train_ato.messages.layout import TrainLayout
from train_ato.messages.topics import BY_NAME
from train_ato.profile.profile import Profile
from train_ato.scenario.formula import signals_of
from train_ato.scenario.formula_parser import parse_formula
from train_ato.scenario.interventions import Intervention, TrainJumpNow
from train_ato.scenario.profile_spec import ProfileSpec
from train_ato.scenario.scenario import LawChange, Links, PlantBlock, Scenario
from train_ato.supervision.plant_line import line_supervision
from train_ato.supervision.supervisor import Supervisor

if TYPE_CHECKING:
    from train_ato.profile.planner.replanner import Replanner


@dataclass(frozen=True)
class RunSetup:
    """A validated run: data, time grids and nominal model.

    Attributes
    ----------
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

    @property
    def tick(self) -> float:
        """Period of the loop [s]."""
        return self.tick_ns * 1e-9

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

    @property
    def has_faults(self) -> bool:
        """True for a run in which messages can get lost or change on their way."""
        return bool(self.scenario.faults or self.scenario.interventions)

    @property
    def control_period(self) -> float:
        """Period of the law [s]."""
        return self.scenario.control_period or self.tick

    @property
    def plant(self) -> PlantBlock:
        """Block ``plant`` of the scenario."""
        return self.scenario.plant

    @property
    def seed(self) -> int:
        """Seed of every random stream."""
        return self.scenario.seed

    @property
    def links(self) -> Links:
        """Delays on topics."""
        return self.scenario.links

    @property
    def observer(self) -> str:
        """Name of the observer."""
        return self.scenario.observer

    @property
    def observer_parameters(self) -> dict[str, Any]:
        """Parameters of the observer that differ from its defaults."""
        return self.scenario.observers.get(self.observer, {})

    @property
    def controller(self) -> str:
        """Name of the law at the start."""
        return self.scenario.law

    @property
    def controller_parameters(self) -> dict[str, dict[str, Any]]:
        """Parameters of every law that differ from its defaults."""
        return self.scenario.laws

    @property
    def laws(self) -> tuple[str, ...]:
        """Names of the laws this run can change to: the registered ones, and each ``module:Class`` of the scenario."""
        named = [self.controller, *self.controller_parameters]
        for change in self.law_changes:
            named += [change.law or self.controller, *change.laws]
        return tuple(dict.fromkeys((*LAWS.loadable(), *named)))

    @property
    def compensation(self) -> str:
        """Name of the delay compensation."""
        return self.scenario.compensation

    @property
    def compensation_parameters(self) -> dict[str, Any]:
        """Parameters of the compensation that differ from its defaults."""
        return self.scenario.compensations.get(self.compensation, {})

    @property
    def law_changes(self) -> tuple[LawChange, ...]:
        """Planned changes of laws and parameters."""
        return self.scenario.law_changes

    def law(self, name: str, values: Mapping[str, Any] | None = None) -> Law:
        """Return a law of this run with the parameters of the scenario, or with others.

        Raises
        ------
        ValueError
            For an unknown name or parameter, or a train or compensation that does not fit the law.
        """
        if values is None:
            values = self.controller_parameters.get(name, {})
        if not self.model.n_units:
            raise ValueError(f"law '{name}': no vehicle of the train has traction or brake; add an envelope")
        compensation = COMPENSATIONS.get(self.compensation)
        try:
            law: Law = LAWS.make(name, values, self.model, self.control_period)
        except RefusedParameter as error:
            if getattr(compensation, "feedforward_only", False):  # the sensors would not make the law use it
                raise error.with_remedy_only() from None
            raise
        except ValueError as error:
            try:
                check_compatible(name, LAWS.get(name), self.compensation, compensation)
            except ValueError as second:
                raise ValueError(f"{error}; also {second}") from None
            raise
        check_compatible(name, law, self.compensation, compensation)
        return law

    def train(self) -> Train:
        """Return the train at its start."""
        try:
            return Train(self.consist, self.line, self.plant, self.step_ns, self.tick_ns, self.seed)
        except ValueError as error:
            raise ValueError(f"plant: {error}") from None

    def check_intervention(self, intervention: Intervention) -> None:
        """Check an intervention for this train and its topics.

        Raises
        ------
        ValueError
            If the run lacks the topic or the part of the train.
        """
        topic = getattr(intervention, "topic", None)
        if topic is not None and not BY_NAME[topic].exists(self.layout):
            raise ValueError(f"{intervention.do}: this run has no {topic}; use another topic")
        if isinstance(intervention, TrainJumpNow):
            self.train().add_jump(Jump(at=0.0, what=intervention.what, factor=intervention.factor))

    def brake_policy(self) -> BrakePolicy:
        """Return a fresh policy of the air brake."""
        return make_brake_policy(self.scenario.brake, self.model, self.line)

    def force_distribution(self) -> ForceDistribution | None:
        """Return the distribution of the force over the power units; None for the fixed shares of the model."""
        shares = self.scenario.force_shares
        return None if shares is None else ForceDistribution(shares, self.model.share.tolist())

    def planned_displacement(self) -> PlannedDisplacement | None:
        """Return the planned displacements of the power units; None without any."""
        planned = self.scenario.unit_displacements
        return None if planned is None else PlannedDisplacement(planned, self.model.n_units)

    def supervisor(self) -> Supervisor:
        """Return the supervisor of the train on its line, up to the stop at the end of the profile.

        Raises
        ------
        ValueError
            If the emergency brake is weaker than a grade before a target.
        """
        spec, profile = self.scenario.supervision, self.profile
        front = self.consist.vehicles[0].length / 2.0
        stop = float(profile.position[-1]) + front if profile.velocity[-1] == 0.0 else None
        reaction = (self.supervision_ticks + 1) * self.tick + self.links.brake_release.longest
        try:
            track = line_supervision(
                self.consist, self.line, self.plant, None if stop is None else stop + spec.overlap,
                kdry=spec.kdry, reaction=reaction, service_brake=spec.service_brake, service_curve=spec.service_curve,
            )  # fmt: skip
        except ValueError as error:
            raise ValueError(f"supervision: {error}; or set supervision.enabled: false") from None
        return Supervisor(track, spec)

    def replanner(self, profile: Profile | None = None) -> Replanner | None:
        """Return the replanner of a profile, by default the first one; None without ``replan:`` in the scenario."""
        spec = self.scenario.replan
        if spec is None:
            return None
        from train_ato.profile.planner.replanner import Replanner  # a late import: it compiles kernels

        replanner = Replanner(spec, profile or self.profile, self.model, self.scenario.profile.plan)
        replanner.warm_up()
        return replanner

    def resolved_yaml(self) -> str:
        """Return the scenario as YAML with the content of all its files; it reproduces the run."""
        return self._resolved

    def fingerprint(self) -> dict[str, str]:
        """Return a hash of every top-level key of the resolved scenario: equal runs have equal ones."""
        texts = {key: json.dumps(value, sort_keys=True) for key, value in self._resolved_data.items()}
        return {key: hashlib.sha256(text.encode()).hexdigest()[:8] for key, text in texts.items()}

    @cached_property
    def _resolved(self) -> str:
        return "".join(_block_yaml(key, value) for key, value in self._resolved_data.items())

    @cached_property
    def _resolved_data(self) -> dict[str, Any]:
        data = self.scenario.model_dump(mode="json", by_alias=True, exclude_none=True, exclude_defaults=False)
        data["plant"]["consist"] = self.consist.model_dump(mode="json", by_alias=True, exclude_defaults=True)
        data["plant"]["line"] = self.line.model_dump(mode="json", by_alias=True, exclude_defaults=True)
        for key in ("consist", "line"):
            if getattr(self.scenario.model, key) is not None:
                part = getattr(self.model, key)
                data["model"][key] = part.model_dump(mode="json", by_alias=True, exclude_defaults=True)
        if self.model.learned is not None:
            data["model"]["learned"] = self.model.learned.model_dump(mode="json", by_alias=True)
        if self.scenario.replan is not None:
            data["replan"] = self.scenario.replan.model_dump(mode="json", by_alias=True, exclude_unset=True)
        profile, folder = self.scenario.profile, self.folder
        determined_by = (profile, folder, _file_of(profile, folder))
        data["profile"] = _texts.get(determined_by, lambda: dict(sorted(profile.inlined(folder).items())))
        return data


def _block_yaml(key: str, value: Any) -> str:
    """Return a top-level key of a resolved scenario with its value as YAML."""
    if not isinstance(value, dict) or not value:
        return _yaml_of({key: value})
    parts = [_yaml_of({key: {name: entry}}) for name, entry in value.items()]
    return f"{key}:\n" + "".join(part.partition("\n")[2] for part in parts)


_texts = PartCache(256)
"""Profiles and YAML of parts of resolved scenarios; the runs of a study have most of it in common."""


def _yaml_of(value: dict[str, Any]) -> str:
    """Return plain data as YAML, without anchors for shared parts."""
    return _texts.get(value, lambda: _dumped(json.loads(json.dumps(value))))


def _dumped(value: dict[str, Any]) -> str:
    text: str = yaml.safe_dump(value, sort_keys=False, allow_unicode=True, width=120)
    return text


def prepare(scenario: Scenario, path: Path, parts: PartCache | None = None) -> RunSetup:
    """Return the prepared run of a scenario: load data, build model and profile, check their combination.

    Parameters
    ----------
    scenario, path
        Checked scenario, and its file.
    parts
        Parts of former runs, reused where the values that determine them are equal; default: none.

    Raises
    ------
    ValueError
        One line: file, key, value, problem; fix.
    """
    folder = path.parent
    try:
        return _prepare(scenario, folder, parts or PartCache())
    except ValueError as error:
        message = str(error)
        raise ValueError(message if message.startswith(str(path)) else f"{path}: {message}") from None
    except ArithmeticError as error:
        raise ValueError(f"{path}: a number is too large or too small ({error}); correct it") from None


def _with_current_names(scenario: Scenario) -> Scenario:
    """Return the scenario with the parameters of laws, observers and compensations under their current names."""
    changes = [change.model_copy(update={"laws": LAWS.current_names(change.laws)}) for change in scenario.law_changes]
    update = {
        "laws": LAWS.current_names(scenario.laws),
        "observers": OBSERVERS.current_names(scenario.observers),
        "compensations": COMPENSATIONS.current_names(scenario.compensations),
        "law_changes": tuple(changes),
    }
    return scenario.model_copy(update=update)


def _prepare(scenario: Scenario, folder: Path, parts: PartCache) -> RunSetup:
    scenario = _with_current_names(scenario)
    consist = scenario_consist(scenario.plant.consist, folder, parts)
    line = scenario_line(scenario.plant.line, folder, parts)
    layout = TrainLayout(
        n_vehicles=len(consist.vehicles),
        n_units=len(consist.power_units),
        sensors=scenario.plant.sensors.couplers,
        air_brake=consist.air_brake is not None,
        disturbed=bool(scenario.plant.disturbances),
        supervised=_is_supervised(scenario, line),
    )
    tick_ns, step_ns = round(scenario.tick * 1e9), round(scenario.step * 1e9)
    profile = _profile(scenario, consist, line, tick_ns, folder, parts)
    setup = RunSetup(
        scenario=with_start_position(scenario, float(profile.position[0])),
        folder=folder,
        consist=consist,
        line=line,
        model=nominal_model(scenario, consist, line, layout, folder, parts),
        profile=profile,
        layout=layout,
        step_ns=step_ns,
        tick_ns=tick_ns,
        ticks=round(scenario.duration * 1e9) // tick_ns,
    )
    _check_choices(setup)
    return setup


def _profile(scenario: Scenario, consist: Consist, line: Line, tick_ns: int, folder: Path, parts: PartCache) -> Profile:
    """Return the profile of a scenario, from former runs if train, line, block ``profile`` and tick are equal."""
    spec, plant = scenario.profile, scenario.plant
    data = (data_key(plant.consist, folder), data_key(plant.line, folder))
    key = ("profile", spec, folder, _file_of(spec, folder), *data, tick_ns, scenario.brake.deepest)
    return parts.get(key, lambda: spec.build(consist, line, tick_ns * 1e-9, folder, scenario.brake.deepest))


def _file_of(spec: ProfileSpec, folder: Path) -> tuple[int, int] | None:
    """Return the state of the file of a profile, None without a file."""
    return None if spec.file is None else file_state(folder / spec.file)


def _is_supervised(scenario: Scenario, line: Line) -> bool:
    """Return the choice of the scenario, or True for a line with speed limits."""
    chosen = scenario.supervision.enabled
    return bool(line.speed_limits) if chosen is None else chosen


def _check_choices(setup: RunSetup) -> None:
    """Check the combination: create train, laws, observer, compensation and brake policy once."""
    _check_replan(setup)
    _check_requirements(setup)
    for name, values in setup.controller_parameters.items():
        LAWS.check_parameters(name, values)
    for name, values in setup.scenario.observers.items():
        OBSERVERS.check_parameters(name, values)
    for name, values in setup.scenario.compensations.items():
        COMPENSATIONS.check_parameters(name, values)
    _check_laws(setup)
    OBSERVERS.make(setup.observer, setup.observer_parameters, setup.model, setup.tick)
    COMPENSATIONS.make(setup.compensation, setup.compensation_parameters, setup.model, setup.control_period)
    setup.brake_policy()
    setup.force_distribution()
    setup.planned_displacement()
    setup.train()
    for intervention in setup.scenario.interventions:
        setup.check_intervention(intervention)
    if setup.layout.supervised:
        setup.supervisor()


def _check_laws(setup: RunSetup) -> None:
    """Create the initial law, and every law with the parameters after each planned change."""
    law, blocks = setup.controller, {name: dict(values) for name, values in setup.controller_parameters.items()}
    setup.law(law, blocks.get(law, {}))
    for change in sorted(setup.law_changes, key=lambda change: change.at):
        law = change.law or law
        for name, values in change.laws.items():
            LAWS.check_parameters(name, values)
            blocks.setdefault(name, {}).update(values)
        setup.law(law, blocks.get(law, {}))


def _check_requirements(setup: RunSetup) -> None:
    """Check that the run has the signals of its requirements."""
    for name, text in (setup.scenario.criteria.requirements or {}).items():
        if reason := unavailable_signal(signals_of(parse_formula(text)), setup.layout, setup.line):
            raise ValueError(f"criteria.requirements.{name}: {reason}")


def _check_replan(setup: RunSetup) -> None:
    """Check that the scenario permits re-planning."""
    if setup.scenario.replan is None:
        return
    if setup.scenario.brake.policy != "none":
        events = " and remove brake.events" if setup.scenario.brake.events else ""
        raise ValueError(
            f"replan: not possible with brake.policy {setup.scenario.brake.policy}, because plans do not include its "
            f"air brake; remove replan, or set brake.policy: none{events}"
        )
    if not setup.layout.n_units:
        raise ValueError("replan: the train has no power unit; remove replan")
    plan = setup.scenario.profile.plan
    if setup.scenario.replan.catch_up and (plan is None or (plan.time is None and plan.points is None)):
        raise ValueError("replan: catch_up: true: the profile has no timetable; add profile.plan.time or .points")
