"""A disturbance observer as one compiled function over records, which Python and the compiled loop call alike.

The function has the form ``observer(p, own, position, speed, driven, resistance)``. It returns the acceleration of one
body that the model does not explain [m/s²]. ``p`` has the constants. ``own`` has the values that the observer keeps for
the body, with the balance of the last sample. ``driven`` is the mean driving acceleration since then, and
``resistance`` is the present resistance. :class:`ObserverForm` adds the balance of forces, the guard and the limits.
"""

from dataclasses import dataclass
from math import copysign, isfinite
from typing import Any

import numpy as np
from numba import carray

from plant_sim.compiled import compiled
from plant_sim.record import Records, dtype_of, fill, quantity, zeros
from train_ato.control.guard import all_within
from train_ato.control.law import INVALID, NOT_FINITE, STEPPED, LawNow, LawUnit
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.observers.force_balance import BalanceConstants, ForceBalance, balanced
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.messages.validity import MAX_FORCE, MAX_POSITION, MAX_SPEED


def is_valid_observer_input(inputs: ObserverInput) -> bool:
    """Return True if all inputs of an observer are finite and physically possible."""
    return (
        all_within(inputs.position, MAX_POSITION)
        and all_within(inputs.velocity, MAX_SPEED)
        and all(all_within(force, MAX_FORCE) for force in (inputs.applied, inputs.coupler_force, inputs.shoe_force))
        and -MAX_FORCE <= inputs.train_shoe_force <= MAX_FORCE
    )


class GuardedObserver:
    """Base of the observers: a subclass computes ``estimate()`` for valid inputs, this class handles the others."""

    def __init__(self, parameters: Any, model: TrainModel, period: float) -> None:
        self.parameters = parameters
        GuardedObserver.bind(self, model, period)

    def bind(self, model: TrainModel, period: float) -> None:
        """Take the model of the train and the tick [s]; an observer with keyword parameters has no other start."""
        self.model = model
        self.period = period
        self.n = model.n_units
        self._last_estimate = [0.0] * self.n

    def estimate(self, inputs: ObserverInput) -> list[float]:
        """Return the disturbance force of every unit [N] for valid inputs."""
        raise TypeError(f"{type(self).__name__} has no estimate()")

    def clear_state(self) -> None:
        """Clear the state of the observer."""

    def on_missed_sample(self) -> None:
        """Handle a missed sample: difference quotients must not bridge it."""

    def reset(self) -> None:
        """Clear all state, including the last estimate."""
        self.clear_state()
        self._last_estimate = [0.0] * len(self._last_estimate)

    def step(self, inputs: ObserverInput) -> Array:
        """Return the disturbance force of every unit [N], finite, > 0 forward."""
        if not is_valid_observer_input(inputs):
            self.on_missed_sample()
            return np.array(self._last_estimate)
        found = self.estimate(inputs)
        if all(map(isfinite, found)):
            self._last_estimate = [
                force if -MAX_FORCE <= force <= MAX_FORCE else copysign(MAX_FORCE, force) for force in found
            ]
        else:
            self.clear_state()
        return np.array(self._last_estimate)


@dataclass
class Body:
    """State of a body of the balance: a unit's vehicle or the train."""

    mass: float = quantity("kg", "inertia")
    known: bool = quantity("", "the values of the last sample are known")
    speed: float = quantity("m/s", "speed at the last sample")
    drive: float = quantity("m/s²", "driving acceleration at the last sample")
    resistance: float = quantity("m/s²", "resisting acceleration at the last sample")
    unexplained: float = quantity("m/s²", "estimate of the acceleration that the model does not explain")


@compiled
def are_measured(now: LawNow, units: Records[LawUnit]) -> bool:
    """Return True if all inputs of an observer are finite and physically possible."""
    for x in units:
        if not (abs(x.position) <= MAX_POSITION and abs(x.velocity) <= MAX_SPEED):
            return False
        if not (abs(x.applied) <= MAX_FORCE and abs(x.shoe_force) <= MAX_FORCE):
            return False
    return abs(now.train_shoe_force) <= MAX_FORCE and now.sensed_force <= MAX_FORCE


