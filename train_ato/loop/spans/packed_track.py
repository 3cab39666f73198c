"""Supervision limits of a train on a line as arrays, for the compiled supervision."""

from __future__ import annotations

import numpy as np

from train_ato.loop.spans import limits_kernel as c
from train_ato.messages.types import Array
from train_ato.supervision.deceleration_curve import DecelerationCurve
from train_ato.supervision.limits import TargetLimits
from train_ato.supervision.track_supervision import WIDEST_MOTION, TrackSupervision

TrackArrays = tuple[Array, Array, Array, Array, Array]
"""Starts of the ceilings, ceilings, targets, arcs of all curves, and the widest motion."""


def packed_track(track: TrackSupervision) -> TrackArrays:
    """Return the limits of a train as arrays.

    Parameters
    ----------
    track
        Limits without a release speed.

    Returns
    -------
    starts : Array, shape (limits,)
        Begin of every ceiling but the first [m].
    ceilings : Array, shape (limits + 1, 4)
        Ceiling speeds [m/s].
    targets : Array, shape (targets, :data:`train_ato.loop.spans.limits_kernel.TARGET_COLUMNS`)
        Constants of the targets, by the columns of :mod:`train_ato.loop.spans.limits_kernel`.
    curves : Array, shape (arcs, 3)
        Speed [m/s], location [m] and deceleration [m/s²] of the arcs.
    widest : Array, shape (3,)
        Motion above which all targets are evaluated: acceleration [m/s²], errors of speed [m/s] and position [m].

    Raises
    ------
    ValueError
        For limits with a release speed, which the compiled limits lack.
    """
    if track._release is not None:
        raise ValueError("supervision: a release speed has no compiled form; run the supervision in Python")
    arcs: list[tuple[float, float, float]] = []
    targets = np.zeros((len(track.targets), c.TARGET_COLUMNS))
    for row, limits, begin in zip(targets, track.targets, track._begins, strict=True):
        row[:] = _target_row(limits, begin, arcs)
    widest = (WIDEST_MOTION.acceleration, WIDEST_MOTION.speed_error, WIDEST_MOTION.under_reading)
    return (
        np.array(track._starts, dtype=np.float64),
        np.array(track._ceilings, dtype=np.float64).reshape(-1, 4),
        targets,
        np.array(arcs, dtype=np.float64).reshape(-1, 3),
        np.array(widest),
    )


def _target_row(limits: TargetLimits, begin: float, arcs: list[tuple[float, float, float]]) -> Array:
    """Return the constants of a target; add the arcs of its curves."""
    times, fixed, target = limits.times, limits.fixed, limits.target
    braking = times.traction + times.remaining
    service = braking + times.bs2
    row = np.zeros(c.TARGET_COLUMNS)
    values = {
        c.LOCATION: target.location, c.TARGET_SPEED: target.speed, c.IS_END: target.kind == "EOA",
        c.SPEED_LIMIT: limits.speed_limit, c.TRACTION: times.traction, c.REMAINING: times.remaining,
        c.BS1: times.bs1, c.BS2: times.bs2, c.INDICATION_TIME: fixed.t_driver + times.indication,
        c.PERMITTED_TIME: service + fixed.t_driver, c.WARNING_TIME: service + fixed.t_warning,
        c.SERVICE_TIME: service, c.EMERGENCY_TIME: braking, c.SBD_PERMITTED_TIME: times.bs1 + fixed.t_driver,
        c.SBD_WARNING_TIME: times.bs1 + fixed.t_warning, c.BEGIN: begin, c.SBD_FIRST: -1.0,
    }  # fmt: skip
    row[list(values)] = list(values.values())
    row[[c.EBD_FIRST, c.EBD_END, c.EBD_TOP]] = _add_curve(limits.ebd, arcs)
    if limits.sbd is not None:
        row[[c.SBD_FIRST, c.SBD_END, c.SBD_TOP]] = _add_curve(limits.sbd, arcs)
    row[c.FLOOR :] = limits.floor
    return row


def _add_curve(curve: DecelerationCurve, arcs: list[tuple[float, float, float]]) -> tuple[float, float, float]:
    """Add the arcs of a curve; return its first one, its end, and its largest speed [m/s]."""
    first = len(arcs)
    arcs += zip(curve.speeds, curve.locations, curve.decelerations, strict=True)
    return float(first), float(len(arcs)), curve.end_speed
