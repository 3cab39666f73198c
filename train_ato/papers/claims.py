"""Data types of a reproduction: cases to run, and claims with their judges.

A paper is a package ``pNNN_name`` whose module ``claims`` has ``PAPER: Paper``.  A case is a shipped scenario with
changes; a case of several claims is run once.  A judge takes the results of the cases of its claim and returns the
measured figures and a verdict.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.control.gains import PRINTED, has_gains
from train_ato.control.registry import LAWS
from train_ato.judge.recording import Recording
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
