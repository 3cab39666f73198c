"""Golden run and `verify`: a new run gives the same messages; a difference is reported in one short line."""

import random
import shutil
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import answer
from engine_runs import record_run, setup_of
from programs import python

import train_ato as ta
from train_ato.cli import main
from train_ato.log import difference
from train_ato.log.bag_layout import table_name
from train_ato.log.difference import LogComparison, _Scale, _unequal, compare_logs
from train_ato.log.log_writer import LogFile
from train_ato.log.mcap_records import stream
from train_ato.log.reading import attachments
from train_ato.log.run_folder import RunFolder, read_run_folder
from train_ato.log.versions import VERSIONS, read_versions, versions
from train_ato.loop.engine import Sink, run_engine
from train_ato.messages.codec import Wire
from train_ato.messages.topics import EPOCH_NS, topics_of
from train_ato.messages.types import Tick
from train_ato.playback.replaying import setup_with_law
from train_ato.scenario.setup import RunSetup

FOLDER = Path(__file__).resolve().parent / "golden"
sys.path.append(str(FOLDER))
import bits  # noqa: E402

GOLDEN = FOLDER / "short_train" / "run.mcap"
ELSEWHERE = 1e-6
"""Part of a field's largest magnitude by which numbers may differ on other processors or versions."""


def other_numbers(recorded: Mapping[str, str]) -> list[str]:
    """Return the names of the different versions that may change the last digits of numbers."""
    here, numeric = versions(), ("python", "numpy", "numba", "llvmlite", "libc", "machine", "processor")
    return [name for name in numeric if recorded.get(name) != here[name]]


@pytest.fixture(scope="module")
def wire() -> Wire:
    return Wire(setup_of(str(FOLDER / "short_train.yaml")).layout)


def altered(folder: Path, topic: str, number: int, change, *, at_end: bool = False) -> Path:
    """Write the golden run again with one message of a topic changed; ``change`` gets and returns its bytes.

    ``at_end`` writes it after all others.
    """
    log = LogFile(folder, attachments(GOLDEN))
    channels: dict[str, int] = {}
    count, held = 0, []
    for message in stream(GOLDEN):
        name = message.channel.topic
        if name not in channels:
            found = message.channel.metadata
            channels[name] = log.channel(
                name, message.schema.name, message.schema.data.decode(), found["topic_type_hash"], "[]"
            )
        data = message.data
        if name == topic:
            if count == number:
                data = change(data)
                if at_end:
                    held.append((channels[name], message.publish_ns, message.log_ns, data))
                    data = None
            count += 1
        if data is not None:
            log.write(channels[name], message.publish_ns, message.log_ns, data)
    for entry in held:
        log.write(*entry)
    log.close()
    return log.path


