"""Sums and extremes over all plant steps: coupler forces, works, saturated time."""

from dataclasses import dataclass

from plant_sim import kernel as k
from plant_sim.packing import Arrays
from plant_sim.states import Array

WORKS = [
    k.WORK_RUNNING, k.WORK_GRADE, k.WORK_CURVE, k.WORK_COUPLER, k.WORK_AIR, k.WORK_HOLD, k.WORK_OUTSIDE,
]  # fmt: skip
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
    def numbers(self) -> dict[str, float]:
        """The totals of the whole train by name."""
        return {name: float(value) for name in self.__slots__ if isinstance(value := getattr(self, name), float)}

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
    state, gear, unit, setting = arrays.state[None], arrays.gear[None], arrays.unit[None], arrays.setting[None]
    numbers = total_numbers(state, gear, unit, setting, vehicles=vehicles, kinetic=[kinetic], jump_energy=jump_energy)
    return Totals(
        draft=arrays.gear[k.DRAFT, : vehicles - 1].copy(),
        buff=arrays.gear[k.BUFF, : vehicles - 1].copy(),
        saturated=arrays.unit[k.SATURATED_TIME].copy(),
        **{name: column[0] for name, column in numbers.items()},
    )


def kinetic_energy_of_each(mass: Array, states: Array) -> list[float]:
    """Return the kinetic energies of several states [J]: masses of shape (n,), states of shape (k, rows, n or more)."""
    v = states[:, k.V, : mass.size]
    return [0.5 * energy for energy in (mass * v * v).sum(axis=1).tolist()]


def total_numbers(
    states: Array,
    gears: Array,
    units: Array,
    settings: Array,
    *,
    vehicles: int,
    kinetic: list[float],
    jump_energy: float,
) -> dict[str, list[float]]:
    """Return the totals of the whole train by name, with a number for each of several states of the kernel.

    Parameters
    ----------
    states, gears, units, settings
        State, gear, unit and setting of the kernel, with the states in the first dimension.
    vehicles, kinetic, jump_energy
        As in :func:`totals_of`, with a kinetic energy per state.
    """
    works = dict(zip(WORKS, states[:, WORKS, :vehicles].sum(axis=2).T.tolist(), strict=True))
    return {
        "draft_max": gears[:, k.DRAFT, : vehicles - 1].max(axis=1, initial=0.0).tolist(),
        "buff_max": gears[:, k.BUFF, : vehicles - 1].min(axis=1, initial=0.0).tolist(),
        "traction": units[:, k.WORK_TRACTION].sum(axis=1).tolist(),
        "regenerated": units[:, k.WORK_REGENERATED].sum(axis=1).tolist(),
        "running": works[k.WORK_RUNNING],
        "curve": works[k.WORK_CURVE],
        "grade": works[k.WORK_GRADE],
        "air_brake": works[k.WORK_AIR],
        "holding_brake": works[k.WORK_HOLD],
        "couplers": works[k.WORK_COUPLER],
        "outside": [float(work + jump_energy) for work in works[k.WORK_OUTSIDE]],
        "kinetic": kinetic,
        "saturated_any": settings[:, k.SATURATED_TIME_ANY].tolist(),
    }
