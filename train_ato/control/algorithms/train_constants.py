"""Class and constants of a train for a predictive law: pole of the loop, time of a wave, drag, tables of limits."""

import math
from typing import Any, NamedTuple

import numpy as np

from plant_sim.elementary import mean_over_units, plain_sum
from plant_sim.gears import LinearGear, RigidGear, SmoothedGear, TableGear
from plant_sim.units import number_text
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.messages.validity import MAX_FORCE

SPEED_STEP = 0.05
"""Spacing of the tables of force limits [m/s]."""
MAX_TABLE_SPEED = 140.0
"""Last speed of the tables of force limits [m/s]."""
MATCHED_SHARE = 2.0 / 3.0
"""Largest gain on the speed over the wave impedance of the couplers."""
MAX_OMEGA = 1.5
"""Largest default pole of the closed loop [rad/s]."""


class TrainClass(NamedTuple):
    """Strategy of `mpc` for a class of trains; all other parts of the law are the same for every train.

    Attributes
    ----------
    observer_ratio : float
        Bandwidth of the observer over omega. Without couplers a gust is in the estimate within the delay. A fast
        estimate would follow the waves of couplers; disturbances that excite soft ones change within the delay.
    position_share : float
        Gain on the position error over omega².
    coupled : bool
        Disturbances are random walks, in place of gusts and steady rates.
    soft : bool
        The units have a regulator of their deviations, and the sines in their disturbances a feed-forward.
    hauls : bool
        The observer has the modes of the couplers and no error of the mass. The force of a staircase of grades is that
        of the lag later. The vehicles stop and depart one by one.
    """

    observer_ratio: float
    position_share: float
    coupled: bool = True
    soft: bool = False
    hauls: bool = False


ONE_MASS = TrainClass(6.0, 0.5, coupled=False)
COUPLED_UNITS = TrainClass(5.0, 0.5)
SOFT_UNITS = TrainClass(2.5, 0.5, soft=True)
HAULED_VEHICLES = TrainClass(1.0, 1.0, hauls=True)
SOFT_COUPLERS = 3.0
"""Frequency pi/T_w of the slowest wave in the couplers over omega, below which the units have a regulator."""


def train_class(model: TrainModel, omega: float = 0.0) -> TrainClass:
    """Return the class of a train; couplers can be soft for a pole of the loop omega [rad/s] only."""
    vehicles = model.consist.vehicles
    if len(vehicles) > model.n_units:
        return HAULED_VEHICLES
    linear = all(isinstance(gear, LinearGear) and gear.slack == 0.0 for gear in model.consist.gears)
    if linear and len(vehicles) > 1 and math.pi < SOFT_COUPLERS * omega * wave_time(model):
        return SOFT_UNITS
    return COUPLED_UNITS if len(vehicles) > 1 else ONE_MASS


class Bandwidth(NamedTuple):
    """Pole of the closed loop, with the condition that limits it.

    Attributes
    ----------
    omega : float
        Pole [rad/s].
    limit : str
        Condition as text.
    """

    omega: float
    limit: str

    @property
    def text(self) -> str:
        """The pole and its limit as text."""
        return f"bandwidth {number_text(self.omega, 2)} rad/s, limited by: {self.limit}"


def default_bandwidth(model: TrainModel) -> Bandwidth:
    """Return the pole of the closed loop, the smallest of its limits by delay, lag and couplers (mpc_derivation.md)."""
    limits, dead = [Bandwidth(MAX_OMEGA, "the law itself, delay and couplers permit more")], dead_time(model)
    if dead > 0.0:
        limits.append(Bandwidth(0.9 / dead, "delay and lag"))
    longest, groups = wave_time(model), hauling_groups(model)
    if longest > 0.0 and groups:
        limits.append(Bandwidth(0.5 * wave_gain(model, MATCHED_SHARE), "wave impedance of the couplers"))
        if (damping := _damping_of_friction(model, longest)) is not None and dead > 0.0:
            path = longest / sum(sides for _, sides in groups)
            kept = math.tanh(0.5 * math.pi * damping * path / dead)
            limits.append(Bandwidth(0.5 * wave_gain(model, kept), "loss of waves in gear"))
    return min(limits, key=lambda each: each.omega)


def wave_gain(model: TrainModel, kept: float) -> float:
    """Return the gain on the speed error with a part ``kept`` of the wave impedance, infinite without waves [1/s]."""
    longest = wave_time(model)
    if longest <= 0.0:
        return math.inf
    gains = (kept * sides * model.mass / (share * model.inertia * longest) for share, sides in hauling_groups(model))
    return min(gains, default=math.inf)


