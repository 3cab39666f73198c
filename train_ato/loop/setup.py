"""Everything a run needs, made and checked from its scenario before anything starts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line
from plant_sim.line import Line
from plant_sim.train import Train
from train_ato.brake.policy import BrakePolicy, make_brake_policy
from train_ato.compensate.fit import refuse_misfit
from train_ato.compensate.registry import COMPENSATIONS
from train_ato.control.contract import Law
from train_ato.control.registry import LAWS
from train_ato.model import TrainModel
from train_ato.observe.registry import OBSERVERS
from train_ato.profile.profile import Profile
from train_ato.scenario import Links, PlantBlock, Scenario, Score, Swap
from train_ato.wire import Shape

if TYPE_CHECKING:
    from train_ato.plan.remaining import Replanner


@dataclass(frozen=True)
class RunSetup:
    """A checked run: data, grids and the nominal model.

    Attributes
    ----------
    consist, line : Consist, Line
        The plant's.
    model : TrainModel
        What laws, observers and compensations know.
    step_ns, tick_ns : int
        Plant step and tick [ns].
    ticks : int
        Number of ticks of the run.
    profile : Profile
        Knots at the tick.
    """

    scenario: Scenario
    folder: Path
    consist: Consist
    line: Line
    model: TrainModel
    profile: Profile
    shape: Shape
    step_ns: int
    tick_ns: int
    ticks: int

    @property
    def tick(self) -> float:
        """Period of the loop [s]."""
        return self.tick_ns * 1e-9

    @property
    def control_period(self) -> float:
        """Period of the law [s]."""
        return self.scenario.control_period or self.tick

    @property
    def plant(self) -> PlantBlock:
        """The plant's block of the scenario."""
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
        return self.scenario.controller

    @property
    def controller_parameters(self) -> dict[str, dict[str, Any]]:
        """Parameters of every law that differ from its defaults."""
        return self.scenario.controllers

    @property
    def compensation(self) -> str:
        """Name of the delay compensation."""
        return self.scenario.compensation

    @property
    def compensation_parameters(self) -> dict[str, Any]:
        """Parameters of the compensation that differ from its defaults."""
        return self.scenario.compensations.get(self.compensation, {})

    @property
    def swaps(self) -> tuple[Swap, ...]:
        """Changes of the law planned in the scenario."""
        return self.scenario.swaps

    @property
    def score(self) -> Score:
        """Part of the run over which the tracking figures are taken."""
        return self.scenario.score

    def law(self, name: str, values: Mapping[str, Any] | None = None) -> Law:
        """Return a law for this run, with the scenario's parameters or others.

        Raises
        ------
        ValueError
            With the reason: a wrong name or parameter, a train or a compensation the law makes no sense with.
        """
        if values is None:
            values = self.controller_parameters.get(name, {})
        if not self.model.n_units:
            raise ValueError(f"controller '{name}': no vehicle of the train has traction or brake; give one some")
        law: Law = LAWS.make(name, values, self.model, self.control_period)
        refuse_misfit(name, law, self.compensation, COMPENSATIONS.get(self.compensation))
        return law

    def train(self) -> Train:
        """Return the train at its start."""
        try:
            return Train(self.consist, self.line, self.plant, self.step_ns, self.tick_ns, self.seed)
        except ValueError as error:
            raise ValueError(f"plant: {error}") from None

    def brake_policy(self) -> BrakePolicy:
        """Return a fresh policy of the air brake."""
        return make_brake_policy(self.scenario.brake, self.model, self.line)

    def replanner(self) -> Replanner | None:
        """Return what plans the rest again when force falls short; None where the scenario does not ask for it."""
        spec = self.scenario.replan
        if spec is None:
            return None
        from train_ato.plan.remaining import Replanner  # compiles the planner: only those who plan pay for it

        replanner = Replanner(spec, self.profile, self.model, self.scenario.profile.plan)
        replanner.warm_up()
        return replanner

    def resolved_yaml(self) -> str:
        """Return the scenario with every file it named written out: this text alone reproduces the run."""
        return self._resolved

    @cached_property
    def _resolved(self) -> str:
        data = self.scenario.model_dump(mode="json", by_alias=True, exclude_none=True, exclude_defaults=False)
        data["plant"]["consist"] = self.consist.model_dump(mode="json", by_alias=True, exclude_defaults=True)
        data["plant"]["line"] = self.line.model_dump(mode="json", by_alias=True, exclude_defaults=True)
        for key in ("consist", "line"):
            if getattr(self.scenario.model, key) is not None:
                part = getattr(self.model, key)
                data["model"][key] = part.model_dump(mode="json", by_alias=True, exclude_defaults=True)
        if self.scenario.replan is not None:
            data["replan"] = self.scenario.replan.model_dump(mode="json", by_alias=True, exclude_unset=True)
        data["profile"] = dict(sorted(self.scenario.profile.inlined(self.folder).items()))
        return yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=120)


