"""A policy of the air brake as one compiled function over records, which Python and the compiled loop call alike.

The function has the form ``policy(p, state, rows, now)`` and returns the reduction of the brake pipe [Pa]. ``p`` has
the rules, ``state`` what the policy keeps, ``rows`` its events, applications or segments, ``now`` the measurement.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from struct import Struct
from typing import Any, ClassVar

import numpy as np
from numba import carray
from numpy.typing import NDArray

from plant_sim.compiled import compiled
from plant_sim.elementary import numpy_total
from plant_sim.railway import envelope_force
from plant_sim.record import dtype_of, fill, quantity, zeros
from train_ato.control.train_model import RELEASE_FORCE, STANDSTILL_SPEED, TrainModel
from train_ato.messages.types import Array


@dataclass
class BrakeNow:
    """Measurement of a step."""

    t: float = quantity("s", "time")
    position: float = quantity("m", "position of vehicle 0's centre")
    velocity: float = quantity("m/s", "speed")
    applied: float = quantity("N", "measured force of all power units, < 0 braking")
    available: float = quantity("N", "largest force of the electric brake of all power units at the speed")


@dataclass
class NoRules:
    """Rules of a policy without any, and its rows."""

    unused: bool = quantity("", "unused")


@compiled
def used_share(now: BrakeNow) -> float:
    """Return the used part of the electric brake."""
    return -now.applied / now.available if now.available > 0.0 else 0.0


@compiled
def lasts(state: Any, condition: bool, t: float, after: float) -> bool:
    """Return True if a condition has lasted for a time [s]; ``state.since`` is its begin, infinite without one."""
    if not condition:
        state.since = inf
    elif state.since == inf:
        state.since = t
    return bool(t - state.since >= after)


AT_REST = 10.0
"""Time at standstill after which the wagons have run in, and traction is a departure [s]."""
DEPARTING = 1.5
"""Speed with traction, after a standstill of any length, above that of a locomotive whose wagons run in [m/s]."""


@compiled
def departs(state: Any, t: float, velocity: float, applied: float) -> bool:
    """Return True for traction after a standstill; ``state.rest`` is its begin or the last motion, infinite before."""
    stood, pulls = t - state.rest >= AT_REST, applied > 0.5 * RELEASE_FORCE  # the lag of a force never ends
    if abs(velocity) < STANDSTILL_SPEED:
        state.rest = min(state.rest, t)
    elif state.rest < inf and not (stood and pulls):
        state.rest = t
    return bool(pulls and (stood or (state.rest < inf and velocity >= DEPARTING)))


@compiled
def electric_brake_available(limits: Array, segments: NDArray[np.int64], speed: float) -> float:
    """Return the largest force of the electric brake of all units [N] at a speed >= 0 [m/s]; 0 without segments."""
    forces = np.empty(len(segments))
    for u in range(len(segments)):
        forces[u] = envelope_force(limits, segments[u, 0], segments[u, 1], speed)
    return float(numpy_total(forces))


_pack_now = Struct(f"{len(dtype_of(BrakeNow).fields or ())}d").pack_into


class PolicyForm:
    """The forms in which a policy is called.

    Parameters
    ----------
    policy
        Compiled function ``policy(p, state, rows, now)``.
    constants, state, row
        Records of its rules, its state and its rows.

    Attributes
    ----------
    step
        The policy on arrays of records.
    entry
        The same for the compiled loop, by addresses: all policies have one type there.
    """

    def __init__(self, policy: Any, constants: type, state: type, row: type) -> None:
        self.constants, self.state, self.row = constants, state, row
        constant_fields, state_fields, row_fields = dtype_of(constants), dtype_of(state), dtype_of(row)
        now_fields = dtype_of(BrakeNow)

        @compiled
        def step(p: Any, state: Any, rows: Any, now: Any) -> float:
            return float(policy(p[0], state[0], rows, now[0]))

        @compiled
        def entry(p: Any, state: Any, rows: Any, count: int, now: Any) -> float:
            known = carray(p, (1,), constant_fields), carray(state, (1,), state_fields)
            return float(step(known[0], known[1], carray(rows, (count,), row_fields), carray(now, (1,), now_fields)))

        self.step, self.entry = step, entry


class BrakePolicy:
    """Base of the policies over records: a subclass gives ``form`` and its values.

    Parameters
    ----------
    charged
        Pressure of the charged brake pipe [Pa].
    rules
        Values of the rules.
    rows
        Values of every row, in the order of its fields.
    model
        The nominal train, whose limits give the available electric brake; None for a policy that does not use it.

    Attributes
    ----------
    constants, state, rows, now : Records
        Rules, state, rows and measurement.
    limits, segments : Array
        Envelopes of the units, see :class:`train_ato.control.train_model.TrainModel`; empty without a model.
    """

    form: ClassVar[PolicyForm]

    def __init__(
        self, charged: float, rules: Any, rows: Sequence[tuple[float, ...]] = (), model: TrainModel | None = None
    ) -> None:
        self.charged = charged
        self.constants, self.state = zeros(self.form.constants, 1), zeros(self.form.state, 1)
        self.rows, self.now = zeros(self.form.row, len(rows)), zeros(BrakeNow, 1)
        fill(self.constants, rules)
        for index, values in enumerate(rows):
            self.rows[index] = values
        none = np.zeros((0, 4)), np.zeros((0, 4), np.int64)
        self.limits, self.segments = none if model is None else model.envelopes

    def step(self, t: float, position: float, velocity: float, applied: float = 0.0) -> float:
        """Return the pressure demanded [Pa]; ``applied`` is the measured force of all units [N], < 0 braking."""
        available = electric_brake_available(self.limits, self.segments, abs(velocity)) if len(self.segments) else 0.0
        _pack_now(self.now, 0, t, position, velocity, applied, available)
        return self.charged - float(self.form.step(self.constants, self.state, self.rows, self.now))
