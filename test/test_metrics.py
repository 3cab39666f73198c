"""Figures and criteria of a run against hand calculations."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml
from engine_runs import setup_of
from recordings import recording_of, with_final, with_series

from plant_sim.line import SpeedLimit
from train_ato.judge.metrics import (
    differences,
    evaluated_ticks,
    excess_speed,
    mean_jerk_1s,
    overspeed,
    stop_error,
    summarise,
)
from train_ato.judge.recording import Recording
from train_ato.judge.result import worst_places
from train_ato.judge.stops import planned_stops, stops_of_run
from train_ato.judge.verdict import CRITERIA, judge_run, verdict_line
from train_ato.loop.engine import run_engine
from train_ato.messages.types import Diagnostic
from train_ato.scenario.criteria import Criteria
from train_ato.scenario.leader import LeaderSpec
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.scenario_files import shipped_scenarios
from train_ato.scenario.setup import RunSetup


def recording(**series: object) -> Recording:
    """Ten ticks at 10 m/s on the reference, except for the given series."""
    time, ten = 0.1 * np.arange(10), np.full(10, 10.0)
    speeds = dict.fromkeys(("velocity", "front_velocity", "reference_velocity", "coupler_draft_max"), ten)
    places = dict.fromkeys(("position", "front_position", "reference_position"), 10 * time)
    return recording_of(time, 1, **{**speeds, **places, "coupler_buff_max": -ten, **series})


def by_hand() -> Recording:
    """Return six ticks of 0.1 s with figures by hand calculation; the train moves from the third on."""
    speed, reference = np.array([0.0, 0.0, 1.0, 3.0, 4.0, 4.0]), np.array([0.0, 0.0, 2.0, 3.0, 3.0, 6.0])
    reference_place = np.array([0.0, 0.0, 0.1, 0.4, 0.7, 1.1])
    place = reference_place + np.array([9.0, 9.0, 3.0, 0.0, -4.0, 0.0])
    six = recording_of(
        0.1 * np.arange(6), 1, position=place, velocity=speed, front_position=place, front_velocity=speed,
        command=1e3 * np.array([0.0, 2.0, 5.0, 5.0, -1.0, 3.0]), reference_position=reference_place,
        reference_velocity=reference,
    )  # fmt: skip
    totals = {
        "plant": {
            "coupler_draft_max": "1.5e6", "coupler_buff_max": "-0.25e6", "energy_traction": "7.2e6",
            "energy_regenerated": "1.8e6", "saturated": "0.3",
        },
        "profile": {"replans": "2"},
        "controller": {"held_steps": "1", "unsound_measurements": "4"},
    }  # fmt: skip
    reports = tuple(Diagnostic(0, node, 0, "", values) for node, values in totals.items())
    end = float(setup_of().profile.position[-1]) - 1.25
    return replace(with_final(six, end, 0.0), kept_reports=reports)


BY_HAND = {
    # Speed errors from the first motion on: -1, 0, 1, -2 m/s; the squares 1, 0, 1, 4 have the mean 1.5.
    "speed_rmse_kmh": 3.6 * 1.224744871391589, "speed_error_max_kmh": 7.2,
    # Without an end of the evaluation, the run has the same errors.
    "speed_rmse_run_kmh": 3.6 * 1.224744871391589, "speed_error_run_max_kmh": 7.2,
    # Position errors 3, 0, -4, 0 m: squares 9, 0, 16, 0, mean 6.25. The 9 m at standstill before are not scored.
    "position_error_max_m": 4.0, "position_rmse_m": 2.5, "stop_error_m": -1.25,
    # The profile of demo stops after 766 s.
    "stop_error_max_m": None, "running_time_s": None, "arrival_delay_max_s": None,
    "overspeed_max_kmh": 0.0, "coupler_draft_max_kn": 1500.0, "coupler_buff_max_kn": -250.0,
    # Speeds 0, 0, 1, 3, 4, 4 m/s every 0.1 s: accelerations 0, 10, 20, 10, 0 m/s2, jerks 100, 100, -100, -100 m/s3.
    "acceleration_max": 20.0, "jerk_max": 100.0,
    # Shorter than two seconds.
    "jerk_1s_max": 0.0,
    # Commands 0, 2, 5, 5, -1, 3 kN change by 2, 3, 0, 6, 4 = 15 kN in 0.6 s.
    "command_variation_kn_per_s": 25.0,
    "energy_traction_kwh": 2.0, "energy_regenerated_kwh": 0.5, "saturated_s": 0.3,
    "replans": 2, "held_steps": 1, "unsound_measurements": 4,
    # Counts that a run without faults does not have.
    "commands_lost": 0, "commands_missed": 0, "commands_refused": 0, "commands_late": 0,
}  # fmt: skip


def test_every_figure_of_six_ticks_is_that_worked_out_by_hand() -> None:
    """Breaks if the definition or the unit of a figure changes, or a new figure has no hand calculation."""
    figures = summarise(setup_of(), by_hand())
    assert figures.pop("stops") == []
    assert figures == pytest.approx(BY_HAND, abs=1e-9)


def test_of_several_units_rms_is_the_mean_and_the_largest_error_that_of_the_worst() -> None:
    """Constant errors of 1, -2 and 6 m/s and of 1, -2 and 6 m: rms 1, 2 and 6, their mean 3; the largest 6."""
    setup = setup_of("xuzhou_metro")
    errors, base = np.array([1.0, -2.0, 6.0]), recording()
    position = base.reference_position[:, None] - setup.model.offsets + errors
    three = np.zeros((10, 3))
    units = {"command": three, "applied": three, "estimate": three, "disturbance": three}
    figures = summarise(setup, recording(velocity=10.0 + errors + three, position=position, **units))
    assert figures["speed_rmse_kmh"] == pytest.approx(3.6 * 3.0)
    assert figures["speed_error_max_kmh"] == pytest.approx(3.6 * 6.0)
    assert figures["position_rmse_m"] == pytest.approx(3.0)
    assert figures["position_error_max_m"] == pytest.approx(6.0)


def test_rms_starts_at_first_motion_and_ends_with_the_scored_part() -> None:
    """Breaks if standstill lowers the rms, or the stop is part of the evaluation."""
    still = np.where(np.arange(10) < 4, 0.0, 10.0)
    standing = recording(front_velocity=still, reference_velocity=still, velocity=still[:, None])
    assert evaluated_ticks(setup_of(), standing) == slice(4, 10)
    for key, value, last in (("until", 6.5, 7), ("until_time", 0.35, 4)):
        setup = setup_of()
        ends = setup.scenario.evaluation.model_copy(update={key: value})
        setup = replace(setup, scenario=setup.scenario.model_copy(update={"evaluation": ends}))
        assert evaluated_ticks(setup, recording()) == slice(0, last)


@pytest.mark.parametrize(
    "keys", [["until=0"], ["until=-10"], ["until_time=0.6"], ["until_time=3", f"plant.start.speeds={[0.0] * 106}"]]
)
def test_an_evaluation_that_ends_before_the_first_motion_is_refused(keys: list[str]) -> None:
    """Breaks if the errors of no tick are 0 and so pass, or a start with the speeds 0 is a motion: departure at 5 s."""
    with pytest.raises(ValueError, match=r"evaluation\.until.*the profile begins .*remove the key"):
        setup_of("demo", *(key if "start" in key else f"evaluation.{key}" for key in keys))


def test_an_evaluation_without_a_tick_has_no_errors_and_passes_nothing() -> None:
    """The train moves from 0.4 s on: breaks if the errors until 0.3 s are 0, and so pass their criteria."""
    setup, still = setup_of(), np.where(np.arange(10) < 4, 0.0, 10.0)
    evaluation = setup.scenario.evaluation.model_copy(update={"until_time": 0.3})
    setup = replace(setup, scenario=setup.scenario.model_copy(update={"evaluation": evaluation}))
    metrics = summarise(setup, recording(front_velocity=still, reference_velocity=still, velocity=still[:, None]))
    assert metrics["speed_rmse_kmh"] is None and metrics["position_error_max_m"] is None
    assert metrics["speed_error_run_max_kmh"] == 0.0
    judged = judge_run(Criteria(speed_error_rms=1.0, position_error=1.0), metrics)
    assert [row["passed"] for row in judged["criteria"]] == [None, None] and judged["verdict"] == "incomplete"
    assert "no speed error, because the evaluation ends before the first motion" in verdict_line({**metrics, **judged})


@pytest.mark.parametrize("tick", [0.05, 0.1])
def test_jerk_is_taken_over_a_tenth_of_a_second_whatever_the_tick(tick: float) -> None:
    """V = t³/6 has jerk 1; single ticks of 0.05 s with alternating noise of 1 mm/s would show 0.8 more."""
    time = tick * np.arange(round(2 / tick))
    noise = 1e-3 * (np.arange(time.size) % 2) if tick == 0.05 else 0.0
    acceleration, jerk = differences(time**3 / 6 + noise, tick)
    np.testing.assert_allclose(acceleration, (np.arange(acceleration.size) + 0.5) ** 2 * 0.005 + 0.0004, atol=5e-4)
    spread = np.diff(acceleration) / 0.1
    np.testing.assert_allclose(jerk, spread)
    assert jerk.size == acceleration.size - 1


def test_overspeed_is_zero_below_the_limit_and_counts_above() -> None:
    """80 km/h on the Daqin section."""
    assert overspeed(setup_of(), recording()) == 0.0
    assert overspeed(setup_of(), recording(front_velocity=np.full(10, 23.0))) == pytest.approx(23 - 80 / 3.6)


def test_stop_error_only_of_a_train_that_stands() -> None:
    setup = setup_of()
    target = float(setup.profile.position[-1])
    assert stop_error(setup, recording()) is None
    assert stop_error(setup, with_final(recording(), target + 0.2, 0.005)) == pytest.approx(0.2)


def test_summary_has_every_key_of_the_design() -> None:
    summary = run_engine(setup_of("demo", "duration=5")).summary
    wanted = """
        scenario controller observer compensation seed ticks simulated_s wall_s real_time_factor speed_rmse_kmh
        speed_error_max_kmh position_error_max_m position_rmse_m stop_error_m overspeed_max_kmh coupler_draft_max_kn
        coupler_buff_max_kn acceleration_max jerk_max command_variation_kn_per_s energy_traction_kwh
        energy_regenerated_kwh saturated_s step_time_us_median step_time_us_p99 version
    """
    assert set(wanted.split()) <= set(summary) and summary["ticks"] == 50


STOP = [{"km": 3.7, "planned_s": 766.0, "arrival_s": 768.0, "delay_s": 2.0, "beyond_m": -0.23}]
METRICS: dict[str, Any] = {
    "stops": STOP, "stop_error_max_m": -0.23, "arrival_delay_max_s": 2.0, "overspeed_max_kmh": 0.4,
    "speed_rmse_kmh": 0.1, "speed_error_run_max_kmh": 1.5, "position_error_max_m": 3.0, "coupler_draft_max_kn": 500.0,
    "coupler_buff_max_kn": -400.0, "acceleration_max": 0.3, "jerk_1s_max": 0.2, "lateness_max_s": 0.5,
    "brake_interventions": 1,
}  # fmt: skip
SI = {
    "stop_window": 0.23, "arrival_delay": 2.0, "overspeed": 0.4 / 3.6, "speed_error_rms": 0.1 / 3.6,
    "speed_error": 1.5 / 3.6, "position_error": 3.0, "coupler_draft": 500e3, "coupler_buff": 400e3,
    "acceleration": 0.3, "jerk": 0.2, "real_time": 0.5, "brake_interventions": 1,
}  # fmt: skip
"""Every criterion with the magnitude of its metric as limit [SI]."""


def two_stops(*assignments: str, dwell: float = 20.0) -> RunSetup:
    """Return a run with a stop [s] on the way and one at the end."""
    phases = f"[{{accelerate_to: 5}}, {{brake_to: 0}}, {{cruise_for: {dwell}}}, {{accelerate_to: 5}}, {{brake_to: 0}}]"
    limits = "{jerk: 0.1, acceleration: 0.2, deceleration: 0.2}"
    texts = (f"profile={{phases: {phases}, limits: {limits}}}", "duration=200", "supervision.enabled=false")
    return setup_of("demo", *texts, *assignments)


def on_profile(setup: RunSetup, late: float, beyond: float) -> Recording:
    """Return a run on its profile ``late`` seconds later and, from the first stop on, ``beyond`` metres ahead."""
    time = setup.tick * np.arange(setup.ticks)
    states, on_time = (np.array([setup.profile.at(max(0.0, t - shift)) for t in time]) for shift in (late, 0.0))
    place = states[:, 0] + np.where(states[:, 0] > 0.99 * planned_stops(setup.profile)[0].position, beyond, 0.0)
    found = recording_of(
        time, 1, position=place, velocity=states[:, 1], front_position=place, front_velocity=states[:, 1],
        reference_position=on_time[:, 0], reference_velocity=on_time[:, 1], reference_acceleration=on_time[:, 2],
    )  # fmt: skip
    return with_final(found, float(place[-1]), 0.0)


@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda entry: entry.key)
def test_a_metric_at_its_limit_passes_and_above_it_fails(criterion) -> None:
    """Breaks if a criterion reads another metric, ignores the sign or compares in another unit."""
    limit = SI[criterion.key]
    below = limit - 1 if isinstance(limit, int) else 0.99 * limit
    for value, verdict in ((limit, "passed"), (below, "failed")):
        found = judge_run(Criteria.model_validate({criterion.key: value}), METRICS)
        assert found["verdict"] == verdict
        assert [row["metric"] for row in found["criteria"]] == [criterion.metric]


def test_every_criterion_is_evaluated() -> None:
    """Breaks if a key of the scenario has no evaluation."""
    others = ["requirements", "tracking"]
    assert [*(entry.key for entry in CRITERIA), *others] == list(Criteria.model_fields) == [*SI, *others]


def test_a_train_that_does_not_stop_fails_and_a_stop_beyond_the_run_is_not_evaluated() -> None:
    """Breaks if a missing stop passes, or a shortened run fails for its stop."""
    criteria = Criteria(stop_window=1.0)
    moving = {"stops": [{**STOP[0], "beyond_m": None, "arrival_s": None}], "stop_error_max_m": None}
    assert judge_run(criteria, moving)["verdict"] == "failed"
    assert judge_run(criteria, {"stops": [], "stop_error_max_m": None})["verdict"] == "incomplete"
    assert judge_run(criteria, {**METRICS, "status": "interrupted"})["verdict"] == "incomplete"
    assert judge_run(criteria, {**METRICS, "status": "failed"})["verdict"] == "failed"
    assert judge_run(Criteria(), METRICS) == {}
    assert judge_run(Criteria(arrival_delay=0.0), {"stops": STOP, "arrival_delay_max_s": -3.0})["verdict"] == "passed"


def test_the_line_has_stop_overspeed_couplers_and_every_failed_criterion() -> None:
    """Breaks if the first line of a report leaves out an answer."""
    judged = judge_run(Criteria(stop_window=0.5, coupler_draft=450e3, coupler_buff=450e3, jerk=0.1), METRICS)
    assert verdict_line({**METRICS, **judged}) == (
        "failed (2 of 4 criteria): coupler draft 500 kN (limit 450); jerk over 1 s 0.2 m/s³ (limit 0.1); "
        "stopped 0.23 m short of the target; overspeed 0.4 km/h; "
        "couplers -400 ... +500 kN (limits -450 ... +450 kN); speed error 0.1 km/h rms; "
        "1 brake intervention"
    )
    limits = Criteria(stop_window=0.2, overspeed=0.1 / 3.6, jerk=0.3)
    places = {"stop_error_max_m": {"at_s": 768.0, "km": 3.69977}, "overspeed_max_kmh": {"at_s": 12.34, "km": 0.1}}
    judged = judge_run(limits, METRICS, places=places)
    assert [row["passed"] for row in judged["criteria"]] == [False, False, True]
    assert verdict_line({**METRICS, **judged}).startswith(
        "failed (2 of 3 criteria): stopped 0.23 m short of the target (limit 0.2) at 768.0 s, km 3.700; "
        "overspeed 0.4 km/h (limit 0.1) at 12.3 s, km 0.100; couplers "
    )
    assert verdict_line({}) == ""
    slow = {**METRICS, "ticks": 200, "ticks_late": 0, "commands_missed": 174, "commands_late": 26}
    assert verdict_line(slow).endswith("; 174 of 200 ticks without a new command, 26 with a late one")
    assert "new command" not in verdict_line({**slow, "commands_missed": 0, "commands_late": 0})
    cut = {"speed_rmse_kmh": 0.1, "speed_rmse_run_kmh": 0.25}
    assert verdict_line(cut).endswith("speed error 0.1 km/h rms, 0.25 km/h with the braking to the stop")


def test_stops_of_a_profile_are_its_rests_and_its_end() -> None:
    """Breaks if the standstill before the start, or a change of direction, counts as a stop."""
    stops = planned_stops(two_stops().profile)
    assert [stop.departure - stop.arrival for stop in stops] == [pytest.approx(20.0, abs=1.0), np.inf]
    turn = setup_of("freight_consensus:realistic")
    assert len(planned_stops(turn.profile)) == 1


def test_every_stop_has_its_error_and_its_delay() -> None:
    """Breaks if only the last stop is evaluated, or the delay is that of another event."""
    setup = two_stops()
    run = on_profile(setup, late=3.0, beyond=0.4)
    first, second = stops_of_run(setup, run)
    assert [first.error, second.error] == pytest.approx([0.4, 0.4], abs=1e-3)
    assert [stop.as_row()["delay_s"] for stop in (first, second)] == pytest.approx([3.0, 3.0], abs=setup.tick)
    figures = summarise(setup, run)
    assert figures["stop_error_max_m"] == pytest.approx(0.4, abs=1e-3)
    profile = setup.profile
    planned = planned_stops(profile)[-1].arrival - float(profile.time[profile.velocity > 0.01][0])
    assert figures["running_time_s"] == pytest.approx(planned, abs=2 * setup.tick)
    assert figures["arrival_delay_max_s"] == pytest.approx(3.0, abs=setup.tick)


@pytest.mark.parametrize(("begin", "end"), [(0.8, 0.2), (3.0, 1.2), (2.0, -1.0)])
def test_a_train_that_moves_before_its_departure_has_arrived_once(begin: float, end: float) -> None:
    """Breaks if a train that departs early has no arrival, or that of one more short halt, a dwell late."""
    setup = two_stops()
    run, first = on_profile(setup, late=3.0, beyond=0.0), planned_stops(setup.profile)[0]
    early = (run.time > first.departure - begin) & (run.time < first.departure - end)
    moved = with_series(run, front_velocity=np.where(early, 0.02, run.front_velocity))
    assert stops_of_run(setup, moved)[0].as_row()["delay_s"] == pytest.approx(3.0, abs=setup.tick)


@pytest.mark.parametrize(("dwell", "rest"), [(20.0, 3.0), (5.0, -1.0)])
def test_a_train_that_runs_through_its_stop_has_not_arrived(dwell: float, rest: float) -> None:
    """Breaks if a rest before it counts: at the start until 3 s after the planned arrival it had -54 s of delay."""
    setup = two_stops(dwell=dwell)
    run, first = on_profile(setup, late=3.0, beyond=0.0), planned_stops(setup.profile)[0]
    through = np.where(run.time <= first.departure, 5.0 * (run.time > first.arrival + rest), run.front_velocity)
    assert stops_of_run(setup, with_series(run, front_velocity=through))[0].arrival is None


def test_a_stop_behind_a_late_train_is_judged_when_the_reference_leaves_it() -> None:
    """Breaks if a train that stops behind a late one later than planned has missed its stop."""
    setup = two_stops()
    behind = replace(setup, scenario=setup.scenario.model_copy(update={"leader": LeaderSpec(headway=60.0)}))
    run = on_profile(setup, late=30.0, beyond=0.4)
    run = with_series(run, reference_position=run.front_position - 0.4, reference_velocity=run.front_velocity)
    assert stops_of_run(setup, run)[0].error is None
    assert stops_of_run(behind, run)[0].as_row()["delay_s"] == pytest.approx(30.0, abs=setup.tick)
    assert stops_of_run(behind, run)[0].error == pytest.approx(0.4, abs=2e-3)
    arrived = int(np.searchsorted(run.time, planned_stops(setup.profile)[0].arrival))
    waiting = slice(arrived, arrived + 20)  # after the planned arrival, but not at the stop
    run.reference_velocity[waiting] = 0.0
    run.reference_position[waiting] -= 50.0
    assert stops_of_run(behind, run)[0].as_row()["delay_s"] == pytest.approx(30.0, abs=setup.tick)


def test_beyond_a_stop_is_in_the_direction_of_the_run() -> None:
    """Breaks if a train that has run back to its stop is short of it with a larger kilometre."""
    setup = setup_of("freight_consensus:realistic", "duration=370")
    (stop,) = stops_of_run(setup, on_profile(setup, late=0.0, beyond=0.4))
    assert (stop.error, stop.as_row()["beyond_m"]) == (pytest.approx(0.4), pytest.approx(-0.4))


def worst_of(limits: str, **series: Any) -> dict[str, tuple[float | None, float | None]]:
    """Return time and place of every criterion of a metro run of 20 s, in 0.1 s, at 10 m/s from km 0 on."""
    setup = setup_of("demo", f"criteria={limits}", "duration=20", "supervision.enabled=false")
    time = 0.1 * np.arange(200)
    units, even = setup.layout.n_units, np.full(200, 10.0)
    given: dict[str, Any] = {
        "front_position": 10.0 * time - setup.consist.vehicles[0].length / 2, "front_velocity": even,
        "velocity": np.repeat(even[:, None], units, axis=1), "position": np.zeros((200, units)) - setup.model.offsets,
        "reference_velocity": even,
    }  # fmt: skip
    run = with_final(recording_of(time, units, **{**given, **series}), 0.0, 10.0)
    metrics = summarise(setup, run)
    rows = judge_run(setup.scenario.criteria, metrics, places=worst_places(setup, run, metrics))["criteria"]
    return {row["criterion"]: (row["at_s"], row["km"]) for row in rows if (row["at_s"], row["km"]) != (None, None)}


def pulse(tick: int, height: float) -> np.ndarray:
    """Return 10 m/s with a pulse of one tick."""
    return 10.0 + height * (np.arange(200) == tick)


@pytest.mark.parametrize(
    ("limits", "series", "at_s", "km"),
    [
        ("{overspeed: 1}", {"front_velocity": pulse(70, 90.0)}, 7.0, 0.07),
        ("{speed_error_rms: 1}", {"velocity": pulse(80, -2.0)[:, None]}, 8.0, 0.08),
        ("{speed_error: 1}", {"velocity": pulse(190, -2.0)[:, None]}, 19.0, 0.19),
        ("{position_error: 1}", {"reference_position": pulse(60, -90.0) - 10.0}, 6.0, 0.06),
        ("{coupler_draft: 1}", {"coupler_draft_max": pulse(33, 2e4)}, 3.3, 0.033),
        ("{coupler_buff: 1}", {"coupler_buff_max": -pulse(44, 2e4)}, 4.4, 0.044),
        ("{acceleration: 1}", {"front_velocity": 10.0 - 3.0 * (np.arange(200) >= 51)}, 5.05, 0.0505),
        ("{jerk: 0.1}", {"front_velocity": 10.0 + np.maximum(0.0, 0.1 * (np.arange(200) - 90))}, 9.0, 0.09),
    ],
)
def test_a_criterion_has_time_and_place_of_its_worst_value(limits, series, at_s, km):
    """Breaks if the place is that of the largest instead of the worst value, of the centre, or of another tick."""
    ((_, place),) = worst_of(limits, **series).items()
    assert place == pytest.approx((at_s, km))


def test_a_criterion_without_a_worst_value_has_no_place() -> None:
    """Breaks if an overspeed or a coupler force of 0 is said to be at the start."""
    assert worst_of("{overspeed: 1, coupler_draft: 1, coupler_buff: 1, jerk: 1, speed_error: 1}") == {}


def test_the_worst_stop_has_its_arrival_and_a_missed_one_its_plan() -> None:
    """Breaks if the place of a stop criterion is that of the last stop, or of the end of the run."""
    setup = two_stops("criteria={stop_window: 0.1, arrival_delay: 1}")
    run = on_profile(setup, late=3.0, beyond=0.4)
    first = stops_of_run(setup, run)[0]
    assert worst_places(setup, run, summarise(setup, run))["stop_error_max_m"] == {
        "at_s": first.arrival, "km": pytest.approx((first.front + 0.4) / 1e3, abs=1e-5)
    }  # fmt: skip
    moving = with_series(run, front_velocity=np.maximum(run.front_velocity, 0.5))
    assert worst_places(setup, moving, summarise(setup, moving))["arrival_delay_max_s"]["at_s"] == first.planned


def test_the_largest_stop_error_has_the_largest_magnitude() -> None:
    """Breaks without the magnitude: 10 m short and 1 m beyond would pass a window of 5 m with 1 m."""
    setup = two_stops("criteria={stop_window: 5}")
    run, first = on_profile(setup, late=0.0, beyond=0.0), planned_stops(setup.profile)[0]
    moved = np.where(run.time <= first.departure, -10.0, 1.0)
    moved = with_final(with_series(run, front_position=run.front_position + moved), run.final[0] + 1.0, 0.0)
    assert [stop.error for stop in stops_of_run(setup, moved)] == pytest.approx([-10.0, 1.0], abs=2e-3)
    metrics = summarise(setup, moved)
    assert metrics["stop_error_max_m"] == pytest.approx(-10.0, abs=2e-3)
    assert judge_run(setup.scenario.criteria, metrics)["verdict"] == "failed"


def test_overspeed_begins_with_the_front_and_ends_with_the_rear() -> None:
    """20 m/s permitted, 10 m/s from 1000 to 1200 m: breaks if vehicle 0's centre, or the sign of 15 m/s, counts."""
    setup = setup_of("demo", "duration=20")
    limits = [SpeedLimit(at=0.0, speed=20.0), SpeedLimit(at=1000.0, speed=10.0), SpeedLimit(at=1200.0, speed=20.0)]
    setup = replace(setup, line=setup.line.model_copy(update={"speed_limits": tuple(limits)}))
    half, length = setup.consist.vehicles[0].length / 2, setup.consist.length
    fronts = np.array([999.9, 1000.1, 1000.0 + half + 0.1, 1199.9 + length, 1200.1 + length])
    for speed in (15.0, -15.0):
        run = recording_of(0.1 * np.arange(5), front_position=fronts - half, front_velocity=np.full(5, speed))
        assert excess_speed(setup, run) == pytest.approx([-5.0, 5.0, 5.0, 5.0, -5.0])


