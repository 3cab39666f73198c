"""Shared fixtures: open data, a scratch working folder, one hypothesis profile for all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "train_ato", deadline=None, derandomize=True, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("train_ato")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the open data; tests that need it are skipped where it is absent."""
    named = os.environ.get("TRAIN_ATO_SHARED")
    folder = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"open data not found at {folder}; set TRAIN_ATO_SHARED to their folder")
    return folder
