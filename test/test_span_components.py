"""Observers, predictor, laws and brake policies in compiled spans give the messages of Python, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from case_costs import sampled
from span_runs import Both, setup_of

from train_ato.control.compiled.law_call import is_in_loop
from train_ato.loop.engine import TickLoop, run_engine
from train_ato.loop.recording import BRAKE_PIPE_COMMAND
from train_ato.loop.spans import kernel

FREE = {"supervision.enabled": False}
METRO = {"duration": 30}
THREE = {**FREE, "duration": 40, "links.command.delay_brake": None, "model.delay_brake": None}
BRAKE = {"brake": {"policy": "planned", "events": [{"time": 10, "reduction": 5e4}, {"time": 40, "reduction": 0}]}}
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
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "eso of the train, pid": ("xuzhou_metro:disturbed", {**METRO, "observer": "eso", "laws.pid.disturbance": True}),
    "ndo of the vehicle, rbf_smc, air brake": (
        "daqin_heavy_haul:ideal", {**FREE, "duration": 120, **LATER_BRAKE, "observer": "ndo", "law": "rbf_smc"}
    ),
    "ndo of the train, air brake": (
        "daqin_heavy_haul", {**FREE, "duration": 80, **BRAKE, "observer": "ndo", **WHOLE}
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
    "pade, air brake": ("daqin_heavy_haul", {**FREE, "duration": 130, **BRAKE, "compensation": "pade"}),
    "policy trip": ("daqin_heavy_haul", {**FREE, "duration": 160, **TRIP, "observer": "ndo", **WHOLE}),
    "policy trigger": ("daqin_heavy_haul", {**FREE, "duration": 130, **TRIGGER}),
    "policy blend": ("demo", {**FREE, "duration": 470, **BLEND}),
    "policy predictive": (
        "demo", {**FREE, "duration": 610, **PREDICTIVE, "observer": "ndo", **WHOLE}
    ),
}  # fmt: skip
"""Scenario and changes, for every component with a compiled step, and for compensations called in compiled ticks."""


@pytest.mark.parametrize("case", sampled(CASES, every=2))
def test_compiled_components_send_the_messages_of_python(case: str) -> None:
    """Breaks if an observer, a prediction, a law or a policy differs in one bit, or runs in Python after all."""
    Both(setup_of(*CASES[case])).assert_equal(least=0.7)


def test_policies_of_the_cases_change_the_pressure() -> None:
    """Breaks if an application or a release is not reached, so that the comparison above has no decision in it."""
    for case in ("policy trip", "policy trigger", "policy blend", "policy predictive"):
        recording = run_engine(setup_of(*CASES[case]), compiled=True).recording
        assert recording is not None
        pressure = recording.topics[BRAKE_PIPE_COMMAND]["pressure"].ravel()
        assert np.count_nonzero(np.diff(pressure)) >= 2, case


def test_components_do_not_compile_the_kernel_again() -> None:
    """Breaks if a component gives an array in another layout: the kernel would be compiled again, for 20 s."""
    for case in ("predictor, springs, three units", "eso of the train, pid", "policy trigger"):
        name, changes = CASES[case]
        run_engine(setup_of(name, {**changes, "duration": 5}), compiled=True)
    assert len(getattr(kernel.run_span, "signatures", [None])) == 1  # missing with NUMBA_DISABLE_JIT


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
