"""Changes of train parameters and parting of couplers during a run, each once at a time or at a position."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plant_sim import kernel as k
from plant_sim.air_brake import BrakeEvents
from plant_sim.consist import Consist
from plant_sim.input_error import one_of
from plant_sim.packing import NO_LIMIT, Arrays, lag_decay
from plant_sim.plant_setup import Jump, PlantSetup, TrainSeparation
from plant_sim.states import Array
from plant_sim.totals import kinetic_energy


class PartedCouplers:
    """Couplers of a train that have parted.

    A parted coupler transmits no force for the rest of the run, in draft or in buff; a later contact of the parts is
    not modelled. The brake pipe is open at the gap: the wave of an application runs from there through both parts, and
    nothing can release it. On a train without air brake the emergency loop is open. The traction of a power unit is cut
    off when the wave has reached it.

    Parameters
    ----------
    consist, arrays
        Data and arrays of the train.
    brake
        Events of its brake pipe or of its emergency loop.

    Attributes
    ----------
    since : float or None
        Time of the first parting [s]; None before it.

    Raises
    ------
    ValueError
        From :meth:`check`, for a vehicle without a coupler that can part behind it.
    """

    def __init__(self, consist: Consist, arrays: Arrays, brake: BrakeEvents) -> None:
        self._arrays, self._brake = arrays, brake
        self._offsets: Array = np.array(consist.offsets)
        self._gaps: Array = (self._offsets + np.array([vehicle.length / 2 for vehicle in consist.vehicles]))[:-1]
        self._units = np.array(consist.power_units, dtype=np.int64)
        self.since: float | None = None

    def check(self, couplers: Sequence[int]) -> None:
        """Raise ValueError if the couplers behind these vehicles are missing or rigid."""
        rigid = [range(first, end) for first, end, kind, _ in self._arrays.run if kind == k.RIGID]
        for coupler in couplers:
            if not 0 <= coupler < len(self._gaps):
                there = one_of(len(self._gaps)) if len(self._gaps) else "the train is one vehicle; remove it"
                raise ValueError(f"jumps: no coupler is behind vehicle {coupler}; {there}")
            if any(coupler in run for run in rigid):
                raise ValueError(f"jumps: the coupler behind vehicle {coupler} is rigid; list one with a draft gear")

    def part(self, couplers: Sequence[int], time: float) -> None:
        """Part the couplers behind some vehicles at a time [s]."""
        a, parted = self._arrays, list(couplers)
        a.gear[k.HALF_SLACK, parted] = NO_LIMIT
        a.run[:, k.EQUAL] = 0
        distance = np.abs(self._offsets[:, None] - self._gaps[parted][None, :]).min(axis=1)
        if self.since is None:
            self.since = time
        else:  # the distance from a later gap, as if its wave had started with the first one
            later = distance + (time - self.since) * self._brake.apply_wave
            distance = np.minimum(a.vehicle[k.PARTED_DISTANCE], later)
        a.vehicle[k.PARTED_DISTANCE] = distance
        a.vehicle_index[k.PARTED_ORDER] = np.argsort(distance, kind="stable")
        self._brake.part(time)

    def reached(self, time: float) -> NDArray[np.bool_]:
        """Return True for every vehicle that the wave from a gap has reached at a time [s], shape (n,)."""
        assert self.since is not None
        arrival = self.since + self._arrays.vehicle[k.PARTED_DISTANCE] / self._brake.apply_wave
        return np.asarray(time >= arrival)

    def noticed(self, time: float) -> bool:
        """Return True if the wave from a gap has reached the first vehicle at a time [s]."""
        return bool(self.reached(time)[0])

    def without_traction(self, time: float, demand: Array) -> Array:
        """Return the demands [N] of shape (steps, units), 0 for units that the wave has reached."""
        return np.ascontiguousarray(np.where(self.reached(time)[self._units], 0.0, demand))


class Jumps:
    """Jumps of a setup, applied to the arrays of the kernel.

    Parameters
    ----------
    setup
        Jumps and lags of the actuators.
    consist, arrays
        Data and arrays of the train.
    couplers
        Couplers of the train that can part.
    step_ns, tick_ns : int
        Plant step and tick [ns].

    Attributes
    ----------
    energy : float
        Kinetic energy added by jumps of mass [J].

    Raises
    ------
    ValueError
        If a jump lists a vehicle or unit outside the train, a coupler that cannot part, or multiplies friction-brake
        forces of a train without any.
    """

    def __init__(
        self,
        setup: PlantSetup,
        consist: Consist,
        arrays: Arrays,
        couplers: PartedCouplers,
        *,
        step_ns: int,
        tick_ns: int,
    ) -> None:
        self.energy = 0.0
        self._arrays, self._couplers = arrays, couplers
        vehicles = len(consist.vehicles)
        self._vehicles, self._units = vehicles, arrays.unit.shape[1]
        self._unit_vehicles = np.array(consist.power_units, dtype=np.int64)
        self._by_mass = np.array([vehicle.resistance.n is None for vehicle in consist.vehicles])
        self._step_ns, self._substeps = step_ns, tick_ns // step_ns
        self._lags = np.broadcast_to(np.array(setup.lag, dtype=np.float64), self._units).copy()
        self._adhesive = setup.adhesion is not None
        self.planned: list[Jump | TrainSeparation] = []
        for jump in setup.jumps:
            self.add(jump)

    def add(self, jump: Jump | TrainSeparation) -> None:
        """Add a jump; errors as at the start, also for a jump of adhesion without an adhesion."""
        if isinstance(jump, TrainSeparation):
            self._couplers.check(jump.vehicles)
        else:
            self._check(jump)
        self.planned.append(jump)

    def _check(self, jump: Jump) -> None:
        for what, listed, count in (("vehicle", jump.vehicles, self._vehicles), ("unit", jump.units, self._units)):
            wrong = [i for i in listed or () if not 0 <= i < count]
            if wrong:
                raise ValueError(f"jumps lists {what} {wrong[0]}: not in the train; {one_of(count)}")
        if jump.what == "brake" and not self._arrays.vehicle[k.SHOE].any():
            raise ValueError("a jump of brake multiplies the shoe forces, but no vehicle has shoes; remove it")
        if jump.what == "adhesion" and not self._adhesive:
            raise ValueError("a jump of adhesion multiplies the adhesion, which is missing; give an adhesion")

    def steps(self, stamp: int) -> list[int]:
        """Return the plant steps with a jump due before them, in the tick that begins at ``stamp`` [ns]."""
        steps = set()
        for jump in self.planned:
            if jump.at is None:
                if self._passed(jump):
                    steps.add(0)
            else:
                step = max(0, -(-(round(jump.at * 1e9) - stamp) // self._step_ns))
                if step < self._substeps:
                    steps.add(step)
        return sorted(steps)

    def apply(self, stamp: int, step: int) -> None:
        """Apply the jumps that are due before a plant step of the tick from ``stamp`` [ns] on."""
        now = stamp + step * self._step_ns
        for jump in list(self.planned):
            due = step == 0 and self._passed(jump) if jump.at is None else round(jump.at * 1e9) <= now
            if due:
                self.planned.remove(jump)
                if isinstance(jump, TrainSeparation):
                    self._couplers.part(jump.vehicles, now * 1e-9)
                    continue
                before = kinetic_energy(self._arrays, self._vehicles)
                self._jump(jump)
                self.energy += kinetic_energy(self._arrays, self._vehicles) - before

    def _passed(self, jump: Jump | TrainSeparation) -> bool:
        return jump.place is not None and bool(self._arrays.state[k.X, 0] >= jump.place)

    def _jump(self, jump: Jump) -> None:
        a = self._arrays
        vehicles = list(range(self._vehicles)) if jump.vehicles is None else list(jump.vehicles)
        units = list(range(self._units)) if jump.units is None else list(jump.units)
        if jump.what == "mass":
            a.vehicle[np.ix_((k.MASS, k.WEIGHT, k.HOLD_CAPACITY), vehicles)] *= jump.factor
            scaled = [i for i in vehicles if self._by_mass[i]]
            a.vehicle[np.ix_(np.array([k.C0, k.C1, k.C2]), np.array(scaled, dtype=np.int64))] *= jump.factor
            a.unit[k.ADHESION_WEIGHT, np.isin(self._unit_vehicles, vehicles)] *= jump.factor
            a.vehicle[k.INVERSE_MASS] = 1.0 / a.vehicle[k.MASS]
            k.locate(a.state, a.vehicle, a.vehicle_index, a.piece)
        elif jump.what == "resistance":
            a.vehicle[np.ix_((k.C0, k.C1, k.C2), vehicles)] *= jump.factor
        elif jump.what == "brake":
            a.vehicle[k.SHOE, vehicles] *= jump.factor
        elif jump.what == "gain":
            a.unit[k.GAIN, units] *= jump.factor
        elif jump.what == "adhesion":
            a.unit[k.ADHESION, units] *= jump.factor
            a.vehicle[k.RAIL, slice(None) if jump.units is None else self._unit_vehicles[units]] *= jump.factor
        else:
            self._lags[units] *= jump.factor
            a.unit[k.LAG_DECAY] = lag_decay(self._lags, self._step_ns * 1e-9)
