"""A measured speed and force history as a run, or as a speed profile."""

import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from plant_sim.library import load_consist, load_line
from plant_sim.line import ENDING, Line, line_for
from train_ato.api.import_csv.columns import MAX_GAP
from train_ato.api.import_csv.layout import NO_LAYOUT, load_layout
from train_ato.api.import_csv.recording import Measured, MeasuredCheck, place_notes
from train_ato.api.import_csv.run import measured_result, measured_setup, series_of, write_messages
from train_ato.api.import_csv.samples import add_notch_force, sort_rows
from train_ato.api.import_csv.smoothing import MAX_WINDOW, measured_profile, window_of
from train_ato.api.import_csv.table import read_table
from train_ato.api.progress import activity, progress_bar
from train_ato.api.run import Run
from train_ato.judge.result import Progress
from train_ato.log.run_folder import RunFolder, summary_text
from train_ato.log.versions import SUMMARY
from train_ato.profile.file import write_profile
from train_ato.program.arguments import option_name
from train_ato.scenario.profile_spec import check_on_line
from train_ato.scenario.setup import RunSetup

PROFILE = "profile.csv"
STEP = 0.005
"""Plant step of an imported scenario; the tick is a multiple of it [s]."""


@dataclass(frozen=True)
class MeasuredRun:
    """Measured run before it is written: setup, samples, and averaging window of its profile [s]."""

    setup: RunSetup
    found: Measured
    window: float

    def write_profile(self, path: Path) -> None:
        """Write the profile with its source."""
        means = f"speed averaged over {self.window:.3g} s twice" if self.window else "the speed as it is"
        source = f"measured: {self.found.table.path.name}, {self.found.table.lines.size} rows, {means}"
        write_profile(self.setup.profile, path, source)

    def write(self, out: Path | None, option: str = "--out") -> Run:
        """Write the run folder with log, profile, summary and figure; a failure leaves none."""
        setup = self.setup
        block = series_of(self.found, setup)
        outcome = measured_result(setup, self.found, block, self.window)
        attached = {SUMMARY: summary_text(outcome.summary).encode()}
        folder = RunFolder.make(out, setup.scenario.name, option)
        begin = time.perf_counter()
        try:
            folder.begin(setup)
            with progress_bar(f"writing {folder.path}") as progress, folder.sink(setup, attached, timed=False) as sink:

                def report(tick: int) -> None:
                    progress(Progress(tick * setup.tick, setup.ticks * setup.tick, time.perf_counter() - begin))

                write_messages(setup, block, sink, report)
            self.write_profile(folder.path / PROFILE)
            folder.finish(setup, outcome)
            from train_ato.report.print_figures import write_run_figure  # matplotlib: not needed before the end

            write_run_figure(setup, outcome, folder.path)
        except BaseException:
            folder.discard(converted=True)
            raise
        return Run(outcome.summary, folder.path, setup=setup)


def import_run(
    csv: str | Path,
    *,
    train: str | Path,
    line: str | Path,
    layout: str | Path | None = None,
    rename: Mapping[str, str] | None = None,
    ignore: Sequence[str] = (),
    from_km: float | str | None = None,
    tick: float = 0.1,
    largest_gap: float = MAX_GAP,
    smooth: float | None = None,
    sort: bool = False,
    name: str | None = None,
    out: str | Path | None = None,
) -> Run:
    """Convert the file of an on-board recorder to a run, as ``train-ato import`` does.

    Parameters
    ----------
    csv
        File with the columns that ``train-ato import --help`` lists.
    train, line
        Measured train and its line: shipped name or file.
    layout
        Layout of the recorder: shipped name or file.
    rename, ignore
        Columns read under another name, and columns that are not read.
    from_km
        Position of the front at the first row [km], or a post such as ``84+500``, for a file without a position column.
    tick
        Period of the run [s].
    largest_gap
        Longest gap to bridge [s].
    smooth
        Averaging window of the profile [s], 0: none; default: from the resolution of the speed.
    sort
        Sort the rows by time and remove repeated rows.
    name
        Name of the run; default: as in the file.
    out
        Run folder to make; default: ``runs/NAME-N``, as for the command.

    Raises
    ------
    ValueError
        Bad input, one line for each fault; nothing was written.
    """
    found = read_recorder(
        csv, train=train, line=line, layout=layout, rename=rename, ignore=ignore, from_km=from_km, tick=tick,
        largest_gap=largest_gap, smooth=smooth, sort=sort, name=name,
    )  # fmt: skip
    return found.write(None if out is None else Path(out), "out")


