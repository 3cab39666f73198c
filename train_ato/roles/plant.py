"""The train at the end of the command link."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from plant_sim.train import Observation, Train
from train_ato.links import Link
from train_ato.roles.outgoing import Outgoing, due
from train_ato.run_setup import RunSetup
from train_ato.topics import Role
from train_ato.types import (
    Command,
    Diagnostic,
    Disturbance,
    Pipe,
    Tick,
)

if TYPE_CHECKING:
    pass


TOTALS: tuple[tuple[str, str], ...] = (
    ("coupler_draft_max", "draft_max"),
    ("coupler_buff_max", "buff_max"),
    ("energy_traction", "traction"),
    ("energy_regenerated", "regenerated"),
    ("energy_running", "running"),
    ("energy_curve", "curve"),
    ("energy_grade", "grade"),
    ("energy_air_brake", "air_brake"),
    ("energy_couplers", "couplers"),
    ("energy_outside", "outside"),
    ("energy_kinetic", "kinetic"),
    ("saturated", "saturated_any"),
)
"""Key in the plant's diagnostics and attribute of the train's totals, SI."""


class PlantRole:
    """The train, its sensors and the receiving end of the command link."""

    role = Role.PLANT

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self.train = Train(
            setup.consist, setup.line, setup.plant, step_ns=setup.step_ns, tick_ns=setup.tick_ns, seed=setup.seed
        )
        self._link = Link(setup.links.command, setup.shape.n_units, setup.step_ns, setup.seed, "command")
        self._pipe_link = Link(setup.links.brake_pipe, 1, setup.step_ns, setup.seed, "brake_pipe")
        self._substeps = setup.tick_ns // setup.step_ns
        self.tick = 0

    @property
    def stamp(self) -> int:
        """Simulation time of the next observation [ns]."""
        return self.tick * self.setup.tick_ns

    @property
    def finished(self) -> bool:
        """Tell whether every tick of the run has been integrated."""
        return self.tick >= self.setup.ticks

    def observe(self) -> Outgoing:
        """Measure at t_k; ``train/measurement`` comes last, because it starts the step."""
        stamp = self.stamp
        seen = self.train.observe()
        messages = self._truth(stamp, seen)
        if due(stamp, self.setup.tick_ns):
            messages.append(("/diagnostics", self.diagnostic()))
        messages.append(("train/measurement", seen.measurement))
        return messages

    def conclude(self) -> Outgoing:
        """Report the state after the last tick; nobody answers it."""
        seen = self.train.observe()
        return [*self._truth(self.stamp, seen), ("/diagnostics", self.diagnostic())]

    def _truth(self, stamp: int, seen: Observation) -> Outgoing:
        """Return the messages about the truth; those of the air brake and of disturbances only where there are any."""
        messages: Outgoing = [("/clock", Tick(stamp)), ("train/cars", seen.cars)]
        if seen.brake_pipe is not None:
            messages.append(("train/brake_pipe", seen.brake_pipe))
        if seen.brake_cylinders is not None:
            messages.append(("train/brake_cylinders", seen.brake_cylinders))
        if self.setup.shape.disturbed:
            messages.append(("train/disturbance", Disturbance(stamp, self.train.outside_force)))
        return messages

    def act(self, command: Command, pipe: Pipe | None) -> None:
        """Take the command stamped t_k and integrate to t_k+1."""
        stamp = self.stamp
        self._link.push(stamp, command.force)
        demand = self._link.window(stamp, self._substeps)
        pressure = None
        if pipe is not None:
            self._pipe_link.push(stamp, np.array([pipe.pressure]))
            pressure = float(self._pipe_link.pop(stamp)[0])
        self.train.advance(demand, pressure)
        self.tick += 1

    def hold(self) -> None:
        """Integrate one tick without a new command: the one under way goes on (paced runs only)."""
        self.train.advance(self._link.window(self.stamp, self._substeps), None)
        self.tick += 1

    def diagnostic(self) -> Diagnostic:
        """Return the running totals of the plant as text."""
        totals = self.train.totals
        values = {name: repr(float(getattr(totals, attribute))) for name, attribute in TOTALS}
        values["commands_lost"] = str(self._link.lost)
        return Diagnostic(self.stamp, "plant", 0, "running" if not self.finished else "finished", values)
