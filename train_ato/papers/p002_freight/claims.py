"""Paper 002: cascaded disturbance observer and fixed-time sliding mode on a freight train of five vehicles."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.messages.types import Array
from train_ato.papers.checks import mean_speed_error, position_error, printed_forms_table
from train_ato.papers.checks import recording as series_of
from train_ato.papers.claims import CaseTable, FigureFile, Paper, Results
from train_ato.papers.drawing import HELD, Sheet
from train_ato.papers.p002_freight import checks as judge
from train_ato.papers.p002_freight import observer_checks
from train_ato.papers.p002_freight.cases import CASES, DELAYS, LAWS, OBSERVER_TICKS, PRINTED_FORMS, RATIOS
from train_ato.papers.p002_freight.observer_checks import percent
from train_ato.papers.p002_freight.observer_trials import FORMS
from train_ato.report.quantities import COLOURS

OFFSETS: Array = 80.0 * np.arange(5, dtype=np.float64)
MASS = 80e3


def draw(results: Results, folder: Path) -> list[FigureFile]:
    """Draw the figures of paper 002 into a folder and return them."""
    return [
        _observers(results, folder / "paper002_estimates.png"),
        _tracking(results, folder / "paper002_tracking.png"),
        _settling(results, folder / "paper002_settling.png"),
        _realistic(results, folder / "paper002_realistic.png"),
    ]


def _observers(results: Results, path: Path) -> FigureFile:
    """Draw figures 3 to 10: d1, d2 and d1' of every car."""
    series = results["observers 1 ms"].series
    sheet = Sheet("disturbances of every car and their estimates, sampled at 1 ms", 5, 3, height=2.0, width=16)
    heads = ("d1 in m/s", "d2 in m/s²", "d1' in m/s²")
    for car in range(5):
        for column, head in enumerate(heads):
            panel = sheet.panel(car, column)
            true = series["truth"][column, :, car]
            for name, colour in (("printed", COLOURS[5]), ("implicit", COLOURS[0]), ("levant", COLOURS[2])):
                if name != "printed" or column < 2:
                    found = series[name][column, :, car]
                    width, alpha = (0.5, 0.4) if name == "printed" else (0.9, 1.0)
                    panel.plot(series["time"], found, color=colour, label=name, lw=width, alpha=alpha)
            panel.plot(series["time"], true, color=COLOURS[1], lw=1.0, ls="--", label="truth")
            room = 1.3 * float(np.abs(true).max())
            panel.set_ylim(-room, room if car else 1.7 * room)
            panel.set_ylabel(f"car {car + 1}: {head}")
    return sheet.save(path, legends=(0,))


def _tracking(results: Results, path: Path) -> FigureFile:
    """Draw figures 11 to 13 and the force: left the whole run, right the first three seconds."""
    recording = series_of(results["ideal"])
    t = recording.time
    sheet = Sheet("fixed-time law, gain 1.9, cascaded observer, tick 1 ms", 5, 2, height=2.1, width=15)
    motion = np.gradient(recording.position, t, axis=0)
    stretch = -np.diff(recording.position, axis=1) - np.diff(OFFSETS)
    error = position_error(recording, OFFSETS)
    for column, until in enumerate((t[-1], 3.0)):
        part = t <= until
        rows = [sheet.panel(row, column) for row in range(5)]
        rows[0].plot(
            t[part], recording.reference_velocity[part], color=COLOURS[5], lw=2.5, alpha=0.5, label="reference"
        )
        rows[1].plot(
            t[part], recording.reference_position[part], color=COLOURS[5], lw=2.5, alpha=0.5, label="reference"
        )
        for car in range(5):
            look: dict[str, Any] = {"color": COLOURS[car], "lw": 0.9, "label": f"car {car + 1}"}
            rows[0].plot(t[part], motion[part, car], **look)
            rows[1].plot(t[part], recording.position[part, car] + OFFSETS[car], **look)
            rows[2].plot(t[part], error[part, car], **look)
            rows[4].plot(t[part], recording.command[part, car] / MASS, **look, **HELD)
        for coupler in range(4):
            rows[3].plot(
                t[part], stretch[part, coupler], color=COLOURS[coupler], lw=0.9, label=f"coupler {coupler + 1}"
            )
        rows[0].set_ylim(-40, 40)
        rows[2].set_ylim(-1.5, 1.5)
        rows[3].set_ylim(-1.5, 1.5)
        rows[4].set_yscale("symlog", linthresh=10)
        labels = (
            "x' = v + d1 in m/s", "x + offset in m", "position error in m", "coupler stretch in m",
            "force per mass in m/s²",
        )  # fmt: skip
        for panel, label in zip(rows, labels, strict=True):
            panel.set_ylabel(label)
    return sheet.save(path, legends=(0, 3))


