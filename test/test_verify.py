"""``verify``: comparison of two logs message by message, also over CPU targets of the kernels."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from engine_runs import setup_of

import train_ato as ta
from train_ato.log import difference
from train_ato.log.difference import LogComparison, _Scale, _unequal, compare_logs
from train_ato.log.run_folder import RunFolder
from train_ato.loop.engine import Sink, run_engine
from train_ato.messages.codec import Wire
from train_ato.messages.types import Tick
from train_ato.scenario.setup import RunSetup


def short(*changes: str) -> RunSetup:
    return setup_of("demo", "duration=3", *changes)


def recorded(run: Path, *changes: str) -> Path:
    """Record a run in the engine."""
    with RunFolder.make(run, run.name).sink(setup := short(*changes)) as sink:
        run_engine(setup, sink=sink)
    return run


@pytest.fixture(scope="module")
def wire() -> Wire:
    return Wire(short().layout)


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("verify") / "one")


def test_comparison_covers_every_message_and_no_wall_clock(one: Path, wire: Wire, tmp_path: Path) -> None:
    """Breaks if step times are compared, or a change of one number or the end of one log has no effect."""
    shorter = recorded(tmp_path / "shorter", "duration=2.9")
    gain = recorded(tmp_path / "gain", "laws.pid.kp=0.0300000001")
    pairs = ((one, recorded(tmp_path / "again")), (one, shorter), (shorter, one), (one, gain))
    found = [compare_logs(*pair, wire) for pair in pairs]
    assert len({entry.messages for entry in found}) == 1  # those of the longer log
    assert [entry.equal for entry in found] == [True, False, False, False]
    first = found[-1].first
    assert first is not None and (first.topic == "/diagnostics" or first.field.startswith("force"))


def test_signs_of_zero_are_different_bits(one: Path, wire: Wire) -> None:
    """Breaks if 0.0 and -0.0 are equal bits, or unequal within a tolerance."""
    strict, tolerant = (_Scale("ato/command", one, wire, relative) for relative in (0.0, 1e-9))
    assert _unequal("force", 0.0, -0.0, strict) == ("force", "0.0", "-0.0")
    assert _unequal("force", 0.0, -0.0, tolerant) is None


def test_late_messages_are_compared_with_those_of_their_stamp(wire, tmp_path, monkeypatch):
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
    assert compare_logs(one, other, wire) == LogComparison(len(messages) + 2)
    found = compare_logs(one, recorded(tmp_path / "shorter", "duration=2.9"), wire)
    assert found.first is not None and found.first.stamp == 2_900_000_000 and found.topics["/clock"] == 2
    assert found.messages == len(messages) + 2


@pytest.mark.campaign
def test_another_cpu_target_has_the_same_bits(tmp_path: Path) -> None:
    """Breaks if the kernel has other bits without AVX and FMA; `.ci/grid` has all targets."""
    variables = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    ta.run("demo", set={"duration": 3}, out=tmp_path / "one", progress=False)
    command = [sys.executable, "-m", "train_ato", "verify", str(tmp_path / "one")]
    done = subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "messages are equal, bit for bit" in done.stdout, done.stderr
