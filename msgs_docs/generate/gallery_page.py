"""Generate the gallery of the site: every shipped scenario, train and line with its picture and numbers.

The scenarios of README are run by the build. The others are rows of ``gallery_measured.json``, because all of them
take minutes; ``--measure gallery`` runs them. Pictures of the rows, trains and lines are drawn as SVG.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

import train_ato as ta
from msgs_docs.generate.rows import read_rows, row_line, write_rows
from plant_sim.library import consist_names, line_names, load_consist, load_line
from plant_sim.track import Track
from plant_sim.units import KMH, number_text
from train_ato.api.progress import share_bar
from train_ato.cli.list import details
from train_ato.control.train_model import TrainModel
from train_ato.judge.metric_names import METRICS
from train_ato.judge.recording import REFERENCE
from train_ato.messages.types import Array
from train_ato.report.print_figures import STYLE as PRINT_STYLE
from train_ato.report.print_figures import UNDATED
from train_ato.report.quantities import COLOURS, GREY
from train_ato.scenario.scenario import expectation_of
from train_ato.scenario.scenario_files import scenario_names

NAME = "gallery"
MEASURED = Path("msgs_docs", "gallery_measured.json")
GALLERY = re.compile(r"^\| \[?`(?P<name>[\w:]+)`[^|]*\| (?P<shows>[^|]+) \|$", re.MULTILINE)
"""Row of the gallery of the README: name of the scenario and its content."""
SHOWN = ("speed_rmse_kmh", "stop_error_max_m", "coupler_draft_max_kn", "energy_traction_kwh", "running_time_s")
POINTS = 120
"""Number of times in the curve of a row."""
_COLOURED = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color", "grid.color")
STYLE = {**PRINT_STYLE, **dict.fromkeys(_COLOURED, GREY), "grid.alpha": 0.3}
"""Style of the figures with text, frame and grid that a dark page shows as well."""
Curve = tuple[str, Sequence[float] | Array, Sequence[float] | Array]
"""Name, and values across and up."""


def measured_row(name: str) -> dict[str, Any]:
    """Run a scenario; return verdict, parts, metrics and the curve of its speed, also of a run that failed."""
    try:
        run = ta.run(name)
    except ta.RunFailed as error:
        if error.run is None:
            raise
        run = error.run
    recording = run.recording
    picked = np.unique(np.linspace(0, recording.time.size - 1, POINTS).round().astype(int))
    time = recording.time[picked]
    found = recording.of(REFERENCE, "velocity")
    profile = np.zeros(0) if found is None else np.interp(time, found[0], KMH * found[1][:, 0])
    figures = {key: value for key in SHOWN if isinstance(value := run.metrics.get(key), (int, float))}
    return {
        "verdict": run.result.title,
        "law": run.metrics["controller"],
        "train": run.setup.consist.name,
        "line": run.setup.line.name,
        "figures": {key: float(f"{value:.4g}") for key, value in figures.items()},
        "time_s": [round(float(value), 1) for value in time],
        "speed_kmh": [round(float(value), 1) for value in KMH * recording.front_velocity[picked]],
        "profile_kmh": [round(float(value), 1) for value in profile],
    }


def measure(top: Path) -> None:
    """Run every shipped scenario and write its row."""
    names, rows = scenario_names(), {}
    with share_bar("gallery") as report:
        for count, name in enumerate(names):
            rows[name] = measured_row(name)
            report((count + 1) / len(names), name)
    write_rows(top / MEASURED, rows)


def unmeasured(top: Path) -> list[str]:
    """Return one line if a scenario has no row, or a row no scenario."""
    changed = set(scenario_names()) ^ set(read_rows(top / MEASURED))
    remedy = f"run python -m msgs_docs.generate --measure {NAME}"
    return [f"{MEASURED}: {', '.join(sorted(changed))}: not measured or not shipped; {remedy}"] if changed else []


def gallery(top: Path) -> dict[str, str]:
    """Return what each scenario of the gallery of README shows, by its name."""
    text = (top / "README.md").read_text(encoding="utf-8").partition("\n## Gallery\n")[2].partition("\n## ")[0]
    return {match["name"]: match["shows"].strip() for match in GALLERY.finditer(text)}


def write_gallery(top: Path, folder: Path) -> None:
    """Write the pages of the gallery; run the scenarios of README."""
    folder.mkdir(parents=True)
    text = "# Gallery\n\nEvery scenario was run by this build: `train-ato run NAME --engine`.\n"
    for name, shows in gallery(top).items():
        run = ta.run(name)
        picture = f"{_file_name(name)}.png"
        run.plot(folder / picture)
        rows = [("train", run.setup.consist.name), ("line", run.setup.line.name), ("law", run.metrics["controller"])]
        found = {key: run.metrics[key] for key in SHOWN if run.metrics.get(key) is not None}
        text += _section(name, [*rows, *_figures(found)], "run", picture, shows, run.result.title)
    (folder / "gallery.md").write_text(text, encoding="utf-8")
    (folder / "scenarios.md").write_text(scenarios_page(top, folder), encoding="utf-8")
    (folder / "trains.md").write_text(trains_page(folder), encoding="utf-8")
    (folder / "lines.md").write_text(lines_page(folder), encoding="utf-8")


def scenarios_page(top: Path, folder: Path) -> str:
    """Return the page of every shipped scenario; write its pictures."""
    text = (
        "# All scenarios\n\nEvery shipped scenario and variant: `train-ato run NAME --engine`. It is expected to "
        "pass or to\nfail; a failed one shows a limit of a law or of a train. `python -m msgs_docs.generate --measure "
        "gallery` measures\nthe rows.\n"
    )
    rows = read_rows(top / MEASURED)
    for name in scenario_names():
        row, expected = rows[name], expectation_of(name)
        curves: list[Curve] = [("profile", row["time_s"], row["profile_kmh"])] if row["profile_kmh"] else []
        curves.append(("train", row["time_s"], row["speed_kmh"]))
        picture = f"{_file_name(name)}.svg"
        draw(folder / picture, curves, "time in s", "speed in km/h")
        parts = [("train", row["train"]), ("line", row["line"]), ("law", row["law"])]
        parts += [("expected", expected.text)] if expected else []
        summary = details(name)["scenario"]["summary"]
        text += _section(name, [*parts, *_figures(row["figures"])], "speed", picture, summary, row["verdict"])
    return text


def trains_page(folder: Path) -> str:
    """Return the page of every shipped train; write the pictures of its forces."""
    text = "# Trains\n\n`train-ato list NAME` prints the same. The picture has the forces of all power units.\n"
    for name in consist_names():
        consist = load_consist(name)
        ends = [segment.to for kind in consist.vehicle_types.values() for segment in kind.traction]
        fastest = KMH * max(ends, default=100 / KMH)
        speeds = np.linspace(0.0, fastest, 160)
        none = np.zeros(len(consist.power_units))
        model = TrainModel(consist, load_line("level"), none, none, 0.0, 0.1)
        limits = [model.force_limits(np.full(none.size, speed / KMH)) for speed in speeds]
        least, most = (np.array([side.sum() for side in sides]) / 1e3 for sides in zip(*limits, strict=True))
        curves: list[Curve] = [("traction", speeds, most), ("electric brake", speeds, least)]
        draw(folder / f"forces_{name}.svg", curves, "speed in km/h", "force in kN")
        text += _section(name, details(name)["consist"].items(), "forces", f"forces_{name}.svg")
    return text


def lines_page(folder: Path) -> str:
    """Return the page of every shipped line; write the pictures of its height and its speed limits."""
    text = "# Lines\n\n`train-ato list NAME` prints the same. The picture has the height above the begin of the line.\n"
    for name in line_names():
        line = load_line(name)
        track = Track(line)
        inside = track.breaks[(track.breaks > line.begin) & (track.breaks < line.end)]
        places = np.concatenate(([line.begin], inside, [line.end]))
        curves: list[Curve] = [("height", places / 1e3, track.elevation(places))]
        stops = [(stop.at / 1e3, stop.name) for stop in line.stops]
        draw(folder / f"height_{name}.svg", curves, "km", "height in m", stops)
        text += _section(name, details(name)["line"].items(), "height", f"height_{name}.svg")
    return text


def _section(
    name: str, facts: Iterable[tuple[str, str]], content: str, picture: str, shows: str = "", verdict: str = ""
) -> str:
    """Return the section of a scenario, a train or a line: its text and verdict, a table and its picture."""
    told = f"{shows[0].upper()}{shows[1:]}.\n\n**{verdict}**\n\n" if shows else ""
    table = "\n".join(["| | |", "|---|---|", *(row_line(*fact) for fact in facts if fact[1])])
    return f"\n## {name}\n\n{told}{table}\n\n![{content} of {name}]({picture})\n"


def _figures(found: dict[str, float]) -> list[tuple[str, str]]:
    return [(f"{METRICS[key][0]} in {METRICS[key][1]}", number_text(value, 3)) for key, value in found.items()]


def _file_name(name: str) -> str:
    return re.sub(r"[^a-z0-9_]", "_", name)


def draw(path: Path, curves: Sequence[Curve], across: str, up: str, marks: Sequence[tuple[float, str]] = ()) -> None:
    """Draw curves with the names of their axes as SVG, for light and dark pages.

    Parameters
    ----------
    path
        File of the picture.
    curves
        Name, values across and values up of each.
    across, up
        Quantity and unit of the axes.
    marks
        Places across with their names.
    """
    figure = Figure(figsize=(10.0, 3.1), layout="constrained")
    with mpl.rc_context(STYLE):
        axes = figure.subplots()
        for (name, values_x, values_y), colour in zip(curves, COLOURS, strict=False):
            axes.plot(values_x, values_y, color=colour, lw=1.6, label=name)
        for at, name in marks:
            axes.axvline(at, color=GREY, lw=1.0, ls="--")
            axes.text(at, 1.0, f" {name}", transform=axes.get_xaxis_transform(), va="top", fontsize="small")
        axes.set(xlabel=across, ylabel=up, ylim=(min(0.0, axes.get_ylim()[0]), None))
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(curves), frameon=False)
        figure.savefig(path, transparent=True, metadata=UNDATED[".svg"])
