"""Environments of Gymnasium: its checks, seeds, spaces and vectors."""

import subprocess
import sys
import warnings

import numpy as np
import pytest

import train_ato as ta

gymnasium = pytest.importorskip("gymnasium", reason="needs the extra packages: pip install '.[gymnasium]'")
ENVS = "train_ato.api.env.gymnasium_env"


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
        runs.append(env.unwrapped.run_env.setup.scenario.seed)
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


@pytest.mark.parametrize("flat", [True, False])
def test_one_compiled_call_is_a_vector_with_the_results_of_single_environments(flat):
    """Breaks if the vector has another space, seed, reset or run than the environments that Gymnasium joins."""
    from gymnasium.utils.env_checker import data_equivalence

    name, choices = f"{ENVS}:train_ato/XuzhouMetro-v0", {"set": {"duration": 2}}
    one = gymnasium.make_vec(name, 3, flat=flat, **choices)
    joined = gymnasium.make_vec(name, 3, vectorization_mode="sync", flat=flat, **choices)
    assert "train_ato" in type(one.unwrapped).__module__
    assert one.metadata["autoreset_mode"] is joined.metadata["autoreset_mode"]
    for space in ("observation_space", "action_space", "single_observation_space", "single_action_space"):
        assert getattr(one, space) == getattr(joined, space), space
    joined.action_space.seed(1)
    assert data_equivalence(one.reset(seed=7)[0], joined.reset(seed=7)[0])
    for number in range(41):
        forces = joined.action_space.sample()
        mine, theirs = one.step(forces), joined.step(forces)
        if number < 40:  # the reset after it draws other seeds
            assert data_equivalence(mine[0], theirs[0]) and np.array_equal(mine[1], theirs[1])
            assert one.observation_space.contains(mine[0])
        assert mine[2].tolist() == theirs[2].tolist() == [number == 39] * 3 and not mine[3].any()
    assert mine[1].tolist() == [0.0] * 3
    one.close()
    joined.close()


def test_the_import_registers_every_scenario_without_the_compiler():
    """Breaks if `gymnasium.make` needs another import, the registration loads numba, or an old Gymnasium stops it."""
    code = (
        "import sys, gymnasium, train_ato; assert not {'numba', 'pandas'} & sys.modules.keys()\n"
        "assert gymnasium.make('train_ato/XuzhouMetro-v0', set={'duration': 1}).reset(seed=1)"
    )
    old = "import gymnasium; del gymnasium.vector.AutoresetMode; import train_ato; train_ato.scenarios()"
    for text in (code, old):
        subprocess.run([sys.executable, "-c", text], check=True)
