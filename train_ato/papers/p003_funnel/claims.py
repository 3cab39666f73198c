"""Paper 003: dynamic-surface funnel control of a high-speed train with input delay and saturation."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.papers import claims as c
from train_ato.papers.claims import largest_position_error as place
from train_ato.papers.claims import largest_speed_error as speed
from train_ato.papers.claims import recording as series_of
from train_ato.papers.drawing import panel_grid, save_grid, thinned
from train_ato.papers.p003_funnel import checks as judge
from train_ato.papers.p003_funnel.checks import boundaries, off_profile
from train_ato.report.quantities import COLOURS

LONG = "crh380a_funnel"
LAWS, TRAINS, SINGLE, PRINTED_FORMS = c.read_paper_runs(__package__)
CASES = SINGLE | {
    f"{key} {train}": c.Case(f"{LONG}:short{variants}", changes)
    for key, (_, changes) in LAWS.items()
    for train, (_, variants) in TRAINS.items()
    if key != "quiet" or "planned" not in train
}
"""Runs of the CRH380A as one mass for paper 003: some on 286 km, the others shorter with the same phases.

The largest errors of both occur in the same phases. The errors of the printed law also depend on the length of the run,
because its funnel narrows over hours.
"""


def draw(results: c.Results, folder: Path) -> list[c.FigureFile]:
    """Draw the figures of paper 003 into a folder and return them."""
    nominal = {"printed long": "printed", "corrected long": "corrected", "pid long": "PID + preview"}
    cut = {"printed long saturated": "printed", "corrected long saturated": "corrected"}
    lost = {"unhandled long": "not handled"}
    return [
        _tracking(results, nominal, "no saturation, 286 km", folder / "paper003_tracking.png"),
        _tracking(results, cut, "200 kN, 286 km", folder / "paper003_saturated.png", (57.5, 61.8)),
        _tracking(results, lost, "200 kN, saturation not handled, 286 km", folder / "paper003_unhandled.png"),
        _funnels(results, folder / "paper003_funnels.png"),
        _planned(results, folder / "paper003_planned.png"),
    ]


def _tracking(
    results: c.Results, keys: Mapping[str, str], title: str, path: Path, zoom: tuple[float, float] | None = None
) -> c.FigureFile:
    """Draw figures 1 to 5: speed, position error, speed error, force; on the right a time range [min]."""
    figure, axes = panel_grid(title, 4, 1 if zoom is None else 2, width=11 if zoom is None else 15)
    for index, (key, label) in enumerate(keys.items()):
        recording = series_of(results[key])
        series = (
            3.6 * recording.front_velocity,
            c.position_error(recording)[:, 0],
            c.speed_error(recording)[:, 0],
            recording.applied[:, 0] / 1e3,
        )
        for column, (begin, end) in enumerate([(0.0, np.inf)] + ([zoom] if zoom else [])):
            part = (recording.time >= 60.0 * begin) & (recording.time <= 60.0 * end)
            time = recording.time[part] / 60.0
            if index == 0:
                reference = thinned(time, 3.6 * recording.reference_velocity[part])
                axes[0, column].plot(*reference, color=COLOURS[5], lw=2.5, alpha=0.5, label="profile")
            for row, values in enumerate(series):
                axes[row, column].plot(*thinned(time, values[part]), color=COLOURS[index], lw=0.9, label=label)
    labels = ("speed in km/h", "position error in m", "speed error in m/s", "applied force in kN")
    for panel, label in zip(axes[:, 0], labels, strict=True):
        panel.set_ylabel(label)
    return save_grid(figure, axes, path, "time in min")


def _funnels(results: c.Results, path: Path) -> c.FigureFile:
    """Draw errors and funnels of the short saturated run, printed and corrected."""
    figure, axes = panel_grid(
        "funnels with 200 kN (short run): printed left, corrected right", 2, 2, height=3.0, width=14
    )
    for column, key in enumerate(("printed saturated", "corrected saturated")):
        case, recording = CASES[key], series_of(results[key])
        phi1, phi2 = boundaries(case, recording)
        errors = (c.position_error(recording)[:, 0], c.speed_error(recording)[:, 0])
        units = ("position in m", "speed in m/s")
        for row, (error, phi, unit) in enumerate(zip(errors, (phi1, phi2), units, strict=True)):
            panel = axes[row, column]
            panel.semilogy(recording.time, np.maximum(np.abs(error), 1e-5), color=COLOURS[0], lw=0.9, label="|error|")
            panel.semilogy(recording.time, phi, color=COLOURS[1], lw=1.2, ls="--", label="funnel")
            panel.set_ylabel(unit)
    return save_grid(figure, axes, path)


def _planned(results: c.Results, path: Path) -> c.FigureFile:
    """Draw the errors to the original profile with 200 kN."""
    figure, axes = panel_grid("200 kN: error to the profile that needs 225.7 kN (short run)", 3)
    choices = (
        ("predictor saturated", "followed"),
        ("predictor planned", "planned for beforehand"),
        ("predictor replanned", "found and re-planned"),
    )
    for index, (key, label) in enumerate(choices):
        recording = series_of(results[key])
        off, fast = off_profile(recording, f"{LONG}:short")
        axes[0, 0].plot(recording.time, off, color=COLOURS[index], lw=1.0, label=label)
        axes[1, 0].plot(recording.time, fast, color=COLOURS[index], lw=1.0, label=label)
        axes[2, 0].plot(recording.time, recording.applied[:, 0] / 1e3, color=COLOURS[index], lw=0.9, label=label)
    for row, label in enumerate(("position error in m", "speed error in m/s", "applied force in kN")):
        axes[row, 0].set_ylabel(label)
    return save_grid(figure, axes, path)


def _rows(results: c.Results) -> Sequence[Sequence[Any]]:
    """Return one row per train: position max, rms and speed max of every law."""
    rows: list[list[Any]] = []
    for train, (label, _) in TRAINS.items():
        cells = []
        for key in LAWS:
            result = results.get(f"{key} {train}")
            if result is None or result.recording is None:
                cells.append("-")
            elif train == "noise":
                cells.append(f"{place(result):.3f} / {c.variation(result):.0f} kN/s")
            else:
                cells.append(f"{place(result):.3f} / {1e3 * judge.place_rms(result):.1f} / {speed(result):.3f}")
        rows.append([label, *cells])
    return rows


EXTRA = {
    "printed long": "printed, 286 km",
    "corrected long": "corrected, 286 km",
    "pid long": "PID + preview, 286 km",
    "predictor long": "PID + predictor + eso, 286 km",
    "printed long saturated": "printed, 286 km, 200 kN",
    "corrected long saturated": "corrected, 286 km, 200 kN",
    "printed network": "printed with its network",
    "corrected, f known": "corrected, f known instead of the network",
    "corrected no delay state": "corrected without the delay state",
    "printed light long": "printed, 286 km, mass -20 %",
    "lag modelled": "PID + predictor + eso, lag 0.4 s known",
    "pid alone": "PID without feed-forward",
}


def _extra(results: c.Results) -> Sequence[Sequence[Any]]:
    return [
        [label, *(c.written(figure(results[key]), unit) for figure, unit in FIGURES)] for key, label in EXTRA.items()
    ]


FIGURES = ((place, "m"), (judge.place_rms, "m"), (speed, "m/s"))

PAPER = c.Paper(
    number="003",
    title="dynamic-surface funnel control of a CRH380A, delay 0.2 |sin t| s, 286 km",
    cases=CASES,
    claims=judge.CLAIMS,
    figures=draw,
    tables=(
        c.CaseTable(
            "short run (36 km, the same phases): e1 max in m / e1 rms in mm / speed error max in m/s (rms and speed "
            "only where v_ref > 1 m/s)",
            ("case", *(label for label, _ in LAWS.values())),
            _rows,
        ),
        c.CaseTable(
            "more runs (rms and speed only where v_ref > 1 m/s)", ("run", "e1 max", "e1 rms", "speed error max"), _extra
        ),
        c.printed_forms_table(PRINTED_FORMS),
    ),
)
