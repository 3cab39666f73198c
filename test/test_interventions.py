"""Interventions in a running train: first tick, effect and entry in the log."""

import dataclasses
import json
import threading
from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest
from engine_runs import compared, record_run, setup_of
from programs import begun, python
from waiting import LIMIT_S, reserved_domain, wait_for

import train_ato
from plant_sim import kernel as k
from plant_sim.air_brake import ATMOSPHERE
from plant_sim.disturbances import Gust, OutsideForces
from train_ato.api.scenario_choice import choose_scenario
from train_ato.cli.info import _value
from train_ato.log.reading import read_log
from train_ato.loop.controller import ControllerStage
from train_ato.loop.engine import run_engine
from train_ato.loop.observer import ObserverStage
from train_ato.loop.plant import PlantStage
from train_ato.loop.profile import ProfileStage
from train_ato.messages.types import Command
from train_ato.profile.profile import profile_of
from train_ato.scenario.interventions import (
    KEY,
    DelayJumpNow,
    EmergencyBrakeNow,
    GustNow,
    MessageFreezeNow,
    MessageLossNow,
    TrainJumpNow,
    interventions_from_json,
    interventions_to_json,
    make_intervention,
    planned_for,
)
from train_ato.scenario.setup import without_effect

SECOND = 1_000_000_000
UNSUPERVISED = "supervision.enabled=false"


def demo(*assignments):
    return setup_of("demo", "duration=90", *assignments)


def with_planned(setup, *entries):
    """Return the same run with interventions, each as (stamp, intervention)."""
    planned = tuple(planned_for(stamp, entry) for stamp, entry in entries)
    return dataclasses.replace(setup, scenario=setup.scenario.model_copy(update={"interventions": planned}))


def gust(acceleration, duration, ramp=1.0):
    return GustNow(acceleration=acceleration, duration=duration, ramp=ramp)


def last_speeds(outcome):
    return outcome.recording.velocity[:, 0]


class Loop:
    """Stages of a run, tick by tick, with the reports of the plant."""

    def __init__(self, setup):
        self.plant, self.profile = PlantStage(setup), ProfileStage(setup)
        self.observer, self.controller = ObserverStage(setup), ControllerStage(setup)
        self.controller.set_profile(profile_of(self.profile.start().profile))
        self.reports = []
        self.seen = {}

    def tick(self):
        seen = self.plant.observe()
        self.seen = dict(seen.published())
        if seen.diagnostics is not None:
            self.reports.append(seen.diagnostics)
        reference = self.profile.on_measurement(seen.measurement).reference
        estimate = self.observer.on_measurement(seen.measurement).estimate
        self.controller.receive(seen.measurement, reference, estimate)
        messages = self.controller.command()
        self.plant.act(messages.command, messages.brake_pipe_command)

    def until(self, stamp):
        while self.plant.stamp < stamp:
            self.tick()

    @property
    def speed(self):
        return float(np.abs(self.plant.train.velocity).max())


@pytest.mark.parametrize(("entry", "written"), [
    (MessageLossNow(duration=3.0), "faults=[{do: drop, topic: ato/command, begin: 20, end: 23}]"),
    (MessageFreezeNow(topic="atp/brake_release", duration=3.0),
     "faults=[{do: freeze, topic: atp/brake_release, begin: 20, end: 23}]"),
    (MessageFreezeNow(topic="train/measurement", duration=3.0), "plant.sensors.freeze=[{begin: 20, end: 23}]"),
    (TrainJumpNow(what="gain", factor=0.5), "plant.jumps=[{at: 20, what: gain, factor: 0.5}]"),
    (TrainJumpNow(what="brake", factor=0.5), "plant.jumps=[{at: 20, what: brake, factor: 0.5}]"),
    (gust(-0.02, 12.0, 2.0), "plant.disturbances=[{kind: gust, begin: 20, end: 32, ramp: 2, acceleration: -0.02}]"),
    (DelayJumpNow(factor=1.5, add=0.4), "links.command.jump={at: 20, factor: 1.5, add: 0.4}"),
], ids=["loss", "freeze", "frozen measurement", "drives", "brakes", "gust", "delay"])  # fmt: skip
def test_a_fault_from_outside_is_the_fault_of_a_scenario(entry, written):
    """Breaks if a fault on request begins or ends at another tick than a planned one, or has another strength."""
    metro = partial(setup_of, "xuzhou_metro", "supervision.enabled=true", "duration=45")
    sudden, planned = run_engine(with_planned(metro(), (20 * SECOND, entry))), run_engine(metro(written))
    np.testing.assert_array_equal(last_speeds(sudden), last_speeds(planned))
    assert sudden.changes.rows()[0]["name"] == entry.do
    assert sudden.failure is None or entry.do not in ("gust", "delay_jump")
    if entry != MessageFreezeNow(topic="atp/brake_release", duration=3.0) and getattr(entry, "what", "") != "brake":
        assert not np.array_equal(last_speeds(sudden), last_speeds(run_engine(metro())))


