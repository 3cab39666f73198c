"""What is done to a running train from outside: from which tick it acts, what it does, how the log tells of it."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from plant_sim.air_brake import ATMOSPHERE
from plant_sim.consist import Consist
from plant_sim.disturbances import Gust
from plant_sim.emergency import EmergencyBrake
from plant_sim.line import Line
from plant_sim.outside_forces import OutsideForces
from plant_sim.plant_setup import PlantSetup
from train_ato.engine import run_engine
from train_ato.interventions import (
    KEY,
    DelayJumpNow,
    EmergencyBrakeNow,
    GustNow,
    as_text,
    from_text,
    made,
    planned_for,
)
from train_ato.record.reading import read_log
from train_ato.roles.controller import ControllerRole
from train_ato.roles.observer import ObserverRole
from train_ato.roles.plant import PlantRole
from train_ato.roles.profile import ProfileRole
from train_ato.roles.trajectories import profile_of
from train_ato.run_setup import prepare
from train_ato.scenario import load

SECOND = 1_000_000_000


def demo(*assignments):
    return prepare(*load("demo", ("duration=90", *assignments)))


def with_planned(setup, *entries):
    """Return the same run with interventions, each as (stamp, intervention)."""
    planned = tuple(planned_for(stamp, entry) for stamp, entry in entries)
    return dataclasses.replace(setup, scenario=setup.scenario.model_copy(update={"interventions": planned}))


def gust(acceleration, duration, ramp=1.0):
    return GustNow(acceleration=acceleration, duration=duration, ramp=ramp)


def last_speeds(outcome):
    return outcome.history.velocity[:, 0]


class Loop:
    """The roles of a run, tick by tick, with what the plant reports."""

    def __init__(self, setup):
        self.plant, self.profile = PlantRole(setup), ProfileRole(setup)
        self.observer, self.controller = ObserverRole(setup), ControllerRole(setup)
        self.controller.set_profile(profile_of(self.profile.start()[0][1]))
        self.reports = []
        self.seen = {}

    def tick(self):
        seen = self.plant.observe()
        self.seen = dict(seen)
        self.reports += [message for topic, message in seen if topic == "/diagnostics"]
        measurement = seen[-1][1]
        reference = self.profile.answer(measurement)[-1][1]
        estimate = self.observer.answer(measurement)[-1][1]
        command, pipe, _ = self.controller.step(measurement, reference, estimate)
        self.plant.act(command, pipe)

    def until(self, stamp):
        while self.plant.stamp < stamp:
            self.tick()

    @property
    def speed(self):
        return float(np.abs(self.plant.train.velocity).max())


def test_a_gust_from_outside_is_the_gust_of_a_scenario():
    """Breaks if it begins a tick late, lasts another time, or leaves a force behind when it is over."""
    blown = run_engine(with_planned(demo(), (30 * SECOND, gust(-0.02, 12.0, 2.0))))
    planned = "plant.disturbances=[{kind: gust, begin: 30, end: 42, ramp: 2, acceleration: -0.02}]"
    written = run_engine(demo(planned))
    assert blown.failure is None
    np.testing.assert_array_equal(last_speeds(blown), last_speeds(written))
    assert np.abs(last_speeds(blown) - last_speeds(run_engine(demo()))).max() > 0.05


def test_a_delay_jump_from_outside_is_the_jump_of_a_scenario():
    """Breaks if the jump reaches commands already under way, or is forgotten."""
    sudden = run_engine(with_planned(demo(), (40 * SECOND, DelayJumpNow(factor=1.5, add=0.4))))
    written = run_engine(demo("links.command.jump={at: 40, factor: 1.5, add: 0.4}"))
    np.testing.assert_array_equal(last_speeds(sudden), last_speeds(written))
    assert not np.array_equal(last_speeds(sudden), last_speeds(run_engine(demo())))


def test_what_is_not_asked_for_costs_no_message():
    """Breaks if a run without interventions reports more than one without the feature."""
    setup = demo()
    plain = run_engine(setup)
    acted = run_engine(with_planned(setup, (int(30.1 * SECOND), gust(0.0, 1.0))))
    assert acted.published["/diagnostics"] == plain.published["/diagnostics"] + 1


def test_emergency_brake_stops_the_train_whatever_the_law_commands():
    """Breaks if the law's force still acts, the pipe is not vented, or the brake lets go by itself at standstill."""
    loop = Loop(demo("duration=600"))
    loop.until(60 * SECOND)
    assert loop.speed > 1.0
    loop.plant.request(EmergencyBrakeNow())
    loop.tick()
    assert loop.reports[-1].message == "emergency brake"
    with pytest.raises(ValueError, match="standstill only; the train runs"):
        loop.plant.request(EmergencyBrakeNow(applied=False))
    loop.until(80 * SECOND)
    assert loop.seen["train/brake_pipe"].pressure == ATMOSPHERE
    assert float(loop.seen["train/brake_cylinders"].shoe_force.sum()) > 3e6
    assert loop.speed < 1e-3
    loop.until(110 * SECOND)
    assert loop.speed < 1e-3
    loop.plant.request(EmergencyBrakeNow(applied=False))
    loop.until(260 * SECOND)
    assert loop.seen["train/brake_pipe"].pressure == 600e3
    assert loop.speed > 1.0


