"""The plant: a train on a line, advanced tick by tick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant_sim import kernel as k
from plant_sim.air_brake import PipeEvents
from plant_sim.consist import Consist
from plant_sim.disturbances import Gust
from plant_sim.line import Line
from plant_sim.outside_forces import OutsideForces
from plant_sim.packing import lag_keep, pack
from plant_sim.plant_setup import Jump, PlantSetup
from plant_sim.sensors import SensorSet
from plant_sim.states import Array, BrakeCylinders, CarStates, Measurement, Pipe
from plant_sim.streams import stream


@dataclass(frozen=True, slots=True)
class Observation:
    """All the plant tells at one stamp; the brake parts are None without an air brake."""

    cars: CarStates
    measurement: Measurement
    brake_pipe: Pipe | None
    brake_cylinders: BrakeCylinders | None


@dataclass(frozen=True, slots=True)
class Totals:
    """What was added up over every plant step since the start.

    Attributes
    ----------
    draft, buff : Array, shape (n - 1,)
        Largest draft (>= 0) and buff (<= 0) force of every coupling [N].
    draft_max, buff_max : float
        The extremes of them [N].
    traction, regenerated : float
        Work of the power units that drove, and of those that braked (>= 0) [J].
    running, curve, grade, air_brake, holding_brake, couplers, outside : float
        Work of the other forces on the train [J], < 0 when it takes energy.  ``couplers`` is minus what the draft
        gears dissipated and hold; ``outside`` includes the energy of jumps of mass.
    kinetic : float
        Change of kinetic energy since the start; equals the sum of all works (``regenerated`` negative) to rounding.
    saturated : Array, shape (units,)
        Time a limit cut the wanted force of every unit [s], standstill left out.
    saturated_any : float
        Time this was so for any unit [s].
    """

    draft: Array
    buff: Array
    draft_max: float
    buff_max: float
    traction: float
    regenerated: float
    running: float
    curve: float
    grade: float
    air_brake: float
    holding_brake: float
    couplers: float
    outside: float
    kinetic: float
    saturated: Array
    saturated_any: float

    @property
    def balance(self) -> float:
        """Kinetic energy not explained by work [J]; rounding only."""
        gained = self.traction + self.running + self.curve + self.grade + self.air_brake
        gained += self.holding_brake + self.couplers + self.outside - self.regenerated
        return self.kinetic - gained


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
        self._lags = np.broadcast_to(np.array(setup.lag, dtype=np.float64), len(self.units)).copy()
        self._unit_vehicles = np.array(self.units, dtype=np.int64)
        self._events = None if consist.air_brake is None else PipeEvents(consist.air_brake, self.n)
        self._no_events = np.zeros((5, 1))
        self._sensors = SensorSet(setup.sensors, len(self.units), self.n, tick_ns * 1e-9, seed)
        sources = [stream(seed, f"disturbance/{i}") for i in range(len(setup.disturbances))]
        masses = self.arrays.vehicle[k.MASS]
        self._outside = OutsideForces(setup.disturbances, masses, self._step, tick_ns * 1e-9, sources)
        self.arrays.setting[k.HAS_DRIFT] = float(self._outside.has_drift)
        self._check_lists()
        self._jumps = list(setup.jumps)
        self._jump_energy = 0.0
        self._kinetic_start = self.kinetic_energy
        self._outside_force = np.zeros(self.n)
        self._gusts = False

    def _check_lists(self) -> None:
        """Refuse what the data models cannot see: numbers outside this train, drift of rigid vehicles."""
        if self._outside.has_drift and len(self.arrays.body) - 1 < self.n:
            raise ValueError("drift speeds (disturbance 'paper002') cannot act on rigidly joined vehicles")
        for jump in self.setup.jumps:
            for what, listed, count in (("vehicle", jump.vehicles, self.n), ("unit", jump.units, len(self.units))):
                wrong = [i for i in listed or () if not 0 <= i < count]
                if wrong:
                    raise ValueError(f"jumps lists {what} {wrong[0]}: the train has {what}s 0 ... {count - 1}")

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
    def pipe_pressure(self) -> float | None:
        """Brake-pipe pressure at the head [Pa, absolute]; None without an air brake."""
        return None if self._events is None else self._events.pressure

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy, rotating masses included [J]."""
        v = self.arrays.state[k.V, : self.n]
        return float(0.5 * (self.arrays.vehicle[k.MASS] * v * v).sum())

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
        for step in self._jump_steps():
            self._integrate(demand, outside, begin, step)
            begin = step
            self._apply_due_jumps(begin)
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

    def _jump_steps(self) -> list[int]:
        """Return the steps of this tick before which jumps are due; the first step stands for a place passed."""
        steps = set()
        for jump in self._jumps:
            if jump.place is not None:
                if self.arrays.state[k.X, 0] >= jump.place:
                    steps.add(0)
            elif jump.at is not None:
                step = max(0, -(-(round(jump.at * 1e9) - self.stamp) // self.step_ns))
                if step < self.substeps:
                    steps.add(step)
        return sorted(steps)

    def _apply_due_jumps(self, step: int) -> None:
        now = self.stamp + step * self.step_ns
        for jump in list(self._jumps):
            by_place = jump.place is not None and step == 0 and self.arrays.state[k.X, 0] >= jump.place
            by_time = jump.at is not None and round(jump.at * 1e9) <= now
            if by_place or by_time:
                self._jumps.remove(jump)
                self._jump(jump)

    def _jump(self, jump: Jump) -> None:
        a = self.arrays
        vehicles = list(range(self.n)) if jump.vehicles is None else list(jump.vehicles)
        units = list(range(len(self.units))) if jump.units is None else list(jump.units)
        before = self.kinetic_energy
        if jump.what == "mass":
            a.vehicle[np.ix_((k.MASS, k.WEIGHT, k.C0, k.C1, k.C2, k.HOLD), vehicles)] *= jump.factor
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
        else:
            self._lags[units] *= jump.factor
            a.unit[k.LAG_KEEP] = lag_keep(self._lags, self._step)
        self._jump_energy += self.kinetic_energy - before

    @property
    def totals(self) -> Totals:
        """Extremes and works since the start."""
        a, n = self.arrays, self.n
        draft, buff = a.gear[k.DRAFT, : n - 1].copy(), a.gear[k.BUFF, : n - 1].copy()

        def work(row: int) -> float:
            return float(a.state[row, :n].sum())

        return Totals(
            draft=draft,
            buff=buff,
            draft_max=float(draft.max(initial=0.0)),
            buff_max=float(buff.min(initial=0.0)),
            traction=float(a.unit[k.WORK_TRACTION].sum()),
            regenerated=float(a.unit[k.WORK_REGENERATED].sum()),
            running=work(k.WORK_RUNNING),
            curve=work(k.WORK_CURVE),
            grade=work(k.WORK_GRADE),
            air_brake=work(k.WORK_AIR),
            holding_brake=work(k.WORK_HOLD),
            couplers=work(k.WORK_COUPLER),
            outside=work(k.WORK_OUTSIDE) + self._jump_energy,
            kinetic=self.kinetic_energy - self._kinetic_start,
            saturated=a.unit[k.SATURATED].copy(),
            saturated_any=float(a.setting[k.SATURATED_ANY]),
        )


def compile_kernel() -> bool:
    """Run one step of a two-vehicle train, so that the compiled kernel is loaded; return whether it had to compile.

    The first time on a machine this takes some seconds; the result is cached beside the source or, if that is not
    writable, in the user's cache directory.
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
    misses = k.advance.stats.cache_misses
    return bool(sum(misses.values()))
