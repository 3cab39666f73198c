"""Compiled ticks, also with a law in Python, give messages, recording and log of the ticks in Python, bit for bit."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from case_costs import sampled
from mcap.reader import make_reader
from mcap.records import Chunk, MessageIndex
from mcap.stream_reader import StreamReader
from span_runs import Both, compiled_part, finished_loop, setup_of

from plant_sim.plant_setup import Sensors
from plant_sim.sensors import SensorSet
from plant_sim.states import VehicleStates
from train_ato.control.compensation.base import CompensationBase
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.contract import LawInput, LawOutput, parameter
from train_ato.control.law_call import is_in_loop
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.observers.record_observer import GuardedObserver
from train_ato.control.stack import ControlStack
from train_ato.judge.recording import BRAKE_PIPE_COMMAND
from train_ato.log.log_writer import RunLog
from train_ato.log.mcap_writer import MESSAGE, MESSAGE_TYPE
from train_ato.log.run_folder import Encoder
from train_ato.loop import python_law, span
from train_ato.loop import span_kernel as kernel
from train_ato.loop.engine import COMPILED_FROM, TickLoop, run_engine
from train_ato.loop.train_protection import TrainProtection, command_age
from train_ato.messages.codec import Wire
from train_ato.messages.delay_lines import DelayJump
from train_ato.messages.topics import topics_of
from train_ato.studies.sweep.row import WALL_TIMES

CASES, COMPONENTS, SUPERVISED = yaml.safe_load(
    (Path(__file__).parent / "data" / "span_cases.yaml").read_text()
).values()
"""Scenario and changes of runs by name, for laws, for components and for runs with a supervisor."""


@pytest.mark.parametrize("case", sampled(CASES, every=2))
def test_compiled_ticks_give_messages_and_recording_of_python(case: str) -> None:
    """Breaks if law, sensor, delay line, disturbance, brake or diagnostics of compiled ticks differ in one bit."""
    # An array of a span in another order, shape or reduction than the messages does too, and a condition that leaves a
    # whole run to Python, which would be compared with itself.
    Both(setup_of(*CASES[case])).assert_equal(least=0.4)


def test_the_kernel_is_compiled_once() -> None:
    """Breaks if a run or a component gives an array in another layout: the kernel is compiled again, for 20 s."""
    laws = ("funnel", "funnel, three units", "pid, air brake by time and place", "disturbances")
    components = ("predictor, springs, three units", "eso of the train, pid", "policy trigger")
    short = ((COMPONENTS[case][0], {**COMPONENTS[case][1], "duration": 5}) for case in components)
    for name, changes in [*(CASES[case] for case in laws), *short]:
        run_engine(setup_of(name, changes), compiled=True)
    assert len(getattr(kernel.run_span, "signatures", [None])) == 1  # missing with NUMBA_DISABLE_JIT


def test_a_long_run_is_compiled_by_default_and_has_no_step_time() -> None:
    """Breaks if long runs stay in Python, or if the time of the first tick counts as that of the law."""
    name, changes = CASES["pid, slow control"]
    long = run_engine(setup_of(name, {**changes, "duration": COMPILED_FROM * 0.05}))
    short = run_engine(setup_of(name, {**changes, "duration": 10}))
    assert long.summary.get("step_time_us_median") is None
    assert short.summary["step_time_us_median"] > 0.0


def test_noise_ahead_is_the_noise_of_the_ticks() -> None:
    """Breaks if a look ahead at the noise of coming ticks draws other numbers or loses some."""
    sensors = Sensors(position_noise=0.1, velocity_noise=0.01)
    plain, ahead = (SensorSet(sensors, (0, 1), np.zeros(2), 0.05, 7) for _ in range(2))
    state = VehicleStates(0, np.array([10.0, 0.0]), np.array([1.0, 1.0]), np.zeros(2))
    for count in (1, 200, 40, 300, 5):
        expected = np.array(ahead._position_noise.ahead(count))
        measured = [plain.measure(state, np.zeros(2)).position - state.position for _ in range(count)]
        assert np.abs(np.array(measured) - expected).max() < 1e-14
        ahead._position_noise.skip(count)


@pytest.mark.parametrize("case", sampled(COMPONENTS, every=2))
def test_compiled_components_send_the_messages_of_python(case: str) -> None:
    """Breaks if an observer, a prediction, a law or a policy differs in one bit, or runs in Python after all."""
    Both(setup_of(*COMPONENTS[case])).assert_equal(least=0.7)


def test_policies_of_the_cases_change_the_pressure() -> None:
    """Breaks if an application or a release is not reached, so that the comparison above has no decision in it."""
    for case in ("policy trip", "policy trigger", "policy blend", "policy predictive"):
        recording = run_engine(setup_of(*COMPONENTS[case]), compiled=True).recording
        pressure = recording.topics[BRAKE_PIPE_COMMAND]["pressure"].ravel()
        assert np.count_nonzero(np.diff(pressure)) >= 2, case


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("freight_consensus", {"laws.fixed_time_smc.states": "estimated", "duration": 1.0}),
        ("xuzhou_metro", {"law": "gpc", "compensation": "none", "duration": 30}),
    ],
)
def test_laws_without_a_compiled_step_are_called_in_python(name: str, changes: dict[str, Any]) -> None:
    """Breaks if a parameter that the compiled step lacks is accepted: the run would have the numbers of another one."""
    loop = TickLoop(setup_of(name, changes), None)
    loop.start()
    assert loop.controller.stack is not None and not is_in_loop(loop.controller.stack.law)
    Both(setup_of(name, changes)).assert_equal()


_CASES = ("heavy haul", "balises", "varying delay", "commands late and lost at random")
MOSTLY = {**dict.fromkeys(_CASES, 0.8), "gust": 0.99}
"""Least part of compiled ticks: a run left to Python, or the ticks of a gust, would be compared with themselves."""


@pytest.mark.parametrize("case", sampled(SUPERVISED, every=2))
def test_supervised_ticks_give_messages_and_recording_of_python(case: str) -> None:
    """Breaks if limits, odometry, state, brake release or report of a compiled step differ in one bit."""
    # A fault or an intervention that begins inside a span, a state of a stage that a span does not continue, or a topic
    # of the supervisor with another shape in the recording does too.
    Both(setup_of(*SUPERVISED[case])).assert_equal(least=MOSTLY.get(case, 0.0))


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["daqin_heavy_haul", "daqin_heavy_haul:twin", "daqin_heavy_haul:disturbed+mismatch"])
def test_a_whole_supervised_run_is_equal(name: str) -> None:
    """Breaks if a state drifts over a long run: brake applications, indication and stop at the end of authority."""
    Both(setup_of(name, {})).assert_equal()


def test_a_train_above_its_limit_is_left_to_the_supervisor() -> None:
    """Breaks if a compiled tick goes on beyond a limit: supervisor, assurance and brake must act in Python."""
    setup = setup_of("demo", {"duration": 200, "supervision.assurance": False, "law": "pid"})
    loop = TickLoop(setup, None, compiled=True)
    loop.start()
    while loop.plant.stamp < 100_000_000_000:
        loop.advance()
    before, ceilings = loop._spans.ticks, loop.supervisor.supervisor.track.records.ceilings
    assert loop._spans.supervised.is_quiet
    for name in ("permitted", "warning", "service"):
        ceilings[name] = 1.0
    for _ in range(20):
        loop.advance()
    assert loop._spans.ticks <= before + setup.supervision_ticks
    assert loop.supervisor.supervisor.interventions == 1


def test_age_of_the_newest_command_that_has_arrived() -> None:
    """Breaks if the delay of the link, a lost command or a change of the delay counts wrong in the age of a command."""
    setup = setup_of("demo", {"duration": 130, "links.command": {"delay": 0.5}})
    protection, tick, ages = TrainProtection(setup), setup.tick_ns, []
    for number in range(30):
        at = number * tick
        if number == 20:
            protection.jump(DelayJump(at=at * 1e-9, add=0.3))
        if number not in (10, 11):
            protection.on_command(at)
        ages.append(int(command_age(protection.age, *protection.stamps.records(at, 0), at, np.zeros((1, 1)))))
    assert tick == 100_000_000  # a command in time is 5 ticks old on arrival, and nominally 6
    assert [age // tick for age in ages[14:19]] == [-1, 0, 1, -1, -1]
    assert [age // tick for age in ages[24:30]] == [-1, 0, 1, 2, 2, 2]


HEAVY: tuple[str, dict[str, Any]] = ("daqin_heavy_haul", {"duration": 90})
GUST = [{"kind": "gust", "begin": 10.0, "end": 30.0, "acceleration": 0.05}]


def records_of(folder: Path, name: str, changes: dict[str, Any], *, compiled: bool) -> list[tuple[Any, ...]]:
    """Return topic, times and bytes of all messages in the log of a run in their order in the file."""
    folder.mkdir()
    setup = setup_of(name, changes)
    with RunLog(folder, topics_of(setup.layout)) as log:
        result = run_engine(setup, sink=Encoder(log, Wire(setup.layout)), compiled=compiled)
        assert result.failure is None
        assert log.counts == {topic: result.published.get(topic, 0) for topic in log.numbers}
    with (folder / "run.mcap").open("rb") as stream:
        found = make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        return [
            (channel.topic, message.log_time, message.publish_time, message.sequence, message.data)
            for _, channel, message in found
        ]


@pytest.mark.parametrize(("name", "changes"), [
    HEAVY, ("xuzhou_metro", {"duration": 60, "law": "pid"}),
    ("crh380a_gpc", {"law": "pid", "compensation": "preview", "duration": 90, "plant.disturbances": GUST}),
], ids=["supervisor, air brake, couplers", "without supervisor and brake", "disturbances, several units"])  # fmt: skip
def test_the_log_of_compiled_ticks_is_that_of_single_messages(name, changes, tmp_path: Path) -> None:
    """Breaks if a block has a message at another place, with another time or other bytes, or loses one."""
    logs = [records_of(tmp_path / str(compiled), name, changes, compiled=compiled) for compiled in (False, True)]
    assert next((pair for pair in zip(*logs, strict=False) if pair[0] != pair[1]), None) is None
    assert len(logs[0]) == len(logs[1])


def test_the_index_finds_every_message_of_a_block(tmp_path: Path) -> None:
    """Breaks if the index of a chunk has a wrong place or time, or lacks a message."""
    records = records_of(tmp_path / "run", *HEAVY, compiled=True)
    data, found = b"", 0
    with (tmp_path / "run" / "run.mcap").open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk):
                data = zstandard.ZstdDecompressor().decompress(record.data, record.uncompressed_size)
            elif isinstance(record, MessageIndex):
                for time, place in record.records:
                    kind, _, channel, _, log_time, _ = MESSAGE.unpack_from(data, place)
                    assert (kind, channel, log_time) == (MESSAGE_TYPE, record.channel_id, time)
                    found += 1
    assert found == len(records)


def test_a_block_with_an_impossible_value_is_refused() -> None:
    """Breaks if a value that is not finite, or a wrong number of values, reaches the log in a block."""
    record = Wire(setup_of("xuzhou_metro", {}).layout).records["ato/command"]
    rows, stamps = np.zeros(3, record.dtype), np.arange(3) * 50_000_000
    force = np.array([[1.0], [np.inf], [2.0]])
    with pytest.raises(ValueError, match="ato/command: effort is not finite: inf"):
        record.fill(rows, stamps, {"force": force})
    with pytest.raises(ValueError, match="ato/command: effort has 2 values"):
        record.fill(rows, stamps, {"force": np.zeros((3, 2))})


FREE = {"supervision.enabled": False}
HERE = "test_compiled_spans"
DEMO = {**FREE, "duration": 60, "plant.sensors.couplers": [0]}
LAW_CASES: dict[str, tuple[str, dict[str, Any]]] = {
    **{case: CASES[case] for case in (
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
        return self.law_input(
            inputs, inputs.t, self.feedforwards(np.array([inputs.t]), np.array([shoes.total]))[0], shoes=shoes
        )


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


@pytest.mark.parametrize("case", sampled(LAW_CASES, every=2))
@pytest.mark.usefixtures("every_law_in_python")
def test_a_law_in_python_sends_the_messages_of_python(case: str) -> None:
    """Breaks if an input of the law, its order in the tick or its output differs in one bit, or no tick is compiled."""
    Both(setup_of(*LAW_CASES[case])).assert_equal(least=0.4)


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


@pytest.mark.parametrize(("changes", "reason"), [
    ({"compensation": f"{HERE}:Counted", f"compensations.{HERE}:Counted.fails_at": 5.05},
     "compensation Counted: ValueError: no input at this time"),
    ({"law": f"{HERE}:Observed", f"laws.{HERE}:Observed.unusual": "error"}, "no force at this time"),
    ({"plant.sensors.couplers": [0], "observer": f"{HERE}:Filtered", f"observers.{HERE}:Filtered.fails_at": 20.0},
     "no estimate at this time"),
])  # fmt: skip
def test_an_error_of_a_component_brakes_as_in_python(changes: dict[str, Any], reason: str) -> None:
    """Breaks if compiled ticks drop the exception, name another part of the loop, or call the component again."""
    setup = setup_of("demo", {**FREE, "duration": 60, **changes})
    python, compiled = (run_engine(setup, compiled=chosen) for chosen in (False, True))
    assert python.failure == compiled.failure and reason in (python.failure or "")
    one, other = ({**each.summary, **dict.fromkeys(WALL_TIMES)} for each in (python, compiled))
    assert one == other


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
