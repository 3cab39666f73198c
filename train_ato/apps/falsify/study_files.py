"""Files of a falsification: table of the runs, result as JSON, scenario of the break."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from train_ato.apps.falsify.study import Falsification
from train_ato.log.whole_file import write_whole

COUNTEREXAMPLE, RUNS_TABLE, RESULT = "counterexample.yaml", "runs.csv", "falsify.json"
"""Files in the folder of a falsification."""


def result_data(result: Falsification) -> dict[str, Any]:
    """Return the result as JSON data; values that are not finite are None."""
    row = result.smallest
    known = [entry.run.robustness for entry in result.rows if math.isfinite(entry.run.robustness)]
    return {
        "scenario": result.scenario.name,
        "requirement": result.target.name,
        "formula": result.target.formula,
        "unit": result.target.unit,
        "found": result.found,
        "interrupted": result.interrupted,
        "runs": len(result.rows),
        "runs_to_break": result.runs_to_break,
        "departure": None if row is None else row.departure,
        "robustness": None if row is None or not math.isfinite(row.run.robustness) else row.run.robustness,
        "smallest_robustness": min(known, default=None),
        "changes": result.changes,
        "nominal": {key: result.space.nominal_values[key] for key in result.changes},
        "problems": sum(bool(entry.run.problem) for entry in result.rows),
    }


def write_study(result: Falsification, folder: Path) -> None:
    """Write the table of the runs, the result and, after a break, the scenario that reproduces it."""
    write_whole(folder / RUNS_TABLE, result.table.to_csv(index=False))
    text = json.dumps(result_data(result), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_whole(folder / RESULT, text)
    if result.found:
        write_whole(folder / COUNTEREXAMPLE, result.yaml)
