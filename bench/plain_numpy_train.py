"""Plant step in plain numpy, for comparison with the compiled kernel in time and results.

The scheme and the order of operations are the same, with array expressions instead of loops.  Included are linear,
clip, smoothed and rigid draft gears, air brake, power units and line; not included are disturbances and tables.
"""

import copy
from typing import Any

import numpy as np
import numpy.typing as npt

from plant_sim import kernel as k
from plant_sim.packing import Arrays
from plant_sim.railway import MIN_POWER_SPEED

Array = npt.NDArray[np.float64]


class PlainTrain:
    """Copy of the arrays of a train with integration in numpy.

    Parameters
    ----------
    arrays : Arrays
        Arrays of :func:`plant_sim.packing.pack`; they are copied.
    step : float
        Plant step [s].
    """

    def __init__(self, arrays: Arrays, step: float) -> None:
        self.arrays = copy.deepcopy(arrays)
        self._step = step
        self._displacement: Array = np.zeros(0)
        kinds = np.zeros(self.arrays.vehicle.shape[1] - 1, dtype=np.int64)
        for first, end, kind, _ in self.arrays.run:
            kinds[first:end] = kind
        self._of_kind = {kind: np.flatnonzero(kinds == kind) for kind in (k.LINEAR, k.CLIP, k.SMOOTHED, k.RIGID)}
        if len(kinds) != sum(map(len, self._of_kind.values())):
            raise ValueError("draft gears given as tables are not supported in plain numpy")
        if self.arrays.unit[k.ADHESION_BY_SPEED].any() or self.arrays.setting[k.REVERSING]:
            raise ValueError("adhesion over speed and reverse motion are not supported in plain numpy")

    def advance(self, t: float, event: Array, events: int, demand: Array) -> None:
        """Integrate ``len(demand)`` steps from time t [s] on; ``event`` is changed in place, as in the kernel."""
        a, n = self.arrays, self.arrays.vehicle.shape[1]
        state, coupler = a.state, a.state[k.COUPLER]
        braked = events > 0 or bool(state[k.TARGET].any() or state[k.CYLINDER].any())
        for index, due in enumerate(demand):
            if braked:
                self._waves(t + index * self._step, event, events)
                braked = self._cylinders() or events > 0
            state[k.DRIVE_FORCE] = 0.0
            state[k.BRAKE_CAPACITY] = 0.0
            self._couplers()
            self._units(due)
            mean = np.average(state[k.V, :n], weights=a.vehicle[k.MASS])
            standing = bool(abs(mean) < a.setting[k.HOLD_SPEED])
            held = float(standing and not (due > 0.0).any())
            if len(self._of_kind[k.RIGID]):
                self._bodies(held)
            else:
                self._speeds(held)
            gear = a.gear[:, : n - 1]
            gear[k.DRAFT] = np.maximum(gear[k.DRAFT], coupler[1:n])
            gear[k.BUFF] = np.minimum(gear[k.BUFF], coupler[1:n])
            self._account_units()
            state[k.X, :n] += self._step * (state[k.V, :n] + state[k.DRIFT, :n])
            self._locate()

    def _couplers(self) -> None:
        a, state = self.arrays, self.arrays.state
        n = a.vehicle.shape[1]
        deflection = state[k.X, : n - 1] - state[k.X, 1:n] - a.vehicle[k.GAP, : n - 1]
        rate = state[k.V, : n - 1] - state[k.V, 1:n]
        side = np.copysign(1.0, deflection)
        for kind, which in self._of_kind.items():
            if len(which):
                gear, s = a.gear[:, which], side[which]
                beyond = np.maximum(s * deflection[which] - gear[k.HALF_SLACK], 0.0)
                state[k.COUPLER, which + 1] = self._gear_force(kind, which, gear, s, beyond=beyond, rate=rate[which])

    def _gear_force(self, kind: int, which: Any, gear: Array, s: Array, *, beyond: Array, rate: Array) -> Array:
        if kind == k.RIGID:
            return np.zeros_like(beyond)
        if kind == k.LINEAR:
            contact = np.where((beyond > 0.0) | (gear[k.HALF_SLACK] == 0.0), 1.0, 0.0)
            return np.asarray(s * gear[k.STIFFNESS] * beyond + gear[k.DAMPING] * contact * rate)
        d = np.minimum(beyond, gear[k.STROKE])
        q = d / (d + gear[k.X0])
        loading = gear[k.F0] * q + d * (gear[k.A1] + gear[k.A2] * d)
        if kind == k.SMOOTHED:
            switch = np.clip(s * rate * gear[k.INVERSE_VE], -1.0, 1.0)
            h = 0.5 * loading * (1.0 + gear[k.RATIO] + (1.0 - gear[k.RATIO]) * switch)
        else:
            before = np.maximum(s * gear[k.HYSTERESIS_FORCE], 0.0)
            moved = d - np.maximum(s * gear[k.HYSTERESIS_DEFLECTION], 0.0)
            h = np.clip(before + gear[k.STIFFNESS] * moved, gear[k.RATIO] * loading, loading)
            self.arrays.gear[k.HYSTERESIS_FORCE, which] = s * h
            self.arrays.gear[k.HYSTERESIS_DEFLECTION, which] = s * d
            h = np.clip(h + s * gear[k.TRANSITION_DAMPING] * rate, gear[k.RATIO] * loading, loading)
        return np.asarray(s * (h + gear[k.STOP] * (beyond - d)) + gear[k.DAMPING] * q * rate)

    def _envelope(self, first: int, end: int, speed: float) -> float:
        for v_end, force, slope, power in self.arrays.envelope[first:end]:
            if speed <= v_end:
                if power > 0.0:
                    return float(max(force + slope * speed + power / max(speed, MIN_POWER_SPEED), 0.0))
                return float(max(force + slope * speed, 0.0))
        return 0.0

    def _units(self, due: Array) -> None:
        unit, index, state = self.arrays.unit, self.arrays.unit_index, self.arrays.state
        for u in range(unit.shape[1]):
            i = index[k.UNIT_VEHICLE, u]
            speed = abs(state[k.V, i])
            cap = min(unit[k.FORCE_LIMIT, u], unit[k.ADHESION, u] * unit[k.ADHESION_WEIGHT, u])
            high = min(self._envelope(index[k.TRACTION_FIRST, u], index[k.TRACTION_END, u], speed), cap)
            low = -min(self._envelope(index[k.BRAKE_FIRST, u], index[k.BRAKE_END, u], speed), cap)
            wanted = due[u] * unit[k.GAIN, u]
            wanted = 0.0 if abs(wanted) < unit[k.DEAD_BAND, u] else wanted
            if (wanted > high or wanted < low) and speed >= self.arrays.setting[k.HOLD_SPEED]:
                unit[k.SATURATED_TIME, u] += self._step
            wanted = min(max(wanted, low), high)
            rated = min(max(wanted, unit[k.RATED, u] - unit[k.RATE_STEP, u]), unit[k.RATED, u] + unit[k.RATE_STEP, u])
            lagged = rated + unit[k.LAG_DECAY, u] * (unit[k.LAGGED, u] - rated)
            unit[k.RATED, u], unit[k.LAGGED, u] = rated, min(max(lagged, low), high)
            if unit[k.LAGGED, u] >= 0.0:
                state[k.DRIVE_FORCE, i] += unit[k.LAGGED, u]
            else:
                state[k.BRAKE_CAPACITY, i] -= unit[k.LAGGED, u]

    def _account_units(self) -> None:
        unit, state = self.arrays.unit, self.arrays.state
        vehicle = self.arrays.unit_index[k.UNIT_VEHICLE]
        lagged = unit[k.LAGGED]
        unit[k.APPLIED] = np.where(lagged < 0.0, -lagged * state[k.FRICTION_SHARE, vehicle], lagged)
        work = unit[k.APPLIED] * self._displacement[vehicle]
        unit[k.WORK_TRACTION] += np.maximum(work, 0.0)
        unit[k.WORK_REGENERATED] -= np.minimum(work, 0.0)

    def _waves(self, t: float, event: Array, events: int) -> None:
        a = self.arrays
        for e in range(events):
            distance = a.vehicle[k.PIPE_DISTANCE + int(event[k.ORIGIN, e])]
            arrived = t >= event[k.ISSUED, e] + distance / event[k.WAVE, e]
            event[k.REACHED, e] = arrived.sum()
            new = np.flatnonzero(arrived & (a.vehicle_index[k.NEWEST] < event[k.NUMBER, e]))
            a.vehicle_index[k.NEWEST, new] = int(event[k.NUMBER, e])
            a.state[k.TARGET, new] = event[k.LEVEL, e] * a.state[k.RESERVOIR, new]

    def _cylinders(self) -> bool:
        a, n = self.arrays, self.arrays.vehicle.shape[1]
        cylinder, target = a.state[k.CYLINDER, :n], a.state[k.TARGET, :n]
        keep = np.where(target > cylinder, a.setting[k.APPLY_DECAY], a.setting[k.RELEASE_DECAY])
        cylinder[:] = target + keep * (cylinder - target)
        cylinder[(target == 0.0) & (cylinder < k.IDLE_CYLINDER)] = 0.0
        speed = 3.6 * np.abs(a.state[k.V, :n])
        a.state[k.SHOE_FORCE, :n] = a.vehicle[k.SHOE] * cylinder * (2.0 * speed + 150.0) / (3.0 * speed + 150.0)
        return bool((cylinder > 0.0).any() or (target > 0.0).any())

    def _explicit(self) -> tuple[Array, Array]:
        """Return viscous resistance and grade force of every vehicle [N]."""
        a, n = self.arrays, self.arrays.vehicle.shape[1]
        v = a.state[k.V, :n]
        grade = a.state[k.GRADE_A, :n] + a.state[k.GRADE_B, :n] * a.state[k.X, :n]
        return -v * (a.vehicle[k.C1] + a.vehicle[k.C2] * np.abs(v)), grade

    def _capacity(self, held: float) -> Array:
        a, n = self.arrays, self.arrays.vehicle.shape[1]
        own = a.vehicle[k.C0] + a.state[k.CURVE, :n] + a.state[k.BRAKE_CAPACITY, :n] + a.state[k.SHOE_FORCE, :n]
        return np.asarray(own + held * a.vehicle[k.HOLD_CAPACITY])

    def _slide(self, free: Array, stop: Array, before: Array) -> tuple[Array, Array, Array]:
        """Return speed after dry friction, sign and share of the friction, and displacement of the step."""
        size = np.abs(free)
        after = np.copysign(np.maximum(size - stop, 0.0), free)
        share = np.divide(size, stop, out=np.ones_like(size), where=size < stop)
        return after, -np.copysign(share, free), 0.5 * self._step * (before + after)

    def _speeds(self, held: float) -> None:
        a, n = self.arrays, self.arrays.vehicle.shape[1]
        before = a.state[k.V, :n].copy()
        viscous, grade = self._explicit()
        couplers = a.state[k.COUPLER, :n] - a.state[k.COUPLER, 1 : n + 1]
        step = self._step * a.vehicle[k.INVERSE_MASS]
        free = before + step * (couplers + grade + viscous + a.state[k.DRIVE_FORCE, :n])
        after, sliding, mid = self._slide(free, step * self._capacity(held), before)
        self._account(held, sliding, mid, viscous, grade=grade, couplers=couplers)
        a.state[k.V, :n] = after

    def _bodies(self, held: float) -> None:
        a, n = self.arrays, self.arrays.vehicle.shape[1]
        first, before = a.body[:-1], a.state[k.V, :n].copy()
        viscous, grade = self._explicit()
        own = grade + a.state[k.DRIVE_FORCE, :n] + viscous
        mass = np.add.reduceat(a.vehicle[k.MASS], first)
        force = np.add.reduceat(own, first) + a.state[k.COUPLER, first] - a.state[k.COUPLER, a.body[1:]]
        capacity = np.add.reduceat(self._capacity(held), first)
        free = before[first] + self._step * force / mass
        after, sliding, mid = self._slide(free, self._step * capacity / mass, before[first])
        count = np.diff(a.body)
        after, sliding, mid = np.repeat(after, count), np.repeat(sliding, count), np.repeat(mid, count)
        rest = own + sliding * self._capacity(held) - a.vehicle[k.MASS] * (after - before) / self._step
        for i in self._of_kind[k.RIGID]:
            a.state[k.COUPLER, i + 1] = a.state[k.COUPLER, i] + rest[i]
        couplers = a.state[k.COUPLER, :n] - a.state[k.COUPLER, 1 : n + 1]
        self._account(held, sliding, mid, viscous, grade=grade, couplers=couplers)
        a.state[k.V, :n] = after

    def _account(
        self, held: float, sliding: Array, mid: Array, viscous: Array, *, grade: Array, couplers: Array
    ) -> None:
        a, n = self.arrays, self.arrays.vehicle.shape[1]
        state, dry = a.state[:, :n], sliding * mid
        state[k.WORK_RUNNING] += viscous * mid + a.vehicle[k.C0] * dry
        state[k.WORK_GRADE] += grade * mid
        state[k.WORK_CURVE] += state[k.CURVE] * dry
        state[k.WORK_COUPLER] += couplers * mid
        state[k.WORK_AIR] += state[k.SHOE_FORCE] * dry
        state[k.WORK_HOLD] += held * a.vehicle[k.HOLD_CAPACITY] * dry
        state[k.FRICTION_SHARE], self._displacement = sliding, mid

    def _locate(self) -> None:
        a, n = self.arrays, self.arrays.vehicle.shape[1]
        x = a.state[k.X, :n]
        if not ((x < a.state[k.PIECE_BEGIN, :n]) | (x >= a.state[k.PIECE_END, :n])).any():
            return
        p = np.searchsorted(a.piece[k.END], x, side="right")
        a.state[k.PIECE_BEGIN, :n], a.state[k.PIECE_END, :n] = a.piece[k.BEGIN, p], a.piece[k.END, p]
        weight = a.vehicle[k.WEIGHT]
        a.state[k.GRADE_A, :n] = -weight * (a.piece[k.GRADE, p] - a.piece[k.GRADE_SLOPE, p] * a.piece[k.BEGIN, p])
        a.state[k.GRADE_B, :n] = -weight * a.piece[k.GRADE_SLOPE, p]
        a.state[k.CURVE, :n] = weight * a.piece[k.DRY_PER_WEIGHT, p]
