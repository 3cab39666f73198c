"""``train-ato import``: convert a measured speed and force history to a run folder and a speed profile.

Options::

    csv CSV                  file of the on-board recorder
    --train, --consist NAME  measured train: shipped name or file (required)
    --line NAME              line of the measurement: shipped name or file (required)
    --layout NAME            layout of the recorder, its titles, notches and units: a file, or {layouts}
    --rename A:=B            read column A as column B
    --ignore COLUMN          ignore columns
    --from-km KM             position of the front at the first row [km], or a post as 84+500, for a file without a
                             position column
    --tick S                 period of the run (default: 0.1 s)
    --largest-gap S          longest gap to bridge (default: %(default)g s)
    --smooth S               averaging window of the profile, 0: none (default: from the resolution)
    --sort                   sort the rows by time and remove repeated rows
    --profile-only           write only the profile; no force column is needed
    --name NAME              name of the run (default: name of the file)
    --out DIR                new run folder; with --profile-only: CSV file to write
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.api.import_csv.columns import MAX_GAP, QUANTITIES, TIMESTAMP, layout_names
from train_ato.cli.plan import kilometre
from train_ato.cli.screen import print_json, print_table
from train_ato.program.arguments import Options

if TYPE_CHECKING:
    from train_ato.api.importing import MeasuredRun
    from train_ato.scenario.setup import RunSetup

ROWS: tuple[tuple[str, str], ...] = (
    ("measured_rows", "rows"), ("measured_interval_s", "between rows, median in s"),
    ("measured_largest_gap_s", "between rows, largest in s"), ("simulated_s", "duration in s"),
    ("distance_m", "distance in m"), ("speed_max_kmh", "speed, largest in km/h"),
    ("energy_traction_kwh", "traction energy in kWh"), ("energy_regenerated_kwh", "regenerated energy in kWh"),
    ("overspeed_max_kmh", "overspeed, largest in km/h"), ("speed_rmse_kmh", "speed error, rms in km/h"),
)  # fmt: skip


def _columns_text() -> str:
    """Return the description of the columns for the help."""
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
            "LINE:reverse and are mirrored with the line; on a line with chainage they are those of its posts. Rows",
            "may be unevenly spaced: every quantity is interpolated linearly at the ticks. Empty cells are gaps and",
            "are bridged up to --largest-gap. The profile is the measured speed, averaged over a window that depends",
            "on the resolution of the speed. A total force is distributed equally over the power units. Places and",
            "force are compared with the speed.",
            "",
            "  train-ato import recorder.csv --train hxd1_c80_105 --line daqin_section",
            "  train-ato import kmc.csv --train my_train.yaml --line my_line.yaml --rename 'v_ist:=speed_kmh' \\",
            "      --ignore Driver Door",
        )
    )


OPTIONS: Options = {
    "--layout": {"words": {"layouts": ", ".join(layout_names())}},
    "--rename": {"nargs": "+", "action": "extend"},
    "--ignore": {"nargs": "+", "action": "extend"},
    "--from-km": {"type": kilometre},
    "--tick": {"default": 0.1},
    "--largest-gap": {"default": MAX_GAP},
}


def finish(parser: argparse.ArgumentParser) -> None:
    """Add the columns of a file below the options."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _columns_text()


def execute(options: argparse.Namespace) -> None:
    """Read, check and write a measured run."""
    from train_ato.api.import_csv.table import titles_of
    from train_ato.api.importing import read_recorder

    if missing := [f"--{key}" for key in ("train", "line") if getattr(options, key) is None]:
        if len(titles_of(options.csv)) < 2 and options.layout is None:  # refused first
            raise ValueError(f"{options.csv}: no table: its first line has one column; give the file of a recorder")
        raise ValueError(f"{' and '.join(missing)}: missing; give the measured train and its line, a name or a file")
    measured = read_recorder(
        options.csv, train=options.train, line=options.line, layout=options.layout, rename=_renames(options.rename),
        ignore=options.ignore, from_km=options.from_km, tick=options.tick, largest_gap=options.largest_gap,
        smooth=options.smooth, sort=options.sort, name=options.name, dash="--",
    )  # fmt: skip
    write = _write_profile if options.profile_only else _write_run
    write(options, measured)


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


def _write_profile(options: argparse.Namespace, measured: MeasuredRun) -> None:
    from train_ato.api.importing import run_name

    path = options.out or Path(f"{run_name(options.csv)}_profile.csv")
    if path.exists():
        raise ValueError(f"--out {path}: exists already; give another name")
    measured.write_profile(path)
    result = {"profile": str(path), **_profile_figures(measured.setup), "measured_notes": measured.found.notes}
    _print_notes(measured)
    if options.json:
        print_json(result)
        return
    _print_rows(result, str(path))
    _print_use(measured, path)


def _write_run(options: argparse.Namespace, measured: MeasuredRun) -> None:
    """Write the run folder with its log."""
    from train_ato.api.importing import PROFILE

    run = measured.write(options.out)
    path = run.folder()
    result: dict[str, Any] = {
        **run.metrics,
        **_profile_figures(measured.setup),
        "run": str(path),
        "profile": str(path / PROFILE),
    }
    _print_notes(measured)
    if options.json:
        print_json(result)
        return
    _print_rows(result, measured.setup.scenario.name)
    sys.stdout.write(f"profile: {result['measured_profile']}; command: {result['measured_command']}\n")
    _print_use(measured, path / PROFILE)
    sys.stdout.write(f"recorded in {path}; a law on the same profile: train-ato run {path / 'scenario.yaml'}\n")


def _profile_figures(setup: RunSetup) -> dict[str, float]:
    profile = setup.profile
    return {
        "simulated_s": profile.end,
        "distance_m": float(profile.position[-1] - profile.position[0]),
        "speed_max_kmh": 3.6 * float(profile.velocity.max()),
    }


def _print_rows(result: dict[str, Any], title: str) -> None:
    rows = [(text, result[key]) for key, text in ROWS if result.get(key) is not None]
    print_table(("quantity", "value"), rows, title)


def _print_notes(measured: MeasuredRun) -> None:
    """Print the corrections and doubts of the file on stderr, also beside JSON."""
    for note in measured.found.notes:
        sys.stderr.write(f"note: {note}\n")


def _print_use(measured: MeasuredRun, path: Path) -> None:
    """Print the option that uses the profile."""
    rolling = ", allow_rolling_end: true" if measured.setup.profile.ends_rolling else ""
    sys.stdout.write(f"in another scenario: --set 'profile={{file: {path.resolve()}{rolling}}}'\n")
