"""Requirements on the live page: equal to those of the recording, and decided before the end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from train_ato.apps.view.live_requirements import LiveRequirements
from train_ato.apps.view.snapshot import Snapshot
from train_ato.loop.engine import run_engine
from train_ato.loop.recording import Recording
from train_ato.loop.requirements import requirement_rows
from train_ato.loop.setup import RunSetup, prepare
from train_ato.scenario.scenario import load_scenario

FORMULAS = (
    "{slow: 'G speed <= 0.1 km/h', moves: 'F speed >= 1 km/h', force: 'G abs(command) <= 800 kN', "
    "pipe: 'G pipe_pressure >= 300 kPa', below: 'G speed <= permitted_speed', draft: 'G coupler_draft <= 900 kN', "
    "keeps: 'G (speed >= 0.5 km/h -> F[0,5] abs(speed_error) <= 2 km/h)'}"
)


def snapshots(setup: RunSetup, recording: Recording) -> list[Snapshot]:
    """Return a snapshot of every tick."""
    held = recording.of("atp/speeds", "speed")
    pipe = recording.of("train/brake_pipe", "pressure")
    rows = np.searchsorted(held[0], recording.time, side="right") - 1
    return [
        Snapshot(
            time=float(stamp),
            position=np.array([recording.front_position[row]]),
            velocity=np.array([recording.front_velocity[row]]),
            coupler=np.array([recording.coupler_draft_max[row], recording.coupler_buff_max[row]]),
            shoe=None,
            applied=recording.applied[row],
            command=recording.command[row],
            estimate=recording.estimate[row],
            reference=(
                float(recording.reference_position[row]),
                float(recording.reference_velocity[row]),
                float(recording.reference_acceleration[row]),
            ),
            pipe=float(pipe[1][row, 0]),
            limits=held[1][rows[row], 1:],
        )
        for row, stamp in enumerate(recording.time)
    ]


def test_the_live_values_are_those_of_the_recording_and_never_contradict_it() -> None:
    """Breaks if a signal of the page is another one, or a requirement is decided against its later result."""
    setup = prepare(*load_scenario("demo", ("duration=30", f"criteria.requirements={FORMULAS}")))
    recording = run_engine(setup).recording
    moments = snapshots(setup, recording)
    live = LiveRequirements(setup)
    wanted = {row["criterion"]: row for row in requirement_rows(setup, recording)}
    early = {}
    for row, moment in enumerate(moments):
        live.add(moment)
        if row in (50, 250):
            early[row] = live.evaluate()
    for found in early.values():
        for name, bounds in found.items():
            assert bounds.lower <= wanted[name]["value"] <= bounds.upper
            assert bounds.passed in (None, wanted[name]["passed"])
    assert [early[250][name].passed for name in ("slow", "moves", "force")] == [False, True, None]
    final = live.evaluate()
    assert {name: found.value for name, found in final.items()} == {name: row["value"] for name, row in wanted.items()}
    assert "slow: broken, robustness" in live.markup or "slow: open" in live.markup


def test_a_page_that_joins_late_shows_nothing_and_frames_between_ticks_are_held() -> None:
    """Breaks if the missing start of a run counts as fulfilled, or a repeated frame as a new sample."""
    setup = prepare(*load_scenario("demo", ("duration=3", f"criteria.requirements={FORMULAS}")))
    moments = snapshots(setup, run_engine(setup).recording)
    late = LiveRequirements(setup)
    late.add(replace(moments[-1], time=5.0))
    assert late.evaluate() == {}
    assert late.markup == ""
    sparse = LiveRequirements(setup)
    for moment in (moments[0], moments[0], moments[10]):
        sparse.add(moment)
    assert sparse._recording().time.size == 11
    assert sparse._recording().front_velocity[9] == moments[0].velocity[0]


def test_a_far_stamp_is_not_a_tick_of_the_run() -> None:
    """Breaks if one foreign message makes the page sample the run up to its stamp, or ends the evaluation."""
    setup = prepare(*load_scenario("demo", ("duration=20", f"criteria.requirements={FORMULAS}")))
    recording = run_engine(setup).recording
    assert recording is not None
    live = LiveRequirements(setup)
    moments = snapshots(setup, recording)
    for moment in [*moments[:100], replace(moments[0], time=1e9), *moments[100:]]:
        live.add(moment)
    found = live.evaluate()
    assert {name: part.passed for name, part in found.items()} == {
        row["criterion"]: row["passed"] for row in requirement_rows(setup, recording)
    }
