"""Outcome of tracking: tracked, or the deviation of the train from its reference with the figure that decided.

=============== ======================================================================================================
no command      the commands pause, or end before the run, by more than the age of a command at which the train coasts;
                in a failed run by any time
never departed  the reference left a stop for longer than ``departure_time``, the train stayed at rest
lost            the position error exceeds the way of ``position_time`` at the largest speed of the profile, at the end
                of the run or beyond the error at the start; or the speed error exceeds the emergency-brake margin of
                SUBSET-026 (3.13.9.2) in half of the time, or with one sign in the last ``position_time``
limit cycle     sustained oscillation of a command (:class:`Oscillation`); no disturbance has its period
disengaged      the ATO was not engaged at the end
not stopped     no standstill at a planned stop, outside of the stop window ``position_time`` after the arrival
stopped beyond  the train came to rest beyond a target by more than the stop window
stopped short   the same, short of it
saturated       the force was at a limit, and the train too slow at the upper or too fast at the lower one, for
                longer than ``saturation_time``
its status      a run that did not end as planned without another outcome: failed, interrupted, killed
=============== ======================================================================================================

Only ticks with an engaged ATO count.  The limits are in the block ``criteria.tracking`` of a scenario
(:class:`train_ato.scenario.criteria.TrackingLimits`), with the reasons of their defaults.

Sustained oscillation of a series: turning points, regular periods, autocorrelation.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from train_ato.control.train_model import STANDSTILL_SPEED
from train_ato.judge.recording import ATO_STATE, DISTURBANCE, Recording
from train_ato.judge.run_end import DONE, FAILED
from train_ato.judge.stops import stops_of_run
from train_ato.judge.verdict import three_digits
from train_ato.messages.types import Array, AtoState
from train_ato.scenario.criteria import TrackingLimits
from train_ato.scenario.setup import RunSetup
from train_ato.supervision.step_function import EMERGENCY_MARGIN

PERIODS = 6
"""Smallest number of regular periods in a row; Thornhill, Huang, Zhang, J. Process Control 13 (2003) 91-100: 5."""
REGULARITY = 0.25
"""Largest standard deviation over mean of the periods; 1/3 of Thornhill et al. also accepts filtered noise."""
EQUALITY = 0.2
"""Largest standard deviation over mean of the swings; a limit cycle has one amplitude, noise any."""
CORRELATION = 0.5
"""Smallest autocorrelation after one period: Miao and Seborg, IEEE Conf. Control Applications (1999).  Noise has 0."""
LAGS = np.linspace(0.8, 1.2, 9)
"""Lags of the autocorrelation over the median period."""
BAND = 0.1
"""Relative difference of the frequency up to which two periods count as equal."""


@dataclass(frozen=True)
class Oscillation:
    """Sustained oscillation.

    Attributes
    ----------
    begin, duration : float
        First turning point, and time of the regular part [s].
    period : float
        Median period [s].
    amplitude : float
        Half of the median swing between turning points, in the unit of the series.
    """

    begin: float
    duration: float
    period: float
    amplitude: float


def sustained_oscillation(
    time: Array, values: Array, *, amplitude: float, max_period: float, min_duration: float
) -> Oscillation | None:
    """Return the longest sustained oscillation of a series, None without one.

    The swings between turning points are at least twice the amplitude and equal (``EQUALITY``). The period is regular
    (``REGULARITY``), and the series after one period is similar to itself (``CORRELATION``). This lasts at least
    ``PERIODS`` periods and ``min_duration``. Noise has irregular periods and no correlation. A decaying oscillation has
    too few swings.

    Parameters
    ----------
    time, values : shape (k,)
        Evenly spaced times [s], and values.
    amplitude
        Smallest amplitude, in the unit of the values.
    max_period, min_duration
        Longest period, and shortest duration of the oscillation [s].
    """
    if values.size < 2 * PERIODS or float(np.ptp(values)) < 2 * amplitude:
        return None
    turns = turning_points(values, 2 * amplitude)
    found = [
        _confirmed(time, values, turns[first : last + 1], min_duration)
        for first, last in _regular_spans(time[turns], np.abs(np.diff(values[turns])), max_period)
    ]
    return max((entry for entry in found if entry is not None), key=lambda entry: entry.duration, default=None)


def turning_points(values: Array, swing: float) -> NDArray[np.intp]:
    """Return the rows of maxima and minima, in turn, with at least ``swing`` between neighbours; the ends are none."""
    change = np.diff(values)
    moving = np.flatnonzero(change)
    rising = change[moving] > 0
    rows = moving[np.flatnonzero(rising[1:] != rising[:-1])] + 1
    rows = np.concatenate(([0], rows, [values.size - 1]))
    found: list[int] = []
    low = high = float(values[0])
    at_low = at_high = direction = 0
    for row, value in zip(rows.tolist(), values[rows].tolist(), strict=True):
        if direction >= 0 and value > high:
            high, at_high = value, row
        if direction <= 0 and value < low:
            low, at_low = value, row
        if direction >= 0 and high - value >= swing:
            found.append(at_high)
            direction, low, at_low = -1, value, row
        elif direction <= 0 and value - low >= swing:
            found.append(at_low)
            direction, high, at_high = 1, value, row
    return np.array(found, dtype=np.intp)


def _regular_spans(turns: Array, swings: Array, max_period: float) -> Iterator[tuple[int, int]]:
    """Yield first and last turning point of the spans with regular periods and swings; ``turns`` are times [s]."""
    count = 2 * PERIODS - 1
    periods = turns[2:] - turns[:-2]
    if periods.size < count:
        return
    windows = sliding_window_view(periods, count)
    regular = (windows.max(axis=1) <= max_period) & (windows.std(axis=1) <= REGULARITY * windows.mean(axis=1))
    heights = sliding_window_view(swings, count + 1)
    regular &= heights.std(axis=1) <= EQUALITY * heights.mean(axis=1)
    covered = np.zeros(turns.size + 1, dtype=np.int64)
    covered[:-1][np.flatnonzero(regular)] += 1
    covered[np.flatnonzero(regular) + count + 1] -= 1
    inside = np.concatenate(([0], np.cumsum(covered)[:-1] > 0, [0])).astype(np.int8)
    edges = np.flatnonzero(np.diff(inside))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _confirmed(time: Array, values: Array, turns: NDArray[np.intp], min_duration: float) -> Oscillation | None:
    """Return the oscillation between turning points, None if too short or without correlation."""
    turns = turns[turns < values.size]
    at = time[turns]
    period = float(np.median(at[2:] - at[:-2]))
    length = max(min_duration, PERIODS * period)
    blocks = int((at[-1] - at[0]) / length * (1 + 1e-9))
    if blocks < 1:
        return None
    tick = float(time[1] - time[0])
    parts = np.array_split(values[turns[0] : turns[-1] + 1], blocks)
    lags = {max(1, round(lag)) for lag in (LAGS * period / tick).tolist()}
    similar = sum(max(_correlation(part, lag) for lag in lags) >= CORRELATION for part in parts)
    if 2 * similar < blocks:
        return None
    swings = np.abs(np.diff(values[turns]))
    duration = float(at[-1] - at[0]) * similar / blocks
    return Oscillation(float(at[0]), duration, period, float(np.median(swings)) / 2)


def _correlation(values: Array, lag: int) -> float:
    """Return the autocorrelation of a series after ``lag`` rows, -1 ... 1; 0 for a constant series."""
    if lag >= values.size:
        return 0.0
    deviation = values - values.mean()
    early, late = deviation[: values.size - lag], deviation[lag:]
    scale = float(np.sqrt((early**2).sum() * (late**2).sum()))
    return float((early * late).sum()) / scale if scale > 0 else 0.0


def has_period(values: Array, period: float) -> bool:
    """Return True if a series has a line at a period, which is not that of a random series.

    The periods within 10 % have more than ``FORCED_SHARE`` of the variance at those within a factor of two, and at
    least ``LINE_SHARE`` of all: a disturbance can be a sum of sines.

    Parameters
    ----------
    values : shape (k,)
        Evenly spaced values.
    period
        Period [rows].
    """
    power = np.abs(np.fft.rfft(values - values.mean())) ** 2
    over = np.fft.rfftfreq(values.size) * period
    line = float(power[np.abs(over - 1) <= max(BAND, period / values.size)].sum())
    around = float(power[(over > 0.5) & (over < 2.0)].sum())
    return line > FORCED_SHARE * around and line >= LINE_SHARE * float(power.sum())


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
MAX_PERIOD = 20.0
"""Longest period of a limit cycle over the dead time of the loop.  A relay with an integrator and dead time oscillates
with 4 dead times, a slow controller at its stability limit with more; hills of the line are slower."""

FORCED_SHARE = 0.5
"""Part of the variance of a disturbance near the period of an oscillation above which the disturbance is its cause."""
LINE_SHARE = 0.1
"""Least part of all its variance: each of ten equal sines has it, and turbulence less."""
MIN_DRIFT = 0.01
"""Smallest standard deviation of a drift speed [m/s]; an integration of the plant over a tick has less."""
MIN_DRIFT_TICKS = 5
"""Longest period of an oscillation that no drift speed explains, in ticks."""


@dataclass(frozen=True)
class TrackingFinding:
    """Deviation from the reference.

    Attributes
    ----------
    outcome
        Entry of :data:`OUTCOMES`, :data:`INCOMPLETE`, or the status of a run that did not end as planned.
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


