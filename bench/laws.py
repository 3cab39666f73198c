"""Time of `step()` of every law, compared with a law that only returns its output.

    python bench/laws.py [LAW ...]

Every law first controls a suitable train; its inputs there are stored and used again in several rounds.  The time of a
step is the best of these rounds, because other load on the machine only adds time.  Median and 99th percentile are over
the steps, so a longer step (a new identification of a model) is included.  The goals are medians; the exit status is 1
if one is missed widely (see figures.py).
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from figures import Figure, judge, publish

from train_ato.control.contract import LawInput, LawOutput
from train_ato.control.registry import LAWS
from train_ato.loop.engine import run_engine
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare

ROUNDS = 9
STEPS = 1000
"""Longest run, in steps of the law."""
WARM = 50
"""Number of first steps that do not count."""


@dataclass(frozen=True)
class Ride:
    """Law, scenario of a suitable train, and goal for the time of one step [us]; None: no goal."""

    law: str
    scenario: str
    goal: float | None = None
    changes: dict[str, Any] = field(default_factory=dict)
    note: str = ""


GPC = {"control_period": 1.2, "compensation": "none"}
RIDES = (
    Ride("pid", "demo", 5.0),
    Ride("smc", "daqin_heavy_haul:ideal", 15.0),
    Ride("rbf_smc", "daqin_heavy_haul:ideal", 15.0),
    Ride("rbf_switching_smc", "xuzhou_metro", 15.0),
    Ride("fixed_time_smc", "freight_consensus", None, note="five units"),
    Ride("lag_smc", "freight_consensus:realistic", None, note="five units"),
    Ride("funnel", "crh380a_funnel:short", 10.0),
    Ride("gpc", "crh380a_gpc:short", 100.0, GPC, "three units, one loop on their mean, every step a sample"),
    Ride(
        "gpc", "crh380a_gpc:short+free", 100.0, GPC | {"laws": {"gpc": {"structure": "unit"}}},
        "three units, a loop each, every step a sample",
    ),
)  # fmt: skip


class Floor:
    """Law that only returns an output."""

    def __init__(self, units: int) -> None:
        self._force = [0.0] * units

    def reset(self) -> None:
        """Forget nothing."""

    def step(self, inputs: LawInput) -> LawOutput:
        """Return 0 N for every unit."""
        return LawOutput(np.array(self._force))


def recorded(ride: Ride) -> tuple[Any, list[LawInput]]:
    """Run a scenario with the law; return a new instance of the law and the stored inputs."""
    inner = LAWS.get(ride.law)
    given: list[LawInput] = []

    class Recording(inner):  # type: ignore[misc, valid-type]
        def step(self, inputs: LawInput) -> LawOutput:
            given.append(inputs)
            output: LawOutput = super().step(inputs)
            return output

    LAWS.register(name := f"{ride.law}_recorded_{id(ride)}", Recording)
    scenario, path = load_scenario(ride.scenario, changes=ride.changes)
    period = scenario.control_period or scenario.tick
    parameters = scenario.laws.get(ride.law, {})
    changes = {"law": name, "laws": {name: parameters}, "duration": min(scenario.duration, STEPS * period)}
    setup = prepare(scenario.model_copy(update=changes), path)
    outcome = run_engine(setup)
    if outcome.failure:
        raise SystemExit(f"{ride.law} on {ride.scenario}: {outcome.failure}")
    return LAWS.make(ride.law, parameters, setup.model, period), given


def step_times(law: Any, given: Sequence[LawInput]) -> tuple[float, float]:
    """Return median and 99th percentile over the steps [us]; every step is the best of several rounds."""
    taken = np.empty((ROUNDS, len(given)))
    clock = time.perf_counter_ns
    for row in taken:
        law.reset()
        for index, inputs in enumerate(given):
            begin = clock()
            law.step(inputs)
            row[index] = clock() - begin
    median, high = np.percentile(taken[:, WARM:].min(axis=0), [50, 99]) / 1e3
    return float(median), float(high)


def main() -> int:
    """Print the table and the goals; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("laws", metavar="LAW", nargs="*", help="default: every registered law")
    options = parser.parse_args()
    chosen = options.laws or LAWS.loadable()
    known = {ride.law for ride in RIDES}
    rides = [ride for ride in RIDES if ride.law in chosen]
    rides += [Ride(name, "demo") for name in chosen if name not in known]
    status = 0
    for ride in rides:
        law, given = recorded(ride)
        floor, _ = step_times(Floor(given[0].force_min.size), given)
        median, high = step_times(law, given)
        where = ", ".join(filter(None, (ride.scenario, ride.note)))
        publish(Figure(f"{ride.law}, {where}, 99 %", high, "us", "no computation", floor))
        goal = Figure(f"{ride.law}, {where}, median", median, "us", "no computation", floor, ride.goal)
        status = max(status, judge([goal]))
    return status


if __name__ == "__main__":
    sys.exit(main())