def test_emergency_force_is_that_of_the_units_brake():
    """Breaks if a locomotive brakes with more than its envelope, or a reversing drive is pushed backwards."""
    setup = demo()
    brake = EmergencyBrake(setup.consist, setup.plant)
    assert brake.demand(np.array([20.0]))[0] == pytest.approx(-461e3)
    both = prepare(*load("freight_consensus"))
    reversing = EmergencyBrake(both.consist, both.plant)
    assert (reversing.demand(np.full(5, 20.0)) == -64e3).all()
    assert (reversing.demand(np.full(5, 0.1)) == -80e3 * 0.1).all()
    assert (reversing.demand(np.full(5, -0.1)) == 80e3 * 0.1).all()
    assert (reversing.demand(np.full(5, 0.01)) == 0.0).all()


def test_an_emergency_stop_of_a_reversing_train_never_drives_it_back():
    """Breaks if the full brake force of a drive that can reverse goes on at standstill."""
    setup = prepare(*load("freight_consensus:aligned", ("plant.disturbances=[]", "tick=0.01")))
    outcome = run_engine(with_planned(setup, (5 * SECOND, EmergencyBrakeNow())))
    assert last_speeds(outcome)[round(5 / setup.tick)] > 10.0
    assert outcome.history.velocity[-1] == pytest.approx(0.0, abs=1e-3)
    assert outcome.history.velocity[round(5 / setup.tick) :].min() > -0.05
    assert outcome.history.applied[round(5.1 / setup.tick) :].min() == pytest.approx(-64e3)


def test_gusts_that_are_over_are_forgotten_one_by_one():
    """Breaks if a second gust ends with the first, or a vehicle keeps a column that nothing fills."""
    forces = OutsideForces((), np.full(3, 100.0), 0.5, 1.0, ())
    forces.add(Gust(kind="gust", begin=0.0, end=2.0, ramp=0.0, force=5.0, vehicles=(0,)))
    forces.add(Gust(kind="gust", begin=0.0, end=3.0, ramp=0.0, acceleration=0.1, vehicles=(2,)))
    assert forces.tick(0.0)[0].tolist() == [[5.0, 10.0]] * 2
    assert not forces.drop_over(1.0)
    assert forces.drop_over(2.0)
    assert forces.vehicles.tolist() == [2]
    assert forces.tick(2.0)[0].tolist() == [[10.0]] * 2
    assert forces.drop_over(3.0)
    assert not forces.gusty


def test_a_later_jump_of_mass_keeps_the_weight_of_other_disturbances():
    """Breaks if a gust from outside makes the scenario's disturbances weigh the train again."""
    scenario = (
        "plant.disturbances=[{kind: harmonic, terms: [{acceleration: 0.01, omega: 1}]}]",
        "plant.jumps=[{at: 20, what: mass, factor: 1.3}]",
    )
    calm = run_engine(demo(*scenario))
    stirred = run_engine(with_planned(demo(*scenario), (40 * SECOND, gust(0.0, 5.0))))
    np.testing.assert_array_equal(last_speeds(calm), last_speeds(stirred))


@pytest.mark.parametrize(
    ("kind", "values", "text"),
    [
        (GustNow, {"acceleration": 2.0, "duration": 9.0}, "acceleration 2.0: input should be less than or equal to 1"),
        (GustNow, {"acceleration": float("nan"), "duration": 9.0}, "acceleration nan"),
        (GustNow, {"acceleration": 0.1, "duration": 0.0}, "duration 0.0: input should be greater than 0"),
        (DelayJumpNow, {"factor": -1.0}, "factor -1.0: input should be greater than or equal to 0"),
        (DelayJumpNow, {"add": 1e4}, "add 10000.0: input should be less than or equal to 600"),
        (EmergencyBrakeNow, {"applied": 1}, "applied 1: input should be true or false"),
    ],
)
def test_what_makes_no_sense_is_refused(kind, values, text):
    """Breaks if a value out of range reaches the train."""
    with pytest.raises(ValueError, match=text.replace(".", r"\.")):
        made(kind, **values)


