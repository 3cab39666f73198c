"""Result of a tuning: gains, runs with the initial and the tuned gains, overlay scenario, history."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from plant_sim.data_text import TextDumper
from train_ato.judge.metric_names import verdict_html
from train_ato.log.whole_file import write_whole
from train_ato.studies.tune.gain_space import HELD_OUT, SEARCHED
from train_ato.studies.tune.objective import TERMS, GainScore

if TYPE_CHECKING:
    import pandas as pd

INITIAL, TUNED = "initial", "tuned"
OVERLAY, TABLE, HISTORY, RESULT = "tuned.yaml", "table.csv", "history.csv", "tune.json"


@dataclass(frozen=True)
class TuneResult:
    """Tuned gains of a law.

    Made by :func:`train_ato.tune`.

    Attributes
    ----------
    law : str
        Name of the law.
    initial, gains : dict
        Values of the varied parameters in the scenario, and tuned; equal if no candidate was better.
    rows : list of dict
        One for each run of the search and held out, with the initial and with the tuned gains: run, part, gains, score
        without unit, terms of the score in their units, outcome of tracking, verdict.
    candidates : list of dict
        One for each candidate: number, generation, gains, objective, mean and worst score, score of every run.
    settings : dict
        Ranges, weights, seeds, number of runs.
    overlay : dict
        Scenario with ``base``, ``law`` and the tuned gains.
    interrupted : bool
        True if Ctrl-C ended the search; the held-out runs are missing then.
    """

    law: str
    initial: dict[str, Any]
    gains: dict[str, Any]
    rows: list[dict[str, Any]]
    candidates: list[dict[str, Any]]
    settings: dict[str, Any]
    overlay: dict[str, Any]
    interrupted: bool = False

    @property
    def improved(self) -> bool:
        """True if a candidate was better than the initial gains in the search."""
        return self.gains != self.initial

    @property
    def improved_held_out(self) -> bool | None:
        """True if the tuned gains are also better on the held-out runs; None without held-out runs."""
        before, after = self.score(INITIAL, HELD_OUT), self.score(TUNED, HELD_OUT)
        return None if before is None or after is None else after.objective < before.objective

    def score(self, gains: str, part: str = SEARCHED) -> GainScore | None:
        """Return the score over the runs of a part with ``initial`` or ``tuned`` gains; None without runs."""
        scores = [row["score"] for row in self.rows if row["gains"] == gains and row["part"] == part]
        return GainScore.of(scores) if scores else None

    @property
    def table(self) -> pd.DataFrame:
        """Runs with the initial and the tuned gains, one row each."""
        import pandas as pd

        return pd.DataFrame(self.rows)

    @property
    def history(self) -> pd.DataFrame:
        """Candidates in their order, one row each."""
        import pandas as pd

        return pd.DataFrame(self.candidates)

    @property
    def yaml(self) -> str:
        """Text of the overlay scenario."""
        return yaml.dump(self.overlay, Dumper=TextDumper, sort_keys=False, allow_unicode=True, width=120)

    @property
    def data(self) -> dict[str, Any]:
        """Result as plain data."""
        return {
            "law": self.law, "initial": self.initial, "gains": self.gains, "improved": self.improved,
            "improved_held_out": self.improved_held_out, "interrupted": self.interrupted, "settings": self.settings,
            "runs": self.rows,
        }  # fmt: skip

    def write(self, out: str | Path) -> Path:
        """Write overlay scenario, table, history and settings into a folder and return the path of the scenario."""
        place = Path(out)
        place.mkdir(parents=True, exist_ok=True)
        write_whole(place / OVERLAY, self.yaml)
        write_whole(place / TABLE, self.table.to_csv(index=False))
        write_whole(place / HISTORY, self.history.to_csv(index=False))
        write_whole(place / RESULT, json.dumps(self.data, indent=2, ensure_ascii=False) + "\n")
        return place / OVERLAY

    def _repr_html_(self) -> str:
        held_out = {True: ", also held out", False: ", not held out", None: ""}[self.improved_held_out]
        verdict = f"improved{held_out}" if self.improved else "not improved: the initial gains are the best"
        return verdict_html(f"{verdict}; {repr(self).strip('<>')}") + str(self.table.to_html(max_rows=20))

    def __repr__(self) -> str:
        gains = ", ".join(f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
                          for name, value in self.gains.items())  # fmt: skip
        return f"<TuneResult {self.law}: {gains}>"


def result_row(label: str, part: str, gains: str, metrics: Mapping[str, Any], score: float) -> dict[str, Any]:
    """Return the row of one run: score, terms of the score in their units, outcome and verdict."""
    return {
        "run": label,
        "part": part,
        "gains": gains,
        "score": score,
        **{term.metrics[0]: term.value(metrics) for term in TERMS},
        "tracking": metrics.get("tracking") or metrics.get("failure") or metrics.get("status"),
        "verdict": metrics.get("verdict"),
    }


def history_row(
    number: int, generation: int, gains: Mapping[str, Any], scores: Sequence[float], labels: Sequence[str]
) -> dict[str, Any]:
    """Return the row of one candidate; score columns have the labels of the runs."""
    score = GainScore.of(scores)
    return {
        "candidate": number,
        "generation": generation,
        **gains,
        "objective": score.objective,
        "mean": score.mean,
        "worst": score.worst,
        **{f"score: {label}": value for label, value in zip(labels, scores, strict=True)},
    }
