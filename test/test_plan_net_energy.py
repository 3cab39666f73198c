"""Net energy as the objective: efficiency, recovered share, electric brake first, auxiliary power."""

from __future__ import annotations

import numpy as np
import pytest
from test_plan_command import METRO, options
from test_plan_energy import hills, metro

from plant_sim.consist import Consist
from train_ato.cli.plan import plan_from_options
from train_ato.profile.planner.planner import Plan, net_energy_bound, plan_profile
from train_ato.profile.planner.settings import PlanSettings

NET = PlanSettings(jerk=None, force_margin=0.0, efficiency=0.85, recovered=0.7, auxiliary=50e3)
FACTOR = 1.1
OPTIMUM_KWH = 36.032
"""Net energy of an independent optimum on the hills with 60 km/h: sequential linear programs over 500 cells, the
functions of ``studies_done/plan_optimum.py``."""


def weak_electric_brake() -> Consist:
    """Return the six cars with 20 kN of electric brake in place of 70, and with an air brake."""
    data = metro().model_dump(mode="json", exclude_none=True)
    motor = data["vehicle_types"]["motor"]
    motor["brake"] = [{"to_kmh": 100, "force_kn": 20}]
    for kind in data["vehicle_types"].values():
        kind["shoes"] = {"count": 8, "force_kn": 30, "friction": 0.48}
    air = {"charged_kpa": 600, "apply_wave": 200, "release_wave": 36, "apply_time": 4, "release_time": 6}
    data["air_brake"] = air | {"reduction_kpa": [0, 50], "braking_factor": [0, 0.17]}
    return Consist.model_validate(data)


@pytest.fixture(scope="module")
def running_time() -> float:
    """Return the running time of the plans [s]."""
    return FACTOR * plan_profile(hills(60), weak_electric_brake(), NET).running_time


@pytest.fixture(scope="module")
def frugal(running_time: float) -> Plan:
    """Return the plan of the least net energy."""
    return plan_profile(hills(60), weak_electric_brake(), NET.model_copy(update={"time": running_time}))


def test_net_energy_has_all_its_parts(frugal: Plan) -> None:
    """Breaks if efficiency, recovered share or auxiliary power is applied to another part."""
    figures = frugal.summary()
    auxiliary = 50.0 * frugal.running_time / 3600
    net = figures["energy_kwh"] / 0.85 - 0.7 * figures["energy_electric_brake_kwh"] + auxiliary
    assert figures["energy_net_kwh"] == pytest.approx(net, abs=2e-4)


def test_the_electric_brake_acts_first_within_its_envelope(frugal: Plan) -> None:
    """Breaks if the friction brake shares the force, or if recovered power exceeds the envelope of 80 kN."""
    way = np.diff(frugal.front)
    _, brake, electric = (work[way > 0.01] / way[way > 0.01] for work in frugal.work)
    assert electric.max() == pytest.approx(80e3, rel=1e-6)
    assert np.allclose(electric[brake < 79e3], brake[brake < 79e3])


def test_the_objective_saves_net_energy(frugal: Plan, running_time: float) -> None:
    """Breaks if the recovered share is not part of the search: the plan of least traction work needs more."""
    traction_only = NET.model_copy(update={"recovered": 0.0, "time": running_time})
    other = plan_profile(hills(60), weak_electric_brake(), traction_only).summary()
    auxiliary = 50.0 * running_time / 3600
    assert frugal.energy / 3.6e6 < other["energy_kwh"] / 0.85 - 0.7 * other["energy_electric_brake_kwh"] + auxiliary


def test_net_energy_is_close_to_the_independent_optimum(frugal: Plan) -> None:
    """Breaks if a switching curve has another place than its node: 5 % above the optimum on steep lines."""
    assert frugal.energy / 3.6e6 <= 1.01 * OPTIMUM_KWH


def test_the_bound_of_the_net_energy_is_below_the_plan(frugal: Plan) -> None:
    """Breaks for a wrong sign of the electric brake in the bound, or without the auxiliary power."""
    bound = net_energy_bound(frugal)
    assert 0.8 * frugal.energy <= bound <= frugal.energy


def test_the_options_reach_the_plan() -> None:
    """Breaks if an option of the net energy is not passed on."""
    words = ("--to-km", "2", "--efficiency", "0.9", "--recovered", "0.5", "--auxiliary-kw", "100")
    result = plan_from_options(options(*METRO, *words))
    net = result["energy_kwh"] / 0.9 - 0.5 * result["energy_electric_brake_kwh"] + 100 * result["running_time_s"] / 3600
    assert result["energy_net_kwh"] == pytest.approx(net, abs=3e-4)
    with pytest.raises(ValueError, match="recovered"):
        plan_from_options(options(*METRO, "--recovered", "1.5"))