@pytest.mark.parametrize(("until", "ticks"), [(2.0, 21), (1.99, 20), (0.3, 4), (0.7, 8)])
def test_an_evaluation_ends_with_the_tick_at_its_time(until: float, ticks: int) -> None:
    """Breaks if the tick exactly at ``until_time`` is left out, or lost to the rounding of 0.1 s: 3 x 0.1 > 0.3."""
    moving = recording_of(0.1 * np.arange(50), 1, front_velocity=np.ones(50), reference_velocity=np.ones(50))
    assert evaluated_ticks(two_stops(f"evaluation.until_time={until}"), moving) == slice(0, ticks)


def test_errors_of_the_run_include_the_braking_behind_the_evaluation() -> None:
    """Breaks if the largest error of the whole run is that of the evaluated part."""
    setup = two_stops("evaluation.until_time=2")
    figures = summarise(setup, on_profile(setup, late=3.0, beyond=0.0))
    assert figures["speed_error_run_max_kmh"] > figures["speed_error_max_kmh"] + 0.1


def test_jerk_over_a_second_is_the_change_of_the_mean_acceleration() -> None:
    """A ramp of 0.5 m/s³ has 0.5 m/s³; a step of the acceleration by 1 m/s² within 0.1 s has 1 m/s³."""
    for tick in (0.05, 0.1, 0.5):  # accelerations at least 0.1 s apart
        assert mean_jerk_1s(0.2 * np.arange(0.0, 5.0, max(tick, 0.1)), tick) == pytest.approx(0.2)
    time = 0.1 * np.arange(60)
    assert mean_jerk_1s(0.5 * time, 0.1) == pytest.approx(np.full(41, 0.5))
    assert mean_jerk_1s(np.where(time < 3, 0.0, 1.0), 0.1).max() == pytest.approx(1.0)


@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_shipped_scenario_states_criteria_with_their_reasons(name: str) -> None:
    """Breaks if a shipped scenario has no stop window; freight_consensus ends at full speed."""
    assert (load_scenario(name)[0].criteria.stop_window is None) == (name == "freight_consensus")
    if name != "crh380a_gpc":  # the criteria of its base
        text = shipped_scenarios()[name].read_text()
        assert yaml.safe_load(text)["criteria"]
        assert text[: text.index("\ncriteria:")].rsplit("\n", 1)[1].startswith("#")
