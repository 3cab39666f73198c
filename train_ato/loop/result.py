"""What a run leaves: its series, its figures, how it ended."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from train_ato.changes import Told
from train_ato.history import History, HistoryBuilder
from train_ato.metrics import summarise
from train_ato.roles.step_times import StepTimes
from train_ato.run_setup import RunSetup
from train_ato.version import VERSION


@dataclass(frozen=True)
class Progress:
    """How far a run is [s]."""

    simulated: float
    duration: float
    wall: float

    @property
    def factor(self) -> float:
        """Simulated seconds per second of wall time."""
        return self.simulated / self.wall if self.wall > 0 else 0.0

    @property
    def remaining(self) -> float:
        """Estimate of the wall time still to come [s]."""
        return (self.duration - self.simulated) / self.factor if self.factor > 0 else 0.0


@dataclass(frozen=True)
class Outcome:
    """End of a run.

    Attributes
    ----------
    history
        Series, or None when not a single tick was complete.
    summary
        What ``summary.json`` holds.
    failure
        One line saying which node failed and why, or None.
    told
        What was changed while it went on.
    """

    history: History | None
    summary: dict[str, Any]
    interrupted: bool = False
    failure: str | None = None
    published: dict[str, int] = field(default_factory=dict)
    told: Told = field(default_factory=Told)

    def checked_against(self, recorded: dict[str, int]) -> Outcome:
        """Return this end of a run, failed if what was recorded is not what was published."""
        wrong = [topic for topic, count in self.published.items() if recorded.get(topic, 0) != count]
        if not wrong or self.failure:
            return self
        topic = wrong[0]
        text = f"recorder: {recorded.get(topic, 0)} of {self.published[topic]} messages of {topic} recorded"
        return replace(self, failure=text, summary={**self.summary, "status": "failed", "failure": text})

    @classmethod
    def of(
        cls,
        setup: RunSetup,
        builder: HistoryBuilder,
        wall: float,
        ticks: int,
        step_times: StepTimes,
        interrupted: bool,
        failure: str | None,
        published: dict[str, int] | None = None,
    ) -> Outcome:
        """Summarise a run from what was collected of it."""
        history = builder.finish() if builder.complete_ticks() else None
        simulated = ticks * setup.tick
        scenario = setup.scenario
        summary: dict[str, Any] = {
            "scenario": scenario.name,
            "controller": setup.controller,
            "observer": setup.observer,
            "compensation": setup.compensation,
            "seed": setup.seed,
            "ticks": ticks,
            "simulated_s": simulated,
            "wall_s": wall,
            "real_time_factor": simulated / wall if wall > 0 else 0.0,
            **(summarise(setup, history) if history is not None else {}),
            "changes": builder.told.rows(scenario),
            "step_time_us_median": step_times.percentile_us(50),
            "step_time_us_p99": step_times.percentile_us(99),
            "status": "failed" if failure else "interrupted" if interrupted else "done",
            "version": VERSION,
        }
        if failure:
            summary["failure"] = failure
        return cls(history, summary, interrupted, failure, published or {}, builder.told)
