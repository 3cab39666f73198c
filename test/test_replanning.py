"""Re-planning during the run: detection from measurements, same start stamp in every mode."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from engine_runs import compared, no_figure, setup_of

from train_ato.cli import main
from train_ato.judge.result import RunResult
from train_ato.log.run_folder import read_run_folder
from train_ato.loop.engine import Sink, run_engine
from train_ato.loop.profile import ProfileStage
from train_ato.loop.stamp_synchronizer import StampSynchronizer
from train_ato.messages.types import DisturbanceEstimate, Measurement, Reference, Trajectory
from train_ato.playback.open_loop import replay_open_loop
from train_ato.profile.planner.replanner import Sample, ShortfallDetector, _regression_end
from train_ato.profile.profile import profile_of
from train_ato.scenario.scenario import check_scenario
from train_ato.scenario.setup import RunSetup

SLIPPERY = ("plant.adhesion={kind: constant, coefficient: 0.3}", "plant.jumps=[{at: 10, what: adhesion, factor: 0.2}]")
"""Adhesion of 6 % of the weight from 10 s on: 107 kN instead of 192 kN of traction and 231 kN of brake."""
WEAK_LOCOMOTIVE = (
    "plant.adhesion={kind: curtius_kniffler}",
    "plant.jumps=[{at: 50, what: adhesion, factor: 0.4}]",
    "duration=1200",
)
HEAVY = (
    "replan={confirmation_time: 8, plan: {acceleration: 0.035, deceleration: 0.035, jerk: 0.002, force_margin: 0.05}}"
)
LAST_57_KM = (
    "profile.start=230000",
    "profile.phases=[{cruise_for: 5}, {accelerate_to_kmh: 300}, {stop_at_km: 286.203}]",
    "duration=1000",
)


class Notes(Sink):
    """Sink for the profiles and the diagnostics of the profile node."""

    def __init__(self) -> None:
        self.profiles: list[Trajectory] = []
        self.said: list[Any] = []

    def add(self, topic: str, message: Any, stamp: int) -> None:
        if topic == "ato/profile":
            self.profiles.append(message)
        elif topic == "/diagnostics" and message.node == "profile":
            self.said.append(message)


def drive(name: str, *assignments: str) -> tuple[RunSetup, RunResult, Notes]:
    setup, notes = setup_of(name, *assignments), Notes()
    outcome = run_engine(setup, sink=notes)
    assert outcome.failure is None
    return setup, outcome, notes


def _watch() -> ShortfallDetector:
    return ShortfallDetector(setup_of("xuzhou_metro", "tick=0.1", "step=0.005").model, 0.2, 1.0, 1.0)


CASES = [
    ("xuzhou_metro", (*SLIPPERY, "replan={}"), 0.7, 0.6, 0.02),
    ("xuzhou_metro", ("plant.jumps=[{at: 10, what: gain, factor: 0.6}]", "law=smc", "observer=eso", "replan={}"),
     2.0, 0.8, 0.05),
    pytest.param("crh380a_funnel:replanned", LAST_57_KM, 0.6, 0.2, 0.05, marks=pytest.mark.campaign),
    pytest.param("crh380a_funnel:replanned", (), 0.6, 0.2, 0.05, marks=pytest.mark.campaign),
    pytest.param(  # a profile above the envelopes of the model
        "crh380a_funnel:saturated", (*LAST_57_KM, "replan={speed_error: 0.1, position_error: 0.3, plan: {jerk: 0.2, "
        "force_margin: 0.03}}"), 0.6, 0.2, 0.05, marks=pytest.mark.campaign
    ),
    pytest.param("demo", (*WEAK_LOCOMOTIVE, HEAVY), 4.0, 0.4, 0.05, marks=pytest.mark.campaign),
    pytest.param(
        "demo", (*WEAK_LOCOMOTIVE, HEAVY, "compensation=twin"), 10.0, 0.8, 0.05, marks=pytest.mark.campaign
    ),
]  # fmt: skip
"""Scenario, changes, then bounds of position error [m], speed error [m/s] and stop error [m]."""


@pytest.mark.parametrize(("name", "changes", "position", "speed", "stop"), CASES)
def test_a_shortfall_is_planned_and_the_stop_is_reached(name, changes, position, speed, stop):
    """Errors without re-planning: 130 m, 44 m (CRH380A), 1.4 km (demo); stop errors of the metro 130 and 44 m."""
    setup, outcome, notes = drive(name, *changes)
    summary = outcome.summary
    assert summary["replans"] == len(notes.profiles) - 1 >= 1
    assert summary["position_error_max_m"] < position
    assert summary["speed_error_max_kmh"] < 3.6 * speed
    assert abs(summary["stop_error_m"]) < stop
    first, last = profile_of(notes.profiles[0]), profile_of(notes.profiles[-1])
    assert first == setup.profile
    assert abs(last.position[-1] - first.position[-1]) < 1e-6
    for before, after in itertools.pairwise(notes.profiles):
        begin = np.searchsorted(after.time, after.stamp + 1_000_000_000)
        assert np.array_equal(after.position[:begin], before.position[:begin]), "the lead belongs to the old profile"


def test_disturbances_without_a_shortfall_start_no_plan() -> None:
    """Breaks if gusts, grades outside the model or noise count as a shortfall."""
    assert drive("xuzhou_metro:disturbed", "replan={}")[1].summary["replans"] == 0


def test_an_impossible_stop_is_reported_and_the_old_profile_stays() -> None:
    """Loss of adhesion during the last braking: 0.8 m/s² required, 0.55 m/s² available."""
    late = ("plant.adhesion={kind: constant, coefficient: 0.3}", "plant.jumps=[{at: 150, what: adhesion, factor: 0.2}]")
    run = "profile.phases=[{cruise_for: 2}, {accelerate_to_kmh: 80}, {cruise_until: 155}, {brake_to: 0}]"
    _, outcome, notes = drive("xuzhou_metro", *late, run, "replan={}", "duration=220")
    assert len(notes.profiles) == 1 and outcome.summary["replans"] == 0
    warnings = [message for message in notes.said if message.level == 1]
    assert warnings and "cannot be brought to 0.0 km/h" in warnings[0].values["reason"]
    refusals = int(warnings[-1].values["refusals"])
    assert 1 <= refusals <= 4, "the time between two attempts doubles"


def test_traction_that_returns_is_used_again() -> None:
    """Low adhesion from 10 to 25 s only; without ``retry`` the train is late until the end."""
    back = "plant.jumps=[{at: 10, what: adhesion, factor: 0.2}, {at: 25, what: adhesion, factor: 5}]"
    ends = []
    for spec in ("replan={}", "replan={retry: 20}"):
        _, outcome, notes = drive("xuzhou_metro", SLIPPERY[0], back, spec)
        assert abs(outcome.summary["stop_error_m"]) < 0.02
        ends.append(profile_of(notes.profiles[-1]).end)
    assert ends[1] < ends[0] - 1.0


METRO = str(Path(__file__).parents[1] / "examples" / "metro" / "scenario.yaml")
WEAK = "plant.jumps=[{at: 5, what: gain, factor: 0.7}]"
WEAK_FOR_7_S = "plant.jumps=[{at: 5, what: gain, factor: 0.7}, {at: 12, what: gain, factor: 1.4285714}]"
NO_BRAKE = "plant.jumps=[{at: 80, what: gain, factor: 0.4}, {at: 120, what: gain, factor: 2.5}]"


@pytest.mark.parametrize(
    ("changes", "place", "dwell"),
    [
        ((WEAK, "replan={catch_up: true, lateness: 3}", "duration=103"), 1340.0, 20.0),
        ((WEAK_FOR_7_S, "replan={catch_up: true, retry: 210}", "duration=255"), 2540.0, 25.0),
        ((NO_BRAKE, "replan={}", "duration=100"), 1340.0, 20.0),
    ],
    ids=["early beyond the stop", "retry at the stop", "weak brake"],
)
def test_no_plan_leaves_out_a_halt_or_ends_it_early(changes: tuple[str, ...], place: float, dwell: float) -> None:
    """Breaks if a train at a stop, or some metres beyond it, is planned as one that has departed."""
    profile = profile_of(drive(METRO, *changes)[2].profiles[-1])
    halt = (np.abs(profile.position - place) < 0.05) & (profile.velocity == 0.0)
    assert halt.any() and np.ptp(profile.time[halt]) > dwell - 0.2


def test_a_train_is_late_to_its_newest_plan() -> None:
    """Breaks if the profile before a plan counts: a plan every 5 s, and the reason of a former one."""
    requests = "ato_requests=[{at: 40, do: disengage}, {at: 100, do: engage}]"
    _, outcome, notes = drive(METRO, WEAK, requests, "replan={catch_up: true, lateness: 3}", "duration=109")
    planned = [message.values for message in notes.said if message.message == "following, planned again"]
    reasons = list(dict.fromkeys(values.get("reason", "engaged").split(";")[0] for values in planned))
    assert reasons[:2] == ["traction 168.0 kN", "engaged"] and reasons[2].endswith("s late") and len(reasons) == 3
    assert outcome.summary["replans"] == 1 and len(notes.profiles) == 4


def test_a_train_that_is_engaged_again_returns_to_the_times_of_its_allowance() -> None:
    """Breaks if the plan after the engagement, which is late, becomes the timetable."""
    requests = "ato_requests=[{at: 20, do: disengage}, {at: 40, do: engage}]"
    plan = "profile.plan={end_km: 2.6, allowance: [{share_percent: 25}]}"
    setup, _, notes = drive(METRO, plan, requests, "replan={catch_up: true, lateness: 3}", "duration=50")
    engaged, late = (profile_of(message).end for message in notes.profiles[1:])
    assert late == pytest.approx(setup.profile.end, abs=0.2) and engaged > late + 5.0


FORCES = [
    ("sits below the need", lambda t: 100e3, -0.2, 100e3),
    ("the same with noise", lambda t: 100e3, -0.2, 100e3),
    ("rises with the error", lambda t: 100e3 + 15e3 * t, -0.2, None),
    ("sits, but is what is needed", lambda t: 151e3, -0.2, None),
    ("sits at the most that is counted on", lambda t: 192e3, -0.2, 192e3),
    ("sits, the error shrinks", lambda t: 100e3, 0.0, None),
    ("brakes where it is too slow", lambda t: -100e3, -0.2, None),
    ("brakes too little", lambda t: -100e3, 0.2, 100e3),
]


@pytest.mark.parametrize(("case", "force", "growth", "level"), FORCES, ids=[case[0] for case in FORCES])
def test_only_a_force_that_does_not_follow_the_error_is_a_limit(case, force, growth, level):
    """Breaks if a reacting law counts as a shortfall, or a shortfall as a reacting law."""
    needed = -150e3 if growth > 0 else 150e3
    random, watch, found = np.random.default_rng(5), _watch(), None
    for t in 0.1 * np.arange(40):  # 4 s of a growing error
        error = growth * t + (0.05 if "noise" in case else 0.0) * float(random.normal())
        sample = Sample(0.5 * growth * t * t, error, 8.0, float(force(t)), needed, (192e3, 230e3))
        found = found or watch.step(sample)
    assert (None if found is None else found.observed.maximum) == level
    if found is not None:
        assert found.direction == (-1 if growth > 0 else 1)


def test_a_constant_force_with_an_error_that_shrinks_is_no_shortfall() -> None:
    """Breaks if a large error is enough: from -0.8 to -0.36 m/s the force is sufficient."""
    watch = _watch()
    samples = [Sample(-1.0, -0.8 + 0.015 * k, 8.0, 100e3, 150e3, (192e3, 230e3)) for k in range(30)]
    assert [watch.step(sample) for sample in samples] == [None] * 30


def test_the_error_is_that_of_the_regression_at_the_last_sample() -> None:
    """Breaks if the slope is another: mean 7/3, slope 3/2 for each sample."""
    assert _regression_end([1.0, 2.0, 4.0]) == pytest.approx(7.0 / 3.0 + 1.5)


def _inputs(stamp: int, planned: int) -> dict[str, Any]:
    none = np.zeros(0)
    reference = Reference(stamp, 0.0, 0.0, 0.0, planned)
    measured, estimate = Measurement(stamp, *(none,) * 6), DisturbanceEstimate(stamp, none)
    return {"measurement": measured, "reference": reference, "estimate": estimate}


def _trajectory(planned: int) -> Trajectory:
    return Trajectory(planned, "train", np.zeros(1, np.int64), *(np.zeros(1),) * 3)


def test_a_profile_is_used_from_its_stamp_on_in_any_order_of_topics() -> None:
    """Four steps with a new profile at stamp 2; topics arrive interleaved in every order, each in its own order."""
    queues = {
        kind: [_inputs(stamp, 0 if stamp < 2 else 2)[kind] for stamp in range(4)]
        for kind in ("measurement", "reference", "estimate")
    }
    queues["profile"] = [_trajectory(0), _trajectory(2)]
    for seed in range(200):
        random = np.random.default_rng(seed)
        left = {kind: list(messages) for kind, messages in queues.items()}
        inputs, current, seen = StampSynchronizer(), -1, []
        while left:
            kind = sorted(left)[int(random.integers(len(left)))]
            message = left[kind].pop(0)
            if not left[kind]:
                del left[kind]
            for step in inputs.put(kind, message):
                current = current if step.profile is None else step.profile.stamp
                seen.append((step.measurement.stamp, current))
        # Stamps before a later complete stamp are discarded; this never happens in lockstep.
        assert seen[-1] == (3, 2)
        assert all(planned == (0 if stamp < 2 else 2) for stamp, planned in seen)
        assert inputs.ignored == 0


def test_a_profile_replaced_before_its_arrival_is_not_awaited() -> None:
    """Breaks if a lost first profile of two in quick succession blocks a paced run."""
    inputs = StampSynchronizer()
    inputs.put("profile", _trajectory(7))
    ready = [step for kind, message in _inputs(5, 5).items() for step in inputs.put(kind, message)]
    assert [(step.profile.stamp, step.measurement.stamp) for step in ready if step.profile] == [(7, 5)]


SHORT = ("--set=duration=30", *(f"--set={text}" for text in (*SLIPPERY, "replan={}")))


@pytest.fixture(scope="module")
def engine_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("engine") / "run"
    with no_figure():
        assert main(["run", "xuzhou_metro", "--json", f"--out={out}", "--engine", *SHORT]) == 0
    return out


@pytest.mark.graph
def test_the_nodes_change_the_profile_at_the_same_stamp(engine_run: Path, tmp_path: Path) -> None:
    """Breaks if a controller uses a new profile a tick earlier or later than the engine does."""
    pytest.importorskip("rclpy")
    out = tmp_path / "run"
    assert main(["run", "xuzhou_metro", "--json", f"--out={out}", *SHORT]) == 0
    assert read_run_folder(out)[1]["replans"] == 1
    assert compared(engine_run, out).first is None


def test_a_recorded_run_with_two_profiles_is_replayed_through_the_law(engine_run: Path) -> None:
    """Breaks if the open loop uses profiles in the order of the file instead of the stamps of the reference."""
    setup, _ = read_run_folder(engine_run)
    assert setup.scenario.replan is not None
    assert replay_open_loop(setup, engine_run).summary()["difference_max_kn"] == 0


def test_a_profile_that_runs_backwards_is_not_planned_again() -> None:
    """Breaks if a plan leaves out the part that runs backwards: a profile of 137 s ended after 650 s."""
    parts = ("cruise_for: 2", *(f"accelerate_to_kmh: {speed}}}, {{brake_to: 0" for speed in (30, -20)))
    profile = f"profile={{start_km: 1, phases: [{', '.join(f'{{{part}}}' for part in parts)}]}}"
    assert setup_of("xuzhou_metro", profile).profile.velocity.min() < -5.0
    with pytest.raises(ValueError, match=r"replan: the profile runs backwards at [\d.]+ s, .*; remove replan"):
        setup_of("xuzhou_metro", profile, "replan={}")


def test_null_survives_the_resolved_scenario_and_no_block_is_no_replanner() -> None:
    """Breaks if ``jerk: null`` (no limit) is lost in the resolved scenario, or a run without the block replans."""
    setup = setup_of("xuzhou_metro", "replan={plan: {jerk: null, force_margin: 0.2}, retry: 60}")
    again = check_scenario(yaml.safe_load(setup.resolved_yaml()), "resolved")
    assert again.replan == setup.scenario.replan
    assert again.replan is not None and again.replan.plan is not None and again.replan.plan.jerk is None
    assert ProfileStage(setup_of("demo", "duration=1"))._replanner is None
