"""Parts of generalised predictive control, paper 004.

These are the model with its online identification, the network of the residual, the Diophantine recursion (13), (14),
and the linear law of a model (18)-(22).
"""

import math

import numpy as np

from plant_sim.elementary import dot_of, exp_each, plain_dot, sin_each
from train_ato.control.algorithms.coupled_units import matrix_exponential
from train_ato.messages.types import Array


class Increments:
    """Recursive identification, eqs. (8)-(11), with a fixed integrator: A = (1 - z⁻¹) A'.

    Parameters
    ----------
    a : Array, shape (4,)
        Nominal A(z⁻¹), with a root at 1.
    b : Array, shape (3,)
        Nominal B(z⁻¹).
    deviation
        Largest deviation of the identified parameters over the norm of the nominal B, and of the poles.
    """

    def __init__(self, a: Array, b: Array, deviation: float) -> None:
        inner = np.array([1.0, 1.0 + a[1], 1.0 + a[1] + a[2]])
        self._nominal = np.concatenate((inner[1:], b))
        self._deviation = deviation
        self._scale = deviation * _length(self._nominal[2:])
        self.reset()

    def reset(self) -> None:
        """Return to the nominal parameters."""
        self.theta = self._nominal.copy()
        self._drift = np.zeros(3)
        self._present: tuple[list[float], list[float]] | None = None

    def polynomials(self) -> tuple[Array, Array]:
        """Return A(z⁻¹), shape (4,), and B(z⁻¹), shape (3,)."""
        c1, c2 = float(self.theta[0]), float(self.theta[1])
        a = np.array([1.0, c1 - 1.0, c2 - c1, -c2])
        a[1:] += self._drift
        return a, self.theta[2:]

    def miss(self, speeds: list[float], sent: list[float]) -> float:
        """Return the newest speed minus its prediction by the model [m/s].

        Parameters
        ----------
        speeds, sent
            Last four speeds [m/s] and commands [m/s²], newest first.
        """
        if self._present is None:
            now_a, now_b = self.polynomials()
            self._present = now_a.tolist(), now_b.tolist()
        (_, a1, a2, a3), b = self._present
        v0, v1, v2, v3 = speeds
        driven = plain_dot(b, sent)
        return v0 - (-a1 * v1 - a2 * v2 - a3 * v3) - driven

    def learn(self, speeds: list[float], sent: list[float], error: float, *, absolute: bool) -> None:
        """Move the parameters by x e/(1 + x'x).

        Parameters
        ----------
        speeds, sent
            Last four speeds [m/s] and commands [m/s²], newest first.
        error
            Prediction error e [m/s].
        absolute
            x contains the speeds themselves instead of their increments.
        """
        self._present = None
        _, v1, v2, v3 = speeds
        if absolute:
            x = np.array([-v1, -v2, -v3, *sent[:3]])
            move = x * (error / (1.0 + dot_of(x, x)))
            self._drift = np.clip(self._drift + move[:3], -self._deviation, self._deviation)
            self.theta[2:] += move[3:]
        else:
            x = np.array([-(v1 - v2), -(v2 - v3), *sent[:3]])
            self.theta += x * (error / (1.0 + dot_of(x, x)))
        off = self.theta - self._nominal
        size = _length(off)
        if size > self._scale:
            self.theta = self._nominal + off * (self._scale / size)


class ResidualNetwork:
    """Back-propagation network for the residual of the model: xi = W s(V z + mu2) + mu1, s the logistic function.

    Parameters
    ----------
    hidden
        Number of hidden neurons.
    """

    def __init__(self, hidden: int) -> None:
        self._start = 0.5 * sin_each(1.0 + np.arange(6 * hidden, dtype=np.float64)).reshape(hidden, 6)
        self._hidden = hidden
        self.reset()

    def reset(self) -> None:
        """Return to the initial weights: fixed and different ones in the first layer, 0 elsewhere."""
        self._v = self._start.copy()
        self._mu2: Array = np.zeros(self._hidden)
        self._w: Array = np.zeros(self._hidden)
        self._mu1 = 0.0
        self._z: Array = np.zeros(6)
        self._s: Array = np.full(self._hidden, 0.5)

    def begin(self, xi: float) -> None:
        """Set the output of the initial weights [m/s], whatever the input."""
        self._mu1 = min(max(xi, -10.0), 10.0)

    def estimate(self, speeds: list[float], sent: list[float]) -> float:
        """Return xi for the next sample [m/s] from the last three speeds [m/s] and commands [m/s²]."""
        self._z = np.array([*(speed / 100.0 for speed in speeds), *sent])
        reach = _bounded((self._v * self._z).sum(axis=1) + self._mu2, 30.0)
        self._s = 1.0 / (1.0 + exp_each(-reach))
        return self._output()

    def learn(self, left: float, rate: float) -> None:
        """Move all weights down the gradient of (left - xi)², ``left`` the measured residual of the last xi [m/s]."""
        error = rate * min(max(left - self._output(), -1.0), 1.0)
        back = error * self._w * self._s * (1.0 - self._s)
        self._mu1 = min(max(self._mu1 + error, -10.0), 10.0)
        self._w = _bounded(self._w + error * self._s, 10.0)
        self._v = _bounded(self._v + back[:, None] * self._z, 10.0)
        self._mu2 = _bounded(self._mu2 + back, 10.0)

    def _output(self) -> float:
        return dot_of(self._w, self._s) + self._mu1