def test_what_is_not_asked_for_costs_no_message():
    """Breaks if an intervention adds more or less than one message to the diagnostics."""
    setup = demo()
    plain = run_engine(setup)
    acted = run_engine(with_planned(setup, (int(30.1 * SECOND), gust(0.0, 1.0))))
    assert acted.published["/diagnostics"] == plain.published["/diagnostics"] + 1


def test_emergency_brake_stops_the_train_whatever_the_law_commands():
    """Breaks if the force of the law still acts, the drives brake, the pipe is not vented, or it releases itself."""
    loop = Loop(demo("duration=600", UNSUPERVISED))
    with pytest.raises(ValueError, match="no emergency brake was requested; that of the supervisor"):
        loop.plant.request(EmergencyBrakeNow(applied=False))
    loop.until(60 * SECOND)
    assert loop.speed > 1.0
    loop.plant.request(EmergencyBrakeNow())
    loop.tick()
    loop.tick()
    assert loop.reports[-1].message == "emergency brake"
    with pytest.raises(ValueError, match="standstill only; the train runs"):
        loop.plant.request(EmergencyBrakeNow(applied=False))
    loop.until(80 * SECOND)
    assert loop.seen["train/brake_pipe"].pressure == ATMOSPHERE
    assert float(loop.seen["train/brake_shoes"].shoe_force.sum()) > 3e6
    assert abs(loop.seen["train/measurement"].applied).max() < 1.0 and loop.speed < 1e-3
    loop.until(110 * SECOND)
    assert loop.speed < 1e-3
    loop.plant.request(EmergencyBrakeNow(applied=False))
    loop.until(260 * SECOND)
    assert loop.seen["train/brake_pipe"].pressure == 600e3 and loop.speed > 1.0


def test_gusts_that_are_over_are_forgotten_one_by_one():
    """Breaks if a second gust ends with the first, a vehicle keeps a column that nothing fills, or spans miss one."""
    forces = OutsideForces((), np.full(3, 100.0), 500_000_000, SECOND, ())
    forces.add(Gust(kind="gust", begin=0.0, end=2.0, ramp=0.0, force=5.0, vehicles=(0,)))
    forces.add(Gust(kind="gust", begin=0.0, end=3.0, ramp=0.0, acceleration=0.1, vehicles=(2,)))
    assert forces.tick(0, np.zeros(3))[0].tolist() == [[5.0, 10.0]] * 2
    ahead, _, means = forces.ahead(0, 2)
    assert ahead[:, 0].tolist() == [[[5.0, 10.0]] * 2] * 2 and means[:, 0].tolist() == [[5.0, 10.0]] * 2
    assert not forces.drop_over(1.0) and forces.drop_over(2.0) and forces.vehicles.tolist() == [2]
    assert forces.tick(2 * SECOND, np.zeros(3))[0].tolist() == [[10.0]] * 2
    assert forces.drop_over(3.0) and not forces.added_gusts


def test_a_later_jump_of_mass_keeps_the_weight_of_other_disturbances():
    """Breaks if a gust after a jump of the mass changes the mass for the planned disturbances."""
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
        (
            GustNow,
            {"acceleration": 0.1, "duration": 0.0},
            "duration 0.0: input should be greater than or equal to 0.000001",
        ),
        (DelayJumpNow, {"factor": -1.0}, "factor -1.0: input should be greater than or equal to 0"),
        (DelayJumpNow, {"add": 1e4}, "add 10000.0: input should be less than or equal to 600"),
        (EmergencyBrakeNow, {"applied": 1}, "applied 1: input should be true or false"),
    ],
)
def test_what_makes_no_sense_is_refused(kind, values, text):
    """Breaks if an invalid value affects the train."""
    with pytest.raises(ValueError, match=text.replace(".", r"\.")):
        make_intervention(kind, **values)


