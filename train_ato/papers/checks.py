"""Figures of results, and verdicts from bounds, for the judges of all papers."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from train_ato.judge.recording import Recording
from train_ato.messages.types import Array
from train_ato.papers.claims import Bound, CaseTable, Check, Judgement, Result, Results, Verdict


def position_error(recording: Recording, offsets: Array | None = None) -> Array:
    """Return x + offset - x_d of every unit [m], shape (k, units).

    Parameters
    ----------
    recording
        The run.
    offsets
        Nominal distances behind vehicle 0 [m]; default: distances at the start, couplers unstretched.
    """
    if offsets is None:
        offsets = recording.front_position[0] - recording.position[0]
    return np.asarray(recording.position + offsets - recording.reference_position[:, None])


def speed_error(recording: Recording) -> Array:
    """Return v - v_d of every unit [m/s], shape (k, units)."""
    return np.asarray(recording.velocity - recording.reference_velocity[:, None])


def mean_speed_error(recording: Recording) -> Array:
    """Return the mean over the units of v - v_d [m/s], shape (k,)."""
    return np.asarray(speed_error(recording).mean(axis=1))


def rms(values: Array) -> float:
    """Return the root mean square over all entries."""
    return float(np.sqrt(np.mean(np.square(values))))


def largest(values: Array) -> float:
    """Return the largest magnitude."""
    return float(np.abs(values).max())


MOVING = 1.0
"""Reference speed from which speed errors are evaluated [m/s]; at rest the holding brake acts."""

STEADY = 1e-6
"""Acceleration of the reference below which its speed is constant [m/s²]."""


def moving(recording: Recording) -> NDArray[np.bool_]:
    """Return a mask of the ticks at which the reference moves, shape (k,)."""
    return np.asarray(recording.reference_velocity > MOVING)


def late_cruise(recording: Recording) -> NDArray[np.bool_]:
    """Return a mask of the last half of the longest interval at constant speed, shape (k,)."""
    steady = moving(recording) & (np.abs(recording.reference_acceleration) < STEADY)
    changes = np.flatnonzero(np.diff(np.concatenate(([False], steady, [False]))))
    begins, ends = changes[::2], changes[1::2]
    if not begins.size:
        raise ValueError("the reference has no constant speed")
    longest = int(np.argmax(ends - begins))
    mask = np.zeros(steady.size, dtype=bool)
    mask[(begins[longest] + ends[longest]) // 2 : ends[longest]] = True
    return mask


def largest_position_error(result: Result) -> float:
    """Return the largest position error of any unit, also at rest [m]."""
    return largest(position_error(recording(result)))


def largest_speed_error(result: Result) -> float:
    """Return the largest speed error of any unit while moving [m/s]."""
    run = recording(result)
    return largest(speed_error(run)[moving(run)])


def time_within(time: Array, values: Array, band: float, begin: float = 0.0, end: float = math.inf) -> float:
    """Return the time after which all magnitudes stay within a band [s].

    Parameters
    ----------
    time, values
        Samples [s], shape (k,) and (k,) or (k, n).
    band
        Largest magnitude.
    begin, end
        Interval of the evaluation [s]; the result counts from its begin.

    Returns
    -------
    float
        0 if no sample is outside; NaN if the last one is, or is not finite.
    """
    part = (time >= begin) & (time < end)
    inside = np.abs(values[part]) <= band
    late = np.flatnonzero(~inside.reshape(inside.shape[0], -1).all(axis=1))
    if late.size == 0:
        return 0.0
    return math.nan if late[-1] == inside.shape[0] - 1 else float(time[part][late[-1] + 1]) - begin


def written(value: float, unit: str = "", digits: int = 3) -> str:
    """Return a figure with its unit, from 1000 m on in km, below 0.01 m in mm."""
    if not math.isfinite(value):
        return "never" if math.isnan(value) else f"beyond measure {unit}".strip()
    for plain, small, big in (("m", "mm", "km"), ("m/s", "mm/s", "")):
        if unit == plain:
            if 0 < abs(value) < 0.01:
                return f"{1000 * value:.{digits}g} {small}"
            if abs(value) >= 1000 and big:
                return f"{value / 1000:.{digits}g} {big}"
    text = f"{value:.{digits}g}" if abs(value) < 10**digits or abs(value) >= 1e5 else f"{value:.0f}"
    return f"{text} {unit}".strip()


GOAL = "goal of this project"


def rms_kmh(result: Result) -> float:
    """Return the rms speed error [km/h]."""
    return float(result.summary["speed_rmse_kmh"])


def largest_kmh(result: Result) -> float:
    """Return the largest speed error [km/h]."""
    return float(result.summary["speed_error_max_kmh"])


def variation(result: Result) -> float:
    """Return the variation of the command [kN/s]."""
    return float(result.summary["command_variation_kn_per_s"])


def recording(result: Result) -> Recording:
    """Return the series of a run."""
    if result.recording is None:
        raise ValueError("the run has no series")
    return result.recording


def gain(better: Result, than: Result) -> float:
    """Return the reduction of the rms speed error from one run to another [%]."""
    return 100.0 * (1.0 - rms_kmh(better) / rms_kmh(than))


def conclude(
    measured: str,
    reproduced: Iterable[Check],
    reason: str,
    *,
    elsewhere: Iterable[Check] = (),
    changed: str = "",
    otherwise: str = "",
) -> Judgement:
    """Return the judgement from the bounds of the claim and from those of the changed setting.

    Parameters
    ----------
    measured
        Measured figures as text.
    reproduced
        Bounds of the claim as stated.
    reason
        Reason if they hold, and of the other verdicts without a reason of their own.
    elsewhere
        Bounds in the changed setting; without any there is no such verdict.
    changed, otherwise
        Reasons for "only in another setting" and "not reproduced".
    """
    here, there = tuple(reproduced), tuple(elsewhere)
    checks = (*here, *(check for check in there if check not in here))
    if all(check.holds for check in here):
        return Judgement(measured, Verdict.REPRODUCED, reason, checks)
    if there and all(check.holds for check in there):
        return Judgement(measured, Verdict.OTHER_SETTING, changed or reason, checks)
    return Judgement(measured, Verdict.NOT_REPRODUCED, otherwise or reason, checks)


def within(key: str, bound_rms: float, bound_largest: float, reason: str) -> Callable[[Results], Judgement]:
    """Return a judge of the goals for rms and largest speed error of a case [km/h]."""
    bounds = (Bound("rms", bound_rms, "km/h", GOAL), Bound("largest", bound_largest, "km/h", GOAL))

    def judge(results: Results) -> Judgement:
        found = (rms_kmh(results[key]), largest_kmh(results[key]))
        checks = [bound.check(value) for bound, value in zip(bounds, found, strict=True)]
        return conclude(f"rms {found[0]:.4f}, largest {found[1]:.2f} km/h", checks, reason)

    return judge


@dataclass(frozen=True)
class PrintedForm:
    """An equation that the paper prints in another form than the default of the law.

    Parameters
    ----------
    text
        The printed form, its equation, and the setting of both runs.
    case
        Case with the printed form.
    here
        Form of this project in the same place.
    default
        Case with that form; all else is equal.
    begin
        Begin of the evaluation [s].
    """

    text: str
    case: str
    here: str
    default: str
    begin: float = 0.0


def printed_forms_table(forms: Sequence[PrintedForm]) -> CaseTable:
    """Return the table of the printed forms of a paper."""

    def rows(results: Results) -> list[tuple[str, ...]]:
        return [
            (form.text, errors(results[form.case], form.begin), form.here, errors(results[form.default], form.begin))
            for form in forms
        ]

    heads = ("printed", "errors", "here", "errors")
    return CaseTable("printed forms: largest position error; speed error, rms and largest", heads, rows)


def errors(result: Result, begin: float = 0.0) -> str:
    """Return the errors of a run after ``begin`` [s], or the reason of its failure; speed errors only while moving.

    Returns
    -------
    str
        Largest position error, rms and largest speed error, with units.
    """
    recording = result.recording
    if recording is None or result.failure:
        return result.failure or "no series"
    late = recording.time >= begin
    place, speed = position_error(recording)[late], speed_error(recording)[late & moving(recording)]
    figures = ((largest(place), "m"), (rms(speed), "m/s"), (largest(speed), "m/s"))
    return "; ".join(written(value, unit) for value, unit in figures)
