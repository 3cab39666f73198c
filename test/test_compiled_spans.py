"""Compiled ticks give messages, recording and log of the ticks in Python, bit for bit."""

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
from span_runs import Both, setup_of

from plant_sim.plant_setup import Sensors
from plant_sim.sensors import SensorSet
from plant_sim.states import VehicleStates
from train_ato.control.law_call import is_in_loop
from train_ato.judge.recording import BRAKE_PIPE_COMMAND
from train_ato.log.log_writer import RunLog
from train_ato.log.mcap_writer import MESSAGE, MESSAGE_TYPE
from train_ato.log.run_folder import Encoder
from train_ato.loop import span_kernel as kernel
from train_ato.loop.engine import COMPILED_FROM, TickLoop, run_engine
from train_ato.loop.train_protection import TrainProtection, command_age
from train_ato.messages.codec import Wire
from train_ato.messages.delay_lines import DelayJump
from train_ato.messages.topics import topics_of

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


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        HEAVY, ("xuzhou_metro", {"duration": 60, "law": "pid"}),
        ("crh380a_gpc", {"law": "pid", "compensation": "preview", "duration": 90, "plant.disturbances": GUST}),
    ],
    ids=["supervisor, air brake, couplers", "without supervisor and brake", "disturbances, several units"],
)  # fmt: skip
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
