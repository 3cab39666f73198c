"""Runs that return a summary only, as those of sweeps: the summary of the same run with its recording."""

from __future__ import annotations

from typing import Any

import pytest
from span_runs import setup_of

from train_ato.apps.sweep.row import WALL_TIMES
from train_ato.loop.engine import TickLoop, run_engine

FREE = {"supervision.enabled": False}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "supervised, air brake by time": (
        "daqin_heavy_haul",
        {"duration": 120, "brake.events": [{"time": 60, "reduction_kpa": 50}]},
    ),
    "overspeed and intervention": (
        "daqin_heavy_haul",
        {"duration": 150, "plant.mismatch.mass_scale": 0.6, "law": "pid", "laws.pid": {"kp": 0.6, "ki": 0.05}},
    ),
    "disturbances": (
        "daqin_heavy_haul", {"duration": 60, "plant.disturbances": [{"kind": "eq40"}], "observer": "eso"}
    ),
    "three units, no supervisor": ("crh380a_gpc:short", {**FREE, "duration": 60, "law": "funnel"}),
    "to the stop": ("xuzhou_metro", {"law": "pid"}),
    "law in Python": ("daqin_heavy_haul", {"duration": 60, "law": "gpc"}),
    "requirements": (
        "daqin_heavy_haul",
        {"duration": 110, "brake.events": [{"time": 60, "reduction_kpa": 50}],
         "criteria.requirements": {"pipe": "G (pipe_pressure_tail >= 540 kPa)", "draft": "G (coupler_draft <= 900 kN)"},
        },
    ),
}  # fmt: skip

NO_PLACE = {"at_s": None, "km": None}


def of_simulation(summary: dict[str, Any]) -> str:
    """Return a summary without wall times and places of coupler forces as text; NaN is equal to NaN."""
    criteria = [{**row, **(NO_PLACE if "coupler" in row["criterion"] else {})} for row in summary["criteria"]]
    return repr({**{key: value for key, value in summary.items() if key not in WALL_TIMES}, "criteria": criteria})


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("case", CASES)
def test_a_summary_without_recording_is_that_of_the_run(case: str, compiled: bool) -> None:
    """Breaks if a series that a metric, the outcome of tracking or a requirement reads is left out."""
    whole, brief = (
        run_engine(setup_of(*CASES[case]), compiled=compiled, summary_only=chosen) for chosen in (False, True)
    )
    assert whole.recording is not None and brief.recording is None
    assert of_simulation(whole.summary) == of_simulation(brief.summary)
    for exact, alone in zip(whole.summary["criteria"], brief.summary["criteria"], strict=True):
        assert alone["at_s"] in (exact["at_s"], None)  # unknown, but never another time


@pytest.mark.parametrize("case", ["supervised, air brake by time", "three units, no supervisor"])
def test_a_failed_run_has_the_same_totals(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the last diagnostics of the plant before a failure lack the totals: they are the metrics of the run."""
    name, changes = CASES[case]
    changed = {**changes, "law_changes": [{"at": 50, "law": "smc"}]}

    def fail(*_: Any) -> None:
        raise ArithmeticError("planned failure")

    monkeypatch.setattr("train_ato.control.laws.smc.Smc.step", fail)
    whole, brief = (run_engine(setup_of(name, changed), compiled=True, summary_only=chosen) for chosen in (False, True))
    assert whole.summary["energy_traction_kwh"] > 0.0
    assert of_simulation(whole.summary) == of_simulation(brief.summary)


def test_compiled_ticks_leave_out_what_no_summary_needs() -> None:
    """Breaks if pressures of the brake pipe, shoe forces or all vehicles are recorded for a summary."""
    setup = setup_of(*CASES["supervised, air brake by time"])
    loop = TickLoop(setup, None, compiled=True, summary_only=True)
    loop.start()
    while not loop.plant.finished:
        loop.advance()
    assert loop._spans is not None and loop._spans.ticks > 0.5 * loop.ticks
    assert {topic: set(samples.values) for topic, samples in loop.recording.finish().topics.items()} == {
        "train/vehicles": {
            "front_position",
            "front_velocity",
            "rear_position",
            "unit_position",
            "unit_velocity",
            "coupler_draft_max",
            "coupler_buff_max",
        },
        "train/measurement": set(),
        "ato/reference": {"position", "velocity", "acceleration"},
        "ato/command": {"force"},
        "ato/state": {"state"},
    }
