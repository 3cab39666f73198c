"""Outcome of tracking: every outcome from made-up series, on both sides of its limit."""

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from engine_runs import setup_of
from recordings import recording_of, with_final, with_series

from train_ato.cli import main
from train_ato.judge.recording import ATO_STATE, Recording
from train_ato.judge.series import TopicSamples
from train_ato.judge.tracking import OUTCOMES, TRACKED, tracking_summary
from train_ato.judge.verdict import is_tracked, outcomes_text, tracking_text, unmet_requirements, verdict_line
from train_ato.loop.engine import run_engine
from train_ato.messages.types import AtoState, Diagnostic
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import RunSetup

SECOND = 1_000_000_000
PLAIN = ("supervision.enabled=false",)


@functools.cache
def demo(*assignments: str) -> RunSetup:
    return setup_of("demo", *PLAIN, *assignments)


def run_of(setup: RunSetup, until: float | None = None, **off: Any) -> Recording:
    """Return a run on its profile up to a time [s], off it in ``position`` [m], ``speed`` [m/s] and ``command``."""
    # Each is a number or a function of the time; the speed changes the position, the command is a share of the force.
    time = setup.tick * np.arange(setup.ticks if until is None else round(until / setup.tick))
    wanted = np.array([setup.profile.at(t) for t in time])
    errors = {
        name: np.broadcast_to(value(time) if callable(value) else value, time.shape).astype(float)
        for name, value in {"position": 0.0, "speed": 0.0, "command": 0.0, **off}.items()
    }
    front = wanted[:, 0] + errors["position"] + setup.tick * np.cumsum(errors["speed"])
    speed = wanted[:, 1] + errors["speed"]
    found = recording_of(
        time, 1, position=front, velocity=speed, front_position=front, front_velocity=speed,
        command=errors["command"] * setup.model.traction[0].largest(), reference_position=wanted[:, 0],
        reference_velocity=wanted[:, 1],
    )  # fmt: skip
    return with_final(found, float(front[-1]), float(speed[-1]))


def outcome(setup: RunSetup, recording: Recording) -> str:
    return str(tracking_summary(setup, recording)["tracking"])


def top_speed(setup: RunSetup) -> float:
    return float(np.abs(setup.profile.velocity).max())


def test_outcomes_of_several_runs_are_counted_where_they_differ() -> None:
    """Breaks if the outcome of one run of several is that of all, or if the figure of a single outcome is lost."""
    good = {"tracking": TRACKED, "tracking_findings": []}
    bad = {"tracking": "limit cycle", "tracking_findings": [{"outcome": "limit cycle", "text": "command ±88 kN"}]}
    assert outcomes_text([good, good]) == TRACKED
    assert outcomes_text([bad]) == "limit cycle: command ±88 kN"
    assert outcomes_text([good, bad, good]) == "tracked 2, limit cycle 1"


def test_a_train_on_its_reference_is_tracked() -> None:
    """Breaks if a regular run, with its stop, has a finding."""
    summary = tracking_summary(demo(), run_of(demo()))
    assert summary == {"tracking": TRACKED, "tracking_findings": []}
    assert is_tracked(summary) and tracking_text(summary) == TRACKED and unmet_requirements(summary) == ""


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("factor", "found"), [(1.01, "lost"), (0.99, TRACKED)])
def test_a_position_error_at_the_end_beyond_the_way_of_ten_seconds_is_lost(factor, found, sign):
    """Breaks if the limit is not the running time at the largest speed, or the sign is wrong."""
    setup = demo()
    error = sign * factor * 10.0 * top_speed(setup)
    summary = tracking_summary(setup, run_of(setup, 400.0, position=lambda t: error * t / t[-1]))
    assert summary["tracking"] == found
    if found == "lost":
        row = summary["tracking_findings"][0]
        assert row["value"] == pytest.approx(error, abs=0.1) and row["limit"] == pytest.approx(10.0 * top_speed(setup))
        side = "ahead" if sign > 0 else "behind"
        assert row["text"] == f"{abs(error):.1f} m {side} at the end"


@pytest.mark.parametrize(("factor", "found"), [(1.01, "lost"), (0.99, TRACKED)])
@pytest.mark.parametrize("start", [0.0, 15.0])
def test_a_position_error_on_the_way_is_lost_beyond_that_of_the_start(start: float, factor: float, found: str) -> None:
    """Breaks if a train that came back counts as tracked, or a distant start as lost."""
    setup = demo()
    peak = factor * (10.0 * top_speed(setup) + start)
    error = run_of(
        setup, 600.0, position=lambda t: np.interp(t, [0, 100, 200, 300, 600], [start, start, peak, 0.0, 0.0])
    )
    summary = tracking_summary(setup, error)
    assert summary["tracking"] == found
    if found == "lost":
        assert summary["tracking_findings"][0]["text"] == f"{peak:.1f} m ahead at 200 s, 0 m behind at the end"


