"""Compiled ticks give the messages and the recording of the ticks in Python, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from span_runs import Both, setup_of

from plant_sim.plant_setup import Sensors
from plant_sim.sensors import SensorSet
from plant_sim.states import VehicleStates
from train_ato.loop.engine import COMPILED_FROM, run_engine
from train_ato.loop.spans import kernel

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
    """Breaks if a run gives an array in another layout: the kernel would be compiled again, for 10 s."""
    for case in ("funnel", "funnel, three units", "pid, air brake by time and place", "disturbances"):
        run_engine(setup_of(*CASES[case]), compiled=True)
    signatures = getattr(kernel.run_span, "signatures", [None])  # missing with NUMBA_DISABLE_JIT
    assert len(signatures) == 1


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