def test_the_log_tells_what_was_done():
    """Breaks if the text in the diagnostics does not reproduce the requested interventions."""
    done = [gust(-0.02, 12.0, 2.0), DelayJumpNow(factor=2.0, add=-0.1), EmergencyBrakeNow()]
    assert interventions_from_json(interventions_to_json(done)) == done
    assert [entry.described() for entry in done] == [
        "gust: acceleration -0.02, duration 12, ramp 2",
        "delay_jump: factor 2, add -0.1",
        "emergency brake applied",
    ]
    for wrong in ("[]x", '[{"do": "fly"}]', '[{"do": "gust"}]', '{"do": "gust"}', "3"):
        with pytest.raises(ValueError, match="not written by this version"):
            interventions_from_json(wrong)


def test_a_scenario_plans_interventions():
    """Breaks if a planned intervention is lost, is missing in the resolved scenario, or is accepted without a time."""
    release = "interventions=[{at: 30, do: emergency_brake}, {at: 40, do: emergency_brake, applied: false}]"
    setup = demo(release, UNSUPERVISED)
    outcome = run_engine(setup)
    assert last_speeds(outcome)[-1] > 0.01 and "do: emergency_brake" in setup.resolved_yaml()
    with pytest.raises(ValueError, match="an entry has no 'at'"):
        demo("interventions=[{do: emergency_brake}]")


def test_a_release_planned_for_a_moving_train_waits_for_its_standstill():
    """Breaks if the emergency brake of a moving train can be released."""
    held = with_planned(
        demo(UNSUPERVISED), (60 * SECOND, EmergencyBrakeNow()), (60 * SECOND + SECOND, EmergencyBrakeNow(applied=False))
    )
    loop = Loop(held)
    loop.until(85 * SECOND)
    told = [(message.stamp, message.values[KEY]) for message in loop.reports if KEY in message.values]
    assert told[0][0] == 60 * SECOND and 61 * SECOND < told[1][0] < 85 * SECOND
    assert not interventions_from_json(told[1][1])[0].applied


@pytest.mark.parametrize(
    ("entry", "what"),
    [
        ("law_changes=[{at: 2, law: smc}, {at: 9, law: pid}]", "law_changes.1: ... change at 9"),
        ("interventions=[{at: 5, do: gust, duration: 1, acceleration: 0.1}]", "interventions.0: ... intervention at 5"),
        ("ato_requests=[{at: 7.5, do: engage}]", "ato_requests.0: ... request at 7.5"),
        ("faults=[{topic: ato/command, do: drop, begin: 8}]", "faults.0: ... fault at 8"),
        ("faults=[{node: observer, do: kill, at: 6}]", "faults.0: ... fault at 6"),
        ("plant.jumps=[{what: lag, factor: 0.5, at: 20}]", "plant.jumps.0: ... jump at 20"),
        ("plant.disturbances=[{kind: gust, begin: 8, end: 9, shift: 1}]", "plant.disturbances.0: ... disturbance at 9"),
        ("plant.disturbances=[{kind: gust, begin: 8, end: 9, shift: -4}]", ""),
        ("plant.sensors.freeze=[{begin: 6, end: 7}]", "plant.sensors.freeze.0: ... freeze at 6"),
        ("plant.sensors.wheel_slip=[{slip: 0.1, begin: 6, end: 7}]", "plant.sensors.wheel_slip.0: ... slip at 6"),
        ("links.command.jump={at: 6, factor: 2}", "links.command.jump: ... jump at 6"),
        ("plant.jumps=[{what: lag, factor: 0.5, place: 9000}]", ""),
        ("interventions=[{at: 4.9, do: gust, duration: 1, acceleration: 0.1}]", ""),
        ("profile={phases: null, plan: {end: 900}, limits: {jerk: 0.1}}", ""),
        ("profile={phases: null, plan: {end: 900}, append: [{cruise_for: 1}], limits: {acceleration: 1}}", ""),
        (
            "profile={phases: null, plan: {end: 900}, limits: {deceleration: 0.1}}",
            "profile.limits.deceleration: it has no effect on a plan; write profile.plan.deceleration",
        ),
        (
            "profile={phases: null, plan: {end: 900}, start: 50, append: [{cruise_for: 1}], limits: {acceleration: 1}}",
            "profile.start: it has no effect on a plan; write profile.plan.begin, a place of the front",
        ),
    ],
)
def test_an_entry_after_the_end_of_the_run_has_a_line(entry: str, what: str, capsys) -> None:
    """Breaks if a planned entry has no effect without a word, or one in time has a line."""
    text = without_effect(setup_of("demo", "duration=5", entry).scenario)
    what = what.replace("...", "the run ends at 5 s, before the")
    assert text == (
        what if "a plan" in what else what and f"{what} s; lengthen duration or remove the {what.split()[-3]}"
    )
    choose_scenario("demo").assigned(["duration=5", entry]).prepare()
    assert capsys.readouterr().err == (text and f"note: demo: {text}\n"), "from Python, and in sweeps"


