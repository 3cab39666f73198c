"""Policies of the air brake as arrays of their compiled steps, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from train_ato.control.air_brake.policy import PlannedBrake, ReleasedBrake, TriggeredBrake
from train_ato.control.air_brake.predictive_policy import PredictiveBrake
from train_ato.control.air_brake.trip_policy import TripBrake
from train_ato.control.algorithms.force_shares import PAIRWISE
from train_ato.control.compiled import brake_policies as c
from train_ato.control.train_model import STANDSTILL_SPEED
from train_ato.messages.types import Array

_STEPS = {kind: kind.step for kind in (ReleasedBrake, PlannedBrake, TripBrake, TriggeredBrake, PredictiveBrake)}
"""Steps with a compiled form: a step that a program replaces at run time has none."""


_STATES = (
    "_next", "_pressure", "_reduction", "_planned", "_stood", "_since", "_released_at", "_applied_at", "_release_below",
    "_changed_at", "_due", "_before",
)  # fmt: skip
"""Attributes of the policies that change during a run."""


def has_compiled_policy(policy: Any, units: int) -> bool:
    """Return True for a policy with a compiled form, for `trip` with few units.

    From :data:`~train_ato.control.algorithms.force_shares.PAIRWISE` units on, numpy adds forces in another order.
    """
    if _STEPS.get(type(policy)) is not type(policy).step:
        return False
    return type(policy) is not TripBrake or units < PAIRWISE


def has_same_state(policy: Any, other: Any) -> bool:
    """Return True for two policies of one kind in the same state."""
    return all(getattr(policy, name, None) == getattr(other, name, None) for name in _STATES)


class CompiledPolicy:
    """Constants and state of a policy as arrays, between two of its events.

    Parameters
    ----------
    policy
        Policy with a compiled form.

    Attributes
    ----------
    number : int
        Number of the policy in :mod:`train_ato.control.compiled.brake_policies`.
    constant, state : Array
        Constants, and state that changes between the events.
    steep : Array, shape (segments, 2)
        Begin and end of the steep segments of `trigger` [m].
    """

    def __init__(self, policy: Any) -> None:
        self._policy = policy
        self.number, self.constant, self.state, self.steep = c.PLANNED, np.zeros(0), np.zeros(0), np.zeros((0, 2))
        if isinstance(policy, TripBrake):
            self.number, self.constant = c.TRIP, _trip_constants(policy)
            since = policy._since
            self.state = np.array([since is not None, since or 0.0, policy._stood], dtype=np.float64)
        elif isinstance(policy, TriggeredBrake):
            self.number, self.constant = c.TRIGGER, _trigger_constants(policy)
            self.steep = np.array(policy._steep, dtype=np.float64).reshape(-1, 2)

    @property
    def arrays(self) -> tuple[int, Array, Array, Array]:
        """Number, constants, state and steep segments."""
        return self.number, self.constant, self.state, self.steep

    def store(self, *policies: Any) -> None:
        """Set the state of the policy and of its copies to that of the array."""
        if self.number != c.TRIP:
            return
        known, since, stood = self.state.tolist()
        for policy in policies:
            policy._since, policy._stood = since if known else None, bool(stood)


def _trip_constants(policy: TripBrake) -> Array:
    rules, constant = policy._rules, np.zeros(c.TRIP_ENTRIES)
    constant[[c.APPLIED, c.IS_PLANNED, c.RELEASED_AT]] = policy._reduction != 0.0, policy._planned, policy._released_at
    if policy._next < len(policy._applications):
        following = policy._applications[policy._next]
        constant[[c.HAS_NEXT, c.APPLY, c.RELEASE, c.ELECTRIC_AT_APPLY, c.ELECTRIC_AT_RELEASE]] = (
            1.0, following.apply, following.release, following.electric_at_apply, following.electric_at_release,
        )  # fmt: skip
    constant[c.SHIFT :] = (
        rules.shift, rules.call, rules.ease, rules.after, rules.tolerance, rules.pause, rules.never_below,
        rules.release_margin, STANDSTILL_SPEED,
    )  # fmt: skip
    return constant


def _trigger_constants(policy: TriggeredBrake) -> Array:
    rules, below, applied_at = policy._rules, policy._release_below, policy._applied_at
    return np.array((
        below is not None, below or 0.0, applied_at is not None, applied_at or 0.0, rules.pause, rules.never_below,
        rules.min_speed, rules.lookahead, rules.min_length, rules.segments,
    ), dtype=np.float64)  # fmt: skip
