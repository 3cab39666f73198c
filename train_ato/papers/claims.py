"""What a reproduction is made of: cases that are run, claims that are judged on them.

A paper is a module ``paperNNN`` of this package with ``PAPER: Paper``.  Cases name a shipped scenario and the changes
to it; a case that several claims need is run once.  A judge sees the results of its claim's cases and says what was
measured and whether the claim holds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from train_ato.history import History

__all__ = ["Calculation", "Case", "Claim", "Judgement", "Paper", "Result", "Results", "Table", "Verdict"]


class Verdict(Enum):
    """Outcome of a claim."""

    REPRODUCED = "reproduced"
    OTHER_SETTING = "only in another setting"
    NOT_REPRODUCED = "not reproduced"


@dataclass(frozen=True)
class Case:
    """One run of the engine.

    Parameters
    ----------
    scenario
        ``NAME[:variant+...]`` of a shipped scenario.
    changes
        Overlay on it.
    full_only
        Too long for the normal reproduction; run under ``--full`` only.
    """

    scenario: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    full_only: bool = False


@dataclass(frozen=True)
class Calculation:
    """Something measured without the closed loop: an observer on a given signal, a model against its data.

    Parameters
    ----------
    function
        Of a module (worker processes find it by name). Takes the arguments by name and returns figures and series.
    arguments
        By name.
    full_only
        As for a case.
    """

    function: Callable[..., tuple[Mapping[str, Any], Mapping[str, Any]]]
    arguments: Mapping[str, Any] = field(default_factory=dict)
    full_only: bool = False


@dataclass(frozen=True)
class Result:
    """What came of a case: ``summary.json``'s content, the series, and the failure if there was one.

    A calculation has its figures in ``summary``, its series in ``series`` and no history.
    """

    summary: Mapping[str, Any]
    history: History | None
    failure: str | None = None
    series: Mapping[str, Any] = field(default_factory=dict)


Results = Mapping[str, Result]
"""Results by the case's key."""


@dataclass(frozen=True)
class Judgement:
    """What was measured (as text, with its unit), the verdict and the reason."""

    measured: str
    verdict: Verdict
    reason: str


@dataclass(frozen=True)
class Claim:
    """One claim of a paper.

    Parameters
    ----------
    text
        The claim in one line.
    stated
        The paper's figure, as text with its unit.
    cases
        Keys of the cases that the judge needs.
    judge
        Takes the results by key.
    full_only
        Judged under ``--full`` only; so is a claim that needs a case of that kind.
    takes_failures
        The judge is asked even when a run of its failed (a law that diverges may end its run).
    """

    text: str
    stated: str
    cases: tuple[str, ...]
    judge: Callable[[Results], Judgement]
    full_only: bool = False
    takes_failures: bool = False


@dataclass(frozen=True)
class Table:
    """Figures of many cases beside each other, printed below the claims.

    Parameters
    ----------
    title, columns
        Heading and column heads.
    rows
        Makes the rows from the results; cases that were not run are absent.
    """

    title: str
    columns: tuple[str, ...]
    rows: Callable[[Results], Sequence[Sequence[Any]]]


@dataclass(frozen=True)
class Paper:
    """A paper with everything that is run and judged for it.

    Parameters
    ----------
    cases
        In the order in which they are started: put the longest first.
    figures
        Draws the paper's figures from the results into a folder and returns the files.
    tables
        Printed below the claims.
    """

    number: str
    title: str
    cases: Mapping[str, Case | Calculation]
    claims: tuple[Claim, ...]
    figures: Callable[[Results, Path], list[Path]]
    tables: tuple[Table, ...] = ()
