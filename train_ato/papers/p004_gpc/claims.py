"""Paper 004: multivariable nonlinear generalised predictive control of an EMU with three power units."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from train_ato.papers import claims as c
from train_ato.papers.claims import largest_position_error as unit_place
from train_ato.papers.claims import largest_speed_error as speed
from train_ato.papers.claims import recording as series_of
from train_ato.papers.drawing import panel_grid, save_grid
from train_ato.papers.p004_gpc import checks as judge
from train_ato.papers.p004_gpc.checks import CASES, JUMP, LAWS, PRINTED_FORMS, SAMPLINGS, TRAINS, WEIGHTS, speed_rms
from train_ato.report.quantities import COLOURS


def draw(results: c.Results, folder: Path) -> list[c.FigureFile]:
    """Draw the figures of paper 004 into a folder and return them."""
    normal = {"pid long": "PID", "gpc long": "gpc, Ts 1.2 s", "pid preview long": "PID + preview"}
    jump = {
        "pid jump": "PID",
        "gpc absolute jump": "gpc as printed",
        "gpc jump": "gpc on increments",
        "pid preview jump": "PID + preview",
    }
    coupled = {"per unit": "three laws", "gpc normal": "one law on the mean speed"}
    return [
        _runs(results, normal, "normal, 286 km", folder / "paper004_normal.png", minutes=True),
        _runs(results, jump, "gain 0.8, delay x1.3, lag 0.6 s from 100 s on (short run)", folder / "paper004_jump.png"),
        _runs(results, coupled, "coupled units (short run)", folder / "paper004_coupled.png"),
        _sampling(results, folder / "paper004_sampling.png"),
    ]


def _runs(
    results: c.Results, keys: Mapping[str, str], title: str, path: Path, *, minutes: bool = False
) -> c.FigureFile:
    """Draw figures 5 to 8: speed, error of the first unit, position error, force, couplers."""
    figure, axes = panel_grid(title, 5)
    for index, (key, label) in enumerate(keys.items()):
        recording = series_of(results[key])
        t, colour = recording.time / (60.0 if minutes else 1.0), COLOURS[index]
        if index == 0:
            axes[0, 0].plot(t, 3.6 * recording.reference_velocity, color=COLOURS[5], lw=2.5, alpha=0.5, label="profile")
        axes[0, 0].plot(t, 3.6 * recording.front_velocity, color=colour, lw=0.9, label=label)
        axes[1, 0].plot(t, c.speed_error(recording)[:, 0], color=colour, lw=0.9, label=label)
        axes[2, 0].plot(t, c.position_error(recording)[:, 0], color=colour, lw=0.9, label=label)
        axes[3, 0].plot(t, recording.applied.sum(axis=1) / 1e3, color=colour, lw=0.9, label=label)
        axes[4, 0].plot(t, recording.coupler_draft_max / 1e3, color=colour, lw=0.8, label=label)
        axes[4, 0].plot(t, recording.coupler_buff_max / 1e3, color=colour, lw=0.8)
        if "jump" in key and index == 0:
            for row in range(5):
                axes[row, 0].axvline(JUMP, color=COLOURS[5], ls=":", lw=1.2)
    labels = ("speed in km/h", "speed error of\nunit 1 in m/s", "position error of\nunit 1 in m",
              "applied force of\nall units in kN", "coupler force in kN\n(draft > 0)")  # fmt: skip
    for panel, label in zip(axes[:, 0], labels, strict=True):
        panel.set_ylabel(label)
    return save_grid(figure, axes, path, "time in min" if minutes else "time in s")


def _sampling(results: c.Results, path: Path) -> c.FigureFile:
    """Draw the rms speed error over the sampling period and over lambda."""
    figure, axes = panel_grid("N = 3, Nu = 2 (short run)", 1, 2, height=4.0, share=False)
    left, right = axes[0, 0], axes[0, 1]
    for index, (suffix, label) in enumerate((("", "U = 0 beyond Nu (printed)"), (" held", "U held beyond Nu"))):
        errors = [1e3 * speed_rms(results[f"Ts {period}{suffix}"]) for period in SAMPLINGS]
        left.semilogy(SAMPLINGS, errors, "o-", color=COLOURS[index], label=label)
    left.set_xlabel("sampling period in s")
    weights = sorted((*WEIGHTS, 0.1))
    keys = [f"Ts 0.4 lambda {weight}" if weight != 0.1 else "Ts 0.4" for weight in weights]
    right.loglog(weights, [1e3 * speed_rms(results[key]) for key in keys], "o-", color=COLOURS[2], label="Ts 0.4 s")
    right.set_xlabel("lambda in s²")
    for panel in (left, right):
        panel.axhline(1e3 * speed_rms(results["gpc normal"]), color=COLOURS[5], ls=":", label="Ts 1.2 s, lambda 0.1")
        panel.set_ylabel("speed error in mm/s rms")
    return save_grid(figure, axes, path)


def _rows(results: c.Results) -> Sequence[Sequence[Any]]:
    return [
        [
            label,
            *(
                f"{speed(run):.3f} / {1e3 * judge.speed_rms(run):.1f} / {unit_place(run):.2f}"
                for run in (results[f"{key} {train}"] for key in LAWS)
            ),
        ]
        for train, (label, _) in TRAINS.items()
    ]


def _extra(results: c.Results) -> Sequence[Sequence[Any]]:
    shown = [key for key in CASES if not any(key == f"{law} {train}" for law in LAWS for train in TRAINS)]
    return [
        [
            key,
            f"{speed(results[key]):.3f}",
            f"{1e3 * judge.speed_rms(results[key]):.1f}",
            f"{unit_place(results[key]):.2f}",
            f"{judge.coupler(results[key]):.0f}",
        ]
        for key in shown
    ]


PAPER = c.Paper(
    number="004",
    title="nonlinear GPC of a CRH380A with three power units, delays 1.0/1.1/1.2 s and 0.6/0.7/0.8 s",
    cases=CASES,
    claims=judge.CLAIMS,
    figures=draw,
    tables=(
        c.CaseTable(
            "short run (36 km): speed error max in m/s (only where v_ref > 1 m/s) / rms in mm/s / position error max "
            "in m; no PID is clamped",
            ("case", *(label for label, _ in LAWS.values())),
            _rows,
        ),
        c.CaseTable("more runs", ("run", "speed max m/s", "rms mm/s", "position m", "coupler kN"), _extra),
        c.printed_forms_table(PRINTED_FORMS),
    ),
)