def _length(vector: Array) -> float:
    return math.sqrt(dot_of(vector, vector))


def _bounded(fresh: Array, bound: float) -> Array:
    """Clip an array in place and return it; three times as fast as ``numpy.clip`` for six entries."""
    np.maximum(fresh, -bound, out=fresh)
    return np.minimum(fresh, bound, out=fresh)


def sampled_actuator(delay: float, lag: float, period: float) -> tuple[Array, Array]:
    """Return A(z⁻¹) and B(z⁻¹) from command acceleration to speed, paper 004, eqs. (4), (5).

    G(s) = exp(-T s)/((tau s + 1) s) (the printed (2) has a wrong minus), the delay by first-order Padé, sampled with a
    zero-order hold; a bilinear transform would give a feed-through, which (5) does not have.

    Parameters
    ----------
    delay, lag, period
        Delay T, lag tau and sampling period [s].

    Returns
    -------
    a : Array, shape (4,)
        1, a1, a2, a3; its root at 1 is the integrator.
    b : Array, shape (3,)
        b0, b1, b2 in A v(k) = B u(k-1).
    """
    pole, fast = 2.0 / max(delay, 1e-3 * period), 1.0 / max(lag, 1e-3 * period)
    rates = np.zeros((4, 4))
    # Padé (pole - s)/(pole + s) = -1 + 2 pole/(s + pole); states: its own, the lag's output, the speed; then u.
    rates[0] = [-pole, 0.0, 0.0, 1.0]
    rates[1] = [2.0 * pole * fast, -fast, 0.0, -fast]
    rates[2] = [0.0, 1.0, 0.0, 0.0]
    step = matrix_exponential(rates * period)
    transition, drive = step[:3, :3], step[:3, 3]
    a = np.ones(1)
    for root in (math.exp(-pole * period), math.exp(-fast * period), 1.0):
        a = convolved(a, np.array([1.0, -root]))
    response, state = [], drive
    for _ in range(3):
        response.append(float(state[2]))
        state = (transition * state).sum(axis=1)
    b = np.array([plain_dot(a[: j + 1].tolist(), response[j::-1]) for j in range(3)])
    return a, b


def convolved(one: Array, other: Array) -> Array:
    """Return the product of two polynomials; ``numpy.convolve`` adds in an order of the processor."""
    found = np.zeros(one.size + other.size - 1)
    for first, value in enumerate(other.tolist()):
        found[first : first + one.size] += value * one
    return found


def diophantine(a: Array, horizon: int) -> tuple[Array, Array]:
    """Solve I = E_j A + z⁻ʲ F_j for j = 1 ... horizon, eq. (13), by recursion.

    Parameters
    ----------
    a : Array, shape (n + 1,)
        A(z⁻¹), a[0] = 1.
    horizon
        Number of steps.

    Returns
    -------
    e : Array, shape (horizon,)
        Coefficients common to all E_j: E_j = e[0] + ... + e[j-1] z^-(j-1).
    f : Array, shape (horizon, n)
        Row j - 1 holds F_j.
    """
    n = a.size - 1
    e, f = np.zeros(horizon), np.zeros((horizon, n))
    remainder = -a[1:].copy()
    e[0] = 1.0
    f[0] = remainder
    for j in range(1, horizon):
        e[j] = f[j - 1, 0]
        f[j, :-1] = f[j - 1, 1:]
        f[j] -= e[j] * a[1:]
    return e, f


def response_and_past(e: Array, b: Array, horizon: int) -> tuple[Array, Array]:
    """Split E_j B = G_j + z⁻ʲ H_j for j = 1 ... horizon, eq. (14).

    Returns
    -------
    g : Array, shape (horizon,)
        Coefficients common to all G_j: the impulse response.
    h : Array, shape (horizon, len(b) - 1)
        Row j - 1 holds H_j, which multiplies u(k-1), u(k-2), ...
    """
    product = convolved(e, b)
    g = product[:horizon]
    past = np.zeros((horizon, b.size - 1))
    for j in range(1, horizon + 1):
        own = convolved(e[:j], b)
        past[j - 1] = own[j:]
    return g, past
