"""Motion of a train relative to its reference, from measured state and force, with disturbance and error of the mass.

The force between two samples is the force of the actuators. The resistance is that of the model at the measured state,
or that of a simulated train with the difference of the running resistance. `msgs_docs/mpc_derivation.md` derives the
observer of a train with hauled vehicles.
"""
# mypy: allow-untyped-defs

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import matrix_product, mean_over_units
from train_ato.control.algorithms.coupler_modes import CouplerModes
from train_ato.control.algorithms.train_constants import (
    dead_time,
    drag_slope,
    starting_resistance,
    train_class,
    wave_time,
)  # fmt: skip
from train_ato.control.contract import LawInput
from train_ato.control.mpc.motion_observer import (
    DISTURBANCE_PRIOR,
    SPEED_PRIOR,
    MotionObserver,
    correct,
    disturbance_drift,
    match,
    mix,
    weigh,
)
from train_ato.control.train_model import STANDSTILL_SPEED, TrainModel
from train_ato.messages.types import Array

WAVE_SPEED = 0.05
"""Standard deviation of the speed of the units by the modes [m/s]."""
OTHER_WAVES = 0.02
"""Standard deviation of the speed of the units by other modes [m/s]."""
LIGHT_WAVES = 0.003
"""The same where the waves outlast the feedback [m/s]: e does not follow a wave of another frequency."""
LOOSE_WAVES = 1.0
"""The same of a mode that is not fed back where waves outlast the feedback: it takes waves near its frequency, too."""
SHORT = 1.0
"""Time of a wave below which ``OTHER_WAVES`` are smaller in proportion [s]; noise of the speed would count as waves."""
MOTION = 3
"""States y_p, y_v and d, before those of the modes."""


@compiled
def modal_step(
    states, covariances, chances, noises, transition, gains, pull, force, random, walks, chain, weight, position,
    speed, mean, floor_ratio,
):  # fmt: skip
    """Advance all filters by a period and correct them; other arguments as in `filter_step`.

    The states are y_p [m], y_v [m/s], d [m/s²], and u_r [m] and w_r [m/s] of every mode. ``transition`` is that of a
    period without input, ``gains``, shape (2, n), the change of the state by an acceleration of 1 m/s² and by a force
    of 1 N, ``pull`` and ``force`` are this acceleration [m/s²] and force [N]. ``random`` is the covariance of the
    change by waves of the modes.
    """
    noise = noises[0]
    mix(states, covariances, chances, chain)
    count, size = states.shape
    exponents, roots = np.empty(count), np.empty(count)
    mean_position, mean_speed = 0.0, 0.0
    half, former = np.empty((size, size)), np.empty(size)
    for j in range(count):
        state, covariance = states[j], covariances[j]
        former[:] = state
        for a in range(size):
            state[a] = gains[0, a] * pull + gains[1, a] * force
            for b in range(size):
                state[a] += transition[a, b] * former[b]
        for a in range(size):
            for b in range(size):
                total = 0.0
                for k in range(size):
                    total += transition[a, k] * covariance[k, b]
                half[a, b] = total
        for a in range(size):
            for b in range(a + 1):
                total = random[a, b]
                if a == 1 and b == 1:
                    total += noise.jolt
                for k in range(size):
                    total += half[a, k] * transition[b, k]
                covariance[a, b] = covariance[b, a] = total
        covariance[2, 2] += disturbance_drift(walks[j], noise)
        miss_position, miss_speed = position - state[0], speed - state[1]
        mean_position += chances[j] * miss_position
        mean_speed += chances[j] * miss_speed
        exponents[j], roots[j] = correct(state, covariance, noise, miss_position, miss_speed)
    weigh(states, chances, exponents, roots, mean)
    match(noises, weight, mean_position, mean_speed, floor_ratio)


