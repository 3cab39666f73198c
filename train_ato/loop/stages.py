"""Stages of the loop that compiled ticks continue."""

from dataclasses import dataclass

from train_ato.loop.controller import ControllerStage
from train_ato.loop.observer import ObserverStage
from train_ato.loop.plant import PlantStage
from train_ato.loop.profile import ProfileStage
from train_ato.loop.supervisor import SupervisorStage
from train_ato.scenario.setup import RunSetup


@dataclass(frozen=True)
class Stages:
    """Setup and stages of the loop."""

    setup: RunSetup
    plant: PlantStage
    profile: ProfileStage
    observer: ObserverStage
    controller: ControllerStage
    supervisor: SupervisorStage | None = None
