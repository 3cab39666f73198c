"""Engagement and takeover of the ATO, changes during a run: in the log, and in the repeated run."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from engine_runs import compared, record_run, setup_of
from request_desk import beside_a_run

from train_ato.api.verifying import verify
from train_ato.cli.main import main
from train_ato.control.assurance import AT_ONCE
from train_ato.control.laws.pid import Pid
from train_ato.control.takeover import TakeoverRamp
from train_ato.judge.recording import OUTSIDE_KEY, Recording
from train_ato.judge.result import RunResult
from train_ato.log.difference import compare_logs
from train_ato.log.recorded import OWN_KEYS, late_commands, outside_nodes, read_changes
from train_ato.log.run_folder import STARTED, RunFolder, read_run_folder
from train_ato.loop.ato_mode import NOTHING_LEFT
from train_ato.loop.controller import ControllerStage
from train_ato.loop.engine import Sink, TickLoop, run_engine
from train_ato.loop.profile import REJOINED, ProfileStage
from train_ato.loop.stamp_synchronizer import StampSynchronizer
from train_ato.loop.supervisor import SupervisorStage
from train_ato.messages.codec import Wire
from train_ato.messages.topics import BY_NAME
from train_ato.messages.types import AtoState, Diagnostic, Reference, Tick, Trajectory
from train_ato.ros.graph.recorded import complete_folder
from train_ato.ros.graph.runner import run_graph
from train_ato.scenario.changes import GIVEN, RunChanges, change_at, changes_from_json, values_of
from train_ato.scenario.scenario import LawChange, load_scenario
from train_ato.scenario.setup import RunSetup, prepare
from train_ato.supervision.supervisor import SupervisionState

pytestmark = pytest.mark.usefixtures("without_figure")
METRO = "xuzhou_metro:disturbed"
TICK_S, LAG_S, PERIOD_S = 0.05, 0.4, 0.4


def driven(name: str, *changes: str) -> tuple[RunResult, Recording]:
    result = run_engine(setup_of(name, *changes))
    return result, result.recording


def states(recording: Recording) -> list[tuple[float, AtoState]]:
    """Return the changes of the ATO's state with their times [s]."""
    topic = recording.topics["ato/state"]
    values = topic.values["state"][:, 0]
    changed = np.flatnonzero(np.diff(values, prepend=-1.0))
    return [(float(topic.time[i]), AtoState(int(values[i]))) for i in changed]


def test_the_demo_with_an_emergency_brake_on_its_way_stops_at_its_place() -> None:
    """Breaks if the ATO is not disengaged, drives on by itself, or plans from another place than that of the train."""
    brake = "interventions=[{at: 200, do: emergency_brake}, {at: 260, do: emergency_brake, applied: false}]"
    result, recording = driven("demo", brake, "ato_requests=[{at: 270, do: engage}]", "duration=1250")
    assert [state for _, state in states(recording)] == [
        AtoState.ENGAGED, AtoState.DISENGAGING, AtoState.AVAILABLE, AtoState.READY, AtoState.ENGAGED,
    ]  # fmt: skip
    assert abs(result.summary["stop_error_m"]) < 0.5 and result.summary["status"] == "done"


def test_a_train_departs_again_after_its_brakes_are_released() -> None:
    """Breaks if the profile after an engagement departs at once, against the shoes, or with another jerk."""
    brake = "interventions=[{at: 60, do: emergency_brake}, {at: 100, do: emergency_brake, applied: false}]"
    _, recording = driven("demo", brake, "ato_requests=[{at: 100, do: engage}]", "duration=200")
    again = recording.profiles[1]
    released = 100.0 + 1295.222 / 36.0 + 3 * 6.0
    departure = float(again.time[(again.time > again.stamp) & (again.velocity > 0.0)][0]) * 1e-9
    assert released - 0.5 < departure < released + 1.0
    later = recording.time > departure  # the slack runs out without a jerk of the locomotive
    assert np.abs(recording.velocity[later, 0] - recording.reference_velocity[later]).max() < 0.5
    assert recording.coupler_draft_max[later].max() < 1000e3