def tracking_summary(setup: RunSetup, recording: Recording, status: str = DONE) -> dict[str, Any]:
    """Return the outcome of tracking for ``summary.json``.

    Parameters
    ----------
    setup
        The run.
    recording
        Its recording with at least one complete tick.
    status
        Status of the run. A run that did not end as planned is never tracked.

    Returns
    -------
    dict
        ``tracking``: entry of :data:`OUTCOMES`, or the status. ``tracking_findings``: rows of
        :class:`TrackingFinding`, the worst first; [] for a tracked run.
    """
    run = EngagedRun(setup, recording)
    found = sorted(_findings(run, failed=status == FAILED), key=lambda finding: OUTCOMES.index(finding.outcome))
    if not found and status != DONE:
        time, planned = recording.time.size * setup.tick, setup.ticks * setup.tick
        text = f"the run, after {time:.1f} of {planned:.1f} s"
        found = [TrackingFinding(status, time, planned, "s", text)]
    return outcome_of(found)


def outcome_of(found: list[TrackingFinding]) -> dict[str, Any]:
    """Return the entries of the summary for findings, the worst first."""
    return {
        "tracking": found[0].outcome if found else TRACKED,
        "tracking_findings": [asdict(finding) for finding in found],
    }


def _findings(run: EngagedRun, *, failed: bool) -> Iterator[TrackingFinding]:
    """Yield the deviations of a run."""
    yield from _no_command(run, failed=failed)
    if run.rows.size:
        yield from _never_departed(run)
        yield from _lost(run)
        yield from _lost_speed(run)
        yield from _limit_cycle(run)
        yield from _saturated(run)
    if run.engaged[-1]:
        yield from _stops(run)
    else:
        times = run.recording.time
        begin = float(times[min(run.rows[-1] + 1, times.size - 1)]) if run.rows.size else 0.0
        yield TrackingFinding("disengaged", begin, float(times[-1]), "s", f"the ATO, at {begin:.1f} s")


