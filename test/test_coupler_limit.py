"""Limit of the coupler forces in the plan of the law mpc."""

from __future__ import annotations

import numpy as np
import pytest

import train_ato as ta
from plant_sim.library import load_consist, load_line
from train_ato.control.algorithms.coupler_limit import CouplerLimit
from train_ato.control.train_model import TrainModel


def _model(consist: str, line: str) -> TrainModel:
    train = load_consist(consist)
    delays = np.full(len(train.power_units), 0.8)
    return TrainModel(train, load_line(line), delays, delays, 0.4, 0.1)


@pytest.mark.parametrize("limit", [2e5, 4e5])
def test_range_of_a_locomotive_with_wagons_on_the_level(limit: float) -> None:
    """The force behind the locomotive has the wagons' part of the inertia: a wrong part or sign changes the range."""
    model = _model("hxd1_c80_105", "level")
    low, high = CouplerLimit(model, limit).force_range(np.array([2e4]), np.array([10.0]))[:, 0].tolist()
    part = 1.0 - model.unit_inertia[0] / model.inertia
    own = model.own_resistance(np.array([10.0]), np.array([2e4]))[0]
    rest = own - (1.0 - part) * model.resisting_force(2e4, 10.0)
    assert high == pytest.approx((limit + rest) / part)
    assert low == pytest.approx((rest - limit) / part)


def test_range_on_a_change_of_grade() -> None:
    """Without the grade of every vehicle at its own place, draft at the top of a grade is not seen."""
    model = _model("hxd1_c80_105", "daqin_section")
    places = np.linspace(4e3, 4e4, 50)
    ranges = CouplerLimit(model, 4e5).force_range(places, np.full(50, 15.0))
    for place, (low, high) in zip(places, ranges.T, strict=True):
        rows = []
        for force in (low, high):
            acceleration = (force - model.resisting_force(place, 15.0)) / model.inertia
            front = force
            largest = 0.0
            for i, vehicle in enumerate(model.consist.vehicles[:-1]):
                at = place - model.consist.offsets[i]
                specific, begin = model.specific_line_force()
                line = np.interp(at - begin, np.arange(specific.size), specific)
                polynomial = vehicle.resistance.polynomial(vehicle.mass, model.consist.gravity)
                running = float(np.polyval(polynomial[::-1], 15.0))
                front -= vehicle.mass * line + running + vehicle.mass * vehicle.rotating_mass_factor * acceleration
                largest = max(largest, abs(front))
            rows.append(largest)
        assert low < high
        np.testing.assert_allclose(rows, 4e5, rtol=0.01)


def test_traction_of_one_locomotive_keeps_the_limit() -> None:
    """Without the limit in the plan this departure has a draft of 544 kN; with it the locomotive pulls less."""
    draft, force = [], []
    for limit in (0.0, 2e5):
        changes = {"duration": 150, "laws.mpc.coupler_limit": limit}
        run = ta.run("daqin_heavy_haul", law="mpc", compensation="none", set=changes, progress=False)
        draft.append(run.metrics["coupler_draft_max_kn"])
        force.append(float(run["ato/command"].filter(like="force").to_numpy().max()) / 1e3)
    assert draft[0] > 500.0
    assert 190.0 < draft[1] < 206.0, "waves add a few kN"
    assert force[1] < 206.0 < force[0]
