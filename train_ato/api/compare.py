"""Comparison of laws: one scenario driven with each of them in the engine."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.api import scenario_choice
from train_ato.api.drive import RunMode, drive
from train_ato.api.run import Run
from train_ato.control.registry import LAWS
from train_ato.judge.metric_names import RESULTS, html_table, metric_heading
from train_ato.judge.ranking import rank_of
from train_ato.program.errors import RunFailed, RunInterrupted, check_packages, refusing
from train_ato.scenario.scenario import Scenario
from train_ato.scenario.scenario_data import with_start
from train_ato.scenario.setup import RunSetup

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from train_ato.report.page_data import PageData


OWN = "own"
"""Source of the gains of a law without the choice."""


@dataclass(frozen=True)
class Compared:
    """One law of a comparison.

    Attributes
    ----------
    label : str
        Name of the law in table and figures.
    metrics : dict
        Metrics of its run; empty for a refused law.
    gains : str
        Source of its parameters: ``fitted``, ``model``, ``printed``, ``given``, or ``own`` for a law without a choice.
    reason : str
        Reason of a refusal or of a failed run; otherwise empty.
    data : PageData or None
        Data of the figures.
    """

    label: str
    metrics: dict[str, Any]
    gains: str = OWN
    reason: str = ""
    data: PageData | None = None

    @property
    def status(self) -> str:
        """``done``, ``failed`` or ``refused``."""
        return str(self.metrics["status"]) if self.metrics else "refused"


class Comparison:
    """One scenario driven with several laws.

    Made by :func:`train_ato.compare`.

    Attributes
    ----------
    scenario : str
        Name of the scenario.
    laws : tuple of Compared
        The best first: by end of the run, outcome of tracking, verdict, failed criteria, rms of the speed error.
    """

    def __init__(self, scenario: str, laws: Sequence[Compared]) -> None:
        self.scenario = scenario
        self.laws = tuple(sorted(laws, key=lambda law: rank_of(law.metrics)))

    @property
    def table(self) -> pd.DataFrame:
        """One row for each law: status, verdict, gains, metrics with units, reason of a refusal or failure."""
        import pandas as pd

        rows = [
            {
                "status": law.status,
                "verdict": law.metrics.get("verdict"),
                "gains": law.gains,
                **{key: law.metrics.get(key) for key in RESULTS},
                "reason": law.reason,
            }
            for law in self.laws
        ]
        return pd.DataFrame(rows, index=pd.Index([law.label for law in self.laws], name="law"))

    @property
    def metrics(self) -> dict[str, dict[str, Any]]:
        """Metrics of the laws with a run."""
        return {law.label: law.metrics for law in self.laws if law.metrics}

    @property
    def rows(self) -> list[dict[str, Any]]:
        """Metrics, status and gains of every law as plain data; a refused law has its reason."""
        return [
            {**law.metrics, "controller": law.label, "status": law.status, "gains": law.gains}
            | ({"reason": law.reason} if law.reason else {})
            for law in self.laws
        ]

    @property
    def _pages(self) -> list[PageData]:
        return [law.data for law in self.laws if law.data is not None]

    @property
    def drawable(self) -> bool:
        """True if any law has data to draw."""
        return any(data.curves for data in self._pages)

    @refusing
    def plot(self, out: str | Path | None = None) -> Figure:
        """Draw speed, speed error, applied force and coupler extremes of all laws in one figure.

        Parameters
        ----------
        out
            PNG or SVG file to write; default: none, a notebook shows the figure.

        Raises
        ------
        ValueError
            If no law has a complete tick.
        """
        from train_ato.report.print_figures import comparison_figure, shown_figure
        from train_ato.report.writing import comparison_title

        figure = comparison_figure(self._pages, comparison_title(self._pages)) if self._pages else None
        if figure is None:
            raise ValueError(f"{self.scenario}: no law has a complete tick to draw")
        return shown_figure(figure, out)

    @refusing
    def report(self, out: str | Path = "comparison.html") -> Path:
        """Write the page of linked figures of all laws and return its path.

        Raises
        ------
        ValueError
            If the file exists already or cannot be written, or no law has a complete tick.
        """
        check_packages("report", "bokeh", "jinja2")
        from train_ato.program.arguments import check_new_file
        from train_ato.report.writing import write_page

        page = Path(out)
        check_new_file(page, (".html", ".htm"), "report")
        if not self.drawable:
            raise ValueError(f"{self.scenario}: no law has a complete tick to draw")
        write_page(self._pages, page, compared=True)
        return page

    def __repr__(self) -> str:
        laws = ", ".join(law.label if law.status == "done" else f"{law.label} ({law.status})" for law in self.laws)
        return f"<Comparison {self.scenario}: {laws}>"

    def _repr_html_(self) -> str:
        keys = [key for key in RESULTS if any(key in law.metrics for law in self.laws)]
        rows = [[law.label, *(law.metrics.get(key) for key in keys), law.reason or law.status] for law in self.laws]
        passed = [law.label for law in self.laws if law.metrics.get("verdict") == "passed"]
        verdict = f"{len(passed)} of {len(self.laws)} laws passed {self.scenario}: {', '.join(passed) or 'none'}"
        return html_table(verdict, ["law", *(metric_heading(key) for key in keys), "end"], rows)


def compare(
    scenario: scenario_choice.GivenScenario,
    laws: Sequence[Any] | None = None,
    *,
    observer: Any = None,
    compensation: Any = None,
    set: scenario_choice.Changes | None = None,
    seed: int | None = None,
    out: str | Path | None = None,
    progress: bool | None = None,
) -> Comparison:
    """Run a scenario with several laws in the engine.

    A law that does not fit the train, or whose run fails, has a row with the reason; the other laws are run.  The
    column ``gains`` has the source of the parameters of each law.

    Parameters
    ----------
    scenario, observer, compensation, set, seed, progress
        As for :func:`train_ato.run`.
    laws
        Laws, each as ``law`` of :func:`train_ato.run`; default: every registered one.
    out
        Folder for the runs, with one subfolder per law; default: none.

    Raises
    ------
    ValueError
        Bad input, such as an unknown law, or if no law fits the train.
    RunInterrupted
        Ctrl-C.

    Examples
    --------
    >>> import train_ato as ta
    >>> both = ta.compare("demo", ["pid", "smc"], set={"duration": 20})
    >>> sorted(both.table["status"].items())
    [('pid', 'done'), ('smc', 'done')]
    """
    choice = scenario_choice.choose_scenario(scenario).changed(set, seed)
    parts = {"observer": observer, "compensation": compensation}
    base = scenario_choice.put_components(choice.checked, importable=False, changes=set, **parts)
    chosen = _chosen(laws)
    named = [law.name for law in chosen if law.given is None]
    for law in chosen:
        law.refuse_changes(None if law.name in named else set)
    setups, refused = _setups(choice, base, chosen)
    folder = None if out is None else Path(out)
    return Comparison(
        choice.name,
        [
            Compared(law.label, {}, "", refused[law.label])
            if law.label in refused
            else _compared(law, setups[law.label], len(setups), folder, shown=progress)
            for law in chosen
        ],
    )


def _chosen(laws: Sequence[Any] | None) -> list[scenario_choice.ComponentChoice]:
    """Return the loaded laws with different labels; None for every registered one."""
    if isinstance(laws, str):
        raise ValueError(f"laws '{laws}': give a list, for example ['pid', 'smc']")
    chosen = _labelled(
        [scenario_choice.choose_component(LAWS, entry) for entry in (LAWS.loadable() if laws is None else laws)]
    )
    if not chosen:
        raise ValueError("laws: no law; add one, or remove the argument to use all that fit")
    for law in chosen:
        LAWS.get(law.name)
    return chosen


def _labelled(laws: Sequence[scenario_choice.ComponentChoice]) -> list[scenario_choice.ComponentChoice]:
    """Return the laws with different labels."""
    taken: dict[str, int] = {}
    found = []
    for law in laws:
        taken[law.label] = taken.get(law.label, 0) + 1
        more = f" ({taken[law.label]})" if taken[law.label] > 1 else ""
        found.append(dataclasses.replace(law, label=law.label + more))
    return found


def _setups(
    choice: scenario_choice.ScenarioChoice, base: Scenario, laws: Sequence[scenario_choice.ComponentChoice]
) -> tuple[dict[str, RunSetup], dict[str, str]]:
    """Prepare one run of the base scenario for each law; return also the reasons of the laws that are refused."""
    setups: dict[str, RunSetup] = {}
    refused: dict[str, str] = {}
    for law in laws:
        scenario = law.put_into(base)
        try:
            if setups:
                first = next(iter(setups.values()))
                begin = float(first.profile.position[0]), float(first.profile.velocity[0])
                setup = dataclasses.replace(first, scenario=with_start(scenario, *begin))
                setup.law(scenario.law)
            else:
                setup = choice.prepare(scenario)
        except ValueError as error:
            refused[law.label] = str(error).partition(f"law '{law.name}'")[2].lstrip(":, ") or str(error)
        else:
            setups[law.label] = setup
    if not setups:
        if len(refused) > 1 and len(set(refused.values())) == 1:
            raise ValueError(f"{choice.name}: {refused[laws[0].label]}")
        reasons = "; ".join(f"{label}: {reason}" for label, reason in refused.items())
        raise ValueError(f"{choice.name}: no law fits this train: {reasons}")
    return setups, refused


def _compared(
    law: scenario_choice.ComponentChoice, setup: RunSetup, runs: int, keep: Path | None, *, shown: bool | None
) -> Compared:
    """Run one law; keep only the data of the figures in memory."""
    law.put_into(setup.scenario)  # registers this class, if two classes have one name
    gains = setup.gains(setup.scenario.law).source or OWN
    folder = None if keep is None else keep / re.sub(r"[^\w.()=,+-]+", "-", law.label)
    try:
        run = drive(setup, RunMode(), out=folder, shown=shown, title=law.label, option="out")
    except RunInterrupted:
        raise
    except RunFailed as error:
        if error.run is None:
            return Compared(law.label, {"status": "failed", "failure": str(error)}, gains, str(error))
        run = error.run
    reason = str(run.metrics.get("failure", ""))
    return Compared(law.label, run.metrics, gains, reason, _page_data(law.label, run, runs))


def _page_data(label: str, run: Run, runs: int) -> PageData:
    """Return the data of the figures; the path of a temporary folder is removed."""
    from train_ato.log.recorded import open_recording
    from train_ato.report.page_data import empty_page_data, page_data, share_of

    try:
        recording = open_recording(run.folder())
    except ValueError as error:
        return empty_page_data(label, run.metrics, str(error))
    reduced = page_data(dataclasses.replace(recording, summary=run.metrics), label, share_of(runs))
    if run.path is None:
        reduced.facts.pop("run", None)
    return reduced
