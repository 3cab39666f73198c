"""Environments of Gymnasium: its checks, seeds, spaces and vectors."""

from __future__ import annotations

import subprocess
import sys
import warnings

import numpy as np
import pytest

import train_ato as ta

gymnasium = pytest.importorskip("gymnasium", reason="needs the extra packages: pip install '.[gymnasium]'")
ENVS = "train_ato.apps.env.gymnasium_env"


@pytest.mark.parametrize("scenario", ta.scenarios())
def test_the_checker_of_gymnasium_accepts_every_shipped_scenario(scenario):
    """Breaks if a space lacks a value, a seed has no effect, or a result has another form."""
    from gymnasium.utils.env_checker import check_env

    name = f"train_ato/{''.join(part.capitalize() for part in scenario.split('_'))}-v0"
    with warnings.catch_warnings():
        warnings.filterwarnings("error", module="gymnasium")
        env = gymnasium.make(f"{ENVS}:{name}", set={"duration": 5}, flat=scenario == "demo")
        check_env(env.unwrapped)
    assert env.spec.id == name


def test_a_seed_is_that_of_the_run_and_its_end_is_terminated():
    """Breaks if the wrapper drives another run than the engine with this seed, or ends it as truncated."""
    env = gymnasium.make(f"{ENVS}:train_ato/XuzhouMetro-v0", set={"duration": 2, "supervision.enabled": False})
    runs, ended = [], False
    for seed in (7, None, 7, None):
        env.reset(seed=seed)
        runs.append(env.unwrapped.run_env.setup.seed)
    assert runs[0] == runs[2] == 7 and runs[1] == runs[3] != 7
    while not ended:
        obs, _, ended, truncated, info = env.step(np.array([1.0]))
        assert env.observation_space.contains(obs) and not truncated
    assert info["metrics"]["simulated_s"] == 2.0 and env.unwrapped.run_env.run.metrics["status"] == "done"
    env.close()
    env.close()


def test_a_vector_begins_the_next_run_in_the_step_after_the_end():
    """Breaks if an ended run of a vector cannot go on, or its members are not independent."""
    envs = gymnasium.make_vec(f"{ENVS}:train_ato/XuzhouMetro-v0", num_envs=2, set={"duration": 4}, flat=True)
    assert envs.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.NEXT_STEP
    envs.reset(seed=1)
    ends = [envs.step(np.array([[0.2], [0.4]]))[2].tolist() for _ in range(82)]
    assert [row for row, end in enumerate(ends) if all(end)] == [79]
    for _ in range(70):
        obs, *_ = envs.step(np.array([[0.2], [0.4]]))
    assert obs[0].tolist() != obs[1].tolist() and obs[0, 0] == pytest.approx(3.55)


def test_the_registration_does_not_import_the_compiler():
    """Breaks if the import of Gymnasium, of this project or of the registration loads numba."""
    code = f"import sys, gymnasium, train_ato, {ENVS}; assert not {{'numba', 'pandas'}} & sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code], check=True)
