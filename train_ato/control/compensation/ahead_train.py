"""Simulated train of the twin: the nominal train on its own clock, ahead of the real one, held to the profile.

Its force is the feed-forward of `twin.py`, which has the equations. The twin corrects the errors of the model here.

Copy of the simulated train of the twin with worn draft gears, for the effect of wear on the measured speed.

The copy has the force of the twin, the same brake pipe, and draft gears with ``WEAR_STEP`` more wear. The waves of its
couplers move its units against the units of the twin, as in a real train with these gears. A slow loop ties its units
to the units of the twin, so that the copy does not drift away along the grades::

    dF = -M (SPEED_GAIN dv + POSITION_GAIN dx)

To first order in the wear, a train with the force F of the twin plus dF has the speed of the twin plus dv. dF and dv
over ``WEAR_STEP`` are therefore the sensitivities of force and speed.

Draft gears of a train with wear as one number, 0 for the gears of the model.

Wear softens the springs and smooths the friction surfaces of a draft gear, and it adds slack between gear and coupler.
Here all of these change by the same part ``wear``::

    F0, a1: times 1 - wear;   slack, unloading ratio r: times 1 + wear

The force at the stroke, that of the closed gear, stays. A negative wear is a stiffer gear with more friction and less
slack than the model has.
"""

from dataclasses import dataclass
from operator import add

import numpy as np

from plant_sim import kernel as k
from plant_sim.elementary import mean_over_units, total_of_units
from plant_sim.gears import DraftGear, LinearGear, RigidGear, TableGear
from plant_sim.packing import pack_gears
from plant_sim.plant_setup import Jump, PlantSetup
from plant_sim.train import Train
from train_ato.control.air_brake.record_policy import BrakePolicy
from train_ato.control.algorithms.train_identification import WEAR
from train_ato.control.compensation.preview import PreviewParameters
from train_ato.control.contract import ProfileLike, flag, parameter
from train_ato.control.train_model import TrainModel