rclpy = pytest.importorskip("rclpy")

from train_ato.messages.codec import Wire  # noqa: E402
from train_ato.ros.graph.environment import applied, claim_domain, variables  # noqa: E402
from train_ato.ros.graph.remote import graph_client  # noqa: E402


def do(domain, *arguments):
    return python("-m", "train_ato", "inject", *arguments, f"--domain={domain}")


@pytest.mark.campaign
@pytest.mark.parametrize("way", [(), ("--processes",)], ids=["composed", "processes"])
def test_a_run_with_interventions_is_driven_again_from_its_log(tmp_path, way):
    """Breaks if an intervention acts on another tick than in the log, in one process or several."""
    domain, run = reserved_domain(), tmp_path / "run"
    running = begun("run", "demo", *way, "--set=duration=100", "--rate=1", f"--domain={domain}", f"--out={run}")
    wait_for(lambda: do(domain, "pause").returncode == 0, "the run")
    assert do(domain, "step").returncode == 0
    blown = do(domain, "gust", "acceleration=0.05", "duration=40", "--json")
    assert "gust: acceleration 0.05, duration 40, ramp 2" in json.loads(blown.stdout)["message"]
    assert do(domain, "delay-jump", "add=0.3").returncode == 0
    assert do(domain, "drop", "topic=ato/command", "duration=2").returncode == 0
    assert do(domain, "cut-out", "factor=0.5").returncode == 0
    assert "is none of" in do(domain, "freeze", "topic=ato/profile").stderr
    assert "adhesion, which is missing" in do(domain, "adhesion").stderr
    with graph_client(domain) as remote:
        assert remote.set_parameter("plant", "rate", 0.0) is None
        assert remote.set_parameter("plant", "paused", False) is None
    _, errors = running.communicate(timeout=LIMIT_S)
    assert running.returncode == 0, errors
    found = [
        (message.stamp, entry)
        for _, _, message in read_log(run, Wire(demo().layout).decode, ("/diagnostics",))
        if message.node == "plant" and KEY in message.values
        for entry in interventions_from_json(message.values[KEY])
    ]
    assert [entry for _, entry in found] == [
        gust(0.05, 40.0, 2.0), DelayJumpNow(add=0.3), MessageLossNow(duration=2.0),
        TrainJumpNow(what="gain", factor=0.5),
    ]  # fmt: skip
    setup = demo("duration=100")
    again = record_run(with_planned(setup, *found), tmp_path / "again")
    assert compared(run, again).differing == 0


@contextmanager
def composed_run(folder, setup, rate, on_tick=None):
    """Start a composed run in a thread; yield its client and the list of its end."""
    domain, ends = reserved_domain(), []
    with claim_domain(domain), applied(variables(domain, folder)):
        from train_ato.ros.graph.composed import run_composed
        from train_ato.ros.graph.graph_result import GraphOptions

        (folder / "run").mkdir()
        given = (setup, folder / "run", domain, GraphOptions(rate=rate), on_tick)
        work = threading.Thread(target=lambda: ends.append(run_composed(*given)), daemon=True)
        work.start()
        with graph_client(domain) as remote:
            yield remote, ends
        work.join(timeout=LIMIT_S)
    assert ends and ends[0].failure is None


def test_refusals_name_their_reason(tmp_path):
    """Breaks if an invalid size, a step without pause or an unknown run is accepted or gives a traceback."""
    domain = reserved_domain()
    assert "holds it; running: " in do(domain, "gust").stderr
    with composed_run(tmp_path, demo("duration=3600"), 2.0) as (remote, _):
        assert not remote.change_parameters("plant", {"gust.acceleration": -0.5, "gust.duration": -1.0})[0]
        assert remote.parameter("plant", "gust.acceleration") == -0.02
        success, reason = remote.call("plant/step")
        assert not success and "pause first" in reason and remote.call("plant/pause", True)[0]
        wait_for(lambda: remote.call("plant/step")[0], "a tick between two pauses")
        assert remote.call("plant/emergency_brake", True)[0] and remote.call("plant/stop")[0]
    assert "has no parameter 'hard=1'" in do(domain, "pause", "hard=1").stderr
    assert "name=number" in do(domain, "gust", "duration=long").stderr


