"""Changes of train parameters and parting of couplers during a run, each once at a time or at a position."""

from __future__ import annotations

import numpy as np

from plant_sim import kernel as k
from plant_sim.consist import Consist
from plant_sim.input_error import one_of
from plant_sim.packing import Arrays, lag_decay
from plant_sim.parted_couplers import PartedCouplers
from plant_sim.plant_setup import Jump, PlantSetup, TrainSeparation
from plant_sim.totals import kinetic_energy


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
        self, setup: PlantSetup, consist: Consist, arrays: Arrays, couplers: PartedCouplers, step_ns: int, tick_ns: int
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
        self._waiting: list[Jump | TrainSeparation] = []
        for jump in setup.jumps:
            self.add(jump)

    def add(self, jump: Jump | TrainSeparation) -> None:
        """Add a jump; errors as at the start, also for a jump of adhesion without an adhesion."""
        if isinstance(jump, TrainSeparation):
            self._couplers.check(jump.vehicles)
        else:
            self._check(jump)
        self._waiting.append(jump)

    def _check(self, jump: Jump) -> None:
        for what, listed, count in (("vehicle", jump.vehicles, self._vehicles), ("unit", jump.units, self._units)):
            wrong = [i for i in listed or () if not 0 <= i < count]
            if wrong:
                raise ValueError(f"jumps lists {what} {wrong[0]}: not in the train; {one_of(count)}")
        if jump.what == "brake" and not self._arrays.vehicle[k.SHOE].any():
            raise ValueError("a jump of brake multiplies the shoe forces, but no vehicle has shoes; remove it")
        if jump.what == "adhesion" and not self._adhesive:
            raise ValueError("a jump of adhesion multiplies the adhesion, which is missing; give an adhesion")

    @property
    def waiting(self) -> bool:
        """True if a jump waits for its time or place."""
        return bool(self._waiting)

    def steps(self, stamp: int) -> list[int]:
        """Return the plant steps of the tick from ``stamp`` [ns] on before which jumps are due."""
        steps = set()
        for jump in self._waiting:
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
        for jump in list(self._waiting):
            due = step == 0 and self._passed(jump) if jump.at is None else round(jump.at * 1e9) <= now
            if due:
                self._waiting.remove(jump)
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
