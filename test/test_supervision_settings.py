"""Defaults and ranges of the block ``supervision:``; a default that moves changes the protection of the train."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from train_ato.supervision.settings import FailsafeSpec, SupervisionSpec
from train_ato.supervision.supervisor import SupervisionState

DEFAULTS: dict[str, Any] = {
    "enabled": None, "period": 0.4, "overlap": 100.0, "kdry": 0.8, "service_brake": True, "service_curve": False,
    "roll_away": 2.0, "speed_difference": 2.0, "position_difference": 20.0, "confirmation": 1.0, "assurance": True,
    "assurance_limit": "warning", "assurance_margin": 0.5, "plan_margin": 0.5,
    "failsafe": {"hold": 0.5, "coast": 1.0, "service": 5.0, "release": None},
}  # fmt: skip
RANGES = [
    # model, key, smallest and largest accepted value (None: no bound), refused values
    (SupervisionSpec, "period", (0.001, 2.0), (0.0009, 2.001)),
    (SupervisionSpec, "overlap", (0.0, 1e5), (-0.001, 100_000.1)),
    (SupervisionSpec, "kdry", (0.001, 1.0), (0.0, 1.001)),
    (SupervisionSpec, "roll_away", (0.001, None), (0.0,)),
    (SupervisionSpec, "speed_difference", (0.001, None), (0.0,)),
    (SupervisionSpec, "position_difference", (0.001, None), (0.0,)),
    (SupervisionSpec, "confirmation", (0.0, None), (-0.001,)),
    (SupervisionSpec, "assurance_margin", (0.0, None), (-0.001,)),
    (SupervisionSpec, "plan_margin", (0.0, None), (-0.001,)),
    (FailsafeSpec, "hold", (0.0, None), (-0.001,)),
    (FailsafeSpec, "coast", (0.0, None), (-0.001,)),
    (FailsafeSpec, "service", (0.0, None), (-0.001,)),
    (FailsafeSpec, "release", (0.001, None), (0.0,)),
]


def test_defaults() -> None:
    """Breaks if a default is changed without its entry here: the figures of every shipped run depend on it."""
    assert SupervisionSpec().model_dump() == DEFAULTS


@pytest.mark.parametrize(("model", "key", "accepted", "refused"), RANGES, ids=[row[1] for row in RANGES])
def test_ranges(
    model: type[SupervisionSpec], key: str, accepted: tuple[float | None, ...], refused: tuple[float, ...]
) -> None:
    """Breaks if a bound of a setting moves or is left out."""
    for value in accepted:
        if value is not None:
            assert getattr(model.model_validate({key: value}), key) == value
    for value in refused:
        with pytest.raises(ValidationError, match=key):
            model.model_validate({key: value})


def test_states_by_severity() -> None:
    """Breaks if a state of a recorded run changes its number: the log and the page have numbers."""
    names = ["NORMAL", "INDICATION", "OVERSPEED", "WARNING", "SERVICE_BRAKE", "EMERGENCY_BRAKE"]
    assert [(state.name, state.value) for state in SupervisionState] == list(zip(names, range(6), strict=True))
    assert SupervisionState.SERVICE_BRAKE.text == "service brake"