def nominal_copy(model: TrainModel, profile: ProfileLike, t: float, period: float, step: float) -> Train:
    """Return a train on the profile, couplers unstretched, with ideal actuators.

    Parameters
    ----------
    model
        The nominal train and line.
    profile
        Profile that gives position and speed.
    t
        Time of the initial state on the profile [s].
    period
        Period of the commands [s].
    step
        Smallest integration step [s]; the step used is the next longer one that divides the period.
    """
    place, speed, _, _ = profile.at(t)
    tick_ns = round(period * 1e9)
    most = max(1, round(period / step))
    step_ns = next(tick_ns // count for count in range(most, 0, -1) if tick_ns % count == 0)
    setup = PlantSetup.model_validate({"start": {"position": place, "speed": speed}})
    return Train(model.consist, model.line, setup, step_ns=step_ns, tick_ns=tick_ns)


CONSTANTS = (k.HALF_SLACK, k.STIFFNESS, k.F0, k.A1, k.A2, k.RATIO)
"""Rows of the draft gears of the kernel that wear changes."""


def worn(gear: DraftGear, wear: float) -> DraftGear:
    """Return a draft gear with wear; a rigid coupler has none.

    Parameters
    ----------
    gear
        Gear of the model.
    wear
        Relative change, above -1 and below 1.
    """
    if isinstance(gear, RigidGear):
        return gear
    changes: dict[str, object] = {"slack": gear.slack * (1.0 + wear)}
    if isinstance(gear, TableGear):
        return gear.model_copy(update=changes)
    changes["stiffness"] = gear.stiffness * (1.0 - wear)
    if not isinstance(gear, LinearGear):
        changes["preload"] = gear.preload * (1.0 - wear)
        changes["unloading_ratio"] = min(gear.unloading_ratio * (1.0 + wear), 1.0)
    return gear.model_copy(update=changes)


WEAR_STEP = 0.1
"""Wear of the draft gears of the copy beyond that of the twin."""
SPEED_GAIN, POSITION_GAIN = 0.1, 0.0025
"""Gains of the loop between copy and twin [1/s, 1/s²]: .05 rad/s, well below the first coupler mode of a long train."""


def set_wear(train: Train, wear: float) -> None:
    """Give a simulated train draft gears with wear, from its next step on."""
    consist = train.consist
    kinds = list(dict.fromkeys(consist.gear_names))  # packed once each: a long train has two or three
    gears, _, _, _ = pack_gears([worn(consist.draft_gears[name], wear) for name in kinds], len(kinds) + 1)
    columns = [kinds.index(name) for name in consist.gear_names]
    train.arrays.gear[list(CONSTANTS), : len(columns)] = gears[list(CONSTANTS)][:, columns]


class WornCopy:
    """Copy of the train of the twin with worn draft gears.

    Parameters
    ----------
    model
        The nominal train.
    profile
        Profile that gives the initial state.
    start
        Time of the initial state [s].
    period
        Control period of the twin [s].
    step
        Integration step of the twin [s].
    """

    def __init__(self, model: TrainModel, profile: ProfileLike, start: float, period: float, step: float) -> None:
        self.train = nominal_copy(model, profile, start, period, step)
        self._model = model
        self._share = model.share.tolist()
        self._demand = np.zeros((self.train.substeps, model.n_units))
        set_wear(self.train, WEAR_STEP)

    def step(self, twin: Train, places: list[float], speeds: list[float], pressure: float | None) -> list[float]:
        """Advance by a control period, after the twin.

        Parameters
        ----------
        twin
            Train of the twin at the end of the period.
        places, speeds
            Positions [m] and speeds [m/s] of its units at the begin of the period.
        pressure
            Pressure demanded at the head of the brake pipe [Pa]; None keeps the present one.

        Returns
        -------
        list of float
            Changes of the total force [N] and of the mean speed of the units [m/s] by a wear of 1, over the period and
            at its begin.
        """
        units, position, velocity = self._model.units, self.train.position, self.train.velocity
        far = mean_over_units(self._share, [position.item(i) - x for i, x in zip(units, places, strict=True)])
        fast = mean_over_units(self._share, [velocity.item(i) - v for i, v in zip(units, speeds, strict=True)])
        pull = -self._model.inertia * (SPEED_GAIN * fast + POSITION_GAIN * far)
        force = twin.applied
        self._demand[:] = force + pull * self._model.share
        self.train.advance(self._demand, pressure)
        change = total_of_units(self.train.applied) - total_of_units(force)
        return [change / WEAR_STEP, fast / WEAR_STEP]


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
    identify: bool = flag("estimate mass, resistance, air brake and draft gears", default=False)


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

    Attributes
    ----------
    window : tuple of int
        First control step in use, and the one behind the last: an earlier window is a return to the state then.
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
        self._forces: list[list[float]] = []
        self._kept = 0
        self.window = 0, 0
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
            set_wear(self._worn.train, errors[WEAR] + WEAR_STEP)
        self.errors = errors

    def by_wear(self, t: float) -> tuple[float, float]:
        """Return the changes of total force [N] and mean speed of the units [m/s] by a wear of 1, at a time [s]."""
        n_units = self._model.n_units
        return self.force(n_units, t), self.force(n_units + 1, t)

    def forget(self) -> None:
        """Drop the forces before the window."""
        del self._forces[: self.window[0] - self._kept]
        self._kept = self.window[0]

    def run(self, until: float, keep_from: float) -> None:
        """Move the window over the forces from ``keep_from`` to ``until`` [s], for which the train advances."""
        first, end = self.window
        while self._start + (end - 1) * self._period < until:
            if end - self._kept == len(self._forces):
                self._forces.append(self._step())
            end += 1
        while end - first > 2 and self._start + (first + 1) * self._period < keep_from:
            first += 1
        self.window = first, end

    def force(self, unit: int, t: float) -> float:
        """Return the force of a unit at a simulated time [N], linear between the control steps."""
        first, end = self.window
        place = (t - self._start) / self._period - first
        index = min(max(int(place), 0), end - first - 2)
        row = first - self._kept + index
        low, high = self._forces[row][unit], self._forces[row + 1][unit]
        return low + (place - index) * (high - low)

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
