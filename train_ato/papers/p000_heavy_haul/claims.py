"""Paper 000: heavy-haul train, RBFNN sliding mode with NDO. Claims, tables and figures."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from train_ato.control.laws.rbf_smc import RbfSmcParameters
from train_ato.papers import claims as c
from train_ato.papers.drawing import HELD, Series, between, inset, panel_grid, panels, save, trace
from train_ato.papers.p000_heavy_haul import cases, checks
from train_ato.papers.p000_heavy_haul.checks import (
    LOCOMOTIVE,
    disturbance_40,
    locomotive_speed_error,
    network_estimate,
    unexplained,
)
from train_ato.report.quantities import COLOURS

LAWS = {"pid": "PID", "smc": "SMC", "rbf": "RBFNN-SMC", "rbf_ndo": "RBFNN-SMC + NDO"}
BAND = 5e-5
"""Largest error of the network in the paper [m/s²]."""
NETWORK_DETAIL = (600.0, 630.0)
"""Range of the enlarged panels of the network [s]."""
ZOOM = (1302.0, 1312.0)
"""Start of the effect of the first air-brake application [s]."""


def draw(results: c.Results, folder: Path) -> list[c.FigureFile]:
    """Draw the figures of paper 000 into a folder; return them."""
    return [
        _tracking(results, folder, "", "5-6"),
        _tracking(results, folder, " disturbed", "11-12"),
        *(one(results, folder) for one in (_network, _force, _couplers, _observer, _limit, _twin)),
    ]


def _errors(results: c.Results, suffix: str) -> list[Series]:
    runs = {label: c.recording(results[f"{key}{suffix}"]) for key, label in LAWS.items()}
    return [(label, run.time, locomotive_speed_error(run)) for label, run in runs.items()]


def _tracking(results: c.Results, folder: Path, suffix: str, number: str) -> c.FigureFile:
    name = "with disturbance (40)" if suffix else "undisturbed"
    figure, (speed, error) = panels(2, f"figures {number}: speed tracking, ideal actuator, {name}", height=3.6)
    reference = c.recording(results[f"smc{suffix}"])
    driver: Series = ("driver's run", reference.time, 3.6 * reference.reference_velocity)
    runs = {label: c.recording(results[f"{key}{suffix}"]) for key, label in LAWS.items()}
    lines: list[Series] = [(label, run.time, 3.6 * run.front_velocity) for label, run in runs.items()]
    trace(speed, lines, "speed in km/h", reference=driver)
    speed.legend(loc="lower right", ncols=5, fontsize="small")
    inset(speed, lines, ZOOM[0], ZOOM[1], place=(0.36, 0.26, 0.26, 0.42), reference=driver)
    errors = _errors(results, suffix)
    trace(error, errors, "speed error v - v_d in km/h")
    error.axhspan(-0.15, 0.15, color="0.5", alpha=0.12, lw=0)
    error.set_xlabel("time in min (grey: +-0.15 km/h)")
    return save(figure, folder / f"paper000_tracking{suffix.replace(' ', '_')}.png")


def _network(results: c.Results, folder: Path) -> c.FigureFile:
    caption = "figures 7-8: network estimate of delta = f - f_hat; left the whole run, right 30 s"
    figure, axes = panel_grid(caption, 4, 2, height=2.3, width=15)
    settings = (
        ("rbf", "as printed", RbfSmcParameters(**cases.PRINTED_NETWORK)),
        ("rbf_ks", "with ks S, clipped inputs", RbfSmcParameters()),
    )
    for row, (key, label, parameters) in enumerate(settings):
        run = c.recording(results[key])
        truth = unexplained(run, cases.PERIOD, 0.01)
        found = network_estimate(run, parameters, cases.PERIOD)
        for column, (begin, end) in enumerate(((0.0, run.time[-1]), NETWORK_DETAIL)):
            part, whole = (run.time >= begin) & (run.time <= end), column == 0
            t, width = run.time[part], 0.4 if whole else 0.9
            upper, lower = axes[2 * row, column], axes[2 * row + 1, column]
            lines = [("truth", t, truth[part]), (label, t, found[part])]
            trace(upper, lines, "delta in m/s²", minutes=whole, lw=width)
            miss = [("error of the estimate", t, (found - truth)[part])]
            trace(lower, miss, "error in m/s²", minutes=whole, lw=width, color=COLOURS[1])
            lower.axhspan(-BAND, BAND, color="0.3", alpha=0.5, lw=0)
            for panel in (upper, lower):  # above the curves, in the panel of the whole run only
                panel.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize="small", frameon=False)
                panel.get_legend().set_visible(whole)
            lower.set_yscale("symlog", linthresh=2 * BAND)
    axes[-1, 0].set_xlabel("time in min (dark band: +-5e-5 m/s², linear scale up to twice of it)")
    axes[-1, 1].set_xlabel("time in s")
    return save(figure, folder / "paper000_network.png")


def _force(results: c.Results, folder: Path) -> c.FigureFile:
    figure, (force, detail) = panels(2, "figure 9: control force of the locomotive", height=3.4, shared=False)
    runs = {label: c.recording(results[key]) for key, label in LAWS.items()}
    lines: list[Series] = [(label, run.time, run.command[:, 0] / 1e3) for label, run in runs.items()]
    trace(force, lines, "force in kN", **HELD)
    force.set_xlabel("time in min")
    trace(detail, between(lines, 1290.0, 1320.0), "force in kN", minutes=False, **HELD)
    detail.set_xlabel("time in s: the air brake is applied")
    return save(figure, folder / "paper000_force.png")


def _couplers(results: c.Results, folder: Path) -> c.FigureFile:
    figure, axes = panels(2, "figure 10: coupler forces, draft > 0", height=3.2)
    titles = (("rbf_ndo", "RBFNN-SMC + NDO, ideal"), ("twin_pid disturbed", "twin + PID, lag 0.4 s, delay 0.8 s, (40)"))
    for panel, (key, title) in zip(axes, titles, strict=True):
        run = c.recording(results[key])
        panel.fill_between(
            run.time / 60, run.coupler_buff_max / 1e3, run.coupler_draft_max / 1e3, color="0.6", alpha=0.35, lw=0
        )
        names = ("behind the locomotive", "middle of the train", "before the last wagon")
        lines = [(name, run.time, run.coupler_samples[:, column] / 1e3) for column, name in enumerate(names)]
        trace(panel, lines, "coupler force in kN")
        panel.set_title(title + " (grey: all couplers)", fontsize="medium")
    axes[-1].set_xlabel("time in min")
    return save(figure, folder / "paper000_couplers.png")


def _observer(results: c.Results, folder: Path) -> c.FigureFile:
    figure, (whole, detail) = panels(2, "NDO against the truth, disturbance (40)", height=3.2, shared=False)
    run = c.recording(results["rbf_ndo disturbed"])
    slow = c.recording(results["rbf_ks_ndo disturbed"])
    truth = unexplained(run, cases.PERIOD, 0.01, disturbance_40(run, cases.PERIOD))
    lines: list[Series] = [
        ("truth", run.time, truth),
        ("NDO, 1000 1/s", run.time, run.estimate[:, 0] / LOCOMOTIVE),
        ("NDO, 20 1/s (other run: with ks)", slow.time, slow.estimate[:, 0] / LOCOMOTIVE),
    ]
    trace(whole, lines, "d in m/s²")
    whole.set_xlabel("time in min")
    trace(detail, between(lines, 600.0, 620.0), "d in m/s²", minutes=False)
    detail.set_xlabel("time in s")
    return save(figure, folder / "paper000_observer.png")


def _limit(results: c.Results, folder: Path) -> c.FigureFile:
    caption = (
        "printed SMC with a pure delay; limit of the rigid train: 0.17 s, the flexible train oscillates from 0.1 s on"
    )
    figure, (error, force) = panels(2, caption, height=3.2)
    runs = {f"{delay:g} s": c.recording(results[f"smc delay {delay}"]) for delay in cases.LIMIT_DELAYS}
    trace(error, [(name, run.time, locomotive_speed_error(run)) for name, run in runs.items()], "speed error in km/h")
    trace(force, [(name, run.time, run.applied[:, 0] / 1e3) for name, run in runs.items()], "applied force in kN")
    force.set_xlabel("time in s")
    return save(figure, folder / "paper000_delay_limit.png")


def _twin(results: c.Results, folder: Path) -> c.FigureFile:
    title = "train of the paper with lag 0.4 s and delay 0.8 s: twin + PID"
    figure, (speed, error, force) = panels(3, title, height=3.0)
    runs = {label: c.recording(results[f"twin_pid {key}"]) for key, (label, _) in cases.LAGGED_TRAINS.items()}
    first = next(iter(runs.values()))
    lines: list[Series] = [(label, run.time, 3.6 * run.front_velocity) for label, run in runs.items()]
    trace(speed, lines, "speed in km/h", reference=("driver's run", first.time, 3.6 * first.reference_velocity))
    speed.legend(loc="lower right", ncols=5, fontsize="small")
    trace(error, [(label, run.time, locomotive_speed_error(run)) for label, run in runs.items()], "speed error in km/h")
    trace(force, [(label, run.time, run.applied[:, 0] / 1e3) for label, run in runs.items()], "applied force in kN")
    force.set_xlabel("time in min")
    return save(figure, folder / "paper000_twin.png")


INDEPENDENT_IDEAL: Mapping[str, tuple[str, str]] = {
    "pid": ("0.106; 0.20", "0.106"), "smc": ("0.0106; 0.06", "0.0125; 0.06"),
    "rbf": ("0.0252; 0.09", "0.0270; 0.09"), "rbf_ndo": ("0.0007; 0.04", "0.0012; 0.03"),
    "smc_ks": ("0.0040", "0.0080"), "rbf_ks": ("0.0029", "0.0069"), "rbf_ks_ndo": ("0.0009", "0.0017"),
}  # fmt: skip
"""Figures of an independent implementation on another driver's run, undisturbed and with (40)."""
INDEPENDENT_LAGGED: Mapping[str, tuple[str, str, str, str]] = {
    "twin_pid": ("0.012; 0.22", "0.017; 0.26", "0.053; 0.51", "0.113; 0.54"),
    "twin_smc_ndo": ("0.022; 0.23", "0.026; 0.29", "0.054; 0.48", "0.107; 0.73"),
    "predicted": ("0.015; 0.16", "0.019; 0.22", "0.086; 0.85", "diverges"),
}