def test_the_largest_position_error_of_several_units_counts() -> None:
    setup = setup_of("crh380a_gpc:short", "plant.consist=crh380a_three_units", *PLAIN)
    one = run_of(setup, 60.0)
    limit = 10.0 * top_speed(setup)
    for error, found in ((1.01 * limit, "lost"), (0.99 * limit, TRACKED)):
        units = one.position - setup.model.offsets
        units[-1, -1] -= error
        topics = dict(one.topics)
        truth = topics["train/vehicles"]
        extended = np.concatenate((units, units[-1:]))
        topics["train/vehicles"] = TopicSamples(truth.time, {**truth.values, "unit_position": extended})
        assert outcome(setup, replace(one, topics=topics)) == found


@pytest.mark.parametrize(("kmh", "seconds", "found"), [(7.6, 10.1, "lost"), (7.4, 10.1, TRACKED), (7.6, 9.8, TRACKED)])
def test_a_speed_error_at_the_end_beyond_the_emergency_margin_is_lost(kmh: float, seconds: float, found: str) -> None:
    """Breaks if the margin is not 7.5 km/h below 110 km/h, or a short error counts."""
    setup = demo()
    late = run_of(setup, 300.0, speed=lambda t: np.where(t > 300.0 - seconds, kmh / 3.6, 0.0))
    summary = tracking_summary(setup, late)
    assert summary["tracking"] == found
    if found == "lost":
        assert summary["tracking_findings"][0]["text"] == f"at least {kmh:g} km/h too fast in the last 10 s"


@pytest.mark.parametrize(("kmh", "share", "found"), [(7.6, 0.56, "lost"), (7.6, 0.48, TRACKED), (7.4, 1.0, TRACKED)])
def test_a_speed_error_in_half_of_the_time_is_lost(kmh: float, share: float, found: str) -> None:
    """A speed that swings about its reference; breaks if a train near its position, but never at its speed, passes."""
    swing = kmh / 3.6 * (-1.0) ** np.arange(60).repeat(50)
    swinging = run_of(demo(), 300.0, speed=lambda t: np.where(t < share * 300.0, swing, 0.0))
    assert outcome(demo(), swinging) == found


@pytest.mark.parametrize(("seconds", "found"), [(20.3, "never departed"), (19.7, TRACKED)])
def test_a_train_at_rest_behind_a_moving_reference_never_departed(seconds: float, found: str) -> None:
    """Breaks if the time of the rest is not that from the departure of the reference, or that of its shortest move."""
    setup = demo("criteria.tracking.position_time=100")
    moving = np.flatnonzero(setup.profile.velocity >= 0.05)[0] * setup.profile.period
    still = run_of(setup, moving + seconds)
    zeros, speed = np.zeros(still.time.size), still.reference_velocity.copy()
    speed[np.flatnonzero(speed >= 0.05)[1]] = 0.0  # a first move of one tick
    series = {"velocity": zeros, "front_velocity": zeros, "reference_velocity": speed}
    summary = tracking_summary(setup, with_series(still, **series))
    assert summary["tracking"] == found
    if found != TRACKED:
        assert "while the reference moved" in summary["tracking_findings"][0]["text"]


def wave(amplitude: float, period: float, begin: float = 100.0, end: float = 300.0) -> Any:
    return lambda t: np.where((t >= begin) & (t < end), amplitude * np.sin(2 * np.pi * (t - begin) / period), 0.0)


def dead_time(setup: RunSetup) -> float:
    return float(max(setup.model.delay[0], setup.model.delay_brake[0])) + setup.model.lag + setup.control_period


@pytest.mark.parametrize(("amplitude", "periods", "seconds", "found"), [
    (0.11, 4.0, 200.0, "limit cycle"), (0.09, 4.0, 200.0, TRACKED), (0.3, 19.6, 200.0, "limit cycle"),
    (0.3, 21.0, 200.0, TRACKED), (0.3, 1.0, 12.0, "limit cycle"), (0.3, 1.0, 9.0, TRACKED),
])  # fmt: skip
def test_a_sustained_oscillation_of_the_command_is_a_limit_cycle(amplitude, periods, seconds, found):
    """Breaks if amplitude, longest period or shortest duration is not that of the definition."""
    setup = demo()
    period = periods * dead_time(setup)
    recording = run_of(setup, 400.0, command=wave(amplitude, period, 100.0, 100.0 + seconds))
    summary = tracking_summary(setup, recording)
    assert summary["tracking"] == found
    if found != TRACKED:
        force = setup.model.traction[0].largest() / 1e3
        row = summary["tracking_findings"][0]
        assert row["value"] == pytest.approx(amplitude * force, rel=0.03)
        assert row["limit"] == pytest.approx(0.1 * force)
        assert f"period of {period:.3g} s" in row["text"]


