"""Brake model of a train of the plant, from the parameters of its own brakes.

The emergency brake of the plant has a path of its own (:mod:`plant_sim.air_brake`): shoes by the vented brake pipe,
or the friction emergency brake. The service brake is the full electric brake with the largest reduction. The model
has, as a gamma train,

* the deceleration force / inertial mass, as a step function with the smallest value of each step up to the
  emergency-brake ceiling speed; the electric brake is a part of the service deceleration only, the running resistance
  of none;
* the equivalent build-up time: the mean over all brake forces of the delay until the same impulse as a step. A shoe
  brake has the propagation time of the pressure wave plus the time constant of its cylinder, a friction emergency brake
  its delay plus its time constant, an electric brake the time constant of its actuator and its ramp.

A force that rises with a common shape and then is constant has, at every time, at least the impulse of that step: the
train of the model never is behind the train of the plant.
"""

from collections import Counter

import numpy as np

from plant_sim.air_brake import FULL_LEVEL
from plant_sim.consist import Consist, VehicleType
from plant_sim.elementary import plain_sum
from plant_sim.packing import pipe_distances
from plant_sim.plant_setup import Adhesion, PlantSetup, SpeedAdhesion
from plant_sim.railway import adhesion_by_speed, shoe_force
from plant_sim.states import Array
from plant_sim.traction import FADE, Envelope
from plant_sim.units import KMH
from train_ato.supervision.step_function import EMERGENCY_MARGIN, StepFunction
from train_ato.supervision.train_model import SupervisedTrain, gamma_brake

STEPS = 7
"""Steps of the deceleration over the speed, the largest number of 3.13.2.2.3.1.2."""
GRID = 0.25 / KMH
"""Distance of the speeds at which the forces of a step are compared [m/s]."""
NO_FACTOR = StepFunction.constant(1.0)


def _adhesion_limit(adhesion: Adhesion | None, weight: float, speed: Array) -> Array:
    """Return the largest force on a weight [N] over the speed; infinite without an adhesion."""
    if adhesion is None:
        return np.full_like(speed, np.inf)
    if isinstance(adhesion, SpeedAdhesion):
        return np.asarray(adhesion.factor * adhesion_by_speed(speed) * weight)
    return np.full_like(speed, adhesion.coefficient * weight)


class PlantBrakeForces:
    """Brake forces of a consist over the speed, by kind.

    Parameters
    ----------
    consist, setup
        Train, and plant with its actuators; the mismatch of the setup is not used.
    speed : Array
        Speeds [m/s].

    Attributes
    ----------
    electric : Array
        Full force of all electric brakes [N].
    emergency : Array
        Force of the emergency brake [N]: shoes with a vented pipe, or the friction emergency brake.
    service_shoes : Array
        Shoe force of the train [N] with the largest reduction of the brake table, beside the electric brakes; 0
        without an air brake.
    friction_delay : float
        Mean over the friction-brake forces of their dead time plus time constant [s].
    """

    def __init__(self, consist: Consist, setup: PlantSetup, speed: Array) -> None:
        self.electric: Array = np.zeros_like(speed)
        self.emergency: Array = np.zeros_like(speed)
        self.service_shoes: Array = np.zeros_like(speed)
        units_mass = plain_sum(consist.vehicles[i].mass for i in consist.power_units)
        factor = shoe_force(1.0, speed)
        level = 0.0 if consist.air_brake is None else consist.air_brake.braking_factor[-1]
        equal = Counter(zip(consist.vehicles, consist.friction_forces, strict=True))
        for (vehicle, standstill), count in equal.items():
            electric = _electric_force(vehicle, consist, setup, speed, units_mass)
            limit = _adhesion_limit(setup.adhesion, vehicle.mass * consist.gravity, speed)
            self.electric += count * electric
            self.emergency += count * np.minimum(FULL_LEVEL * standstill * factor, limit)
            self.service_shoes += count * np.minimum(level * standstill * factor, np.maximum(limit - electric, 0.0))
        self.friction_delay = _friction_delay(consist)


def _electric_force(
    vehicle: VehicleType, consist: Consist, setup: PlantSetup, speed: Array, units_mass: float
) -> Array:
    """Return the full electric-brake force of one vehicle [N]: envelope, force limit and adhesion."""
    if not vehicle.brake:
        return np.zeros_like(speed)
    envelope = Envelope(vehicle.brake)
    force = np.full_like(speed, envelope.largest()) if setup.ideal_actuator else envelope.forces(speed)
    if setup.force_limit is not None:
        force = np.minimum(force, setup.force_limit * vehicle.mass / units_mass)
    weight = (vehicle.adhesive_mass or vehicle.mass) * consist.gravity
    return np.asarray(np.minimum(force, _adhesion_limit(setup.adhesion, weight, speed)))