class ModalObserver(MotionObserver):
    """Position error [m], speed error [m/s] and disturbance [m/s²] of a train with hauled vehicles.

    Parameters
    ----------
    period
        Control period [s].
    bandwidth
        omega_o, bandwidth of the disturbance at the smallest noise [rad/s].
    wave_time
        T_w, time of a wave through the train [s], > 0.
    speed_noise
        Standard deviation of the measured speed at the start [m/s].
    modes
        Modes of the couplers, at least one.
    dead_time
        tau + Ta, from a measurement to its effect [s].
    outlast
        True if the feedback of a mode could excite it.
    """

    def __init__(
        self, period: float, bandwidth: float, wave_time: float, *, speed_noise: float, modes: CouplerModes,
        dead_time: float, outlast: bool = False,
    ) -> None:  # fmt: skip
        self._modes = modes
        self._other_waves = min(1.0, wave_time / SHORT) * (LIGHT_WAVES if outlast else OTHER_WAVES)
        damped = modes.damped_by_loop(dead_time, outlast=outlast)
        self._not_fed_back = [MOTION + 2 * number for number, kept in enumerate(damped) if not kept]
        self._wave_speeds = np.array([LOOSE_WAVES if outlast and not kept else WAVE_SPEED for kept in damped])
        self._transition, self._gains = _motion(modes, period)
        super().__init__(period, bandwidth, wave_time, speed_noise=speed_noise)

    def reset(self) -> None:
        """Restart at the next sample without a disturbance and with the prior noise."""
        super().reset()
        count, size = self._filters.walks.size, MOTION + 2 * self._modes.omega.size
        self._waves = 2.0 * self._other_waves**2 / self._wave_time * self._period
        wave = _waves(self._modes, self._wave_speeds)
        moved = matrix_product(self._transition, wave)
        self._random = wave - matrix_product(moved, np.ascontiguousarray(self._transition.T))
        prior = np.zeros((size, size))
        prior[:MOTION, :MOTION] = np.diag([self._filters.position_prior**2, SPEED_PRIOR**2, DISTURBANCE_PRIOR**2])
        self._states, self._mean = np.zeros((count, size)), np.zeros(size)
        self._covariances = np.array([prior + wave] * count)

    def restart(self, position: float, speed: float, force: float = 0.0) -> None:
        """Take a sample as position and speed error [m, m/s] with the stretch by a steady force [N] and no waves."""
        super().restart(position, speed)
        self._states[:, MOTION:] = 0.0
        self._states[:, MOTION::2] = force * self._modes.mobility / self._modes.omega**2
        for place in self._not_fed_back:
            self.position_error -= float(self._states[0, place])

    def _filter(self, position: float, speed: float, pull: float, regressor: float, force: float) -> None:
        """Advance and correct the filters; arguments as in the base class."""
        modal_step(
            self._states, self._covariances, self._chances, self._noise, self._transition, self._gains, pull, force,
            self._random, self._filters.walks, self._filters.chain, 1.0 / self._count, position, speed, self._mean,
            self._filters.position_floor,
        )  # fmt: skip
        found = self._mean.tolist()
        self.position_error, self.speed_error, self.disturbance = found[:3]
        for place in self._not_fed_back:
            self.position_error -= found[place]
            self.speed_error -= found[place + 1]


def _motion(modes: CouplerModes, period: float) -> tuple[Array, Array]:
    """Return transition of the states and their changes by an acceleration [m/s²] and a force [N], shape (2, n)."""
    size = MOTION + 2 * modes.omega.size
    transition, gains = np.eye(size), np.zeros((2, size))
    h = period
    transition[0, 1], transition[0, 2], transition[1, 2] = h, 0.5 * h * h, h
    gains[0, :2] = 0.5 * h * h, h
    for number, (omega, damping, mobility) in enumerate(
        zip(modes.omega.tolist(), modes.damping.tolist(), modes.mobility.tolist(), strict=True)
    ):
        place = MOTION + 2 * number
        block, forced = _oscillator(omega, damping, h)
        transition[place : place + 2, place : place + 2] = block
        gains[1, place : place + 2] = mobility * forced
        gains[1, :2] += mobility * forced
        transition[0, place : place + 2] = block[0] - [1.0, h]
        transition[1, place : place + 2] = block[1] - [0.0, 1.0]
    return transition, gains