def test_the_log_tells_what_was_done():
    """Breaks if the text in the diagnostics does not give back what was asked for."""
    done = [gust(-0.02, 12.0, 2.0), DelayJumpNow(factor=2.0, add=-0.1), EmergencyBrakeNow()]
    assert from_text(as_text(done)) == done
    assert [entry.described() for entry in done] == [
        "gust: acceleration -0.02, duration 12, ramp 2",
        "delay_jump: factor 2, add -0.1",
        "emergency brake applied",
    ]
    for wrong in ("[]x", '[{"do": "fly"}]', '[{"do": "gust"}]', '{"do": "gust"}', "3"):
        with pytest.raises(ValueError, match="not written by this version"):
            from_text(wrong)


def test_a_scenario_plans_interventions():
    """Breaks if a planned one is not read, not written out with the scenario, or has no time and is taken."""
    setup = demo("interventions=[{at: 30, do: emergency_brake}, {at: 40, do: emergency_brake, applied: false}]")
    outcome = run_engine(setup)
    assert last_speeds(outcome)[-1] > 0.01
    assert "do: emergency_brake" in setup.resolved_yaml()
    with pytest.raises(ValueError, match="one has no 'at'"):
        demo("interventions=[{do: emergency_brake}]")


def test_a_release_planned_for_a_moving_train_waits_for_its_standstill():
    """Breaks if the emergency brake lets go of a train that still moves."""
    held = with_planned(
        demo(), (60 * SECOND, EmergencyBrakeNow()), (60 * SECOND + SECOND, EmergencyBrakeNow(applied=False))
    )
    loop = Loop(held)
    loop.until(85 * SECOND)
    told = [(message.stamp, message.values[KEY]) for message in loop.reports if KEY in message.values]
    assert told[0][0] == 60 * SECOND
    assert 61 * SECOND < told[1][0] < 85 * SECOND
    assert not from_text(told[1][1])[0].applied


rclpy = pytest.importorskip("rclpy")

from train_ato.graph.environment import applied, claim_domain, variables  # noqa: E402
from train_ato.graph.remote import asking  # noqa: E402
from train_ato.record.difference import compare  # noqa: E402
from train_ato.run_folder import RunFolder  # noqa: E402
from train_ato.wire import Wire  # noqa: E402


