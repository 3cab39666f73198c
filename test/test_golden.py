"""The golden run: driven again it gives the same messages, and a difference is named in one short line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from train_ato.cli import main
from train_ato.record.difference import compare
from train_ato.record.reading import attachments, stream
from train_ato.record.run_log import LogFile
from train_ato.record.versions import VERSIONS, other_numbers, read_versions, versions
from train_ato.run_folder import open_run
from train_ato.run_setup import prepare
from train_ato.scenario import load
from train_ato.topics import EPOCH_NS, TOPICS
from train_ato.wire import Wire

FOLDER = Path(__file__).resolve().parent / "golden"
GOLDEN = FOLDER / "short_train" / "run.mcap"
ELSEWHERE = 1e-6
"""Part of a field's largest magnitude by which numbers may differ on other processors or versions."""


@pytest.fixture(scope="module")
def wire() -> Wire:
    return Wire(prepare(*load(str(FOLDER / "short_train.yaml"))).shape)


def altered(folder: Path, topic: str, number: int, change) -> Path:
    """Write the golden run again with one message of a topic changed; ``change`` gets and returns its bytes."""
    log = LogFile(folder, attachments(GOLDEN))
    channels: dict[str, int] = {}
    count = 0
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
            count += 1
        if data is not None:
            log.write(channels[name], message.publish_ns, message.log_ns, data)
    log.close()
    return log.path


def test_golden_run_is_driven_again(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if any number of the physics, a law, a link or an encoder changes; `test/golden/make.py` is the way then.

    Bit for bit where processor and versions are those that recorded it, else up to rounding.
    """
    others = other_numbers(read_versions(attachments(GOLDEN)[VERSIONS]))
    relative = ELSEWHERE if others else 0.0
    assert main(["verify", str(GOLDEN), f"--relative={relative}", "--json"]) == 0, capsys.readouterr().err
    result = json.loads(capsys.readouterr().out)
    assert result["equal"] is True
    assert result["messages"] > 4000


def test_golden_run_meets_everything() -> None:
    """Breaks if the golden run no longer has every topic of the table and every kind of change."""
    names = {message.channel.topic.lstrip("/") for message in stream(GOLDEN)}
    assert names == {topic.name.lstrip("/") for topic in TOPICS if topic.recorded}
    assert sum(path.stat().st_size for path in GOLDEN.parent.iterdir()) < 300_000


def test_attached_scenario_is_that_of_the_file() -> None:
    """Breaks if scenario and log were committed apart."""
    setup = prepare(*load(str(FOLDER / "short_train.yaml")))
    assert open_run(GOLDEN)[0].resolved_yaml() == setup.resolved_yaml()


def test_the_first_difference_is_named_in_one_short_line(
    tmp_path: Path, wire: Wire, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if topic, stamp, field or place is wrong or lost, or the line runs over the screen."""

    def push(data: bytes) -> bytes:
        message = wire.decode("train/cars", data)
        message.velocity[4] += 1e-5
        return wire.encode("train/cars", message)

    log = altered(tmp_path, "/train/cars", 123, push)
    assert main(["verify", str(log), f"--relative={ELSEWHERE / 100}"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "1 of " in line
    assert "messages differ; first: train/cars at 12.300 s, velocity[4]: " in line
    assert len(line) < 240


def test_a_missing_message_is_one_difference(tmp_path: Path, wire: Wire) -> None:
    """Breaks if everything behind a lost message is counted as different."""
    log = altered(tmp_path, "/ato/estimate", 77, lambda data: None)
    found = compare(GOLDEN, log, wire)
    assert found.topics == {"ato/estimate": 1}
    assert str(found.first) == "ato/estimate at 7.700 s, message: there and missing"


def test_tolerance_is_a_part_of_the_field(tmp_path: Path, wire: Wire) -> None:
    """Breaks if a small force near zero is held to a millionth of itself, or a large error passes."""
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
        assert compare(GOLDEN, log, wire).differing == 1
        assert compare(GOLDEN, log, wire, ELSEWHERE).equal == (place == "near")


def test_versions_say_whether_bits_can_be_equal() -> None:
    here = versions()
    assert other_numbers(here) == []
    assert other_numbers({**here, "numpy": "0.1", "mcap": "0.1"}) == ["numpy"]
    assert other_numbers(read_versions(b"- 1")) == [*other_numbers({})]
    assert read_versions(attachments(GOLDEN)[VERSIONS]).keys() == here.keys()


def test_golden_folder_is_a_bag_for_other_tools(tmp_path: Path) -> None:
    """Breaks if the golden folder is no bag for tools that know nothing of us."""
    from rosbags.rosbag2 import Reader

    shutil.copytree(GOLDEN.parent, tmp_path / "bag")
    with Reader(tmp_path / "bag") as bag:
        assert bag.message_count == sum(1 for _ in stream(GOLDEN))
        assert bag.start_time == EPOCH_NS
