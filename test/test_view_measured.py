"""Driver's display of a measured run: recorded data only, no unmeasured vehicles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from import_files import recorded, take

from train_ato.apps.view.recorded import RecordedFeed
from train_ato.log.tables.loading import load


def test_a_measured_run_is_shown_as_it_was_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the display needs true states, or shows the front of the train at its power unit."""
    take(tmp_path, capsys, recorded(0.2, 60.0), train=["--consist", "crh380a_three_units", "--line", "level"])
    feed = RecordedFeed(tmp_path / "imported")
    table = load(tmp_path / "imported")["train/measurement"]
    assert feed.facts.layout.n_vehicles == 1, "no strip of couplers along the train"
    feed.seek(30.0)
    assert feed.frame is not None
    moment, row = feed.frame.moment, table.iloc[300]
    assert moment.speed == pytest.approx(3.6 * row["unit_0_speed_m_s"], abs=1e-9)
    assert moment.applied.sum() == pytest.approx(sum(row[f"unit_{unit}_applied_force_n"] for unit in range(3)))
    assert feed.recording.setup is not None
    offset = feed.recording.setup.model.offsets[0]
    assert moment.position[0] == pytest.approx(row["unit_0_position_m"] + offset, abs=1e-9)
    part = feed.part(0.0, 60.0)
    assert np.isfinite(part["speed"]).all()
    feed.step(1)
    assert feed.time == pytest.approx(30.1)