def test_the_emergency_brake_cuts_the_traction_at_once() -> None:
    """Breaks if the drive still gets the command of the law, or the ATO goes on commanding it."""
    _, recording = driven(METRO, "interventions=[{at: 20, do: emergency_brake}]", "duration=60")
    time, sent = recording.time, np.asarray(recording.command)
    assert float(sent[np.searchsorted(time, 19.5)].max()) > 50e3
    begin = 20.0 + TICK_S
    later = time >= begin
    decay = float(recording.applied.max()) * np.exp(-(time[later] - begin) / LAG_S)
    assert (recording.applied[later, 0] <= decay + 1e-6).all(), "only the lag of the actuators is left"
    assert float(sent[time > 20.0 + PERIOD_S].max()) <= 0.0, "a disengaged ATO coasts or brakes"


def test_an_engagement_is_refused_while_a_brake_is_in_effect() -> None:
    """Breaks if a planned engagement does not wait for the release."""
    brake = "interventions=[{at: 30, do: emergency_brake}, {at: 80, do: emergency_brake, applied: false}]"
    _, recording = driven(METRO, brake, "ato_requests=[{at: 40, do: engage}]", "duration=100")
    engaged = [time for time, state in states(recording) if state is AtoState.ENGAGED]
    assert engaged[0] == 0.0 and engaged[1] > 80.0


def test_an_engagement_beyond_the_last_stop_is_refused_at_once() -> None:
    """Breaks if a train with no way left is engaged, and fails 10 s later for another reason."""
    loop = TickLoop(setup_of("demo", "ato_requests=[{at: 1, do: disengage}, {at: 3.4, do: engage}]"), None)
    loop.start()
    ato = loop.controller.ato
    assert ato.last_stop == loop.profile.profile.position.max() > 100.0
    ato.last_stop = 0.0
    go_on(loop, 3.2)
    with pytest.raises(ValueError, match="engage: the train is at the last stop of its profile or beyond it"):
        ato.request("engage")
    go_on(loop, 4.0)
    assert (ato.machine.state, ato.machine.reason) == (AtoState.FAILURE, NOTHING_LEFT)
    loop.controller.foreign_profile, ato.last_stop = True, np.inf
    loop.controller.set_profile(loop.profile.profile)
    assert ato.last_stop == np.inf  # another program can plan on from there


def test_the_ways_of_running_agree_over_a_disengagement(tmp_path: Path) -> None:
    """Breaks if a state of the ATO or a new plan reaches a node at another tick than in the engine."""
    setup = setup_of(
        METRO, "interventions=[{at: 60, do: emergency_brake}, {at: 90, do: emergency_brake, applied: false}]",
        "ato_requests=[{at: 95, do: engage}]", "duration=120",
    )  # fmt: skip
    engine, graph = run_engine(setup), run_graph(setup, tmp_path, mode="composed")
    assert graph.failure is None and graph.recording is not None and engine.recording is not None
    for topic, samples in engine.recording.topics.items():
        for name, values in samples.values.items():
            np.testing.assert_array_equal(values, graph.recording.topics[topic].values[name], err_msg=topic)


def test_a_law_that_raises_stops_the_train_before_the_run_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a dead law ends the run while the train moves."""
    step = Pid.step

    def failing(self: Pid, inputs: Any) -> Any:
        if inputs.t > 30.0:
            raise ZeroDivisionError("gain is 0")
        return step(self, inputs)

    monkeypatch.setattr(Pid, "step", failing)
    result, recording = driven(METRO, "law=pid", "duration=120")
    assert result.failure.startswith("node controller failed: law pid: ZeroDivisionError: gain is 0, ")
    assert recording.front_velocity[-1] < 0.1 and 30.0 < recording.time[-1] < 80.0


STRUCK_S = 30.0


def metro(*changes: str) -> RunSetup:
    return setup_of("xuzhou_metro:disturbed", "duration=120", *changes)


def begun(setup: RunSetup) -> TickLoop:
    """Return a run at the time of the restart, in motion with traction."""
    loop = TickLoop(setup, None)
    loop.start()
    go_on(loop, STRUCK_S)
    return loop


def go_on(loop: TickLoop, time: float) -> None:
    while loop.ticks < round(time / loop.plant.setup.tick):
        loop.tick()


def new_controller(loop: TickLoop) -> None:
    loop.controller = ControllerStage(loop.plant.setup)
    loop.controller.set_profile(loop.profile.profile)
    loop.controller.join(loop.plant.stamp)


def demands(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Return demands and measured forces of the train from the restart on [N]."""
    later = recording.time >= STRUCK_S - 1e-9
    return recording.command[later].sum(axis=1), recording.applied[later].sum(axis=1)


