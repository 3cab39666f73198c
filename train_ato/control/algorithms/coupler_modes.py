"""Modes of the couplers of a train that change the speed of its power units; `msgs_docs/mpc_derivation.md`.

The bodies are the vehicles. Vehicles with a rigid coupler between them form one body. For weak damping the modes are
nearly a balanced realisation. The modes with the largest Hankel singular values are then those of balanced truncation
(Gregory 1984, Journal of Guidance, Control, and Dynamics 7, 725-732). Slack and preload are not in the modes.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import matrix_product
from train_ato.control.algorithms.train_constants import (
    dead_time,
    default_bandwidth,
    friction_damping,
    mean_stiffness,
    train_class,
)
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array

MAX_MODES = 4
"""Largest number of modes."""
MIN_SHARE = 0.05
"""Smallest Hankel singular value of a mode over the largest one."""
MIN_MOBILITY = 1e-9
"""Mobility over that of the whole train below which a mode has a node at the units, but for rounding."""
DAMPING = (0.02, 0.5)
"""Smallest and largest damping ratio."""
LONGER_DELAY = 1.5
"""Factor on the dead time with which the loop still damps a mode that is fed back where waves outlast the feedback."""
SWEEPS = 60
"""Largest number of sweeps of the Jacobi method; about ten are enough."""


@dataclass(frozen=True)
class TrainModes:
    """All modes of the couplers, in the order of their frequencies.

    Attributes
    ----------
    omega : Array, shape (modes,)
        Frequencies [rad/s].
    viscous, friction : Array, shape (modes,)
        Damping ratio by the dampers, and by the friction in the gears.
    mobility : Array, shape (modes,)
        b² of the mean of the units [1/kg].
    units : Array, shape (modes,)
        Sum of s_i phi_r(i)², the mobility of units that feed back their own speeds [1/kg].
    mass, stiffness, dampers : Array
        Masses of the bodies [kg]; stiffness [N/m] and damping [N s/m] of the gears between them.
    shapes : Array, shape (bodies, modes)
        Modes phi_r [kg^-1/2].
    """

    omega: Array
    viscous: Array
    friction: Array
    mobility: Array
    units: Array
    mass: Array
    stiffness: Array
    dampers: Array
    shapes: Array

    @property
    def friction_matrix(self) -> Array:
        """Damping matrix of the bodies with the damping ratios of the friction [N s/m]: 2 zeta omega M phi (M phi)'."""
        moved = self.mass[:, np.newaxis] * self.shapes
        damping: Array = matrix_product(moved * (2.0 * self.friction * self.omega), np.ascontiguousarray(moved.T))
        return damping

    @classmethod
    def of(cls, model: TrainModel) -> TrainModes:
        """Return the modes of a train; none if all couplers are rigid."""
        mass, stiffness, viscous, friction, share = _bodies(model)
        root = 1.0 / np.sqrt(mass)
        squared, vectors = _eigenvalues(mass.size, (chain(stiffness) * np.outer(root, root)).tobytes())
        order = np.argsort(squared, kind="stable")[1:]
        omega, shapes = np.sqrt(squared[order]), vectors[:, order] * root[:, np.newaxis]
        stretch = np.diff(shapes, axis=0) ** 2
        return cls(
            omega, _ordered_product(viscous, stretch) / (2.0 * omega),
            _ordered_product(friction * stiffness, stretch) / omega**2, _ordered_product(share, shapes) ** 2,
            _ordered_product(share, shapes**2), mass, stiffness, viscous, shapes,
        )  # fmt: skip


@dataclass(frozen=True)
class CouplerModes:
    """Modes with the largest effect on the speed of the units.

    Attributes
    ----------
    omega : Array, shape (modes,)
        Frequencies [rad/s].
    damping : Array, shape (modes,)
        Damping ratios.
    mobility : Array, shape (modes,)
        b², acceleration of the units in the mode by a force [1/kg].
    """

    omega: Array
    damping: Array
    mobility: Array

    @classmethod
    def of(cls, model: TrainModel) -> CouplerModes:
        """Return the modes of a train; none if all couplers are rigid, or if no mode moves the units."""
        modes = TrainModes.of(model)
        omega, mobility = modes.omega, modes.mobility
        damping = np.clip(modes.viscous + modes.friction, *DAMPING)
        size = mobility / (4.0 * damping * omega)
        size[mobility < MIN_MOBILITY / model.inertia] = 0.0
        chosen = np.argsort(-size, kind="stable")[:MAX_MODES]
        least = MIN_SHARE * size.max(initial=0.0)
        chosen = np.sort(chosen[(size[chosen] > 0.0) & (size[chosen] >= least)])
        return cls(omega[chosen], damping[chosen], mobility[chosen])

    def outlast(self, gain: float, inertia: float, lag: float) -> bool:
        """Return True if a feedback of the waves can excite a mode at some phase, so at some delay.

        The force g M through the lag on the speed of the units changes the damping rate zeta omega of a mode by at most
        g M b² A/2, A = 1/sqrt(1 + omega² Ta²).

        Parameters
        ----------
        gain
            g, gain on the speed error [1/s].
        inertia
            M [kg].
        lag
            Ta [s].
        """
        passed = 1.0 / np.sqrt(1.0 + (self.omega * lag) ** 2)
        return bool(np.any(0.5 * gain * inertia * self.mobility * passed > self.damping * self.omega))

    def damped_by_loop(self, dead_time: float, *, outlast: bool) -> list[bool]:
        """Return True for every mode that turns by less than a quarter from a measurement to its effect, after [s]."""
        longest = dead_time * (LONGER_DELAY if outlast else 1.0)
        return [omega * longest < 0.5 * math.pi for omega in self.omega.tolist()]


