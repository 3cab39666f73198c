"""Simulated train of the twin: the nominal train on its own clock, ahead of the real one, held to the profile.

Its force is the feed-forward of `twin.py`, which has the equations. The twin corrects the errors of the model here.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from operator import add
from typing import TYPE_CHECKING

import numpy as np

from plant_sim.plant_setup import Jump
from train_ato.control.algorithms.force_shares import total_of_units
from train_ato.control.algorithms.train_identification import WEAR
from train_ato.control.compensation.nominal_train import nominal_copy
from train_ato.control.compensation.preview import PreviewParameters
from train_ato.control.compensation.worn_copy import WornCopy, set_wear
from train_ato.control.contract import parameter

if TYPE_CHECKING:
    from train_ato.control.air_brake.record_policy import BrakePolicy
    from train_ato.control.compensation.rigid import ProfileLike
    from train_ato.control.train_model import TrainModel

L1, L2 = 1.0, 0.25
"""Gains of the twin on its speed and position error [1/s, 1/s²]."""
YIELD = 0.01
"""Part of the coupler forces that the units of the twin do not compensate.

A unit with exactly the speed of the profile is a fixed end for the waves in its train, which draft gears within their
hysteresis damp little: a wave of 88 kN lasted for minutes, with a period of 20 s, that of the quarter wave of 105
wagons.  A unit that yields to the coupler force F by ``YIELD F / (m L1)`` reflects the part (1 - r) / (1 + r) of a
wave, with r = YIELD Z / (m L1) and the wave impedance Z = sqrt(stiffness times mass of a wagon), 2.4 MN s/m: 0.8.
"""


@dataclass(frozen=True)
class TwinParameters(PreviewParameters):
    """Parameters of the compensation `twin`."""

    period: float = parameter(0.05, "s", 0.001, 1.0, "control period of the twin")
    step: float = parameter(0.005, "s", 1e-4, 0.1, "integration step of the twin")
    identify: bool = parameter(False, "", 0, 1, "estimate mass, resistance, air brake and draft gears")


class AheadTrain:
    """Nominal train that follows the profile on its own clock.

    Parameters
    ----------
    model
        The nominal train.
    profile
        Profile to follow.
    parameters
        Control period and integration step.
    policy
        Policy of the air brake, not shared; None without one.
    start
        Time of the initial state [s].
    """

    def __init__(
        self,
        model: TrainModel,
        profile: ProfileLike,
        parameters: TwinParameters,
        policy: BrakePolicy | None,
        start: float,
    ) -> None:
        self.profile = profile
        self._model = model
        self._policy = policy if model.consist.air_brake is not None else None
        self._train = nominal_copy(model, profile, start, parameters.period, parameters.step)
        self._period = round(parameters.period * 1e9) * 1e-9
        self._start = start
        self._inertia, self._offsets = model.unit_inertia.tolist(), model.offsets.tolist()
        self._demand = np.zeros((self._train.substeps, model.n_units))
        self._forces: deque[list[float]] = deque()
        self._first = 0
        self._computed: deque[list[float]] = deque()
        self._made: list[list[float]] = []
        self._marks: list[tuple[int, int]] = []
        self.errors = [0.0, 0.0, 0.0, 0.0]
        self._worn: WornCopy | None = None
        if parameters.identify:
            self._worn = WornCopy(model, profile, start, parameters.period, parameters.step)

    def correct(self, errors: list[float]) -> None:
        """Set the relative errors of mass, resistance and air brake of the model and the wear from now on."""
        mass, resistance, brake = (
            (1.0 + now) / (1.0 + before) for now, before in zip(errors[:WEAR], self.errors[:WEAR], strict=True)
        )
        by_mass = [vehicle.resistance.n is None for vehicle in self._model.consist.vehicles]
        weighed = tuple(i for i, scaled in enumerate(by_mass) if scaled)
        others = tuple(i for i, scaled in enumerate(by_mass) if not scaled)
        jumps = [("mass", mass, None), ("resistance", resistance / mass, weighed), ("resistance", resistance, others)]
        if self._model.consist.air_brake is not None:
            jumps.append(("brake", brake, None))
        trains = [self._train] if self._worn is None else [self._train, self._worn.train]
        for what, factor, vehicles in jumps:
            if vehicles != ():
                for train in trains:
                    train.add_jump(Jump(at=train.time, what=what, factor=factor, vehicles=vehicles))
        set_wear(self._train, errors[WEAR])
        if self._worn is not None:
            self._worn.set_wear(errors[WEAR])
        self.errors = errors

    def by_wear(self, t: float) -> tuple[float, float]:
        """Return the changes of total force [N] and mean speed of the units [m/s] by a wear of 1, at a time [s]."""
        n_units = self._model.n_units
        return self.force(n_units, t), self.force(n_units + 1, t)

    def begin_record(self) -> None:
        """Begin a record of reads that :meth:`rewind` can undo."""
        self._made, self._marks = list(self._forces), []

    def mark(self) -> None:
        """Mark the state before a read."""
        self._marks.append((self._first, len(self._made)))

    def rewind(self, read: int) -> None:
        """Return to the state after a number of recorded reads; forces computed since then are used again."""
        marks, self._marks = self._marks, []
        if read < len(marks):
            first, made = marks[read]
            self._computed.extendleft(reversed(self._made[made:]))
            self._forces = deque(self._made[first - marks[0][0] : made])
            self._first = first

    def run(self, until: float, keep_from: float) -> None:
        """Advance the train until the forces up to ``until`` exist; drop those before ``keep_from`` [s]."""
        while self._start + (self._first + len(self._forces) - 1) * self._period < until:
            force = self._computed.popleft() if self._computed else self._step()
            self._forces.append(force)
            if self._marks:
                self._made.append(force)
        while len(self._forces) > 2 and self._start + (self._first + 1) * self._period < keep_from:
            self._forces.popleft()
            self._first += 1

    def force(self, unit: int, t: float) -> float:
        """Return the force of a unit at a simulated time [N], linear between the control steps."""
        place = (t - self._start) / self._period - self._first
        index = min(max(int(place), 0), len(self._forces) - 2)
        low = self._forces[index][unit]
        return low + (place - index) * (self._forces[index + 1][unit] - low)

    def _step(self) -> list[float]:
        train, model = self._train, self._model
        t = self._start + train.time
        pressure = None
        position, velocity = train.position, train.velocity
        if self._policy is not None:
            pressure = self._policy.step(t, float(position[0]), float(velocity[0]), total_of_units(train.applied))
        place, speed, _, _ = self.profile.at(t)
        _, _, pull, _ = self.profile.at(t + 0.5 * self._period)
        places, speeds = [position.item(i) for i in model.units], [velocity.item(i) for i in model.units]
        low, high = model.limits_of_units(speeds)
        sent = []
        for unit, against in enumerate(self._opposing(places, speeds)):
            error = places[unit] + self._offsets[unit] - place
            wanted = against + self._inertia[unit] * (pull - L1 * (speeds[unit] - speed) - L2 * error)
            sent.append(low[unit] if wanted < low[unit] else high[unit] if wanted > high[unit] else wanted)
        self._demand[:] = sent
        train.advance(self._demand, pressure)
        return sent if self._worn is None else sent + self._worn.step(train, places, speeds, pressure)

    def _opposing(self, places: list[float], speeds: list[float]) -> list[float]:
        """Return compensated coupler forces, shoe force and resistance against the motion of every unit [N]."""
        force, shoes, kept = self._train.coupler_force, self._train.shoe_force, 1.0 - YIELD
        # item -1 is 0 N
        outside = [kept * (force.item(i) - force.item(i - 1)) + shoes.item(i) for i in self._model.units]
        own = self._model.own_resistance(np.array(speeds), np.array(places))
        return list(map(add, outside, own.tolist()))
