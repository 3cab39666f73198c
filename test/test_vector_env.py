"""Many environments in one call: the bits of single ones, their domains and seeds, the next run after an end."""

import threading
from typing import Any

import numpy as np
import pytest
from numba import typeof
from refusals import one_line

import train_ato as ta
from train_ato.loop.native_arguments import row_numbers

MASS = {"plant.mismatch.mass_scale": {"from": 0.8, "to": 1.2}}
CASES: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "metro, random": ("xuzhou_metro", {"duration": 12, "model.delay": 0.3}, MASS | {
        "links.command.delay": {"from": 0.1, "to": 0.5}, "plant.line": ["xuzhou_metro_test", "level"],
        "plant.adhesion": [{"kind": "curtius_kniffler", "factor": factor} for factor in (0.3, 1.0)],
        "plant.disturbances": [[], [{"kind": "turbulence", "acceleration_rms": 0.01}]],
    }),
    "demo, supervised": ("demo", {"duration": 30}, {}),
    "slow control": ("xuzhou_metro", {"duration": 12, "control_period": 0.2, "supervision.enabled": True}, {}),
    "three units": ("crh380a_gpc:short", {"duration": 10}, {}),
    "ticks in Python": ("xuzhou_metro:disturbed", {
        "duration": 5, "supervision.enabled": True, "links.measurement.delay": 0.15, "observer": "cascaded"}, {}),
}  # fmt: skip
"""Scenario, changes and domain."""
OF_COMPUTATION = {"wall_s", "real_time_factor", "step_time_us_median", "step_time_us_p99", "criteria"}
"""Metrics with another value: wall times, and the criteria, which have no place of the worst coupler here."""


@pytest.mark.parametrize("case", CASES)
def test_every_train_is_that_of_an_environment_of_its_own(case, monkeypatch):
    """Breaks if the common call runs another tick or mixes two trains, or a value, cost or end is of another time."""
    name, changes, over = CASES[case]
    kinds = set()  # the compiled call reads all rows as those of the first one
    noted = lambda row: kinds.add(typeof(row)) or row_numbers(row)  # noqa: E731
    monkeypatch.setattr("train_ato.api.env.vector_env.row_numbers", noted)
    envs = ta.vector_env(name, 3, set=changes, over=over, normalised=True, threads=2)
    observations, _ = envs.reset(seed=5)
    more = {"normalised": True, "flat": True, "observe": tuple(envs.quantities)}
    single = [ta.Env(name, set={**changes, **domain}, **more) for domain in envs.domains]
    for env, seed, seen in zip(single, envs.seeds, observations, strict=True):
        assert np.array_equal(env.reset(seed=seed)[0], seen)
    random, compiled, steps = np.random.default_rng(0), 0, round(changes["duration"] / envs.period)
    for number in range(steps):
        if number % 20 == 0:
            forces = random.uniform(-0.3, 1.0, (3, envs.n_units))
        observations, rewards, ended, _, info = envs.step(forces)
        compiled += sum(train.span is not None for train in envs._trains)
        for index, env in enumerate(single):
            seen, reward, end, _, own = env.step(forces[index])
            assert np.array_equal(seen, observations[index]), (number, index)
            assert (reward, end, own["engaged"]) == (rewards[index], ended[index], info["engaged"][index])
            assert all(info["costs"][cost][index] == value for cost, value in own["costs"].items())
    assert len(kinds) <= 1
    assert ended.all() and (compiled > 1.5 * steps) == (case != "ticks in Python")
    for env, metrics, verdict in zip(single, info["metrics"], info["verdict"], strict=True):
        expected = {name: value for name, value in env.run.metrics.items() if name not in OF_COMPUTATION}
        assert {name: value for name, value in metrics.items() if name not in OF_COMPUTATION} == expected
        assert verdict == env.run.metrics["verdict"]
    envs.close()


def test_the_step_after_an_end_begins_the_next_run():
    """Breaks if an ended train stops the others or keeps its domain, or an equal seed draws another one."""
    with ta.vector_env("xuzhou_metro", 2, set={"duration": 1}, over=MASS, threads=1) as envs:
        first, _ = envs.reset(seed=[3, 9])
        domains, seeds = envs.domains, envs.seeds
        ends = [envs.step(np.full((2, 1), 1e5))[2].tolist() for _ in range(20)]
        assert ends == [[False] * 2] * 19 + [[True] * 2] and envs.domains == domains
        again, rewards, ended, truncated, info = envs.step(np.full((2, 1), 1e5))
        assert not (ended.any() or truncated.any() or rewards.any()) and "metrics" not in info
        assert again[:, 0].tolist() == [0.0, 0.0] and envs.domains != domains and envs.seeds != seeds
        following = envs.seeds
        assert np.array_equal(envs.reset(seed=np.array([3, 9]))[0], first) and envs.domains == domains
        assert envs.reset()[0].shape == first.shape and envs.seeds == following
        low, high = MASS["plant.mismatch.mass_scale"].values()
        assert all(low <= value <= high for domain in (*domains, *envs.domains) for value in domain.values())


def test_the_threads_of_a_vector_end_with_it():
    """Breaks if a thread keeps the environments in use, or waits for a call after their end."""
    others, envs = set(threading.enumerate()), ta.vector_env("xuzhou_metro", 3, set={"duration": 1}, threads=3)
    envs.reset()
    for _ in range(4):
        envs.step(np.zeros((3, 1)))
    own = set(threading.enumerate()) - others
    del envs
    for thread in own:
        thread.join(60)
    assert len(own) == 2 and not any(thread.is_alive() for thread in own)


def test_wrong_uses_of_a_vector_are_refused_in_one_line():
    """Breaks if a wrong force reaches a train, or an impossible vector is made."""
    envs = ta.vector_env("xuzhou_metro", 2, set={"duration": 1})
    for wrong, text in (
        (lambda: envs.step(np.zeros((2, 1))), "call reset"),
        (lambda: ta.vector_env("xuzhou_metro", 0), "num_envs 0"),
        (lambda: ta.vector_env("xuzhou_metro", 2, threads=0), "threads 0"),
        (lambda: ta.vector_env("xuzhou_metro", 2, threads=1.5), "threads 1.5"),
        (lambda: ta.vector_env("xuzhou_metro", 2, observe=("sped",)), "did you mean 'speed'"),
        (lambda: ta.vector_env("xuzhou_metro", 2, over={"plant.mass": [1]}), "plant.mass"),
        (lambda: ta.vector_env("xuzhou_metro", 2, over={"model.delay": [0.1, 1.0]}), "commands_in_flight"),
        (lambda: ta.vector_env("xuzhou_metro", 2, over={"control_period": [0.05, 0.1]}), "same tick and control_per"),
        (lambda: envs.reset(options={"control_period": 0.2}), "same tick and control_period"),
        (lambda: envs.reset(seed=[1]), "1 seeds for 2 trains"),
        (lambda: envs.reset(seed=-1), "seed -1"),
    ):
        with one_line(text):
            wrong()
    envs.reset()
    for forces, text in (([[1.0]], "shape"), ([[1.0], [np.nan]], "not finite"), ("full", "not numbers")):
        with pytest.raises(ValueError, match=text):
            envs.step(forces)
    assert envs.step([[0.0], [0.0]])[0][:, 0].tolist() == [0.05, 0.05]