def _pair(results: c.Results, key: str) -> str:
    result = results[key]
    if result.failure:
        return result.failure
    return f"{c.rms_kmh(result):.4f}; {c.largest_kmh(result):.2f}"


def _ideal_rows(results: c.Results) -> list[tuple[Any, ...]]:
    return [
        (
            label,
            _pair(results, key),
            INDEPENDENT_IDEAL.get(key, ("", ""))[0],
            _pair(results, f"{key} disturbed"),
            INDEPENDENT_IDEAL.get(key, ("", ""))[1],
            f"{c.variation(results[key]):.1f}",
        )
        for key, (label, _) in cases.IDEAL_LAWS.items()
    ]


def _lagged_rows(results: c.Results) -> list[tuple[Any, ...]]:
    rows = []
    for key, (label, _) in cases.LAGGED_LAWS.items():
        row = [label]
        for train, stated in zip(cases.LAGGED_TRAINS, INDEPENDENT_LAGGED.get(key, ("",) * 4), strict=True):
            row += [_pair(results, f"{key} {train}"), stated]
        runs = [results[f"{key} {train}"] for train in cases.LAGGED_TRAINS]
        low = min(run.summary["coupler_buff_max_kn"] for run in runs)
        high = max(run.summary["coupler_draft_max_kn"] for run in runs)
        rows.append((*row, f"{low:.0f} ... {high:+.0f}", f"{max(c.variation(run) for run in runs):.1f}"))
    return rows


PAPER = c.Paper(
    number="000",
    title="heavy-haul train, multi-mass model, RBFNN sliding mode and disturbance observer",
    cases=cases.CASES,
    claims=checks.CLAIMS,
    figures=draw,
    tables=(
        c.CaseTable(
            "ideal actuator, f_hat = f/1.01: rms; largest speed error in km/h",
            ("law", "undisturbed", "independent", "with (40)", "independent", "kN/s"),
            _ideal_rows,
        ),
        c.CaseTable(
            "lag 0.4 s, delay 0.8 s: rms; largest speed error in km/h, couplers in kN, largest variation in kN/s (last "
            "row: the independent figures are of another law on that prediction)",
            (
                "law",
                *(text for label, _ in cases.LAGGED_TRAINS.values() for text in (label, "independent")),
                "couplers",
                "kN/s",
            ),
            _lagged_rows,
        ),
        c.printed_forms_table(cases.PRINTED_FORMS),
    ),
)
