"""Figures of paper 003: tracking, saturation with and without handling, funnels."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from train_ato.papers.checks import recording as series_of
from train_ato.papers.claims import FigureFile, Results
from train_ato.papers.drawing import thinned
from train_ato.papers.p003_funnel.cases import CASES
from train_ato.papers.p003_funnel.series import boundaries, off_profile
from train_ato.papers.sheets import COLOURS, Sheet
from train_ato.papers.tracking import position_error, speed_error

LONG = "crh380a_funnel"


def draw(results: Results, folder: Path) -> list[FigureFile]:
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
    results: Results, keys: Mapping[str, str], title: str, path: Path, zoom: tuple[float, float] | None = None
) -> FigureFile:
    """Draw figures 1 to 5: speed, position error, speed error, force; on the right a time range [min]."""
    sheet = Sheet(f"{title}", 4, 1 if zoom is None else 2, width=11 if zoom is None else 15)
    for index, (key, label) in enumerate(keys.items()):
        recording = series_of(results[key])
        series = (
            3.6 * recording.front_velocity,
            position_error(recording)[:, 0],
            speed_error(recording)[:, 0],
            recording.applied[:, 0] / 1e3,
        )
        for column, (begin, end) in enumerate([(0.0, np.inf)] + ([zoom] if zoom else [])):
            part = (recording.time >= 60.0 * begin) & (recording.time <= 60.0 * end)
            time = recording.time[part] / 60.0
            if index == 0:
                reference = thinned(time, 3.6 * recording.reference_velocity[part])
                sheet.panel(0, column).plot(*reference, color=COLOURS[5], lw=2.5, alpha=0.5, label="profile")
            for row, values in enumerate(series):
                sheet.panel(row, column).plot(*thinned(time, values[part]), color=COLOURS[index], lw=0.9, label=label)
    labels = ("speed in km/h", "position error in m", "speed error in m/s", "applied force in kN")
    for row, label in enumerate(labels):
        sheet.panel(row).set_ylabel(label)
    return sheet.save(path, "time in min")


def _funnels(results: Results, path: Path) -> FigureFile:
    """Draw errors and funnels of the short saturated run, printed and corrected."""
    sheet = Sheet("funnels with 200 kN (short run): printed left, corrected right", 2, 2, height=3.0, width=14)
    for column, key in enumerate(("printed saturated", "corrected saturated")):
        case, recording = CASES[key], series_of(results[key])
        phi1, phi2 = boundaries(case, recording)
        errors = (position_error(recording)[:, 0], speed_error(recording)[:, 0])
        units = ("position in m", "speed in m/s")
        for row, (error, phi, unit) in enumerate(zip(errors, (phi1, phi2), units, strict=True)):
            panel = sheet.panel(row, column)
            panel.semilogy(recording.time, np.maximum(np.abs(error), 1e-5), color=COLOURS[0], lw=0.9, label="|error|")
            panel.semilogy(recording.time, phi, color=COLOURS[1], lw=1.2, ls="--", label="funnel")
            panel.set_ylabel(unit)
    return sheet.save(path)


def _planned(results: Results, path: Path) -> FigureFile:
    """Draw the errors to the original profile with 200 kN."""
    sheet = Sheet("200 kN: error to the profile that needs 225.7 kN (short run)", 3)
    choices = (
        ("predictor saturated", "followed"),
        ("predictor planned", "planned for beforehand"),
        ("predictor replanned", "found and re-planned"),
    )
    for index, (key, label) in enumerate(choices):
        recording = series_of(results[key])
        off, fast = off_profile(recording, f"{LONG}:short")
        sheet.panel(0).plot(recording.time, off, color=COLOURS[index], lw=1.0, label=label)
        sheet.panel(1).plot(recording.time, fast, color=COLOURS[index], lw=1.0, label=label)
        sheet.panel(2).plot(recording.time, recording.applied[:, 0] / 1e3, color=COLOURS[index], lw=0.9, label=label)
    for row, label in enumerate(("position error in m", "speed error in m/s", "applied force in kN")):
        sheet.panel(row).set_ylabel(label)
    return sheet.save(path)
