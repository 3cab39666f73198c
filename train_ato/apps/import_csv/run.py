"""A measured run in our own form: scenario, messages of every tick, summary and figure."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.consist import Consist
from plant_sim.library import load_consist
from train_ato.history import History
from train_ato.measured.recording import Measured
from train_ato.measured.samples import Samples
from train_ato.measured.series import Series
from train_ato.metrics import differences, summarise
from train_ato.outcome import Outcome
from train_ato.profile.file import csv_text
from train_ato.profile.profile import Profile
from train_ato.roles.outgoing import due
from train_ato.roles.trajectories import limits_of, trajectory_of
from train_ato.run_folder import Encoder
from train_ato.run_setup import RunSetup, prepare
from train_ato.scenario import SCHEMA, check
from train_ato.types import Command, Diagnostic, DisturbanceEstimate, Measurement, Pipe, Reference, Tick
from train_ato.version import VERSION

__all__ = ["MEASURED", "NOT_RECORDED", "measured_setup", "outcome_of", "write_messages"]

LARGEST_STEP = 0.005
"""Step of the plant where the scenario is driven [s]."""
REDUCTION_STEP = 10e3
"""Steps in which a recorded reduction of the brake pipe becomes events [Pa]."""
MEASURED = "measured"
"""What stands in the summary for the law: nobody here knows who drove."""
NOT_RECORDED = "not recorded; the force at the wheel in its place"
"""What the summary says of the command where the recorder gave none."""
UNKNOWN = (
    "position_error_max_m", "position_rmse_m", "stop_error_m", "coupler_draft_max_kn", "coupler_buff_max_kn",
    "saturated_s", "replans", "held_steps", "unsound_measurements",
)  # fmt: skip
"""Figures that speed and force do not tell."""
OF_A_REFERENCE = ("speed_rmse_kmh", "speed_error_max_kmh")
OF_A_DEMAND = ("command_variation_kn_per_s",)


def measured_setup(found: Measured, profile: Profile, consist: str, line: str, name: str) -> RunSetup:
    """Return the scenario of a measured run: its train and line, and its own speed as the profile.

    Raises
    ------
    ValueError
        One line: the tick, the name, or a place off the line.
    """
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
        "step": min(tick, LARGEST_STEP),
        "plant": {"consist": _absolute(consist), "line": _absolute(line)},
        "profile": {"knots": csv_text(profile, f"measured: {path.name}"), **rolling},
    }
    if found.pressure is not None and (events := brake_events(found.pressure, load_consist(consist))):
        data["brake"] = {"policy": "planned", "events": events}
    return prepare(check(data, path), path)


def brake_events(pressure: Samples, consist: Consist) -> list[dict[str, float]]:
    """Return the applications and releases that a recorded brake-pipe pressure shows, as a scenario plans them.

    The reduction is taken in steps, so that neither noise nor the slope of a wave makes an event of its own.
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
    """Return a file's full path; names of shipped trains and lines stay."""
    return str(Path(name).resolve()) if Path(name).is_file() else name


def write_messages(setup: RunSetup, series: Series, sink: Encoder, progress: Callable[[int], None]) -> None:
    """Write what a run of ours would have published of all this, tick by tick; what nobody measured is left out.

    There is no ``train/cars``: the truth of every vehicle is not known.  The estimate is that of the observer ``none``.
    """
    sink.add("ato/profile", trajectory_of(setup.profile), 0)
    sink.add("ato/limits", limits_of(setup), 0)
    none, estimate = np.zeros(0), np.zeros(setup.shape.n_units)
    for tick in range(setup.ticks):
        stamp = tick * setup.tick_ns
        state = (series.position[tick], series.velocity[tick], series.applied[tick])
        sink.add("/clock", Tick(stamp), stamp)
        if series.pressure is not None:
            sink.add("train/brake_pipe", Pipe(stamp, float(series.pressure[tick])), stamp)
        if due(stamp, setup.tick_ns):
            sink.add("/diagnostics", _told(series, tick, stamp), stamp)
        sink.add("train/measurement", Measurement(stamp, *state, none, none, none), stamp)
        sink.add("ato/reference", _reference(setup, series, tick, stamp), stamp)
        sink.add("ato/estimate", DisturbanceEstimate(stamp, estimate), stamp)
        sink.add("ato/command", Command(stamp, series.command[tick]), stamp)
        progress(tick)
    stamp = setup.ticks * setup.tick_ns
    sink.add("/clock", Tick(stamp), stamp)
    sink.add("/diagnostics", _told(series, setup.ticks, stamp), stamp)


def _reference(setup: RunSetup, series: Series, tick: int, stamp: int) -> Reference:
    velocity, acceleration = series.reference_velocity[tick], series.reference_acceleration[tick]
    return Reference(stamp, float(setup.profile.position[tick]), float(velocity), float(acceleration))


def _told(series: Series, tick: int, stamp: int) -> Diagnostic:
    """Return what the plant says of itself, as far as it was measured."""
    values = {
        "energy_traction": repr(float(series.traction[tick])),
        "energy_regenerated": repr(float(series.regenerated[tick])),
    }
    return Diagnostic(stamp, "plant", 0, MEASURED, values)


def outcome_of(setup: RunSetup, found: Measured, series: Series, window: float) -> Outcome:
    """Return summary and series as a run of ours leaves them; what was not measured is null.

    Acceleration and jerk are those of the profile: differences of a speed as it is recorded are those of its noise.
    """
    history = _history(setup, series)
    figures = summarise(setup, history)
    acceleration, jerk = differences(setup.profile.velocity, setup.tick)
    figures["acceleration_max"], figures["jerk_max"] = float(np.abs(acceleration).max()), float(np.abs(jerk).max())
    unknown = {
        *UNKNOWN,
        *(() if series.referenced else OF_A_REFERENCE),
        *(() if series.commanded else OF_A_DEMAND),
    }
    summary: dict[str, Any] = {
        "scenario": setup.scenario.name,
        "controller": MEASURED,
        "observer": setup.observer,
        "compensation": setup.compensation,
        "seed": setup.seed,
        "ticks": setup.ticks,
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
    return Outcome(history, summary)


def _history(setup: RunSetup, series: Series) -> History:
    """Return the series as figures and summaries take them; of the couplers nobody knows."""
    part, count = slice(0, setup.ticks), setup.ticks
    nothing = np.full(count, np.nan)
    profile = setup.profile
    return History(
        time=series.time[part],
        position=series.position[part],
        velocity=series.velocity[part],
        front_position=profile.position[part],
        front_velocity=series.velocity[part, 0],
        coupler_high=nothing,
        coupler_low=nothing,
        coupler_some=np.full((count, 3), np.nan),
        applied=series.applied[part],
        command=series.command[part],
        estimate=np.zeros_like(series.applied[part]),
        disturbance=np.zeros_like(series.applied[part]),
        reference_position=profile.position[part],
        reference_velocity=series.reference_velocity[part],
        reference_acceleration=series.reference_acceleration[part],
        final_position=float(profile.position[count]),
        final_velocity=float(profile.velocity[count]),
        totals={
            "energy_traction": float(series.traction[count]),
            "energy_regenerated": float(series.regenerated[count]),
        },
        brake_pipe=series.pressure[part] if series.pressure is not None else None,
    )
