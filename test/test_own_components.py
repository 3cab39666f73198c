"""Components without registration and their templates: in all modes, and their exceptions in a run."""

import importlib
import inspect
import json
import os
import sys
import time
from dataclasses import dataclass, make_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from law_trains import FIVE, inputs, model
from refusals import one_line

import train_ato as ta
from train_ato.cli.main import main
from train_ato.cli.new import CODE_KINDS
from train_ato.control.command_hold import CommandHold
from train_ato.control.compensation.base import CompensationBase
from train_ato.control.component_fault import output_fault, text_of_error
from train_ato.control.contract import LawOutput, parameter
from train_ato.control.guard import GuardedLaw
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS, in_contract_form
from train_ato.program import interrupt
from train_ato.program.errors import RunFailed

EXAMPLES = Path(__file__).parents[1] / "examples"
KEYS = ("speed_rmse_kmh", "coupler_draft_max_kn", "energy_traction_kwh")
SHORT = {"duration": 20}
OBSERVER, COMPENSATION = "my_observer:MyObserver", "my_compensation:MyCompensation"
CHANGES = {f"observers.{OBSERVER}.filter_time": 2.0, f"compensations.{COMPENSATION}.ratio": 0.5}


@pytest.fixture
def templates(monkeypatch):
    """Make the templates importable; return the classes of observer and compensation."""
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLES), prepend=os.pathsep)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    for registry in (OBSERVERS, COMPENSATIONS):
        monkeypatch.setattr(registry, "_unregistered", {})
    yield tuple(getattr(importlib.import_module(m), c) for m, c in (OBSERVER.split(":"), COMPENSATION.split(":")))
    for module in ("my_observer", "my_compensation"):
        sys.modules.pop(module, None)


def figures(run):
    return [run.metrics[key] for key in KEYS]


