"""Report of a log without its run folder, and of a log without the air brake of its train."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from import_files import MASS, metro, recorded, take, text_of

from train_ato.apps.report.curves import CURVES, NotAvailable
from train_ato.log.recorded import open_recording

GOLDEN = Path(__file__).resolve().parent / "golden" / "short_train" / "run.mcap"


def test_a_log_that_lies_in_another_runs_folder_is_not_that_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if train, summary and name on the page are those of the folder instead of the log."""
    take(tmp_path, capsys, recorded(0.2, 60.0))
    other = tmp_path / "imported" / "other.mcap"
    shutil.copy(GOLDEN, other)
    found, alone = open_recording(other), open_recording(GOLDEN)
    assert found.name == "other"
    assert found.setup is not None
    assert alone.setup is not None
    assert found.setup.consist == alone.setup.consist
    assert "measured_file" not in found.summary
    own = open_recording(tmp_path / "imported" / "run.mcap")
    assert own.name == "imported"
    assert own.summary["measured_file"] == "run.csv"


@pytest.mark.parametrize(
    ("train", "reason"),
    [("hxd1_c80_105", "the log has nothing of an air brake"), ("xuzhou_metro_3", "the train has no air brake")],
)
def test_a_train_with_an_air_brake_is_not_said_to_have_none(
    train: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a missing recording of the brake pipe is reported as a property of the train."""
    time = np.arange(0.0, 60.25, 0.5)
    mass, slower = {"hxd1_c80_105": (10684e3, 12.0), "xuzhou_metro_3": (MASS, 1.0)}[train]
    speed, position, force = (column / slower for column in metro(time))
    text = text_of(
        {"time_s": time, "speed_kmh": 3.6 * speed, "position_m": position, "force_kn": force * mass / MASS / 1e3}
    )
    take(tmp_path, capsys, text, train=["--consist", train, "--line", "level"])
    recording = open_recording(tmp_path / "imported")
    for name in ("pipe", "shoe_force"):
        with pytest.raises(NotAvailable, match=reason):
            CURVES[name](recording)