def bandwidth_text(model: TrainModel) -> str:
    """Return the default bandwidth of `mpc` with all its conditions as text."""
    found = default_bandwidth(model)
    if not train_class(model).hauls:
        return found.text
    modes = CouplerModes.of(model)
    if not modes.outlast(2.0 * found.omega, model.inertia, model.lag):
        return found.text
    damped = sum(modes.damped_by_loop(dead_time(model), outlast=True))
    return f"{found.text}; the couplers damp waves little, the law {damped} of {modes.omega.size} kinds of waves"


def body_numbers(model: TrainModel) -> list[int]:
    """Return the number of the body of every vehicle: vehicles with a rigid coupler between them are one."""
    parted = [math.isfinite(mean_stiffness(gear)) for gear in model.consist.gears]
    return [sum(parted[:number]) for number in range(len(model.consist.vehicles))]


def _bodies(model: TrainModel) -> tuple[Array, Array, Array, Array, Array]:
    """Return mass [kg], stiffness [N/m], damping [N s/m], friction damping ratio, and share of the force of bodies."""
    numbers = body_numbers(model)
    gears = [gear for gear in model.consist.gears if math.isfinite(mean_stiffness(gear))]
    mass, share = [0.0] * (len(gears) + 1), [0.0] * (len(gears) + 1)
    shares = dict(zip(model.units, model.share.tolist(), strict=True))
    for number, (vehicle, body) in enumerate(zip(model.consist.vehicles, numbers, strict=True)):
        mass[body] += vehicle.mass * vehicle.rotating_mass_factor
        share[body] += shares.get(number, 0.0)
    stiffness = np.array([mean_stiffness(gear) for gear in gears])
    viscous = np.array([gear.damping if gear.kind == "linear" else 0.0 for gear in gears])
    friction = np.array([friction_damping(gear) for gear in gears])
    return np.array(mass), stiffness, viscous, friction, np.array(share)


def chain(stiffness: Array) -> Array:
    """Return the stiffness matrix of a chain of bodies [N/m], shape (bodies, bodies)."""
    ends = np.concatenate(([0.0], stiffness, [0.0]))
    return np.diag(ends[:-1] + ends[1:]) - np.diag(stiffness, 1) - np.diag(stiffness, -1)


def _ordered_product(row: Array, matrix: Array) -> Array:
    """Return row times matrix, added in order, with the same bits everywhere."""
    total = np.zeros(matrix.shape[1])
    for factor, each in zip(row.tolist(), matrix, strict=True):
        total = total + factor * each
    return total


@lru_cache(maxsize=4)
def _eigenvalues(size: int, symmetric: bytes) -> tuple[Array, Array]:
    """Return :func:`eigenvalues` of the bytes of a matrix; a run takes those of its train ten times."""
    found: tuple[Array, Array] = eigenvalues(np.frombuffer(symmetric).reshape(size, size).copy())
    return found


@compiled
def eigenvalues(symmetric):
    """Return eigenvalues and eigenvectors (columns) of a symmetric matrix by cyclic Jacobi rotations.

    The rotations have one order, so that the bits are the same everywhere. The bits of LAPACK depend on the machine
    (Golub and Van Loan 2013, Matrix Computations, section 8.5).
    """
    a = symmetric.copy()
    size = a.shape[0]
    vectors = np.eye(size)
    total = 0.0
    for i in range(size):
        for j in range(size):
            total += a[i, j] * a[i, j]
    for _ in range(SWEEPS):
        rest = 0.0
        for i in range(size):
            for j in range(i):
                rest += a[i, j] * a[i, j]
        if rest <= 1e-28 * total:
            break
        for p in range(size - 1):
            for q in range(p + 1, size):
                if a[p, q] * a[p, q] <= 1e-36 * total:
                    continue
                half = 0.5 * (a[q, q] - a[p, p]) / a[p, q]
                tangent = (1.0 if half >= 0.0 else -1.0) / (abs(half) + math.sqrt(half * half + 1.0))
                cosine = 1.0 / math.sqrt(tangent * tangent + 1.0)
                sine = tangent * cosine
                for k in range(size):
                    first, second = a[k, p], a[k, q]
                    a[k, p], a[k, q] = cosine * first - sine * second, sine * first + cosine * second
                for k in range(size):
                    first, second = a[p, k], a[q, k]
                    a[p, k], a[q, k] = cosine * first - sine * second, sine * first + cosine * second
                for k in range(size):
                    first, second = vectors[k, p], vectors[k, q]
                    vectors[k, p], vectors[k, q] = cosine * first - sine * second, sine * first + cosine * second
    return np.diag(a).copy(), vectors