def noise_of(seed: int, smooth: int, count: int = 4000) -> np.ndarray:
    """Return the sliding mean of white noise over some ticks, with the standard deviation 0.3."""
    white = np.random.default_rng(seed).standard_normal(count + smooth)
    return 0.3 * np.convolve(white, np.ones(smooth) / np.sqrt(smooth), mode="valid")[:count]


def test_noise_is_no_limit_cycle() -> None:
    """White or coloured noise with a third of the force, 1 % of false alarms; breaks without one of the tests."""
    setup = demo()
    recording = run_of(setup, 400.0)
    force = setup.model.traction[0].largest()
    alarms = [
        (seed, smooth)
        for seed in range(24)
        for smooth in (1, 3, 10, 20, 40)
        if outcome(setup, with_series(recording, command=force * noise_of(seed, smooth))) != TRACKED
    ]
    assert len(alarms) <= 1, alarms


def test_a_limit_cycle_between_noise_is_found() -> None:
    """Breaks if irregular swings before and after an oscillation are counted with it."""
    setup = demo()
    command = noise_of(1, 10)
    command[2500:3000] = 0.3 * np.sin(2 * np.pi * 0.1 * np.arange(500) / 5.0)
    summary = tracking_summary(setup, run_of(setup, 400.0, command=command))
    assert summary["tracking"] == "limit cycle"
    assert "period of 5 s" in summary["tracking_findings"][0]["text"]


@pytest.mark.parametrize(
    ("command", "found"),
    [
        (lambda t, period: 0.3 * (-1.0) ** np.arange(t.size), "limit cycle"),
        (lambda t, period: 0.5 * np.sign(np.sin(2 * np.pi * t / 100.0)), TRACKED),
        (lambda t, period: np.exp(-t / (2 * period)) * np.sin(2 * np.pi * t / period), TRACKED),
    ],
    ids=["switching at every tick", "phases", "decaying"],
)
def test_switching_is_a_limit_cycle_and_steps_and_decaying_oscillations_are_none(command: Any, found: str) -> None:
    """Breaks if the phases of a profile, or an oscillation that dies out, count as sustained, or switching does not."""
    setup = demo()
    shaken = {"position": lambda t: 2e-3 * (-1.0) ** np.arange(t.size)}  # within a tick: no drift speed of 0.04 m/s
    assert outcome(setup, run_of(setup, 400.0, command=lambda t: command(t, 5 * dead_time(setup)), **shaken)) == found


def test_an_oscillating_reference_is_no_limit_cycle() -> None:
    """Breaks if the inertial force of the reference counts as an oscillation of the law."""
    setup = demo()
    acceleration = 0.3 * setup.model.traction[0].largest() / setup.model.inertia
    found = run_of(setup, 400.0, command=wave(0.3, 5 * dead_time(setup)))
    same = acceleration * wave(1.0, 5 * dead_time(setup))(found.time)
    assert outcome(setup, found) == "limit cycle"
    assert outcome(setup, with_series(found, reference_acceleration=same)) == TRACKED


@pytest.mark.parametrize(
    ("strength", "beside", "found"),
    [(0.0, 0.0, "limit cycle"), (1.0, 0.0, TRACKED), (1.0, 1.5, TRACKED), (1.0, 5.0, "limit cycle")],
)
def test_the_answer_to_a_periodic_disturbance_is_no_limit_cycle(strength: float, beside: float, found: str) -> None:
    """Breaks if a command that cancels a sine of the disturbance, alone or beside a larger one, is that of the loop."""
    setup = demo()
    answer = run_of(setup, 400.0, command=wave(-0.3, 5 * dead_time(setup)))
    delayed = wave(1e5 * strength, 5 * dead_time(setup))(answer.time + 1.0)
    fast = wave(1e5 * beside, 1.5 * dead_time(setup))(answer.time)
    forces = delayed + fast + np.random.default_rng(1).standard_normal(delayed.size)
    assert outcome(setup, with_series(answer, disturbance=forces)) == found


