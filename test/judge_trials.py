"""Trials of a judge: results for each of its verdicts, and figures just within and just beyond each of its bounds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import judge_results
import numpy as np

from plant_sim.library import read_yaml
from train_ato.judge.recording import COMMAND, ESTIMATE, MEASUREMENT, TRUTH, Recording
from train_ato.judge.series import TopicSamples
from train_ato.papers.claims import Claim, Result, Verdict

GOOD, ELSEWHERE, BAD = Verdict.REPRODUCED, Verdict.OTHER_SETTING, Verdict.NOT_REPRODUCED
Figures = Mapping[str, Any]


@dataclass(frozen=True)
class Edge:
    """One figure of the results of some cases within and beyond a bound, both within 3 % of it."""

    keys: tuple[str, ...]
    figure: str
    inside: float
    outside: float
    elsewhere: bool
    """The other figures are those of "only in another setting"."""


@dataclass(frozen=True)
class Trial:
    """Made-up results of one claim; others are cases in which nonsense alone may leave "reproduced"."""

    claim: str  # begin of its text
    make: Callable[..., Result]  # maker of one result from figures
    good: Mapping[str, Figures]  # by case of "reproduced"; without an entry those of the maker
    edges: tuple[Edge, ...]  # figures at the bounds
    elsewhere: Mapping[str, Figures] | None  # changes of "only in another setting"; None without this verdict
    others: frozenset[str]

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Trial:
        """Return the trial of a row of the table."""
        edges = tuple(
            Edge((keys,) if isinstance(keys, str) else tuple(keys), figure, float(inside), float(outside), elsewhere)
            for elsewhere, name in ((False, "edges"), (True, "edges elsewhere"))
            for keys, figure, inside, outside in row.get(name, ())
        )
        make = getattr(judge_results, row["make"])
        return cls(
            row["claim"], make, row.get("good", {}), edges, row.get("elsewhere"), frozenset(row.get("others", ()))
        )

    def results(
        self, claim: Claim, elsewhere: bool = False, keys: Iterable[str] = (), **figures: Any
    ) -> dict[str, Result]:
        """Return the results of a claim, with other figures of some cases."""
        changes = self.elsewhere if elsewhere else None
        found = {key: {**self.good.get(key, {}), **(changes or {}).get(key, {})} for key in claim.cases}
        for key in keys:
            found[key] |= figures
        return {key: self.make(**entry) for key, entry in found.items()}

    def at_edges(self, claim: Claim) -> Iterator[tuple[Edge, dict[str, Result], dict[str, Result]]]:
        """Yield every edge with the results within and beyond the bound."""
        for entry in self.edges:
            within, beyond = (
                self.results(claim, entry.elsewhere, entry.keys, **{entry.figure: value})
                for value in (entry.inside, entry.outside)
            )
            yield entry, within, beyond


TRIALS: dict[str, list[Trial]] = {
    paper: [Trial.of(row) for row in rows]
    for paper, rows in read_yaml(Path(__file__).with_name("data") / "judge_trials.yaml").items()
}
"""Trials by paper."""


def _figures(result: Result, change: Callable[[float], float]) -> dict[str, Any]:
    return {
        key: change(float(value)) if isinstance(value, int | float) and not isinstance(value, bool) else value
        for key, value in result.summary.items()
    }


def _series(recording: Recording | None, changes: Mapping[tuple[str, str], Callable[[Any], Any]]) -> Recording | None:
    if recording is None:
        return None
    topics = dict(recording.topics)
    for (topic, name), change in changes.items():
        samples = topics[topic]
        topics[topic] = TopicSamples(samples.time, {**samples.values, name: change(samples[name])})
    return replace(recording, topics=topics)


PLACES = ((TRUTH, "unit_position"), (TRUTH, "front_position"))
SPEEDS = ((TRUTH, "unit_velocity"), (TRUTH, "front_velocity"))
FORCES = (
    *((COMMAND, "force"), (ESTIMATE, "force"), (MEASUREMENT, "applied")),
    *((TRUTH, "coupler_draft_max"), (TRUTH, "coupler_buff_max")),
)


def _with(result: Result, figure: Callable[[float], float], series: Mapping[Any, Callable[[Any], Any]]) -> Result:
    return Result(_figures(result, figure), _series(result.recording, series))


def _apart(rows: Any) -> Any:
    """Return an addition of 1e6 and more that differs from unit to unit and from sample to sample."""
    return 1e6 * (1.0 + np.arange(rows.shape[0]) % 3)[:, None] * (1.0 + np.arange(rows.shape[1]))


def _million(value: float) -> float:
    return float(np.copysign(1e6, value))


def far(result: Result) -> Result:
    """Return the result with positions 1000 km off and more, and figures a million times the unit."""
    return _with(result, _million, dict.fromkeys(PLACES, lambda rows: rows + _apart(rows)))


def fast(result: Result) -> Result:
    """Return the result with speeds 1e6 m/s off and more, and figures a million times the unit."""
    return _with(result, _million, dict.fromkeys(SPEEDS, lambda rows: rows + _apart(rows)))


def forced(result: Result) -> Result:
    """Return the result with forces 1e12 N off and more, and figures a million times the unit."""
    return _with(result, _million, dict.fromkeys(FORCES, lambda rows: rows + 1e6 * _apart(rows)))


def lost(result: Result) -> Result:
    """Return the result with all of these."""
    return forced(far(fast(result)))


def not_a_number(result: Result) -> Result:
    """Return the result with NaN in place of every figure and series."""
    nan = dict.fromkeys((*PLACES, *SPEEDS, *FORCES), lambda rows: np.full_like(rows, np.nan))
    return _with(result, lambda value: np.nan, nan)


def zero(result: Result) -> Result:
    """Return the result with 0 in place of every figure and series."""
    none = dict.fromkeys((*PLACES, *SPEEDS, *FORCES), np.zeros_like)
    return _with(result, lambda value: 0.0, none)


def failed(result: Result) -> Result:
    """Return a run that failed without figures."""
    return Result({}, None, "plant: speed beyond measure")


ABSURD: Mapping[str, Callable[[Result], Result]] = {"lost": lost, "NaN": not_a_number, "failed": failed}
"""Nonsense that no judge reproduces."""
APART: Mapping[str, Callable[[Result], Result]] = {"far": far, "fast": fast, "forced": forced}
"""Nonsense in one kind of series."""
EVERY: Mapping[str, Callable[[Result], Result]] = {**ABSURD, **APART, "zero": zero}
