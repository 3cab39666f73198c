"""Difference of two runs over time and place, at their stops, and of their energy: measured beside simulated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from train_ato.api.run import Run, open_run
from train_ato.judge.metric_names import verdict_html
from train_ato.judge.motion_difference import STOP_COLUMNS, DrivenMotion, motion_difference
from train_ato.program.errors import refusing

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class RunDifference:
    """Second run minus first run.

    Attributes
    ----------
    over_time : pandas.DataFrame
        ``speed_kmh``, ``position_m`` and ``force_kn`` (all power units) at the common ticks of the first run.
    over_place : pandas.DataFrame
        ``speed_kmh`` and ``time_s`` (> 0: the second run is later) by the place of the front in m.
    stops : pandas.DataFrame
        Target in km, times of arrival, error, and their differences, of every stop of either run; NaN without arrival.
        A measured run has no targets: its standstill within 50 m of a target of the other run is its stop. The index
        has the posts of a line with chainage.
    energy : dict
        Difference of traction and regenerated energy in kWh; None if a run does not have it.
    line : str
        Largest differences in one line, and those of the energy.
    """

    over_time: pd.DataFrame
    over_place: pd.DataFrame
    stops: pd.DataFrame
    energy: dict[str, float | None]
    line: str

    def __str__(self) -> str:
        return f"{self.line}\n{self.stops.to_string()}"

    def _repr_html_(self) -> str:
        return verdict_html(self.line) + str(self.stops.to_html())


def difference(first: Run | str | Path, second: Run | str | Path, *, step: float = 1.0) -> RunDifference:
    """Return the difference of two runs, for example of a simulated and a measured one.

    Parameters
    ----------
    first, second
        Runs or run folders; the difference is the second minus the first.
    step
        Distance of the places [m].

    Raises
    ------
    InputError
        If the runs have no common time or place, in one line.

    Examples
    --------
    >>> import train_ato as ta
    >>> light, heavy = (ta.run("demo", set={"plant.mismatch.mass_scale": scale, "duration": 60}) for scale in (1, 1.1))
    >>> found = ta.difference(light, heavy)
    >>> bool(found.over_place["time_s"].iloc[-1] > 0), list(found.over_time.columns)
    (True, ['speed_kmh', 'position_m', 'force_kn'])
    """
    import pandas as pd

    runs = [run if isinstance(run, Run) else refusing(open_run)(run) for run in (first, second)]
    motions = [DrivenMotion.of(run.recording, run.metrics) for run in runs]
    for run, motion in zip(runs, motions, strict=True):
        if motion is None:
            run.setup  # noqa: B018  raises with the reason why train and line are missing
            raise ValueError(f"{run.metrics.get('scenario')}: no complete tick to compare")
    found = motion_difference(*motions, step=step)  # type: ignore[arg-type]
    return RunDifference(
        pd.DataFrame(found.over_time, index=pd.Index(found.time, name="time_s")),
        pd.DataFrame(found.over_place, index=pd.Index(found.place, name="place_m")),
        pd.DataFrame(found.stops, found.posts, STOP_COLUMNS, dtype=float),
        found.energy,
        found.line,
    )
