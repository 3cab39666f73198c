"""Drive, summarise and draw the demonstration runs of the pages."""

import io
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from msgs_docs.generate.any_law_page import summary_figures, verdict
from msgs_docs.generate.law_pages.pages import Component, DemoRun, demo_of
from train_ato.control.gains import PRINTED, has_gains
from train_ato.control.registry import LAWS
from train_ato.judge.recording import Recording
from train_ato.messages.types import Array
from train_ato.papers.claims import Case, Result
from train_ato.papers.drawing import thinned
from train_ato.papers.p002_freight.observer_trials import truth as paper_002
from train_ato.papers.session import Finished, run_cases
from train_ato.report.print_figures import LONG_RUN_S, SHEET_SIZE, styled
from train_ato.report.quantities import COLOURS, GREY
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import RunSetup

COLOURS_OF_PNG = 64


@styled(SHEET_SIZE)
def draw_demo(component: Component, demo: DemoRun, runs: Mapping[str, tuple[Case, Result]], path: Path) -> None:
    """Draw the first two runs of a page over each other."""
    figure = Figure(figsize=(8.4, 4.6), dpi=90, layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    drawn = [(label, case.setup(), result.recording) for label, (case, result) in list(runs.items())[:2]]
    times = [recording.time for _, _, recording in drawn if recording is not None]
    minutes = max(time[-1] for time in times) > LONG_RUN_S
    for index, (label, setup, recording) in reversed(list(enumerate(drawn))):
        assert recording is not None
        part = slice(*np.searchsorted(recording.time, demo.span or (-np.inf, np.inf)))
        time = recording.time[part] / (60.0 if minutes else 1.0)
        style = {"color": COLOURS[index], "lw": 1.8 if index else 1.0, "alpha": 0.7 if index else 1.0, "label": label}
        upper.plot(*thinned(time, _error(demo, setup, recording)[part]), **style)
        if demo.lower == "force":
            lower.plot(*thinned(time, recording.applied.sum(axis=1)[part] / 1e3), **style)
            continue
        if index == 0:
            lower.plot(
                *thinned(time, _truth(setup, recording)[part] / 1e3), color=GREY, lw=2.6, alpha=0.45, label="truth"
            )
        if np.any(recording.estimate):
            lower.plot(*thinned(time, recording.estimate[part, 0] / 1e3), **style)
    upper.set_ylabel("speed error in km/h" if demo.draw == "speed" else "position error in m")
    lower.set_ylabel("force in kN" if demo.lower == "force" else "disturbance in kN\n(front unit)")
    lower.set_xlabel("time in min" if minutes else "time in s")
    for panel in (upper, lower) if demo.lower == "estimate" else (upper,):
        handles, labels = panel.get_legend_handles_labels()
        panel.legend(
            handles[::-1], labels[::-1], loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, fontsize="small",
            frameon=False,
        )  # fmt: skip
    for panel in (upper, lower):
        panel.margins(x=0.01)
    upper.set_title(drawn[0][1].scenario.name, loc="left", fontsize="small")
    picture = io.BytesIO()
    figure.savefig(picture, format="png")
    picture.seek(0)  # few colours: a fifth of the size, without a visible difference
    Image.open(picture).convert("RGB").quantize(COLOURS_OF_PNG).save(path, optimize=True)


def _error(demo: DemoRun, setup: RunSetup, recording: Recording) -> Array:
    """Return the front unit's error."""
    if demo.draw == "speed":
        return 3.6 * (recording.velocity[:, 0] - recording.reference_velocity)
    return np.asarray(recording.position[:, 0] + setup.model.offsets[0] - recording.reference_position)


def _truth(setup: RunSetup, recording: Recording) -> Array:
    """Return the disturbance of the front unit [N].

    Of a train that is one vehicle it is what the nominal model leaves of the true motion, unknown grades included;
    of others the outside force on the unit's vehicle, with the rate of its speed offset where it has one (d2 + d1' of
    paper 002).
    """
    if any(spec.kind == "paper002" for spec in setup.scenario.plant.disturbances):
        _, pushed, offset_rate = paper_002(recording.time)
        return float(setup.model.unit_inertia[0]) * (pushed[:, 0] + offset_rate[:, 0])
    if setup.layout.n_vehicles > 1:
        return recording.disturbance[:, 0]
    model = setup.model
    speed, place = recording.front_velocity, recording.front_position
    later = np.roll(recording.applied[:, 0], -1)
    known = np.array([model.rigid_force(x, v, 0.0) for x, v in zip(place.tolist(), speed.tolist(), strict=True)])
    pull = np.append(np.diff(speed), 0.0) / setup.tick
    found: Array = model.inertia * pull - 0.5 * (recording.applied[:, 0] + later) + known
    found[np.abs(speed) < 0.5] = np.nan  # the holding brake and dry friction are no disturbance
    found[-1] = np.nan
    return found


KEPT = ("speed_rmse_kmh", "speed_error_max_kmh", "position_error_max_m", "command_variation_kn_per_s")
WORKERS = 2


def measure_components(
    chosen: Iterable[Component], folder: Path, report: Callable[[float, str], None]
) -> dict[str, list[dict[str, Any]]]:
    """Execute the runs of some pages and draw their figures.

    Parameters
    ----------
    chosen
        Components of these pages.
    folder
        Folder of the figures.
    report
        Called with the finished share and the name of the last scenario.

    Returns
    -------
    dict
        Rows of the tables by key of the component.

    Raises
    ------
    OSError
        If a run fails.
    """
    demos = [(component, demo_of(component.kind, component.name)) for component in chosen]
    cases = {repr(case): case for _, demo in demos for case in demo.runs.values()}
    results: dict[str, Result] = {}
    with closing(run_cases(cases.items(), WORKERS)) as messages:
        for message in messages:
            if isinstance(message, Finished):
                case, result = cases[message.key], message.result
                if result.failure or result.recording is None:
                    raise OSError(f"{command(case)}: {result.failure or 'no complete tick'}")
                results[message.key] = result
                report(len(results) / len(cases), case.scenario)
    found = {}
    for component, demo in demos:
        runs = {label: (case, results[repr(case)]) for label, case in demo.runs.items()}
        found[component.key] = [row(label, case, result) for label, (case, result) in runs.items()]
        draw_demo(component, demo, runs, folder / f"{component.page}.png")
    return found


def row(label: str, case: Case, result: Result) -> dict[str, Any]:
    """Return one row of a table: label, scenario, command line, outcome and metrics to four digits."""
    figures: dict[str, Any] = {key: float(f"{result.summary[key]:.4g}") for key in KEPT}
    buff, draft = result.summary["coupler_buff_max_kn"], result.summary["coupler_draft_max_kn"]
    figures["couplers"] = f"{buff:.0f} ... {draft:+.0f}" if buff or draft else None
    found = summary_figures(result.summary)
    found["missed"] = {
        name: value for name, value in found.get("missed", {}).items() if value is not None
    }  # no supervisor
    return {"run": label, "scenario": case.scenario, "command": command(case), "outcome": verdict(found), **figures}


def command(case: Case) -> str:
    """Return the command line of a case."""
    options, settings = [], []
    scenario, _ = load_scenario(case.scenario, changes=dict(case.changes))
    law = scenario.law
    if law in LAWS.names() and has_gains(LAWS.get(law)) and "gains" not in scenario.laws.get(law, {}):
        settings.append(f"--set laws.{law}.gains={PRINTED}")
    for key, value in case.changes.items():
        if key in ("law", "observer", "compensation"):
            options.append(f"--{key} {value}")
        else:
            settings += [f"--set {path}={text}" for path, text in _flat(key, value)]
    return " ".join(["train-ato run", case.scenario, *options, *settings])


def _flat(path: str, value: Any) -> list[tuple[str, str]]:
    if isinstance(value, Mapping):
        return [pair for key, inner in value.items() for pair in _flat(f"{path}.{key}", inner)]
    return [(path, str(value).lower() if isinstance(value, bool) else str(value))]