def _settling(results: Results, path: Path) -> FigureFile:
    """Draw error and acceleration of the nominal error dynamics."""
    sheet = Sheet("error dynamics of the fixed-time law without limits, from 108 m", 2)
    for index, gain in enumerate(("1.9", "50")):
        series = results[f"gain {gain} from 108 m"].series
        later = series["time"] > 1e-9
        t = series["time"][later]
        sheet.panel(0).loglog(t, np.abs(series["error"][later]), color=COLOURS[index], label=f"gain {gain} 1/s")
        sheet.panel(1).loglog(t, np.abs(series["acceleration"][later]), color=COLOURS[index], label=f"gain {gain} 1/s")
    sheet.panel(0).axhline(0.01, color=COLOURS[5], ls=":", label="settled")
    sheet.panel(1).axhline(0.8, color=COLOURS[5], ls=":", label="a real train, 0.8 m/s²")
    sheet.panel(0).set_ylabel("|E| in m")
    sheet.panel(1).set_ylabel("|E''| in m/s²")
    return sheet.save(path)


def _realistic(results: Results, path: Path) -> FigureFile:
    """Draw the realistic setting at a delay of 1 s: worst position error, mean speed error, couplers, force."""
    sheet = Sheet("limits, lag 0.4 s, delay 1.0 s, noise, travelling load of 0.1 m/s²", 5)
    choices = (
        ("print", "paper's law, gain 2"),
        ("scaled predicted", "gain 0.3, predictor"),
        ("unit", "lag_smc per car"),
        ("common damped", "lag_smc common"),
    )
    for index, (key, label) in enumerate(choices):
        recording = series_of(results[f"{key} 1.0"])
        t, colour = recording.time, COLOURS[index]
        if index == 0:
            sheet.panel(0).plot(t, recording.reference_velocity, color=COLOURS[5], lw=2.5, alpha=0.5, label="profile")
        sheet.panel(0).plot(t, recording.front_velocity, color=colour, lw=0.9, label=label)
        error = position_error(recording, OFFSETS)
        worst = error[np.arange(t.size), np.abs(error).argmax(axis=1)]
        sheet.panel(1).plot(t, worst, color=colour, lw=0.9, label=label)
        sheet.panel(2).plot(t, mean_speed_error(recording), color=colour, lw=0.9, label=label)
        sheet.panel(3).plot(t, recording.coupler_draft_max / 1e3, color=colour, lw=0.8, label=label)
        sheet.panel(3).plot(t, recording.coupler_buff_max / 1e3, color=colour, lw=0.8)
        sheet.panel(4).plot(t, recording.applied.sum(axis=1) / 1e3, color=colour, lw=0.8, label=label)
    sheet.panel(1).set_ylim(-2, 2)
    sheet.panel(2).set_ylim(-0.5, 0.5)
    sheet.panel(3).set_ylim(-150, 150)
    labels = ("speed in m/s", "position error,\nworst car, in m", "mean speed error\nin m/s",
              "coupler force in kN\n(draft > 0)", "applied force\nin kN")  # fmt: skip
    for row, label in enumerate(labels):
        sheet.panel(row).set_ylabel(label)
    return sheet.save(path)


def _row(results: Results, law: str, settings: Iterable[str]) -> list[str]:
    found = [judge.realistic(results, f"{law} {setting}") for setting in settings]
    return [LAWS[law][0], *(f"{place:.2f} / {coupler:.2f}" for place, _, coupler in found)]


def _table_rows(results: Results) -> Sequence[Sequence[Any]]:
    return [_row(results, law, (f"{delay}" for delay in DELAYS if f"{law} {delay}" in results)) for law in LAWS]


def _ratio_rows(results: Results) -> Sequence[Sequence[Any]]:
    return [_row(results, law, (f"x{ratio}" for ratio in RATIOS)) for law in ("unit", "common", "common damped")]


def _observer_rows(results: Results) -> Sequence[Sequence[Any]]:
    return [
        [
            f"{key} {name}",
            *(percent(results[f"observers {key}"].summary[f"{name} {part}"]) for part in ("d1", "d2", "d1'")),
            judge.time_text(results[f"observers {key}"].summary[f"{name} settling"]),
        ]
        for key in OBSERVER_TICKS
        for name in FORMS
    ]


PAPER = Paper(
    number="002",
    title="fixed-time sliding mode with a cascaded disturbance observer, five freight vehicles",
    cases=CASES,
    claims=[*observer_checks.CLAIMS, *judge.CLAIMS],
    figures=draw,
    tables=(
        CaseTable(
            "observers: rms error of the worst car over the rms of its disturbance, and time until d1 and d2 are "
            "within 10 % (0.01 ms: from 0.06 to 0.1 s only)",
            ("sampling, form", "d1", "d2", "d1'", "settled"),
            _observer_rows,
        ),
        CaseTable(
            "realistic version: position rms / largest coupler stretch in m over the delay",
            ("law", *(f"{delay:g} s" for delay in DELAYS)),
            _table_rows,
        ),
        CaseTable(
            "the same over the ratio of true to modelled delay (modelled 0.8 s)",
            ("law", *(f"{ratio:g}" for ratio in RATIOS)),
            _ratio_rows,
        ),
        printed_forms_table(PRINTED_FORMS),
    ),
)
