"""Train, line, nominal model and start position of a scenario, with the files beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line
from plant_sim.line import Line
from train_ato.control.train_model import TrainModel
from train_ato.messages.layout import TrainLayout
from train_ato.scenario.scenario import Scenario

__all__ = ["nominal_model", "scenario_consist", "scenario_line", "with_start_position"]


def scenario_consist(named: str | Consist, folder: Path) -> Consist:
    """Return a consist of a scenario: defined there, or a file beside it, or a shipped one."""
    return named if isinstance(named, Consist) else load_consist(_beside(named, folder))


def scenario_line(named: str | Line, folder: Path) -> Line:
    """Return a line of a scenario: defined there, or a file beside it, or a shipped one."""
    return named if isinstance(named, Line) else load_line(_beside(named, folder))


def _beside(name: str, folder: Path) -> str:
    """Return the path of a file in the folder of the scenario, or the name itself."""
    path = folder / name
    return str(path) if path.is_file() else name


def nominal_model(scenario: Scenario, consist: Consist, line: Line, layout: TrainLayout, folder: Path) -> TrainModel:
    """Return the nominal model of a scenario; without a block ``model`` it has the data of plant and links."""
    block = scenario.model
    link = scenario.links.command
    delay, delay_brake = link.per_unit(layout.n_units, "links.command")
    if block.delay is not None:
        nominal = link.model_copy(update={"delay": block.delay, "delay_brake": block.delay_brake})
        delay, delay_brake = nominal.per_unit(layout.n_units, "model")
    return TrainModel(
        consist if block.consist is None else scenario_consist(block.consist, folder),
        line if block.line is None else scenario_line(block.line, folder),
        np.asarray(delay),
        np.asarray(delay_brake),
        float(np.max(scenario.plant.lag)) if block.lag is None else block.lag,
        scenario.tick,
        tuple(layout.sensors),
        over_length=scenario.plant.grade_over_length,
        reversing=scenario.plant.reversing,
    )


def with_start_position(scenario: Scenario, position: float) -> Scenario:
    """Return the scenario with the train at the begin of the profile, unless it defines the start position."""
    start = scenario.plant.start
    if start.positions is not None or "position" in start.model_fields_set:
        return scenario
    plant = scenario.plant.model_copy(update={"start": start.model_copy(update={"position": position})})
    return scenario.model_copy(update={"plant": plant})
