"""Recording of a run: equal from memory and log, also with missing parts and repeated reports."""

import os
import pickle
import shutil
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from engine_runs import setup_of
from report_runs import EVENTFUL, without

from train_ato.judge import kept_samples
from train_ato.judge.metrics import summarise
from train_ato.judge.recording import COMMAND, FIELDS, TRUTH, Recording
from train_ato.judge.repeated_reports import KeptReports, RepeatedReport
from train_ato.log.recorded import open_recording, read_recording
from train_ato.log.run_folder import RunFolder, read_run_folder
from train_ato.loop.engine import run_engine
from train_ato.messages.types import Diagnostic, Trajectory
from train_ato.scenario.setup import RunSetup


@pytest.fixture(scope="module", params=["demo", "freight_consensus:realistic", "xuzhou_metro"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RunSetup, Recording]:
    """Disturbances, air brake, coupler sensors and changes in the first; several units, one vehicle in the others."""
    options = EVENTFUL if request.param == "demo" else ["--set=duration=20"]
    setup = setup_of(request.param, *(text[6:] for text in options if text.startswith("--set=")), "observer=ndo")
    folder = RunFolder.make(tmp_path_factory.mktemp("recording") / "run", "run")
    folder.begin(setup)
    with folder.sink(setup) as sink:
        result = run_engine(setup, sink=sink)
    folder.finish(setup, result)
    assert result.recording is not None
    return folder.path, setup, result.recording


def assert_same(one: np.ndarray, other: np.ndarray, what: str) -> None:
    """Fail unless two arrays are equal in shape and in every bit."""
    assert one.shape == other.shape, what
    assert np.ascontiguousarray(one).tobytes() == np.ascontiguousarray(other).tobytes(), what


def test_samples_of_a_long_run_are_in_a_file(run, monkeypatch):
    """Breaks if samples of the file differ from those in memory, are not released, or are lost without room."""
    folder, setup, kept = run
    monkeypatch.setattr(kept_samples, "IN_MEMORY", 20_000)
    monkeypatch.setattr(kept_samples, "CACHED", 0)
    read, again = read_recording(folder, setup), run_engine(setup).recording
    assert again is not None

    def refused(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "pwrite", refused)
    full = read_recording(folder, setup)
    for found in (read, again, full, pickle.loads(pickle.dumps(again))):
        assert list(found.topics) == list(kept.topics)
        for topic, samples in kept.topics.items():
            assert_same(samples.time, found.topics[topic].time, topic)
            for name, values in samples.values.items():
                assert_same(values, found.topics[topic][name], f"{topic}: {name}")
                for row in (0, values.shape[0] // 2, values.shape[0] - 1):
                    assert_same(values[row], found.topics[topic].row(name, row), f"{topic}: {name}, row {row}")
        assert found.reports == kept.reports
    assert not isinstance(again.topics[TRUTH].values, dict)
    assert [*folder.glob(".*"), *folder.glob("tmp*")] == []


def test_a_folder_with_its_log_only_has_the_scenario_of_the_log(run, tmp_path, monkeypatch):
    """Breaks if what `recover` leaves of a killed recorder has no train, or a long one ends in a traceback."""
    monkeypatch.setattr(kept_samples, "IN_MEMORY", 20_000)
    shutil.copyfile(run[0] / "run.mcap", tmp_path / "run.mcap")
    assert open_recording(tmp_path).summary == {"status": "killed"}
    assert read_run_folder(tmp_path)[0].fingerprint() == run[1].fingerprint()
    assert read_recording(tmp_path).topics[TRUTH]["unit_position"].shape[1] == 0


def test_memory_and_log_hold_the_same_bits(run: tuple[Path, RunSetup, Recording]) -> None:
    folder, setup, kept = run
    read = read_recording(folder, setup)
    assert list(kept.topics) == list(read.topics)
    if setup.scenario.name == "demo":
        assert set(kept.topics) == set(FIELDS)
    for topic, samples in kept.topics.items():
        assert_same(samples.time, read.topics[topic].time, topic)
        assert list(samples.values) == list(read.topics[topic].values), topic
        for name, values in samples.values.items():
            assert_same(values, read.topics[topic][name], f"{topic}: {name}")
    assert kept.limits is not None
    assert read.limits is not None
    assert len(kept.profiles) == len(read.profiles)
    for one, other in zip((*kept.profiles, kept.limits), (*read.profiles, read.limits), strict=True):
        assert (one.stamp, one.name) == (other.stamp, other.name)
        for part in fields(Trajectory)[2:]:
            assert_same(getattr(one, part.name), getattr(other, part.name), part.name)
    assert kept.reports == read.reports
    assert kept.totals == read.totals
    assert summarise(setup, kept) == summarise(setup, read), "figures of a graph run or a killed one differ"


def test_vehicles_are_kept_on_request_and_agree_with_what_is_taken_of_them(run):
    """Breaks if units, front or coupler extremes are from other vehicles."""
    folder, setup, _ = run
    truth = open_recording(folder).topics[TRUTH]
    assert truth["position"].shape == (truth.time.size, setup.layout.n_vehicles)
    assert_same(truth["unit_velocity"], truth["velocity"][:, list(setup.model.units)], "units")
    assert_same(truth["front_position"], truth["position"][:, :1], "front")
    if setup.layout.n_vehicles > 1:
        assert_same(truth["coupler_draft_max"][:, 0], truth["coupler_force"].max(axis=1), "draft")
        assert_same(truth["coupler_buff_max"][:, 0], truth["coupler_force"].min(axis=1), "buff")


def test_ticks_without_a_command_hold_the_last_one(run: tuple[Path, RunSetup, Recording], tmp_path: Path) -> None:
    """Breaks if series of a log with gaps are joined by their count, or a tick without a command is left out."""
    folder, setup, kept = run
    whole = read_recording(folder, setup)
    command = whole.topics[COMMAND]
    chosen = np.delete(np.arange(command.time.size), [3, 4, 50])
    part = type(command)(command.time[chosen], {"force": command["force"][chosen]})
    gaps = Recording({**whole.topics, COMMAND: part})
    assert gaps.time.tolist() == kept.time.tolist()
    assert_same(gaps.velocity, kept.velocity, "velocity")
    assert_same(gaps.command[chosen], kept.command[chosen], "command")
    assert_same(gaps.command[[3, 4, 50]], kept.command[[2, 2, 49]], "held command")
    missing = read_recording(without(folder, tmp_path / "part", {COMMAND}), setup)
    assert COMMAND not in missing.topics
    assert missing.time.size == 0


SECOND = 1_000_000_000
STAMPS = [SECOND, 2 * SECOND, 3 * SECOND]
PLANT = RepeatedReport(Diagnostic(SECOND, "plant", 0, "running", {"energy_traction": "1.5", "law": "pid"}), STAMPS,
                       {"energy_traction": [1.5, 2.5, 0.1]})  # fmt: skip
PROFILE = RepeatedReport(Diagnostic(SECOND, "profile", 1, "following", {"replans": "2"}), STAMPS)
START = Diagnostic(0, "plant", 0, "running", {"energy_traction": "0.0", "law": "smc"})
RECORDING = Recording(kept_reports=(START, PLANT, PROFILE))


def test_messages_are_in_the_order_of_the_ticks() -> None:
    """Breaks if the messages of a node are not between those of the others, or with a number of another stamp."""
    wanted = [START]
    for stamp, energy in zip(STAMPS, ("1.5", "2.5", "0.1"), strict=True):
        wanted.append(Diagnostic(stamp, "plant", 0, "running", {"energy_traction": energy, "law": "pid"}))
        wanted.append(Diagnostic(stamp, "profile", 1, "following", {"replans": "2"}))
    assert RECORDING.reports == tuple(wanted)


def test_messages_of_equal_texts_are_joined_and_given_back() -> None:
    """Breaks if a joined message has another number or text, or an event is lost between equal ones."""
    values = [
        {"speed": "1.5", "count": "0", "state": "on"},
        {"speed": "0.1", "count": "0", "state": "on"},
        {"speed": "-0.0", "count": "3", "state": "on"},  # a constant number becomes a column
        {"speed": "1", "count": "3", "state": "on"},  # an integer is another text
        {"speed": "1", "count": "3", "state": "off"},
        {"speed": "1.50", "count": "3", "state": "off"},  # no number that is written like this
        {"speed": "nan", "count": "3", "state": "off"},
        *[{"speed": "nan", "count": "3", "state": "off", "changed": "{}"}] * 3,
    ]
    messages = [Diagnostic(SECOND * at, "controller", 0, "engaged", entry) for at, entry in enumerate(values)]
    kept = KeptReports()
    for message in messages:
        kept.add(message)
    found = Recording(kept_reports=kept.finish())
    assert found.reports == tuple(messages)
    assert len(kept.finish()) < len(messages)
    assert [report.stamp // SECOND for report in found.changed_reports] == [0, 2, 3, 4, 5, 6, 7, 8, 9]
    one, other = found.diagnostics["controller"], Recording(kept_reports=tuple(messages)).diagnostics["controller"]
    assert {key: one.texts(key) for key in one.values} == {key: other.texts(key) for key in other.values}
    late = KeptReports()
    for message in (messages[1], messages[0]):
        late.add(message)
    assert late.finish() == tuple(messages[:2])


def test_totals_and_series_are_those_of_the_messages() -> None:
    """Breaks if the last message of a span is missing in the totals, or a number or text in the series."""
    alone = Recording(kept_reports=RECORDING.reports)
    assert RECORDING.totals == alone.totals == {"energy_traction": 0.1, "replans": 2.0}
    for node in ("plant", "profile"):
        one, other = RECORDING.diagnostics[node], alone.diagnostics[node]
        assert one.time.tolist() == other.time.tolist()
        assert (one.level.tolist(), one.message) == (other.level.tolist(), other.message)
        assert {key: one.texts(key) for key in one.values} == {key: other.texts(key) for key in other.values}
