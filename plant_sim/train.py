"""Plant: a train on a line, integrated tick by tick."""

import math

import numpy as np

from plant_sim import kernel as k
from plant_sim.air_brake import PipeEvents, PipePressure, friction_brake_events
from plant_sim.consist import Consist
from plant_sim.disturbances import OutsideForces
from plant_sim.elementary import random_stream
from plant_sim.jumps import Jumps, PartedCouplers
from plant_sim.line import Line
from plant_sim.packing import pack
from plant_sim.plant_setup import Jump, PlantSetup
from plant_sim.section_effects import MANY_TICKS, SectionEffects, with_adhesion_of
from plant_sim.sensors import SensorSet
from plant_sim.states import Array, BrakeShoes, Observation, Pipe, VehicleStates
from plant_sim.totals import Totals, kinetic_energy, kinetic_energy_of_each, total_numbers, totals_of


class Train:
    """Multi-mass train on a line.

    Parameters
    ----------
    consist, line, setup
        Data of train, line and plant, with mismatch, disturbances and jumps.
    step_ns, tick_ns : int
        Plant step and tick [ns]; the tick is a multiple of the step.
    seed : int
        Seed of all random numbers.

    Attributes
    ----------
    arrays : Arrays
        Arrays of the kernel; every call of the kernel changes them.
    n : int
        Number of vehicles.
    units : tuple of int
        Numbers of the vehicles that are power units, front first.
    sensors : tuple of int
        Numbers of the vehicles with a coupler sensor behind them.
    sensor_set : SensorSet
        Sensors of power units and couplers.
    substeps : int
        Plant steps per tick.
    stamp : int
        Time of the present state since the start [ns].

    Raises
    ------
    ValueError
        If steps, setup and train do not match.
    """

    def __init__(
        self, consist: Consist, line: Line, setup: PlantSetup, *, step_ns: int, tick_ns: int, seed: int = 0
    ) -> None:
        if step_ns <= 0 or tick_ns <= 0 or tick_ns % step_ns:
            raise ValueError(
                f"tick {tick_ns} ns is not a positive multiple of the plant step {step_ns} ns; correct one of them"
            )
        setup = with_adhesion_of(line, setup)
        self.consist, self.line, self.setup = consist, line, setup
        self.units = consist.power_units
        self.sensors = setup.sensors.couplers
        self.step_ns, self.tick_ns, self.substeps = step_ns, tick_ns, tick_ns // step_ns
        self.stamp = 0
        self.step = step_ns * 1e-9
        self.arrays, self.n = pack(consist, line, setup, self.step), len(consist.vehicles)
        self._sections = SectionEffects(consist, line, setup, self.arrays)
        self.brake = friction_brake_events(consist)
        self.pipe = self.brake if isinstance(self.brake, PipeEvents) else None
        self._pressure: PipePressure | None = None
        if self.pipe is not None and consist.air_brake is not None:
            ends = (0, self.n - 1)
            self._pressure = PipePressure(consist.air_brake, self.arrays.vehicle, ends, self.pipe.changes)
        self.sensor_set = SensorSet(setup.sensors, self.units, self.arrays.vehicle[k.GAP], tick_ns * 1e-9, seed)
        sources = [random_stream(seed, f"disturbance/{i}") for i in range(len(setup.disturbances))]
        masses = self.arrays.vehicle[k.MASS]
        self.outside = OutsideForces(setup.disturbances, masses, step_ns, tick_ns, sources)
        self.arrays.setting[k.HAS_DRIFT] = float(self.outside.has_drift)
        if self.outside.has_drift and len(self.arrays.body) - 1 < self.n:
            raise ValueError(
                "disturbance paper002: drift speeds cannot act on rigidly joined vehicles; choose other draft gears"
            )
        self.parted = PartedCouplers(consist, self.arrays, self.brake)
        self.jumps = Jumps(setup, consist, self.arrays, self.parted, step_ns=step_ns, tick_ns=tick_ns)
        self._kinetic_start = self.kinetic_energy
        self._outside_force = np.zeros(self.n)

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
        """Force of the coupler behind every vehicle [N], shape (n,); the last is 0."""
        return self.arrays.state[k.COUPLER, 1 : self.n + 1].copy()

    @property
    def applied(self) -> Array:
        """Force of every power unit after delay, lag and limit [N], shape (units,)."""
        return np.array(self.arrays.unit[k.APPLIED])

    @property
    def shoe_force(self) -> Array:
        """Shoe force of every vehicle [N], >= 0, shape (n,)."""
        return self.arrays.state[k.SHOE_FORCE, : self.n].copy()

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy, rotating masses included [J]."""
        return kinetic_energy(self.arrays, self.n)

    @property
    def momentum(self) -> float:
        """Momentum, rotating masses included [kg m/s]."""
        return float((self.arrays.vehicle[k.MASS] * self.arrays.state[k.V, : self.n]).sum())

    @property
    def outside_force(self) -> Array:
        """Mean force of all disturbances except grades on every vehicle over the last tick [N], without drift."""
        return self._outside_force.copy()

    def observe(self) -> Observation:
        """Return true state and measurement at the present stamp; draws sensor noise, so call it once per tick."""
        a, n, stamp = self.arrays, self.n, self.stamp
        force = a.state[k.COUPLER, 1 : n + 1].copy()
        vehicles = VehicleStates(stamp, a.state[k.X, :n].copy(), a.state[k.V, :n].copy(), force)
        measured = self.sensor_set.measure(vehicles, a.unit[k.APPLIED].copy())
        if self._pressure is None:
            return Observation(vehicles, measured, None, None, None)
        head, tail = self._pressure.at(stamp * 1e-9)
        shoes = BrakeShoes(stamp, a.state[k.SHOE_FORCE, :n].copy())
        return Observation(vehicles, measured, Pipe(stamp, head), Pipe(stamp, tail), shoes)

    def pipe_pressures_at_each(self, times: Array) -> Array:
        """Return the brake-pipe pressures at the first and the last vehicle at rising times [s], shape (times, 2)."""
        assert self._pressure is not None
        first = self._pressure.at(times.item(0))
        if self._pressure.is_settled:
            self._pressure.at(times.item(-1))
            return np.tile(first, (times.size, 1))
        return np.array([first, *self._pressure.at_each(times[1:].tolist())])

    def advance(self, demand: Array, brake_pipe_pa: float | None = None) -> None:
        """Integrate one tick.

        Parameters
        ----------
        demand : Array, shape (substeps, units)
            Force commands that are due at every plant step [N].
        brake_pipe_pa : float, optional
            Pressure demanded at the head from now on [Pa, absolute]; None keeps the present one. Without effect while
            the emergency brake is applied.

        Raises
        ------
        ValueError
            If the shape is wrong, a command is not finite, or a pressure is demanded without an air brake.
        """
        demand = np.ascontiguousarray(demand, dtype=np.float64)
        flat = demand.ravel()
        if demand.shape != (self.substeps, len(self.units)):
            raise ValueError(f"demand has the shape {demand.shape}; give {(self.substeps, len(self.units))}")
        # a finite sum of squares proves finite commands, in 0.6 instead of 2.9 us; one that is not may be an overflow
        if not math.isfinite(flat.dot(flat)) and not np.isfinite(demand).all():
            raise ValueError(f"demand at {self.time:.3f} s is not finite; correct the law that sent it")
        time = self.stamp * 1e-9
        if brake_pipe_pa is not None:
            if self.pipe is None:
                raise ValueError(
                    f"brake-pipe pressure demanded, but train '{self.consist.name}' has no air brake; demand None"
                )
            self.pipe.demand(time, brake_pipe_pa)
        if self.outside.added_gusts and self.outside.drop_over(self.time):
            self.arrays.state[k.DRIVE_FORCE] = 0.0
            self._outside_force[:] = 0.0
        if self._sections.exist:
            self._sections.apply(self.stamp, self.tick_ns)
        outside = self.outside.sum
        if self.outside.acts:
            outside = self.outside.tick(self.stamp, self.arrays.state[k.V, : self.n])
        begin = 0
        if self.jumps.planned:
            for step in self.jumps.steps(self.stamp):
                self._integrate(demand, outside, begin, step)
                begin = step
                self.jumps.apply(self.stamp, begin)
        self._integrate(demand, outside, begin, self.substeps)
        if self.outside.acts:
            self.keep_outside(self.arrays.state[k.V])
        self.stamp += self.tick_ns

    @property
    def is_quiet(self) -> bool:
        """True if ticks need no Python: no brake wave, jump, added gust, parted coupler or force by the cubed speed."""
        if self.parted.since is not None or self.jumps.planned or self.outside.added_gusts or self.outside.has_cubes:
            return False
        self.brake.drop_finished()
        return not (self.brake.count or self.ticks_before_section == 0)

    @property
    def ticks_before_section(self) -> int:
        """Number of ticks in which no vehicle can pass the limit of a line section, which changes its forces."""
        return self._sections.ticks_before_next(self.tick_ns * 1e-9) if self._sections.exist else MANY_TICKS

    def advance_quiet(self, demand: Array) -> int:
        """Integrate ticks of a quiet train in one compiled call; return their number.

        Parameters
        ----------
        demand : Array, shape (ticks, substeps, units)
            Finite force commands that are due at every plant step [N]; disturbances and line sections may end the call
            earlier.
        """
        a, demand = self.arrays, demand[: self.ticks_before_section]
        outside = np.ascontiguousarray(self.outside.rest_of_block(self.stamp, len(demand)))
        k.advance_ticks(
            self.stamp, self.tick_ns, self.step, a.state, a.vehicle, a.vehicle_index, a.gear,
            a.table, a.run, a.body, a.unit, a.unit_index, a.envelope, a.piece,
            self.brake.array, demand[: len(outside)], outside, self.outside.vehicles, a.setting,
        )  # fmt: skip
        if self.outside.acts:
            self.keep_outside(self.arrays.state[k.V])
        self.stamp += len(outside) * self.tick_ns
        return len(outside)

    def add_jump(self, jump: Jump) -> None:
        """Add a jump that is not in the setup."""
        self.jumps.add(jump)

    def apply_emergency_brake(self) -> None:
        """Vent the brake pipe from now on, or without an air brake open the loop of the friction emergency brake.

        No drive and no command is part of this path. The demand of the drives stays that of :meth:`advance`.
        """
        self.brake.apply_emergency(self.time)

    def release_emergency_brake(self) -> None:
        """Close vent or loop; a brake pipe gets the pressure demanded last. No effect on a train that has parted."""
        self.brake.release_emergency(self.time)

    def _integrate(self, demand: Array, outside: Array, begin: int, end: int) -> None:
        if end <= begin:
            return
        a = self.arrays
        time = (self.stamp + begin * self.step_ns) * 1e-9
        if end - begin < self.substeps:
            demand, outside = demand[begin:end], np.ascontiguousarray(outside[:, begin:end])
        if self.parted.since is not None:
            demand = self.parted.without_traction(time, demand)
        if self.brake.count:
            self.brake.drop_finished()
        k.advance(
            time, self.step, a.state, a.vehicle, a.vehicle_index, a.gear,
            a.table, a.run, a.body, a.unit, a.unit_index, a.envelope, a.piece,
            self.brake.array, self.brake.count, demand,
            outside, self.outside.vehicles, a.setting,
        )  # fmt: skip

    def keep_outside(self, speed: Array) -> None:
        """Keep the mean force of the disturbances over a tick, with the speeds of the vehicles after it [m/s]."""
        listed, (force, per_speed) = self.outside.listed, self.outside.mean
        self._outside_force[listed] = force + per_speed * speed[listed]

    @property
    def totals(self) -> Totals:
        """Extremes and works since the start."""
        return totals_of(self.arrays, self.n, self.kinetic_energy - self._kinetic_start, self.jumps.energy)

    def totals_at_each(self, states: Array, gears: Array, units: Array, settings: Array) -> dict[str, list[float]]:
        """Return totals by name up to earlier states of the kernel, after the last jump.

        Parameters
        ----------
        states, gears, units, settings
            Arrays of the kernel with the states in the first dimension.
        """
        energies = kinetic_energy_of_each(self.arrays.vehicle[k.MASS], states)
        changes = [energy - self._kinetic_start for energy in energies]
        return total_numbers(
            states, gears, units, settings, vehicles=self.n, kinetic=changes, jump_energy=self.jumps.energy
        )


def compile_kernel() -> None:
    """Load the compiled kernel by one step of a two-vehicle train.

    The first compilation on a machine takes some seconds; :mod:`plant_sim.compiled` describes the cache.
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
    Train(consist, line, PlantSetup(), step_ns=1_000_000, tick_ns=1_000_000).advance(np.zeros((1, 0)))