@pytest.mark.graph
@pytest.mark.parametrize("mode", [[], ["--processes"]])
def test_a_reset_run_begins_again_with_the_log_of_a_fresh_one(mode, tmp_path):
    """Breaks if the ended log is lost, if a change of the ended run lasts, or if the new run is not a fresh one."""
    domain, out = reserved_domain(), tmp_path / "run"
    words = ["run", "demo", "--set=duration=30", "--rate=10", f"--domain={domain}", f"--out={out}", *mode]
    run = begun(*words, "--start-limit=none", stdout=None)
    try:
        wait_for(lambda: (out / "run.mcap.partial").exists())
        with graph_client(domain) as remote:
            assert remote.set_parameter("controller", "law", "smc") is None
            wait_for(lambda: remote.call("plant/reset")[0])
        said = run.communicate(timeout=LIMIT_S)[1]
    finally:
        run.kill()
    assert run.returncode == 0, said
    ended, fresh = (json.loads((tmp_path / name / "summary.json").read_text()) for name in ("run", "run-2"))
    assert (ended["status"], fresh["status"]) == ("interrupted", "done")
    assert ended["interruption"].startswith("reset by a request at ")
    assert f"{ended['interruption']}; it begins again in {tmp_path / 'run-2'}" in said
    assert train_ato.load(out)["train/vehicles"].index.size == ended["ticks"] + 1 < fresh["ticks"]
    assert fresh["controller"] == "pid" and train_ato.verify(tmp_path / "run-2").equal


def test_the_rate_holds_lockstep_back_and_lets_it_go(tmp_path):
    """Breaks if a slow rate does not delay a tick, or a new rate has no effect within a tick."""
    setup, ticks = demo(), []
    with composed_run(tmp_path, setup, 1e-4, ticks.append) as (remote, ends):
        assert remote.set_parameter("plant", "gust.duration", 5.0) is None
        held = max(ticks, default=0)
        assert remote.set_parameter("plant", "rate", 0.0) is None
    assert held <= 1 and ends[0].ticks == setup.ticks


def test_a_metro_is_stopped_by_its_own_brake_alone():
    """Breaks if a train without an air brake or with dead drives is not stopped, or the drives or the link act."""
    setup = setup_of("xuzhou_metro", "duration=120")
    outcome = run_engine(with_planned(setup, (60 * SECOND, EmergencyBrakeNow())))
    assert outcome.failure is None and last_speeds(outcome)[round(59 / setup.tick)] > 20.0
    assert abs(last_speeds(outcome)[-1]) < 1e-6
    assert abs(outcome.recording.applied[round(70 / setup.tick) :]).max() < 1.0
    assert outcome.recording.applied.min() > -230e3
    dead = ("duration=120", "plant.mismatch={electric_brake_scale: 0.0}", "links.command={delay: 60}")
    loop = Loop(setup_of("xuzhou_metro", *dead))
    loop.until(10 * SECOND)
    loop.plant.train.arrays.state[k.V] = 20.0
    loop.plant.request(EmergencyBrakeNow())
    loop.until(40 * SECOND)
    assert loop.speed == 0.0


def ticked(plant, count):
    """Run the plant for some ticks without commands."""
    for _ in range(count):
        plant.observe()
        plant.act()


def test_requests_are_limited_in_number_and_a_delay_has_no_overflow():
    """Breaks if requests add up without bound, also in a pause, or the product of delay jumps is not a number."""
    plant = PlantStage(demo())
    for _ in range(5):
        plant.request(gust(0.01, 2.0))
    ticked(plant, 10)
    for _ in range(5):
        plant.request(gust(0.01, 2.0))
    with pytest.raises(ValueError, match=r"10 requests of gust are in force, the maximum; repeat it after 2\.1 s"):
        plant.request(gust(0.01, 2.0))
    ticked(plant, 11)
    plant.request(gust(0.01, 2.0))
    for _ in range(100):
        plant.request(DelayJumpNow(factor=1000.0))
    with pytest.raises(ValueError, match="100 requests of delay_jump are in force, the maximum"):
        plant.request(DelayJumpNow(factor=1000.0))
    plant.observe()
    plant.act(Command(0, np.zeros(plant.setup.layout.n_units)), None)
    plant = PlantStage(demo())
    for _ in range(10):
        plant.request(EmergencyBrakeNow())
    with pytest.raises(ValueError, match="10 requests of emergency_brake are in force"):
        plant.request(EmergencyBrakeNow())
    ticked(plant, 1)
    plant.request(EmergencyBrakeNow())


def test_a_change_with_a_topic_is_listed() -> None:
    """Breaks if ``info`` takes the name of a topic or of a force for a number."""
    assert _value({"topic": "ato/command", "duration": 2.0}) == "topic ato/command, duration 2"
    assert _value({"applied": True}) == "applied 1"
