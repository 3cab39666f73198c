"""The report of a log without the folder of its run, and of one that lacks what the train has."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from import_files import recorded, take

from train_ato.report.lines import LINES, LeftOut
from train_ato.report.recording import read_recording

GOLDEN = Path(__file__).resolve().parent / "golden" / "short_train" / "run.mcap"


def test_a_log_that_lies_in_another_runs_folder_is_not_that_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if train, summary and name on the page are those of the folder, its figures those of the other log."""
    take(tmp_path, capsys, recorded(0.2, 60.0))
    other = tmp_path / "imported" / "other.mcap"
    shutil.copy(GOLDEN, other)
    found, alone = read_recording(other), read_recording(GOLDEN)
    assert found.name == "other"
    assert found.setup is not None
    assert alone.setup is not None
    assert found.setup.consist == alone.setup.consist
    assert "measured_file" not in found.summary
    own = read_recording(tmp_path / "imported" / "run.mcap")
    assert own.name == "imported"
    assert own.summary["measured_file"] == "run.csv"


@pytest.mark.parametrize(
    ("train", "reason"),
    [("hxd1_c80_105", "the log has nothing of an air brake"), ("xuzhou_metro_3", "the train has no air brake")],
)
def test_a_train_with_an_air_brake_is_not_said_to_have_none(
    train: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if the recorder's silence on the brake pipe is told as a property of the train."""
    take(tmp_path, capsys, recorded(0.5, 60.0), train=["--consist", train, "--line", "level"])
    recording = read_recording(tmp_path / "imported")
    for name in ("pipe", "shoe_force"):
        with pytest.raises(LeftOut, match=reason):
            LINES[name](recording)
