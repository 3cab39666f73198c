"""Compiled policies of the air brake between two of their events, with the operations of the Python policies.

A step that changes the pressure or the next application is left to Python; the caller then restores the state.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

from plant_sim.compiled import compiled

PLANNED, TRIP, TRIGGER = range(3)
"""Policies with a compiled form; the events of `planned` are known before the span."""
# Entries of `state` of trip.
HAS_SINCE, SINCE, STOOD = range(3)
# Entries of `constant` of trip: state between events, next application, rules.
(
    APPLIED, IS_PLANNED, RELEASED_AT, HAS_NEXT, APPLY, RELEASE, ELECTRIC_AT_APPLY, ELECTRIC_AT_RELEASE, SHIFT, CALL,
    EASE, AFTER, TOLERANCE, PAUSE, NEVER_BELOW, RELEASE_MARGIN, STANDSTILL,
) = range(17)  # fmt: skip
TRIP_ENTRIES = 17
# Entries of `constant` of trigger.
(
    HAS_RELEASE, RELEASE_BELOW, HAS_APPLIED, APPLIED_AT, REST, LOWEST_RELEASE, MIN_SPEED, LOOKAHEAD, MIN_LENGTH,
    SEGMENTS,
) = range(10)  # fmt: skip


@compiled
def _lasts(constant, state, condition, t):
    if not condition:
        state[HAS_SINCE] = 0.0
    elif state[HAS_SINCE] == 0.0:
        state[HAS_SINCE], state[SINCE] = 1.0, t
    return state[HAS_SINCE] > 0.0 and t - state[SINCE] >= constant[AFTER]


@compiled
def _trip_applies(constant, state, t, position, velocity, share):
    """Return True for an application, or a next application that is passed without need."""
    full, following = _lasts(constant, state, share >= constant[CALL], t), constant[HAS_NEXT] > 0.0
    if following and position >= constant[RELEASE]:
        return True
    if following and position >= constant[APPLY] - constant[SHIFT]:
        spared = share < constant[ELECTRIC_AT_APPLY] - constant[TOLERANCE]
        return full or position >= constant[APPLY] + (constant[SHIFT] if spared else 0.0)
    return full and t - constant[RELEASED_AT] >= constant[PAUSE] and velocity >= constant[NEVER_BELOW]


@compiled
def _trip_releases(constant, state, t, position, velocity, share, applied):
    """Return True for a release."""
    if abs(velocity) < constant[STANDSTILL]:
        state[STOOD] = 1.0
    due = False
    if velocity >= constant[NEVER_BELOW]:
        if constant[IS_PLANNED] == 0.0:
            due = _lasts(constant, state, share <= constant[EASE], t)
        else:
            pulling = _lasts(constant, state, share < 0.0, t)
            slow = velocity <= constant[NEVER_BELOW] + constant[RELEASE_MARGIN]
            strained = share > constant[ELECTRIC_AT_RELEASE] + constant[TOLERANCE]
            late = position >= constant[RELEASE] + (constant[SHIFT] if strained else 0.0)
            due = position >= constant[RELEASE] - constant[SHIFT] and (pulling or slow or late)
    return due or (state[STOOD] > 0.0 and applied > 0.0)


@compiled
def _trigger_changes(constant, steep, t, position, velocity):
    """Return True for an application or a release by the rules of paper 000."""
    if constant[HAS_RELEASE] > 0.0:
        return constant[LOWEST_RELEASE] <= velocity <= constant[RELEASE_BELOW]
    rested = constant[HAS_APPLIED] == 0.0 or t - constant[APPLIED_AT] >= constant[REST]
    if not (rested and velocity > constant[MIN_SPEED]):
        return False
    found, horizon = 0, position + constant[LOOKAHEAD]
    for row in range(len(steep)):
        begin, end = steep[row, 0], steep[row, 1]
        inside = (end if end < horizon else horizon) - (begin if begin > position else position)
        found += inside > constant[MIN_LENGTH]
    return found >= constant[SEGMENTS]


@compiled
def changes_pressure(policy, constant, state, steep, t, position, velocity, applied, available):
    """Step a policy between two events; return True for a step that is left to Python.

    Parameters
    ----------
    policy
        Number of the policy.
    constant, state, steep
        Arrays of :class:`train_ato.control.compiled.policy_packing.CompiledPolicy`.
    t, position, velocity, applied
        Time [s], position of vehicle 0's centre [m], speed [m/s], measured force of all power units [N].
    available
        Largest force of the electric brake of all power units at the speed [N].
    """
    if policy == TRIGGER:
        return _trigger_changes(constant, steep, t, position, velocity)
    if policy != TRIP:
        return False
    share = -applied / available if available > 0.0 else 0.0
    if constant[APPLIED] > 0.0:
        return _trip_releases(constant, state, t, position, velocity, share, applied)
    return _trip_applies(constant, state, t, position, velocity, share)
