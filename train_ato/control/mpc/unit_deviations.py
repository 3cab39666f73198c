"""Regulator of coupled units against their train, after the delay; equations: `msgs_docs/mpc_derivation.md`."""

# mypy: allow-untyped-defs

import math

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import matrix_product, plain_dot, plain_sum
from plant_sim.record import Records
from train_ato.control.algorithms.coupled_units import CoupledUnits
from train_ato.control.algorithms.quadratic_program import inverse
from train_ato.control.contract import LawInput
from train_ato.control.mpc.disturbance_lines import DisturbanceLines
from train_ato.control.train_model import Actuator, TrainModel, newest_arrived
from train_ato.messages.types import Array

MAX_STEPS = 50000
"""Largest number of steps of the difference equation."""
CHANGE = 1e-11
"""Change of a gain in one step, over the largest one, below which the gains are final."""


@compiled
def difference_equation(a, a_transposed, b, b_transposed, cost, weight):
    """Return the gain K, shape (inputs, states), and S, shape (states, states), of the steady state."""
    final = cost.copy()
    last = np.zeros((b.shape[1], a.shape[0]))
    for _ in range(MAX_STEPS):
        ahead, through = matrix_product(final, a), matrix_product(final, b)
        gain = matrix_product(
            inverse(weight + matrix_product(b_transposed, through)), matrix_product(b_transposed, ahead)
        )
        ahead -= matrix_product(through, gain)
        final = cost + matrix_product(a_transposed, ahead)
        largest, change = 0.0, 0.0
        for i in range(gain.shape[0]):
            for j in range(gain.shape[1]):
                largest = max(largest, abs(gain[i, j]))
                change = max(change, abs(gain[i, j] - last[i, j]))
        for i in range(final.shape[0]):
            for j in range(i):
                final[i, j] = final[j, i] = 0.5 * (final[i, j] + final[j, i])
        if change <= CHANGE * largest:
            break
        last = gain
    return gain, final


def regulator_gain(a: Array, b: Array, cost: Array, weight: Array) -> Array:
    """Return K, shape (inputs, states), of u = -K x with the smallest sum of x'Qx + u'Ru for x+ = A x + B u.

    ``cost`` and ``weight`` are Q, at least 0, and R, positive.
    """
    gain: Array = _steady(a, b, cost, weight)[0]
    return gain


def filter_gain(a: Array, c: Array, process: Array, noise: Array) -> Array:
    """Return L, shape (states, outputs), of the Kalman filter x = x- + L (y - C x-) for x+ = A x + w, y = C x + n.

    ``process`` and ``noise`` are the covariances of w and n.
    """
    covariance = _steady(a.T, c.T, process, noise)[1]
    spread = matrix_product(covariance, np.ascontiguousarray(c.T))
    gain: Array = matrix_product(spread, inverse(noise + matrix_product(np.ascontiguousarray(c), spread)))
    return gain


def _steady(a: Array, b: Array, cost: Array, weight: Array) -> tuple[Array, Array]:
    """Return K and S of contiguous copies of the matrices."""
    matrices = (a, a.T, b, b.T, cost, weight)
    found: tuple[Array, Array] = difference_equation(*map(np.ascontiguousarray, matrices))
    return found


POSITION = 0.1
"""Deviation of a position with the weight 1 [m]."""
COUPLER = 1e5
"""Coupler force with the weight 1 [N]."""
JERK = 0.25
"""Rate of the command over the mass of a unit with the weight 1 [m/s³]."""
DRIFT, ACCELERATION, FORCE_CHANGE = 0.1, 0.05, 0.01
"""Process noise in a second: speed beside v [m/s], acceleration [m/s²], change of d over the mass [m/s²]."""
POSITION_NOISE, SPEED_NOISE = 0.02, 0.005
"""Standard deviations of the measurements [m, m/s]."""


@compiled
def commands_due(sent, actuators, tick, due):
    """Compute the command of every unit that is due in the middle of every tick of the delay [N].

    Parameters
    ----------
    sent : Array, shape (d, units)
        Commands sent, oldest first [N].
    actuators : Records of Actuator, shape (units,)
        Delays of the units.
    tick
        s.
    due : Array, shape (ticks, units)
        Result [N].
    """
    for k in range(due.shape[0]):
        for i in range(due.shape[1]):
            due[k, i] = newest_arrived(sent, i, (k + 0.5) * tick, tick, actuators[i].forward, actuators[i].backward)