@pytest.mark.parametrize("case", ["new process", "other node"])
def test_the_demand_begins_at_the_force_that_acts_and_keeps_the_jerk(case: str) -> None:
    """Breaks if the demand jumps to the full brake, or does not reach it."""
    setup = metro()
    loop = begun(setup)
    if case == "new process":
        new_controller(loop)
    else:
        loop.controller.follow_outage("node observer restarted: test")
    go_on(loop, STRUCK_S + 15.0)
    demand, applied = demands(loop.recording.finish())
    largest = float(np.abs(setup.profile.jerk()).max()) * setup.model.inertia * setup.tick
    assert abs(demand[0] - applied[0]) <= largest * (1 + 1e-9)
    assert np.abs(np.diff(demand[: int(demand.argmin()) + 1])).max() <= largest * (1 + 1e-9)
    assert demand.min() == pytest.approx(float(setup.model.force_limits(np.full(setup.model.n_units, 5.0))[0].sum()))
    assert loop.controller.ato.machine.reason.endswith("restarted" if case == "new process" else "test")


def test_takeover_ramps_without_a_measurement_and_at_a_limit() -> None:
    """Breaks if NaN reaches the train, the brake waits for its jerk at a limit, or the law returns as steeply."""
    ramp = TakeoverRamp(metro().model, 0.5)
    units = np.full(metro().model.n_units, np.nan)
    assert np.isfinite(ramp.step(np.zeros(units.size), units)).all() and ramp.ended
    model = metro().model
    brake, none = np.full(model.n_units, -2e5), np.zeros(model.n_units)
    plain, steeper, at_once = (TakeoverRamp(model, 0.5, none, least) for least in (0.0, 2.0, AT_ONCE))
    first = plain.step(brake, none)
    assert steeper.step(brake, none) == pytest.approx(4.0 * first)
    assert at_once.step(brake, none) == pytest.approx(brake)
    assert at_once.change == pytest.approx(plain.change)


def test_an_engagement_after_the_restart_plans_from_the_place_of_the_train() -> None:
    """Breaks if a request before the restart is repeated, a later one is lost, or the plan begins elsewhere."""
    setup = metro("ato_requests=[{at: 29, do: engage}, {at: 80, do: engage}]", "duration=150")
    loop = TickLoop(setup, None)
    loop.start()
    go_on(loop, 5.0)
    new_controller(loop)
    loop.controller.join(round(STRUCK_S * 1e9))
    go_on(loop, 79.0)
    assert loop.controller.ato.machine.state.text == "ready"
    assert abs(float(loop.plant.train.velocity[0])) < 0.1
    place = float(loop.plant.train.position[0])
    go_on(loop, 82.0)
    assert loop.controller.ato.drives
    assert loop.profile.profile.at(loop.profile.planned * 1e-9)[0] == pytest.approx(place, abs=1.0)
    go_on(loop, 110.0)
    assert float(loop.plant.train.velocity[0]) > 1.0


def test_a_profile_that_joins_is_sent_again_with_its_first_reference() -> None:
    """Breaks if the references are not those of the controller's profile, or it plans while the train moves."""
    setup = metro()
    loop = begun(setup)
    loop.controller.follow_outage("node profile restarted: test")
    loop.profile = ProfileStage(setup)
    loop.profile.join()
    stamp = loop.plant.stamp
    go_on(loop, STRUCK_S + 20.0)
    assert loop.profile.planned == stamp and loop.profile.profile == setup.profile
    recording = loop.recording.finish()
    assert [plan.stamp for plan in recording.profiles] == [0, stamp]
    reports = [report for report in recording.reports if report.node == "profile" and report.stamp >= stamp]
    assert reports[0].values["reason"] == REJOINED
    refused = [report for report in recording.reports if "refused ato/reference" in report.values]
    assert refused == []


