"""Interventions on the train during a run: planned ones, requests, and their effect at the receiving end."""

from __future__ import annotations

import sys

from plant_sim.disturbances import Gust
from plant_sim.plant_setup import Jump
from plant_sim.train import Train
from train_ato.loop.inputs import StageInputs
from train_ato.loop.setup import RunSetup
from train_ato.loop.train_protection import TrainProtection
from train_ato.messages.faults import DropFault, FreezeFault
from train_ato.messages.links import DelayJump, Link
from train_ato.scenario.interventions import (
    DelayJumpNow,
    EmergencyBrakeNow,
    GustNow,
    Intervention,
    MessageLossNow,
    TrainJumpNow,
    due_stamp,
)

MAX_REQUESTS = {
    "gust": 10,
    "delay_jump": 100,
    "emergency_brake": 10,
    "message_loss": 10,
    "message_freeze": 10,
    "train_jump": 100,
}
"""Maximum number of requested interventions in force, by kind; their effects add up."""
LASTING = (DelayJumpNow, TrainJumpNow)
"""Kinds with an effect to the end of the run."""


class TrainInterventions:
    """Interventions that wait for their tick, and their effect.

    Parameters
    ----------
    setup
        Prepared run with the planned interventions.
    train, link, protection, inputs
        Train, delay line of the commands, fail-safe reactions and receiving ends of the plant.
    """

    def __init__(
        self, setup: RunSetup, train: Train, link: Link, protection: TrainProtection, inputs: StageInputs
    ) -> None:
        self._setup = setup
        self._train, self._link, self._protection, self._inputs = train, link, protection, inputs
        self._due = [(due_stamp(planned, setup.tick_ns), planned) for planned in setup.scenario.interventions]
        self._in_force: dict[str, list[int]] = {}

    @property
    def waiting(self) -> bool:
        """True if an intervention waits for its tick."""
        return bool(self._due)

    @property
    def due_stamps(self) -> list[int]:
        """Stamps of the waiting interventions [ns]."""
        return [at for at, _ in self._due]

    def request(self, stamp: int, intervention: Intervention, *, speed: float, standstill: bool) -> None:
        """Add an intervention that acts from a stamp [ns] on.

        Raises
        ------
        ValueError
            If it is impossible for this run, for a release of the emergency brake of a moving train, or with too many
            requests in force.
        """
        if _releases(intervention) and not standstill:
            text = f"{3.6 * speed:.1f} km/h"
            raise ValueError(f"the emergency brake is released at standstill only; the train runs {text}")
        self._setup.check_intervention(intervention)
        self._take_place(stamp, intervention)
        self._due.append((stamp, intervention))

    def _take_place(self, stamp: int, intervention: Intervention) -> None:
        """Count a request in force: to its end, a lasting one to the end of the run, others for one tick."""
        kind = intervention.do
        places = self._in_force[kind] = [end for end in self._in_force.get(kind, ()) if end > stamp]
        if len(places) >= MAX_REQUESTS[kind]:
            until = "" if isinstance(intervention, LASTING) else f"; repeat it after {min(places) * 1e-9:.1f} s"
            raise ValueError(f"{len(places)} requests of {kind} are in force, the maximum{until}")
        end = stamp + self._setup.tick_ns + round(getattr(intervention, "duration", 0.0) * 1e9)
        places.append(sys.maxsize if isinstance(intervention, LASTING) else end)

    def take(self, stamp: int, *, standstill: bool) -> list[Intervention]:
        """Apply and return the interventions due at a stamp [ns]; a planned release waits for standstill."""
        taken, left = [], []
        for at, intervention in self._due:
            if at > stamp or (_releases(intervention) and not standstill):
                left.append((at, intervention))
            else:
                taken.append(intervention)
        self._due = left
        for intervention in taken:
            self._apply(stamp / 1e9, intervention)
        return taken

    def _apply(self, now: float, intervention: Intervention) -> None:
        train = self._train
        if isinstance(intervention, GustNow):
            end, ramp = now + intervention.duration, intervention.ramp
            train.add_gust(Gust(kind="gust", begin=now, end=end, ramp=ramp, acceleration=intervention.acceleration))
        elif isinstance(intervention, DelayJumpNow):
            jump = DelayJump(at=now, factor=intervention.factor, add=intervention.add)
            self._link.jump(jump)
            self._protection.jump(jump)
        elif isinstance(intervention, EmergencyBrakeNow):
            self._protection.requested = intervention.applied
        elif isinstance(intervention, TrainJumpNow):
            train.add_jump(Jump(at=now, what=intervention.what, factor=intervention.factor))
        elif isinstance(intervention, MessageLossNow):
            self._inputs.add(DropFault(topic=intervention.topic, begin=now, end=now + intervention.duration))
        elif intervention.topic == "train/measurement":
            train.freeze_measurement(now, now + intervention.duration)
        else:
            self._inputs.add(FreezeFault(topic=intervention.topic, begin=now, end=now + intervention.duration))


def _releases(intervention: Intervention) -> bool:
    return isinstance(intervention, EmergencyBrakeNow) and not intervention.applied