class UnitDeviations:
    """Forces against the deviations of the units from the mean of their train.

    Parameters
    ----------
    model
        The nominal train.
    period
        Control period [s].
    first_weight
        Weight of the first force of a period in its mean.

    Attributes
    ----------
    lines : DisturbanceLines
        Persistent sines in the disturbances of the units; :meth:`reset` does not change them.

    Raises
    ------
    RefusedParameter
        If a vehicle is not driven or a draft gear is not a linear spring without slack.
    """

    def __init__(self, model: TrainModel, period: float, first_weight: float) -> None:
        self._units = CoupledUnits(model)
        self._weight: list[float] = self._units.weight.tolist()
        self._offsets = model.offsets
        self._tick, self._lag = model.tick, model.lag
        self._map = self._units.step_matrix(period)
        self._gain = deviation_regulator(self._units, model.lag, period)
        self._correction = deviation_filter(self._units, period)
        self._mean_weight = first_weight
        self.lines = DisturbanceLines(self._units, model, period)
        self.reset()

    def reset(self) -> None:
        """Restart at the next measurement."""
        n = self._units.n
        self._state: Array | None = None
        self._slow: Array = np.zeros(n)
        self._applied: Array = np.zeros(n)

    def forces(self, inputs: LawInput, sent: Array, actuators: Records[Actuator], ticks: int) -> list[float]:
        """Return the added force of every unit [N]; their sum is 0.

        The commands in flight, shape (d, units), have the oldest first [N]. The longest delay has ``ticks``.
        """
        state = self._estimate(inputs)
        applied, n = inputs.applied, self._units.n
        places, speeds = state[:n] - self._offsets, state[n:]
        if ticks:
            due = np.empty((ticks, n))
            commands_due(sent, actuators, self._tick, due)
            decay = math.exp(-self._tick / self._lag) if self._lag > 0.0 else 0.0
            acting: list[list[float]] = [applied.tolist()]
            for row in due.tolist():
                acting.append([command + (now - command) * decay for command, now in zip(row, acting[-1], strict=True)])
            lasting = (1.0 - decay) * self._lag / self._tick  # mean of a deviation of the applied force over a tick
            driving = due + (np.array(acting[:-1]) - due) * lasting + self._slow
            places = places + self._offsets
            origin = float(places[0])
            moved, step = np.concatenate((places - origin, speeds, np.zeros(n))), self._units.step_matrix(self._tick)
            motion, constant = moved[: 2 * n], moved[2 * n :]
            for force in driving:
                constant[:] = force
                motion[:] = step.dot(moved)  # 1 us less than the operator, with the same bits
            places, speeds, applied = motion[:n] + origin - self._offsets, motion[n:], np.array(acting[-1])
        last = self._between(sent[-1] if len(sent) else applied)
        deviations = (self._deviations(places + self._offsets), self._deviations(speeds), self._between(applied), last)
        change = self._gain.dot(np.concatenate(deviations))
        forces: list[float] = self._between(last - change).tolist()
        return forces

    def _estimate(self, inputs: LawInput) -> Array:
        """Advance the filter by a period, correct it by the measurement and return x and v, shape (2 units,)."""
        measured = np.concatenate(
            (self._deviations(inputs.position + self._offsets), self._deviations(inputs.velocity))
        )
        if self._state is None:
            self._state = measured
        else:
            mean = self._mean_weight * self._applied + (1.0 - self._mean_weight) * inputs.applied
            advanced = self._map.dot(np.concatenate((self._state, self._between(mean) + self._slow)))
            corrected = self._correction.dot(measured - advanced)
            self._state = advanced + corrected[: advanced.size]
            self._slow = self._slow + self._between(corrected[advanced.size :])
        self._applied = inputs.applied
        return self._state

    def _deviations(self, values: Array) -> Array:
        """Return values of the units minus their mean, weighted by mass, shape (units,)."""
        return values - plain_dot(self._weight, values.tolist())

    def _between(self, forces: Array) -> Array:
        """Return forces minus those that move the train without deviations [N], shape (units,)."""
        return forces - plain_sum(forces.tolist()) * self._units.weight


def deviation_regulator(units: CoupledUnits, lag: float, period: float) -> Array:
    """Return the gain of the change of the command on x, v, F and the last command, shape (units, 4 units)."""
    n = units.n
    step = units.driven_step(lag, period)
    between = np.eye(n) - np.outer(units.weight, np.ones(n))
    a = np.zeros((4 * n, 4 * n))
    a[: 3 * n, : 3 * n], a[: 3 * n, 3 * n :], a[3 * n :, 3 * n :] = step[:, : 3 * n], step[:, 3 * n :], np.eye(n)
    b = a[:, 3 * n :].dot(between)
    couplers = units.stiffness[:, None] * (np.eye(n)[:-1] - np.eye(n)[1:])
    deviation = np.eye(n) - np.outer(np.ones(n), units.weight)
    cost = np.zeros((4 * n, 4 * n))
    cost[:n, :n] = deviation.T.dot(deviation) / POSITION**2 + couplers.T.dot(couplers) / COUPLER**2
    return regulator_gain(a, b, cost, np.diag((units.mass * JERK * period) ** -2.0))


def deviation_filter(units: CoupledUnits, period: float) -> Array:
    """Return the gain of the corrections of x, v and d on the measured deviations, shape (3 units, 2 units)."""
    n = units.n
    a = np.eye(3 * n)
    a[: 2 * n] = units.step_matrix(period)
    noise = np.repeat([POSITION_NOISE, SPEED_NOISE], n) ** 2.0
    process = np.concatenate((np.repeat([DRIFT, ACCELERATION], n), FORCE_CHANGE * units.mass)) ** 2.0 * period
    return filter_gain(a, np.eye(3 * n)[: 2 * n], np.diag(process), np.diag(noise))
