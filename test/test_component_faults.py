"""Laws, observers and compensations that raise, hang or return nonsense: the train stops, the run says why."""

from __future__ import annotations

import inspect
import sys
import time
from typing import Any

import numpy as np
import pytest

import train_ato as ta
from train_ato import interrupt
from train_ato.control.contract import LawOutput
from train_ato.errors import RunFailed

BEGIN_S = 20.0
METRO = {"duration": 90}


class Unsound:
    """Law with the feed-forward, and a fault from a time on."""

    def __init__(self, fault: str = "divides") -> None:
        self.fault = fault
        self.steps = 0

    def bind(self, model: Any, period: float) -> None:
        self.gain = 0.3 * model.inertia * model.share

    def reset(self) -> None:
        pass

    def step(self, inputs: Any) -> Any:
        self.steps += 1
        if inputs.t >= BEGIN_S:
            return getattr(self, self.fault)()
        return LawOutput(inputs.feedforward - self.gain * (inputs.velocity - inputs.reference_velocity))

    def divides(self) -> Any:
        return 1 / 0

    def nan(self) -> Any:
        return LawOutput(np.array([np.nan]))

    def nothing(self) -> Any:
        return None

    def number(self) -> Any:
        return 3.0

    def long(self) -> Any:
        return LawOutput(np.zeros(4))

    def text(self) -> Any:
        return LawOutput("full")  # type: ignore[arg-type]

    def exits(self) -> Any:
        sys.exit(0)

    def interrupts(self) -> Any:
        raise KeyboardInterrupt

    def loops(self) -> Any:
        while True:
            pass

    def sleeps(self) -> Any:
        time.sleep(600.0)


class UnsoundObserver:
    """Observer that raises after 20 s."""

    def __init__(self, gain: float = 1.0) -> None:
        self.gain = gain

    def bind(self, model: Any, period: float) -> None:
        self.left = round(BEGIN_S / period)

    def reset(self) -> None:
        pass

    def step(self, inputs: Any) -> Any:
        self.left -= 1
        if self.left < 0:
            raise ValueError("no measurement")
        return np.zeros(1)


def failed(scenario: str = "xuzhou_metro", **options: Any) -> RunFailed:
    with pytest.raises(RunFailed) as caught:
        ta.run(scenario, **options)
    assert caught.value.run is not None
    return caught.value


def speeds(error: RunFailed) -> tuple[float, float]:
    """Return the speed at the fault and at the end [m/s]."""
    recording = error.run.recording
    return float(np.interp(BEGIN_S, recording.time, recording.front_velocity)), float(recording.front_velocity[-1])


FAULTS = {
    "divides": "ZeroDivisionError: division by zero",
    "nan": "step() returned [nan] N; return LawOutput(force=array of 1)",
    "nothing": "step() returned NoneType; return LawOutput(force=array of 1)",
    "number": "step() returned float; return LawOutput(force=array of 1)",
    "long": "step() returned [0.0, 0.0, 0.0, 0.0] N, shape (4,); return LawOutput(force=array of 1)",
    "text": "step() returned force of type str; return LawOutput(force=array of 1)",
    "exits": "called sys.exit(0)",
    "interrupts": "KeyboardInterrupt",
    "loops": "step() did not return within 0.5 s",
    "sleeps": "step() did not return within 0.5 s",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_of_a_law_stops_the_train_and_fails_the_run(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the run ends while the train moves, brakes at another time than after a NaN, or lacks file and line."""
    monkeypatch.setattr(interrupt, "STEP_LIMIT_S", 0.5)
    monkeypatch.setattr("train_ato.control.component_fault.STEP_LIMIT_S", 0.5)
    error = failed(law=Unsound(fault), set=METRO)
    method = getattr(Unsound, fault)
    first = inspect.getsourcelines(method)[1]
    said = str(error)
    assert said.startswith(f"node controller failed: law Unsound: {FAULTS[fault]}, {__file__}:")
    line = int(
        said.removeprefix(f"node controller failed: law Unsound: {FAULTS[fault]}, {__file__}:").partition(";")[0]
    )
    raised = fault in ("divides", "exits", "interrupts", "loops", "sleeps")
    assert first < line <= first + 2 if raised else line == inspect.getsourcelines(Unsound.step)[1]
    moving, end = speeds(error)
    assert moving > 5.0 and abs(end) < 0.1
    command = error.run.recording.command[:, 0]
    at = round(BEGIN_S / 0.05)
    assert (command[at : at + 20] == command[at - 1]).all(), "the bound: 1 s"
    assert command[at + 20 :].min() < -100e3, "then the braking law"
    assert error.run.metrics["status"] == "failed"


def test_a_supervised_run_stops_in_the_same_way() -> None:
    """Breaks if the run goes on after the stop."""
    error = failed("xuzhou_metro:disturbed", law=Unsound("nan"), set=METRO)
    moving, end = speeds(error)
    assert moving > 5.0 and abs(end) < 0.1


def test_an_observer_that_raises_stops_the_train() -> None:
    """Breaks if the run ends while the train moves, or the line lacks the observer, the file or the node."""
    error = failed(observer=UnsoundObserver(), set=METRO)
    assert str(error).startswith(
        f"node observer failed: observer UnsoundObserver: ValueError: no measurement, {__file__}:"
    )
    moving, end = speeds(error)
    assert moving > 5.0 and abs(end) < 0.1


@pytest.mark.parametrize("mode", ["engine", pytest.param("composed", marks=pytest.mark.graph)])
def test_a_law_object_is_the_object_that_runs(mode: Any) -> None:
    """Breaks if the run makes another law from the keywords: the user's object would see no step."""
    law = Unsound("nan")
    run = ta.run("xuzhou_metro", law=law, set={"duration": 10}, mode=mode)
    assert law.steps == run.metrics["ticks"] == 200


@pytest.mark.graph
def test_a_law_that_loops_stops_the_nodes_of_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the executor hangs with the law."""
    monkeypatch.setattr(interrupt, "STEP_LIMIT_S", 0.5)
    error = failed("xuzhou_metro:disturbed", law=Unsound("loops"), set=METRO, mode="composed")
    assert "step() did not return within" in str(error) and __file__ in str(error)
    assert abs(speeds(error)[1]) < 0.1
