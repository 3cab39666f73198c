"""The train at the end of the command link."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plant_sim.disturbances import Gust
from plant_sim.emergency import EmergencyBrake
from plant_sim.train import Observation
from train_ato.interventions import (
    KEY,
    DelayJumpNow,
    EmergencyBrakeNow,
    GustNow,
    Intervention,
    as_text,
    due_stamp,
)
from train_ato.links import DelayJump, Link
from train_ato.roles.outgoing import Outgoing, due
from train_ato.run_setup import RunSetup
from train_ato.topics import Role
from train_ato.types import (
    Array,
    Command,
    Diagnostic,
    Disturbance,
    Pipe,
    Tick,
)

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
STANDSTILL = 0.05
"""Speed of every vehicle below which the emergency brake may be released [m/s]."""


class PlantRole:
    """The train, its sensors and the receiving end of the command link.

    Parameters
    ----------
    setup
        The run, with the interventions that its scenario plans; more may be asked for while it runs.

    Attributes
    ----------
    emergency : bool
        The emergency brake is applied: the law's commands arrive and do not act.
    """

    role = Role.PLANT

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self.emergency = False
        self._due = [(due_stamp(planned, setup.tick_ns), planned) for planned in setup.scenario.interventions]
        self._brake = EmergencyBrake(setup.consist, setup.plant)
        self.train = setup.train()
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
        taken = self._intervene(stamp) if self._due else []
        seen = self.train.observe()
        messages = self._truth(stamp, seen)
        if taken or due(stamp, self.setup.tick_ns):
            messages.append(("/diagnostics", self.diagnostic(taken)))
        messages.append(("train/measurement", seen.measurement))
        return messages

    def request(self, intervention: Intervention) -> None:
        """Do something to the train from outside; it acts from the next observation on and is reported with it.

        Raises
        ------
        ValueError
            If the emergency brake is to be released while the train moves.
        """
        if _releases(intervention) and self._speed >= STANDSTILL:
            speed = f"{3.6 * self._speed:.1f} km/h"
            raise ValueError(f"the emergency brake is released at standstill only; the train runs {speed}")
        self._due.append((self.stamp, intervention))

    @property
    def _speed(self) -> float:
        """Speed of the fastest vehicle [m/s]."""
        return float(np.abs(self.train.velocity).max())

    def _intervene(self, stamp: int) -> list[Intervention]:
        """Take what is due at this stamp; a release that was planned for a moving train waits for its standstill."""
        moving = self._speed >= STANDSTILL
        taken, left = [], []
        for at, intervention in self._due:
            if at > stamp or (moving and _releases(intervention)):
                left.append((at, intervention))
            else:
                taken.append(intervention)
        self._due = left
        now = stamp / 1e9
        for intervention in taken:
            if isinstance(intervention, GustNow):
                end, ramp = now + intervention.duration, intervention.ramp
                acceleration = intervention.acceleration
                self.train.blow(Gust(kind="gust", begin=now, end=end, ramp=ramp, acceleration=acceleration))
            elif isinstance(intervention, DelayJumpNow):
                self._link.jump(DelayJump(at=now, factor=intervention.factor, add=intervention.add))
            else:
                self.emergency = intervention.applied
                if self.emergency:
                    self.train.vent()
        return taken

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
        pressure = None
        if pipe is not None:
            self._pipe_link.push(stamp, np.array([pipe.pressure]))
            pressure = float(self._pipe_link.pop(stamp)[0])
        self._advance(pressure)

    def hold(self) -> None:
        """Integrate one tick without a new command: the one under way goes on (paced runs only)."""
        self._advance(None)

    def _advance(self, pressure: float | None) -> None:
        """Integrate one tick with what is due, or with the emergency brake instead."""
        demand: Array = self._link.window(self.stamp, self._substeps)
        if self.emergency:
            demand[:] = self._brake.demand(self.train.velocity[list(self.train.units)])
            pressure = None
        self.train.advance(demand, pressure)
        self.tick += 1

    def diagnostic(self, taken: Sequence[Intervention] = ()) -> Diagnostic:
        """Return the running totals of the plant as text, with what was done from outside at this stamp."""
        totals = self.train.totals
        values = {name: repr(float(getattr(totals, attribute))) for name, attribute in TOTALS}
        values["commands_lost"] = str(self._link.lost)
        if taken:
            values[KEY] = as_text(taken)
        if self.finished:
            return Diagnostic(self.stamp, "plant", 0, "finished", values)
        level, state = (1, "emergency brake") if self.emergency else (0, "running")
        return Diagnostic(self.stamp, "plant", level, state, values)


def _releases(intervention: Intervention) -> bool:
    return isinstance(intervention, EmergencyBrakeNow) and not intervention.applied
