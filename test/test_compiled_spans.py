"""Compiled ticks give messages and recording of the ticks in Python, bit for bit: laws, components, supervisor."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from case_costs import sampled
from span_runs import Both, setup_of

from plant_sim.plant_setup import Sensors
from plant_sim.sensors import SensorSet
from plant_sim.states import VehicleStates
from train_ato.control.compiled.law_call import is_in_loop
from train_ato.loop.engine import COMPILED_FROM, TickLoop, run_engine
from train_ato.loop.recording import BRAKE_PIPE_COMMAND
from train_ato.loop.spans import kernel
from train_ato.loop.train_protection import TrainProtection, command_age
from train_ato.messages.links import DelayJump

FREE = {"supervision.enabled": False}
HEAVY = {**FREE, "duration": 60, "tick": 0.05}
NOISE = {
    "plant.sensors": {
        "couplers": [0, 52], "position_noise": 0.1, "velocity_noise": 0.02, "force_noise": 1e3,
        "deflection_noise": 1e-4, "position_bias": 0.3, "velocity_bias": 0.01, "position_quantum": 0.01,
        "velocity_quantum": 0.001,
    }
}  # fmt: skip
BRAKE = {"brake": {"policy": "planned", "events": [{"time": 20, "reduction": 5e4}, {"place": 900, "reduction": 0}]}}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "pid, air brake by time and place": ("daqin_heavy_haul", {**HEAVY, **BRAKE}),
    "pid under preview, air brake": ("daqin_heavy_haul", {**HEAVY, **BRAKE, "compensation": "preview"}),
    "pid under twin, air brake": ("daqin_heavy_haul:twin", {**HEAVY, **BRAKE}),
    "pid with filters, noise": (
        "daqin_heavy_haul",
        {**HEAVY, **NOISE, "laws.pid": {"kp": 0.03, "kd": 0.1, "filter_time": 0.5, "integral": "speed"}},
    ),
    "pid, forces, without feed-forward": (
        "xuzhou_metro",
        {"duration": 60, "law": "pid", "compensation": "none",
         "laws.pid": {"per_mass": False, "kp": 3e5, "ki": 1e3, "feedforward": False}},
    ),
    "pid, slow control": ("crh380a_funnel:short", {**FREE, "duration": 60, "control_period": 0.2}),
    "smc, couplers measured": ("daqin_heavy_haul:ideal", {**HEAVY, **BRAKE, "law": "smc"}),
    "smc, feed-forward": (
        "xuzhou_metro", {"duration": 60, "law": "smc", "laws.smc": {"equivalent": "feedforward", "phi": 0.1}}
    ),
    "funnel": ("crh380a_funnel:short", {**FREE, "duration": 60, "law": "funnel", "compensation": "none"}),
    "funnel, feed-forward, three units": (
        "crh380a_gpc:short", {**FREE, "duration": 60, "law": "funnel", "compensation": "preview",
                              "laws.funnel": {"feedforward": True}},
    ),
    "fixed_time_smc, feed-forward": (
        "crh380a_gpc:short", {**FREE, "duration": 60, "law": "fixed_time_smc", "compensation": "preview",
                              "laws.fixed_time_smc": {"equivalent": "feedforward", "unmatched": True}},
    ),
    "funnel, printed": (
        "crh380a_funnel:short",
        {**FREE, "duration": 60, "law": "funnel", "compensation": "none",
         "laws.funnel": {"variant": "printed", "outside_funnel": "printed", "kappa": "printed"}},
    ),
    "funnel, printed, resistance of the model": (
        "crh380a_funnel:short",
        {**FREE, "duration": 60, "law": "funnel", "compensation": "none",
         "laws.funnel": {"variant": "printed", "resistance": "model"}},
    ),
    "funnel, resistance of the model, air brake": (
        "daqin_heavy_haul", {**HEAVY, **BRAKE, "law": "funnel", "compensation": "none",
                             "laws.funnel": {"resistance": "both"}},
    ),
    "funnel, three units": ("crh380a_gpc:short", {**FREE, "duration": 60, "law": "funnel", "compensation": "none"}),
    "pid, delays by unit and sign, jump": (
        "crh380a_gpc:jump", {**FREE, "duration": 300, "law": "pid", "compensation": "preview"}
    ),
    "law changes": (
        "demo", {**FREE, "duration": 100, "law_changes": [{"at": 20.05, "law": "smc"}, {"at": 40, "law": "pid"}],
                 "plant.sensors.couplers": [0]},
    ),
    "disturbances": (
        "daqin_heavy_haul",
        {**HEAVY, "plant.disturbances": [
            {"kind": "eq40"}, {"kind": "turbulence", "acceleration_rms": 0.01, "correlation": 3.0},
            {"kind": "gust", "begin": 10.0, "end": 30.0, "acceleration": 0.05},
        ]},
    ),
    "jumps by time and place, separation": (
        "daqin_heavy_haul",
        {**HEAVY, "plant.jumps": [
            {"at": 20.01, "what": "mass", "factor": 1.1}, {"place": 700, "what": "gain", "factor": 0.9},
            {"at": 40, "what": "coupler", "vehicles": [50]},
        ]},
    ),
    "sensors that freeze and slip": (
        "crh380a_gpc:short",
        {**FREE, "duration": 60, "law": "pid", "compensation": "preview", "plant.sensors": {
            "freeze": [{"begin": 20, "end": 21, "quantity": "velocity"}, {"begin": 30, "end": 31, "unit": 1}],
            "wheel_slip": [{"begin": 10, "end": 12, "slip": 0.1}, {"begin": 11, "end": 13, "slip": -0.2, "unit": 2}],
        }},
    ),
    "commands late and lost at random": (
        "crh380a_gpc:short",
        {**FREE, "duration": 60, "law": "pid", "compensation": "preview",
         "links.command": {"delay": [0.3, 0.5, 0.4], "delay_brake": 0.1, "jitter": 0.3, "loss": 0.2}},
    ),
    "to the stop": ("xuzhou_metro", {"law": "pid"}),
}  # fmt: skip
"""Scenario and changes; together they contain every kind of event that ends a span."""


@pytest.mark.parametrize("case", CASES)
def test_compiled_ticks_give_messages_and_recording_of_python(case: str) -> None:
    """Breaks if law, sensor, delay line, disturbance, brake or diagnostics of compiled ticks differ in one bit."""
    # An array of a span in another order, shape or reduction than the messages does too, and a condition that leaves a
    # whole run to Python, which would be compared with itself.
    Both(setup_of(*CASES[case])).assert_equal(least=0.4)


def test_the_kernel_is_compiled_once() -> None:
    """Breaks if a run or a component gives an array in another layout: the kernel is compiled again, for 20 s."""
    laws = ("funnel", "funnel, three units", "pid, air brake by time and place", "disturbances")
    components = ("predictor, springs, three units", "eso of the train, pid", "policy trigger")
    short = ((COMPONENTS[case][0], {**COMPONENTS[case][1], "duration": 5}) for case in components)
    for name, changes in [*(CASES[case] for case in laws), *short]:
        run_engine(setup_of(name, changes), compiled=True)
    assert len(getattr(kernel.run_span, "signatures", [None])) == 1  # missing with NUMBA_DISABLE_JIT


def test_a_long_run_is_compiled_by_default_and_has_no_step_time() -> None:
    """Breaks if long runs stay in Python, or if the time of the first tick counts as that of the law."""
    name, changes = CASES["pid, slow control"]
    long = run_engine(setup_of(name, {**changes, "duration": COMPILED_FROM * 0.05}))
    short = run_engine(setup_of(name, {**changes, "duration": 10}))
    assert long.summary.get("step_time_us_median") is None
    assert short.summary["step_time_us_median"] > 0.0


def test_noise_ahead_is_the_noise_of_the_ticks() -> None:
    """Breaks if a look ahead at the noise of coming ticks draws other numbers or loses some."""
    sensors = Sensors(position_noise=0.1, velocity_noise=0.01)
    plain, ahead = (SensorSet(sensors, (0, 1), np.zeros(2), 0.05, 7) for _ in range(2))
    state = VehicleStates(0, np.array([10.0, 0.0]), np.array([1.0, 1.0]), np.zeros(2))
    for count in (1, 200, 40, 300, 5):
        assert ahead._position_noise is not None and ahead._velocity_noise is not None
        expected = np.array(ahead._position_noise.ahead(count))
        measured = [plain.measure(state, np.zeros(2)).position - state.position for _ in range(count)]
        assert np.abs(np.array(measured) - expected).max() < 1e-14
        ahead._position_noise.skip(count)


METRO = {"duration": 30}
THREE = {**FREE, "duration": 40, "links.command.delay_brake": None, "model.delay_brake": None}
EARLY_AND_LATE = {
    "brake": {"policy": "planned", "events": [{"time": 10, "reduction": 5e4}, {"time": 40, "reduction": 0}]}
}
TRIP = {
    "brake": {
        "policy": "trip", "events": [],
        "applications": [{"apply": 100, "release": 180, "reduction": 5e4, "electric_at_apply": 0.5,
                          "electric_at_release": 0.1}],
        "trip": {"shift": 40, "never_below": 2.0, "after": 1.0},
    }
}  # fmt: skip
TRIGGER = {
    "brake": {
        "policy": "trigger", "events": [],
        "trigger": {"min_speed": 2.0, "segments": 1, "grade_below": -1e-3, "min_length": 50.0, "release_drop": 0.3,
                    "never_below": 1.0},
    }
}  # fmt: skip
BLEND = {
    "brake": {
        "policy": "blend", "events": [],
        "blend": {"call": 0.3, "call_after": 1.0, "ease": 0.1, "ease_after": 1.0, "pause": 5.0, "never_below": 1.0},
    }
}  # fmt: skip
PREDICTIVE = {
    "brake": {
        "policy": "predictive", "events": [],
        "predictive": {"electric_use": 0.02, "never_below": 1.0, "min_application": 10.0, "pause": 10.0},
    }
}  # fmt: skip
LATER_BRAKE = {"brake": {"policy": "planned", "events": [{"time": 70, "reduction": 5e4}, {"time": 90, "reduction": 0}]}}
"""Not at 10 s: with gains that fit, a slow departure would end at a standstill, whose ticks are left to Python."""
EARLY_BRAKE = {"brake": {"policy": "planned", "events": [{"time": 40, "reduction": 5e4}]}}
WHOLE = {"observers.ndo": {"omega": 0.03, "scope": "train"}, "laws.pid.disturbance": True}
COMPONENTS: dict[str, tuple[str, dict[str, Any]]] = {
    "eso of the train, pid": ("xuzhou_metro:disturbed", {**METRO, "observer": "eso", "laws.pid.disturbance": True}),
    "ndo of the vehicle, rbf_smc, air brake": (
        "daqin_heavy_haul:ideal", {**FREE, "duration": 120, **LATER_BRAKE, "observer": "ndo", "law": "rbf_smc"}
    ),
    "ndo of the train, air brake": (
        "daqin_heavy_haul", {**FREE, "duration": 80, **EARLY_AND_LATE, "observer": "ndo", **WHOLE}
    ),
    "cascaded by Levant, fixed_time_smc": ("freight_consensus", {"duration": 1.5}),
    "cascaded with implicit signs": (
        "freight_consensus", {"duration": 1.5, "observers.cascaded": {"method": "implicit", "unmatched": False}}
    ),
    "cascaded with explicit signs": (
        "freight_consensus",
        {"duration": 1.5, "observers.cascaded.method": "explicit", "laws.fixed_time_smc.unmatched": False},
    ),
    "predictor, springs, three units": (
        "crh380a_gpc:tuned", {**THREE, "law": "lag_smc", "compensation": "predictor", "observer": "eso"}
    ),
    "predictor without estimate, common command": (
        "crh380a_gpc:tuned",
        {**THREE, "law": "lag_smc", "laws.lag_smc.command": "common", "compensation": "predictor", "observer": "ndo",
         "compensations.predictor.disturbance": False},
    ),
    "predictor, chain of five units": ("freight_consensus:realistic", {"duration": 3}),
    "predictor, estimated delay": (
        "xuzhou_metro", {**METRO, "compensation": "predictor", "compensations.predictor.delay": "estimated"}
    ),
    "predictor, delays by sign": (
        "crh380a_gpc:short", {**FREE, "duration": 40, "law": "lag_smc", "compensation": "predictor"}
    ),
    "preview, delays by sign, air brake": (
        "daqin_heavy_haul", {**FREE, "duration": 60, "law": "smc", "compensation": "preview",
                             "model.delay_brake": 0.6, **EARLY_BRAKE}
    ),
    "train_predictor, air brake": (
        "daqin_heavy_haul", {**FREE, "duration": 60, "law": "smc", "compensation": "train_predictor", **EARLY_BRAKE}
    ),
    "twin that identifies the train": (
        "demo", {**FREE, "duration": 40, "compensation": "twin", "compensations.twin.identify": True}
    ),
    "mpc, limits ahead": ("xuzhou_metro", {"duration": 20, "law": "mpc"}),
    "predictor, funnel": (
        "xuzhou_metro:tuned+disturbed", {**METRO, "law": "funnel", "compensation": "predictor", "observer": "eso"}
    ),
    "rbf_smc as in the paper": (
        "xuzhou_metro:tuned",
        {**METRO, "law": "rbf_smc", "observer": "ndo",
         "laws.rbf_smc": {"equivalent": "feedforward", "clip": False, "ndo_omega": 5.0, "anti_windup": False}},
    ),
    "rbf_switching_smc": (
        "crh380a_gpc:tuned", {**FREE, "duration": 40, "law": "rbf_switching_smc", "compensation": "preview"}
    ),
    "rbf_switching_smc, measured derivatives": (
        "xuzhou_metro", {**METRO, "law": "rbf_switching_smc", "laws.rbf_switching_smc.derivatives": "measured"}
    ),
    "rbf_switching_smc, printed forms": (
        "xuzhou_metro:tuned+disturbed",
        {**METRO, "law": "rbf_switching_smc",
         "laws.rbf_switching_smc": {"objective": "printed_acceleration", "rbfi_input": "command", "clip": False,
                                    "sensitivity": "value", "alpha": 0.0}},
    ),
    "pade, air brake": ("daqin_heavy_haul", {**FREE, "duration": 130, **EARLY_AND_LATE, "compensation": "pade"}),
    "policy trip": ("daqin_heavy_haul", {**FREE, "duration": 160, **TRIP, "observer": "ndo", **WHOLE}),
    "policy trigger": ("daqin_heavy_haul", {**FREE, "duration": 130, **TRIGGER}),
    "policy blend": ("demo", {**FREE, "duration": 470, **BLEND}),
    "policy predictive": (
        "demo", {**FREE, "duration": 610, **PREDICTIVE, "observer": "ndo", **WHOLE}
    ),
}  # fmt: skip
"""Scenario and changes, for every component with a compiled step, and for compensations called in compiled ticks."""


@pytest.mark.parametrize("case", sampled(COMPONENTS, every=2))
def test_compiled_components_send_the_messages_of_python(case: str) -> None:
    """Breaks if an observer, a prediction, a law or a policy differs in one bit, or runs in Python after all."""
    Both(setup_of(*COMPONENTS[case])).assert_equal(least=0.7)


def test_policies_of_the_cases_change_the_pressure() -> None:
    """Breaks if an application or a release is not reached, so that the comparison above has no decision in it."""
    for case in ("policy trip", "policy trigger", "policy blend", "policy predictive"):
        recording = run_engine(setup_of(*COMPONENTS[case]), compiled=True).recording
        assert recording is not None
        pressure = recording.topics[BRAKE_PIPE_COMMAND]["pressure"].ravel()
        assert np.count_nonzero(np.diff(pressure)) >= 2, case


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("freight_consensus", {"laws.fixed_time_smc.states": "estimated", "duration": 1.0}),
        ("xuzhou_metro", {"law": "gpc", "compensation": "none", **METRO}),
    ],
)
def test_laws_without_a_compiled_step_are_called_in_python(name: str, changes: dict[str, Any]) -> None:
    """Breaks if a parameter that the compiled step lacks is accepted: the run would have the numbers of another one."""
    loop = TickLoop(setup_of(name, changes), None)
    loop.start()
    assert loop.controller.stack is not None
    assert not is_in_loop(loop.controller.stack.law)
    Both(setup_of(name, changes)).assert_equal()


SHORT = {"duration": 130}
SUPERVISED: dict[str, tuple[str, dict[str, Any]]] = {
    "demo to its stop": ("demo", {}),
    "heavy haul": ("daqin_heavy_haul", SHORT),
    "twin, disturbances, noise": ("daqin_heavy_haul:twin+disturbed+noise", SHORT),
    "mismatch, smc": ("daqin_heavy_haul:tuned+strong_mismatch", {**SHORT, "law": "smc", "compensation": "twin"}),
    "overspeed on a line with limits": ("crh380a_gpc", {**SHORT, "law": "pid", "compensation": "preview"}),
    "curve of the service brake": (
        "crh380a_funnel:short", {"law": "pid", "supervision.service_curve": True, "duration": 100}
    ),
    "period of one tick, without assurance": (
        "crh380a_funnel:short",
        {"duration": 60, "law": "funnel", "compensation": "none", "supervision.period": 0.05,
         "supervision.assurance": False},
    ),
    "balises": ("demo", {**SHORT, "plant.odometry": {"balise_spacing": 30.0, "wheel_error": 0.01}}),
    "command held for no time": ("demo", {**SHORT, "supervision.failsafe": {"hold": 0.0}}),
    "varying delay": (
        "demo", {**SHORT, "links.command": {"delay": 0.8, "varying": {"amplitude": 0.3, "omega": 1.0}}}
    ),
    "commands late and lost at random": (
        "demo", {**SHORT, "links.command": {"delay": 0.5, "jitter": 0.2, "loss": 0.2}}
    ),
    "gust": ("demo", {**SHORT, "interventions": [{"do": "gust", "at": 60.05, "acceleration": -0.05, "duration": 9}]}),
    "emergency brake": ("demo", {**SHORT, "interventions": [{"do": "emergency_brake", "at": 90}]}),
    "lost commands and releases": (
        "demo",
        {**SHORT, "interventions": [
            {"do": "message_loss", "at": 60, "topic": "ato/command", "duration": 0.4},
            {"do": "message_loss", "at": 120, "topic": "atp/brake_release", "duration": 0.4},
        ]},
    ),
    "frozen measurement, changed delays": (
        "demo",
        {**SHORT, "interventions": [
            {"do": "message_freeze", "at": 50, "topic": "train/measurement", "duration": 0.6},
            {"do": "delay_jump", "at": 80, "factor": 1.5}, {"do": "delay_jump", "at": 110, "add": -0.5},
        ]},
    ),
    "dropped references, corrupt odometry": (
        "demo",
        {**SHORT, "faults": [
            {"do": "drop", "topic": "ato/reference", "begin": 50, "end": 51, "probability": 0.5},
            {"do": "corrupt", "topic": "train/odometry", "begin": 120, "end": 122, "probability": 0.3, "value": "bit"},
        ]},
    ),
    "late measurements, repeated commands": (
        "demo",
        {**SHORT, "faults": [
            {"do": "delay", "topic": "train/measurement", "begin": 50.1, "end": 53, "delay": 0.3},
            {"do": "repeat", "topic": "ato/command", "begin": 80, "end": 81},
        ]},
    ),
    "ATO disengaged and engaged with a new profile": (
        "crh380a_funnel:short",
        {"law": "pid", "duration": 160,
         "ato_requests": [{"at": 20, "do": "disengage"}, {"at": 30, "do": "engage"}]},
    ),
    "faults without a supervisor": (
        "xuzhou_metro",
        {"duration": 60, "law": "pid", "faults": [
            {"do": "drop", "topic": "ato/command", "begin": 20, "end": 21, "probability": 0.5},
        ]},
    ),
}  # fmt: skip
"""Scenario and changes; together they contain every state of the supervisor, and every reaction of the train."""
FULL = ("daqin_heavy_haul", "daqin_heavy_haul:twin", "daqin_heavy_haul:disturbed+mismatch")


MOSTLY = ("heavy haul", "balises", "gust", "varying delay", "commands late and lost at random")
"""Cases in which most ticks are compiled: a run left to Python would be compared with itself."""


@pytest.mark.parametrize("case", sampled(SUPERVISED, every=2))
def test_supervised_ticks_give_messages_and_recording_of_python(case: str) -> None:
    """Breaks if limits, odometry, state, brake release or report of a compiled step differ in one bit."""
    # A fault or an intervention that begins inside a span, a state of a stage that a span does not continue, or a topic
    # of the supervisor with another shape in the recording does too.
    Both(setup_of(*SUPERVISED[case])).assert_equal(least=0.8 if case in MOSTLY else 0.0)


@pytest.mark.campaign
@pytest.mark.parametrize("name", FULL)
def test_a_whole_supervised_run_is_equal(name: str) -> None:
    """Breaks if a state drifts over a long run: brake applications, indication and stop at the end of authority."""
    Both(setup_of(name, {})).assert_equal()


def test_a_train_above_its_limit_is_left_to_the_supervisor() -> None:
    """Breaks if a compiled tick goes on beyond a limit: supervisor, assurance and brake must act in Python."""
    setup = setup_of("demo", {"duration": 200, "supervision.assurance": False, "law": "pid"})
    loop = TickLoop(setup, None, compiled=True)
    loop.start()
    while loop.plant.stamp < 100_000_000_000:
        loop.advance()
    assert loop._spans is not None and loop.supervisor is not None
    before, ceilings = loop._spans.ticks, loop.supervisor.supervisor.track.records.ceilings
    assert loop._spans.supervised.is_quiet
    for name in ("permitted", "warning", "service"):
        ceilings[name] = 1.0
    for _ in range(20):
        loop.advance()
    assert loop._spans.ticks <= before + setup.supervision_ticks
    assert loop.supervisor.supervisor.interventions == 1


def test_age_of_the_newest_command_that_has_arrived() -> None:
    """Breaks if the delay of the link, a lost command or a change of the delay counts wrong in the age of a command."""
    setup = setup_of("demo", {**SHORT, "links.command": {"delay": 0.5}})
    protection, tick, ages = TrainProtection(setup), setup.tick_ns, []
    for number in range(30):
        at = number * tick
        if number == 20:
            protection.jump(DelayJump(at=at * 1e-9, add=0.3))
        if number not in (10, 11):
            protection.on_command(at)
        ages.append(int(command_age(protection.age, *protection.stamps.records(at, 0), at, np.zeros((1, 1)))))
    assert tick == 100_000_000  # a command in time is 5 ticks old on arrival, and nominally 6
    assert [age // tick for age in ages[14:19]] == [-1, 0, 1, -1, -1]
    assert [age // tick for age in ages[24:30]] == [-1, 0, 1, 2, 2, 2]