def _damping_of_friction(model: TrainModel, longest: float) -> float | None:
    """Return the mean damping ratio of gears with friction, in a cycle from draft to buff; or None.

    ``longest`` is the time of a wave through all couplers [s].
    """
    pull = mean_over_units([1.0] * model.n_units, [each.force(0.0) for each in model.traction])
    found = []
    for gear in model.consist.gears:
        acting = 0.5
        if isinstance(gear, SmoothedGear):
            speed = 0.5 * math.pi / longest * pull / mean_stiffness(gear)
            acting *= min(1.0, speed / gear.switching_speed)
        if not isinstance(gear, RigidGear | LinearGear):
            found.append(acting * friction_damping(gear))
    return plain_sum(found) / len(found) if found else None


def dead_time(model: TrainModel) -> float:
    """Return the time from a measurement to the effect of its command, largest delay and lag [s]."""
    return model.longest_delay + model.lag


def hauling_groups(model: TrainModel) -> list[tuple[float, int]]:
    """Return share of the force and number of hauled neighbours of each group of adjacent power units.

    The groups without a hauled neighbour have no entry.
    """
    shares = dict(zip(model.units, model.share.tolist(), strict=True))
    found, share, before, count = [], 0.0, 0, len(model.consist.vehicles)
    for number in range(count + 1):
        if number in shares:
            share += shares[number]
            continue
        after = int(number < count)
        if share > 0.0 and before + after > 0:
            found.append((share, before + after))
        share, before = 0.0, 1
    return found


def wave_time(model: TrainModel) -> float:
    """Return the time of a wave through all couplers of a train [s]; mass over it is the wave impedance.

    It is 0 for a train with rigid couplers only.
    """
    count = len(model.consist.vehicles)
    softest = min(map(mean_stiffness, model.consist.gears), default=math.inf)
    return math.sqrt(model.mass * count / softest)


def friction_damping(gear: Any) -> float:
    """Return the damping ratio by the friction of a draft gear, for a train in draft or in buff.

    With the unloading ratio r the mean stiffness is k (1 + r)/2. In a cycle from no force to twice the mean deflection
    X the gear loses 2 k (1 - r) X²: zeta = 2 (1 - r)/(pi (1 + r)). From draft to buff it is half of it.
    """
    if isinstance(gear, LinearGear | RigidGear):
        return 0.0
    if isinstance(gear, TableGear):
        ratio = max(table.unloading[-1] / table.loading[-1] for table in gear.tables)
    else:
        ratio = float(gear.unloading_ratio)
    return 2.0 * (1.0 - ratio) / (math.pi * (1.0 + ratio))


def mean_stiffness(gear: Any) -> float:
    """Return the mean stiffness of a draft gear up to its stroke [N/m]; infinite for a rigid coupler."""
    if isinstance(gear, RigidGear):
        return math.inf
    if isinstance(gear, LinearGear):
        return gear.stiffness
    if isinstance(gear, TableGear):
        return min(float(table.loading[-1] / table.deflection[-1]) for table in gear.tables)
    return float(gear.force_at_stroke / gear.stroke)


def force_tables(model: TrainModel) -> Array:
    """Return the largest brake and traction force of the train over the speed [N], shape (2, speeds).

    The brake force of a train with an air brake has no limit here: the air brake adds to the electric brake, and its
    later applications are not in the input of a law.
    """
    speeds = SPEED_STEP * np.arange(round(MAX_TABLE_SPEED / SPEED_STEP))
    tables = np.empty((2, speeds.size))
    for row, envelopes in enumerate((model.brake, model.traction)):
        for column, speed in enumerate(speeds.tolist()):
            tables[row, column] = mean_over_units([1.0] * model.n_units, [each.force(speed) for each in envelopes])
    if model.air_brake is not None:
        tables[0] = MAX_FORCE
    return tables


def drag_slope(model: TrainModel) -> tuple[float, float]:
    """Return the slope of the running resistance at speed 0 [N s/m] and its increase with the speed [N s²/m²]."""
    low, middle, high = map(model.running_resistance, (10.0, 20.0, 30.0))
    curvature = (high - 2.0 * middle + low) / 100.0
    return (high - low) / 20.0 - 20.0 * curvature, curvature


def starting_resistance(model: TrainModel) -> float:
    """Return the running resistance at the begin of a motion on a level line [N], before it fades out at standstill."""
    slope, curvature = drag_slope(model)
    return model.running_resistance(10.0) - 10.0 * slope - 100.0 * curvature
