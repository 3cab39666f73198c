"""A law in Python inside compiled spans gives the messages of ticks in Python, and receives the same inputs."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from case_costs import sampled
from span_runs import Both, compiled_part, finished_loop, setup_of
from test_compiled_spans import CASES as LAWS
from test_compiled_spans import COMPONENTS

from train_ato.control.compensation.base import CompensationBase
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.contract import LawInput, LawOutput, parameter
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.observers.record_observer import GuardedObserver
from train_ato.control.stack import ControlStack
from train_ato.loop import python_law, span
from train_ato.loop.engine import TickLoop, run_engine
from train_ato.studies.sweep.row import WALL_TIMES

FREE = {"supervision.enabled": False}
HERE = "test_python_law_spans"
DEMO = {**FREE, "duration": 60, "plant.sensors.couplers": [0]}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    **{case: LAWS[case] for case in (
        "pid under preview, air brake", "pid under twin, air brake", "pid with filters, noise", "pid, slow control",
        "smc, couplers measured", "funnel, resistance of the model, air brake", "law changes", "disturbances",
    )},
    **{case: COMPONENTS[case] for case in (
        "eso of the train, pid", "cascaded by Levant, fixed_time_smc", "predictor, springs, three units",
        "predictor, funnel", "policy trip",
    )},
    "gpc": ("xuzhou_metro", {"duration": 60, "law": "gpc", "compensation": "none"}),
    "gpc under preview": ("crh380a_gpc:short", {**FREE, "duration": 30, "compensation": "preview",
                                                "links.command.delay_brake": None, "model.delay_brake": None}),
    "supervised": ("demo", {"duration": 120}),
}  # fmt: skip
"""Scenario and changes, for every input of a law and every event that ends a span."""
LATE = {"delay": 0.15, "jitter": 0.1, "loss": 0.1}
PLANNED = {"policy": "planned", "events": [{"time": 20, "reduction": 5e4}, {"place": 900, "reduction": 0}]}
WHOLE: dict[str, tuple[str, dict[str, Any]]] = {
    "measurement late and lost": ("demo", {**DEMO, "links.measurement": LATE, "observer": "eso"}),
    "reference and estimate late": (
        "demo", {"duration": 60, "links.reference": LATE, "links.estimate": LATE, "observer": "ndo"}
    ),
    "brake pipe late": (
        "daqin_heavy_haul", {**FREE, "duration": 60, "tick": 0.05, "links.brake_pipe": LATE, "brake": PLANNED}
    ),
    "law changes": (
        "demo", {**DEMO, "law_changes": [{"at": 20.05, "law": "smc"}, {"at": 40, "law": "pid"}],
                 "links.measurement.delay": 0.1}
    ),
    "re-planning": (
        "xuzhou_metro", {"duration": 60, "replan": {}, "plant.jumps": [{"at": 12, "what": "gain", "factor": 0.5}]}
    ),
    "force shares and displacements": ("daqin_two_locomotives", {"duration": 60, "supervision.enabled": True}),
    "observer in Python, air brake": (
        "daqin_heavy_haul", {**FREE, "duration": 60, "tick": 0.05, "observer": f"{HERE}:Filtered", "brake": PLANNED}
    ),
    "observer in Python, supervised": ("demo", {"duration": 60, "observer": f"{HERE}:Filtered"}),
    "slow law with diagnostics": ("demo", {**DEMO, "law": f"{HERE}:Observed", "control_period": 0.3}),
}  # fmt: skip
"""Scenario and changes, for every part of a run that compiled ticks call with the whole control stack."""


@dataclasses.dataclass
class Observed:
    """Feed-forward and a gain, with all inputs kept as they were received."""

    gain: float = parameter(0.1, "1/s", 0.0, 10.0, "gain on the speed error")
    unusual: str = parameter("none", "", 0, 0, "unusual output", choices=("none", "held", "nan", "pipe", "error"))
    horizon = 3

    def reset(self) -> None:
        self.received: list[LawInput] = []
        self.copies: list[LawInput] = []

    def bind(self, model: Any, period: float) -> None:
        self._mass = model.inertia * model.share

    def step(self, inputs: LawInput) -> LawOutput:
        self.received.append(inputs)
        self.copies.append(dataclasses.replace(inputs, **{
            name: value.copy() for name, value in _fields(inputs).items() if isinstance(value, np.ndarray)
        }))  # fmt: skip
        force = inputs.feedforward - self.gain * self._mass * (inputs.velocity - inputs.reference_velocity)
        if self.unusual == "none" or round(inputs.t * 10) % 70:
            return LawOutput(force)
        if self.unusual == "error":
            raise ValueError("no force at this time")
        if self.unusual == "nan":
            return LawOutput(np.full_like(force, np.nan))
        if self.unusual == "pipe":
            return LawOutput(force, brake_pipe=5e5)
        return LawOutput(force, held="waits")

    def diagnostics(self) -> dict[str, str]:
        """Return a text that differs in every report."""
        return {"steps": str(len(self.received))}


@dataclasses.dataclass
class Pushing:
    """Full traction for 70 of every 100 s, so that the braking law takes over and gives back."""

    def reset(self) -> None:
        """Keep nothing."""

    def step(self, inputs: LawInput) -> LawOutput:
        return LawOutput(inputs.force_max if inputs.t % 100.0 > 30.0 else 0.0 * inputs.force_max)


class Counted(CompensationBase):
    """Feed-forward of the present time, with its calls and the commands as they were sent."""

    @dataclasses.dataclass
    class Parameters:
        """Parameters."""

        fails_at: float = parameter(1e6, "s", 0.0, 1e6, "time of an exception")

    def __init__(self, parameters: Any, model: Any, period: float) -> None:
        super().__init__(parameters, model, period)
        self.calls: list[tuple[float, bytes]] = []

    def on_command_sent(self, force: np.ndarray) -> None:
        self.calls.append((-1.0, force.tobytes()))

    def step(self, inputs: CompensationInput) -> LawInput:
        self.shoes.demand(inputs.t, inputs.pressure)
        self.calls.append((inputs.t, inputs.measurement.velocity.tobytes() + bytes([inputs.saturated])))
        if inputs.t >= self.parameters.fails_at:
            raise ValueError("no input at this time")
        shoes = self.shoes.at(inputs.t, inputs.reference.velocity)
        return self.law_input(inputs, inputs.t, self.feedforward(inputs.t, shoes.total), shoes=shoes)


@dataclasses.dataclass
class Filtered(GuardedObserver):
    """Filter of the measured forces, with an exception at a time."""

    fails_at: float = parameter(1e6, "s", 0.0, 1e6, "time of an exception")

    def clear_state(self) -> None:
        self.last = 0.0

    def estimate(self, inputs: ObserverInput) -> np.ndarray:
        if inputs.t >= self.fails_at:
            raise ValueError("no estimate at this time")
        self.last = 0.9 * self.last + 0.01 * (inputs.applied + inputs.shoe_force)
        return np.array(self.last)


def _fields(inputs: LawInput) -> dict[str, Any]:
    return {entry.name: getattr(inputs, entry.name) for entry in dataclasses.fields(inputs)}


def _as_bytes(inputs: LawInput) -> dict[str, Any]:
    """Return the inputs without signs of zero lost: arrays as types, shapes and bytes, numbers as texts."""
    values = {**_fields(inputs), "preview": None, "lookahead": None}
    values |= {f"preview.{name}": getattr(inputs.preview, name) for name in ("position", "velocity", "acceleration")}
    return {
        name: (value.dtype, value.shape, value.tobytes()) if isinstance(value, np.ndarray) else (type(value), value)
        for name, value in values.items()
    }


@pytest.fixture
def every_law_in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let shipped laws run as those of other packages."""
    monkeypatch.setattr(span, "is_in_loop", lambda law: False)