def test_a_supervisor_that_joins_releases_at_standstill() -> None:
    """Breaks if it releases a moving train, or the time before it counts as a movement backwards."""
    setup = metro()
    loop = begun(setup)
    loop.supervisor = SupervisorStage(setup)
    loop.supervisor.join()
    go_on(loop, STRUCK_S + 40.0)
    recording = loop.recording.finish()
    reports = [report for report in recording.reports if report.node == "supervisor"]
    later = [report for report in reports if report.stamp >= STRUCK_S * 1e9]
    assert later[0].message == SupervisionState.EMERGENCY_BRAKE.text
    assert later[0].values["reason"] == "node supervisor restarted"
    assert later[-1].message == SupervisionState.NORMAL.text
    released = next(report for report in later if report.message == SupervisionState.NORMAL.text)
    assert abs(np.interp(released.stamp * 1e-9, recording.time, recording.front_velocity)) < 0.1


def test_messages_of_incomplete_stamps_are_not_counted_after_a_restart() -> None:
    """Breaks if a node that joins reports ignored messages, or counts none later."""
    inputs = StampSynchronizer(ahead=10)
    inputs.join()
    inputs.put("profile", Trajectory(0, "train", *(np.zeros(2) for _ in range(4))))
    inputs.put("reference", Reference(100, 0.0, 0.0, 0.0))
    inputs.put("measurement", Tick(100))
    inputs.put("estimate", Tick(100))
    inputs.put("measurement", Tick(110))
    inputs.put("reference", Reference(110, 0.0, 0.0, 0.0))
    assert inputs.put("estimate", Tick(110)) and inputs.ignored == 0
    inputs.put("measurement", Tick(120))
    inputs.put("measurement", Tick(120))
    assert inputs.ignored == 1


SECOND = 1_000_000_000
AT_REST = "[{at: 1, do: disengage}, {at: 2.5, do: engage}, {at: 2.5, do: disengage}, {at: 9, do: reset}]"
"""Requests to a train that does not yet move; the third waits for the engagement, the last is never possible."""
LOST = "faults=[{topic: ato/reference, begin: 0.5, end: 3, do: drop}]"
"""A loss of the reference, after which the ATO fails before the train moves; the run goes on."""


