"""Conversion of a measured run to scenario, messages of every tick, and summary."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.consist import Consist
from plant_sim.library import load_consist, split_name
from train_ato.api.import_csv.recording import Measured
from train_ato.api.import_csv.samples import ColumnSamples
from train_ato.api.import_csv.series import MeasuredSeries
from train_ato.judge.metrics import differences, summarise
from train_ato.judge.recording_builder import RecordingBuilder
from train_ato.judge.result import RunResult, identity
from train_ato.loop.engine import Sink
from train_ato.loop.stage_messages import diagnostics_due
from train_ato.messages.types import Command, Diagnostic, DisturbanceEstimate, Measurement, Pipe, Reference, Tick
from train_ato.profile.file import csv_text
from train_ato.profile.profile import Profile, limits_of, trajectory_of
from train_ato.program.version import VERSION
from train_ato.scenario.scenario import check_scenario
from train_ato.scenario.scenario_files import SCHEMA
from train_ato.scenario.setup import RunSetup, prepare

MAX_STEP = 0.005
"""Maximum plant step of the scenario [s]."""
REDUCTION_STEP = 10e3
"""Resolution of the brake events from a recorded brake-pipe reduction [Pa]."""
MEASURED = "measured"
"""Controller name in the summary of an imported run."""
NOT_RECORDED = "not recorded; the force at the wheel in its place"
"""Entry of the summary for a file without command column."""
NOT_MEASURED = (
    "position_error_max_m", "position_rmse_m", "stop_error_m", "coupler_draft_max_kn", "coupler_buff_max_kn",
    "saturated_s", "replans", "held_steps", "unsound_measurements", "stop_error_max_m", "arrival_delay_max_s", "stops",
)  # fmt: skip
"""Figures that need more than speed and force."""
NEED_REFERENCE = ("speed_rmse_kmh", "speed_error_max_kmh", "speed_rmse_run_kmh", "speed_error_run_max_kmh")
NEED_COMMAND = ("command_variation_kn_per_s",)


def measured_setup(found: Measured, profile: Profile, consist: str, line: str, name: str) -> RunSetup:
    """Return the setup of a measured run: train, line, and the measured speed as profile."""
    path = found.table.path
    rolling = {"allow_rolling_end": True} if profile.ends_rolling else {}
    tick = profile.period
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "name": name,
        "summary": f"measured: {path.name}",
        "source": f"Imported from {path.name}; the profile is the measured speed.",
        "duration": tick * (len(profile) - 1),
        "tick": tick,
        "step": min(tick, MAX_STEP),
        "plant": {"consist": _absolute(consist), "line": _absolute(line)},
        "profile": {"knots": csv_text(profile, f"measured: {path.name}"), **rolling},
    }
    if found.pressure is not None and (events := brake_events(found.pressure, load_consist(consist))):
        data["brake"] = {"policy": "planned", "events": events}
    return prepare(check_scenario(data, path), path)


def brake_events(pressure: ColumnSamples, consist: Consist) -> list[dict[str, float]]:
    """Return the brake events of a recorded brake-pipe pressure, in the form of a scenario.

    The reduction is rounded to steps, so that noise and pressure waves cause no events.
    """
    events: list[dict[str, float]] = []
    if consist.air_brake is None:
        return events
    held = 0.0
    for time, value in zip(pressure.time.tolist(), pressure.values.tolist(), strict=True):
        reduction = consist.air_brake.charged - value
        step = max(0.0, round(reduction / REDUCTION_STEP) * REDUCTION_STEP)
        if abs(reduction - held) > 0.75 * REDUCTION_STEP and step != held:
            held = step
            events.append({"time": round(time, 3), "reduction": held})
    return events


def _absolute(name: str) -> str:
    """Return the absolute path of a file, or the name of a shipped train or line."""
    stem, selection = split_name(name)
    return f"{Path(stem).resolve()}{selection}" if Path(stem).is_file() else name


def write_messages(
    setup: RunSetup,
    series: MeasuredSeries,
    sink: RecordingBuilder | Sink,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Write the measured quantities as messages of every tick.

    ``train/vehicles`` is omitted: the truth of every vehicle was not measured.  The estimate is that of the observer
    ``none``.
    """
    sink.add("ato/profile", trajectory_of(setup.profile), 0)
    sink.add("ato/limits", limits_of(setup.line), 0)
    none, estimate = np.zeros(0), np.zeros(setup.layout.n_units)
    for tick in range(setup.ticks):
        stamp = tick * setup.tick_ns
        state = (series.position[tick], series.velocity[tick], series.applied[tick])
        sink.add("/clock", Tick(stamp), stamp)
        if series.pressure is not None:
            sink.add("train/brake_pipe", Pipe(stamp, float(series.pressure[tick])), stamp)
        if diagnostics_due(stamp, setup.tick_ns):
            sink.add("/diagnostics", _plant_diagnostics(series, tick, stamp), stamp)
        sink.add("train/measurement", Measurement(stamp, *state, none, none, none), stamp)
        sink.add("ato/reference", _reference(setup, series, tick, stamp), stamp)
        sink.add("ato/estimate", DisturbanceEstimate(stamp, estimate), stamp)
        sink.add("ato/command", Command(stamp, series.command[tick]), stamp)
        if progress is not None:
            progress(tick)
    stamp = setup.ticks * setup.tick_ns
    sink.add("/clock", Tick(stamp), stamp)
    sink.add("/diagnostics", _plant_diagnostics(series, setup.ticks, stamp), stamp)