def _oscillator(omega: float, damping: float, period: float) -> tuple[Array, Array]:
    """Return transition of displacement and speed over a period, and their change by an acceleration of 1 m/s²."""
    rate, turn = damping * omega, omega * math.sqrt(1.0 - damping * damping)
    fade, cosine, sine = math.exp(-rate * period), math.cos(turn * period), math.sin(turn * period) / turn
    block = fade * np.array([[cosine + rate * sine, sine], [-omega * omega * sine, cosine - rate * sine]])
    return block, np.array([(1.0 - block[0, 0]) / (omega * omega), block[0, 1]])


def _waves(modes: CouplerModes, speeds: Array) -> Array:
    """Return the covariance of the states by waves with standard deviations of the speed [m/s], shape (modes,)."""
    size = MOTION + 2 * modes.omega.size
    covariance = np.zeros((size, size))
    part = modes.mobility / math.fsum(modes.mobility.tolist())
    for number, (omega, speed) in enumerate(zip(modes.omega.tolist(), (part * speeds**2).tolist(), strict=True)):
        place = MOTION + 2 * number
        for offset, variance in ((0, speed / omega**2), (1, speed)):
            covariance[place + offset, place + offset] = variance
            covariance[offset, offset] += variance
            covariance[offset, place + offset] = covariance[place + offset, offset] = variance
    return covariance


SIMULATED_SHARE = 2.0
"""Gain on the position error over omega²: the speed has no cost of its own, and the position error is the integral."""
SIMULATED_WAVES = 0.01
"""Standard deviation of the speed of a unit against its train beyond the waves of the simulated train [m/s]."""


