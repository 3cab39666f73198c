"""``train-ato import``: convert a measured speed and force history to a run folder and a speed profile."""

from __future__ import annotations

import argparse
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.cli.screen import print_json, print_table

if TYPE_CHECKING:
    from plant_sim.line import Line
    from train_ato.apps.import_csv.recording import Measured
    from train_ato.loop.setup import RunSetup
    from train_ato.profile.profile import Profile

PROFILE = "profile.csv"
STEP = 0.005
"""Plant step of an imported scenario; the tick is a multiple of it [s]."""
ROWS: tuple[tuple[str, str], ...] = (
    ("measured_rows", "rows"),
    ("measured_interval_s", "between rows, median in s"),
    ("measured_largest_gap_s", "between rows, largest in s"),
    ("simulated_s", "duration in s"),
    ("distance_m", "distance in m"),
    ("speed_max_kmh", "speed, largest in km/h"),
    ("energy_traction_kwh", "traction energy in kWh"),
    ("energy_regenerated_kwh", "regenerated energy in kWh"),
    ("overspeed_max_kmh", "overspeed, largest in km/h"),
    ("speed_rmse_kmh", "speed error, rms in km/h"),
)


def _columns_text() -> str:
    """Return the description of the columns for the help."""
    from train_ato.apps.import_csv.columns import QUANTITIES, TIMESTAMP

    width = max(len(" | ".join(quantity.names)) for quantity in QUANTITIES)
    lines = [f"  {' | '.join(q.names):{width}}  {q.meaning}" for q in QUANTITIES]
    of_unit = ", ".join(quantity.name for quantity in QUANTITIES if quantity.of_unit)
    return "\n".join(
        (
            "columns, named with their unit; time, speed and force are required:",
            *lines,
            f"  {TIMESTAMP:{width}}  instead of time: 2026-03-01T08:15:30.5, 01.03.2026 08:15:30,5,",
            f"  {'':{width}}  3/1/2026 8:15:30 AM, 08:15:30, date and time in two columns, or Unix time in s or ms",
            f"for every power unit from 0 on, as unit_0_force_kn: {of_unit}",
            "",
            "Names of recorders are read too: V [km/h], Speed (m/s), F in kN, or units in the row below the names.",
            "",
            "Separators are commas, semicolons or tabs, or that of a first line sep=;. Decimal commas are read,",
            "between commas in quotes; lines with # are comments. A place may be 12+345. Falling kilometres need",
            "LINE:reverse and are mirrored with the line. Rows may be unevenly spaced: every quantity is interpolated",
            "linearly at the ticks. Empty cells are gaps and are bridged up to --largest-gap. The profile is the",
            "measured speed, averaged over a window that depends on the resolution of the speed. A total force is",
            "distributed equally over the power units. Places and force are compared with the speed.",
            "",
            "  train-ato import recorder.csv --consist hxd1_c80_105 --line daqin_section",
            "  train-ato import kmc.csv --consist my_train.yaml --line my_line.yaml --rename 'v_ist:=speed_kmh' \\",
            "      --ignore Driver Door",
        )
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``import``."""
    from train_ato.apps.import_csv.columns import LARGEST_GAP

    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _columns_text()
    parser.add_argument("csv", type=Path, metavar="CSV", help="file of the on-board recorder")
    parser.add_argument("--consist", required=True, metavar="NAME", help="measured train: shipped name or file")
    parser.add_argument("--line", required=True, metavar="NAME", help="line of the measurement: shipped name or file")
    parser.add_argument(
        "--rename",
        nargs="+",
        action="extend",
        default=[],
        metavar="A:=B",
        help="read column A as column B",
    )
    parser.add_argument("--ignore", nargs="+", action="extend", default=[], metavar="COLUMN", help="ignore columns")
    parser.add_argument(
        "--from-km",
        type=float,
        metavar="KM",
        help="position of the front at the first row, for a file without a position column",
    )
    parser.add_argument("--tick", type=float, default=0.1, metavar="S", help="period of the run (default: 0.1 s)")
    parser.add_argument(
        "--largest-gap",
        type=float,
        default=LARGEST_GAP,
        metavar="S",
        help=f"longest gap to bridge (default: {LARGEST_GAP:g} s)",
    )
    parser.add_argument(
        "--smooth",
        type=float,
        metavar="S",
        help="averaging window of the profile, 0: none (default: from the resolution)",
    )
    parser.add_argument("--sort", action="store_true", help="sort the rows by time and remove repeated rows")
    parser.add_argument("--profile-only", action="store_true", help="write only the profile; no force column is needed")
    parser.add_argument("--name", metavar="NAME", help="name of the run (default: name of the file)")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="new run folder; with --profile-only: CSV file to write"
    )


def execute(options: argparse.Namespace) -> int:
    """Read, check and write a measured run."""
    import numpy as np

    from plant_sim.library import load_consist, load_line
    from plant_sim.line_direction import ENDING
    from train_ato.apps.import_csv.recording import measured
    from train_ato.apps.import_csv.run import measured_setup
    from train_ato.apps.import_csv.samples import sort_rows
    from train_ato.apps.import_csv.smoothing import measured_profile, window_of
    from train_ato.apps.import_csv.table import read_table
    from train_ato.apps.runs.progress import activity

    _check_numbers(options)
    consist, line = load_consist(options.consist), load_line(options.line)
    if not consist.power_units:
        raise ValueError(f"--consist {options.consist}: has no power unit; name the measured train")
    with activity(f"reading {options.csv}"):
        found_in = read_table(options.csv, _renames(options.rename), frozenset(options.ignore))
    note = sort_rows(found_in) if options.sort else ""
    half = consist.vehicles[0].length / 2
    offsets = np.array(consist.offsets)[list(consist.power_units)]
    mirror = line.begin + line.end if options.line.endswith(ENDING) else None
    found = measured(found_in, len(consist.power_units), half, offsets, options.largest_gap, mirror)
    found.notes += [note] if note else []
    window = window_of(found) if options.smooth is None else options.smooth
    profile = measured_profile(found, options.tick, _start(options, found, half, line), window)
    setup = measured_setup(found, profile, options.consist, options.line, options.name or _run_name(options.csv))
    if options.profile_only:
        return _write_profile(options, setup, found, window)
    return _write_run(options, setup, found, window)


def _check_numbers(options: argparse.Namespace) -> None:
    """Check the numbers of the options."""
    from train_ato.apps.import_csv.smoothing import MAX_WINDOW

    if not 0 < options.largest_gap < float("inf"):
        raise ValueError(f"--largest-gap {options.largest_gap}: out of range; give more than 0 s")
    steps = options.tick / STEP
    if not STEP <= options.tick <= 10 or abs(steps - round(steps)) > 1e-6:
        raise ValueError(
            f"--tick {options.tick}: out of range; give a multiple of {STEP:g} s up to 10 s, for example 0.1"
        )
    if options.smooth is not None and not 0 <= options.smooth <= MAX_WINDOW:
        raise ValueError(f"--smooth {options.smooth}: out of range; give 0 to {MAX_WINDOW:g} s")
    if options.from_km is not None and not abs(options.from_km) < 1e5:
        raise ValueError(f"--from-km {options.from_km}: out of range; give kilometres of the line")


def _renames(entries: list[str]) -> dict[str, str]:
    renames: dict[str, str] = {}
    for entry in entries:
        before, sign, after = entry.rpartition(":=")
        if not (sign and before and after):
            raise ValueError(
                f"--rename {entry}: not a renaming; write from:=to, for example --rename 'V [km/h]:=speed_kmh'"
            )
        if before in renames:
            raise ValueError(f"--rename {entry}: {before} is renamed twice; keep one")
        renames[before] = after
    return renames


def _run_name(path: Path) -> str:
    """Return a valid name of a scenario from a file name."""
    return re.sub(r"[^A-Za-z0-9_.+-]+", "_", path.stem).strip("_.+-")[:80] or "measured"


def _start(options: argparse.Namespace, found: Measured, half: float, line: Line) -> float:
    """Return the position of vehicle 0's centre at the first row [m]."""
    if found.position is not None:
        if options.from_km is not None:
            raise ValueError(
                f"--from-km {options.from_km}: the file has a position column; remove the option, or add "
                f"--ignore '{found.position.column.title}'"
            )
        return float(found.position.values[0])
    return line.begin if options.from_km is None else options.from_km * 1e3 - half


def _write_profile(options: argparse.Namespace, setup: RunSetup, found: Measured, window: float) -> int:
    from train_ato.profile.file import write_profile

    path = options.out or Path(f"{_run_name(options.csv)}_profile.csv")
    if path.exists():
        raise ValueError(f"--out {path}: exists already; give another name")
    write_profile(setup.profile, path, _source(found, window))
    result = {"profile": str(path), **_profile_figures(setup.profile), "measured_notes": found.notes}
    if options.json:
        print_json(result)
        return 0
    print_table(
        ("quantity", "value"), [(text, result[key]) for key, text in ROWS if result.get(key) is not None], str(path)
    )
    _print_notes(found, path, setup)
    return 0


def _write_run(options: argparse.Namespace, setup: RunSetup, found: Measured, window: float) -> int:
    """Write the run folder with its log."""
    from train_ato.apps.import_csv.run import measured_result, write_messages
    from train_ato.apps.import_csv.series import series_of
    from train_ato.apps.runs.progress import progress_bar
    from train_ato.log.run_folder import RunFolder
    from train_ato.log.summary_file import summary_text
    from train_ato.log.versions import SUMMARY
    from train_ato.loop.result import Progress
    from train_ato.profile.file import write_profile

    series = series_of(found, setup)
    outcome = measured_result(setup, found, series, window)
    attached = {SUMMARY: summary_text(outcome.summary).encode()}
    folder = RunFolder.make(options.out, setup.scenario.name)
    begin = time.perf_counter()
    try:
        folder.begin(setup)
        with progress_bar(f"writing {folder.path}") as progress, folder.sink(setup, attached, timed=False) as sink:

            def report(tick: int) -> None:
                if tick % 1000 == 0:
                    progress(Progress(tick * setup.tick, setup.ticks * setup.tick, time.perf_counter() - begin))

            write_messages(setup, series, sink, report)
        write_profile(setup.profile, folder.path / PROFILE, _source(found, window))
        folder.finish(setup, outcome)
        from train_ato.apps.report.run_figure import write_run_figure  # matplotlib: not needed before the end

        write_run_figure(setup, outcome, folder.path)
    except BaseException:
        folder.discard(converted=True)
        raise
    result: dict[str, Any] = {
        **outcome.summary,
        **_profile_figures(setup.profile),
        "run": str(folder.path),
        "profile": str(folder.path / PROFILE),
    }
    if options.json:
        print_json(result)
        return 0
    print_table(
        ("quantity", "value"),
        [(text, result[key]) for key, text in ROWS if result.get(key) is not None],
        setup.scenario.name,
    )
    sys.stdout.write(f"profile: {result['measured_profile']}; command: {result['measured_command']}\n")
    _print_notes(found, folder.path / PROFILE, setup)
    sys.stdout.write(
        f"recorded in {folder.path}; a law on the same profile: train-ato run {folder.path / 'scenario.yaml'}\n"
    )
    return 0


def _source(found: Measured, window: float) -> str:
    means = f"speed averaged over {window:.3g} s twice" if window else "the speed as it is"
    return f"measured: {found.table.path.name}, {found.table.lines.size} rows, {means}"


def _profile_figures(profile: Profile) -> dict[str, float]:
    return {
        "simulated_s": profile.end,
        "distance_m": float(profile.position[-1] - profile.position[0]),
        "speed_max_kmh": 3.6 * float(profile.velocity.max()),
    }


def _print_notes(found: Measured, path: Path, setup: RunSetup) -> None:
    """Print the corrections of the file, and the option that uses the profile."""
    for note in found.notes:
        sys.stdout.write(f"note: {note}\n")
    rolling = ", allow_rolling_end: true" if setup.profile.ends_rolling else ""
    sys.stdout.write(f"in another scenario: --set 'profile={{file: {path.resolve()}{rolling}}}'\n")