class Running:
    """``train-ato run`` in a process of its own, on a domain that is known."""

    def __init__(self, folder: Path, domain: int, *arguments: str) -> None:
        self.folder = folder
        self.process = subprocess.Popen(
            [sys.executable, "-m", "train_ato", "run", *arguments, "--domain", str(domain), "--out", str(folder)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def end(self):
        _, errors = self.process.communicate(timeout=120)
        assert self.process.returncode == 0, errors


def free_domain():
    with claim_domain() as domain:
        return domain


def do(domain, *arguments):
    command = [sys.executable, "-m", "train_ato", "do", *arguments, "--domain", str(domain)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


@pytest.mark.slow
@pytest.mark.parametrize("way", [(), ("--processes",)], ids=["composed", "processes"])
def test_a_run_with_interventions_is_driven_again_from_its_log(tmp_path, way):
    """Breaks if an intervention acts on another tick than the log says, in either way of running the nodes."""
    domain = free_domain()
    running = Running(tmp_path / "run", domain, "demo", *way, "--set", "duration=100", "--pace", "1")
    deadline = time.monotonic() + 60
    paused = do(domain, "pause")
    while paused.returncode and time.monotonic() < deadline:
        paused = do(domain, "pause")
    assert paused.returncode == 0, paused.stderr
    assert do(domain, "step").returncode == 0
    blown = do(domain, "gust", "acceleration=0.05", "duration=40", "--json")
    assert "gust: acceleration 0.05, duration 40, ramp 2" in json.loads(blown.stdout)["message"]
    assert do(domain, "delay-jump", "add=0.3").returncode == 0
    with asking(domain) as remote:
        assert remote.set_parameter("plant", "pace", 0.0) is None
        assert remote.set_parameter("plant", "paused", False) is None
    running.end()

    found = [
        (message.stamp, entry)
        for _, _, message in read_log(running.folder, Wire(demo().shape).decode, ("/diagnostics",))
        if KEY in message.values
        for entry in from_text(message.values[KEY])
    ]
    assert [entry for _, entry in found] == [gust(0.05, 40.0, 2.0), DelayJumpNow(add=0.3)]
    setup = demo("duration=100")
    again = RunFolder.make(tmp_path / "again", "again")
    with again.sink(setup) as sink:
        run_engine(with_planned(setup, *found), sink=sink)
    assert compare(running.folder, again.path, Wire(setup.shape)).differing == 0


def test_refusals_name_their_reason(tmp_path):
    """Breaks if a wrong strength, a step while running or an unknown run is accepted or ends in a traceback."""
    domain = free_domain()
    assert "no run holds it" in do(domain, "gust").stderr
    with claim_domain(domain), applied(variables(domain, tmp_path)):
        from train_ato.graph.composed import run_composed
        from train_ato.graph.run_end import GraphOptions

        ends = []
        folder = tmp_path / "run"
        folder.mkdir()
        options = GraphOptions(pace=2.0)
        work = threading.Thread(
            target=lambda: ends.append(run_composed(demo("duration=3600"), folder, domain, options)), daemon=True
        )
        work.start()
        with asking(domain) as remote:
            assert remote.set_parameter("plant", "gust.duration", -1.0) is not None
            success, reason = remote.call("plant/step")
            assert not success
            assert "pause first" in reason
            assert remote.call("plant/pause", True)[0]
            assert remote.call("plant/step")[0]
            assert remote.call("plant/emergency_brake", True)[0]
            assert remote.call("plant/stop")[0]
        work.join(timeout=30)
    assert ends
    assert ends[0].failure is None
    assert "takes no" in do(domain, "pause", "hard=1").stderr
    assert "name=number" in do(domain, "gust", "duration=long").stderr


def test_the_pace_holds_lockstep_back_and_lets_it_go(tmp_path):
    """Breaks if a slow pace does not hold a tick back, or a changed one is not taken until the next tick."""
    domain = free_domain()
    with claim_domain(domain), applied(variables(domain, tmp_path)):
        from train_ato.graph.composed import run_composed
        from train_ato.graph.run_end import GraphOptions

        ends, ticks = [], []
        folder = tmp_path / "run"
        folder.mkdir()
        setup = demo()
        work = threading.Thread(
            target=lambda: ends.append(run_composed(setup, folder, domain, GraphOptions(pace=1e-4), ticks.append)),
            daemon=True,
        )
        work.start()
        with asking(domain) as remote:
            assert remote.set_parameter("plant", "gust.duration", 5.0) is None
            held = max(ticks, default=0)
            assert remote.set_parameter("plant", "pace", 0.0) is None
        work.join(timeout=60)
    assert held <= 1
    assert ends[0].failure is None
    assert ends[0].ticks == setup.ticks


def test_a_metro_is_stopped_by_its_own_brake_alone():
    """Breaks if a train without an air brake cannot be stopped, or its pipe is asked for."""
    setup = prepare(*load("xuzhou_metro", ("duration=120",)))
    outcome = run_engine(with_planned(setup, (60 * SECOND, EmergencyBrakeNow())))
    assert outcome.failure is None
    assert last_speeds(outcome)[round(59 / setup.tick)] > 20.0
    assert abs(last_speeds(outcome)[-1]) < 1e-6
    assert outcome.history.applied.min() == pytest.approx(-230.6e3, rel=1e-6)


def test_train_and_line_that_are_empty_of_units_take_an_emergency_brake():
    """Breaks if a train without power units cannot be braked in an emergency."""
    consist = Consist.model_validate(
        {
            "schema": "train_ato/consist/1",
            "name": "wagons",
            "vehicle_types": {"car": {"mass": 1e5, "length": 10.0, "resistance": {"n": (1e3, 0.0, 0.0)}}},
            "train": ({"type": "car", "count": 2},),
            "draft_gears": {"spring": {"kind": "linear", "stiffness": 1e6}},
            "default_gear": "spring",
        }
    )
    assert Line.model_validate({"schema": "train_ato/line/1", "name": "level", "end": 1000.0}).end == 1000.0
    assert EmergencyBrake(consist, PlantSetup()).demand(np.zeros(0)).shape == (0,)