@pytest.mark.parametrize("case", sampled(CASES, every=2))
@pytest.mark.usefixtures("every_law_in_python")
def test_a_law_in_python_sends_the_messages_of_python(case: str) -> None:
    """Breaks if an input of the law, its order in the tick or its output differs in one bit, or no tick is compiled."""
    Both(setup_of(*CASES[case])).assert_equal(least=0.4)


@pytest.mark.parametrize("case", sampled(WHOLE, every=2))
def test_a_control_stack_is_called_as_a_whole(case: str) -> None:
    """Breaks if a delayed message, a pressure, a decision or an estimate is taken twice, late or not at all."""
    Both(setup_of(*WHOLE[case])).assert_equal(least=0.6)


def test_a_law_drives_again_after_the_braking_law_as_in_python() -> None:
    """Breaks if the step at which the braking law gives back is reported at the ticks after it too."""
    runs = Both(setup_of("crh380a_funnel:short", {"law": f"{HERE}:Pushing", "duration": 300}))
    runs.assert_equal(least=0.5)
    assert runs._other.summary["takeovers"] > 1


def test_the_case_of_replanning_has_a_new_profile() -> None:
    """Breaks if the comparison above has no decision of re-planning in it."""
    assert run_engine(setup_of(*WHOLE["re-planning"]), compiled=True).summary["replans"] == 1


def test_an_error_of_an_observer_brakes_as_in_python() -> None:
    """Breaks if compiled ticks drop the exception of an observer, or call it again."""
    name = f"{HERE}:Filtered"
    changes = {**DEMO, "observer": name, f"observers.{name}.fails_at": 20.0}
    python, compiled = (run_engine(setup_of("demo", changes), compiled=chosen) for chosen in (False, True))
    assert python.failure == compiled.failure and "no estimate at this time" in (python.failure or "")
    one, other = ({**each.summary, **dict.fromkeys(WALL_TIMES)} for each in (python, compiled))
    assert one == other


