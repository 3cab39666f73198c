"""The plant: a train on a line, advanced tick by tick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant_sim import kernel as k
from plant_sim.air_brake import PipeEvents
from plant_sim.compiled import results_are_kept
from plant_sim.consist import Consist
from plant_sim.disturbances import Gust
from plant_sim.jumps import Jumps
from plant_sim.line import Line
from plant_sim.outside_forces import OutsideForces
from plant_sim.packing import pack
from plant_sim.plant_setup import PlantSetup
from plant_sim.sensors import SensorSet
from plant_sim.states import Array, BrakeCylinders, CarStates, Measurement, Pipe
from plant_sim.streams import stream
from plant_sim.totals import Totals, kinetic_energy, totals_of


@dataclass(frozen=True, slots=True)
class Observation:
    """All the plant tells at one stamp; the brake parts are None without an air brake."""

    cars: CarStates
    measurement: Measurement
    brake_pipe: Pipe | None
    brake_cylinders: BrakeCylinders | None


class Train:
    """A multi-mass train on a line.

    Parameters
    ----------
    consist, line, setup
        The data; what they say about mismatch, disturbances and jumps is applied here.
    step_ns, tick_ns : int
        Plant step and tick [ns]; the tick is a multiple of the step.
    seed : int
        Of all random numbers.

    Attributes
    ----------
    n : int
        Vehicles.
    units : tuple of int
        Vehicles that are power units, front first.
    sensors : tuple of int
        Vehicles with a coupler sensor behind them.
    substeps : int
        Plant steps per tick.
    stamp : int
        Time of the present state [ns since the start].

    Raises
    ------
    ValueError
        If steps, setup and train do not fit.
    """

    def __init__(
        self, consist: Consist, line: Line, setup: PlantSetup, step_ns: int, tick_ns: int, seed: int = 0
    ) -> None:
        if step_ns <= 0 or tick_ns <= 0 or tick_ns % step_ns:
            raise ValueError(f"tick {tick_ns} ns must be a positive multiple of the plant step {step_ns} ns")
        self.consist, self.line, self.setup = consist, line, setup
        self.n = len(consist.vehicles)
        self.units = consist.power_units
        self.sensors = setup.sensors.couplers
        self.step_ns, self.tick_ns, self.substeps = step_ns, tick_ns, tick_ns // step_ns
        self.stamp = 0
        self._step = step_ns * 1e-9
        self.arrays = pack(consist, line, setup, self._step)
        self._unit_vehicles = np.array(self.units, dtype=np.int64)
        self._events = None if consist.air_brake is None else PipeEvents(consist.air_brake, self.n)
        self._no_events = np.zeros((5, 1))
        self._sensors = SensorSet(setup.sensors, len(self.units), self.n, tick_ns * 1e-9, seed)
        sources = [stream(seed, f"disturbance/{i}") for i in range(len(setup.disturbances))]
        masses = self.arrays.vehicle[k.MASS]
        self._outside = OutsideForces(setup.disturbances, masses, self._step, tick_ns * 1e-9, sources)
        self.arrays.setting[k.HAS_DRIFT] = float(self._outside.has_drift)
        if self._outside.has_drift and len(self.arrays.body) - 1 < self.n:
            raise ValueError("drift speeds (disturbance 'paper002') cannot act on rigidly joined vehicles")
        self._jumps = Jumps(setup, consist, self.arrays, step_ns, tick_ns)
        self._kinetic_start = self.kinetic_energy
        self._outside_force = np.zeros(self.n)
        self._gusts = False

    @property
    def time(self) -> float:
        """Time of the present state [s]."""
        return self.stamp * 1e-9

    @property
    def position(self) -> Array:
        """Centre of every vehicle [m], shape (n,)."""
        return self.arrays.state[k.X, : self.n].copy()

    @property
    def velocity(self) -> Array:
        """Speed of every vehicle [m/s], shape (n,)."""
        return self.arrays.state[k.V, : self.n].copy()

    @property
    def coupler_force(self) -> Array:
        """Force behind every vehicle [N], shape (n,); the last is 0."""
        force = np.zeros(self.n)
        force[:-1] = self.arrays.state[k.COUPLER, 1 : self.n]
        return force

    @property
    def applied(self) -> Array:
        """Force that acts on every power unit after delay, lag and limit [N]."""
        return np.array(self.arrays.unit[k.APPLIED])

    @property
    def shoe_force(self) -> Array:
        """Shoe force of every vehicle [N], >= 0."""
        return self.arrays.state[k.SHOE_FORCE, : self.n].copy()

    @property
    def outside_force(self) -> Array:
        """Mean force of all disturbances but grades on every vehicle over the last tick [N], without drift."""
        return self._outside_force.copy()

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy, rotating masses included [J]."""
        return kinetic_energy(self.arrays, self.n)

    @property
    def momentum(self) -> float:
        """Momentum, rotating masses included [kg m/s]."""
        return float((self.arrays.vehicle[k.MASS] * self.arrays.state[k.V, : self.n]).sum())

    def observe(self) -> Observation:
        """Return truth and measurement at the present stamp.  Draws sensor noise: call it once a tick."""
        x, v, coupler = self.position, self.velocity, self.coupler_force
        i = self._sensors.couplers
        deflection = x[i] - x[i + 1] - self.arrays.vehicle[k.GAP, i] if len(i) else np.zeros(0)
        rate = v[i] - v[i + 1] if len(i) else np.zeros(0)
        measured = self._sensors.measure(
            self.stamp,
            x[self._unit_vehicles],
            v[self._unit_vehicles],
            self.applied,
            (deflection, rate, coupler[i] if len(i) else np.zeros(0)),
        )
        pipe = None if self._events is None else Pipe(self.stamp, self._events.pressure)
        cylinders = None if self._events is None else BrakeCylinders(self.stamp, self.shoe_force)
        return Observation(CarStates(self.stamp, x, v, coupler), measured, pipe, cylinders)

    def advance(self, demand: Array, brake_pipe_pa: float | None = None) -> None:
        """Integrate one tick.

        Parameters
        ----------
        demand : Array, shape (substeps, units)
            Force commands that are due at every plant step [N].
        brake_pipe_pa : float, optional
            Pressure demanded at the head from now on [Pa, absolute]; None leaves it.

        Raises
        ------
        ValueError
            If the shape is wrong, a command is not finite, or a brake pressure is demanded of a train without an air
            brake.
        """
        demand = np.ascontiguousarray(demand, dtype=np.float64)
        if demand.shape != (self.substeps, len(self.units)):
            raise ValueError(f"demand has the shape {demand.shape}, needed is {(self.substeps, len(self.units))}")
        if not np.isfinite(demand).all():
            raise ValueError(f"demand at {self.time:.3f} s is not finite: the law that sent it is at fault")
        if brake_pipe_pa is not None:
            if self._events is None:
                raise ValueError(f"a brake-pipe pressure is demanded, the train '{self.consist.name}' has no air brake")
            self._events.demand(self.time, brake_pipe_pa)
        if self._gusts:
            self._drop_gusts()
        outside = self._outside.tick(self.time)
        begin = 0
        for step in self._jumps.steps(self.stamp):
            self._integrate(demand, outside, begin, step)
            begin = step
            self._jumps.apply(self.stamp, begin)
        self._integrate(demand, outside, begin, self.substeps)
        self._keep_outside(outside)
        self.stamp += self.tick_ns

    def blow(self, gust: Gust) -> None:
        """Let a gust act that the setup does not have, from the next tick on.

        Raises
        ------
        ValueError
            If it lists a vehicle that the train does not have.
        """
        self._outside.add(gust)
        self._gusts = True

    def _drop_gusts(self) -> None:
        """Forget gusts that are over; what they left on vehicles that nothing pushes any more is taken off."""
        if self._outside.drop_over(self.time):
            self.arrays.state[k.PUSH] = 0.0
            self._outside_force[:] = 0.0
            self._gusts = self._outside.gusty

    def vent(self) -> None:
        """Vent the brake pipe at the head from now on; a train without an air brake has nothing to vent."""
        if self._events is not None:
            self._events.vent(self.time)

    def _integrate(self, demand: Array, outside: Array, begin: int, end: int) -> None:
        if end <= begin:
            return
        a = self.arrays
        whole = begin == 0 and end == self.substeps
        events = 0 if self._events is None else self._events.under_way()
        k.advance(
            (self.stamp + begin * self.step_ns) * 1e-9, self._step, a.state, a.vehicle, a.vehicle_index, a.gear,
            a.table, a.run, a.body, a.unit, a.unit_index, a.envelope, a.piece,
            self._no_events if self._events is None else self._events.array, events, demand[begin:end],
            outside if whole else np.ascontiguousarray(outside[:, begin:end]), self._outside.vehicles, a.setting,
        )  # fmt: skip

    def _keep_outside(self, outside: Array) -> None:
        listed = self._outside.vehicles
        if len(listed):
            speed = self.arrays.state[k.V, listed]
            self._outside_force[listed] = outside[0].mean(axis=0) + outside[1].mean(axis=0) * speed

    @property
    def totals(self) -> Totals:
        """Extremes and works since the start."""
        return totals_of(self.arrays, self.n, self.kinetic_energy - self._kinetic_start, self._jumps.energy)


def compile_kernel() -> bool:
    """Run one step of a two-vehicle train, so that the compiled kernel is loaded; return whether it had to compile.

    The first time on a machine this takes some seconds; :mod:`plant_sim.compiled` says where the result is kept.
    """
    consist = Consist.model_validate(
        {
            "schema": "train_ato/consist/1",
            "name": "warm-up",
            "vehicle_types": {"car": {"mass": 1e5, "length": 10.0, "resistance": {"n": (1e3, 0.0, 0.0)}}},
            "train": ({"type": "car", "count": 2},),
            "draft_gears": {"spring": {"kind": "linear", "stiffness": 1e6}},
            "default_gear": "spring",
        }
    )
    line = Line.model_validate({"schema": "train_ato/line/1", "name": "level", "end": 1000.0})
    Train(consist, line, PlantSetup(), 1_000_000, 1_000_000).advance(np.zeros((1, 0)))
    stats = getattr(k.advance, "stats", None)  # none where NUMBA_DISABLE_JIT leaves the function as it is
    return stats is not None and (not results_are_kept() or bool(sum(stats.cache_misses.values())))