def follow_simulation(required: Array, simulated: Array, count: int) -> Array:
    """Return the total force on the reference [N], that of the simulated train up to the effect of the last command.

    ``required`` is the force of the rigid train, ``simulated`` that of the simulated train at the first times [N];
    without entries ``required`` is returned. Beyond them, up to the effect at ``count`` times, the last difference
    lasts.
    """
    if not simulated.size:
        return required
    known = min(simulated.size, count)
    lasting = simulated[known - 1] - required[known - 1]
    return np.concatenate((simulated[:known], required[known:count] + lasting, required[count:]))


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
        Unexplained acceleration less its mean over ``MEAN_TIME`` [m/s²]. The part of the error of the mass is
        included. It is 0 with hauled vehicles.
    """

    def __init__(
        self, model: TrainModel, period: float, *, omega: float, ratio: float, weight: float, speed_noise: float,
        use_mass: bool,
    ) -> None:  # fmt: skip
        kind, bandwidth = train_class(model), ratio * omega
        waves = wave_time(model) if kind.hauls else 0.0
        self._model, self._period, self._use_mass = model, period, use_mass
        self._share: list[float] = model.share.tolist()
        self._new_observer: Callable[[], MotionObserver] = partial(
            MotionObserver, period, bandwidth, waves, coupled=kind.coupled, speed_noise=speed_noise
        )
        self._new_simulated = self._new_observer
        if waves > 0.0 and (modes := CouplerModes.of(model)).omega.size:
            outlast = modes.outlast(2.0 * omega, model.inertia, model.lag)
            self._new_observer = partial(
                ModalObserver, period, bandwidth, waves, speed_noise=speed_noise, modes=modes,
                dead_time=dead_time(model), outlast=outlast,
            )  # fmt: skip
        self._weight = weight
        self._fade = 1.0 - math.exp(-period / MEAN_TIME)
        self.drag_slope = drag_slope(model)
        starting = starting_resistance(model) + DEPARTURE * model.inertia
        self._starting = math.inf if kind.hauls else starting  # hauled vehicles depart one by one
        self.reset()

    def reset(self) -> None:
        """Restart at the next sample, without any estimate."""
        self.observer = self._new_observer()
        self._before: tuple[float, float, float] | None = None
        self._sample, self._moved = (math.nan, 0.0), 0.0
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

    def _departs(self, inputs: LawInput, force: float, line_force: float) -> bool:
        """Return True if the traction [N] accelerates the train at a departure, whatever the noise of the speed.

        A falling grade does not count: the holding brake can hold the train there without traction. Nor does an
        arrival: the holding brake acts while the last traction decays.
        """
        if float(inputs.lookahead.acceleration[0]) <= 0.0:
            return False
        return force > self._starting + max(line_force, 0.0) + inputs.train_shoe_force

    def _at_rest(self, speed: float, reference: float) -> bool:
        """Return True at standstill by measured and estimated speed [m/s]."""
        estimated = speed if self.observer.stands else reference + self.observer.speed_error
        return abs(speed) < self.rest_speed(STANDSTILL_SPEED) and abs(estimated) < STANDSTILL_SPEED + 3.0 * (
            self.observer.speed_noise if self.observer.stands else 0.0
        )

    def _find_resolution(self, place: float, speed: float) -> None:
        """Take the way that a moving train goes [m] while its measured place stays as the resolution of the place.

        A sample that is repeated with its speed is a lost one, and does not count.
        """
        former_place, former_speed = self._sample
        if place != former_place:
            self._moved = 0.0
        elif speed != former_speed:
            self._moved += max(abs(speed) - 3.0 * self.observer.speed_noise, 0.0) * self._period
            self.observer.resolution = max(self.observer.resolution, self._moved)

    def step(self, inputs: LawInput) -> None:
        """Take the measurements of a control period."""
        model, ahead, observer = self._model, inputs.lookahead, self.observer
        speed, reference = mean_over_units(self._share, inputs.velocity.tolist()), float(ahead.velocity[0])
        line_force = model.line_force(model.front(inputs.position))
        resisting = model.running_resistance(speed) + line_force + inputs.train_shoe_force
        simulated = ahead.simulated_force
        if simulated.size:
            slope = self.drag_slope[0] + self.drag_slope[1] * abs(reference)
            resisting = float(simulated[0]) + slope * (speed - reference)
        place = mean_over_units(self._share, (inputs.position + model.offsets).tolist())
        position_error, speed_error = place - float(ahead.position[0]), speed - reference
        force = mean_over_units([1.0] * model.n_units, inputs.applied.tolist())
        by_line = line_force / model.inertia
        stands = not simulated.size and self._at_rest(speed, reference) and not self._departs(inputs, force, line_force)
        if self._before is None or stands:
            moving = not (stands or simulated.size)
            observer.stand(position_error, speed, place, reference, moving=moving, force=moving * force)
            regressor = by_line
        else:
            force_before, resisting_before, reference_before = self._before
            drive = self._weight * force_before + (1.0 - self._weight) * force
            pull = (drive - 0.5 * (resisting_before + resisting)) / model.inertia
            regressor = pull + by_line
            change = 0.0 if simulated.size else (reference - reference_before) / self._period
            force_change = (force - force_before) / model.inertia
            self._find_resolution(place, speed)
            observer.step(position_error, speed_error, pull - change, regressor, force_change, drive)
        self._before, self._sample = (force, resisting, reference), (place, speed)
        mass_error = self.mass_error
        rest = (observer.mass_error - mass_error) * regressor
        self.unexplained = observer.disturbance + mass_error * by_line + rest
        whole = self.unexplained + mass_error * (regressor - by_line)
        self._mean += self._fade * (whole - self._mean)
        self.passing = 0.0 if math.isinf(self._starting) else whole - self._mean
        self.beyond_reference = resisting - float(simulated[0] if simulated.size else ahead.resistance[0])
