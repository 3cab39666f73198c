"""The environment drives the run of the engine step by step, one or many: the same bits, its states, its refusals."""

import copy
import itertools
import pickle
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numba import typeof
from refusals import one_line

import train_ato as ta
from train_ato.api.env.observation import COSTS, DISTANCES
from train_ato.cli.main import main
from train_ato.loop.native_arguments import row_numbers
from train_ato.report.page_data import page_data
from train_ato.report.page_sections import run_sections
from train_ato.report.quantities import traces_of

FREE = {"supervision.enabled": False}
RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    "demo, supervised": ("demo", {"duration": 40}),
    "demo": ("demo", {"duration": 20, **FREE}),
    "metro, supervised": ("xuzhou_metro", {"duration": 20, "supervision.enabled": True}),
    "metro": ("xuzhou_metro", {"duration": 20}),
    "slow control": ("xuzhou_metro", {"duration": 30, "control_period": 0.2}),
    "three units, a shared force": ("crh380a_gpc:short", {"duration": 10}),
    "faults and delays": ("xuzhou_metro:disturbed", {
        "duration": 30, "supervision.enabled": True, "links.measurement.delay": 0.15, "links.command.jitter": 0.05,
        "observer": "cascaded", "faults": [{"topic": "train/measurement", "do": "drop", "begin": 10, "end": 11}]}),
}  # fmt: skip
"""Scenario and changes."""


def commands(run: ta.Run, env: ta.Env) -> np.ndarray:
    """Return the commands of a run at the steps of an environment."""
    return run.recording.command[:: round(env.period / env.setup.tick)]


def assert_same_arrays(one: ta.Run, other: ta.Run) -> None:
    a, b = one.recording.topics, other.recording.topics
    assert a.keys() == b.keys()
    for topic, samples in a.items():
        assert samples.time.tobytes() == b[topic].time.tobytes(), topic
        for name, values in samples.values.items():
            assert values.tobytes() == b[topic][name].tobytes(), (topic, name)


@pytest.mark.parametrize("case", RUNS)
def test_the_commands_of_a_run_give_the_same_run(case):
    """Breaks if the environment calls a stage in another order, twice or not at all, or loses a message."""
    name, changes = RUNS[case]
    recorded = ta.run(name, set=changes, seed=5)
    env = ta.Env(name, set=changes)
    env.reset(seed=5)
    for force in commands(recorded, env):
        _, _, ended, truncated, info = env.step(force)
    assert ended and not truncated
    assert info["metrics"]["verdict"] == recorded.metrics["verdict"] == info["verdict"]
    assert_same_arrays(env.run, recorded)