def read_recorder(
    csv: str | Path,
    *,
    train: str | Path,
    line: str | Path,
    layout: str | Path | None = None,
    rename: Mapping[str, str] | None = None,
    ignore: Sequence[str] = (),
    from_km: float | str | None = None,
    tick: float = 0.1,
    largest_gap: float = MAX_GAP,
    smooth: float | None = None,
    sort: bool = False,
    name: str | None = None,
    dash: str = "",
) -> MeasuredRun:
    """Read and check a measured run with the parameters of :func:`import_run`.

    ``dash`` precedes names of options in messages.
    """
    _check_numbers(largest_gap, tick, smooth, from_km, dash)
    consist = load_consist(str(train))
    on = line_for(load_line(str(line)), consist.categories, consist.rating)
    if not consist.power_units:
        option = "--train" if dash else "train"
        raise ValueError(f"{option} {train}: has no power unit; name the measured train")
    kind = NO_LAYOUT if layout is None else load_layout(str(layout))
    with activity(f"reading {csv}"):
        table = read_table(Path(csv), dict(rename or {}), frozenset(ignore), kind)
    notes = [sort_rows(table) if sort or kind.sort else "", add_notch_force(table, consist)]
    half = consist.vehicles[0].length / 2
    against = str(line).endswith(ENDING)
    found = MeasuredCheck(table, consist, on, against=against, largest_gap=largest_gap).run()
    found.notes += [note for note in notes if note]
    window = window_of(found) if smooth is None else smooth
    profile = measured_profile(found, tick, _start(from_km, found, half, on, dash), window)
    front = np.interp(found.speed.time, profile.time, profile.position) + half
    found.notes += place_notes(found, front, on, consist.length)
    title = (found.position or found.speed).column.title
    try:
        check_on_line(profile, consist, on, f"check the unit of '{title}', {option_name('from_km', dash)} and the line")
    except ValueError as error:
        raise ValueError(f"{csv}: {error}") from None
    setup = measured_setup(found, profile, str(train), str(line), name or run_name(Path(csv)))
    return MeasuredRun(setup, found, window)


def _check_numbers(
    largest_gap: float, tick: float, smooth: float | None, from_km: float | str | None, dash: str
) -> None:
    """Check the numbers of the options."""
    if not 0 < largest_gap < float("inf"):
        raise ValueError(f"{option_name('largest_gap', dash)} {largest_gap}: out of range; give more than 0 s")
    steps = tick / STEP
    if not STEP <= tick <= 10 or abs(steps - round(steps)) > 1e-6:
        raise ValueError(f"{dash}tick {tick}: out of range; give a multiple of {STEP:g} s up to 10 s, for example 0.1")
    if smooth is not None and not 0 <= smooth <= MAX_WINDOW:
        raise ValueError(f"{dash}smooth {smooth}: out of range; give 0 to {MAX_WINDOW:g} s")
    if isinstance(from_km, (int, float)) and not abs(from_km) < 1e5:
        raise ValueError(f"{option_name('from_km', dash)} {from_km}: out of range; give kilometres of the line")


def run_name(path: Path) -> str:
    """Return a valid name of a scenario from a file name."""
    return re.sub(r"[^A-Za-z0-9_.+-]+", "_", path.stem).strip("_.+-")[:80] or "measured"


def _start(from_km: float | str | None, found: Measured, half: float, line: Line, dash: str) -> float:
    """Return the position of vehicle 0's centre at the first row [m]."""
    if found.position is not None:
        if from_km is not None:
            option, ignored = option_name("from_km", dash), f"{dash}ignore '{found.position.column.title}'"
            raise ValueError(f"{option} {from_km}: the file has a position column; remove the option, or add {ignored}")
        return float(found.position.values[0])
    if from_km is None:
        return line.begin
    return (line.place_of(from_km) if isinstance(from_km, str) else from_km * 1e3) - half
