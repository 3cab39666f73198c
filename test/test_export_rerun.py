"""``train-ato export RUN --rerun``: a recording for the Rerun viewer, read with the reader of its package."""

import sys
from pathlib import Path

import numpy as np
import pyarrow
import pytest

import train_ato as ta
from plant_sim.alignment import Alignment
from train_ato.cli.main import main
from train_ato.log.run_folder import read_run_folder


@pytest.fixture(scope="module")
def run(demo_run) -> Path:
    return demo_run("duration=20")


def test_the_recording_has_the_numbers_of_the_log(run: Path, tmp_path: Path) -> None:
    """Breaks if a curve has another time or value than the log, or a box is not at its vehicle."""
    chunk = pytest.importorskip("rerun.chunk", reason="needs pip install rerun-sdk, Python 3.11 or later")
    assert main(["export", str(run), "--rerun", "--out", str(tmp_path / "out")]) == 0
    chunks: dict[str, list[pyarrow.RecordBatch]] = {}  # a slow machine writes several for one path
    for entry in chunk.RrdReader(tmp_path / "out" / "run.rrd").stream():
        if not entry.is_static:
            chunks.setdefault(entry.entity_path, []).append(entry.to_record_batch())
    found = {path: pyarrow.Table.from_batches(batches).sort_by("simulated_time") for path, batches in chunks.items()}
    table = ta.open_run(run)["train/measurement"]
    speed = next(batch for path, batch in found.items() if path.endswith("train/measurement/unit_0_speed_m_s"))
    assert speed["simulated_time"].cast("int64").to_numpy() == pytest.approx(table.index.to_numpy() * 1e9)
    values = [entry[0] for entry in speed["Scalars:scalars"].to_pylist()]
    assert values == table["unit_0_speed_m_s"].tolist()
    assert not any("train/vehicles" in path for path in found), "a table of 424 columns is no set of curves"
    boxes, states = found["/scene/vehicles"], ta.open_run(run)["train/vehicles"]
    assert boxes.num_rows == 20 * 5 + 1
    positions = states[[name for name in states if str(name).endswith("position_m")]].to_numpy()[-1]
    track = Alignment(read_run_folder(run)[0].line).at(positions)
    centers = np.array(boxes["Boxes3D:centers"].to_pylist()[-1])
    assert centers[:, :2] == pytest.approx(np.column_stack((track.x, track.y)), abs=1e-3)


def test_a_missing_package_is_named(run, tmp_path, monkeypatch, capsys):
    """Breaks if the base installation without the viewer's package ends in a traceback."""
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(["export", str(run), "--rerun", "--out", str(tmp_path / "out")]) == 2
    assert "pip install rerun-sdk" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