def test_an_accepted_request_is_in_summary_log_and_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a request is missing in ``changes``, has its planned time, or one that was not accepted is listed."""
    run = record_run(setup_of("demo", "duration=15", f"ato_requests={AT_REST}"), tmp_path / "run")
    rows = json.loads((run / "summary.json").read_text())["changes"]
    assert [(row["at_s"], row["name"], row["value"], row["planned"]) for row in rows] == [
        (1.2, "ato_request", "disengage", True),
        (2.8, "ato_request", "engage", True),
        (3.2, "ato_request", "disengage", True),
    ]
    assert read_changes(run).requests == [
        (1_200_000_000, "disengage"), (2_800_000_000, "engage"), (3_200_000_000, "disengage"),
    ]  # fmt: skip
    assert main(["info", str(run / "run.mcap"), "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["changes"]
    assert [(row["at_s"], row["value"]) for row in listed] == [(1.2, "disengage"), (2.8, "engage"), (3.2, "disengage")]


def test_accepted_requests_drive_the_run_again(tmp_path: Path) -> None:
    """Breaks if the repeated run lacks a request, has it at another step, or forgets one that still waits."""
    setup = setup_of("demo", "duration=15", f"ato_requests={AT_REST}")
    run = record_run(setup, tmp_path / "run")
    plain = dataclasses.replace(setup, scenario=setup.scenario.model_copy(update={"ato_requests": ()}))
    again = dataclasses.replace(setup, scenario=read_changes(run).driven(plain.scenario))
    assert [(entry.at, entry.do) for entry in again.scenario.ato_requests] == [
        (1.2, "disengage"), (2.8, "engage"), (3.2, "disengage"),
    ]  # fmt: skip
    assert compared(run, record_run(again, tmp_path / "again")).first is None
    assert [entry.do for entry in read_changes(run).driven(setup.scenario).ato_requests][-1] == "reset"


def test_a_request_is_planned_if_the_scenario_has_it() -> None:
    """Breaks if an accepted request counts as a plan of another kind or of a later time, or as two plans."""
    scenario, _ = load_scenario(
        "demo", ("ato_requests=[{at: 1, do: reset}, {at: 2, do: engage}, {at: 9, do: engage}]",)
    )
    found = RunChanges(requests=[(3 * SECOND, "engage"), (4 * SECOND, "engage")])
    assert [row["planned"] for row in found.rows(scenario)] == [True, False]
    assert [(entry.at, entry.do) for entry in found.driven(scenario).ato_requests] == [
        (1.0, "reset"), (3.0, "engage"), (4.0, "engage"), (9.0, "engage"),
    ]  # fmt: skip


def test_a_request_of_another_version_is_refused() -> None:
    """Breaks if a repeated run omits a request that this version cannot read."""
    message = Diagnostic(SECOND, "controller", 0, "engaged", {"ato_request": "fly"})
    with pytest.raises(ValueError, match="ato_request 'fly': not written by this version"):
        RunChanges.of([message])
    other = Diagnostic(SECOND, "plant", 0, "running", {"ato_request": "engage"})
    assert RunChanges.of([other]).requests == []


@pytest.mark.campaign
def test_live_requests_are_recorded_and_verified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a service call is missing in the log or ``verify`` omits it, or a refusal has no reason."""
    pytest.importorskip("rclpy")
    run = tmp_path / "run"
    with beside_a_run(run, monkeypatch, f"--set={LOST}", "--set=duration=60") as (desk, summary):
        early = desk.inject("engage")
        assert early.returncode == 2
        assert "engage: refused by the controller: engage: the ATO is" in early.stderr
        desk.steps(32)  # past the loss of the reference, in the state failure
        for action in ("reset", "engage", "disengage"):
            done = desk.inject(action)
            assert done.returncode == 0, done.stderr
            assert f"controller on domain {desk.domain}: {action}" in done.stdout
            desk.steps(8)
    rows = summary["changes"]
    assert [(row["name"], row["value"], row["planned"]) for row in rows] == [
        ("ato_request", action, False) for action in ("reset", "engage", "disengage")
    ]
    planned = yaml.safe_load((run / "scenario.yaml").read_text())["ato_requests"]
    assert [(entry["at"], entry["do"]) for entry in planned] == [(row["at_s"], row["value"]) for row in rows]
    setup, _ = read_run_folder(run)
    silent = dataclasses.replace(setup, scenario=setup.scenario.model_copy(update={"ato_requests": ()}))
    first = compared(run, driven_again(silent, tmp_path / "other")).first  # without the requests it fails
    assert first is not None and first.stamp == round(rows[0]["at_s"] * SECOND)


def drive(folder: Path, *assignments: str) -> Path:
    return record_run(setup_of("demo", "duration=40", *assignments), folder)


def driven_again(setup: RunSetup, folder: Path) -> Path:
    """Return a folder with the log of a run, and nothing else."""
    with RunFolder.make(folder, "again").sink(setup) as sink:
        run_engine(setup, sink=sink)
    return folder


def test_a_planned_change_is_told_at_the_step_that_begins_to_use_it(tmp_path: Path) -> None:
    """Breaks if a parameter waits for the next report, or a change between two ticks has the wrong stamp."""
    planned = "law_changes=[{at: 12.34, laws: {pid: {kp: 0.05}}}, {at: 30, law: smc}]"
    run = drive(tmp_path / "run", planned)
    assert read_changes(run).laws == [(12_400_000_000, {"pid.kp": 0.05}), (30 * SECOND, {"controller": "smc"})]
    assert json.loads((run / "summary.json").read_text())["changes"] == [
        {"at_s": 12.4, "name": "pid.kp", "value": 0.05, "planned": True},
        {"at_s": 30.0, "name": "controller", "value": "smc", "planned": True},
    ]
    assert not (run / STARTED).exists()
    plain = drive(tmp_path / "plain")
    assert compared(plain, run).first is not None