def test_names_classes_and_objects_give_the_same_run(templates, capsys, without_figure):
    """Breaks if object, class, name and command result in different runs, or a component loses its module."""
    observer, compensation = templates
    by_object = ta.run("demo", observer=observer(filter_time=2.0), compensation=compensation(0.5), set=SHORT)
    assert by_object.metrics["observer"] == OBSERVER and by_object.metrics["compensation"] == COMPENSATION
    assert by_object["ato/estimate"].abs().to_numpy().max() > 0.0
    assert [in_contract_form(each).__module__ for each in templates] == ["my_observer", "my_compensation"]
    by_class = ta.run("demo", observer=observer, compensation=compensation, set={**CHANGES, **SHORT})
    by_name = ta.run("demo", observer=OBSERVER, compensation=COMPENSATION, set={**CHANGES, **SHORT})
    assert figures(by_class) == figures(by_object) == figures(by_name)
    other = ta.run("demo", observer=observer, compensation=compensation, set=SHORT)
    assert not other["ato/estimate"].equals(by_object["ato/estimate"]) and figures(other) != figures(by_object)
    arguments = ["run", "demo", "--engine", "--observer", OBSERVER, "--compensation", COMPENSATION, "--json"]
    arguments += [f"--set={key}={value}" for key, value in {**CHANGES, **SHORT}.items()]
    assert main([*arguments, "--out", "out"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [found[key] for key in KEYS] == figures(by_object)


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    """Write and read in a folder of the test, from which own modules are found too."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)


def test_a_comparison_uses_the_components(templates):
    """Breaks if `compare` ignores a class or an object."""
    observer, compensation = templates
    options = {"observer": observer(2.0), "compensation": compensation(ratio=0.5), "set": SHORT}
    table = ta.compare("demo", ["pid"], **options).table
    assert table.loc["pid", "speed_rmse_kmh"] == ta.run("demo", **options).metrics["speed_rmse_kmh"]


def test_a_class_of_a_registered_component_has_its_name():
    """Breaks if a registered class does not use the parameters of its name."""
    run = ta.run("demo", observer=OBSERVERS.get("eso"), compensation=COMPENSATIONS.get("twin"), set=SHORT)
    assert (run.metrics["observer"], run.metrics["compensation"]) == ("eso", "twin")


@pytest.mark.campaign
@pytest.mark.parametrize("mode", ["composed", "processes"])
def test_every_mode_gives_the_same_run(mode, templates):
    """Breaks if a node does not find a component by its module, or its parameters are lost."""
    own = {"law": "my_law:MyLaw", "observer": OBSERVER, "compensation": COMPENSATION}
    changes = {"laws.my_law:MyLaw.gain": 0.3, **CHANGES, **SHORT}
    engine, graph = (ta.run("demo", **own, set=changes, mode=way) for way in ("engine", mode))
    assert graph.path is None and graph.metrics["mode"] == mode and graph.save("graph").is_dir()
    for topic in ("train/vehicles", "ato/estimate", "ato/command"):
        pd.testing.assert_frame_equal(engine[topic], graph[topic], check_exact=True)


@dataclass
class Predicting(CompensationBase):
    """Compensation of a notebook with an attribute of the contract."""

    gain: float = 1.0
    predicts = True

    def step(self, inputs):
        return self.law_input(inputs, inputs.t, np.zeros(self.model.n_units), shoes=self.shoes.at(inputs.t, 0.0))


class WithoutProfile:
    """Compensation without a method of the contract, which failed in the middle of a run."""

    def reset(self):
        """Clear nothing."""

    def step(self, inputs):
        """Return nothing."""


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"observer": "esoo"}, r"unknown observer 'esoo'; did you mean 'eso'\?"),
        ({"observer": 3}, r"observer 3: give a name, 'module:Class', a class or an object"),
        ({"compensation": ("twin",)}, r"compensation \('twin',\): give a name"),
        ({"compensation": "my_compensation:Nothing"}, r"module 'my_compensation' has no class 'Nothing'"),
        ({"observer": type("Empty", (), {})}, r"observer: class Empty has no method reset\(\)"),
        ({"compensation": WithoutProfile}, r"compensation: class WithoutProfile has no method set_profile"),
        ({"compensation": WithoutProfile()}, r"compensation: class WithoutProfile has no method set_profile"),
        ({"compensation": Predicting, "law": "gpc"}, r"'gpc' .*Predicting.* predicts the state"),
        ({"compensation": Predicting, "set": {"compensations.pid.kp": 1}}, r"unknown compensation 'pid'"),
    ],
)
def test_bad_input_is_refused_in_one_line(options, message, templates, tmp_path):
    """Breaks if a wrong component starts a run, or the error has no remedy."""
    with one_line(message):
        ta.run("demo", **{"set": SHORT, **options})
    assert list(tmp_path.iterdir()) == []


def test_a_component_of_a_function_cannot_go_to_other_processes(templates):
    """Breaks if the refusal comes from another process."""

    class Local(templates[0]):
        pass

    with pytest.raises(ValueError, match="mode 'processes': another process cannot import the observer"):
        ta.run("demo", observer=Local(), mode="processes")


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
            return ANSWERS[self.fault] if self.fault in ANSWERS else getattr(self, self.fault)()
        return LawOutput(inputs.feedforward - self.gain * (inputs.velocity - inputs.reference_velocity))

    def divides(self) -> Any:
        return 1 / 0

    def exits(self) -> Any:
        sys.exit(0)

    def interrupts(self) -> Any:
        raise KeyboardInterrupt

    def loops(self) -> Any:
        while True:
            pass

    def sleeps(self) -> Any:
        time.sleep(600.0)


ANSWERS: dict[str, Any] = {
    "nan": LawOutput(np.array([np.nan])), "nothing": None, "number": 3.0, "long": LawOutput(np.zeros(4)),
    "text": LawOutput("full"), "whole": LawOutput(np.array([1000])),
    "pressure": LawOutput(np.zeros(1), brake_pipe=np.nan),
}  # fmt: skip
"""Outputs of a step of :class:`Unsound`."""


class UnsoundObserver:
    """Observer that raises after 20 s, or returns an answer."""

    def __init__(self, gain: float = 1.0) -> None:
        self.gain = gain

    def bind(self, model: Any, period: float) -> None:
        self.left = round(BEGIN_S / period)

    def reset(self) -> None:
        pass

    def step(self, inputs: Any) -> Any:
        self.left -= 1
        return np.zeros(1) if self.left >= 0 else self.answer()

    def answer(self) -> Any:
        raise ValueError("no measurement")


def failed(scenario: str = "xuzhou_metro", **options: Any) -> RunFailed:
    with pytest.raises(RunFailed) as caught:
        ta.run(scenario, **options)
    assert caught.value.run is not None
    return caught.value


def assert_stopped(error: RunFailed) -> None:
    """Require a train in motion at the fault and at standstill at the end."""
    recording = error.run.recording
    assert np.interp(BEGIN_S, recording.time, recording.front_velocity) > 5.0
    assert abs(recording.front_velocity[-1]) < 0.1


FAULTS = {
    "divides": "ZeroDivisionError: division by zero",
    "nan": "step() returned [nan] N; return LawOutput(force=array of 1)",
    "nothing": "step() returned NoneType; return LawOutput(force=array of 1)",
    "number": "step() returned float; return LawOutput(force=array of 1)",
    "long": "step() returned [0.0, 0.0, 0.0, 0.0] N, shape (4,); return LawOutput(force=array of 1)",
    "text": "step() returned force of type str; return LawOutput(force=array of 1)",
    "pressure": "step() returned brake_pipe nan Pa; return LawOutput(force=array of 1)",
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
    begin = f"node controller failed: law Unsound: {FAULTS[fault]}, {__file__}:"
    assert str(error).startswith(begin)
    line = int(str(error).removeprefix(begin).partition(";")[0])
    first = inspect.getsourcelines(Unsound.step if fault in ANSWERS else getattr(Unsound, fault))[1]
    assert line == first if fault in ANSWERS else first < line <= first + 2
    assert_stopped(error)
    command = error.run.recording.command[:, 0]
    at = round(BEGIN_S / 0.05)
    assert (command[at : at + 20] == command[at - 1]).all(), "the bound: 1 s"
    assert command[at + 20 :].min() < -100e3, "then the braking law"
    assert error.run.metrics["status"] == "failed"


class Counts(Unsound):
    """Law whose diagnostics have a number and a half of a character, and an error from a time on."""

    def diagnostics(self) -> Any:
        return {"steps": self.steps, "unit": "\udcff"} if self.steps < BEGIN_S / 0.05 else self.divides()


def test_the_text_of_a_held_command_is_printable() -> None:
    """Breaks if half of a character in the text of a law fails the run by the codec, without the name of the law."""
    hold = CommandHold(0.1, 0.05)
    for _ in range(3):
        hold.hold("law Own: \udcff", by_component=True)
    with pytest.raises(RunFailed, match=r"law Own: \\udcff"):
        hold.check_limit()


def test_an_error_in_the_diagnostics_of_a_law_stops_the_train() -> None:
    """Breaks if the run ends while the train moves, the message has no law, or a number in place of a text fails it."""
    error = failed(law=Counts("whole"), set=METRO)
    assert f"node controller failed: law Counts: {FAULTS['divides']}, {__file__}:" in str(error)
    assert_stopped(error)


class Silent(Unsound):
    """Law whose diagnostics are nothing."""

    def diagnostics(self) -> Any:
        return None


class Misses(Unsound):
    """Law that fails without a measurement."""

    def on_missed_sample(self) -> None:
        raise KeyError("missed")


@dataclass
class Absent(CompensationBase):
    """Compensation that returns nothing."""

    def step(self, inputs: Any) -> Any:
        return None


@dataclass
class Wide(Predicting):
    """Compensation that returns forces of seven units."""

    def step(self, inputs: Any) -> Any:
        return replace(super().step(inputs), feedforward=np.zeros(7))


@dataclass
class Spoilt(Predicting):
    """Compensation that returns no number."""

    def step(self, inputs: Any) -> Any:
        return replace(super().step(inputs), position=np.array([np.nan]))


@pytest.mark.parametrize(("given", "said", "method", "faults"), [
    ({"law": Silent("whole")}, "law Silent: diagnostics() returned NoneType; return a dictionary of texts",
     Silent.diagnostics, []),
    ({"law": Misses("whole")}, "law Misses: KeyError: 'missed'", Misses.on_missed_sample,
     [{"topic": "train/measurement", "do": "drop", "end": 0.2}]),
    ({"compensation": Absent}, "compensation Absent: step() returned NoneType; return LawInput(...)", Absent.step, []),
    ({"compensation": Wide}, "compensation Wide: step() returned feedforward of shape (7,); return an array of 1",
     Wide.step, []),
    ({"compensation": Spoilt}, "compensation Spoilt: step() returned invalid inputs: position", Spoilt.step, []),
])  # fmt: skip
def test_every_method_that_is_wrong_is_named_with_its_file(given: Any, said: str, method: Any, faults: Any) -> None:
    """Breaks if the line has a file of this project in place of that of the component, or no component."""
    error = failed("demo" if faults else "xuzhou_metro", **given, set={**METRO, "faults": faults})
    begin = f"node controller failed: {said}, {__file__}:"
    assert str(error).startswith(begin)
    line = int(str(error).removeprefix(begin).partition(";")[0])
    assert 0 <= line - inspect.getsourcelines(method)[1] <= 1


def test_the_pipe_has_a_command_before_the_first_measurement() -> None:
    """Breaks if the plant of a graph waits for a brake-pipe command that never comes."""
    faults = [{"topic": "train/measurement", "do": "drop", "end": 0.5}]
    run = ta.run("demo", set={"duration": 2, "faults": faults})
    assert len(run["ato/brake_pipe_command"]) == len(run["ato/command"]) == 20


def test_an_output_that_is_nonsense_names_the_step_that_returned_it() -> None:
    """Breaks if a law that derives from another one is reported at the line of the law that it replaced."""

    class Demands(Unsound):
        def demand(self, inputs: Any) -> list[float]:
            return []

    class Steps(Demands):
        def step(self, inputs: Any) -> Any:
            return None

    for law, method in ((Demands("nan"), Demands.demand), (Steps("nan"), Steps.step)):
        found = output_fault("own", law, None, 1)
        assert found.endswith(f", {__file__}:{inspect.getsourcelines(method)[1]}")


class Demands(GuardedLaw):
    """Law with any result of its demand."""

    def __init__(self, wanted: Any = None) -> None:
        self.wanted = wanted

    def demand(self, inputs: Any) -> Any:
        return self.wanted


NO_FORCES = (
    None, 1000.0, "pull", [1e3], [1e3, 1e3, 1e3, 1e3, "1 kN"], "11111", b"11111", ["1000"] * 5, dict.fromkeys(range(5)),
    set(range(5)), [True] * 5, np.full(5, 1e3 + 1j), np.full(5, 5, "m8[s]"), [[1.0], [1.0, 2.0], 1.0, 1.0, 1.0],
    iter([1e3] * 5),
)  # fmt: skip


@pytest.mark.parametrize("wanted", NO_FORCES)
def test_a_demand_that_is_no_list_of_all_units_is_refused(wanted: Any) -> None:
    """Breaks if one number counts for all five units, or if the line names the guard in place of the own law.

    Keys of a dictionary, bytes of a text and the real part of complex numbers are no forces either.
    """
    law = Demands(wanted)
    law.bind(model(FIVE), 0.1)
    found = output_fault("own:Demands", law, law.step(inputs(law.model)), 5)
    assert found.startswith("law Demands: demand() returned ")
    assert "; return a list of 5 forces, " in found and " 0x" not in found
    assert found.endswith(f", {__file__}:{inspect.getsourcelines(Demands.demand)[1]}")
    law.wanted = np.full(5, 1e3)
    assert output_fault("own:Demands", law, law.step(inputs(law.model)), 5) == ""


def test_a_law_that_counts_in_n_keeps_the_limits() -> None:
    """Breaks if a counter of a law takes the number of units of the guard, which then passes any force on."""
    law = Demands(np.full(5, 1e9))
    law.bind(model(FIVE), 0.1)
    law.n += 1
    law.reset()
    given = inputs(law.model)
    assert law.step(given).force.tolist() == given.force_max.tolist() and law.saturated == [True] * 5


@pytest.mark.parametrize("name", ["period", "n", "share", "model"])
def test_a_parameter_that_the_train_replaces_is_refused(name: str) -> None:
    """Breaks if a parameter of a law has no effect, because the guard sets an attribute of its name."""
    law = make_dataclass("Named", [(name, float, parameter(0.7, "1", 0.0, 1.0, "own"))], bases=(Demands,))
    with pytest.raises(ValueError, match=rf"bind\(\) replaces its parameter '{name}'; choose another name"):
        LAWS.make(LAWS.name_of(law), {}, model(FIVE), 0.1)


@dataclass(slots=True)
class Completed:
    """Law whose own ``bind()`` completes a parameter."""

    gain: float = 0.0

    def bind(self, model: Any, period: float) -> None:
        self.gain = self.gain or 0.2 / period

    reset = step = lambda *_: None


def test_a_law_can_complete_its_parameters_for_the_train() -> None:
    """Breaks if a default that ``bind()`` computes is refused, or a law with slots."""
    assert LAWS.make(LAWS.name_of(Completed), {}, model(FIVE), 0.1).gain == 2.0
    assert LAWS.make(LAWS.name_of(Completed), {"gain": 0.5}, model(FIVE), 0.1).gain == 0.5


def test_the_text_of_an_error_is_printable() -> None:
    """Breaks if a log refuses half of a character in the text of an error, or a text that cannot be made hides it."""

    class Wordless(Exception):
        def __str__(self) -> str:
            raise RuntimeError("no text")

    assert text_of_error(ValueError("bad \udcff\nend")).startswith(r"ValueError: bad \udcff end")
    assert text_of_error(Wordless()).startswith("Wordless: its text cannot be made")


def test_a_text_that_is_no_python_has_the_place_that_reads_it() -> None:
    """Breaks if a SyntaxError in a step has the place in the text only, not file and line of the law."""
    try:
        eval("1 +")
    except SyntaxError as error:
        line = error.__traceback__.tb_lineno  # type: ignore[union-attr]
        assert text_of_error(error) == f"SyntaxError: invalid syntax (<string>, line 1), {__file__}:{line}"


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("horizon", "all", "horizon is 'all'; give a number of entries, 0 or more"),
        ("horizon", -1, "horizon is -1; give a number of entries, 0 or more"),
        ("horizon", True, "horizon is True; give a number of entries, 0 or more"),
        ("lookahead_times", [1.0, 2.0], r"lookahead_times is \[1.0, 2.0\]; give a numpy array of times in s"),
        ("lookahead_times", np.array([1.0, np.nan]), r"lookahead_times is \[ 1. nan\]; give a numpy array"),
        ("lookahead_times", np.ones((2, 2)), "lookahead_times is .*; give a numpy array"),
    ],
)
def test_a_wrong_preview_is_refused_at_the_start(name: str, value: Any, says: str) -> None:
    """Breaks if the run begins and then blames the compensation, which reads horizon and times of the law."""
    law = type("Ahead", (Demands,), {name: value, "__init__": lambda law: None})
    with pytest.raises(ValueError, match=f"law '.*Ahead': {says}"):
        LAWS.make(LAWS.name_of(law), {}, model(FIVE), 0.1)


def test_a_horizon_of_an_observer_is_its_own() -> None:
    """Breaks if an observer is refused for a name that the program reads of laws only."""
    observer = type("Ahead", (OBSERVERS.get("none"),), {"horizon": 2.5})
    assert OBSERVERS.make(OBSERVERS.name_of(observer), {}, model(FIVE), 0.1).horizon == 2.5


def test_a_bind_without_its_base_is_named() -> None:
    """Breaks if the line speaks of an attribute of the base class."""
    with pytest.raises(TypeError, match=r"its bind\(\) does not call super\(\)\.bind\(model, period\)"):
        Demands().reset()


def brakes_after(observer: Any, said: str, mode: Any = "engine") -> None:
    """Require an error that begins with these words and the place, and a train that was braked to standstill."""
    error = failed(observer=observer, set=METRO, mode=mode)
    assert str(error).startswith(f"node observer failed: observer {said}, {__file__}:")
    assert_stopped(error)


def test_a_supervised_run_stops_in_the_same_way() -> None:
    """Breaks if the run goes on after the stop."""
    assert_stopped(failed("xuzhou_metro:disturbed", law=Unsound("nan"), set=METRO))


@pytest.mark.parametrize(
    "mode", ["engine", *(pytest.param(mode, marks=pytest.mark.graph) for mode in ("composed", "processes"))]
)
def test_an_observer_that_raises_stops_the_train(mode: Any) -> None:
    """Breaks if the run ends while the train moves, or the line lacks the observer, the file or the node."""
    brakes_after(UnsoundObserver, "UnsoundObserver: ValueError: no measurement", mode=mode)


@pytest.mark.parametrize(
    ("answer", "fault"), [(np.array([np.nan]), "[nan] N"), (np.zeros(2), "shape (2,)"), (0.0, "float")]
)
def test_an_observer_that_returns_nonsense_stops_the_train(answer: Any, fault: str) -> None:
    """Breaks if the codec of the message ends the run while the train moves, without file and line."""
    observer = UnsoundObserver()
    observer.answer = lambda: answer
    brakes_after(observer, f"UnsoundObserver: step() returned {fault}; return an array of 1")


def test_whole_numbers_are_forces() -> None:
    """Breaks if an array of int64 ends the run while the train moves, because the messages have float64 only."""
    observer = UnsoundObserver()
    observer.answer = lambda: np.array([0])
    run = ta.run("xuzhou_metro", law=Unsound("whole"), observer=observer, set={"duration": 22})
    assert run.metrics["ticks"] == 440 and run.recording.command[-1, 0] == 1000.0


class Writer(UnsoundObserver):
    """Law and observer: writes into all its inputs, and returns an array of its own that the next step changes."""

    writes = False

    def bind(self, model: Any, period: float) -> None:
        self.own, self.seen = np.zeros(model.n_units), []

    def step(self, inputs: Any) -> Any:
        given = [value for name in inputs.__slots__ if isinstance(value := getattr(inputs, name), np.ndarray)]
        self.seen.append([value.tolist() for value in given])
        self.own += 1000.0
        for value in given if self.writes else ():
            value += 1.0
        return self.own if self.gain else LawOutput(self.own)


@pytest.mark.parametrize("scenario", ["demo", "xuzhou_metro"])
def test_writing_into_the_inputs_changes_no_message(scenario: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the log has what a law or an observer wrote, or all estimates are the last one, or a step sees it."""
    parts = [(Writer(0.0), Writer(1.0)) for _ in range(2)]
    runs = []
    for writes, (law, observer) in zip((False, True), parts, strict=True):
        monkeypatch.setattr(Writer, "writes", writes)
        runs.append(ta.run(scenario, law=law, observer=observer, set={"duration": 3}))
    for topic in ("train/measurement", "ato/estimate", "ato/command"):
        pd.testing.assert_frame_equal(runs[0][topic], runs[1][topic])
    assert [part.seen for part in parts[0]] == [part.seen for part in parts[1]]
    assert runs[0]["ato/estimate"].iloc[:3, -1].tolist() == [1000.0, 2000.0, 3000.0]


@pytest.mark.parametrize("mode", ["engine", pytest.param("composed", marks=pytest.mark.graph)])
def test_a_law_object_is_the_object_that_runs(mode: Any) -> None:
    """Breaks if the run makes another law from the keywords: the user's object would see no step."""
    law = Unsound("nan")
    run = ta.run("xuzhou_metro", law=law, set={"duration": 10}, mode=mode)
    assert law.steps == run.metrics["ticks"] == 200


def test_changes_of_the_parameters_of_an_object_are_refused() -> None:
    """Breaks if a change has no effect without a word, because the object's own value replaces it."""
    law, changes = Unsound("nan"), {f"laws.{LAWS.name_of(Unsound)}.fault": "whole"}
    for call in (ta.run, ta.learn, ta.tune, lambda name, law, set: ta.compare(name, [law], set=set)):
        with pytest.raises(ValueError, match=r"set laws\..*\.fault: no effect on an object, .* here Unsound"):
            call("xuzhou_metro", law=law, set=changes)
    run = ta.compare("xuzhou_metro", [Unsound("whole"), Unsound], set={**changes, "duration": 1})
    assert list(run.table["status"]) == ["done", "done"]


@pytest.mark.graph
def test_a_law_that_loops_stops_the_nodes_of_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the executor hangs with the law."""
    monkeypatch.setattr(interrupt, "STEP_LIMIT_S", 0.5)
    error = failed("xuzhou_metro:disturbed", law=Unsound("loops"), set=METRO, mode="composed")
    assert "step() did not return within" in str(error) and __file__ in str(error)
    assert_stopped(error)


@pytest.mark.parametrize(
    ("files", "arguments"),
    [
        (["train a"], "plan level a.yaml --to-km 3 --no-bound"),
        (["line b"], "plan b.yaml xuzhou_metro_3 --no-bound"),
        (["scenario c", "journey d"], "plan line.yaml train.yaml --journey d.yaml --no-bound"),
        (["train e --like xuzhou_metro_3", "line f --like level"], "plan f.yaml e.yaml --to-km 3 --no-bound"),
    ],
)
def test_a_new_file_is_planned(files: list[str], arguments: str) -> None:
    for new in files:
        assert main(["new", *new.split()]) == 0
    assert main(arguments.split()) == 0


@pytest.mark.parametrize("law", ["pid", "smc"])
def test_a_new_scenario_stops_within_a_tenth_of_a_metre(law: str) -> None:
    """Breaks if the example of an own metro misses a stop, or a criterion, with default gains."""
    assert main(["new", "scenario", "mine"]) == 0
    run = ta.run("mine.yaml", law=law, progress=False)
    assert run.metrics["verdict"] == "passed", run.metrics["criteria"]
    errors = [stop["beyond_m"] for stop in run.metrics["stops"]]
    assert len(errors) == 4 and max(map(abs, errors)) < 0.1


def test_a_scenario_like_a_shipped_one_has_its_profile() -> None:
    """Breaks if the file of a driver's profile is not copied beside the scenario that names it."""
    assert main(["new", "scenario", "mine", "--like", "daqin_heavy_haul"]) == 0
    assert Path("daqin_driver.csv").is_file() and ta.scenario("mine.yaml").name == "mine"


@pytest.mark.parametrize("kind", CODE_KINDS)
@pytest.mark.parametrize("like", [False, True])
def test_new_code_drives(kind: str, like: bool, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a template is not renamed, or a shipped law, observer or compensation does not run as a copy."""
    first = {"law": "pid", "observer": "eso", "compensation": "preview"}[kind]
    assert main(["new", kind, f"{'copied' if like else 'begun'}_{kind}", *(["--like", first] if like else [])]) == 0
    (target,) = [word for word in capsys.readouterr().out.split() if ":" in word and word != "next:"]
    run = ta.run("demo", set={"duration": 20}, progress=False, **{kind: target})
    assert run.metrics["tracking"] == "tracked"


@pytest.mark.parametrize("name", ["numpy", "class", "train_ato"])
def test_new_code_has_a_name_that_python_can_import(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if ``new`` writes a file that another module hides, so that the printed next command is refused."""
    assert main(["new", "law", name]) == 2
    assert f"NAME {name}: Python has this word or module already" in capsys.readouterr().err
    assert not list(Path().iterdir())


def test_a_folder_may_have_the_name_of_new_code() -> None:
    """Breaks if a folder without Python files counts as a module."""
    Path("mine").mkdir()
    assert main(["new", "law", "mine"]) == 0 and Path("mine.py").is_file()
