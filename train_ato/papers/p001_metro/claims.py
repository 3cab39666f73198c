"""Paper 001: metro train, sliding mode with an RBF network for the switching term. Claims, table and figures."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.messages.types import Array
from train_ato.papers.claims import CaseTable, FigureFile, Paper, Result, Results, printed_forms_table, recording
from train_ato.papers.drawing import HELD, Series, between, inset, panels, save, trace
from train_ato.papers.p001_metro import checks as judges
from train_ato.papers.p001_metro.checks import CASES, INERTIA, LAWS, PRINTED_FORMS, TRAINS
from train_ato.report.quantities import COLOURS


def draw(results: Results, folder: Path) -> list[FigureFile]:
    """Draw the figures of paper 001 into a folder; return them."""
    return [one(results, folder) for one in (_tracking, _chattering, _disturbed, _literal, _delay)]


def _errors(results: Results, named: Mapping[str, str]) -> list[Series]:
    runs = {label: recording(results[key]) for key, label in named.items()}
    return [(label, run.time, run.front_velocity - run.reference_velocity) for label, run in runs.items()]


def _tracking(results: Results, folder: Path) -> FigureFile:
    figure, (speed, ideal, lagged, close) = panels(
        4, "figures 4-7: speed tracking and its error; d is c without the PID", height=2.6
    )
    runs = {
        label: recording(results[f"ideal {key}"]) for key, label in (("pid", "PID"), ("rbf", "SMC with RBF network"))
    }
    first = next(iter(runs.values()))
    profile: Series = ("profile", first.time, 3.6 * first.reference_velocity)
    lines: list[Series] = [(label, run.time, 3.6 * run.front_velocity) for label, run in runs.items()]
    trace(speed, lines, "speed in km/h", reference=profile)
    speed.legend(loc="lower center", ncols=3, fontsize="small")
    inset(speed, lines, 129.0, 145.0, place=(0.5, 0.25, 0.2, 0.42), reference=profile)
    trace(ideal, _errors(results, {"ideal pid": "PID, ideal", "ideal rbf": "RBF, ideal"}), "v - v_d in m/s")
    named = {
        "pid nominal": "PID",
        "pid_preview nominal": "PID + preview",
        "rbf nominal": "RBF + preview",
        "tanh_predictor nominal": "tanh + predictor",
    }
    errors = _errors(results, named)
    trace(lagged, errors, "v - v_d in m/s\nlag 0.4 s, delay 0.3 s")
    trace(close, errors[1:], "v - v_d in m/s\nlag 0.4 s, delay 0.3 s", first_colour=1)
    close.set_xlabel("time in s")
    return save(figure, folder / "paper001_tracking.png")


def _chattering(results: Results, folder: Path) -> FigureFile:
    figure, axes = panels(3, "command of the relay (9) and of the network (12), per mass", height=2.6, shared=False)
    relay, network = recording(results["ideal sign"]), recording(results["ideal rbf"])
    whole, detail = axes[:2]
    starts = np.unique(np.searchsorted(relay.time, np.arange(relay.time[0], relay.time[-1], 5.0)))
    time, pull = relay.time[starts], relay.command[:, 0] / INERTIA
    low, high = np.minimum.reduceat(pull, starts), np.maximum.reduceat(pull, starts)
    whole.fill_between(time, low, high, step="post", color=COLOURS[0], alpha=0.35, lw=0, label="sgn(s), range of 5 s")
    trace(
        whole,
        [("RBF network", network.time, network.command[:, 0] / INERTIA)],
        "ideal: u/M in m/s²",
        minutes=False,
        color=COLOURS[1],
        **HELD,
    )
    lines: list[Series] = [
        (label, run.time, run.command[:, 0] / INERTIA) for label, run in (("sgn(s)", relay), ("RBF network", network))
    ]
    trace(detail, between(lines, 20.0, 22.0), "ideal: u/M in m/s²", minutes=False, **HELD)
    run = recording(results["sign nominal"])
    smooth = recording(results["tanh nominal"])
    lines = [
        (label, series.time, series.front_velocity - series.reference_velocity)
        for label, series in (("sgn(s)", run), ("tanh(s/phi)", smooth))
    ]
    trace(axes[2], lines, "v - v_d in m/s\nlag 0.4 s, delay 0.3 s", minutes=False)
    axes[2].set_xlabel("time in s")
    return save(figure, folder / "paper001_chattering.png")


def _disturbed(results: Results, folder: Path) -> FigureFile:
    figure, (error, force, estimate) = panels(3, "disturbed, with noise, lag 0.4 s and delay 0.3 s", height=3.0)
    named = {
        "pid disturbed": "PID",
        "pid_preview disturbed": "PID + preview",
        "rbf disturbed": "RBF + preview",
        "tanh_predictor disturbed": "tanh + predictor + ESO",
    }
    trace(error, _errors(results, named), "v - v_d in m/s")
    runs = {label: recording(results[key]) for key, label in named.items()}
    trace(force, [(label, run.time, run.applied[:, 0] / 1e3) for label, run in runs.items()], "applied force in kN")
    time, truth, found = truth_and_estimate(results["tanh_predictor disturbed"])
    trace(estimate, [("truth", time, truth), ("ESO, 3 1/s", time, found)], "disturbance in m/s²")
    estimate.set_ylim(np.percentile(truth, 0.2) - 0.1, np.percentile(truth, 99.8) + 0.1)
    estimate.set_xlabel("time in s")
    return save(figure, folder / "paper001_disturbed.png")


def _literal(results: Results, folder: Path) -> FigureFile:
    figure, (place, speed) = panels(2, "the networks learning as printed, objective e''", height=3.0)
    runs = {
        label: recording(results[key])
        for key, label in (
            ("ideal literal", "printed, ideal"),
            ("literal nominal", "printed, lag and delay"),
            ("ideal rbf", "corrected, ideal"),
        )
    }
    errors = [(label, run.time, run.front_position - run.reference_position) for label, run in runs.items()]
    trace(place, errors, "position error in m")
    place.legend(loc="lower left", fontsize="small")
    place.set_yscale("symlog", linthresh=0.1)
    trace(speed, [(label, run.time, 3.6 * run.front_velocity) for label, run in runs.items()], "speed in km/h")
    speed.set_xlabel("time in s")
    return save(figure, folder / "paper001_literal.png")


def _delay(results: Results, folder: Path) -> FigureFile:
    figure, (slower, late) = panels(2, "a slower actuator than modelled, and a delay of 1 s", height=3.0)
    for panel, train, label in (
        (slower, "slower", "true lag 0.5 s, delay 0.45 s"),
        (late, "long_delay", "delay 1.0 s"),
    ):
        named = {
            f"pid_preview {train}": "PID + preview",
            f"rbf {train}": "RBF + preview",
            f"tanh_predictor {train}": "tanh + predictor + ESO",
        }
        trace(panel, _errors(results, named), f"v - v_d in m/s\n{label}")
    late.set_xlabel("time in s")
    return save(figure, folder / "paper001_delay.png")


def truth_and_estimate(result: Result) -> tuple[Array, Array, Array]:
    """Return time [s] and true and estimated disturbance of a run [m/s²].

    The true disturbance is the acceleration beyond the nominal train M v' = F - R(v), averaged over half a second.
    """
    run = recording(result)
    period = run.time[1] - run.time[0]
    v = 3.6 * run.front_velocity
    resistance = (0.11 + 0.0029 * v + 0.00013 * v * v) * 9.8e-3 * 181_292.5
    width = max(1, round(0.5 / period))
    known = (run.applied[:, 0] - resistance) / INERTIA
    mean = np.convolve(known, np.full(width, 1.0 / width), mode="valid")[: run.time.size - width]
    motion = (run.front_velocity[width:] - run.front_velocity[:-width]) / (width * period)
    time = run.time[:-width] + 0.5 * width * period
    return time, motion - mean, np.interp(time, run.time, run.estimate[:, 0] / INERTIA)


INDEPENDENT: Mapping[str, tuple[str, str, str, str]] = {
    "nominal": ("0.081 / 0.62", "0.015 / 0.11", "0.015 / 0.11", "0.002 / 0.014"),
    "disturbed": ("0.085 / 0.64", "0.039 / 0.13", "0.039 / 0.14", "0.025 / 0.11"),
    "mismatch": ("0.100 / 0.68", "0.054 / 0.42", "0.055 / 0.42", "0.043 / 0.41"),
    "slower": ("0.127 / 0.86", "0.063 / 0.28", "0.066 / 0.36", "0.036 / 0.16"),
    "long_delay": ("-", "0.49 / 1.3", "0.54 / 1.3", "0.049 / ~0.2"),
}
"""Independent figures: PID; PID and RBF with a Padé feed-forward, not a preview; best with predictor and observer."""


def _rows(results: Results) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = []
    for train, (label, _) in TRAINS.items():
        here = (judges.pair(results[f"{key} {train}"]) for key in LAWS)
        rows.append((label, *here))
        rows.append(("   independent (*)", *INDEPENDENT[train][:3], "", "", INDEPENDENT[train][3]))
    return rows


def _ideal_rows(results: Results) -> list[tuple[Any, ...]]:
    named = {
        "ideal pid": "PID", "ideal pid_known": "PID + feed-forward", "ideal sign": "sgn(s), 50 ms",
        "ideal sign 10 ms": "sgn(s), 10 ms", "ideal tanh": "tanh(s/phi)", "ideal rbf": "RBF corrected, 50 ms",
        "ideal rbf 10 ms": "RBF corrected, 10 ms",
    }  # fmt: skip
    return [
        (label, judges.pair(results[key]), f"{judges.shaking(results[key]):.3f}", results[key].summary["stop_error_m"])
        for key, label in named.items()
    ]


PAPER = Paper(
    number="001",
    title="metro train, sliding mode with an RBF network for the switching term",
    cases=CASES,
    claims=judges.CLAIMS,
    figures=draw,
    tables=(
        CaseTable(
            "lag 0.4 s, delay 0.3 s: rms / largest speed error in m/s; (*) the independent PID and RBF have a Padé "
            "feed-forward instead of the preview, and the last column is the best of several independent laws with "
            "predictor (and observer)",
            ("case", *(label for label, _ in LAWS.values())),
            _rows,
        ),
        CaseTable(
            "ideal actuator, no disturbance",
            ("law", "rms / largest in m/s", "variation in m/s² per s", "stop error in m"),
            _ideal_rows,
        ),
        printed_forms_table(PRINTED_FORMS),
    ),
)
