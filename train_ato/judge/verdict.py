"""Verdict of a run: its metrics against the criteria of the scenario; outcome of tracking and verdict as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from train_ato.judge.metric_names import metric_name, metric_unit
from train_ato.program.display_units import display_unit, shown_value

if TYPE_CHECKING:
    from train_ato.scenario.criteria import Criteria

Metrics = Mapping[str, Any]
CriterionRow = dict[str, Any]
"""Row of ``criteria`` in ``summary.json``: criterion, metric, value, limit, passed, and time ``at_s`` and place ``km``
of the front at the worst value; of a requirement also formula and unit."""


@dataclass(frozen=True)
class Criterion:
    """One criterion.

    Attributes
    ----------
    key
        Field of :class:`~train_ato.scenario.criteria.Criteria`.
    metric
        Key of the metric in ``summary.json``.
    factor
        Limit in this unit over the SI value.
    """

    key: str
    metric: str
    factor: float = 1.0

    @property
    def unit(self) -> str:
        """Unit of metric and limit."""
        return metric_unit(self.metric)


CRITERIA: tuple[Criterion, ...] = (
    Criterion("stop_window", "stop_error_max_m"),
    Criterion("arrival_delay", "arrival_delay_max_s"),
    Criterion("overspeed", "overspeed_max_kmh", 3.6),
    Criterion("speed_error_rms", "speed_rmse_kmh", 3.6),
    Criterion("speed_error", "speed_error_run_max_kmh", 3.6),
    Criterion("position_error", "position_error_max_m"),
    Criterion("coupler_draft", "coupler_draft_max_kn", 1e-3),
    Criterion("coupler_buff", "coupler_buff_max_kn", 1e-3),
    Criterion("acceleration", "acceleration_max"),
    Criterion("jerk", "jerk_1s_max"),
    Criterion("real_time", "lateness_max_s"),
    Criterion("brake_interventions", "brake_interventions"),
)
"""All criteria, in the order of the verdict."""
AT_STOPS = ("stop_error_max_m", "arrival_delay_max_s")
"""Metrics of the stops: without a value although a stop was due, the train did not stop."""
OVERSPEED = "overspeed_max_kmh"
ONE_SIDED = ("arrival_delay_max_s",)
"""Metrics whose sign counts: an early arrival is no delay."""
NOWHERE: dict[str, float | None] = {"at_s": None, "km": None}
"""Place of a value that is 0 or not known."""
COUPLER_LIMITS = {"coupler_buff_max_kn": "-", "coupler_draft_max_kn": "+"}


def judge_run(
    criteria: Criteria,
    metrics: Metrics,
    requirements: Sequence[CriterionRow] = (),
    places: Mapping[str, Mapping[str, float]] | None = None,
) -> dict[str, Any]:
    """Return ``verdict`` and ``criteria`` of ``summary.json``; {} for a scenario without criteria.

    Parameters
    ----------
    criteria
        Criteria of the scenario.
    metrics
        Metrics of the run by the keys of ``summary.json``, and ``status`` of a run that did not end regularly.
    requirements
        Rows of the requirements (:func:`train_ato.judge.requirements.requirement_rows`).
    places
        ``at_s`` and ``km`` of the worst value by metric (:func:`train_ato.judge.result.worst_places`).

    Returns
    -------
    dict
        ``verdict``: ``passed``, ``failed``, or ``incomplete`` for a run that ended before a criterion could be
        evaluated. ``criteria``: one row for each criterion, failed ones first; ``passed`` is None if it was not
        evaluated, ``at_s`` and ``km`` are None without a worst value.
    """
    rows = [row for criterion in CRITERIA if (row := _judged(criterion, criteria, metrics)) is not None]
    for row in rows:
        row.update({**NOWHERE, **(places or {}).get(row["metric"], {})})
    rows += requirements
    if not rows:
        return {}
    rows.sort(key=lambda row: row["passed"] is not False)
    ends = {row["passed"] for row in rows}
    status = metrics.get("status", "done")
    if False in ends or status == "failed":
        return {"verdict": "failed", "criteria": rows}
    complete = None not in ends and status == "done"
    return {"verdict": "passed" if complete else "incomplete", "criteria": rows}


def _judged(criterion: Criterion, criteria: Criteria, metrics: Metrics) -> CriterionRow | None:
    limit = getattr(criteria, criterion.key)
    if limit is None:
        return None
    limit = float(f"{limit * criterion.factor:.12g}")
    value = metrics.get(criterion.metric)
    passed: bool | None
    if value is None:
        passed = False if criterion.metric in AT_STOPS and metrics.get("stops") else None
    else:
        passed = bool((value if criterion.metric in ONE_SIDED else abs(value)) <= limit)
    return {"criterion": criterion.key, "metric": criterion.metric, "value": value, "limit": limit, "passed": passed}


def tracking_text(summary: Metrics) -> str:
    """Return outcome of tracking and deciding figure, ``tracked`` without a finding, "" without an outcome."""
    findings = summary.get("tracking_findings")
    return f"{findings[0]['outcome']}: {findings[0]['text']}" if findings else str(summary.get("tracking") or "")


def outcomes_text(summaries: Sequence[Metrics]) -> str:
    """Return the outcome of tracking of runs with equal ones, else every outcome with its number of runs."""
    if len(texts := {tracking_text(summary) for summary in summaries}) == 1:
        return texts.pop()
    counts = Counter(summary["tracking"] for summary in summaries)
    return ", ".join(f"{outcome} {count}" for outcome, count in counts.most_common())


def is_tracked(summary: Metrics) -> bool:
    """Return False for a run with another outcome of tracking than ``tracked``; True for a run without one."""
    return not summary.get("tracking_findings")


def unmet_requirements(summary: Metrics) -> str:
    """Return the outcome of a run that is not tracked and its failed criteria, "" for a run without any.

    Parameters
    ----------
    summary
        Content of ``summary.json``.
    """
    parts = [] if is_tracked(summary) else [tracking_text(summary)]
    parts += [_failure_text(row, summary) for row in summary.get("criteria") or [] if row["passed"] is False]
    return "; ".join(parts)


def verdict_line(summary: Metrics) -> str:
    """Return the verdict of a run as one line of text, "" for a summary without metrics.

    A run that is not tracked has the outcome of tracking first.

    Parameters
    ----------
    summary
        Content of ``summary.json``.
    """
    rows = summary.get("criteria") or []
    failed = [row for row in rows if row["passed"] is False]
    stated = {row["metric"] for row in failed}
    stop = "" if AT_STOPS[0] in stated else _stop_text(summary)
    overspeed = "" if OVERSPEED in stated else _overspeed_text(summary)
    facts = [text for text in (stop, overspeed, _coupler_text(summary), _error_text(summary)) if text]
    if not facts and not failed:
        return ""
    parts = [
        *(_failure_text(row, summary) for row in failed),
        *facts,
        *_plan_texts(summary),
        *_protection_texts(summary),
        *_lateness_texts(summary),
    ]
    outcome = "" if is_tracked(summary) else f"{tracking_text(summary)}; "
    return f"{outcome}{_head(summary, len(rows), failed)}: {'; '.join(parts)}"


def _error_text(summary: Metrics) -> str:
    """Return the rms of the speed error; if the evaluation ends before the run, also that of the whole run."""
    error, run = summary.get("speed_rmse_kmh"), summary.get("speed_rmse_run_kmh")
    if error is None:
        return "" if run is None else "no speed error, because the evaluation ends before the first motion"
    whole = "" if run is None or run == error else f", {shown_quantity(run, 'km/h')} with the braking to the stop"
    return f"speed error {shown_quantity(error, 'km/h')} rms{whole}"


def _head(summary: Metrics, count: int, failed: list[CriterionRow]) -> str:
    verdict = summary.get("verdict")
    if verdict is None:
        return "no criteria"
    if verdict == "failed":
        of = f"{len(failed)} of {count} {'criterion' if count == 1 else 'criteria'}"
        return f"failed ({of})" if failed else "failed (the run did not end)"
    if verdict == "incomplete":
        return "incomplete"
    return f"passed ({count} {'criterion' if count == 1 else 'criteria'})"


def _stop_text(summary: Metrics) -> str:
    stops = summary.get("stops")
    if stops is None:
        error = summary.get("stop_error_m")
        return "" if error is None else _stopped(error)
    if not stops:
        return "no stop was due"
    if any(row["beyond_m"] is None for row in stops):
        return "did not stop" if len(stops) == 1 else "did not stop at every stop"
    if len(stops) == 1:
        return _stopped(stops[0]["beyond_m"])
    worst = max((row["beyond_m"] for row in stops), key=abs)
    return f"{len(stops)} stops, the largest error {_stopped(worst).removeprefix('stopped ')}"


def _stopped(beyond: float) -> str:
    return f"stopped {shown_quantity(abs(beyond), 'm')} {'beyond' if beyond > 0 else 'short of'} the target"


def _lateness_texts(summary: Metrics) -> list[str]:
    """Return the lateness of the ticks of a run with a rate, and its missing and late commands, as text."""
    late, missed, delayed = (summary.get(key) or 0 for key in ("ticks_late", "commands_missed", "commands_late"))
    parts = [f"{missed:.0f} of {summary.get('ticks')} ticks without a new command, {delayed:.0f} with a late one"]
    parts = parts if (missed or delayed) and "ticks_late" in summary else []
    if not late:
        return parts
    largest, share = 1e3 * summary["lateness_max_s"], 100 * summary["behind_share"]
    return [
        *parts,
        f"{late:.0f} ticks late by up to {three_digits(largest)} ms, {three_digits(share)} % behind the rate",
    ]


def _plan_texts(summary: Metrics) -> list[str]:
    """Return time and distance of the first plan whose force cannot keep a stop, [] without one."""
    begin, beyond = summary.get("stop_not_kept_s"), summary.get("stop_not_kept_m")
    if begin is None or beyond is None:
        return []
    return [f"from {begin:.1f} s on the force cannot keep a stop, plans pass it by up to {shown_quantity(beyond, 'm')}"]


def _protection_texts(summary: Metrics) -> list[str]:
    """Return the numbers of brake interventions and takeovers with the time of the first, [] without any."""
    counts = (
        ("brake_interventions", "brake intervention{}", "first_intervention_s"),
        ("takeovers", "takeover{} of the braking law", "first_takeover_s"),
    )
    found = [
        (f"{summary[key]} {name.format('s' * (summary[key] != 1))}", summary.get(at))
        for key, name, at in counts
        if summary.get(key)
    ]
    return [text if begin is None else f"{text} from {begin:.1f} s on" for text, begin in found]


def _overspeed_text(summary: Metrics) -> str:
    value = summary.get(OVERSPEED)
    if value is None:
        return ""
    rows = [row for row in summary.get("criteria") or [] if row["metric"] == OVERSPEED]
    return f"overspeed {shown_quantity(value, 'km/h')}{place_text(rows[0]) if rows else ''}"


def _coupler_text(summary: Metrics) -> str:
    draft, buff = summary.get("coupler_draft_max_kn"), summary.get("coupler_buff_max_kn")
    if draft is None or buff is None or not (draft or buff):
        return ""
    limits = {row["metric"]: row["limit"] for row in summary.get("criteria") or []}
    given = [f"{sign}{shown_digits(limits[key], 'kN')}" for key, sign in COUPLER_LIMITS.items() if key in limits]
    unit = display_unit("kN")[0]
    within = f" (limits {' ... '.join(given)} {unit})" if given else ""
    largest = shown_value(buff, f"{buff:.0f}", "kN"), shown_value(draft, f"{draft:.0f}", "kN")
    return f"couplers {largest[0]} ... +{largest[1]} {unit}{within}"


def _failure_text(row: CriterionRow, summary: Metrics) -> str:
    if "formula" in row:
        robustness, unit = row["value"], row.get("unit") or ""
        found = "not evaluated" if robustness is None else f"robustness {shown_quantity(robustness, unit)}"
        return f"{row['criterion']}: {found}{'' if robustness is None else place_text(row)}"
    criterion = next(entry for entry in CRITERIA if entry.key == row["criterion"])
    value = "none" if row["value"] is None else shown_quantity(row["value"], criterion.unit)
    text = f"{metric_name(criterion.metric).removesuffix(', largest')} {value}"
    if criterion.metric == AT_STOPS[0]:
        text = _stop_text(summary) or text
    return f"{text} (limit {shown_digits(row['limit'], criterion.unit)}){place_text(row)}"


def place_text(row: CriterionRow) -> str:
    """Return time and place of the worst value of a criterion as text, "" without them."""
    parts = [] if row.get("at_s") is None else [f"at {row['at_s']:.1f} s"]
    parts += [] if row.get("km") is None else [f"km {row.get('post') or format(row['km'], '.3f')}"]
    return f" {', '.join(parts)}" if parts else ""


def shown_digits(value: float, unit: str) -> str:
    """Return a number with three significant digits in the unit of display of its unit."""
    return shown_value(value, three_digits(value), unit)


def shown_quantity(value: float, unit: str) -> str:
    """Return a number with three significant digits and its unit of display."""
    return f"{shown_digits(value, unit)} {display_unit(unit)[0]}".rstrip()


def three_digits(value: float) -> str:
    """Return a number with three significant digits, never in exponential form."""
    if value == 0 or abs(value) < 5e-4:
        return "0"
    if abs(value) >= 100:
        return f"{value:.0f}"
    text = f"{float(f'{value:.3g}'):.6f}".rstrip("0").rstrip(".")
    return text or "0"
