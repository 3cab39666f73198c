"""Motion of a train relative to its reference, from measured state and force, with disturbance and error of the mass.

The force between two samples is that of the actuators; the resistance is that of the model at the measured state, or
that of a simulated train with the difference of the running resistance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from train_ato.control.algorithms.coupler_modes import CouplerModes
from train_ato.control.algorithms.force_shares import mean_over_units
from train_ato.control.algorithms.modal_observer import ModalObserver
from train_ato.control.algorithms.motion_observer import MotionObserver
from train_ato.control.algorithms.simulated_reference import SIMULATED_WAVES
from train_ato.control.algorithms.train_constants import dead_time, drag_slope, starting_resistance, wave_time
from train_ato.control.train_model import STANDSTILL_SPEED

if TYPE_CHECKING:
    from train_ato.control.contract import LawInput
    from train_ato.control.train_model import TrainModel

MEAN_TIME = 10.0
"""Time over which the unexplained acceleration is averaged for the limits far ahead [s]."""
DEPARTURE = 0.02
"""Acceleration by traction from which a train is in motion [m/s²]: a force of some N may only release its brake."""


class MeasuredMotion:
    """Estimate of the motion of a train as one mass, once per control period.

    Parameters
    ----------
    model
        The nominal train.
    period
        Control period [s].
    omega, ratio
        Half of the gain on the speed error [rad/s], and the bandwidth of the observer over it.
    weight
        Weight of the former force in the mean force of a period.
    speed_noise
        Standard deviation of the measured speed at the start [m/s].
    use_mass
        False: the error of the mass is 0.

    Attributes
    ----------
    observer : MotionObserver
        The estimates.
    beyond_reference : float
        Resistance at the measured state beyond that on the reference [N].
    unexplained : float
        Acceleration that model and error of the mass do not explain [m/s²].
    passing : float
        Unexplained acceleration, with that of the error of the mass, beyond its mean over ``MEAN_TIME`` [m/s²]; 0 with
        hauled vehicles.
    """

    def __init__(
        self, model: TrainModel, period: float, omega: float, ratio: float, weight: float, speed_noise: float,
        use_mass: bool,
    ) -> None:  # fmt: skip
        vehicles, bandwidth = len(model.consist.vehicles), ratio * omega
        waves = wave_time(model) if vehicles > model.n_units else 0.0
        self._model, self._period, self._use_mass = model, period, use_mass
        self._share: list[float] = model.share.tolist()
        self._new_observer: Callable[[], MotionObserver] = partial(
            MotionObserver, period, bandwidth, waves, vehicles > 1, speed_noise
        )
        self._new_simulated = self._new_observer
        if waves > 0.0 and (modes := CouplerModes.of(model)).omega.size:
            outlast = modes.outlast(2.0 * omega, model.inertia, model.lag)
            self._new_observer = partial(
                ModalObserver, period, bandwidth, waves, speed_noise, modes, dead_time(model), outlast
            )
        self._weight = weight
        self._fade = 1.0 - math.exp(-period / MEAN_TIME)
        self.drag_slope = drag_slope(model)
        starting = starting_resistance(model) + DEPARTURE * model.inertia
        self._starting = starting if vehicles == model.n_units else math.inf  # hauled vehicles depart one by one
        self.reset()

    def reset(self) -> None:
        """Restart at the next sample, without any estimate."""
        self.observer = self._new_observer()
        self._before: tuple[float, float, float] | None = None
        self.beyond_reference = self.unexplained = self.passing = 0.0
        self._mean = 0.0

    def miss(self) -> None:
        """Restart at the next sample with the present disturbance."""
        self.observer.miss()
        self._before = None

    def begin_simulated(self) -> None:
        """Estimate the deviation from a simulated train, which has the waves of the couplers, from now on."""
        self.observer = self._new_simulated()
        self.observer.set_simulated(SIMULATED_WAVES)

    @property
    def mass_error(self) -> float:
        """The part of the estimated error of the mass that the measurements support."""
        return self.observer.mass_error * self.observer.mass_known if self._use_mass else 0.0

    @property
    def inertia(self) -> float:
        """Estimated inertia of the train [kg]."""
        return self._model.inertia / (1.0 + self.mass_error)

    def rest_speed(self, smallest: float) -> float:
        """Return the measured speed below which the train can be at standstill [m/s]."""
        return smallest + 3.0 * self.observer.speed_noise

    def _departs(self, inputs: LawInput, force: float) -> bool:
        """Return True if the traction [N] accelerates the train at a departure, whatever the noise of the speed.

        A falling grade does not count: the holding brake can hold the train there without traction. Nor does an
        arrival: the holding brake acts while the last traction decays.
        """
        if float(inputs.lookahead.acceleration[0]) <= 0.0:
            return False
        grade = max(self._model.line_force(self._model.front(inputs.position)), 0.0)
        return force > self._starting + grade + inputs.train_shoe_force

    def _at_rest(self, speed: float, reference: float) -> bool:
        """Return True at standstill by measured and estimated speed [m/s]."""
        estimated = speed if self.observer.stands else reference + self.observer.speed_error
        return abs(speed) < self.rest_speed(STANDSTILL_SPEED) and abs(estimated) < STANDSTILL_SPEED + 3.0 * (
            self.observer.speed_noise if self.observer.stands else 0.0
        )

    def step(self, inputs: LawInput) -> None:
        """Take the measurements of a control period."""
        model, ahead, observer = self._model, inputs.lookahead, self.observer
        speed, reference = mean_over_units(self._share, inputs.velocity.tolist()), float(ahead.velocity[0])
        resisting = model.resisting_force(model.front(inputs.position), speed, inputs.train_shoe_force)
        simulated = ahead.simulated_force
        if simulated.size:
            slope = self.drag_slope[0] + self.drag_slope[1] * abs(reference)
            resisting = float(simulated[0]) + slope * (speed - reference)
        place = mean_over_units(self._share, (inputs.position + model.offsets).tolist())
        position_error, speed_error = place - float(ahead.position[0]), speed - reference
        force = mean_over_units([1.0] * model.n_units, inputs.applied.tolist())
        by_line = model.line_force(model.front(inputs.position)) / model.inertia
        stands = not simulated.size and self._at_rest(speed, reference) and not self._departs(inputs, force)
        if self._before is None or stands:
            observer.stand(position_error, speed, place, reference, moving=not (stands or simulated.size))
            regressor = by_line
        else:
            force_before, resisting_before, reference_before = self._before
            drive = self._weight * force_before + (1.0 - self._weight) * force
            pull = (drive - 0.5 * (resisting_before + resisting)) / model.inertia
            regressor = pull + by_line
            change = 0.0 if simulated.size else (reference - reference_before) / self._period
            force_change = (force - force_before) / model.inertia
            observer.step(position_error, speed_error, pull - change, regressor, force_change, drive)
        self._before = (force, resisting, reference)
        mass_error = self.mass_error
        rest = (observer.mass_error - mass_error) * regressor
        self.unexplained = observer.disturbance + mass_error * by_line + rest
        whole = self.unexplained + mass_error * (regressor - by_line)
        self._mean += self._fade * (whole - self._mean)
        self.passing = 0.0 if math.isinf(self._starting) else whole - self._mean
        self.beyond_reference = resisting - float(simulated[0] if simulated.size else ahead.resistance[0])