def test_what_took_effect_drives_the_run_again(tmp_path: Path) -> None:
    """Breaks if two changes of one step are exchanged, or rounding moves a swap between two ticks."""
    both = "{at: 7.77, laws: {pid: {kp: 0.05, ki: 0.001}}, law: pid}"
    later = "{at: 7.79, laws: {smc: {ks: 0.1}}}, {at: 7.8, laws: {pid: {kd: 0.1}}}"  # the log has this order
    planned = f"law_changes=[{both}, {later}, {{at: 0, law: smc}}]"
    run = drive(tmp_path / "run", planned)
    setup, _ = read_run_folder(run)
    told = read_changes(run)
    again = told.driven(setup_of("demo", "duration=40").scenario)
    assert {swap.at for swap in again.law_changes} == {0.0, 7.8}
    other = driven_again(dataclasses.replace(setup, scenario=again), tmp_path / "again")
    assert compared(run, other).first is None


def test_a_swap_at_the_start_is_the_law_of_the_start(tmp_path: Path) -> None:
    """Breaks if the initial law starts with the transition of a swap."""
    swapped = drive(tmp_path / "a", "law_changes=[{at: 0, law: smc}]")
    chosen = drive(tmp_path / "b", "law=smc")
    found = compared(swapped, chosen)
    assert found.topics == {"/diagnostics": 1}
    assert "changed" in str(found.first)


def test_steps_that_were_not_reached_stay_planned() -> None:
    scenario, _ = load_scenario("demo", ("law_changes=[{at: 5, law: smc}, {at: 700, law: pid}]",))
    told = RunChanges(laws=[(3 * SECOND, {"pid.kp": 0.5}), (5 * SECOND, {"controller": "smc"})])
    driven = [(swap.at, values_of(swap)) for swap in told.driven(scenario).law_changes]
    assert driven == [(3.0, {"pid.kp": 0.5}), (5.0, {"controller": "smc"}), (700.0, {"controller": "pid"})]
    assert [row["planned"] for row in told.rows(scenario)] == [False, True]


def test_a_run_whose_parameters_were_set_together_is_read_again() -> None:
    """Breaks if the changes of a step are checked one after the other: its folder was refused."""
    setup = setup_of("demo", "law=gpc", "laws.gpc={n: 20, nu: 10}")
    again = RunChanges(laws=[(3 * SECOND, {"gpc.n": 3, "gpc.nu": 2})]).driven(setup.scenario)
    assert len(prepare(again, Path()).scenario.law_changes) == 2


@pytest.mark.parametrize("stamp", [0, 1, 100_000_000, 700_000_000, 86_399_900_000_000, 2_599_300_000_001])
def test_stamps_survive_the_scenario_file(stamp: int) -> None:
    """Breaks if a stamp written in seconds returns a nanosecond off: the change would move by a tick."""
    swap = change_at(stamp, {"smc.k": 0.1, "controller": "smc"})
    read = LawChange.model_validate(yaml.safe_load(yaml.safe_dump(swap.model_dump(mode="json"))))
    assert round(read.at * SECOND) == stamp
    assert values_of(read) == {"smc.k": 0.1, "controller": "smc"}


@pytest.mark.parametrize("text", ["", "[]", '{"pid.kp": [1]}', "{'a': 1}"])
def test_foreign_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="not written by this version"):
        changes_from_json(text)


