"""Linear model of a train on level line at a constant speed, with the delays of the commands apart.

The bodies are those of the coupler modes (:mod:`train_ato.control.algorithms.coupler_modes`): vehicles, joined where
the coupler between them is rigid, with the mean stiffness of the draft gears. x are the displacements of the bodies
from their motion at the constant speed, and v are the speeds of the displacements. f are the deviations of the forces
from the forces that keep this speed::

    x' = v,  M v' = -K x - (C + Phi' + R) v + B f,  Ta f' = u(t - tau) - f

C are the dampers, R the slope of the running resistance, and Phi' the friction in the gears with its damping ratio in
every mode. Slack and preload are not in the model.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant_sim.railway import DRY_FRICTION_SPEED
from plant_sim.units import KMH
from train_ato.control.algorithms.coupler_modes import TrainModes, body_numbers, chain
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.program.errors import check_packages, refusing

Signal = tuple[str, str]
"""Name and unit."""


@dataclass(frozen=True, repr=False)
class LinearTrain:
    """Linear model ``z' = A z + B u(t - delay)``, ``y = C z + D u(t - delay)``.

    Attributes
    ----------
    A, B, C, D : Array
        Matrices of shapes (states, states), (states, units), (outputs, states), (outputs, units).
    states, inputs, outputs : tuple of (str, str)
        Names and units. States: displacement and speed of every body, force of every unit with a lag. Inputs: commands
        of the units. Outputs: displacement and speed of every unit, force of every coupler that is not rigid (> 0
        draft). All are deviations from the motion at the constant speed.
    delay, delay_brake : Array, shape (units,)
        Delay of the commands in traction and in braking [s].
    speed : float
        Constant speed [m/s].
    force : float
        Force of all units at this speed on level line [N].
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    delay: Array
    delay_brake: Array
    speed: float
    force: float

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Eigenvalues of A [rad/s]."""
        return np.linalg.eigvals(self.A).astype(np.complex128)

    def __repr__(self) -> str:
        poles = sorted(self.poles, key=abs)  # the first one is 0: the place of the train on level line
        worst = max(pole.real for pole in poles[1:])
        return f"{'stable' if worst < 0.0 else 'unstable'} at {KMH * self.speed:.4g} km/h, besides the free place"

    def _repr_html_(self) -> str:
        rows = (
            f"<tr><td>{name}</td><td>{delay:.4g} s</td><td>{braking:.4g} s</td></tr>"
            for (name, _), delay, braking in zip(self.inputs, self.delay, self.delay_brake, strict=True)
        )
        return (
            f"<p><b>{self!r}</b></p><p>{len(self.states)} states, {len(self.outputs)} outputs</p><table><tr>"
            f"<th>input</th><th>delay in traction</th><th>in braking</th></tr>{''.join(rows)}</table>"
        )

    @refusing
    def response(self, omega: Any, *, braking: bool = False) -> NDArray[np.complex128]:
        """Return the frequency response with the delays, shape (frequencies, outputs, units).

        Parameters
        ----------
        omega : Array, shape (frequencies,)
            Frequencies [rad/s], not 0: a constant force moves the train without an end.
        braking
            True: with the delays in braking.

        Raises
        ------
        ValueError
            For a frequency that is 0 or no finite number.
        """
        try:
            frequencies = np.atleast_1d(np.asarray(omega, dtype=np.float64))
        except (TypeError, ValueError, OverflowError):
            frequencies = np.zeros(1)
        if not (np.isfinite(frequencies).all() and frequencies.all()):
            raise ValueError(f"response: omega {str(omega)[:60]}: give finite frequencies [rad/s] other than 0")
        late = self.delay_brake if braking else self.delay
        unit = np.eye(len(self.A))
        found = [
            (self.C @ np.linalg.solve(1j * w * unit - self.A, self.B) + self.D) * np.exp(-1j * w * late)
            for w in frequencies.ravel()
        ]
        return np.array(found)

    def scipy(self) -> Any:
        """Return the model without delays as :class:`scipy.signal.StateSpace`."""
        check_packages("scipy()", "scipy")
        from scipy.signal import StateSpace

        return StateSpace(self.A, self.B, self.C, self.D)

    @refusing
    def control(self) -> Any:
        """Return the model without delays as ``control.StateSpace`` with the names of all signals.

        Raises
        ------
        ValueError
            If python-control is not installed.
        """
        try:
            import control
        except ImportError:
            raise ValueError("python-control is not installed; run: pip install control") from None
        names = [[name for name, _ in signals] for signals in (self.states, self.inputs, self.outputs)]
        return control.ss(self.A, self.B, self.C, self.D, states=names[0], inputs=names[1], outputs=names[2])

    @classmethod
    def of(cls, model: TrainModel, speed: float) -> "LinearTrain":
        """Return the linear model of a train at a speed > 0 [m/s]."""
        modes, numbers = TrainModes.of(model), body_numbers(model)
        bodies, units, lag = len(modes.mass), model.n_units, model.lag
        slope = np.zeros(bodies)
        for number, body in enumerate(numbers):
            slope[body] += _resistance_slope(model, number, speed)
        damping = chain(modes.dampers) + np.diag(slope) + modes.friction_matrix
        driven = np.zeros((bodies, units))
        driven[[numbers[unit] for unit in model.units], range(units)] = 1.0
        lagged = units if lag > 0.0 else 0
        a = np.zeros((2 * bodies + lagged,) * 2)
        a[:bodies, bodies : 2 * bodies] = np.eye(bodies)
        a[bodies : 2 * bodies, : 2 * bodies] = -np.hstack((chain(modes.stiffness), damping)) / modes.mass[:, None]
        b = np.zeros((len(a), units))
        force = driven / modes.mass[:, None]
        if lagged:
            a[bodies : 2 * bodies, 2 * bodies :] = force
            a[2 * bodies :, 2 * bodies :], b[2 * bodies :] = -np.eye(units) / lag, np.eye(units) / lag
        else:
            b[bodies:] = force
        stretch = np.eye(bodies)[:-1] - np.eye(bodies)[1:]
        couplers = np.hstack((modes.stiffness[:, None] * stretch, modes.dampers[:, None] * stretch))
        c = np.zeros((2 * units + len(couplers), len(a)))
        c[:units, :bodies] = c[units : 2 * units, bodies : 2 * bodies] = driven.T
        c[2 * units :, : 2 * bodies] = couplers
        names = [f"vehicle_{numbers.index(body)}" for body in range(bodies)]
        of_units = [f"unit_{unit}" for unit in range(units)]
        ends = [numbers.index(body + 1) - 1 for body in range(bodies - 1)]
        return cls(
            a, b, c, np.zeros((len(c), units)),
            (*((f"{name}_displacement", "m") for name in names), *((f"{name}_speed", "m/s") for name in names),
             *((f"{name}_force", "N") for name in of_units[:lagged])),
            tuple((f"{name}_command", "N") for name in of_units),
            (*((f"{name}_displacement", "m") for name in of_units), *((f"{name}_speed", "m/s") for name in of_units),
             *((f"coupler_{vehicle}_force", "N") for vehicle in ends)),
            model.delay, model.delay_brake, speed, model.running_resistance(speed),
        )  # fmt: skip


def _resistance_slope(model: TrainModel, number: int, speed: float) -> float:
    """Return the derivative of the running resistance of a vehicle by its speed [N s/m]."""
    vehicle = model.consist.vehicles[number]
    c0, c1, c2 = vehicle.resistance.polynomial(vehicle.mass, model.consist.gravity)
    fading = math.tanh(speed / DRY_FRICTION_SPEED)
    size = c0 + c1 * speed + c2 * speed**2
    return (c1 + 2.0 * c2 * speed) * fading + size * (1.0 - fading**2) / DRY_FRICTION_SPEED
