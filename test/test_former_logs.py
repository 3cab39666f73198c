"""Logs of version 0.1.0 with the former names of topics and vehicles: the golden run of that version."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import train_ato
from train_ato.apps.replay.log import ReplayLog
from train_ato.apps.replay.options import ReplayOptions, chosen_topics
from train_ato.cli import main
from train_ato.log import bag_layout
from train_ato.log.reading import attachments, iter_raw, read_log
from train_ato.log.run_folder import read_run_folder
from train_ato.log.versions import SCENARIO
from train_ato.messages.codec.codec import Wire
from train_ato.messages.topic import SUPERVISED
from train_ato.messages.topics import BY_NAME

OLD = Path(__file__).resolve().parent / "golden" / "former" / "short_train" / "run.mcap"
FORMER = {"train/vehicles": "train/cars", "train/brake_shoes": "train/brake_cylinders",
          "ato/brake_pipe_command": "ato/brake_pipe"}  # fmt: skip


@pytest.fixture(scope="module")
def wire() -> Wire:
    return Wire(read_run_folder(OLD)[0].layout)


def test_messages_have_the_present_names(wire: Wire) -> None:
    """Breaks if a former topic is left out, or vehicles named car_0 ... are refused."""
    read = {topic for topic, _, _ in iter_raw(OLD)}
    assert set(FORMER) <= read
    assert not set(FORMER.values()) & read
    seen = [message for _, _, message in read_log(OLD, wire.decode, ("train/vehicles",))]
    assert seen[0].position.size == wire.layout.n_vehicles
    assert np.isfinite(seen[-1].coupler_force).all()


def test_a_layout_of_former_names_is_found_once(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if every message of a former log is read: the log of an hour would take minutes."""
    from train_ato.messages.codec import fixed

    calls = []
    original = fixed.layout_of
    monkeypatch.setattr(fixed, "layout_of", lambda *given: calls.append(1) or original(*given))
    fresh = Wire(wire.layout)
    made = len(calls)
    for topic, _, data in iter_raw(OLD, ("train/vehicles", "train/brake_shoes")):
        fresh.decode(topic, data)
    assert len(calls) - made == 2


def test_tables_have_the_present_names(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if `load` keeps the old topic or column, or prints more than one notice."""
    monkeypatch.setattr(bag_layout, "_shown", [])
    frames = train_ato.load(OLD)
    assert set(FORMER) <= set(frames)
    assert "vehicle_3_coupler_force_n" in frames["train/vehicles"]
    assert "vehicle_0_shoe_force_n" in frames["train/brake_shoes"]
    assert frames["train/cars"] is frames["train/vehicles"]
    (line,) = capsys.readouterr().err.splitlines()
    assert "topic names of version 0.1.0" in line
    assert list(train_ato.load(OLD, topics=["train/vehicles"])) == ["train/vehicles"]
    assert list(train_ato.load(OLD, topics=["train/cars"])) == ["train/vehicles"]


def test_replay_publishes_under_the_present_names() -> None:
    """Breaks if the replay of a former log uses the former topics."""
    with ReplayLog(OLD) as log:
        chosen = chosen_topics(log.topics, ReplayOptions())
    names = {topic.published_as.lstrip("/") for topic in chosen.values()}
    known = {topic for topic in BY_NAME.values() if topic.recorded and topic.condition is not SUPERVISED}
    assert names == {topic.name.lstrip("/") for topic in known} - {"train/brake_pipe_tail"}


def test_an_old_run_has_no_supervision(tmp_path: Path) -> None:
    """Breaks if a run recorded before the supervision is repeated or drawn with it, or a new one without."""
    assert not read_run_folder(OLD)[0].layout.supervised
    text = attachments(OLD)[SCENARIO]
    assert b"supervision:" not in text
    for name, added, supervised in (("old", b"", False), ("new", b"supervision: {overlap: 50}\n", True)):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "run.mcap").write_bytes(OLD.read_bytes())
        (folder / SCENARIO).write_bytes(text + added)
        assert read_run_folder(folder)[0].layout.supervised is supervised


def test_info_and_report_read_an_old_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a command rejects a former log or omits the train."""
    assert main(["info", str(OLD), "--json"]) == 0
    json.loads(capsys.readouterr().out)
    page = tmp_path / "report.html"
    assert main(["report", str(OLD), f"--out={page}"]) == 0
    assert "coupler" in page.read_text(encoding="utf-8")