def test_golden_run_is_driven_again(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if any number of the physics, a law, a link or an encoder changes; `test/golden/make.py` changes it."""
    # Bit for bit where processor and versions are those that recorded it, else up to rounding.
    relative = ELSEWHERE if other_numbers(read_versions(attachments(GOLDEN)[VERSIONS])) else 0.0
    result = answer(capsys, "verify", str(GOLDEN), f"--relative={relative}")
    assert result["equal"] is True and result["messages"] > 4000


def test_golden_run_meets_everything_and_has_the_scenario_of_its_file() -> None:
    """Breaks if a topic is missing, or scenario and log were committed apart, except for texts."""
    layout = replace(setup_of(str(FOLDER / "short_train.yaml")).layout, supervised=False)
    names = {table_name(message.channel.topic) for message in stream(GOLDEN)}
    assert names == {topic.name for topic in topics_of(layout) if topic.recorded}
    assert sum(path.stat().st_size for path in GOLDEN.parent.iterdir()) < 300_000
    setup = setup_of(str(FOLDER / "short_train.yaml"))
    attached, file = (yaml.safe_load(run.resolved_yaml()) for run in (read_run_folder(GOLDEN)[0], setup))
    for resolved in (attached, file):
        for data in (resolved["plant"]["consist"], resolved["plant"]["line"]):
            if isinstance(data, dict):
                data.pop("source", None), data.pop("summary", None)
    assert attached == file


def test_the_first_difference_is_named_in_one_short_line(tmp_path, wire, capsys):
    """Breaks if topic, stamp, field or place is wrong or missing, or the line is too long."""

    def push(data: bytes) -> bytes:
        message = wire.decode("train/vehicles", data)
        message.velocity[4] += 1e-5
        return wire.encode("train/vehicles", message)

    log = altered(tmp_path, "/train/vehicles", 123, push)
    assert main(["verify", str(log), f"--relative={ELSEWHERE / 100}"]) == 1
    *_, line = capsys.readouterr().err.splitlines()
    assert "1 of " in line
    assert "messages differ; first: train/vehicles at 12.300 s, velocity[4]: " in line
    assert len(line) < 240


def test_a_record_whose_evaluation_has_no_tick_is_repeated(tmp_path: Path) -> None:
    """Breaks if a run of older code, with an evaluation that is now refused, can no longer be read."""
    run = record_run(setup_of("demo", "duration=4"), tmp_path / "run")
    file = run / "scenario.yaml"
    data = yaml.safe_load(file.read_text())
    file.write_text(yaml.safe_dump({**data, "evaluation": {**(data.get("evaluation") or {}), "until_time": 3.0}}))
    with pytest.raises(ValueError, match=r"evaluation\.until_time: 3 s"):
        setup_of(str(file))
    assert ta.verify(run).equal
    recorded, _ = read_run_folder(run)
    assert setup_with_law(recorded, run, "smc", lambda choice: choice).scenario.law == "smc"


def test_a_missing_message_is_one_difference(tmp_path: Path, wire: Wire) -> None:
    """Breaks if all messages after a lost one count as different."""
    log = altered(tmp_path, "/ato/estimate", 77, lambda data: None)
    found = compare_logs(GOLDEN, log, wire)
    assert found.topics == {"ato/estimate": 1}
    assert str(found.first) == "ato/estimate at 7.700 s, message: there and missing"


def test_a_late_message_is_compared_in_its_place(tmp_path, wire, monkeypatch):
    """Breaks if a message that comes after its stamp is closed, to the very stamp, is a difference."""
    monkeypatch.setattr(difference, "PORTION", 25)
    monkeypatch.setattr(difference, "WINDOW_NS", 1_000_000_000)
    count = sum(message.channel.topic == "/ato/estimate" for message in stream(GOLDEN))
    for number in range(count - 14, count - 6):
        (folder := tmp_path / str(number)).mkdir()
        log = altered(folder, "/ato/estimate", number, lambda data: data, at_end=True)
        assert compare_logs(GOLDEN, log, wire).equal, number


def test_tolerance_is_a_part_of_the_field(tmp_path: Path, wire: Wire) -> None:
    """Breaks if a small force near zero has a bound of a millionth of itself, or a large error passes."""
    largest = max(
        float(np.abs(wire.decode("ato/command", message.data).force).max())
        for message in stream(GOLDEN)
        if message.channel.topic == "/ato/command"
    )

    def off(by: float):
        def change(data: bytes) -> bytes:
            message = wire.decode("ato/command", data)
            message.force[0] += by
            return wire.encode("ato/command", message)

        return change

    for place, factor in (("near", 0.9), ("far", 1.1)):
        (tmp_path / place).mkdir()
        log = altered(tmp_path / place, "/ato/command", 0, off(factor * ELSEWHERE * largest))
        assert compare_logs(GOLDEN, log, wire).differing == 1
        assert compare_logs(GOLDEN, log, wire, ELSEWHERE).equal == (place == "near")


def test_versions_and_bag_of_the_golden_run(tmp_path: Path) -> None:
    """Breaks if versions that may change bits are not named, or other tools cannot open the folder."""
    here = versions()
    assert other_numbers(here) == []
    assert other_numbers({**here, "numpy": "0.1", "mcap": "0.1"}) == ["numpy"]
    assert other_numbers(read_versions(b"- 1")) == [*other_numbers({})]
    assert read_versions(attachments(GOLDEN)[VERSIONS]).keys() == here.keys()
    from rosbags.rosbag2 import Reader

    shutil.copytree(GOLDEN.parent, tmp_path / "bag")
    with Reader(tmp_path / "bag") as bag:
        assert bag.message_count == sum(1 for _ in stream(GOLDEN)) and bag.start_time == EPOCH_NS


CASES = list(bits.cases())
SAMPLE = random.Random(30).sample([case for case in CASES if case.changes is not None], 16)
"""Short runs; the campaign has all."""


@pytest.mark.skipif(bits.made_elsewhere(), reason="the bits are those of another C library")
@pytest.mark.parametrize("case", SAMPLE, ids=lambda case: case.name)
def test_a_run_has_its_stored_bits(case: bits.Case) -> None:
    """Breaks if one bit of a topic changes; `test/golden/bits.py --write` is the way if it must."""
    assert not list(bits.changed([case]))


@pytest.mark.campaign
@pytest.mark.skipif(bits.made_elsewhere(), reason="the bits are those of another C library")
@pytest.mark.parametrize("kind", sorted({case.name.split()[0] for case in CASES}))
def test_all_runs_have_their_stored_bits(kind: str) -> None:
    """Breaks like the test above, for every shipped scenario, fault, combination of components and compiled tick."""
    assert not list(bits.changed(case for case in CASES if case.name.split()[0] == kind))


def test_every_law_observer_and_compensation_has_stored_bits() -> None:
    assert {case.name for case in CASES} == bits.stored()[1].keys()


def short(*changes: str) -> RunSetup:
    return setup_of("demo", "duration=3", *changes)


def recorded(run: Path, *changes: str) -> Path:
    """Record a run in the engine."""
    with RunFolder.make(run, run.name).sink(setup := short(*changes)) as sink:
        run_engine(setup, sink=sink)
    return run


@pytest.fixture(scope="module")
def wire_of_short() -> Wire:
    return Wire(short().layout)


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("verify") / "one")


def test_comparison_covers_every_message_and_no_wall_clock(one: Path, wire_of_short: Wire, tmp_path: Path) -> None:
    """Breaks if step times are compared, or a change of one number or the end of one log has no effect."""
    shorter = recorded(tmp_path / "shorter", "duration=2.9")
    gain = recorded(tmp_path / "gain", "laws.pid.kp=0.0300000001")
    pairs = ((one, recorded(tmp_path / "again")), (one, shorter), (shorter, one), (one, gain))
    found = [compare_logs(*pair, wire_of_short) for pair in pairs]
    assert len({entry.messages for entry in found}) == 1  # those of the longer log
    assert [entry.equal for entry in found] == [True, False, False, False]
    first = found[-1].first
    assert first is not None and (first.topic == "/diagnostics" or first.field.startswith("force"))


def test_signs_of_zero_are_different_bits(one: Path, wire_of_short: Wire) -> None:
    """Breaks if 0.0 and -0.0 are equal bits, or unequal within a tolerance."""
    strict, tolerant = (_Scale("ato/command", one, wire_of_short, relative) for relative in (0.0, 1e-9))
    assert _unequal("force", 0.0, -0.0, strict) == ("force", "0.0", "-0.0")
    assert _unequal("force", 0.0, -0.0, tolerant) is None


def test_late_messages_are_compared_with_those_of_their_stamp(wire_of_short, tmp_path, monkeypatch):
    """Breaks if a message behind the others, or a foreign one far ahead, counts as missing."""
    messages: list[tuple[str, object, int]] = []

    class Kept(Sink):
        def add(self, topic: str, message: object, stamp: int) -> None:
            messages.append((topic, message, stamp))

    setup = short()
    run_engine(setup, sink=Kept())
    late = messages.pop(len(messages) // 2)
    far = ("/clock", Tick(stamp=10**17), 10**17)
    monkeypatch.setattr(difference, "PORTION", 1)
    one, other = tmp_path / "one", tmp_path / "other"
    for run, found in ((one, [far, *messages, late]), (other, [late, *messages[::-1], far])):
        with RunFolder.make(run, "late").sink(setup) as sink:
            for topic, message, stamp in found:
                sink.add(topic, message, stamp)
    monkeypatch.setattr(difference, "WINDOW_NS", 1_000_000_000)
    assert compare_logs(one, other, wire_of_short) == LogComparison(len(messages) + 2)
    found = compare_logs(one, recorded(tmp_path / "shorter", "duration=2.9"), wire_of_short)
    assert found.first is not None and found.first.stamp == 2_900_000_000 and found.topics["/clock"] == 2
    assert found.messages == len(messages) + 2


@pytest.mark.campaign
def test_another_cpu_target_has_the_same_bits(tmp_path: Path) -> None:
    """Breaks if the kernel has other bits without AVX and FMA; `.ci/grid` has all targets."""
    variables = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    ta.run("demo", set={"duration": 3}, out=tmp_path / "one", progress=False)
    done = python("-m", "train_ato", "verify", str(tmp_path / "one"), **variables)
    assert done.returncode == 0 and "messages are equal, bit for bit" in done.stdout, done.stderr
