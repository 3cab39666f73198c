"""Stages of the loop, in one process."""

from collections.abc import Mapping, Sequence
from typing import Any

from train_ato.loop.controller import ControllerStage
from train_ato.loop.inputs import StageInputs
from train_ato.loop.observer import ObserverStage
from train_ato.loop.plant import PlantStage
from train_ato.loop.profile import ProfileStage
from train_ato.loop.supervisor import SupervisorStage
from train_ato.scenario.setup import RunSetup


class Stages:
    """Setup and stages of the loop."""

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self.plant = PlantStage(setup)
        self.profile = ProfileStage(setup)
        self.observer = ObserverStage(setup)
        self.controller = ControllerStage(setup)
        self.observer.on_fault = self.controller.fail
        self.supervisor = SupervisorStage(setup) if setup.layout.supervised else None

    @property
    def inputs(self) -> list[StageInputs]:
        """Receiving ends of all stages."""
        owners = (self.plant, self.profile, self.observer, self.controller, self.supervisor)
        return [owner.inputs for owner in owners if owner is not None]

    def accept(self, count: int, messages: Mapping[str, Sequence[Any]]) -> None:
        """Take valid messages at all receiving ends: their number, and by topic the last two or the only one."""
        for inputs in self.inputs:
            for topic in messages.keys() & inputs.ends:
                inputs.ends[topic].accept(count, messages[topic])