@pytest.mark.parametrize("places", [14, pytest.param(1000, marks=pytest.mark.campaign)])
def test_a_state_of_a_random_place_continues_bit_for_bit(places):
    """Breaks if a state lacks a part of a stage, shares one with the run that goes on, or cuts a view of an array."""
    random, count = np.random.default_rng(places), 0
    for name, changes in itertools.cycle(RUNS.values()):
        env = ta.Env(name, set=changes, flat=True, normalised=True)
        env.reset(seed=count)
        for _ in range(round(changes["duration"] / env.period) // 8 if places > 99 else 2):
            for _ in range(int(random.integers(1, 8))):
                env.step(random.uniform(-0.5, 1.0, env.n_units))
            state, forces = env.save(), random.uniform(-1.0, 1.0, (3, env.n_units))
            ahead = [_outcome(env.step(force)) for force in forces]
            other = ta.Env(name, set=changes, flat=True, normalised=True)
            seen = other.restore(pickle.loads(pickle.dumps(state)))[0]
            assert [_outcome(other.step(force)) for force in forces] == ahead
            assert_same_arrays(other.run, env.run)
            assert env.restore(state)[0].tobytes() == seen.tobytes()
            count += 1
        if count >= places:
            break


def _outcome(step: Any) -> tuple[Any, ...]:
    observation, reward, ended, _, info = step
    return observation.tobytes(), reward, ended, info["command"].tobytes(), info["brake"]


OTHER = """
import pickle, sys
import train_ato as ta
name, changes, state, forces = pickle.load(sys.stdin.buffer)
env = ta.Env(name, set=changes, flat=True)
env.restore(state)
found = [env.step(force)[0].tobytes() for force in forces]
sys.stdout.buffer.write(pickle.dumps(found))
"""


def test_another_process_continues_a_state():
    """Breaks if a state contains an address, an id or an object of its process."""
    name, changes = RUNS["demo, supervised"]
    changes = {**changes, "observer": "eso"}
    env = ta.Env(name, set=changes, flat=True)
    env.reset(seed=9)
    for _ in range(60):
        env.step(4e5)
    state, forces = env.save(), [3e5, -1e5, 2e5] * 10
    here = [env.step(force)[0].tobytes() for force in forces]
    given = pickle.dumps((name, changes, state, forces))
    there = subprocess.run([sys.executable, "-c", OTHER], input=given, capture_output=True, check=True).stdout
    assert pickle.loads(there) == here


def test_states_do_not_grow_with_the_run():
    """Breaks if a state contains the history of the run."""
    env = ta.Env("xuzhou_metro", set={"duration": 60})
    env.reset()
    sizes = []
    for _ in range(3):
        for _ in range(300):
            env.step(1e5)
        sizes.append(len(env.save().data))
    assert max(sizes[1:]) <= sizes[0] + 100


def test_costs_are_those_of_the_metrics():
    """Breaks if a cost has another unit, another sign or another interval than the metric."""
    changes = {"duration": 50, "criteria.stop_window": 5}
    law = ta.run("demo", set=changes)
    env = ta.Env("demo", set=changes, reward={cost.name: 2.0 for cost in COSTS})
    env.reset()
    sums, total = dict.fromkeys([cost.name for cost in COSTS], 0.0), 0.0
    for force in law.recording.command:
        _, reward, _, _, info = env.step(force)
        total += reward
        for name, cost in info["costs"].items():
            sums[name] += cost
    metrics, recording = info["metrics"], env.run.recording
    assert total == pytest.approx(-2.0 * sum(sums.values()))
    assert sums["energy"] == pytest.approx(metrics["energy_traction_kwh"] - metrics["energy_regenerated_kwh"])
    assert sums["couplers"] == pytest.approx(max(metrics["coupler_draft_max_kn"], -metrics["coupler_buff_max_kn"]))
    error = recording.velocity[:, 0] - recording.reference_velocity
    assert sums["tracking"] == pytest.approx(0.1 * (error**2).sum())
    jerk = np.diff(recording.front_velocity, 2, prepend=[recording.front_velocity[0]] * 1) / 0.01
    assert sums["comfort"] == pytest.approx(0.1 * (jerk**2).sum(), rel=1e-2)
    assert sums["stop"] == pytest.approx(abs(env.run.recording.final[0] - env.setup.profile.position[-1]))


def test_the_observation_is_the_knowledge_of_the_ato():
    """Breaks if an observation is the truth, is of another tick, or lacks the delay of its message."""
    changes = {"duration": 20, "supervision.enabled": True, "links.measurement.delay": 0.25,
               "plant.sensors.velocity_noise": 0.1}  # fmt: skip
    env = ta.Env("xuzhou_metro", set=changes, normalised=True)
    first, _ = env.reset(seed=3)
    seen = [first] + [env.step(0.5)[0] for _ in range(200)]
    measured, sent = env.run["train/measurement"], env.run["ato/command"]
    late = 5
    speed = np.array([obs["speed"][0] for obs in seen])
    assert speed[late:].tolist() == measured["unit_0_speed_m_s"].to_numpy()[: speed.size - late].tolist()
    assert np.array_equal(seen[60]["commands_in_flight"], sent["unit_0_force_n"].to_numpy()[54:60])
    assert seen[60]["supervised_limits"][0] == env.run["atp/speeds"].iloc[15]["permitted_speed_m_s"]
    front = seen[60]["position"][0] + env.setup.model.offsets[0]
    weight = env.setup.model.mass * env.setup.consist.gravity
    gradient = 1e3 * env.setup.model.line_force(front + 200.0) / weight
    assert seen[60]["gradients_ahead"][3] == pytest.approx(gradient, rel=1e-12)
    for name, quantity in env.quantities.items():
        values = np.array([obs[name] for obs in seen])
        assert values.shape[1:] == quantity.low.shape, name
        assert (quantity.low <= values).all() and (values <= quantity.high).all(), name


OWN_LIMITS = [(-1000.0, 80.0), (250.0, 40.0), (320.0, 60.0)]


def own_line(folder: Path) -> str:
    """Return the file of a line with these limits [m, km/h]."""
    rows = "".join(f"\n  - {{at: {at}, speed_kmh: {speed}}}" for at, speed in OWN_LIMITS)
    line = folder / "line.yaml"
    line.write_text(f"schema: train_ato/line/1\nname: own\nbegin: -1000\nend: 8000\nspeed_limits:{rows}\n")
    return str(line)


def test_a_train_that_will_run_back_sees_its_way_from_the_begin():
    """Breaks if the way to the end is below 0, and the limits ahead are those behind, until the reference moves."""
    back = {"start": 5000, "phases": [{"cruise_for": 2}, {"accelerate_to": -3}, {"brake_to": 0}]}
    env = ta.Env("xuzhou_metro", set={"profile": back, "plant.start": {}, "plant.reversing": True, "duration": 5})
    obs, _ = env.reset(seed=1)
    places = env.setup.profile.position
    assert obs["distance_to_end"] == pytest.approx(places[0] - places[-1]) and places[0] > places[-1]


def test_limits_ahead_are_those_of_the_line(tmp_path):
    """Breaks if a limit is not that of the whole train, or its place not the distance ahead."""
    changes = {"plant.line": own_line(tmp_path), "duration": 2}
    env = ta.Env("xuzhou_metro", set=changes, observe=("position", "limits_ahead"))
    obs, _ = env.reset()
    vehicle, length = env.setup.consist.vehicles[0], env.setup.consist.length
    for distance, found in zip(DISTANCES, obs["limits_ahead"], strict=True):
        front = obs["position"][0] + env.setup.model.offsets[0] + distance + vehicle.length / 2
        ends = [at for at, _ in OWN_LIMITS[1:]] + [np.inf]
        rear, rows = front - length, zip(OWN_LIMITS, ends, strict=True)
        over = [speed for (at, speed), end in rows if at <= front and end > rear]
        assert found == pytest.approx(min(over) / 3.6), distance


@pytest.mark.parametrize("assured", [True, False])
def test_the_supervisor_brakes_in_spite_of_the_caller(assured, tmp_path):
    """Breaks if the force of the caller reaches the train against the supervisor, or ``info`` does not say so."""
    changes = {"supervision.enabled": True, "supervision.assurance": assured, "plant.line": own_line(tmp_path)}
    names = ("speed", "brakes", "ato_engaged", "supervised_limits")
    env = ta.Env("xuzhou_metro", set={"duration": 45, **changes}, normalised=True, observe=names)
    env.reset()
    for _ in range(800):
        obs, _, _, _, info = env.step(1.0)
        assert obs["speed"][0] < obs["supervised_limits"][3]
        if not info["engaged"]:
            break
    if assured:
        assert info["takeover"] and info["brake"] == "none" and info["interventions"] == 0
    else:
        assert (info["reason"], info["brake"], info["interventions"]) == ("supervisor", "service brake", 1)
        assert obs["brakes"].tolist() == [1.0, 1.0, 0.0] and info["ato_state"] != "engaged"
    assert obs["ato_engaged"][0] == 0.0
    speed = obs["speed"][0]
    for _ in range(100):
        obs, _, _, _, info = env.step(1.0)
    assert obs["speed"][0] < speed - 1.0


def test_the_caller_drives_again_after_a_takeover(tmp_path, without_figure):
    """Breaks if the force of the caller is lost at the return of the law, or the saved or present run is another."""
    changes = {"duration": 60, "supervision.enabled": True, "plant.line": own_line(tmp_path)}
    env = ta.Env("xuzhou_metro", set=changes, normalised=True)
    env.reset()
    env.step(1.0)
    half, engaged, end = env.run, [True], False
    while not end:
        force = 1.0 if all(engaged) else -0.02
        *_, end, _, info = env.step(force)
        engaged.append(info["engaged"])
    back = engaged.index(True, engaged.index(False))
    assert all(engaged[back:]) and len(engaged) > back + 20
    assert half.metrics["interruption"] == "the environment is after 1 of 1200 ticks"
    assert half.recording.topics["train/measurement"].time.size == 1, "the tick that has begun is not of the run"
    assert [run.metrics["ticks"] for run in (half, env.run)] == [1, 1200] and env.run is env.run
    env.run.save(tmp_path / "run")
    assert main(["verify", str(tmp_path / "run")]) == 0


def test_options_and_seeds_of_a_reset():
    """Breaks if an option stays for the next run, or equal seeds give other runs."""
    env = ta.Env("xuzhou_metro:disturbed", set={"duration": 10}, flat=True, seed=11)

    def rolled(**given: Any) -> tuple[int, bytes]:
        first, _ = env.reset(**given)
        return env.setup.scenario.seed, b"".join([first.tobytes(), *(env.step(1e5)[0].tobytes() for _ in range(30))])

    first, drawn, again = rolled(), rolled(), rolled(seed=11)
    assert first == again and first[0] == 11
    assert drawn == rolled() and drawn[0] != 11 and drawn[1] != first[1]
    assert rolled(seed=11, options={"duration": 5})[1] != b"" and env.setup.ticks == 100
    assert rolled(seed=11) == first and env.setup.ticks == 200


@pytest.mark.parametrize(("force", "text"), [
    ([np.nan], "not finite"), (np.inf, "not finite"), ([1.0, 2.0], r"shape \(2,\); give \(1,\)"),
    ([[1.0]], "shape"), ("full", "not a number"), (None, "not finite"), ([], "shape"),
    ([10**400], "not a number"),
])  # fmt: skip
def test_a_wrong_force_is_refused_before_the_step(force, text):
    """Breaks if a wrong force reaches the stack, or the run cannot go on after the refusal."""
    env = ta.Env("xuzhou_metro", set={"duration": 5})
    env.reset()
    with one_line(text):
        env.step(force)
    assert env.step(0.0)[4]["time"] == pytest.approx(0.05)


def test_wrong_uses_are_refused_in_one_line():
    """Breaks if a step outside of a run, a foreign state, or an unknown name is accepted."""
    env = ta.Env("xuzhou_metro", set={"duration": 1})
    other = ta.Env("xuzhou_metro", set={"duration": 2})
    for wrong, text in (
        (lambda: env.step(0.0), "call reset"), (env.save, "call reset"), (lambda: env.run, "call reset"),
        (lambda: env.reset(seed=-1), "seed -1"), (lambda: env.reset(seed=1.5), "seed 1.5"),
        (lambda: env.reset(options={"durration": 3}), "durration"),
        (lambda: ta.Env("xuzhou_metro", observe=("sped",)), "did you mean 'speed'"),
        (lambda: ta.Env("xuzhou_metro", observe="speed"), "observe 'speed': give names in a list"),
        (lambda: ta.Env("xuzhou_metro", observe=(), flat=True), r"observe \(\): give names"),
        (lambda: ta.Env("xuzhou_metro", reward=["energy"]), "give weights by name"),
        (lambda: ta.Env("xuzhou_metro", reward={"energy": "1"}), "weight '1' is not finite"),
        (lambda: ta.Env("xuzhou_metro", observe={"speed"}), "give names in a list"),
        (lambda: ta.linearise("xuzhou_metro", speed_kmh="60"), "speed_kmh '60'"),
        (lambda: ta.linearise("xuzhou_metro", speed_kmh=True), "speed_kmh True"),
        (lambda: ta.linearise("xuzhou_metro", speed_kmh=60).response([0.0, 1.0]), "frequencies"),
        (lambda: ta.linearise("xuzhou_metro", speed_kmh=60).response("a"), "frequencies"),
        (lambda: ta.run("xuzhou_metro", on_tick=3), "on_tick 3: give a function"),
        (lambda: env.reset(options={"duration": 5}, seed=-1), "seed -1"),
        (lambda: ta.Env("xuzhou_metro", reward={"enrgy": 1.0}), "did you mean 'energy'"),
        (lambda: ta.Env("xuzhou_metro", reward={"energy": np.nan}), "not finite"),
        (lambda: env.restore(3), "not a state"),
    ):  # fmt: skip
        with one_line(text) as caught:
            wrong()
        assert isinstance(caught.value, ta.InputError), text
    assert env.setup.ticks == 20
    env.reset()
    other.reset()
    with one_line("force '5' is not a number per unit; give 1"):
        env.step("5")
    for name in ("costs", "verdict", 1, ""):
        with pytest.raises(ValueError, match=f"{name!r} is (a name of info|no text)"):
            env.step(0.0, signals={name: 1.0})
    with pytest.raises(ValueError, match=r"another scenario.*duration"):
        other.restore(env.save())
    for _ in range(20):
        env.step(0.0)
    with pytest.raises(ValueError, match="has ended"):
        env.step(0.0)
    with pytest.raises(ValueError, match="damaged"):
        env.restore(replace(env.save(), data=b""))
    with pytest.raises(TypeError, match="save"):
        copy.deepcopy(env)
    env.restore(other_state := env.save())
    with pytest.raises(ValueError, match="has ended"):
        env.step(0.0)
    assert other_state.seed == env.setup.scenario.seed


def test_the_caller_may_write_into_all_that_a_step_returns():
    """Breaks if the log has what the caller wrote into ``info["command"]`` or into an observation."""
    commands = []
    for added in (0.0, 5.0):
        env = ta.Env("xuzhou_metro", set={"duration": 1})
        env.reset()
        ended = False
        while not ended:
            observation, _, ended, _, info = env.step(1e4)
            for values in (info["command"], *observation.values()):
                values += added
        commands.append(env.run["ato/command"])
    pd.testing.assert_frame_equal(*commands)


def test_own_signals_are_in_the_log_and_verified(tmp_path, capsys):
    """Breaks if a signal is in another tick, changes the run, or is missing in the report or in the repeated run."""

    def ahead(obs: dict[str, np.ndarray]) -> dict[str, float]:
        return {"ahead": obs["position_error"][0]}

    run, plain = ta.run("demo", set={"duration": 12}, on_tick=ahead), ta.run("demo", set={"duration": 12})
    assert_same_arrays(run, plain)
    time, found = run.recording.reported("signals", "ahead")
    error = run.recording.position[:, 0] + run.setup.model.offsets[0] - run.recording.reference_position
    assert time.tolist() == run.recording.time.tolist() and found == pytest.approx(error, abs=1e-9)
    assert main(["verify", str(run.save(tmp_path / "run"))]) == 0
    env = ta.Env("xuzhou_metro", set={"duration": 1})
    env.reset()
    for step in range(20):
        info = env.step(0.0, signals={"my_signal": step})[4]
    assert info["my_signal"] == 19
    assert env.run.recording.reported("signals", "my_signal")[1].tolist() == [float(step) for step in range(20)]
    assert main(["verify", str(env.run.save(tmp_path / "env"))]) == 0
    for told, name, values in ((run, "ahead", found), (env.run, "my_signal", np.arange(20.0))):
        data = page_data(told.recording)
        assert data.curves["signals"].columns[f"signal:{name}"] == pytest.approx(values)
        assert [trace.look.words for trace in traces_of(data.curves["signals"].columns)] == [name]
        assert [part.anchor for part in run_sections(data)[0]].count("signals") == 1
    assert "signals" not in page_data(plain.recording).curves | page_data(plain.recording).left_out
    assert capsys.readouterr().out.count("bit for bit") == 2


def test_a_run_ends_when_its_caller_says_so():
    """Breaks if the run goes on, loses its last tick, or counts as done or as an error."""
    run = ta.run("demo", stop_when=lambda obs: obs["time"][0] > 2.95)
    assert (run.metrics["status"], run.metrics["ticks"]) == ("interrupted", 31)
    assert run.metrics["interruption"] == "stop_when ended it after 31 of 8000 ticks"


@pytest.mark.parametrize(("on_tick", "text"), [
    (lambda obs: 1 / 0, r"ZeroDivisionError: division by zero, .*test_env.py:\d+"),
    (lambda obs: [1.0], "not numbers by name"), (lambda obs: {"x": "y"}, "not numbers by name"),
    (lambda obs: {"x": np.zeros(2)}, "not numbers by name"), (lambda obs: {"x": 10**400}, "not numbers by name"),
])  # fmt: skip
def test_a_failure_of_on_tick_is_named(on_tick, text):
    """Breaks if the failure names a law, or the record up to it is lost."""
    with pytest.raises(ta.RunFailed, match=f"node on_tick failed: .*{text}") as failed:
        ta.run("demo", set={"duration": 5}, on_tick=on_tick)
    assert failed.value.run.metrics["status"] == "failed"
    with pytest.raises(ValueError, match="mode 'composed': on_tick"):
        ta.run("demo", mode="composed", on_tick=on_tick)


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
    numbers = ([[1.0]], "shape"), ([[1.0], [np.nan]], "not finite"), ([[1.0], [10**400]], "not numbers")
    for forces, text in (*numbers, ("full", "not numbers"), ([["1"], ["2"]], "not numbers")):
        with pytest.raises(ValueError, match=text):
            envs.step(forces)
    assert envs.step([[0.0], [0.0]])[0][:, 0].tolist() == [0.05, 0.05]
