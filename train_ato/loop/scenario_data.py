"""Train, line, layout, nominal model, profile and start position of a scenario, with the files beside it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line, split_name
from plant_sim.line import Line
from train_ato.control.algorithms.train_constants import dead_time
from train_ato.control.learned_resistance import LearnedResistance, model_hash, read_learned
from train_ato.control.train_model import LineForceTable, TrainModel
from train_ato.loop.part_cache import PartCache, file_state
from train_ato.messages.layout import TrainLayout
from train_ato.messages.types import Array
from train_ato.profile.profile import Profile
from train_ato.scenario.profile_spec import ProfileSpec
from train_ato.scenario.scenario import Scenario

__all__ = [
    "nominal_model",
    "profile_key",
    "scenario_consist",
    "scenario_layout",
    "scenario_line",
    "scenario_profile",
    "with_departure",
    "with_start_position",
]


def scenario_consist(named: str | Consist, folder: Path, parts: PartCache | None = None) -> Consist:
    """Return a consist of a scenario: defined there, or a file beside it, or a shipped one."""
    if isinstance(named, Consist):
        return named
    parts = parts or PartCache()
    return parts.get(("consist", data_key(named, folder)), lambda: load_consist(_beside(named, folder)))


def scenario_line(named: str | Line, folder: Path, parts: PartCache | None = None) -> Line:
    """Return a line of a scenario: defined there, or a file beside it, or a shipped one."""
    if isinstance(named, Line):
        return named
    parts = parts or PartCache()
    return parts.get(("line", data_key(named, folder)), lambda: load_line(_beside(named, folder)))


def data_key(named: str | Consist | Line, folder: Path) -> tuple[object, ...]:
    """Return the values that determine a consist or a line: its data, or its file with the state of the file."""
    if not isinstance(named, str):
        return (named,)
    path = _beside(named, folder)
    return path, file_state(Path(split_name(path)[0]))


def _beside(name: str, folder: Path) -> str:
    """Return the path of a file in the folder of the scenario, with the selection of a line, or the name itself."""
    stem, selection = split_name(name)
    path = folder / stem
    return f"{path}{selection}" if path.is_file() else name


def scenario_layout(scenario: Scenario, consist: Consist, line: Line) -> TrainLayout:
    """Return the parts of train and plant that determine the topics of a run and the sizes of their messages."""
    return TrainLayout(
        n_vehicles=len(consist.vehicles),
        n_units=len(consist.power_units),
        sensors=scenario.plant.sensors.couplers,
        air_brake=consist.air_brake is not None,
        disturbed=bool(scenario.plant.disturbances),
        supervised=_is_supervised(scenario, line),
    )


def _is_supervised(scenario: Scenario, line: Line) -> bool:
    """Return the choice of the scenario, or True for a line with speed limits."""
    chosen = scenario.supervision.enabled
    return bool(line.speed_limits) if chosen is None else chosen


def nominal_model(
    scenario: Scenario, consist: Consist, line: Line, layout: TrainLayout, folder: Path, parts: PartCache | None = None
) -> TrainModel:
    """Return the nominal model of a scenario; without a block ``model`` it has the data of plant and links.

    ``parts`` has the tables of the line force of former models.

    Raises
    ------
    ValueError
        For a learned resistance of another line or train: file, key, value, problem; fix.
    """
    parts = parts or PartCache()
    block = scenario.model
    link = scenario.links.command
    delay, delay_brake = link.per_unit(layout.n_units, "links.command")
    if block.delay is not None:
        nominal = link.model_copy(update={"delay": block.delay, "delay_brake": block.delay_brake})
        delay, delay_brake = nominal.per_unit(layout.n_units, "model")
    own_line = line
    consist = consist if block.consist is None else scenario_consist(block.consist, folder, parts)
    line = line if block.line is None else scenario_line(block.line, folder, parts)
    named = (block.consist or scenario.plant.consist, block.line or scenario.plant.line)
    over_length = scenario.plant.grade_over_length
    key = ("line force", over_length, *(data_key(data, folder) for data in named))
    return TrainModel(
        consist,
        line,
        np.asarray(delay),
        np.asarray(delay_brake),
        float(np.max(scenario.plant.lag)) if block.lag is None else block.lag,
        scenario.tick,
        tuple(layout.sensors),
        over_length=over_length,
        reversing=scenario.plant.reversing,
        line_force=parts.get(key, lambda: LineForceTable(consist, line, over_length=over_length)),
        learned=_learned(block.learned, folder, own_line, consist, line, over_length),
    )


def _learned(
    named: str | LearnedResistance | None, folder: Path, line: Line, consist: Consist, nominal: Line, over_length: bool
) -> LearnedResistance | None:
    """Return the learned resistance of a scenario for its line, nominal train and nominal line."""
    if named is None:
        return None
    file = _beside(named, folder) if isinstance(named, str) else ""
    try:
        found = read_learned(Path(file)) if isinstance(named, str) else named
        found.check_fits(line, consist, model_hash(consist, nominal, over_length))
    except ValueError as error:
        message = str(error).removeprefix(f"{file}: ")
        raise ValueError(f"model.learned: {file}{': ' if file else ''}{message}") from None
    return found


def scenario_profile(
    scenario: Scenario,
    consist: Consist,
    line: Line,
    tick_ns: int,
    folder: Path,
    parts: PartCache,
    ceiling: tuple[Array, Array] | None = None,
) -> Profile:
    """Return the profile of a scenario, from former runs if train, line, block ``profile`` and tick are equal.

    ``ceiling`` has places of the front [m] and speeds [m/s] of a speed limit of a plan beside that of the line.
    """
    spec, plant = scenario.profile, scenario.plant
    data = (data_key(plant.consist, folder), data_key(plant.line, folder))
    key = ("profile", *profile_key(spec, folder), *data, tick_ns, scenario.brake.deepest, ceiling)
    reduction = scenario.brake.deepest
    return parts.get(key, lambda: spec.build(consist, line, tick_ns * 1e-9, folder, reduction, ceiling))


def profile_key(spec: ProfileSpec, folder: Path) -> tuple[object, ...]:
    """Return the values that determine the data of a block ``profile``: its keys, and the state of its file."""
    return spec, folder, None if spec.file is None else file_state(spec.file_in(folder))


def with_departure(scenario: Scenario, model: TrainModel) -> Scenario:
    """Return the scenario with the departure of its plan, unless it defines one: when the first command takes effect.

    No law follows an earlier one: the train would have the speed error of the acceleration over delay and lag, which a
    slow loop carries to the first stop.
    """
    plan = scenario.profile.plan
    if plan is None or plan.departure is not None or plan.begin_speed > 0.0:
        return scenario
    if plan.points is not None and plan.points[0].departure is not None:
        return scenario
    departure = math.ceil(dead_time(model) / model.tick - 1e-9) * model.tick
    profile = scenario.profile.model_copy(update={"plan": plan.model_copy(update={"departure": departure})})
    return scenario.model_copy(update={"profile": profile})


def with_start_position(scenario: Scenario, position: float) -> Scenario:
    """Return the scenario with the train at the begin of the profile, unless it defines the start position."""
    start = scenario.plant.start
    if start.positions is not None or "position" in start.model_fields_set:
        return scenario
    plant = scenario.plant.model_copy(update={"start": start.model_copy(update={"position": position})})
    return scenario.model_copy(update={"plant": plant})
