"""Comparison of laws: runs of one scenario in one table, one figure and one page."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.apps.runs.component_choice import ComponentChoice, choose_component, put_components
from train_ato.apps.runs.drive import RunMode, drive
from train_ato.apps.runs.ranking import rank_of
from train_ato.apps.runs.run import Run
from train_ato.apps.runs.scenario_choice import Changes, ScenarioChoice, choose_scenario
from train_ato.apps.runs.summary_table import RESULT_ROWS, html_table
from train_ato.control.registry import LAWS
from train_ato.errors import RunFailed, RunInterrupted
from train_ato.loop.setup import RunSetup
from train_ato.scenario.scenario import Scenario

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from train_ato.apps.report.page_data import PageData

SHOWN = tuple(key for key, _ in RESULT_ROWS if key not in ("real_time_factor", "step_time_us_median"))
"""Metrics of the table."""


@dataclass(frozen=True)
class Compared:
    """One law of a comparison.

    Attributes
    ----------
    label : str
        Name of the law in table and figures.
    metrics : dict
        Metrics of its run; empty for a refused law.
    reason : str
        Reason of a refusal or of a failed run; otherwise empty.
    data : PageData or None
        Data of the figures.
    """

    label: str
    metrics: dict[str, Any]
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
        The best first: by end of the run, verdict, failed criteria and rms of the speed error.
    """

    def __init__(self, scenario: str, laws: Sequence[Compared]) -> None:
        self.scenario = scenario
        self.laws = tuple(sorted(laws, key=lambda law: rank_of(law.metrics)))

    @property
    def table(self) -> pd.DataFrame:
        """One row for each law: status, metrics with the unit in their name, reason of a refusal or failure."""
        import pandas as pd

        rows = [
            {"status": law.status, **{key: law.metrics.get(key) for key in SHOWN}, "reason": law.reason}
            for law in self.laws
        ]
        return pd.DataFrame(rows, index=pd.Index([law.label for law in self.laws], name="law"))

    @property
    def metrics(self) -> dict[str, dict[str, Any]]:
        """Metrics of the laws with a run."""
        return {law.label: law.metrics for law in self.laws if law.metrics}

    @property
    def _pages(self) -> list[PageData]:
        return [law.data for law in self.laws if law.data is not None]

    @property
    def drawable(self) -> bool:
        """True if any law has data to draw."""
        return any(data.curves for data in self._pages)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw speed, speed error, applied force and coupler extremes of all laws in one figure.

        Parameters
        ----------
        path
            PNG or SVG file to write; default: none, a notebook shows the figure.

        Raises
        ------
        ValueError
            If no law has a complete tick.
        """
        from train_ato.apps.report.print_figures import comparison_figure
        from train_ato.apps.report.print_parts import SCREEN_DPI, save_figure
        from train_ato.apps.report.writing import comparison_title

        figure = comparison_figure(self._pages, comparison_title(self._pages)) if self._pages else None
        if figure is None:
            raise ValueError(f"{self.scenario}: no law has a complete tick to draw")
        if path is not None:
            save_figure(figure, Path(path), SCREEN_DPI)
        return figure

    def report(self, path: str | Path = "comparison.html") -> Path:
        """Write the page of linked figures of all laws and return its path.

        Raises
        ------
        ValueError
            If the file exists already or cannot be written, or no law has a complete tick.
        """
        from train_ato.apps.report.writing import write_comparison_page
        from train_ato.arguments import check_new_file

        page = Path(path)
        check_new_file(page, (".html", ".htm"), "report")
        if not self.drawable:
            raise ValueError(f"{self.scenario}: no law has a complete tick to draw")
        write_comparison_page(self._pages, page)
        return page

    def __repr__(self) -> str:
        laws = ", ".join(law.label if law.status == "done" else f"{law.label} ({law.status})" for law in self.laws)
        return f"<Comparison {self.scenario}: {laws}>"

    def _repr_html_(self) -> str:
        keys = [key for key in SHOWN if any(key in law.metrics for law in self.laws)]
        words = dict(RESULT_ROWS)
        rows = [[law.label, *(law.metrics.get(key) for key in keys), law.reason or law.status] for law in self.laws]
        return html_table(self.scenario, ["law", *(words[key] for key in keys), "end"], rows)


def compare(
    scenario: str | Path | ScenarioChoice,
    controllers: Sequence[Any] | None = None,
    *,
    observer: Any = None,
    compensation: Any = None,
    set: Changes | None = None,
    seed: int | None = None,
    keep: str | Path | None = None,
    progress: bool | None = None,
) -> Comparison:
    """Run a scenario with several laws in the engine.

    A law that does not fit the train, or whose run fails, has a row with the reason; the other laws are run.

    Parameters
    ----------
    scenario, observer, compensation, set, seed, progress
        As for :func:`train_ato.run`.
    controllers
        Laws, each as ``controller`` of :func:`train_ato.run`; default: every registered one.
    keep
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
    choice = choose_scenario(scenario).changed(set, seed)
    base = put_components(choice.checked, observer=observer, compensation=compensation, importable=False)
    if isinstance(controllers, str):
        raise ValueError(f"controllers '{controllers}': give a list, for example ['pid', 'smc']")
    named = controllers if controllers is not None else LAWS.loadable()
    laws = _labelled([choose_component(LAWS, entry) for entry in named])
    if not laws:
        raise ValueError("controllers: no law; add one, or remove the argument to use all that fit")
    for law in laws:
        LAWS.get(law.name)
    setups, refused = _setups(choice, base, laws)
    return Comparison(
        choice.name,
        [
            Compared(law.label, {}, refused[law.label])
            if law.label in refused
            else _compared(law, setups[law.label], len(setups), None if keep is None else Path(keep), progress)
            for law in laws
        ],
    )