@pytest.mark.campaign
@pytest.mark.parametrize("way", [[], ["--processes"]], ids=["one", "several"])
def test_a_law_set_from_another_process_is_recorded_and_verified(way, tmp_path, monkeypatch):
    """Breaks if the log lacks the time of a change of law or parameter, or ``verify`` omits the change."""
    pytest.importorskip("rclpy")
    run = tmp_path / "run"
    with beside_a_run(run, monkeypatch, "--set=duration=100", *way) as (desk, summary):
        assert desk.set("pid.kpp=1").returncode == 2
        assert desk.set("law=smc").returncode == 0
        desk.steps(3)
        assert desk.set("pid.kp=0.05").returncode == 0
        desk.steps(2)
        assert desk.set("law=pid").returncode == 0
    changes = summary["changes"]
    told = [(row["name"], row["value"], row["planned"]) for row in changes]
    assert told == [("controller", "smc", False), ("pid.kp", 0.05, False), ("controller", "pid", False)]
    first = changes[0]["at_s"]
    assert [row["at_s"] - first for row in changes] == pytest.approx([0.0, 0.3, 0.5], abs=0.11)
    assert yaml.safe_load((run / STARTED).read_text())["law_changes"] == []
    assert len(yaml.safe_load((run / "scenario.yaml").read_text())["law_changes"]) == 3
    (run / "scenario.yaml").unlink()
    plain = setup_of(str(run / STARTED))
    found = compare_logs(run, driven_again(plain, tmp_path / "plain"), Wire(plain.layout))
    assert found.first is not None
    assert found.first.stamp == round(first * SECOND)


def test_late_commands_of_a_paced_run_are_counted(tmp_path: Path) -> None:
    """Breaks if ``verify`` attributes an effect of the wall clock to the code: the last count of the plant is valid."""
    setup = setup_of()
    with RunFolder.make(tmp_path / "run", "demo").sink(setup) as sink:
        for second, late in enumerate((0, 2, 3)):
            values = {"wall_late": str(late), "wall_held": "1"}
            sink.add("/diagnostics", Diagnostic(second * SECOND, "plant", 0, "running", values), second * SECOND)
        sink.add("/diagnostics", Diagnostic(0, "controller", 0, "engaged", {"wall_late": "99"}), 0)
    assert late_commands(tmp_path / "run") == 4
    assert late_commands(drive(tmp_path / "lockstep")) == 0


NAMES = {"controller": "my_controller", "observer": "my_observer"}


def record_by_hand(
    folder: Path, changed: tuple[str, ...], told: dict[str, Any], names: dict[str, str] = NAMES, lost: Any = None
) -> dict[str, Any]:
    """Record a run with start parameters of nodes that the recorder does not have; return its summary."""
    # ``told`` has the start parameters in the first diagnostics of a node, None for a program that sends none; ``lost``
    # the stamp from which on the link has lost all messages of a node [s].
    driven = setup_of("demo", "duration=20", *changed)

    class Nodes(Sink):
        def __init__(self, sink: Any) -> None:
            self.sink = sink

        def add(self, topic: str, message: Any, stamp: int) -> None:
            sender = getattr(message, "node", "") or BY_NAME[topic].publishers[0].value
            given = told.get(getattr(message, "node", ""), {})
            if given is None or stamp * 1e-9 >= (lost or {}).get(sender, math.inf):
                return
            if given and stamp == 0:
                message = dataclasses.replace(message, values={**message.values, GIVEN: json.dumps(given)})
            self.sink.add(topic, message, stamp)

    setup = setup_of("demo", "duration=20")
    with RunFolder.make(folder, "demo").sink(setup) as sink:
        run_engine(driven, sink=Nodes(sink))
        counts = sink.counts
    assert complete_folder(setup, folder, counts, 1.0, names=names) is not None
    return json.loads((folder / "summary.json").read_text())


