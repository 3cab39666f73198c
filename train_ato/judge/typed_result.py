"""Typed result of a run: verdict, criteria, stops and energy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from train_ato.judge.metric_names import html_table
from train_ato.judge.verdict import CRITERIA, unmet_requirements, verdict_line


@dataclass(frozen=True)
class CriterionResult:
    """One criterion or requirement of a run.

    Attributes
    ----------
    name, metric : str
        Key in the scenario, and key of its metric in ``summary.json``.
    value, limit : float or None
        Worst value (of a requirement: smallest robustness) and limit [unit]; None if it was not evaluated.
    unit : str
        Unit of both, "" without one.
    passed : bool or None
        None if it was not evaluated.
    at_s, km : float or None
        Time [s] and place of the front [km] of the worst value; None for a value of 0.
    """

    name: str
    metric: str
    value: float | None
    limit: float | None
    unit: str
    passed: bool | None
    at_s: float | None
    km: float | None


@dataclass(frozen=True)
class StopOfRun:
    """One stop of a run: place [km], arrival of the profile and of the train [s], delay [s], error [m].

    The values of a stop that was not made are None. The error is > 0 beyond the target. ``post`` is the kilometre on a
    line with a chainage.
    """

    km: float
    planned_s: float
    arrival_s: float | None
    delay_s: float | None
    beyond_m: float | None
    post: str | None = None


@dataclass(frozen=True)
class Energy:
    """Work of traction and of the electric brake at the wheels [kWh]; None if it is not known."""

    traction_kwh: float | None
    regenerated_kwh: float | None


@dataclass(frozen=True)
class TypedResult:
    """TypedResult of a run.

    Attributes
    ----------
    verdict : str
        ``passed``, ``failed``, ``incomplete`` (it ended before a criterion could be evaluated), ``aborted`` (a node
        failed), or ``none`` (the scenario has no criteria).
    tracking : str
        Outcome of tracking: ``tracked``, ``lost``, ...; "" if it is not known.
    line, reason : str
        Verdict in one line; outcome and failed criteria, "" without any.
    criteria : tuple of CriterionResult
        Failed ones first.
    stops : tuple of StopOfRun
        Stops that were due, in their order.
    energy : Energy
        Work at the wheels.
    """

    verdict: Literal["passed", "failed", "incomplete", "aborted", "none"]
    tracking: str
    line: str
    reason: str
    criteria: tuple[CriterionResult, ...]
    stops: tuple[StopOfRun, ...]
    energy: Energy

    @property
    def title(self) -> str:
        """Verdict and its line, also of a run that is not tracked or has no metrics."""
        if self.line.startswith((self.verdict, "no criteria")):
            return self.line
        return f"{self.verdict}: {self.line or self.reason or 'no metrics of tracking'}"

    def _repr_html_(self) -> str:
        rows = ((row.name, row.value, row.limit, row.unit, row.at_s, row.km) for row in self.criteria)
        return html_table(self.title, ("criterion", "value", "limit", "unit", "at s", "km"), rows)

    @property
    def passed(self) -> bool:
        """True if the verdict is ``passed``."""
        return self.verdict == "passed"

    @classmethod
    def of(cls, summary: Mapping[str, Any]) -> TypedResult:
        """Return the result from the content of ``summary.json``."""
        units = {criterion.key: criterion.unit for criterion in CRITERIA}
        return cls(
            verdict="aborted" if summary.get("status") == "failed" else summary.get("verdict", "none"),
            tracking=str(summary.get("tracking") or ""),
            line=verdict_line(summary),
            reason=unmet_requirements(summary) or str(summary.get("failure") or ""),
            criteria=tuple(
                CriterionResult(
                    name=row["criterion"],
                    unit=row.get("unit", units.get(row["criterion"], "")),
                    **{key: row.get(key) for key in ("metric", "value", "limit", "passed", "at_s", "km")},
                )
                for row in summary.get("criteria") or ()
            ),
            stops=tuple(StopOfRun(**row) for row in summary.get("stops") or ()),
            energy=Energy(summary.get("energy_traction_kwh"), summary.get("energy_regenerated_kwh")),
        )