def _reference(setup: RunSetup, series: MeasuredSeries, tick: int, stamp: int) -> Reference:
    velocity, acceleration = series.reference_velocity[tick], series.reference_acceleration[tick]
    return Reference(stamp, float(setup.profile.position[tick]), float(velocity), float(acceleration))


def _plant_diagnostics(series: MeasuredSeries, tick: int, stamp: int) -> Diagnostic:
    """Return the diagnostics of the plant with the measured energies."""
    values = {
        "energy_traction": repr(float(series.traction[tick])),
        "energy_regenerated": repr(float(series.regenerated[tick])),
    }
    return Diagnostic(stamp, "plant", 0, MEASURED, values)


def measured_result(setup: RunSetup, found: Measured, series: MeasuredSeries, window: float) -> RunResult:
    """Return recording and summary of a measured run; figures that were not measured are null.

    Acceleration and jerk are those of the profile, because differences of the recorded speed amplify its noise.
    """
    builder = RecordingBuilder(setup)
    write_messages(setup, series, builder)
    recording = builder.finish()
    figures = summarise(setup, recording)
    acceleration, jerk = differences(setup.profile.velocity, setup.tick)
    figures["acceleration_max"], figures["jerk_max"] = float(np.abs(acceleration).max()), float(np.abs(jerk).max())
    unknown = {
        *NOT_MEASURED,
        *(() if series.referenced else NEED_REFERENCE),
        *(() if series.commanded else NEED_COMMAND),
    }
    summary: dict[str, Any] = {
        **identity(setup, setup.ticks),
        "controller": MEASURED,
        "simulated_s": round(setup.ticks * setup.tick, 9),
        "wall_s": None,
        "real_time_factor": None,
        **{key: None if key in unknown else value for key, value in figures.items()},
        "changes": [],
        "step_time_us_median": None,
        "step_time_us_p99": None,
        "status": "done",
        "version": VERSION,
        "measured_file": found.table.path.name,
        "measured_columns": ", ".join(found.table.columns),
        "measured_rows": int(found.table.lines.size),
        "measured_interval_s": round(found.interval, 9),
        "measured_largest_gap_s": round(found.largest_gap, 9),
        "measured_resampled": f"linear between rows, every {setup.tick:g} s",
        "measured_profile": f"mean over {window:.3g} s, twice" if window else "the speed as it is",
        "measured_command": "as recorded" if series.commanded else NOT_RECORDED,
        "measured_reference": "as recorded" if series.referenced else "not recorded; the profile in its place",
        "measured_notes": "; ".join(found.notes) or None,
    }
    return RunResult(recording, summary)
