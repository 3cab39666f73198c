"""Conversion of a measured run: values at the ticks, scenario, messages of every tick, and summary."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.consist import Consist
from plant_sim.library import load_consist, split_name
from plant_sim.line import Line
from plant_sim.units import number_text
from train_ato.api.import_csv.recording import STANDSTILL_NOISE, Measured
from train_ato.api.import_csv.samples import ColumnSamples
from train_ato.judge.metrics import differences, summarise
from train_ato.judge.recording_builder import RecordingBuilder
from train_ato.judge.result import RunResult, identity
from train_ato.loop.engine import Sink
from train_ato.loop.stage_messages import SECOND_NS
from train_ato.messages.topics import TickBlock, Values
from train_ato.messages.types import Array, Diagnostic, Tick
from train_ato.profile.file import csv_text
from train_ato.profile.profile import Profile, limits_of, trajectory_of
from train_ato.program.version import VERSION
from train_ato.scenario.scenario import check_scenario
from train_ato.scenario.scenario_files import SCHEMA
from train_ato.scenario.setup import RunSetup, prepare

MAX_FORCE_RATIO = 3.0
"""Maximum force relative to the envelope; larger ones have a wrong unit."""

WORK_NOTE, WORK_BRAKED, WORK_REFUSED = (0.63, 1.45), (0.4, 2.5), (0.1, 10.0)
"""Work of the force over the energy that the train needs, outside of which there is a note (also where the train brakes
in between), and an error of the unit. A speed in mph that is read as km/h has 1.6."""
MIN_FORCE, REFERENCE = 0.01, (0.4, 2.5)
"""Force over the brake envelope, and reference over measured speed, of a probably wrong unit."""
BRAKING, BRAKED_SHARE = 0.3, 0.2
"""Deceleration [m/s²], and share of the work of the traction during it, that a note names."""
LATE, LATEST, FITS = 4, 30, 0.5
"""Shift of the force against the speed that is noted and the largest one tried [s], and the part of the mismatch that
it may leave."""
CHARGED = (0.7, 1.5)
"""Largest brake-pipe pressure over that of the charged pipe, outside of which a note names the unit."""
MIN_WORK = 1e5
"""Energy below which the work is not checked [J]."""
KWH = 3.6e6
ATMOSPHERE = 101.325e3
"""Difference between an absolute and a gauge pressure [Pa]."""


def series_of(found: Measured, setup: RunSetup) -> TickBlock:
    """Return the messages of a measured run at the ticks, by linear interpolation.

    A total force is distributed equally over the power units.  Without a recorded demand the command is the force at
    the wheel; without a recorded reference it is the profile.  ``train/vehicles`` is omitted: the truth of every
    vehicle was not measured.  The estimate is that of the observer ``none``.
    """
    if not found.force:
        raise ValueError(
            f"{found.table.path}: no force column; name one force_kn, or import only the profile with --profile-only"
        )
    if found.pressure is not None and not setup.layout.air_brake:
        title = found.pressure.column.title
        raise ValueError(
            f"{found.table.path}: column '{title}': train '{setup.consist.name}' has no air brake; remove it with "
            f"--ignore '{title}'"
        )
    if found.pressure is not None and setup.consist.air_brake is not None:
        found.notes += [_checked_pressure(found.pressure, setup.consist.air_brake.charged, found.table.path)]
    _check_forces(found, setup)
    _check_work(found, setup)
    _note_units(found, setup)
    _note_shift(found, setup)
    return _block(found, setup)


def _block(found: Measured, setup: RunSetup) -> TickBlock:
    """Return the messages of the checked run, with those after the last tick."""
    units = setup.layout.n_units
    count, profile = setup.ticks + 1, setup.profile
    time: Array = np.asarray(setup.tick * np.arange(count), dtype=np.float64)
    centre = profile.position[:count] if found.position is None else found.position.at(time)
    position = [
        found.unit_position[unit].at(time) if unit in found.unit_position else centre - setup.model.offsets[unit]
        for unit in range(units)
    ]
    v = np.stack([found.unit_speed.get(unit, found.speed).at(time) for unit in range(units)], axis=1)
    f = np.stack(_of_units(found.force, time, units), axis=1)
    speed, acceleration = profile.velocity[:count], profile.acceleration[:count]
    if found.reference_speed is not None:
        speed = found.reference_speed.at(time)
        acceleration = np.gradient(speed, setup.tick)
    none = np.zeros((count, 0))
    seen = {"position": np.stack(position, axis=1), "velocity": v, "applied": f}
    columns = {"position": profile.position[:count], "velocity": speed, "acceleration": acceleration}
    expected = {name: values[:, None] for name, values in columns.items()}
    command = np.stack(_of_units(found.command, time, units), axis=1) if found.command else f
    rows: list[tuple[str, Values]] = [("/clock", {})]
    rows += [] if found.pressure is None else [("train/brake_pipe", {"pressure": found.pressure.at(time)[:, None]})]
    rows += [
        ("train/measurement", seen | dict.fromkeys(("deflection", "rate", "force"), none)),
        ("ato/reference", expected | {"planned": np.zeros((count, 1), np.int64)}),
        ("ato/estimate", {"force": np.zeros((count, units))}),
        ("ato/command", {"force": command}),
    ]
    stamps, power = setup.tick_ns * np.arange(count), (v * f).sum(axis=1)
    energies = [_sum(np.maximum(each, 0.0), setup.tick).tolist() for each in (power, -power)]
    due = [k for k, stamp in enumerate(stamps.tolist()) if stamp % SECOND_NS < setup.tick_ns or k == setup.ticks]
    between: dict[int, list[tuple[int, str, Any]]] = {}
    for k in due:
        values = {"energy_traction": repr(energies[0][k]), "energy_regenerated": repr(energies[1][k])}
        report = Diagnostic(int(stamps[k]), "plant", 0, MEASURED, values)
        between[k] = [(len(rows) - 4, "/diagnostics", report)]
    return TickBlock(stamps, rows, between)


def _of_units(samples: dict[int | None, ColumnSamples], time: Array, units: int) -> list[Array]:
    whole = samples.get(None)
    if whole is not None:
        return [whole.at(time) / units] * units
    return [samples[unit].at(time) for unit in range(units)]


def _sum(power: Array, tick: float) -> Array:
    return np.concatenate(([0.0], np.cumsum((power[1:] + power[:-1]) / 2 * tick)))


def _check_forces(found: Measured, setup: RunSetup) -> None:
    """Check the forces against the envelopes of the train, to detect wrong units."""
    grid = np.linspace(0.0, max(1.0, float(found.speed.values.max())), 50)
    limits = [setup.model.force_limits(np.full(setup.layout.n_units, speed)) for speed in grid]
    most = np.max([np.maximum(np.abs(low), np.abs(high)) for low, high in limits], axis=0)
    for group in (found.force, found.command):
        for unit, samples in group.items():
            bound = MAX_FORCE_RATIO * float(most.sum() if unit is None else most[unit])
            wrong = np.flatnonzero(np.abs(samples.values) > bound)
            if wrong.size:
                place = int(wrong[0])
                value = samples.values[place]
                raise found.table.wrong(
                    int(samples.rows[place]),
                    samples.column,
                    f"{number_text(value / 1e3)} kN is {abs(value) / bound * MAX_FORCE_RATIO:.1f} times the maximum "
                    f"of train '{setup.consist.name}'; check the unit in the column name",
                )


def _check_work(found: Measured, setup: RunSetup) -> None:
    """Compare the work of the force with the energy of the train over its largest gain of speed.

    The train needs its kinetic energy, the work of its running resistance, and the potential energy of the line. Mass
    and line may differ from those of the day, so a small difference is a note.
    """
    vehicles, gravity = setup.consist.vehicles, setup.consist.gravity
    time, speed = found.speed.time, found.speed.values
    standing = speed < STANDSTILL_NOISE  # the least speed is that of the last standstill, not of the least noise
    kinetic = 0.5 * sum(vehicle.inertia for vehicle in vehicles) * np.where(standing, 0.0, speed) ** 2
    gain = kinetic - np.minimum.accumulate(kinetic)
    last = int(np.argmax(gain))
    first = last - int(np.argmin(kinetic[: last + 1][::-1]))
    steps = np.diff(time[first : last + 1])
    if not steps.size:
        return

    def work(force: Array) -> float:
        power = force * speed[first : last + 1]
        return float((steps * (power[1:] + power[:-1]) / 2).sum())

    moments = time[first : last + 1]
    force = np.sum(
        [samples.at(moments) for samples in found.force.values()] if None not in found.force
        else [found.force[None].at(moments)], axis=0,
    )  # fmt: skip
    terms = np.sum([vehicle.resistance.polynomial(vehicle.mass, gravity) for vehicle in vehicles], axis=0)
    v = speed[first : last + 1]
    place = np.interp(moments, setup.profile.time, setup.profile.position)
    climbed = setup.consist.mass * gravity * _height(setup.line, place[0], place[-1])
    needed = (
        float(gain[last]) + work(terms[0] + terms[1] * v + terms[2] * v**2) + max(climbed, -0.5 * float(gain[last]))
    )
    ratio = work(np.maximum(force, 0.0)) / needed
    usual = WORK_BRAKED if (np.diff(v) < -BRAKING * steps).any() else WORK_NOTE
    if needed < MIN_WORK or usual[0] <= ratio <= usual[1]:
        return
    samples = next(iter(found.force.values()))
    title, against = samples.column.title, work(np.maximum(-force, 0.0))
    remedy = f"check the units of '{title}' and '{found.speed.column.title}'"
    if against > WORK_BRAKED[0] * needed:
        remedy = f"it does {number_text(against / KWH)} kWh with the other sign: traction is > 0, correct the signs"
    elif WORK_BRAKED[0] <= 1e3 * ratio * samples.column.factor <= WORK_BRAKED[1]:
        remedy += f", --rename '{title}:=force_kn' for kN"
    lines = [int(found.table.lines[found.speed.rows[row]]) for row in (first, last)]
    text = (
        f"the force does {number_text(ratio * needed / KWH)} kWh up to line {lines[1]}, where train "
        f"'{setup.consist.name}' needs {number_text(needed / KWH)} kWh for its speed and resistance; {remedy}, or "
        "the mass of --train"
    )
    row = int(found.speed.rows[first])
    if WORK_REFUSED[0] <= ratio <= WORK_REFUSED[1]:
        found.notes.append(found.table.at(row, samples.column, text))
        return
    raise found.table.wrong(row, samples.column, text)


def _note_units(found: Measured, setup: RunSetup) -> None:
    """Note a brake force, a demand or a reference far from the train, and traction while it brakes.

    A wrong unit of one of them leaves the speed, the places and the work of the traction plausible.
    """
    speed = found.speed
    low, _ = setup.model.force_limits(np.full(setup.layout.n_units, 0.5 * float(speed.values.max())))
    brake = float(np.abs(low).sum())
    for group, sign, what in (
        (found.force, -1.0, "brake"),
        (found.command, -1.0, "brake"),
        (found.command, 1.0, "traction"),
    ):
        first = next(iter(group.values()), None)
        most = sum(float((sign * samples.values).max()) for samples in group.values())
        if first is not None and 0.0 < most < MIN_FORCE * brake:
            column = (sign < 0 and group is found.force and found.table.find("brake_force")) or first.column
            found.notes.append(
                f"{column.title}: {what} of at most {number_text(most / 1e3)} kN, a hundredth of the train's "
                f"{number_text(brake / 1e3)} kN or less; check the unit in the column name"
            )
    if (reference := found.reference_speed) is not None:
        ratio = float(reference.values.max()) / float(speed.values.max())
        if not REFERENCE[0] <= ratio <= REFERENCE[1]:
            found.notes.append(
                f"{reference.column.title}: at most {number_text(3.6 * reference.values.max())} km/h, the train runs "
                f"{number_text(3.6 * speed.values.max())} km/h; check the unit in the column name"
            )
    force = np.sum([samples.at(speed.time) for samples in found.force.values()], axis=0)
    power = np.maximum(force * speed.values, 0.0)[1:] * np.diff(speed.time)
    braking = np.diff(speed.values) / np.diff(speed.time) < -BRAKING
    if power[braking].sum() > BRAKED_SHARE * power.sum() > 0.0:
        row = int(np.flatnonzero(braking & (power > 0.0))[0]) + 1
        found.notes.append(
            found.table.at(
                int(speed.rows[row]), next(iter(found.force.values())).column,
                f"{100 * power[braking].sum() / power.sum():.0f} % of the work of the traction is done while "
                "the train brakes; a brake force is < 0, or in a column brake_force_kn",
            )
        )  # fmt: skip


def _note_shift(found: Measured, setup: RunSetup) -> None:
    """Note a traction that fits to speed and line at another time only: two recorders, or two clocks."""
    time = np.arange(0.0, float(found.speed.time[-1]) + 1.0)
    if time.size <= LATEST:
        return
    speed, front = found.speed.at(time), np.interp(time, setup.profile.time, setup.profile.position)
    resisting = np.where(speed > STANDSTILL_NOISE, setup.model.resisting_forces(front, speed), 0.0)
    force = np.sum([samples.at(time) for samples in found.force.values()], axis=0)
    needed, given = (
        np.convolve(np.maximum(entry, 0.0), np.full(LATE + 1, 1.0 / (LATE + 1)), "same")  # coarse speeds have no rate
        for entry in (setup.model.inertia * np.gradient(speed) + resisting, force)
    )
    padded = np.pad(given, LATEST)
    errors = [float(np.square(padded[k : k + time.size] - needed).mean()) for k in range(2 * LATEST + 1)]
    late = int(np.argmin(errors)) - LATEST
    if abs(late) >= LATE and min(errors) < FITS**2 * errors[LATEST]:
        title = next(iter(found.force.values())).column.title
        found.notes.append(
            f"{title}: fits to the speed {abs(late)} s {'later' if late < 0 else 'earlier'} (mean mismatch "
            f"{number_text(min(errors) ** 0.5 / 1e3, 3)} kN, as recorded {number_text(errors[LATEST] ** 0.5 / 1e3, 3)}"
            " kN); check the clocks of the columns"
        )


def _height(line: Line, begin: float, end: float) -> float:
    """Return the height of a place of a line above another [m]."""
    places = [entry.at for entry in line.rounded_grades]
    ends = [*places[1:], max(end, *places)] if places else []
    return sum(
        entry.grade * max(0.0, min(stop, end) - max(entry.at, begin))
        for entry, stop in zip(line.rounded_grades, ends, strict=True)
    )


def _checked_pressure(pressure: ColumnSamples, charged: float, path: Path) -> str:
    """Return the note on a recorded brake-pipe pressure; refuse one that is never charged by one atmosphere."""
    title, highest = pressure.column.title, float(pressure.values.max())
    text = f"at most {number_text(highest / 1e3, 4)} kPa, {number_text(charged / 1e3)} kPa are charged"
    if abs(charged - highest - ATMOSPHERE) < 0.3 * ATMOSPHERE:
        raise ValueError(
            f"{path}: column '{title}': {text}: probably a gauge pressure; the absolute one is read: add 101.3 kPa "
            f"(1.013 bar, 14.7 psi) in the file, or remove it with --ignore '{title}'"
        )
    doubt = "" if CHARGED[0] <= highest / charged <= CHARGED[1] else "; check the unit in the column name"
    return f"{title}: absolute pressure, {text}{doubt}"


MAX_STEP = 0.005
"""Maximum plant step of the scenario [s]."""
REDUCTION_STEP = 10e3
"""Resolution of the brake events from a recorded brake-pipe reduction [Pa]."""
PORTION = 1000
"""Number of ticks whose messages are written at once."""
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
    setup: RunSetup, block: TickBlock, sink: RecordingBuilder | Sink, progress: Callable[[int], None] | None = None
) -> None:
    """Write the messages of every tick, and the state after the last one."""
    sink.add("ato/profile", trajectory_of(setup.profile), 0)
    sink.add("ato/limits", limits_of(setup.line), 0)
    for first in range(0, setup.ticks, PORTION):
        sink.add_ticks(block.part(first, min(first + PORTION, setup.ticks)))
        if progress is not None:
            progress(first)
    stamp, ((_, topic, last),) = setup.ticks * setup.tick_ns, block.between[setup.ticks]
    sink.add("/clock", Tick(stamp), stamp)
    sink.add(topic, last, stamp)


def measured_result(setup: RunSetup, found: Measured, block: TickBlock, window: float) -> RunResult:
    """Return recording and summary of a measured run; figures that were not measured are null.

    Acceleration and jerk are those of the profile, because differences of the recorded speed amplify its noise.
    """
    builder = RecordingBuilder(setup)
    write_messages(setup, block, builder)
    recording = builder.finish()
    figures = summarise(setup, recording)
    acceleration, jerk = differences(setup.profile.velocity, setup.tick)
    figures["acceleration_max"], figures["jerk_max"] = float(np.abs(acceleration).max()), float(np.abs(jerk).max())
    unknown = {
        *NOT_MEASURED,
        *(() if found.reference_speed else NEED_REFERENCE),
        *(() if found.command else NEED_COMMAND),
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
        "measured_command": "as recorded" if found.command else NOT_RECORDED,
        "measured_reference": "as recorded" if found.reference_speed else "not recorded; the profile in its place",
        "measured_notes": "; ".join(found.notes) or None,
    }
    return RunResult(recording, summary)