def prepare(scenario: Scenario, path: Path) -> RunSetup:
    """Load what the scenario names, build the model and the profile, and check that everything fits together.

    Raises
    ------
    ValueError
        One line that names the file, the key, the value and the remedy.
    """
    folder = path.parent
    try:
        return _prepare(scenario, folder)
    except ValueError as error:
        message = str(error)
        raise ValueError(message if message.startswith(str(path)) else f"{path}: {message}") from None


def _prepare(scenario: Scenario, folder: Path) -> RunSetup:
    consist = _consist(scenario.plant.consist, folder)
    line = _line(scenario.plant.line, folder)
    shape = Shape(
        n_vehicles=len(consist.vehicles),
        n_units=len(consist.power_units),
        sensors=scenario.plant.sensors.couplers,
        air_brake=consist.air_brake is not None,
        disturbed=bool(scenario.plant.disturbances),
    )
    tick_ns, step_ns = round(scenario.tick * 1e9), round(scenario.step * 1e9)
    profile = scenario.profile.build(consist, line, tick_ns * 1e-9, folder, scenario.brake.deepest)
    setup = RunSetup(
        scenario=_started(scenario, float(profile.position[0])),
        folder=folder,
        consist=consist,
        line=line,
        model=_model(scenario, consist, line, shape, folder),
        profile=profile,
        shape=shape,
        step_ns=step_ns,
        tick_ns=tick_ns,
        ticks=round(scenario.duration * 1e9) // tick_ns,
    )
    _check_choices(setup)
    return setup


def _started(scenario: Scenario, position: float) -> Scenario:
    """Return the scenario with the train where the profile begins, unless it says where the train starts."""
    start = scenario.plant.start
    if start.positions is not None or "position" in start.model_fields_set:
        return scenario
    plant = scenario.plant.model_copy(update={"start": start.model_copy(update={"position": position})})
    return scenario.model_copy(update={"plant": plant})


def _consist(named: str | Consist, folder: Path) -> Consist:
    return named if isinstance(named, Consist) else load_consist(_beside(named, folder))


def _line(named: str | Line, folder: Path) -> Line:
    return named if isinstance(named, Line) else load_line(_beside(named, folder))


def _beside(name: str, folder: Path) -> str:
    """Return the path of a file beside the scenario, or the name unchanged."""
    path = folder / name
    return str(path) if path.is_file() else name


def _model(scenario: Scenario, consist: Consist, line: Line, shape: Shape, folder: Path) -> TrainModel:
    block = scenario.model
    link = scenario.links.command
    delay, delay_brake = link.per_unit(shape.n_units, "links.command")
    if block.delay is not None:
        believed = link.model_copy(update={"delay": block.delay, "delay_brake": block.delay_brake})
        delay, delay_brake = believed.per_unit(shape.n_units, "model")
    return TrainModel(
        consist if block.consist is None else _consist(block.consist, folder),
        line if block.line is None else _line(block.line, folder),
        np.asarray(delay),
        np.asarray(delay_brake),
        float(np.max(scenario.plant.lag)) if block.lag is None else block.lag,
        scenario.tick,
        tuple(shape.sensors),
        over_length=scenario.plant.grade_over_length,
        reversing=scenario.plant.reversing,
    )


def _check_choices(setup: RunSetup) -> None:
    """Make the train and every chosen law, observer and compensation once: what does not fit is refused here."""
    _check_replan(setup)
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
    setup.train()


def _check_laws(setup: RunSetup) -> None:
    """Make the law of the start, and every law as a planned swap leaves it."""
    law, blocks = setup.controller, {name: dict(values) for name, values in setup.controller_parameters.items()}
    setup.law(law, blocks.get(law, {}))
    for swap in sorted(setup.swaps, key=lambda swap: swap.at):
        law = swap.controller or law
        for name, values in swap.controllers.items():
            LAWS.check_parameters(name, values)
            blocks.setdefault(name, {}).update(values)
        setup.law(law, blocks.get(law, {}))


def _check_replan(setup: RunSetup) -> None:
    """Refuse what cannot be planned again."""
    if setup.scenario.replan is None:
        return
    if setup.scenario.brake.policy != "none":
        raise ValueError(
            f"replan: the profile knows nothing of the air brake that brake.policy {setup.scenario.brake.policy} "
            "applies; leave replan out or set brake.policy: none"
        )
    if not setup.shape.n_units:
        raise ValueError("replan: the train has no power unit whose force could fall short; leave replan out")
