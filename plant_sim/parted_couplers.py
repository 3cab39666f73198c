"""Train separation: couplers that part during a run, and the emergency brake that follows from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plant_sim import kernel as k
from plant_sim.brake_events import BrakeEvents
from plant_sim.consist import Consist
from plant_sim.input_error import one_of
from plant_sim.packing import NO_LIMIT, Arrays
from plant_sim.states import Array


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
        self._since: float | None = None

    @property
    def parted(self) -> bool:
        """True after the first parting."""
        return self._since is not None

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
        if self._since is None:
            self._since = time
        else:  # the distance from a later gap, as if its wave had started with the first one
            later = distance + (time - self._since) * self._brake.apply_wave
            distance = np.minimum(a.vehicle[k.PARTED_DISTANCE], later)
        a.vehicle[k.PARTED_DISTANCE] = distance
        a.vehicle_index[k.PARTED_ORDER] = np.argsort(distance, kind="stable")
        self._brake.part(time)

    def reached(self, time: float) -> NDArray[np.bool_]:
        """Return True for every vehicle that the wave from a gap has reached at a time [s], shape (n,)."""
        if self._since is None:
            return np.zeros(len(self._offsets), dtype=np.bool_)
        arrival = self._since + self._arrays.vehicle[k.PARTED_DISTANCE] / self._brake.apply_wave
        return np.asarray(time >= arrival)

    def noticed(self, time: float) -> bool:
        """Return True if the wave from a gap has reached the first vehicle at a time [s]."""
        return self._since is not None and bool(self.reached(time)[0])

    def without_traction(self, time: float, demand: Array) -> Array:
        """Return the demands [N] of shape (steps, units), 0 for units that the wave has reached."""
        if self._since is None:
            return demand
        return np.ascontiguousarray(np.where(self.reached(time)[self._units], 0.0, demand))
