"""Law mpc around the simulated train of `twin`, and the identification of the train against it."""

from __future__ import annotations

import numpy as np
import pytest

import train_ato as ta
from plant_sim import kernel as k
from train_ato.control.algorithms.simulated_reference import follow_simulation
from train_ato.control.algorithms.train_identification import SLOWEST, WEAR, TrainIdentification
from train_ato.control.algorithms.worn_gears import worn
from train_ato.control.compensation.ahead_train import AheadTrain, TwinParameters
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import load_scenario

DAQIN = "daqin_heavy_haul:twin+identified"


def _metrics(scenario, duration, **options):
    return ta.run(scenario, set={"duration": duration}, progress=False, **options).metrics


def _rms(metrics):
    """Return the root mean square of the speed error [m/s]."""
    return metrics["speed_rmse_kmh"] / 3.6


def test_mpc_follows_the_simulated_train():
    """Breaks if mpc plans with the force of the rigid train: 20 mm/s, 23 kN/s; the goals are 1.6 and 12."""
    found = _metrics("daqin_heavy_haul:twin", 200, law="mpc")
    assert _rms(found) <= 0.0016
    assert found["command_variation_kn_per_s"] <= 12.0


def test_noise_does_not_reach_the_command():
    """Breaks if the measured speed is used unfiltered, as by pid: 5 mm/s and 25 kN/s; the goals are 4 and 12."""
    found = _metrics(f"{DAQIN}+disturbed+noise", 200, law="mpc")
    assert _rms(found) <= 0.004
    assert found["command_variation_kn_per_s"] <= 12.0


def test_the_twin_receives_the_errors_of_the_model():
    """Breaks if the twin is not corrected: the position error of pid stays at .8 m."""
    errors = {}
    for name in ("twin", "twin+identified"):
        run = ta.run(f"daqin_heavy_haul:{name}+strong_mismatch", law="pid", set={"duration": 300}, progress=False)
        position = run["train/measurement"]["unit_0_position_m"] - run["ato/reference"]["position_m"]
        errors[name] = float(position.iloc[-500:].abs().mean())
    assert errors["twin"] > 0.5
    assert errors["twin+identified"] < 0.1


@pytest.mark.parametrize(("variant", "wear"), [("+strong_mismatch", 0.2), ("", 0.0)])
def test_the_wear_of_the_draft_gears_is_found(monkeypatch, variant, wear):
    """Breaks with the effect of wear on the force alone, or with shocks of the couplers as samples like others.

    The gears of the mismatch have 20 % less stiffness, 25 % less preload, 20 % more slack and unloading ratio.
    """
    filters = []
    step = TrainIdentification.step

    def kept(self, *sample):
        filters[:] = [self]
        step(self, *sample)

    monkeypatch.setattr(TrainIdentification, "step", kept)
    _metrics(f"{DAQIN}{variant}", 1000, law="mpc")
    (found,) = filters
    deviation = found.deviations[WEAR]
    assert deviation < 0.05
    assert abs(found.errors[WEAR] - wear) < 2.0 * deviation


def _filtered(errors, waves=0.0, noise=0.0):
    """Return the estimate for a train with errors of mass, resistance and brake, and wear; forces over mass in m/s²."""
    random = np.random.default_rng(1)
    found, speed, wave = TrainIdentification(0.1), 0.0, 0.0
    for i in range(6000):
        t = 0.1 * i
        by_wear = 0.5 * np.sin(t / 10.0)
        phases = [0.05 * np.sin(t / 40.0), 0.01 + 0.005 * np.cos(t / 70.0), 0.06 * (t % 200.0 > 150.0)]
        known = np.array([*phases, -0.1 * by_wear])
        pull = 0.3 * np.array(errors) @ known - 0.05 * speed
        wave = 0.98 * wave + waves * random.normal()
        measured = speed + errors[WEAR] * by_wear + wave + noise * random.normal()
        found.step(measured, SLOWEST, pull, known, by_wear)
        speed += 0.1 * (pull - np.array(errors) @ known)
    return found.errors


@pytest.mark.parametrize(("waves", "noise", "bound"), [(0.0, 0.0, 0.003), (0.002, 0.02, 0.03)])
def test_identification_separates_the_errors(waves, noise, bound):
    """A wrong sign or a wrong row of the covariance gives other errors, or none."""
    errors = (0.03, 0.15, -0.08, 0.2)
    np.testing.assert_allclose(_filtered(errors, waves, noise), errors, atol=bound)


def test_an_exact_model_has_no_errors():
    """A force that is not in both trains appears as an error of the model."""
    np.testing.assert_allclose(_filtered((0.0, 0.0, 0.0, 0.0)), 0.0, atol=1e-12)


@pytest.mark.parametrize("identify", [False, True])
def test_corrections_scale_the_simulated_train(identify):
    """A factor on the last value in place of the nominal one, the resistance scaled by the mass twice, no slack."""
    setup = prepare(*load_scenario("daqin_heavy_haul"))
    ahead = AheadTrain(setup.model, setup.profile, TwinParameters(identify=identify), setup.brake_policy(), 0.0)
    rows, gears = [k.MASS, k.C0, k.SHOE], [k.F0, k.A1, k.HALF_SLACK, k.RATIO]
    nominal, new = ahead._train.arrays.vehicle[rows].copy(), ahead._train.arrays.gear[gears].copy()
    for errors in ([0.1, -0.1, 0.2, 0.3], [0.03, 0.15, -0.08, 0.2]):
        ahead.correct(errors)
        ahead.run(ahead._train.time + 0.1, 0.0)
    expected = nominal * np.array([[1.03], [1.15], [0.92]])
    worn = new * np.array([[0.8], [0.8], [1.2], [1.2]])
    np.testing.assert_allclose(ahead._train.arrays.vehicle[rows], expected, rtol=1e-12)
    np.testing.assert_allclose(ahead._train.arrays.gear[gears], worn, rtol=1e-12)


@pytest.mark.parametrize("wear", [-0.3, 0.2])
def test_wear_keeps_the_force_of_the_closed_gear(wear):
    """Breaks if the second-order coefficient of the loading curve stays: the closed gear loses force."""
    consist = prepare(*load_scenario("daqin_heavy_haul")).model.consist
    for gear in consist.draft_gears.values():
        used = worn(gear, wear)
        d = used.stroke
        loading = used.preload * d / (d + used.preload_length) + used.stiffness * d + used.second_order * d * d
        assert loading == pytest.approx(gear.force_at_stroke, rel=1e-12)
        assert used.stiffness == pytest.approx((1.0 - wear) * gear.stiffness)
        assert worn(gear, 0.0) == gear


def test_the_simulated_force_replaces_the_rigid_one_up_to_the_effect():
    """A shift by one entry, or a jump after the last known entry, changes the plan."""
    rigid, simulated = np.arange(6.0), np.array([10.0, 12.0])
    np.testing.assert_array_equal(follow_simulation(rigid, simulated, 4), [10.0, 12.0, 13.0, 14.0, 4.0, 5.0])
    np.testing.assert_array_equal(follow_simulation(rigid, simulated, 1), [10.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    assert follow_simulation(rigid, np.zeros(0), 4) is rigid