def _friction_delay(consist: Consist) -> float:
    """Return the mean delay of the friction-brake forces [s], weighted by their size."""
    loop, brake = consist.friction_emergency_brake, consist.air_brake
    if loop is not None:
        return loop.delay + loop.time_constant
    assert brake is not None
    full = np.array(consist.friction_forces)
    arrival = pipe_distances(consist) / brake.apply_wave
    return brake.apply_time + float((full * arrival).sum() / full.sum()) if full.any() else 0.0


def _electric_delay(consist: Consist, setup: PlantSetup) -> float:
    """Return the longest delay of the electric brakes [s]: lag, ramp from full traction, fading near standstill."""
    lags = setup.lag if isinstance(setup.lag, tuple) else (setup.lag,)
    delay = max(lags, default=0.0)
    if setup.rate_limit is not None:
        for number in consist.power_units:
            vehicle = consist.vehicles[number]
            traction, brake = Envelope(vehicle.traction).largest(), Envelope(vehicle.brake).largest()
            delay = max(delay, max(lags, default=0.0) + (traction + brake / 2.0) / setup.rate_limit)
    return delay + (FADE if setup.reversing else 0.0)


def _traction_delay(consist: Consist, setup: PlantSetup) -> float:
    """Return the time after which the traction has the impulse of its fading [s]."""
    lags = setup.lag if isinstance(setup.lag, tuple) else (setup.lag,)
    delay = max(lags, default=0.0)
    if setup.rate_limit is not None and consist.power_units:
        largest = max(Envelope(consist.vehicles[i].traction).largest() for i in consist.power_units)
        delay += largest / (2.0 * setup.rate_limit)
    return delay


def _smallest_per_step(speed: Array, force: Array, mass: float, top: float) -> StepFunction:
    """Return the step function of the smallest deceleration [m/s²] of each step up to a top speed [m/s]."""
    bounds = [top * (i + 1) / STEPS for i in range(STEPS)]
    lower = [0.0, *bounds[:-1]]
    upper = [*bounds[:-1], float(speed[-1])]
    values = []
    for low, high in zip(lower, upper, strict=True):
        inside = (speed >= low - GRID) & (speed <= high + GRID)
        values.append(float(force[inside].min()) / mass)
    return StepFunction(tuple(bounds[:-1]), tuple(values))


def plant_train(consist: Consist, setup: PlantSetup, max_speed: float, kdry: float = 1.0) -> SupervisedTrain:
    """Return the train data of a train of the plant.

    Parameters
    ----------
    consist, setup
        Train, and plant with its actuators and adhesion.
    max_speed
        Maximum speed of the train [m/s].
    kdry
        Rolling-stock correction factor of the emergency deceleration, 0 to 1.

    Raises
    ------
    ValueError
        If no vehicle of a train with an air brake has shoes.
    """
    speed = np.arange(0.0, max_speed + EMERGENCY_MARGIN.above(max_speed) + GRID, GRID)
    forces = PlantBrakeForces(consist, setup, speed)
    mass = plain_sum(vehicle.inertia for vehicle in consist.vehicles)
    emergency = _smallest_per_step(speed, forces.emergency, mass, max_speed)
    service = _smallest_per_step(speed, forces.electric + forces.service_shoes, mass, max_speed)
    if min(emergency.values) <= 0.0:
        raise ValueError(
            f"train '{consist.name}' has no emergency brake: no vehicle of its air brake has shoes; give it shoes"
        )
    both = np.maximum(forces.electric + forces.service_shoes, 1e-9)
    delayed = forces.electric * _electric_delay(consist, setup) + forces.service_shoes * forces.friction_delay
    brake = gamma_brake(
        emergency,
        forces.friction_delay,
        service if min(service.values) > 0.0 else None,
        float((delayed / both).max()),
        kdry=StepFunction.constant(kdry),
        kwet=NO_FACTOR,
        adhesion=1.0,
    )
    return SupervisedTrain(
        length=consist.length,
        max_speed=max_speed,
        brake=brake,
        m_rotating_nom=100.0 * (mass / consist.mass - 1.0),
        t_traction_cut_off=_traction_delay(consist, setup),
    )