def _labelled(laws: Sequence[ComponentChoice]) -> list[ComponentChoice]:
    """Return the laws with different labels."""
    taken: dict[str, int] = {}
    found = []
    for law in laws:
        taken[law.label] = taken.get(law.label, 0) + 1
        more = f" ({taken[law.label]})" if taken[law.label] > 1 else ""
        found.append(dataclasses.replace(law, label=law.label + more))
    return found


def _setups(
    choice: ScenarioChoice, base: Scenario, laws: Sequence[ComponentChoice]
) -> tuple[dict[str, RunSetup], dict[str, str]]:
    """Prepare one run of the base scenario for each law; return also the reasons of the laws that are refused."""
    setups: dict[str, RunSetup] = {}
    refused: dict[str, str] = {}
    for law in laws:
        scenario = law.put_into(base)
        try:
            if setups:
                setup = dataclasses.replace(next(iter(setups.values())), scenario=scenario)
                setup.law(scenario.controller)
            else:
                setup = choice.prepare(scenario)
        except ValueError as error:
            refused[law.label] = str(error).partition(f"controller '{law.name}'")[2].lstrip(":, ") or str(error)
        else:
            setups[law.label] = setup
    if not setups:
        reasons = "; ".join(f"{label}: {reason}" for label, reason in refused.items())
        raise ValueError(f"{choice.name}: no law fits this train: {reasons}")
    return setups, refused


def _compared(law: ComponentChoice, setup: RunSetup, runs: int, keep: Path | None, shown: bool | None) -> Compared:
    """Run one law; keep only the data of the figures in memory."""
    law.put_into(setup.scenario)  # registers this class, if two classes have one name
    folder = None if keep is None else keep / re.sub(r"[^\w.()=,+-]+", "-", law.label)
    try:
        run = drive(setup, RunMode(), out=folder, shown=shown, title=law.label, option="keep")
    except RunInterrupted:
        raise
    except RunFailed as error:
        if error.run is None:
            raise
        run = error.run
    return Compared(law.label, run.metrics, str(run.metrics.get("failure", "")), _page_data(law.label, run, runs))


def _page_data(label: str, run: Run, runs: int) -> PageData:
    """Return the data of the figures; the path of a temporary folder is removed."""
    from train_ato.apps.report.page_data import empty_page_data, page_data, share_of
    from train_ato.log.recorded import open_recording

    try:
        recording = open_recording(run.folder())
    except ValueError as error:
        return empty_page_data(label, run.metrics, str(error))
    reduced = page_data(dataclasses.replace(recording, summary=run.metrics), label, share_of(runs))
    if run.path is None:
        reduced.facts.pop("run", None)
    return reduced
