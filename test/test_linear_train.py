"""Linear model of a train: finite differences of the plant, modes of the couplers, a closed form."""

from __future__ import annotations

import numpy as np
import pytest

import train_ato as ta
from plant_sim.line import Line
from plant_sim.train import Train
from train_ato.apps.runs.scenario_choice import choose_scenario
from train_ato.control.algorithms.coupler_modes import TrainModes

LEVEL = Line.model_validate({"schema": "train_ato/line/1", "name": "level", "end": 10000.0})
STEP_NS = 100_000


def plant_slopes(name: str, speed: float, lag: float) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives of the accelerations of all vehicles by displacements and speeds, and by forces."""
    setup = choose_scenario(name).prepare()
    consist = setup.consist
    places, speeds = 5000.0 - np.array(consist.offsets), np.full(len(consist.vehicles), speed)

    def accelerations(moved: np.ndarray, faster: np.ndarray, force: np.ndarray) -> np.ndarray:
        start = {"positions": tuple((places + moved).tolist()), "speeds": tuple((speeds + faster).tolist())}
        plant = setup.plant.model_copy(
            update={"start": type(setup.plant.start).model_validate(start), "lag": 0.0, "ideal_actuator": True,
                    "disturbances": (), "jumps": ()}
        )  # fmt: skip
        train = Train(consist, LEVEL, plant, STEP_NS, STEP_NS, 0)
        train.advance(force[None, :])
        return (train.velocity - speeds - faster) / (STEP_NS * 1e-9)

    n, units = len(consist.vehicles), len(consist.power_units)
    base = np.full(units, 2e4)
    none, unit, push = np.zeros(n), np.eye(n), np.eye(units)
    rows = [accelerations(1e-3 * e, none, base) - accelerations(-1e-3 * e, none, base) for e in unit]
    rows += [accelerations(none, 1e-3 * e, base) - accelerations(none, -1e-3 * e, base) for e in unit]
    forced = [accelerations(none, none, base + 1e3 * e) - accelerations(none, none, base) for e in push]
    return np.array(rows).T / 2e-3, np.array(forced).T / 1e3


@pytest.mark.parametrize(
    ("name", "speed_kmh"), [("freight_consensus", 50.0), ("crh380a_gpc", 200.0), ("xuzhou_metro", 70.0)]
)
def test_the_matrices_are_the_slopes_of_the_plant(name, speed_kmh):
    """Breaks if a mass, a stiffness, a damper, the slope of the resistance, a sign or a row is another one."""
    model = ta.linearise(name, speed_kmh=speed_kmh)
    lag = choose_scenario(name).prepare().model.lag
    state, force = plant_slopes(name, speed_kmh / 3.6, lag)
    n, units = len(state), force.shape[1]
    assert [entry[0] for entry in model.states[:n]] == [f"vehicle_{i}_displacement" for i in range(n)]
    assert model.A[n : 2 * n, : 2 * n] == pytest.approx(state, rel=2e-3, abs=2e-3 * np.abs(state).max())
    found = model.A[n : 2 * n, 2 * n :] if lag else model.B[n:]
    assert found == pytest.approx(force, rel=1e-3, abs=1e-3 * np.abs(force).max())
    assert np.array_equal(model.A[:n, n : 2 * n], np.eye(n))
    if lag:
        assert np.array_equal(model.B[2 * n :], np.eye(units) / lag)
    drag = model.A[n : 2 * n, n : 2 * n].sum(axis=1)
    assert drag == pytest.approx(state[:, n:].sum(axis=1), rel=0.02)


def test_the_poles_are_those_of_the_coupler_modes():
    """Breaks if the friction of the gears or a mode is missing: zeta omega and omega of every mode, and the lag."""
    setup = choose_scenario("demo").prepare()
    modes, model = TrainModes.of(setup.model), ta.linearise("demo", speed_kmh=40)
    poles = model.poles
    waves = sorted(poles[poles.imag > 0], key=abs)
    assert len(waves) == modes.omega.size == len(modes.mass) - 1
    assert np.abs(waves) == pytest.approx(modes.omega, rel=1e-3)
    damped = -np.real(waves) / np.abs(waves)
    assert damped == pytest.approx(modes.viscous + modes.friction, rel=0.02, abs=2e-3)
    assert np.abs(poles + 1.0 / setup.model.lag).min() < 1e-9


def test_the_response_of_one_vehicle_is_a_closed_form():
    """Breaks if the delay is in the matrices or missing in the response: e^(-j w tau)/((1 + j w Ta)(M j w + r))."""
    setup, omega = choose_scenario("xuzhou_metro").prepare(), np.array([0.01, 0.3, 2.0])
    model, nominal = ta.linearise("xuzhou_metro", speed_kmh=60), setup.model
    speed, h = 60 / 3.6, 1e-4
    slope = (nominal.running_resistance(speed + h) - nominal.running_resistance(speed - h)) / (2 * h)
    delay = np.exp(-1j * omega * nominal.delay[0]) / (1 + 1j * omega * nominal.lag)
    expected = delay / (nominal.inertia * 1j * omega + slope)
    assert model.response(omega)[:, 1, 0] == pytest.approx(expected, rel=1e-6)
    assert model.outputs == (("unit_0_displacement", "m"), ("unit_0_speed", "m/s"))
    assert model.delay.tolist() == nominal.delay.tolist() and model.force == nominal.running_resistance(speed)
    system = model.scipy()
    assert np.array_equal(system.A, model.A) and np.array_equal(system.D, model.D)


@pytest.mark.parametrize("speed", [0.0, -5.0, float("nan"), 2000.0])
def test_an_impossible_speed_is_refused(speed):
    """Breaks if a speed without a linear model is accepted."""
    with pytest.raises(ValueError, match="speed_kmh"):
        ta.linearise("demo", speed_kmh=speed)
