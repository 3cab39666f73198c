"""Policy of a planned trip: places of the plan, and their moves by the measured electric brake."""

from __future__ import annotations

import numpy as np
import pytest

from plant_sim.library import load_consist, load_line
from train_ato.control.air_brake.policy import BrakeSpec, make_brake_policy
from train_ato.control.train_model import TrainModel

CHARGED, APPLIED = 600e3, 550e3
APPLY, RELEASE, SHIFT = 5000.0, 8000.0, 300.0
FULL = 461e3
"""Electric brake of the HXD1 between 5 and 75 km/h [N]."""


@pytest.fixture(scope="module")
def model() -> TrainModel:
    none = np.zeros(1)
    return TrainModel(load_consist("hxd1_c80_105"), load_line("daqin_section"), none, none, 0.0, 0.1)


def spec(**rules: float) -> BrakeSpec:
    application = {"apply": APPLY, "release": RELEASE, "reduction": 50e3} | {
        "electric_at_apply": 0.4,
        "electric_at_release": 0.3,
    }
    return BrakeSpec.model_validate({"policy": "trip", "applications": [application], "trip": rules})


def places(model: TrainModel, shares: list[tuple[float, float]], speed: float = 18.0, **rules: float) -> list[float]:
    """Return the places at which the pressure changes, for the used share of the electric brake from places on."""
    policy = make_brake_policy(spec(**rules), model, model.line)
    found, before, begins = [], CHARGED, [at for at, _ in shares]
    for place in np.arange(0.0, 12_000.0, 2.0):
        share = shares[int(np.searchsorted(begins, place, side="right")) - 1][1]
        pressure = policy.step(place / speed, place, speed, -share * FULL)
        if pressure != before:
            found.append(float(place))
        before = pressure
    return found


def test_the_nominal_train_brakes_at_the_planned_places(model: TrainModel) -> None:
    """Breaks if a place moves although the electric brake is used as planned."""
    assert places(model, [(0.0, 0.4), (6000.0, 0.3)]) == [APPLY, RELEASE]


def test_a_full_electric_brake_makes_the_application_earlier(model: TrainModel) -> None:
    """Breaks if a train heavier than planned waits for the planned place, or applies more than the shift before it."""
    apply, _ = places(model, [(0.0, 0.4), (4800.0, 0.95), (5100.0, 0.3)])
    assert 4800.0 + 4.0 * 18.0 - 4.0 <= apply <= 4800.0 + 4.0 * 18.0 + 4.0
    early = places(model, [(0.0, 0.4), (1000.0, 0.95), (1400.0, 0.2), (5100.0, 0.3)], pause=1e4, call=0.9)
    assert early[0] == pytest.approx(1000.0 + 4.0 * 18.0, abs=4.0), "an unplanned application"


def test_a_spared_electric_brake_makes_the_application_later(model: TrainModel) -> None:
    """Breaks if a train with more resistance than planned brakes at the planned place, or never."""
    assert places(model, [(0.0, 0.1), (6000.0, 0.3)])[0] == APPLY + SHIFT
    assert places(model, [(0.0, 0.1), (5100.0, 0.3)])[0] == 5100.0


def test_a_strained_electric_brake_makes_the_release_later(model: TrainModel) -> None:
    """Breaks if the shoes release while the electric brake has no reserve for the planned speed."""
    assert places(model, [(0.0, 0.4), (6000.0, 0.6)])[1] == RELEASE + SHIFT
    assert places(model, [(0.0, 0.4), (6000.0, 0.6), (8100.0, 0.3)])[1] == 8100.0


def test_drives_that_pull_make_the_release_earlier(model: TrainModel) -> None:
    """Breaks if drives pull against the shoes up to the planned place, or a release is far from it."""
    _, release = places(model, [(0.0, 0.4), (6000.0, -0.05)])
    assert RELEASE - SHIFT <= release <= RELEASE - SHIFT + 4.0


def test_a_release_is_before_the_minimum_speed_and_never_below_it(model: TrainModel) -> None:
    """Breaks if a slow train keeps its planned release place and then cannot release, or releases below the minimum."""
    slow = 35.3 / 3.6
    assert places(model, [(0.0, 0.4), (6000.0, 0.3)], speed=slow)[1] == RELEASE - SHIFT
    below = 34.9 / 3.6
    assert len(places(model, [(0.0, 0.4), (6000.0, 0.3)], speed=below)) == 1


def test_a_departure_releases(model: TrainModel) -> None:
    """Breaks if a train that has stopped with applied brakes cannot depart."""
    policy = make_brake_policy(spec(), model, model.line)
    for t, speed, force in ((0.0, 5.0, -0.4 * FULL), (1.0, 0.0, 0.0)):
        assert policy.step(t, APPLY + t, speed, force) == APPLIED
    assert policy.step(2.0, APPLY + 1.0, 0.0, 1e5) == CHARGED


def test_unplanned_applications_keep_the_recharge_pause(model: TrainModel) -> None:
    """Breaks if a used up electric brake far from the plan has no effect, or the reservoirs get no time to recharge."""
    shares = [(0.0, 0.95), (500.0, 0.1), (800.0, 0.95)]
    changes = places(model, shares, pause=60.0)
    released = changes[1]
    assert changes[0] == pytest.approx(4.0 * 18.0, abs=4.0)
    assert released == pytest.approx(500.0 + 4.0 * 18.0, abs=4.0)
    assert changes[2] - released >= 60.0 * 18.0 - 1e-6


@pytest.mark.parametrize(
    ("data", "word"),
    [
        ({"policy": "trip"}, "applications"),
        ({"policy": "none", "applications": [{"apply": 1.0, "release": 2.0}]}, "applications"),
        ({"policy": "trip", "applications": [{"apply": 2.0, "release": 1.0}]}, "release"),
    ],
)
def test_contradictions_are_refused(data: dict[str, object], word: str) -> None:
    """Breaks if a policy without applications, or applications without the policy, run silently."""
    with pytest.raises(ValueError, match=word):
        BrakeSpec.model_validate(data)
