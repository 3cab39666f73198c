"""Data types of a reproduction: cases to run, and claims with their judges.

A paper is a package ``pNNN_name`` whose module ``claims`` has ``PAPER: Paper``.  A case is a shipped scenario with
changes; a case of several claims is run once.  A judge takes the results of the cases of its claim and returns the
measured figures and a verdict.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_sim.data_text import parse_yaml
from train_ato.control.gains import PRINTED, has_gains
from train_ato.control.registry import LAWS
from train_ato.judge.recording import Recording
from train_ato.messages.types import Array
from train_ato.scenario.scenario import Scenario, load_scenario
from train_ato.scenario.setup import RunSetup, prepare

BETTER = 0.9
""""Better", "more accurate": an error of at most nine tenths of the other one."""
MUCH_BETTER = 0.5
""""Significantly", "effective": at most half of the other one."""
REMOVED = 0.1
""""None", "removed", "accurate": at most a tenth of the other one, or of the quantity itself."""
UNCHANGED = 0.1
""""Unchanged": at most a tenth more or less."""
ROBUST = 2.0
""""Robust", "performance kept": at most twice the error of the nominal train."""
ABOUT = 0.2
""""About" a figure: within a fifth of it."""
TENTH = 0.1
"""A figure of an independent implementation or a printed one without "about": within a tenth of it."""
CLOSE = 0.03
"""Distance of a measured figure from its bound, as a fraction, from which the bound needs a note."""


@dataclass(frozen=True)
class Bound:
    """Limit of a measured quantity.

    Parameters
    ----------
    quantity
        Name of the quantity.
    limit
        Largest permitted value; the smallest with ``least``.
    unit
        Unit of value and limit, empty for ratios.
    source
        Origin of the limit: the paper's figure or words, a closed form, a goal, a convention.
    least
        The limit is the smallest permitted value.
    note
        Reason for a measured figure within 3 % of the limit.
    """

    quantity: str
    limit: float
    unit: str
    source: str
    least: bool = False
    note: str = ""

    def check(self, value: float) -> "Check":
        """Return the comparison with a measured value."""
        return Check(self, float(value))


@dataclass(frozen=True)
class Check:
    """Bound and the measured value."""

    bound: Bound
    value: float

    @property
    def holds(self) -> bool:
        """True if the value is finite and within the bound."""
        inside = self.value >= self.bound.limit if self.bound.least else self.value <= self.bound.limit
        return bool(np.isfinite(self.value)) and inside

    @property
    def close(self) -> bool:
        """True if the value is within 3 % of the limit."""
        return abs(self.value - self.bound.limit) <= CLOSE * abs(self.bound.limit)

    def __str__(self) -> str:
        """Return bound, source and measured value as text."""
        bound = self.bound
        sign = ">=" if bound.least else "<="
        text = f"{bound.quantity} {sign} {bound.limit:.4g} {bound.unit}".strip()
        note = f", within 3 %: {bound.note or 'no reason given'}" if self.close else ""
        return f"{text} ({bound.source}): {self.value:.3g}{note}"


def about(quantity: str, stated: float, unit: str, source: str, part: float = ABOUT) -> tuple[Bound, Bound]:
    """Return lower and upper bound around a stated figure, by a fraction of it."""
    return (
        Bound(quantity, (1.0 - part) * stated, unit, source, least=True),
        Bound(quantity, (1.0 + part) * stated, unit, source),
    )


def ratio(quantity: str, limit: float, words: str) -> Bound:
    """Return the bound of a ratio for the words of a claim."""
    return Bound(quantity, limit, "", words)


def worst(values: Iterable[float]) -> float:
    """Return the largest value; NaN if any value is NaN."""
    return float(np.max(list(values)))


def least(values: Iterable[float]) -> float:
    """Return the smallest value; NaN if any value is NaN."""
    return float(np.min(list(values)))


class Verdict(Enum):
    """Outcome of a claim."""

    REPRODUCED = "reproduced"
    OTHER_SETTING = "only in another setting"
    NOT_REPRODUCED = "not reproduced"


UNSUPERVISED: Mapping[str, Any] = {"supervision": {"enabled": False}}
"""The papers have no supervisor: it would brake a train whose control is lost."""


def printed(scenario: Scenario, path: Path) -> tuple[Scenario, Path]:
    """Return a scenario, and its file, with the printed gains of every law, apart from those that it gives."""
    laws = {name: {"gains": PRINTED} for name in LAWS.loadable() if has_gains(LAWS.get(name))}
    given = {name: {**laws.get(name, {}), **values} for name, values in scenario.laws.items()}
    return scenario.model_copy(update={"laws": {**laws, **given}}), path


@dataclass(frozen=True)
class Case:
    """One run of the engine, without a supervisor.

    Parameters
    ----------
    scenario
        ``NAME[:variant+...]`` of a shipped scenario.
    changes
        Overlay on it.
    full_only
        Run under ``--full`` only, because of its duration.
    """

    scenario: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    full_only: bool = False

    def setup(self) -> RunSetup:
        """Return the prepared run; errors as :func:`train_ato.scenario.setup.prepare`."""
        return prepare(*printed(*load_scenario(self.scenario, changes={**UNSUPERVISED, **self.changes})))


@dataclass(frozen=True)
class Calculation:
    """Measurement without the closed loop, such as an observer on a given signal.

    Parameters
    ----------
    function
        Function of a module (worker processes import it by name); returns figures and series.
    arguments
        Keyword arguments.
    full_only
        As for a case.
    """

    function: Callable[..., tuple[Mapping[str, Any], Mapping[str, Any]]]
    arguments: Mapping[str, Any] = field(default_factory=dict)
    full_only: bool = False


@dataclass(frozen=True)
class Result:
    """Result of a case: content of ``summary.json``, recording, and failure if any.

    A calculation has figures in ``summary``, series in ``series`` and no recording.
    """

    summary: Mapping[str, Any]
    recording: Recording | None
    failure: str | None = None
    series: Mapping[str, Any] = field(default_factory=dict)


Results = Mapping[str, Result]
"""Results by key of the case."""


@dataclass(frozen=True)
class Judgement:
    """Measured figures (text with units), verdict, reason, and the compared bounds."""

    measured: str
    verdict: Verdict
    reason: str
    checks: tuple[Check, ...] = ()


Judge = Callable[[Results], Judgement]
"""Function from the results by key to the judgement."""

TWO = frozenset((Verdict.REPRODUCED, Verdict.NOT_REPRODUCED))
THREE = frozenset(Verdict)


@dataclass(frozen=True)
class Claim:
    """One claim of a paper.

    Parameters
    ----------
    text
        The claim in one line.
    stated
        Figure of the paper, text with unit.
    cases
        Keys of the cases for the judge.
    judge
        Judge of the results.
    verdicts
        Verdicts that some results reach.
    full_only
        Judged under ``--full`` only, like every claim with such a case.
    takes_failures
        Failed runs are judged too (a diverging law may end its run).
    """

    text: str
    stated: str
    cases: tuple[str, ...]
    judge: Judge
    verdicts: frozenset[Verdict] = TWO
    full_only: bool = False
    takes_failures: bool = False


class Claims(list[Claim]):
    """Claims of a paper in the order of their judges."""

    def judged_by(
        self,
        text: str,
        stated: str,
        cases: Iterable[str],
        verdicts: frozenset[Verdict] = TWO,
        *,
        takes_failures: bool = False,
    ) -> Callable[[Judge], Judge]:
        """Return a decorator that adds a claim with its judge; parameters as for :class:`Claim`."""

        def add(judge: Judge) -> Judge:
            self.append(Claim(text, stated, tuple(cases), judge, verdicts, takes_failures=takes_failures))
            return judge

        return add


@dataclass(frozen=True)
class CaseTable:
    """Table of figures of several cases, printed below the claims.

    Parameters
    ----------
    title, columns
        Heading and column heads.
    rows
        Function of the results, without cases that were not run.
    """

    title: str
    columns: tuple[str, ...]
    rows: Callable[[Results], Sequence[Sequence[Any]]]


@dataclass(frozen=True)
class FigureFile:
    """Figure of a paper: its PNG file, beside which is a PDF of the same name, and its caption."""

    path: Path
    caption: str


@dataclass(frozen=True)
class Paper:
    """Paper with its cases, claims, figures and tables.

    Parameters
    ----------
    cases
        Cases in the order of their start, longest first.
    figures
        Function that draws the figures from the results into a folder and returns them.
    tables
        Tables below the claims.
    """

    number: str
    title: str
    cases: Mapping[str, Case | Calculation]
    claims: Sequence[Claim]
    figures: Callable[[Results, Path], list[FigureFile]]
    tables: tuple[CaseTable, ...] = ()


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


class PaperRuns(NamedTuple):
    """File ``cases.yaml`` of a paper; the runs of every law on every train are made of the first two by the paper.

    Attributes
    ----------
    laws : mapping
        Label and changes of a law by key, in the order of the table.
    trains : mapping
        Label and variants of a train by key, in the order of the table.
    single : dict of Case
        Single runs by key.
    printed_forms : tuple of PrintedForm
        Printed forms, each with the runs to compare.
    """

    laws: Mapping[str, tuple[str, Mapping[str, Any]]]
    trains: Mapping[str, tuple[str, str]]
    single: dict[str, Case]
    printed_forms: tuple[PrintedForm, ...]


def read_paper_runs(package: str) -> PaperRuns:
    """Read the file of a paper in its package."""
    data = parse_yaml((files(package) / "cases.yaml").read_text(encoding="utf-8"))
    return PaperRuns(
        {key: (label, changes) for key, (label, changes) in data["laws"].items()},
        {key: (label, variants) for key, (label, variants) in data.get("trains", {}).items()},
        {key: Case(**case) for key, case in data["single"].items()},
        tuple(PrintedForm(**form) for form in data["printed_forms"]),
    )
