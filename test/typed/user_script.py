"""Script of a user, read by mypy with the package: every result has a type, none is ``Any``."""

from typing import Literal

import pandas as pd
from typing_extensions import assert_type

import train_ato as ta
from train_ato.control.algorithms.linear_train import LinearTrain
from train_ato.control.contract import LawInput, LawOutput


class Proportional(ta.Law):
    """Law of a user."""

    gain: float = ta.parameter(0.05, unit="1/s", low=0.0, high=1.0, meaning="gain of the speed error")

    def step(self, given: LawInput) -> LawOutput:
        """Return no force."""
        return LawOutput(force=0.0 * given.velocity)


def study() -> float:
    """Use the functions of the package."""
    run = ta.run("demo", law=Proportional, set={"duration": 20.0}, seed=3)
    assert_type(run, ta.Run)
    assert_type(run.result.verdict, Literal["passed", "failed", "incomplete", "aborted", "none"])
    assert_type(run.result.stops[0].beyond_m, float | None)
    assert_type(run.result.energy.traction_kwh, float | None)
    found = ta.difference(run, "runs/demo-1")
    assert_type(found.energy, dict[str, float | None])
    assert_type(found.line, str)
    assert_type(ta.linearise("demo", speed_kmh=40.0), LinearTrain)
    assert_type(ta.compare("demo", ["pid", Proportional]).table, pd.DataFrame)
    env = ta.Env("demo")
    env.reset(seed=1)
    assert_type(env.step([0.0])[1], float)
    assert_type(env.period, float)
    changed = ta.scenario("demo").with_({"duration": 30})
    assert_type(ta.run(changed).result.passed, bool)
    assert_type(ta.laws(), dict[str, str])
    table: pd.DataFrame = run["train/measurement"]
    try:
        ta.open_run("nowhere")
    except ta.InputError as error:
        assert_type(str(error), str)
    return float(len(table))