def test_law_and_observer_are_those_that_the_nodes_reported(tmp_path: Path) -> None:
    """Breaks if summary or scenario has the law of the recorder's scenario, or the run cannot be repeated from them."""
    changed = ("law=smc", "laws.smc.ks=0.3", "observer=ndo", "observers.ndo.omega=5.0")
    told = {"controller": {"smc.ks": 0.3, "controller": "smc"}, "observer": {"observer": "ndo", "ndo.omega": 5.0}}
    summary = record_by_hand(tmp_path / "run", changed, told)
    assert (summary["controller"], summary["observer"]) == ("smc", "ndo")
    assert (summary["status"], summary["changes"]) == ("done", [])
    scenario = yaml.safe_load((tmp_path / "run" / "scenario.yaml").read_text())
    assert (scenario["law"], scenario["laws"]["smc"]["ks"]) == ("smc", 0.3)
    assert (scenario["observer"], scenario["observers"]["ndo"]["omega"]) == ("ndo", 5.0)
    assert main(["verify", str(tmp_path / "run")]) == 0
    assert main(["verify", str(tmp_path / "run" / "run.mcap")]) == 0


def test_a_program_in_place_of_a_node_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the summary names a law of the scenario that did not drive, or ``verify`` drives it in its place."""
    summary = record_by_hand(tmp_path / "run", ("law=smc",), {"controller": None})
    assert summary["controller"] == summary["compensation"] == "external: my_controller"
    assert (summary["observer"], summary["external"]) == ("none", {"controller": "my_controller"})
    assert not {"gains", "advice"} & {*summary}
    assert main(["verify", str(tmp_path / "run")]) == 2
    assert "cannot be driven again, a node was a program outside of this project: controller was my_controller" in (
        capsys.readouterr().err
    )


def test_a_run_with_a_restarted_node_is_not_repeated(tmp_path: Path) -> None:
    """Breaks if ``verify`` names the messages that the absent node did not send as differences."""
    run = drive(tmp_path / "run")
    summary = json.loads((run / "summary.json").read_text())
    (run / "summary.json").write_text(json.dumps({**summary, "restarts": {"controller": 1}}))
    with pytest.raises(ValueError, match="cannot be driven again, it has a restarted node: controller; "):
        verify(run)


@pytest.mark.parametrize(("node", "sent_s"), [*((node, 1.0) for node in OWN_KEYS), *((node, 0.0) for node in NAMES)])
def test_a_node_whose_report_was_lost_is_no_other_program(node: str, sent_s: float, tmp_path: Path) -> None:
    """Breaks if the log of a link cut at the start names another program, without any sign of one, as the driver."""
    names = {role: role for role in OWN_KEYS}
    lost = dict.fromkeys(OWN_KEYS, 1.0) | {node: sent_s}
    summary = record_by_hand(tmp_path / "run", (), {node: None}, names, lost)
    assert "external" not in summary
    assert (summary["controller"], summary["observer"], summary["compensation"]) == ("pid", "none", "preview")


PLANT = Diagnostic(0, "plant", 0, "running", {OWN_KEYS["plant"]: "0"})
SENT = dict.fromkeys(OWN_KEYS, 0.5)


@pytest.mark.parametrize("node", [*OWN_KEYS][1:])
def test_signs_of_a_program_in_place_of_a_node(node: str) -> None:
    """Breaks if one sign of another program is not enough, or a missing report is one."""
    others = [Diagnostic(0, role, 0, "", {key: ""}) for role, key in OWN_KEYS.items() if role not in (node, "plant")]

    def found(*reports: Diagnostic, plant: Diagnostic = PLANT, name: str = node, sent_s: float = 0.5) -> dict[str, str]:
        return outside_nodes(
            [plant, *others, *reports], supervised=True, names={node: name}, sent_s=SENT | {node: sent_s}
        )

    assert found() == {}
    assert found(Diagnostic(0, node, 0, "", {OWN_KEYS[node]: ""}), sent_s=60.0) == {}
    met = dataclasses.replace(PLANT, values={**PLANT.values, OUTSIDE_KEY: f"lidar {node}"})
    assert found(plant=met) == {node: node}
    assert found(plant=met, name="mine") == found(name="mine") == {node: "mine"}
    assert found(name="mine", sent_s=0.0) == {}
    assert found(Diagnostic(0, node, 0, "", {})) == {node: node}
    assert found(Diagnostic(0, node, 0, "", {node: "my law"}), plant=met) == {node: "my law"}
    assert found(sent_s=3.0) == {node: node}