def test_turbulence_is_not_the_cause_of_a_limit_cycle() -> None:
    """Breaks if random forces that have any period count as the cause."""
    cycle = run_of(demo(), 400.0, command=wave(-0.3, 5 * dead_time(demo())))
    for seed in range(12):
        windy = with_series(cycle, disturbance=1e5 * noise_of(seed, 20))
        assert outcome(demo(), windy) == "limit cycle", seed


@pytest.mark.parametrize(("window", "error", "found"), [
    ("5", 5.05, "stopped beyond"), ("5", 4.95, TRACKED), ("5", -5.05, "stopped short"), ("5", -4.95, TRACKED),
    ("null", 12.1, "stopped beyond"), ("null", 11.9, TRACKED),
])  # fmt: skip
def test_a_stop_outside_of_the_window(window: str, error: float, found: str) -> None:
    """Breaks if the window is not that of the criteria, or the sign is wrong."""
    setup = demo(f"criteria.stop_window={window}")
    summary = tracking_summary(setup, run_of(setup, position=lambda t: error * t / t[-1]))
    assert summary["tracking"] == found
    if found != TRACKED:
        side = "beyond" if error > 0 else "short of"
        assert summary["tracking_findings"][0]["text"] == f"{abs(error):.4g} m {side} the target"


@pytest.mark.parametrize(
    ("seconds", "error", "found"),
    [(10.4, 5.1, "not stopped"), (9.6, 5.1, TRACKED), (10.4, 4.5, TRACKED), (10.4, -5.5, "not stopped")],
)
def test_a_train_that_moves_outside_of_the_window_has_not_stopped(seconds: float, error: float, found: str) -> None:
    """Breaks if a missing standstill is no finding, or one within the stop window or soon after the arrival is."""
    setup = demo()
    arrival = float(setup.profile.time[np.flatnonzero(np.abs(setup.profile.velocity) >= 0.01)[-1] + 1])
    rolling = run_of(setup, arrival + seconds, position=error, speed=lambda t: np.where(t > arrival - 5, 0.02, 0.0))
    assert outcome(setup, rolling) == found


@pytest.mark.parametrize(("seconds", "kmh", "force", "found"), [
    (12, -2.1, 1.0, "saturated"), (12, 2.1, -1.0, "saturated"), (10, -2.1, 1.0, TRACKED), (12, -1.9, 1.0, TRACKED),
    (12, 2.1, 1.0, TRACKED), (12, -2.1, -1.0, TRACKED),
])  # fmt: skip
def test_a_force_limit_with_a_speed_error_is_saturated(seconds: int, kmh: float, force: float, found: str) -> None:
    """Breaks if saturation without an error, or with an error that less force reduces, counts."""
    setup = demo()
    slow = run_of(
        setup, 300.0, speed=lambda t: np.where((t >= 100) & (t < 150), kmh / 3.6, 0.0), command=lambda _: force
    )
    counts = [(t, float(np.clip(t - 110, 0, seconds))) for t in range(300)]
    reports = tuple(Diagnostic(t * SECOND, "plant", 0, "", {"saturated": str(value)}) for t, value in counts)
    summary = tracking_summary(setup, replace(slow, kept_reports=reports))
    assert summary["tracking"] == found
    if found != TRACKED:
        assert summary["tracking_findings"][0]["value"] == seconds


def with_ato(recording: Recording, *spans: tuple[float, float]) -> Recording:
    """Return the recording with an ATO that is engaged in these times [s]."""
    time = recording.time[::4]
    engaged = np.any([(time >= begin) & (time < end) for begin, end in spans], axis=0)
    states = np.where(engaged, float(AtoState.ENGAGED), float(AtoState.READY))
    return replace(recording, topics={**recording.topics, ATO_STATE: TopicSamples(time, {"state": states[:, None]})})


def test_only_the_engaged_ato_is_evaluated() -> None:
    """Breaks if the position error of a train without its ATO counts, or a disengaged ATO is no outcome."""
    setup = demo()
    far = run_of(setup, 400.0, position=lambda t: np.where(t > 200, 500.0, 0.0), command=wave(0.5, 5.0, 250.0, 390.0))
    assert outcome(setup, far) == "lost"
    summary = tracking_summary(setup, with_ato(far, (0.0, 150.0)))
    assert [row["outcome"] for row in summary["tracking_findings"]] == ["disengaged"]
    assert summary["tracking_findings"][0]["text"] == "the ATO, at 150.0 s"
    back = run_of(setup, 400.0, position=lambda t: np.where((t > 200) & (t < 301), 500.0, 0.0))
    assert outcome(setup, with_ato(back, (0.0, 150.0), (300.0, 400.0))) == TRACKED
    assert outcome(setup, with_ato(back, (0.0, 150.0), (290.0, 400.0))) == "lost"