def _driven(changes: dict[str, Any], name: str = "demo", *, compiled: bool) -> ControlStack:
    """Return the control stack after a run, of which compiled spans have at least two fifths of the ticks."""
    loop = finished_loop(setup_of(name, changes), compiled=compiled)
    assert not compiled or (loop._spans is not None and loop._spans.ticks > 0.4 * loop.ticks)
    assert loop.controller.stack is not None
    return loop.controller.stack


@pytest.mark.parametrize(("name", "changes"), [
    ("demo", {**DEMO, "compensation": "none", "observer": "eso"}),
    ("demo", {**DEMO, "compensation": "preview"}),
    ("demo", {**DEMO, "compensation": "twin"}),
    ("demo", {**DEMO, "compensation": "predictor"}),
    ("daqin_heavy_haul", {**FREE, "duration": 60, "compensation": "preview", "brake": {
        "policy": "planned", "events": [{"time": 20, "reduction": 5e4}, {"time": 40, "reduction": 0}]}}),
], ids=["none", "preview", "twin", "predictor", "air brake"])  # fmt: skip
def test_the_law_receives_the_inputs_of_python(name: str, changes: dict[str, Any]) -> None:
    """Breaks if an input differs in value, type or shape, or if an input that a law keeps changes later."""
    changes = {**changes, "law": f"{HERE}:Observed"}
    python, compiled = (_driven(changes, name, compiled=chosen).law for chosen in (False, True))
    assert len(python.received) == len(compiled.received)
    for expected, found in zip(python.copies, compiled.copies, strict=True):
        assert _as_bytes(expected) == _as_bytes(found), expected.t
    for kept, copied in zip(compiled.received, compiled.copies, strict=True):
        assert _as_bytes(kept) == _as_bytes(copied), kept.t


@pytest.mark.parametrize("unusual", ["held", "nan", "pipe", "none"])
def test_an_unusual_output_has_the_effect_of_python(unusual: str) -> None:
    """Breaks if a law is called twice in a tick, or if a held force, a pressure or its diagnostics are lost."""
    name = "daqin_heavy_haul" if unusual == "pipe" else "demo"
    law = {"law": f"{HERE}:Observed", f"laws.{HERE}:Observed.unusual": unusual}
    changes = {**FREE, "duration": 60, **law}
    Both(setup_of(name, changes)).assert_equal()


@pytest.mark.parametrize("unusual", ["none", "held", "nan", "slow"])
def test_an_own_compensation_is_called_as_in_python(unusual: str) -> None:
    """Breaks if a compensation is called twice in a tick that is left to Python, or if a command is lost or doubled."""
    law = {"law": f"{HERE}:Observed", f"laws.{HERE}:Observed.unusual": unusual}
    if unusual == "slow":
        law = {"law": "smc", "control_period": 0.3}
    changes = {**FREE, **law, "duration": 30, "compensation": f"{HERE}:Counted"}
    python, compiled = (_driven(changes, compiled=chosen).compensation for chosen in (False, True))
    assert python.calls == compiled.calls


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"compensation": f"{HERE}:Counted", f"compensations.{HERE}:Counted.fails_at": 5.05},
         "compensation Counted: ValueError: no input at this time"),
        ({"law": f"{HERE}:Observed", f"laws.{HERE}:Observed.unusual": "error"}, "no force at this time"),
    ],
)  # fmt: skip
def test_an_error_of_a_compensation_or_a_law_names_it(changes: dict[str, Any], reason: str) -> None:
    """Breaks if compiled ticks drop the exception, or name another part of the loop."""
    setup = setup_of("demo", {**FREE, "duration": 60, **changes})
    python, compiled = (run_engine(setup, compiled=chosen).failure for chosen in (False, True))
    assert python == compiled and reason in (python or "")


def test_a_slow_law_ends_the_span(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if Ctrl-C and the progress wait for all ticks of a span."""
    monkeypatch.setattr(python_law, "MAX_CALLS_NS", 0)
    loop = TickLoop(setup_of("demo", {**DEMO, "law": f"{HERE}:Observed"}), None, compiled=True)
    loop.start()
    loop.advance()
    for _ in range(20):
        before = loop.ticks
        loop.advance()
        assert loop.ticks == before + 1


def test_a_law_in_python_has_its_step_time_and_gpc_compiled_ticks() -> None:
    """Breaks if the time of the law is lost in compiled ticks, or laws without a compiled step leave them to Python."""
    result = run_engine(setup_of("demo", {**DEMO, "law": f"{HERE}:Observed"}), compiled=True)
    assert result.summary["step_time_us_median"] > 0.0
    assert compiled_part(setup_of("xuzhou_metro", {"law": "gpc", "compensation": "none", "duration": 40})) > 0.8
