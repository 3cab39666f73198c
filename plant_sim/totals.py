"""Sums and extremes over all plant steps: coupler forces, works, saturated time."""

from __future__ import annotations

from dataclasses import dataclass

from plant_sim import kernel as k
from plant_sim.packing import Arrays
from plant_sim.states import Array

WORKS = [
    k.WORK_RUNNING,
    k.WORK_GRADE,
    k.WORK_CURVE,
    k.WORK_COUPLER,
    k.WORK_AIR,
    k.WORK_HOLD,
    k.WORK_OUTSIDE,
]
"""Rows of the works of forces on the vehicles."""


@dataclass(frozen=True, slots=True)
class Totals:
    """Sums and extremes over all plant steps since the start.

    Attributes
    ----------
    draft, buff : Array, shape (n - 1,)
        Largest draft (>= 0) and buff (<= 0) force of every coupler [N].
    draft_max, buff_max : float
        Extremes over all couplers [N].
    traction, regenerated : float
        Work of the power units in traction, and in braking (>= 0) [J].
    running, curve, grade, air_brake, holding_brake, couplers, outside : float
        Work of the other forces on the train [J], < 0 for a loss. ``couplers`` is minus the energy dissipated and
        stored by the draft gears; ``outside`` includes the energy of jumps of mass.
    kinetic : float
        Change of kinetic energy since the start [J]; the sum of all works, ``regenerated`` negative, to rounding.
    saturated : Array, shape (units,)
        Time for which the demand of every unit was beyond a limit [s], without standstill.
    saturated_any : float
        The same for any unit [s].
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
        """Change of kinetic energy minus all works [J]; only rounding."""
        gained = self.traction + self.running + self.curve + self.grade + self.air_brake
        gained += self.holding_brake + self.couplers + self.outside - self.regenerated
        return self.kinetic - gained


def kinetic_energy(arrays: Arrays, vehicles: int) -> float:
    """Return the kinetic energy of the train, rotating masses included [J]."""
    v = arrays.state[k.V, :vehicles]
    return float(0.5 * (arrays.vehicle[k.MASS] * v * v).sum())


def totals_of(arrays: Arrays, vehicles: int, kinetic: float, jump_energy: float) -> Totals:
    """Return the totals from the arrays of the kernel.

    Parameters
    ----------
    arrays
        Arrays of the kernel.
    vehicles
        Number of vehicles.
    kinetic
        Change of kinetic energy since the start [J].
    jump_energy
        Part of it from jumps of mass [J].
    """
    draft, buff = arrays.gear[k.DRAFT, : vehicles - 1].copy(), arrays.gear[k.BUFF, : vehicles - 1].copy()
    work = dict(zip(WORKS, arrays.state[WORKS, :vehicles].sum(axis=1).tolist(), strict=True))
    return Totals(
        draft=draft,
        buff=buff,
        draft_max=float(draft.max(initial=0.0)),
        buff_max=float(buff.min(initial=0.0)),
        traction=float(arrays.unit[k.WORK_TRACTION].sum()),
        regenerated=float(arrays.unit[k.WORK_REGENERATED].sum()),
        running=work[k.WORK_RUNNING],
        curve=work[k.WORK_CURVE],
        grade=work[k.WORK_GRADE],
        air_brake=work[k.WORK_AIR],
        holding_brake=work[k.WORK_HOLD],
        couplers=work[k.WORK_COUPLER],
        outside=work[k.WORK_OUTSIDE] + jump_energy,
        kinetic=kinetic,
        saturated=arrays.unit[k.SATURATED_TIME].copy(),
        saturated_any=float(arrays.setting[k.SATURATED_TIME_ANY]),
    )