@compiled
def limit_estimates(p: BalanceConstants, state: Records[Body], units: Records[LawUnit]) -> bool:
    """Write the estimates of all units, limited; return False, without a change, if one is not finite."""
    for own in state:
        if not isfinite(own.mass * own.unexplained):
            return False
    for u in range(units.size):
        own = state[0 if p.whole_train else u]
        force = own.mass * own.unexplained * (units[u].share if p.whole_train else 1.0)
        units[u].disturbance = min(max(force, -MAX_FORCE), MAX_FORCE)
    return True


class ObserverForm:
    """The forms in which an observer is called.

    Parameters
    ----------
    observer
        Compiled function ``observer(p, own, position, speed, driven, resistance)``.
    constants, body
        Records of its constants and of its state for a body.

    Attributes
    ----------
    step
        The guarded observer, on arrays of records; returns ``STEPPED``, ``INVALID`` or ``NOT_FINITE``.
    entry
        The same for the compiled loop, by addresses: all observers have one type there.
    """

    def __init__(self, observer: Any, constants: type, body: type) -> None:
        self.constants, self.body = constants, body

        @compiled
        def step(all_p: Any, state: Any, now: Any, units: Any) -> int:
            p = all_p[0]
            if not are_measured(now[0], units):
                return INVALID
            for index in range(state.size):
                own = state[index]
                speed, drive, resistance = balanced(p, own.mass, index, now[0], units)
                driven = p.weight * (own.drive if own.known else drive) + (1.0 - p.weight) * drive
                own.unexplained = observer(p, own, units[index].position, speed, driven, resistance)
                own.speed, own.drive, own.resistance, own.known = speed, drive, resistance, True
            return STEPPED if limit_estimates(p, state, units) else NOT_FINITE

        constant_fields, body_fields = dtype_of(constants), dtype_of(body)
        now_fields, input_fields = dtype_of(LawNow), dtype_of(LawUnit)

        @compiled
        def entry(p: Any, state: Any, bodies: int, now: Any, units: Any, n: int) -> int:
            records = carray(now, (1,), now_fields), carray(units, (n,), input_fields)
            return int(
                step(carray(p, (1,), constant_fields), carray(state, (bodies,), body_fields), records[0], records[1])
            )

        self.step, self.entry = step, entry


class RecordObserver(GuardedObserver):
    """Base of the observers over records: a subclass gives ``form`` and the values of its constants.

    A subclass with an ``estimate()`` of its own is an observer in Python, with the guard of :class:`GuardedObserver`.

    Parameters
    ----------
    parameters
        Parameters of the observer.
    model
        The nominal train.
    period
        Tick [s].
    balance
        Balance of forces.
    more
        Constants beside the parameters and those of the balance.

    Attributes
    ----------
    constants, state : Records
        Constants, and state of every body.
    balance : ForceBalance
        Balance with the inputs; its units have the last estimate.
    """

    form: ObserverForm

    def __init_subclass__(cls) -> None:
        if "estimate" in vars(cls):
            cls.step = GuardedObserver.step  # type: ignore[method-assign]

    def __init__(self, parameters: Any, model: TrainModel, period: float, balance: ForceBalance, **more: float) -> None:
        super().__init__(parameters, model, period)
        self.balance = balance
        self.constants, self.state = zeros(self.form.constants, 1), zeros(self.form.body, balance.count)
        known = {name: balance.constants[name] for name in balance.constants.dtype.names}
        fill(self.constants, parameters, **known, **more)
        self.clear_state()

    def clear_state(self) -> None:
        """Set the estimates to 0 and restart at the next sample."""
        self.state[:] = 0
        self.state["mass"] = self.balance.mass

    def on_missed_sample(self) -> None:
        """Handle a missed sample: restart at the next one with the present estimates."""
        self.state["known"] = False

    def reset(self) -> None:
        """Clear all state, including the last estimate."""
        super().reset()
        self.balance.units["disturbance"] = 0.0

    def step(self, inputs: ObserverInput) -> Array:
        """Return the disturbance force of every unit [N], finite, > 0 forward."""
        balance = self.balance
        balance.fill(inputs)
        found = self.form.step(self.constants, self.state, balance.now, balance.units)
        if found == INVALID:
            self.on_missed_sample()
        elif found == NOT_FINITE:
            self.clear_state()
        estimate: Array = balance.units["disturbance"].copy()
        return estimate
