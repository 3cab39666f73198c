"""Outcome of tracking: tracked, or the deviation of the train from its reference with the figure that decided.

=============== ======================================================================================================
no command      the commands pause, or end before the run, by more than the age of a command at which the train coasts;
                in a failed run by any time
never departed  the reference left a stop for longer than ``departure_time``, the train stayed at rest
lost            the position error exceeds the way of ``position_time`` at the largest speed of the profile, at the end
                of the run or beyond the error at the start; or the speed error exceeds the emergency-brake margin of
                SUBSET-026 (3.13.9.2) in half of the time, or with one sign in the last ``position_time``
limit cycle     sustained oscillation of a command (:mod:`train_ato.loop.oscillation`); no disturbance has its period
disengaged      the ATO was not engaged at the end
not stopped     no standstill at a planned stop, outside of the stop window ``position_time`` after the arrival
stopped beyond  the train came to rest beyond a target by more than the stop window
stopped short   the same, short of it
saturated       the force was at a limit, and the train too slow at the upper or too fast at the lower one, for
                longer than ``saturation_time``
=============== ======================================================================================================

Only ticks with an engaged ATO count.  The limits are in the block ``criteria.tracking`` of a scenario
(:class:`train_ato.scenario.criteria.TrackingLimits`), with the reasons of their defaults.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.control.train_model import STANDSTILL_SPEED
from train_ato.loop.force_limit import time_at_force_limit
from train_ato.loop.oscillation import Oscillation, share_at_period, sustained_oscillation
from train_ato.loop.recording import ATO_STATE, DISTURBANCE, Recording
from train_ato.loop.setup import RunSetup
from train_ato.loop.stops import stops_of_run
from train_ato.loop.verdict import three_digits
from train_ato.messages.types import Array, AtoState
from train_ato.scenario.criteria import TrackingLimits
from train_ato.supervision.ceiling import EMERGENCY_MARGIN

RESUMED = 2.0
"""Time after the ATO was engaged again in which its new profile arrives [s]; not evaluated."""


class EngagedRun:
    """Ticks with an engaged ATO, with the errors of k ticks and the limits of the outcome of tracking.

    Attributes
    ----------
    setup, recording
        The run and its recording.
    limits : TrackingLimits
        Limits of the scenario.
    engaged : ndarray of bool, shape (k,)
        True for the ticks with an engaged ATO.
    top_speed : float
        Largest speed of the profile [m/s].
    """

    def __init__(self, setup: RunSetup, recording: Recording) -> None:
        self.setup = setup
        self.recording = recording
        self.limits: TrackingLimits = setup.scenario.criteria.tracking
        self.engaged = engaged_ticks(recording)
        self.top_speed = float(np.abs(setup.profile.velocity).max())

    @cached_property
    def rows(self) -> NDArray[np.intp]:
        """Ticks with an engaged ATO."""
        return np.flatnonzero(self.engaged)

    @cached_property
    def at_end(self) -> bool:
        """True if the ATO is engaged at the end."""
        return bool(self.engaged[-1])

    @cached_property
    def direction(self) -> Array:
        """Direction of the reference at every tick, at rest that of the last motion: 1 or -1."""
        sign = np.sign(self.recording.reference_velocity)
        last = np.maximum.accumulate(np.where(sign != 0, np.arange(sign.size), 0))
        return np.where(sign[last] < 0, -1.0, 1.0)

    @cached_property
    def position_error(self) -> Array:
        """Largest position error of all units at every tick, > 0 ahead [m], shape (k,)."""
        recording = self.recording
        reference = recording.reference_position[:, None]
        units = self.setup.layout.n_units
        error = (
            recording.position + self.setup.model.offsets - reference
            if units
            else recording.front_position[:, None] - reference
        )
        worst = np.abs(error).argmax(axis=1)
        return np.asarray(error[np.arange(worst.size), worst]) * self.direction

    @cached_property
    def speed_error(self) -> Array:
        """Speed error of vehicle 0 at every tick, > 0 too fast [m/s], shape (k,).

        Its speed is the derivative of its position, with the drift of paper 002.
        """
        recording = self.recording
        if recording.time.size < 2:
            return np.zeros(recording.time.size)
        speed = np.gradient(recording.front_position, recording.time)
        return np.asarray((speed - recording.reference_velocity) * self.direction)

    def end_text(self, row: int) -> str:
        """Return the time of a tick in words."""
        return "at the end" if row == self.engaged.size - 1 else f"at {self.recording.time[row]:.0f} s"


def engaged_ticks(recording: Recording) -> NDArray[np.bool_]:
    """Return True for the ticks with an engaged ATO, without the time in which a new profile arrives, shape (k,)."""
    time, states = recording.time, recording.of(ATO_STATE, "state")
    if states is None or not states[0].size:
        return np.ones(time.size, dtype=bool)
    row = np.maximum(np.searchsorted(states[0], time, side="right") - 1, 0)
    engaged = states[1][row, 0] == float(AtoState.ENGAGED)
    for resumed in time[1:][engaged[1:] & ~engaged[:-1]]:
        engaged &= (time < resumed) | (time >= resumed + RESUMED)
    return np.asarray(engaged)


TRACKED = "tracked"
"""Outcome of a run without a finding."""
OUTCOMES = (
    "no command", "never departed", "lost", "limit cycle", "disengaged", "not stopped", "stopped beyond",
    "stopped short", "saturated", TRACKED,
)  # fmt: skip
"""Outcomes, the worst first."""
INCOMPLETE = "log incomplete"
"""Outcome of a run whose recorder lost messages."""
DEFAULT_STOP_WINDOW = 12.0
"""Stop window of a scenario without one [m]: default accuracy of a location, Q_NVLOCACC of SUBSET-026, A.3.2."""
LONGEST_PERIOD = 20.0
"""Longest period of a limit cycle over the dead time of the loop.  A relay with an integrator and dead time oscillates
with 4 dead times, a slow controller at its stability limit with more; hills of the line are slower."""

FORCED_SHARE = 0.5
"""Part of the variance of a disturbance at the period of an oscillation above which the disturbance is its cause."""
SMALLEST_DRIFT = 0.01
"""Smallest standard deviation of a drift speed [m/s]; an integration of the plant over a tick has less."""


@dataclass(frozen=True)
class TrackingFinding:
    """Deviation from the reference.

    Attributes
    ----------
    outcome
        Entry of :data:`OUTCOMES`.
    value, limit, unit
        Figure that decided, its limit, and their unit.
    text
        Figure in words.
    """

    outcome: str
    value: float
    limit: float
    unit: str
    text: str


def tracking_summary(setup: RunSetup, recording: Recording, failed: bool = False) -> dict[str, Any]:
    """Return the outcome of tracking for ``summary.json``.

    Parameters
    ----------
    setup
        The run.
    recording
        Its recording with at least one complete tick.
    failed
        True for a failed run: with a tick without a command it is not tracked.

    Returns
    -------
    dict
        ``tracking``: entry of :data:`OUTCOMES`. ``tracking_findings``: rows of :class:`TrackingFinding`, the worst
        first; [] for a tracked run.
    """
    run = EngagedRun(setup, recording)
    return outcome_of(sorted(_findings(run, failed), key=lambda finding: OUTCOMES.index(finding.outcome)))


def outcome_of(found: list[TrackingFinding]) -> dict[str, Any]:
    """Return the entries of the summary for findings, the worst first."""
    return {
        "tracking": found[0].outcome if found else TRACKED,
        "tracking_findings": [asdict(finding) for finding in found],
    }


def _findings(run: EngagedRun, failed: bool) -> Iterator[TrackingFinding]:
    """Yield the deviations of a run."""
    yield from _no_command(run, failed)
    if run.rows.size:
        yield from _never_departed(run)
        yield from _lost(run)
        yield from _lost_speed(run)
        yield from _limit_cycle(run)
        yield from _saturated(run)
    if run.at_end:
        yield from _stops(run)
    else:
        last = float(run.recording.time[run.rows[-1]]) if run.rows.size else 0.0
        yield TrackingFinding("disengaged", last, float(run.recording.time[-1]), "s", f"the ATO, at {last:.1f} s")


def _no_command(run: EngagedRun, failed: bool) -> Iterator[TrackingFinding]:
    """Yield the longest time without a command; the ticks that are missing in the log have none."""
    recording, tick = run.recording, run.setup.tick
    begin, end = float(recording.time[0]), float(recording.time[-1])
    ticks = np.rint((recording.time[recording.commanded] - begin) / tick)
    pauses = np.diff(ticks, prepend=-1.0, append=np.rint((end - begin) / tick) + 1.0) - 1.0
    longest = int(pauses.argmax())
    silent, limit = float(pauses[longest]) * tick, 0.0 if failed else run.setup.scenario.supervision.failsafe.hold
    if silent > limit:
        since = begin + (float(ticks[longest - 1]) + 1.0 if longest else 0.0) * tick
        when = f"in the last {three_digits(silent)} s" if longest == ticks.size else f"for {three_digits(silent)} s"
        after = "" if longest == ticks.size else f" from {since:.2f} s on"
        text = f"none {when}{after}; {ticks.size} of {int(ticks.size + pauses.sum())} ticks had one"
        yield TrackingFinding("no command", silent, limit, "s", text)


def _never_departed(run: EngagedRun) -> Iterator[TrackingFinding]:
    """Yield the longest motion of the reference during which the train stayed at rest."""
    recording, limit = run.recording, run.limits.departure_time
    moving = run.engaged & (np.abs(recording.reference_velocity) >= STANDSTILL_SPEED)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], moving.astype(np.int8), [0]))))
    waits = [
        float(last - first) * run.setup.tick
        for first, last in zip(edges[::2], edges[1::2], strict=True)
        if np.abs(recording.front_velocity[first:last]).max() < STANDSTILL_SPEED
    ]
    if waits and max(waits) >= limit:
        text = f"at rest for {max(waits):.0f} s while the reference moved"
        yield TrackingFinding("never departed", max(waits), limit, "s", text)


def _lost(run: EngagedRun) -> Iterator[TrackingFinding]:
    """Yield the largest position error: beyond the limit at the end, or beyond limit and error at the start."""
    limit = run.limits.position_time * run.top_speed
    error = run.position_error[run.rows]
    peak = int(np.abs(error).argmax())
    if limit <= 0 or (abs(error[-1]) <= limit and abs(error[peak]) <= limit + abs(error[0])):
        return
    row = error.size - 1 if abs(error[-1]) > 0.99 * abs(error[peak]) else peak
    text = f"{_place(error[row])} {run.end_text(int(run.rows[row]))}"
    if row == peak != error.size - 1:
        text += f", {_place(error[-1])} {run.end_text(int(run.rows[-1]))}"
    yield TrackingFinding("lost", float(error[row]), limit, "m", text)


def _place(error: float) -> str:
    """Return a position error as text."""
    return f"{three_digits(abs(error))} m {'ahead' if error > 0 else 'behind'}"


def _lost_speed(run: EngagedRun) -> Iterator[TrackingFinding]:
    """Yield a speed error beyond the emergency-brake margin: in half of the run, or of one sign at its end."""
    limit = EMERGENCY_MARGIN.above(run.top_speed)
    median = float(np.median(np.abs(run.speed_error[run.rows])))
    if median > limit:
        text = f"speed error above {three_digits(3.6 * median)} km/h in half of the time"
        yield TrackingFinding("lost", 3.6 * median, 3.6 * limit, "km/h", text)
        return
    count = round(run.limits.position_time / run.setup.tick)
    if run.rows.size < count or not run.engaged[-count:].all():
        return
    errors = run.speed_error[-count:]
    smallest = float(np.abs(errors).min())
    if smallest > limit and (errors > 0).all() == (errors > 0).any():
        side = "too fast" if errors[-1] > 0 else "too slow"
        text = f"at least {three_digits(3.6 * smallest)} km/h {side} in the last {run.limits.position_time:g} s"
        yield TrackingFinding("lost", 3.6 * smallest, 3.6 * limit, "km/h", text)


def _limit_cycle(run: EngagedRun) -> Iterator[TrackingFinding]:
    """Yield the oscillation of the command with the largest amplitude of all units."""
    found: list[tuple[Oscillation, float]] = []
    seen: list[Array] = []
    for unit, (force, share) in enumerate(_command_shares(run)):
        if force <= 0 or any(np.array_equal(share, other) for other in seen):
            continue
        seen.append(share)
        oscillation = sustained_oscillation(
            run.recording.time,
            share,
            amplitude=run.limits.oscillation,
            max_period=LONGEST_PERIOD * _dead_time(run.setup, unit),
            min_duration=run.limits.oscillation_time,
        )
        if oscillation is not None:
            found.append((oscillation, force))
    found.sort(key=lambda entry: -entry[0].amplitude * entry[1])
    for worst, force in found:
        if _is_forced(run, worst):
            continue
        value, limit = worst.amplitude * force / 1e3, run.limits.oscillation * force / 1e3
        text = (
            f"command ±{three_digits(value)} kN with a period of {three_digits(worst.period)} s "
            f"for {worst.duration:.0f} s from {worst.begin:.0f} s on"
        )
        yield TrackingFinding("limit cycle", value, limit, "kN", text)
        return


def _is_forced(run: EngagedRun, oscillation: Oscillation) -> bool:
    """Return True if a disturbance force, or a drift speed, of any power unit has the period of the oscillation.

    A drift speed is the derivative of the position minus the speed: the unmatched disturbance of paper 002.
    """
    recording, tick = run.recording, run.setup.tick
    first = int(np.searchsorted(recording.time, oscillation.begin))
    rows = slice(first, int(np.searchsorted(recording.time, oscillation.begin + oscillation.duration)))
    position, speed = recording.position[rows], recording.velocity[rows]
    drift = np.diff(position, axis=0) / tick - (speed[1:] + speed[:-1]) / 2
    drift = drift[:, drift.std(axis=0) > SMALLEST_DRIFT]
    forces = [] if recording.of(DISTURBANCE, "unit_force") is None else [*recording.disturbance[rows].T]
    period = oscillation.period / tick
    return any(share_at_period(values, period) > FORCED_SHARE for values in (*forces, *drift.T))


def _command_shares(run: EngagedRun) -> Iterator[tuple[float, Array]]:
    """Yield largest force [N] of every unit and its command without the inertial force of the reference, over it.

    The command counts as 0 while the ATO is not engaged.
    """
    model, recording = run.setup.model, run.recording
    inertial = model.inertia * recording.reference_acceleration
    for unit in range(min(model.n_units, recording.units)):
        force = max(model.traction[unit].largest(), model.brake[unit].largest())
        free = recording.command[:, unit] - float(model.share[unit]) * inertial
        yield force, np.where(run.engaged, free, 0.0) / force if force > 0 else free


def _dead_time(setup: RunSetup, unit: int) -> float:
    """Return delay, lag and control period of a unit [s]."""
    model = setup.model
    return max(float(model.delay[unit]), float(model.delay_brake[unit])) + model.lag + setup.control_period


def _stops(run: EngagedRun) -> Iterator[TrackingFinding]:
    """Yield the worst stop beyond and short of the stop window, and a train that did not stop."""
    recording, criteria = run.recording, run.setup.scenario.criteria
    window = DEFAULT_STOP_WINDOW if criteria.stop_window is None else criteria.stop_window
    rows = [stop.as_row() for stop in stops_of_run(run.setup, recording)]
    errors = [row["beyond_m"] for row in rows if row["beyond_m"] is not None]
    for outcome, worst in (("stopped beyond", max(errors, default=0.0)), ("stopped short", min(errors, default=0.0))):
        side = outcome.removeprefix("stopped ")
        if (worst if side == "beyond" else -worst) > window:
            text = f"{three_digits(abs(worst))} m {side}{' of' if side == 'short' else ''} the target"
            yield TrackingFinding(outcome, worst, window, "m", text)
    delay = run.limits.position_time
    for row in rows:
        late = (row["planned_s"] or 0.0) + delay
        if row["beyond_m"] is not None or late > recording.time[-1]:
            continue
        tick = int(np.searchsorted(recording.time, late))
        error = float(run.position_error[tick])
        if abs(error) > window and abs(recording.reference_velocity[tick]) < STANDSTILL_SPEED:
            text = f"moving, {_place(error)}, {delay:g} s after a planned arrival"
            yield TrackingFinding("not stopped", error, window, "m", text)


def _saturated(run: EngagedRun) -> Iterator[TrackingFinding]:
    """Yield the time at a force limit with a speed error that more force would reduce."""
    at_limit = time_at_force_limit(run.setup, run.recording)
    if at_limit is None or not run.setup.layout.n_units:
        return
    recording, limits = run.recording, run.limits
    row = np.minimum(np.searchsorted(recording.time, at_limit[0]), recording.time.size - 1)
    error = run.speed_error[row]
    lacking = recording.command[row].sum(axis=1) * run.direction[row] * error < 0
    counted = run.engaged[row] & lacking & (np.abs(error) > limits.saturation_error)
    total = float(np.diff(at_limit[1], prepend=0.0)[counted].sum())
    if total > limits.saturation_time:
        largest = 3.6 * float(np.abs(error[counted]).max())
        text = f"{total:.0f} s at a force limit with a speed error of up to {three_digits(largest)} km/h"
        yield TrackingFinding("saturated", total, limits.saturation_time, "s", text)