def test_the_worst_outcome_is_the_first() -> None:
    """Breaks if a limit cycle hides a lost train, or a finding is left out."""
    setup = demo()
    bad = run_of(setup, 400.0, position=lambda t: t, command=wave(0.5, 5.0))
    summary = {**tracking_summary(setup, bad), "speed_rmse_kmh": 1.0}
    assert [row["outcome"] for row in summary["tracking_findings"]] == ["lost", "limit cycle"]
    assert verdict_line(summary).startswith("lost: 400 m ahead at the end; no criteria: ")
    assert not is_tracked(summary) and unmet_requirements(summary) == "lost: 400 m ahead at the end"
    assert OUTCOMES[-1] == TRACKED


@pytest.mark.parametrize(("key", "value"), [
    ("position_time", 30), ("oscillation", 0.6), ("oscillation_time", 150), ("departure_time", 5),
    ("saturation_time", 5), ("saturation_error_kmh", 1),
])  # fmt: skip
def test_the_limits_are_keys_of_a_scenario(key: str, value: float) -> None:
    """Breaks if a key is not read, or not checked like every other one."""
    found, usual = (load_scenario("demo", more)[0].criteria for more in ((f"criteria.tracking.{key}={value}",), ()))
    assert found.tracking != usual.tracking
    with pytest.raises(ValueError, match=key.removesuffix("_kmh")):
        load_scenario("demo", (f"criteria.tracking.{key}=-1",))


def test_a_strict_run_that_is_not_tracked_has_exit_status_1(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if --strict accepts a lost train or a failed criterion, or rejects a tracked run."""
    short = ["run", "demo", "--engine", "--set=duration=60"]
    assert main([*short, "--strict", f"--out={tmp_path / 'a'}"]) == 0
    lost = [*short, "--set=criteria.tracking.position_time=0.001"]
    assert main([*lost, f"--out={tmp_path / 'b'}"]) == 0
    assert capsys.readouterr().out.count("lost: ") == 1
    assert main(["info", str(tmp_path / "b")]) == 0
    assert "deviations from the reference" in capsys.readouterr().out
    assert main([*lost, "--strict", f"--out={tmp_path / 'c'}"]) == 1
    assert f"train-ato: {tmp_path / 'c'}: lost: " in capsys.readouterr().err
    failed = [*short, "--set=criteria.speed_error_kmh=0.0001", "--strict", f"--out={tmp_path / 'd'}"]
    assert main(failed) == 1
    assert "speed error of the run" in capsys.readouterr().err
    compared = ["compare", "demo", "--laws=pid", "--set=duration=60", "--strict"]
    assert main([*compared, f"--out={tmp_path / 'e'}"]) == 0
    assert main([*compared, "--set=criteria.tracking.position_time=0.001", f"--out={tmp_path / 'f'}"]) == 1
    said = capsys.readouterr()
    assert "lost!" in said.out and "not tracked: pid: lost: " in said.out and "pid: lost: " in said.err


@pytest.mark.campaign
@pytest.mark.parametrize(("scenario", "changes", "found"), [
    ("freight_consensus:realistic", {"law": "pid", "observer": "cascaded", "compensation": "train_predictor"},
     ["lost", "limit cycle", "saturated"]),
    ("freight_consensus:realistic", {}, [TRACKED]),
    ("daqin_heavy_haul",
     {"law": "gpc", "laws": {"gpc": {"gains": "printed"}}, "control_period": 0.2, "duration": 200},
     ["limit cycle"]),
    ("crh380a_gpc:short", {"laws": {"gpc": {"gains": "printed", "sampling": 0.2}}, "duration": 120},
     ["never departed", "lost", "saturated"]),
    ("xuzhou_metro:long_delay", {"duration": 200, "step": 0.005}, ["limit cycle", "saturated"]),
    ("xuzhou_metro:disturbed", {"duration": 120, "step": 0.005}, [TRACKED]),
    ("demo", {"duration": 200}, [TRACKED]),
])  # fmt: skip
def test_driven_runs_have_the_outcome_that_their_figures_show(scenario, changes, found):
    """Breaks if a law that loses the train is called tracked, or the answer to the waves of paper 002 a limit cycle."""
    summary = run_engine(setup_of(scenario, changes=changes)).summary
    rows = summary["tracking_findings"]
    assert summary["tracking"] == found[0]
    assert found == [TRACKED] if not rows else {row["outcome"] for row in rows} <= set(found)
