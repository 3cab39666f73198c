"""Online identification of paper 004: parameters of the model, and a network for the residual."""

import math

import numpy as np

from plant_sim.elementary import dot_of, exp_each, plain_dot, sin_each
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
        self._a, self._b = np.array(a), np.array(b)
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