def _no_command(run: EngagedRun, *, failed: bool) -> Iterator[TrackingFinding]:
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
    model = run.setup.model
    for unit, (force, share) in enumerate(_command_shares(run)):
        if force <= 0 or any(np.array_equal(share, other) for other in seen):
            continue
        seen.append(share)
        dead = max(float(model.delay[unit]), float(model.delay_brake[unit])) + model.lag + run.setup.control_period
        oscillation = sustained_oscillation(
            run.recording.time,
            share,
            amplitude=run.limits.oscillation,
            max_period=MAX_PERIOD * dead,
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

    A drift speed is the derivative of the position minus the speed: the unmatched disturbance of paper 002. A period of
    a few ticks is none: the mean of two speeds is not the mean over their tick then.
    """
    recording, tick = run.recording, run.setup.tick
    first = int(np.searchsorted(recording.time, oscillation.begin))
    rows = slice(first, int(np.searchsorted(recording.time, oscillation.begin + oscillation.duration)))
    position, speed = recording.position[rows], recording.velocity[rows]
    drift = np.diff(position, axis=0) / tick - (speed[1:] + speed[:-1]) / 2
    drift = drift[:, (drift.std(axis=0) > MIN_DRIFT) & (oscillation.period > MIN_DRIFT_TICKS * tick)]
    forces = [] if recording.of(DISTURBANCE, "unit_force") is None else [*recording.disturbance[rows].T]
    period = oscillation.period / tick
    return any(has_period(values, period) for values in (*forces, *drift.T))


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
    if at_limit is None:
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


def time_at_force_limit(setup: RunSetup | None, recording: Recording) -> tuple[Array, Array] | None:
    """Return times [s] and the time at a force limit since the start [s], shape (k,) each; None without diagnostics.

    The plant counts demands beyond the limits of the train. The controller counts commands at the limits of its model.
    Neither count is complete. A command that the law or the controller has clipped is not beyond the limit of the
    train, and a limit of the train below that of the model does not clip the command. Both counts are in the
    diagnostics once a second. In each of these seconds the larger count is used, because a demand beyond both limits is
    in both counts. The count of the controller is moved by the nominal delay of the command and a tick, because it
    includes the step at its stamp.
    """
    plant = recording.reported("plant", "saturated")
    steps = recording.reported("controller", "saturated_steps")
    if steps is not None and setup is not None:
        delay = float(np.mean(setup.model.delay))
        controller = (steps[0] + delay + setup.tick, steps[1] * setup.control_period)
        if plant is None:
            return controller
        time = plant[0]
        increments = [_increments(time, *series) for series in (plant, controller)]
        return time, np.cumsum(np.maximum(*increments))
    return plant


def _increments(time: Array, at: Array, count: Array) -> Array:
    """Return the increase of a count until each time; a count that starts again after a restart of its node goes on."""
    rising = np.cumsum(np.maximum(0.0, np.diff(count, prepend=0.0)))
    values = np.interp(time, at, rising)
    values[-1] = rising[-1]  # the last command has no effect within the run, and the count has no later report
    return np.diff(values, prepend=0.0)
