"""Faults: their table, their modes, and the receiving end of messages."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import answer
from engine_runs import compared, no_figure
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from msgs_docs.generate.fault_page import BASES, MEASURED, NOTHING, ROWS, STANDSTILL, run_row
from msgs_docs.generate.rows import read_rows
from train_ato.cli import main
from train_ato.messages.faults import FAULT_TOPICS, Fault, message_faults
from train_ato.messages.receiver import AliveCheck, Receiver, validity_check
from train_ato.messages.topics import BY_NAME, TOPICS, Rate, Role
from train_ato.messages.types import BrakeRelease, Command
from train_ato.report.events import detect_events

pytestmark = pytest.mark.usefixtures("without_figure")

FIGURES = read_rows(Path(__file__).resolve().parents[1] / MEASURED)
FIRST = {key: row.name for row in reversed(ROWS) if not row.slow for key in (row.kind, row.reaction)}
"""First fault of every kind and of every reaction: the quick runs, less those of the campaign in case_costs.txt."""
MARKS = {row.name: [] if row.name in FIRST.values() else [pytest.mark.campaign] for row in ROWS}


def test_the_table_has_every_kind_of_fault():
    """Breaks if a row is deleted or hides another one of its name."""
    assert len({row.name for row in ROWS}) == len(ROWS) >= 48
    kinds = {"repetition", "deletion", "insertion", "re-sequencing", "corruption", "delay", "masquerade"}
    assert kinds | {"node", "sensor", "link", "train"} <= {row.kind for row in ROWS}


@pytest.mark.parametrize("row", [pytest.param(row, id=row.name, marks=MARKS[row.name]) for row in ROWS])
def test_the_train_is_safe_after_a_fault(row):
    """Breaks if a fault leads beyond a place or a speed, ends the run of a moving train, or is reported late."""
    run = run_row(row)
    assert run.result.failure is None or run.result.failure.endswith("; the train was stopped")
    assert run.front < run.supervised_location and run.top_speed < run.largest_speed
    assert run.end_speed < STANDSTILL
    assert abs(FIGURES[row.name]["margin_m"] - (run.supervised_location - run.front)) < 1.0
    assert (abs(run.front - run.stop) < 5.0) == row.arrives
    assert any(re.search(row.reaction, text) for _, text in run.events), [text for _, text in run.events][-20:]
    if not row.arrives and row.reaction != NOTHING:
        assert run.detected is not None and run.reacted is not None
        assert run.reacted - run.detected < 1.5 + 1e-9, "a demand to coast or brake within 1.5 s"


def test_the_report_has_the_fault_and_its_refusal():
    """Breaks if a fault of the scenario or a refused message is missing in the events of a report."""
    rows = {row.name: row for row in ROWS}

    def events_of(name):
        run = run_row(rows[name])
        return detect_events(replace(run.recording, setup=run.setup))

    events = [(event.begin, event.text) for event in events_of("command NaN")]
    assert (20.0, "corrupt ato/command: value nan, probability 1.0") in events
    assert any(text == "plant: ato/command: refused a message: force nan" for _, text in events)
    killed = [event.text for event in events_of("profile killed")]
    assert {"node profile: kill", "controller: ato/reference: no valid message"} <= set(killed)


METRO = [BASES["metro"][0], *(f"--set={text}" for text in BASES["metro"][1:])]
MIXED = (
    "[{do: drop, probability: 0.3, topic: ato/command, begin: 5}, "
    "{do: corrupt, value: bit, probability: 0.5, topic: ato/reference, begin: 8, end: 12}, "
    "{do: reorder, block: 0.3, topic: train/measurement, reader: controller, begin: 12, end: 16}, "
    "{do: delay, delay: 0.6, topic: train/odometry, begin: 30}]"
)
"""Faults of several topics, and a random one."""


def drive(out: Path, faults: str, *options: str) -> int:
    return main(["run", *METRO, "--set=duration=45", f"--set=faults={faults}", f"--out={out}", "--json", *options])


@pytest.fixture(scope="module")
def engine_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("engine") / "run"
    with no_figure():
        assert drive(out, MIXED, "--engine") == 0
    return out


@pytest.mark.parametrize(
    "way", [(), pytest.param(("--processes",), marks=pytest.mark.campaign)], ids=["one process", "several"]
)
def test_faults_have_equal_numbers_in_every_mode(engine_run: Path, tmp_path: Path, way: tuple[str, ...]) -> None:
    """Breaks if a fault acts on the transport of a mode or the process of its reader, or is not seeded."""
    assert drive(tmp_path / "run", MIXED, *way) == 0 and compared(engine_run, tmp_path / "run").first is None


def test_a_killed_node_is_silent_in_one_process(tmp_path: Path, engine_run: Path, capsys) -> None:
    """Breaks if engine and composed graph treat a lost node differently, or the resolved scenario loses a fault."""
    kill = "[{do: kill, node: controller, at: 20}]"
    assert [drive(tmp_path / name, kill, *options) for name, options in (("a", ["--engine"]), ("b", []))] == [0, 0]
    assert compared(tmp_path / "a", tmp_path / "b").first is None
    assert answer(capsys, "verify", str(engine_run))["equal"] is True


TICK = 100_000_000
_FAULTS: TypeAdapter[tuple[Fault, ...]] = TypeAdapter(tuple[Fault, ...])


def faults(*entries):
    return message_faults(_FAULTS.validate_python(entries))


def receiver(*entries, checked=True, max_age=None, seed=1, topic="ato/command"):
    return Receiver(BY_NAME[topic], Role.PLANT, faults(*entries), seed, checked=checked, max_age=max_age)


def command(tick, force=None):
    return Command(tick * TICK, np.array([float(tick) if force is None else force]))


def received(link, ticks):
    """Return, per tick, the number of the newest command of a receiver, None without one."""
    found = [link.receive(tick * TICK, command(tick)) for tick in range(ticks)]
    return [None if message is None else float(message.force[0]) for message in found]


def drop(**values):
    return {"do": "drop", "topic": "ato/command", **values}


def test_a_receiver_uses_the_newest_message():
    """Breaks if a valid message is delayed or refused, or a contradiction or an old age leaves another one in use."""
    link = receiver()
    messages = [command(tick) for tick in range(5)]
    assert all(link.receive(message.stamp, message) is message for message in messages)
    assert (link.missed, link.refused, link.changed, link.diagnostics()) == (0, 0, False, {})
    link = receiver()
    link.receive(0, command(0))
    link.accept(2, [command(1), command(2)])
    assert link.receive(2 * TICK, command(2, 99.0)).force[0] == 1.0
    assert link.refusal == "contradictory messages of stamp 0.200 s"
    single = receiver()
    single.receive(0, command(0))
    single.accept(1, [command(1)])
    assert single.receive(TICK, command(1, 99.0)).force[0] == 0.0
    link = receiver(drop(begin=0.2), max_age=3 * TICK)
    assert received(link, 7) == [0, 1, 1, 1, 1, None, None] and link.missed == 5


@pytest.mark.parametrize(
    ("fault", "expected", "refusal"),
    [
        (drop(), [0, 1, 2, 2, 2, 2, 6, 7], ""),
        ({"do": "delay", "delay": 0.2}, [0, 1, 2, 2, 2, 3, 6, 7], "repeated stamp 0.500 s"),
        ({"do": "repeat"}, [0, 1, 2, 2, 2, 2, 6, 7], "repeated stamp 0.200 s"),
        ({"do": "repeat", "message": "each"}, [0, 1, 2, 3, 4, 5, 6, 7], "repeated stamp 0.500 s"),
        ({"do": "reorder", "block": 0.3}, [0, 1, 2, 2, 2, 2, 6, 7], "repeated stamp"),
        ({"do": "insert", "ahead": 1.0}, [0, 1, 2, 3, 4, 5, 6, 7], "stamp 1.000 s ahead"),
        ({"do": "insert"}, [0, 1, 2, 2, 2, 2, 6, 7], "contradictory messages of stamp 0.500 s"),
        ({"do": "freeze"}, [0, 1, 2, 2, 2, 2, 6, 7], ""),
        ({"do": "corrupt", "value": "nan"}, [0, 1, 2, 2, 2, 2, 6, 7], "force nan"),
        ({"do": "corrupt", "value": "inf"}, [0, 1, 2, 2, 2, 2, 6, 7], "force inf"),
        ({"do": "corrupt", "value": "range"}, [0, 1, 2, 2, 2, 2, 6, 7], "force 1e+15"),
        ({"do": "corrupt", "value": "sign"}, [0, 1, 2, -3, -4, -5, 6, 7], ""),
    ],
)
def test_effect_and_refusal_of_every_fault(fault, expected, refusal):
    """Breaks if a fault begins or ends a tick early or late, has no effect, or is accepted."""
    link = receiver({"topic": "ato/command", "begin": 0.3, "end": 0.6, **fault})
    assert received(link, 8) == expected
    assert link.refusal.startswith(refusal) and bool(link.refusal) == bool(refusal)


def test_alive_counter_and_force_of_a_message_are_checked():
    """Breaks if repeated content releases a brake, a counter is not read, or a force beyond every brake is accepted."""
    check, none = AliveCheck(), float("nan")
    counters = ([4.0] * 3, [4.0] * 3, [3.0] * 3, [5.0, 5.0, 6.0], [-1.0] * 3, [none] * 3, [5.0] * 3)
    assert [check.problem(BrakeRelease(0, np.ones(3), np.array(alive))) for alive in counters] == [
        "", "alive counter 4 repeated", "alive counter 3 repeated", "alive counter 5 not possible",
        "alive counter -1 not possible", "alive counter nan not possible", "",
    ]  # fmt: skip
    check = validity_check(BY_NAME["ato/command"])
    assert [check(command(0, force)) for force in (1e10, -1e10, 1.01e10, -1.01e10)] == [
        "", "", "force 1.01e+10", "force -1.01e+10",
    ]  # fmt: skip


def test_a_random_fault_is_seeded_and_independent_of_others():
    """Breaks if a run is not repeatable, or one fault changes the random numbers of another."""
    half = drop(probability=0.5)
    lost = [
        received(receiver(half, *more, seed=seed), 200) for seed, more in ((1, ()), (1, (drop(begin=90),)), (2, ()))
    ]
    assert lost[0] == lost[1] and lost[0] != lost[2]
    link = receiver(half)
    received(link, 1000)
    assert 400 < link.missed < 600


@given(st.integers(0, 2**32 - 1))
def test_no_flipped_bit_of_a_release_releases_a_brake(seed):
    """Breaks if a brake release with one wrong bit is accepted with another content."""
    link = receiver(
        {"do": "corrupt", "topic": "atp/brake_release", "value": "bit"}, topic="atp/brake_release", seed=seed
    )
    sent = BrakeRelease(TICK, np.array([1.0, 0.0, 1.0]), np.full(3, 7.0))
    found = link.receive(TICK, sent)
    assert found is None or found.released.tolist() == sent.released.tolist()


def test_a_receiver_without_check_uses_what_arrives():
    """Breaks if a run without supervision refuses a message or loses its first one."""
    link = receiver({"do": "corrupt", "topic": "ato/command", "value": "nan", "begin": 0.1}, checked=False)
    assert received(link, 1) == [0] and np.isnan(received(link, 3)[1:]).all()
    assert received(receiver(drop(), checked=False), 3) == [0, 0, 0]


def test_a_fault_of_one_reader_leaves_the_others():
    """Breaks if ``reader`` is ignored, or a fault of another topic acts."""
    entries = ({"do": "drop", "topic": "train/measurement", "reader": "observer"}, drop())
    for topic, reader, lost in (
        ("train/measurement", Role.OBSERVER, 1),
        ("train/measurement", Role.CONTROLLER, 0),
        ("ato/command", Role.PLANT, 1),
    ):
        link = Receiver(BY_NAME[topic], reader, faults(*entries), 1, checked=False)
        link.receive(0, command(0))
        assert link.missed == lost, (topic, reader)


def test_a_lost_node_is_the_loss_of_all_its_messages():
    """Breaks if a killed node still sends a message of the loop, or a topic of the loop cannot fail."""
    found = faults({"do": "kill", "node": "controller", "at": 3})
    assert {fault.topic for fault in found} == {"ato/command", "ato/brake_pipe_command", "ato/state"}
    assert {(fault.do, fault.begin, fault.end) for fault in found} == {("drop", 3.0, None)}
    (slow,) = faults({"do": "slow", "node": "observer", "at": 3, "delay": 2})
    assert (slow.do, slow.topic, slow.delay) == ("delay", "ato/estimate", 2.0)
    ticking = {topic.name for topic in TOPICS if topic.readers and topic.rate in (Rate.TICK, Rate.SUPERVISION)}
    assert set(FAULT_TOPICS) == ticking and len(ticking) >= 9


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        (drop(topic="ato/comand"), "did you mean 'ato/command'"),
        (drop(topic="ato/profile"), "no topic of the loop"),
        (drop(begin=5, end=5), "end 5 s must be after begin 5 s"),
        (drop(reader="observer"), "observer does not read ato/command; use one of plant"),
        (drop(probability=0), "greater than 0"),
        ({"do": "kill", "node": "plant", "at": 1}, "'profile'"),
        ({"do": "burn", "topic": "ato/command"}, "burn"),
    ],
)
def test_an_impossible_fault_is_refused(entry, text):
    with pytest.raises(ValidationError, match=text):
        faults(entry)
