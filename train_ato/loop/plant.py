"""Plant stage: the train and the receiving end of the command link.

Interventions on the train during a run: planned ones, requests, and their effect at the receiving end.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from plant_sim.disturbances import Gust
from plant_sim.odometry import Odometers
from plant_sim.plant_setup import Jump
from plant_sim.states import Observation
from plant_sim.traction import FullServiceBrake
from plant_sim.train import Train
from train_ato.judge.recording import LOST_KEY
from train_ato.loop.inputs import StageInputs
from train_ato.loop.stage_messages import PlantMessages, PlantTruth
from train_ato.loop.train_ahead import ReportRadio, ReportSender
from train_ato.loop.train_protection import TrainProtection
from train_ato.messages.delay_lines import DelayJump, Link, LinkSpec
from train_ato.messages.faults import DropFault, FreezeFault
from train_ato.messages.receiver import AliveCheck
from train_ato.messages.topics import Role
from train_ato.messages.types import (
    Array,
    BrakeRelease,
    BrakeShoes,
    Command,
    Diagnostic,
    Disturbance,
    Pipe,
    Protection,
    ProtectionState,
    Tick,
    VehicleStates,
)
from train_ato.scenario import interventions
from train_ato.scenario.setup import RunSetup

MAX_REQUESTS = {
    "gust": 10, "delay_jump": 100, "emergency_brake": 10, "message_loss": 10, "message_freeze": 10,
    "train_jump": 100,
}  # fmt: skip
"""Maximum number of requested interventions in force, by kind; their effects add up."""
LASTING = (interventions.DelayJumpNow, interventions.TrainJumpNow)
"""Kinds with an effect to the end of the run."""


class TrainInterventions:
    """Interventions that wait for their tick, and their effect.

    Parameters
    ----------
    setup
        Prepared run with the planned interventions.
    train, link, protection, inputs
        Train, delay line of the commands, fail-safe reactions and receiving ends of the plant.

    Attributes
    ----------
    due : list of (int, Intervention)
        Interventions that wait for their tick, with its stamp [ns].
    """

    def __init__(
        self, setup: RunSetup, train: Train, link: Link, protection: TrainProtection, inputs: StageInputs
    ) -> None:
        self._setup = setup
        self._train, self._link, self._protection, self._inputs = train, link, protection, inputs
        self.due = [
            (interventions.due_stamp(planned, setup.tick_ns), planned) for planned in setup.scenario.interventions
        ]
        self._in_force: dict[str, list[int]] = {}

    def request(self, stamp: int, intervention: interventions.Intervention, *, speed: float, standstill: bool) -> None:
        """Add an intervention that acts from a stamp [ns] on.

        Raises
        ------
        ValueError
            If it is impossible for this run, for a release of the emergency brake of a moving train or without a
            request of it, or with too many requests in force.
        """
        if _releases(intervention) and not standstill:
            text = f"{3.6 * speed:.1f} km/h"
            raise ValueError(f"the emergency brake is released at standstill only; the train runs {text}")
        waiting = any(isinstance(planned, interventions.EmergencyBrakeNow) for _, planned in self.due)
        if _releases(intervention) and not (self._protection.requested or waiting):
            raise ValueError("no emergency brake was requested; that of the supervisor ends by its own rules")
        self._setup.check_intervention(intervention)
        self._take_place(stamp, intervention)
        self.due.append((stamp, intervention))

    def _take_place(self, stamp: int, intervention: interventions.Intervention) -> None:
        """Count a request in force: to its end, a lasting one to the end of the run, others for one tick."""
        kind = intervention.do
        places = self._in_force[kind] = [end for end in self._in_force.get(kind, ()) if end > stamp]
        if len(places) >= MAX_REQUESTS[kind]:
            until = "" if isinstance(intervention, LASTING) else f"; repeat it after {min(places) * 1e-9:.1f} s"
            raise ValueError(f"{len(places)} requests of {kind} are in force, the maximum{until}")
        end = stamp + self._setup.tick_ns + round(getattr(intervention, "duration", 0.0) * 1e9)
        places.append(sys.maxsize if isinstance(intervention, LASTING) else end)

    def take(self, stamp: int, *, standstill: bool) -> list[interventions.Intervention]:
        """Apply and return the interventions due at a stamp [ns]; a planned release waits for standstill."""
        taken, left = [], []
        for at, intervention in self.due:
            if at > stamp or (_releases(intervention) and not standstill):
                left.append((at, intervention))
            else:
                taken.append(intervention)
        self.due = left
        for intervention in taken:
            self._apply(stamp / 1e9, intervention)
        return taken

    def _apply(self, now: float, intervention: interventions.Intervention) -> None:
        train = self._train
        if isinstance(intervention, interventions.GustNow):
            end, ramp = now + intervention.duration, intervention.ramp
            train.outside.add(Gust(kind="gust", begin=now, end=end, ramp=ramp, acceleration=intervention.acceleration))
        elif isinstance(intervention, interventions.DelayJumpNow):
            jump = DelayJump(at=now, factor=intervention.factor, add=intervention.add)
            self._link.jump(jump)
            self._protection.jump(jump)
        elif isinstance(intervention, interventions.EmergencyBrakeNow):
            self._protection.requested = intervention.applied
        elif isinstance(intervention, interventions.TrainJumpNow):
            train.add_jump(Jump(at=now, what=intervention.what, factor=intervention.factor))
        elif isinstance(intervention, interventions.MessageLossNow):
            self._inputs.add(DropFault(topic=intervention.topic, begin=now, end=now + intervention.duration))
        elif intervention.topic == "train/measurement":
            train.sensor_set.freeze(now, now + intervention.duration)
        else:
            self._inputs.add(FreezeFault(topic=intervention.topic, begin=now, end=now + intervention.duration))


def _releases(intervention: interventions.Intervention) -> bool:
    return isinstance(intervention, interventions.EmergencyBrakeNow) and not intervention.applied


TOTALS: tuple[tuple[str, str], ...] = (
    ("coupler_draft_max", "draft_max"), ("coupler_buff_max", "buff_max"), ("energy_traction", "traction"),
    ("energy_regenerated", "regenerated"), ("energy_running", "running"), ("energy_curve", "curve"),
    ("energy_grade", "grade"), ("energy_air_brake", "air_brake"), ("energy_couplers", "couplers"),
    ("energy_outside", "outside"), ("energy_kinetic", "kinetic"), ("saturated", "saturated_any"),
)  # fmt: skip
"""Key in the diagnostics of the plant, and attribute of the totals of the train [SI]."""
RESTARTS_KEY = "restarts"
"""Key in the diagnostics of the plant: numbers of restarts by node, as a JSON object."""
STANDSTILL = 0.05
"""Maximum speed of every vehicle for a release of the emergency brake [m/s]."""

Truth = tuple[Tick, VehicleStates, Pipe | None, Pipe | None, BrakeShoes | None, Disturbance | None, Diagnostic | None]
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
    pipe_link : Link or None
        Link of the pressure of the brake pipe; None without a delay.
    odometers : Odometers or None
        Odometers of the supervisor.
    reports : ReportSender or None
        Reports to the train behind; None for a train alone in its domain.
    radio : ReportRadio or None
        Live reports of the train ahead; None without any.
    tick, stamp : int
        Number of complete ticks, and simulation time of the next observation [ns].
    """

    role = Role.PLANT

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self.protection = TrainProtection(setup)
        self.inputs = StageInputs(setup, self.role)
        self.alive_check = AliveCheck()
        if setup.layout.supervised:
            self.inputs.ends["atp/brake_release"].check = self.alive_check.problem
        self.lost = ""
        self.restarts: dict[str, int] = {}
        self.outage_changed = False
        self.reported = Protection.NONE
        self._service_brake = FullServiceBrake(setup.consist, setup.scenario.plant)
        self.train = setup.train()
        links, seed = setup.scenario.links, setup.scenario.seed
        self.link = Link(links.command, setup.layout.n_units, setup.step_ns, seed, "command")
        self.interventions = TrainInterventions(setup, self.train, self.link, self.protection, self.inputs)
        pipe = links.brake_pipe
        self.pipe_link: Link | None = None
        if setup.consist.air_brake is not None and pipe != LinkSpec():
            charged = setup.consist.air_brake.charged  # demanded until the first command arrives
            self.pipe_link = Link(pipe, 1, setup.step_ns, seed, "brake_pipe", initial=charged)
        self._tick_ns = setup.tick_ns
        self._substeps = setup.tick_ns // setup.step_ns
        self.half = setup.consist.vehicles[0].length / 2.0
        self.odometers: Odometers | None = None
        if setup.layout.supervised:
            front = float(self.train.position[0]) + self.half
            slips = setup.scenario.plant.sensors.wheel_slip
            self.odometers = Odometers(setup.scenario.plant.odometry, slips, front, seed)
        self.reports = ReportSender(setup) if setup.layout.reports else None
        self.radio = ReportRadio(setup) if setup.layout.behind else None
        self.tick = self.stamp = 0

    @property
    def finished(self) -> bool:
        """True if every tick of the run has been integrated."""
        return self.tick >= self.setup.ticks

    def observe(self) -> PlantMessages:
        """Return truth and measurement at t_k."""
        stamp = self.stamp
        taken = self.interventions.take(stamp, standstill=self.standstill) if self.interventions.due else []
        seen, odometry, protection = self.train.observe(), None, None
        if self.odometers is not None:
            self.odometers.move(stamp, seen.vehicles.position.item(0) + self.half)
            if self.setup.supervised_at(stamp):
                odometry = self.odometers.observe(stamp, seen.vehicles.velocity.item(0))
                protection = ProtectionState(stamp, ACTIVE[self.protection.level].copy())
        changed = self.protection.level is not self.reported
        self.reported = self.protection.level
        changed |= self.outage_changed
        self.outage_changed = False
        reported = self.inputs.report_due(stamp) or taken or changed
        truth = self._truth(stamp, seen, self.diagnostic(taken) if reported else None)
        report = None if self.reports is None or odometry is None else self.reports.message(odometry)
        ahead = None if self.radio is None or odometry is None else self.radio.newest(stamp)
        return PlantMessages(*truth, report, ahead, odometry, protection, seen.measurement)

    def request(self, intervention: interventions.Intervention) -> None:
        """Add an intervention; it acts from the next observation on, which reports it.

        Raises
        ------
        ValueError
            If it is impossible now or for this run.
        """
        self.interventions.request(self.stamp, intervention, speed=self._speed, standstill=self.standstill)

    def report_outage(self, lost: str, restarts: dict[str, int] | None = None) -> None:
        """Report begin or end of an outage at the next observation: nodes with the reason, and numbers of restarts."""
        self.lost, self.restarts = lost, self.restarts if restarts is None else restarts
        self.outage_changed = True

    @property
    def _speed(self) -> float:
        """Maximum speed of all vehicles [m/s]."""
        return float(np.abs(self.train.velocity).max())

    @property
    def standstill(self) -> bool:
        """True if every vehicle is at standstill."""
        return self._speed < STANDSTILL

    def conclude(self) -> PlantTruth:
        """Return the state after the last tick.

        Raises
        ------
        ValueError
            If it is not finite; a run without a log has no other check of it.
        """
        seen = self.train.observe()
        if not np.isfinite(seen.vehicles.position).all():
            raise ValueError("the position of the train is not finite; shorten step, or mend masses and draft gears")
        return PlantTruth(*self._truth(self.stamp, seen, self.diagnostic()))

    def _truth(self, stamp: int, seen: Observation, diagnostics: Diagnostic | None) -> Truth:
        """Return the messages of :class:`PlantTruth`; None for a missing air brake and without disturbances."""
        return (
            Tick(stamp),
            seen.vehicles,
            seen.brake_pipe,
            seen.brake_pipe_tail,
            seen.brake_shoes,
            Disturbance(stamp, self.train.outside_force) if self.setup.layout.disturbed else None,
            diagnostics,
        )

    def _receive(self, command: Command | None, pipe: Pipe | None, release: BrakeRelease | None) -> float | None:
        """Take the messages of this tick; return the pressure demanded at the head [Pa], None for the present one."""
        stamp, ends, layout = self.stamp, self.inputs.ends, self.setup.layout
        if layout.supervised:
            released = ends["atp/brake_release"].receive(stamp, release)
            if ends["atp/brake_release"].fresh:
                self.protection.on_release(released, stamp)
        forces = ends["ato/command"].receive(stamp, command)
        pressure: Any = ends["ato/brake_pipe_command"].receive(stamp, pipe) if layout.air_brake else None
        if ends["ato/command"].fresh:
            self.link.push(stamp, forces.force)
            piped = forces.stamp if not layout.air_brake else 0 if pressure is None else pressure.stamp
            self.protection.on_command(min(forces.stamp, piped), stamp)
        if not (layout.air_brake and ends["ato/brake_pipe_command"].fresh):
            return None
        if self.pipe_link is None:
            return float(pressure.pressure)
        self.pipe_link.push(stamp, (pressure.pressure,))
        return float(self.pipe_link.pop(stamp)[0])

    def act(
        self, command: Command | None = None, pipe: Pipe | None = None, release: BrakeRelease | None = None
    ) -> None:
        """Integrate to t_k+1 with the arrived commands, or with the fail-safe reaction in their place.

        The command has the stamp t_k, None without a new one (without lockstep only); the brake release comes at a step
        of the supervisor.  The emergency brake has a path of its own; the electric brake of locomotives acts beside it
        and counts nowhere.
        """
        pressure = self._receive(command, pipe, release)
        stamp, protection, parted = self.stamp, self.protection, self.train.parted
        demand: Array = self.link.window(stamp, self._substeps)
        before = protection.level
        level = protection.step(
            stamp,
            standstill=protection.awaits_standstill and self.standstill,
            separated=parted.since is not None and parted.noticed(self.train.time),
        )
        if level is not Protection.NONE:
            pressure = self._brake(level, demand, pressure)
        if level is not before:
            if level is Protection.EMERGENCY_BRAKE:
                self.train.apply_emergency_brake()
            elif before is Protection.EMERGENCY_BRAKE:
                self.train.release_emergency_brake()
        self.train.advance(demand, pressure)
        self.tick, self.stamp = self.tick + 1, stamp + self._tick_ns

    def _brake(self, level: Protection, demand: Array, pressure: float | None) -> float | None:
        """Put a reaction in place of the demand; return the pressure demanded at the head [Pa], None for no change."""
        brake = self.setup.consist.air_brake
        demand[:] = 0.0
        if level is Protection.SERVICE_BRAKE or (level is Protection.EMERGENCY_BRAKE and brake is not None):
            demand[:] = self._service_brake.demand(self.train.velocity[list(self.train.units)])
        if level is Protection.SERVICE_BRAKE and brake is not None:
            return brake.charged - brake.reduction[-1]
        return None if level is Protection.EMERGENCY_BRAKE else pressure

    def diagnostic(self, taken: Sequence[interventions.Intervention] = ()) -> Diagnostic:
        """Return the running totals of the plant as text, with the interventions at this stamp."""
        return self.diagnostic_at(self.stamp, self.train.totals.numbers, taken)

    def diagnostic_at(
        self, stamp: int, totals: Mapping[str, float], taken: Sequence[interventions.Intervention] = ()
    ) -> Diagnostic:
        """Return the diagnostics of a stamp with the totals up to it by name."""
        values = {key: repr(totals[name]) for key, name in TOTALS}
        values["commands_lost"] = str(self.link.lost)
        values |= self.inputs.diagnostics()
        if taken:
            values[interventions.KEY] = interventions.interventions_to_json(taken)
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
