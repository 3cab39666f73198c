"""Plant stage: the train and the receiving end of the command link."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import numpy as np

from plant_sim.odometry import Odometers
from plant_sim.service_brake import FullServiceBrake
from plant_sim.states import Observation
from train_ato.loop.inputs import StageInputs
from train_ato.loop.setup import RunSetup
from train_ato.loop.stage_messages import PlantMessages, PlantTruth, diagnostics_due
from train_ato.loop.train_interventions import TrainInterventions
from train_ato.loop.train_protection import Protection, TrainProtection
from train_ato.messages.links import Link, LinkSpec
from train_ato.messages.topics import Role
from train_ato.messages.types import (
    Array,
    BrakeRelease,
    Command,
    Diagnostic,
    Disturbance,
    Odometry,
    Pipe,
    ProtectionState,
    Tick,
)
from train_ato.messages.validity import AliveCheck
from train_ato.scenario.interventions import KEY, Intervention, interventions_to_json

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
"""Key in the diagnostics of the plant, and attribute of the totals of the train [SI]."""
LOST_KEY, RESTARTS_KEY = "lost", "restarts"
"""Keys in the diagnostics of the plant: nodes without an answer; numbers of restarts by node, as a JSON object."""
STANDSTILL = 0.05
"""Maximum speed of every vehicle for a release of the emergency brake [m/s]."""

ACTIVE = {level: np.array(level.active, dtype=np.float64) for level in Protection}
"""Values of the fail-safe state of the train by reaction."""


class PlantStage:
    """Train, its sensors and the receiving end of the command link.

    Parameters
    ----------
    setup
        Prepared run with the planned interventions; :meth:`request` adds others.

    Attributes
    ----------
    protection : TrainProtection
        Fail-safe reactions; with a brake in effect the commands of the law have no effect.
    lost : str
        Nodes without an answer and the reason, "" without one.
    restarts : dict
        Number of restarts after which a node has answered again, by its name.
    alive_check : AliveCheck
        Check of the alive counter of the brake releases.
    link : Link
        Link of the commands.
    odometers : Odometers or None
        Odometers of the supervisor.
    """

    role = Role.PLANT

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self.protection = TrainProtection(setup)
        self._inputs = StageInputs(setup, self.role)
        self.alive_check = AliveCheck()
        if setup.layout.supervised:
            self._inputs.check("atp/brake_release", self.alive_check.problem)
        self.lost = ""
        self.restarts: dict[str, int] = {}
        self._outage_changed = False
        self._reported = Protection.NONE
        self._service_brake = FullServiceBrake(setup.consist, setup.plant)
        self.train = setup.train()
        self.link = Link(setup.links.command, setup.layout.n_units, setup.step_ns, setup.seed, "command")
        self._interventions = TrainInterventions(setup, self.train, self.link, self.protection, self._inputs)
        pipe = setup.links.brake_pipe
        self._pipe_link: Link | None = None
        if setup.consist.air_brake is not None and pipe != LinkSpec():
            charged = setup.consist.air_brake.charged  # demanded until the first command arrives
            self._pipe_link = Link(pipe, 1, setup.step_ns, setup.seed, "brake_pipe", initial=charged)
        self._tick_ns = setup.tick_ns
        self._substeps = setup.tick_ns // setup.step_ns
        self._half = setup.consist.vehicles[0].length / 2.0
        self.odometers: Odometers | None = None
        if setup.layout.supervised:
            front = float(self.train.position[0]) + self._half
            slips = setup.plant.sensors.wheel_slip
            self.odometers = Odometers(setup.plant.odometry, slips, front, setup.seed)
        self.tick = 0

    @property
    def stamp(self) -> int:
        """Simulation time of the next observation [ns]."""
        return self.tick * self._tick_ns

    @property
    def finished(self) -> bool:
        """True if every tick of the run has been integrated."""
        return self.tick >= self.setup.ticks

    def observe(self) -> PlantMessages:
        """Return truth and measurement at t_k."""
        stamp = self.stamp
        taken = self._interventions.take(stamp, standstill=self.standstill) if self._interventions.waiting else []
        seen = self.train.observe()
        odometry, protection = self._for_supervisor(stamp, seen)
        changed = self.protection.level is not self._reported
        self._reported = self.protection.level
        changed |= self._outage_changed
        self._outage_changed = False
        reported = self._inputs.take_changed() or taken or changed or diagnostics_due(stamp, self._tick_ns)
        truth = self._truth(stamp, seen, self.diagnostic(taken) if reported else None)
        return PlantMessages(truth, seen.measurement, odometry, protection)

    def _for_supervisor(self, stamp: int, seen: Observation) -> tuple[Odometry | None, ProtectionState | None]:
        """Return odometry and fail-safe state at a step of the supervisor, otherwise None."""
        if self.odometers is None:
            return None, None
        self.odometers.move(stamp, seen.vehicles.position.item(0) + self._half)
        if not self.setup.supervised_at(stamp):
            return None, None
        odometry = self.odometers.observe(stamp, seen.vehicles.velocity.item(0))
        return odometry, ProtectionState(stamp, ACTIVE[self.protection.level].copy())

    def request(self, intervention: Intervention) -> None:
        """Add an intervention; it acts from the next observation on, which reports it.

        Raises
        ------
        ValueError
            If it is impossible now or for this run.
        """
        self._interventions.request(self.stamp, intervention, speed=self._speed, standstill=self.standstill)

    def report_outage(self, lost: str, restarts: dict[str, int] | None = None) -> None:
        """Report begin or end of an outage at the next observation: nodes with the reason, and numbers of restarts."""
        self.lost, self.restarts = lost, self.restarts if restarts is None else restarts
        self._outage_changed = True

    @property
    def _speed(self) -> float:
        """Maximum speed of all vehicles [m/s]."""
        return float(np.abs(self.train.velocity).max())

    @property
    def standstill(self) -> bool:
        """True if every vehicle is at standstill."""
        return self._speed < STANDSTILL

    def conclude(self) -> PlantTruth:
        """Return the state after the last tick."""
        return self._truth(self.stamp, self.train.observe(), self.diagnostic())

    def _truth(self, stamp: int, seen: Observation, diagnostics: Diagnostic | None) -> PlantTruth:
        """Return the messages of the truth; None for a missing air brake and without disturbances."""
        return PlantTruth(
            Tick(stamp),
            seen.vehicles,
            seen.brake_pipe,
            seen.brake_pipe_tail,
            seen.brake_shoes,
            Disturbance(stamp, self.train.outside_force) if self.setup.layout.disturbed else None,
            diagnostics,
        )

    def act(self, command: Command, pipe: Pipe | None, release: BrakeRelease | None = None) -> None:
        """Integrate to t_k+1 with the command stamped t_k, and the brake release at a step of the supervisor."""
        self._advance(self._receive(command, pipe, release))

    def hold(self, release: BrakeRelease | None = None) -> None:
        """Integrate one tick without a new command (without lockstep only)."""
        self._advance(self._receive(None, None, release))

    def _receive(self, command: Command | None, pipe: Pipe | None, release: BrakeRelease | None) -> float | None:
        """Take the messages of this tick; return the pressure demanded at the head [Pa], None for the present one."""
        stamp, inputs = self.stamp, self._inputs
        released = inputs.receive("atp/brake_release", stamp, release)
        if inputs.fresh("atp/brake_release"):
            self.protection.on_release(released, stamp)
        forces = inputs.receive("ato/command", stamp, command)
        pressure = inputs.receive("ato/brake_pipe_command", stamp, pipe)
        if inputs.fresh("ato/command"):
            self.link.push(stamp, forces.force)
            piped = forces.stamp if not self.setup.layout.air_brake else 0 if pressure is None else pressure.stamp
            self.protection.on_command(min(forces.stamp, piped), stamp)
        if not inputs.fresh("ato/brake_pipe_command"):
            return None
        if self._pipe_link is None:
            return float(pressure.pressure)
        self._pipe_link.push(stamp, (pressure.pressure,))
        return float(self._pipe_link.pop(stamp)[0])

    def _advance(self, pressure: float | None) -> None:
        """Integrate one tick with the arrived commands, or with the fail-safe reaction in their place.

        The emergency brake has a path of its own; the electric brake of locomotives acts beside it and counts nowhere.
        """
        stamp, protection = self.stamp, self.protection
        demand: Array = self.link.window(stamp, self._substeps)
        before = protection.level
        level = protection.step(
            stamp,
            standstill=protection.awaits_standstill and self.standstill,
            separated=self.train.separation_noticed,
        )
        if level is not Protection.NONE:
            pressure = self._brake(level, demand, pressure)
        if level is not before:
            if level is Protection.EMERGENCY_BRAKE:
                self.train.apply_emergency_brake()
            elif before is Protection.EMERGENCY_BRAKE:
                self.train.release_emergency_brake()
        self.train.advance(demand, pressure)
        self.tick += 1

    def _brake(self, level: Protection, demand: Array, pressure: float | None) -> float | None:
        """Put a reaction in place of the demand; return the pressure demanded at the head [Pa], None for no change."""
        brake = self.setup.consist.air_brake
        demand[:] = 0.0
        if level is Protection.SERVICE_BRAKE or (level is Protection.EMERGENCY_BRAKE and brake is not None):
            demand[:] = self._service_brake.demand(self.train.velocity[list(self.train.units)])
        if level is Protection.SERVICE_BRAKE and brake is not None:
            return brake.charged - brake.reduction[-1]
        return None if level is Protection.EMERGENCY_BRAKE else pressure

    def diagnostic(self, taken: Sequence[Intervention] = ()) -> Diagnostic:
        """Return the running totals of the plant as text, with the interventions at this stamp."""
        return self.diagnostic_at(self.stamp, self.train.totals.numbers, taken)

    def diagnostic_at(self, stamp: int, totals: Mapping[str, float], taken: Sequence[Intervention] = ()) -> Diagnostic:
        """Return the diagnostics of a stamp with the totals up to it by name."""
        values = {key: repr(totals[name]) for key, name in TOTALS}
        values["commands_lost"] = str(self.link.lost)
        values |= self._inputs.diagnostics()
        if taken:
            values[KEY] = interventions_to_json(taken)
        if self.lost:
            values[LOST_KEY] = self.lost
        if self.restarts:
            values[RESTARTS_KEY] = json.dumps(self.restarts)
        if stamp >= self.setup.ticks * self._tick_ns:
            return Diagnostic(stamp, "plant", 0, "finished", values)
        protection = self.protection
        if protection.level is Protection.NONE:
            return Diagnostic(stamp, "plant", 0, "running", values)
        values["protection"] = protection.reason
        return Diagnostic(stamp, "plant", 1, protection.level.text, values)
