"""Paper 000: series of the judges and cases of the tables."""

import numpy as np
import pytest
from law_trains import SINGLE, inputs, model, printed_law
from reproduce_results import series

from plant_sim.elementary import random_stream
from train_ato.control.laws.rbf_smc import RbfSmcParameters
from train_ato.papers.p000_heavy_haul.cases import CASES, DURATION
from train_ato.papers.p000_heavy_haul.checks import LOCOMOTIVE, disturbance_40, network_estimate, unexplained


@pytest.mark.parametrize("clip", [False, True])
def test_network_estimate_is_the_law_s_own(clip: bool) -> None:
    """Breaks if the series drawn as delta_hat is not what `rbf_smc` adds to its force."""
    period, train = 0.05, model(SINGLE)
    learning = printed_law("rbf_smc", {"clip": clip}, train, period)
    plain = printed_law("smc", {}, train, period)
    random = random_stream(3, "test/network")
    errors, rates = 0.02 * random.standard_normal(40), 0.008 * random.standard_normal(40)
    added = []
    for error, rate in zip(errors, rates, strict=True):
        seen = inputs(train, position=np.array([500.0 + error]), velocity=np.array([10.0 + rate]))
        added.append(float((plain.step(seen).force - learning.step(seen).force)[0]) / train.mass)
    run = series(rates, np.zeros(40), period)
    run.front_position[:] = run.reference_position + errors
    found = network_estimate(run, RbfSmcParameters(clip=clip), period)
    assert np.abs(found).max() > 1e-6
    np.testing.assert_allclose(found, added, rtol=1e-4, atol=1e-9)


def test_unexplained_motion_is_the_model_error_and_the_disturbance() -> None:
    """A locomotive pulled back by 2 m/s² with f_hat = f/1.01: delta = -0.0198; breaks with a wrong sign or share."""
    period, count = 0.05, 200
    time = period * np.arange(count)
    sigma = 0.002 + 0.001 * np.sin(time + period / 2 + 1)
    sigma += 0.0003 * 20.0 * (np.sin(2 * (time + period / 2) + 2) + np.cos(3 * (time + period / 2) + 1))
    still = series(np.zeros(count), LOCOMOTIVE * (2.0 - sigma), period)
    np.testing.assert_allclose(disturbance_40(still, period), sigma, atol=1e-12)
    found = unexplained(still, period, 0.01, disturbance_40(still, period))
    np.testing.assert_allclose(found[:-1], -2.0 * 0.01 / 1.01 + sigma[:-1], atol=1e-9)


def test_both_tables_are_run() -> None:
    ideal = ("pid", "smc", "rbf", "rbf_ndo", "smc_ks", "rbf_ks", "rbf_ks_ndo")
    lagged = ("twin_pid", "twin_smc_ndo", "predicted")
    wanted = [f"{law}{suffix}" for law in ideal for suffix in ("", " disturbed")]
    wanted += [f"{law} {train}" for law in lagged for train in ("nominal", "disturbed", "mismatch", "strong")]
    for key in wanted:
        case = CASES[key]
        assert case.changes["duration"] == DURATION, key
        assert case.changes.get("tick", 0.05) == (0.01 if key.startswith("pid") else 0.05), key
        assert ("+disturbed" in case.scenario) == (not key.endswith("nominal") and key not in ideal), key
