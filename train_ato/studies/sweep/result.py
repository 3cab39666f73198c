"""Folder and result of a sweep: table, figures, counts of the ends of its runs.

``sweep.json`` has the specification and the versions, ``runs.jsonl`` the finished runs
(:mod:`train_ato.api.series_folder`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.api.series_folder import SeriesFolder
from train_ato.judge.metric_names import verdict_html
from train_ato.log.versions import versions
from train_ato.log.whole_file import replacing
from train_ato.program.errors import check_packages, refusing
from train_ato.studies.sweep.groups import ERROR_METRIC, NotDrawable, shown_metrics
from train_ato.studies.sweep.row import Row, SweepBase, data_hash
from train_ato.studies.sweep.spec import SweepSpec, read_sweep

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


RESULTS = "results.parquet"


def sweep_identity(spec: SweepSpec, base: SweepBase) -> dict[str, Any]:
    """Return specification, hashes of scenario and code, and versions of a sweep."""
    data = {**spec.data, "scenario": spec.scenario}  # the path of a file from everywhere
    return {
        "schema": SweepFolder.schema(),
        "spec": data,
        "scenario": data_hash([base.data, data], base.path.parent),
        "code": base.source,
        "versions": versions(),
    }


class SweepFolder(SeriesFolder):
    """Folder of a sweep."""

    command = "sweep"
    file = "sweep.json"

    @property
    def results(self) -> Path:
        """File of the table."""
        return self.path / RESULTS

    def spec(self) -> SweepSpec:
        """Return the specification of the sweep."""
        return read_sweep(self.identity()["spec"], str(self.path / self.file))


METADATA = b"train_ato.sweep"
"""Key of the Parquet metadata with specification, hashes and versions as JSON."""
FIRST = ("law", "observer", "compensation", "seed", "status", "reason", "verdict", "tracking")
LAST = ("sha256", "wall_s", "evaluation_s", "overhead_s", "point")


def sweep_table(rows: Sequence[Row], keys: Sequence[str]) -> pd.DataFrame:
    """Return one row for each run.

    Returns
    -------
    pandas.DataFrame
        The columns are ``run``, the varied keys, law, observer, compensation, seed, ``status``, ``reason``, ``verdict``
        and ``tracking``; the numeric metrics of ``summary.json`` (NaN without a value); ``sha256`` of the resolved
        scenario; the wall times ``wall_s``, ``evaluation_s``, ``overhead_s``; ``point``, the values of the varied keys
        as JSON. If the values of a key have several types, or are not scalar, its column has JSON texts.
    """
    import pandas as pd

    metrics = list(dict.fromkeys(key for row in rows for key in row.get("metrics", {})))
    columns: dict[str, list[Any]] = {"run": [row["run"] for row in rows]}
    for key in keys:
        columns[key] = _column([row["point"].get(key) for row in rows])
    for key in FIRST:
        columns.setdefault(key, _column([row.get(key) for row in rows]))
    for key in metrics:
        columns[key] = [float("nan") if (value := row.get("metrics", {}).get(key)) is None else value for row in rows]
    for key in LAST[:-1]:
        columns[key] = [row.get(key) for row in rows]
    columns["point"] = [json.dumps(row["point"], ensure_ascii=False) for row in rows]
    frame = pd.DataFrame(columns)
    if "seed" not in keys:
        frame["seed"] = frame["seed"].astype("UInt64")
    return frame


def _column(values: list[Any]) -> list[Any]:
    """Return values of one scalar type unchanged, others as JSON texts."""
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} or kinds in ({str}, {bool}, set()):
        return values
    return [None if value is None else json.dumps(value, ensure_ascii=False) for value in values]


def write_results(path: Path, frame: pd.DataFrame, identity: Mapping[str, Any]) -> None:
    """Write the table as one Parquet file, whole or not at all."""
    import pyarrow as pa
    import pyarrow.parquet

    table = pa.Table.from_pandas(frame, preserve_index=False)
    metadata = {**(table.schema.metadata or {}), METADATA: json.dumps(identity, default=str).encode()}
    with replacing(path) as temporary:
        pyarrow.parquet.write_table(table.replace_schema_metadata(metadata), temporary, compression="zstd")


def read_results(path: Path) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Return table and metadata of a Parquet file of a sweep."""
    check_packages(str(path), "pyarrow")
    import pyarrow as pa
    import pyarrow.parquet

    try:
        table = pyarrow.parquet.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise ValueError(f"{path}: is no Parquet file ({' '.join(str(error).split())[:80]}); name another") from None
    text = (table.schema.metadata or {}).get(METADATA)
    if text is None:
        raise ValueError(f"{path}: has no metadata of a sweep; name a file that `sweep` wrote")
    return table.to_pandas(), json.loads(text)


class SweepResult:
    """Finished runs of a sweep.

    Made by :func:`train_ato.sweep`.

    Attributes
    ----------
    spec : SweepSpec
        Specification.
    table : pandas.DataFrame
        One row for each finished run; see ``msgs_docs/sweeps.md`` for the columns.
    path : Path or None
        Folder of the sweep, None for one in memory.
    """

    def __init__(self, spec: SweepSpec, table: pd.DataFrame, path: Path | None = None) -> None:
        self.spec = spec
        self.table = table
        self.path = path

    @property
    def counts(self) -> dict[str, int]:
        """Number of runs by status."""
        return {str(status): int(count) for status, count in self.table["status"].value_counts().items()}

    @refusing
    def plot_box(self, metric: str = ERROR_METRIC, out: str | Path | None = None) -> Figure:
        """Draw a box plot of a metric for every value of the first list, for example of every law.

        Parameters
        ----------
        metric
            Numeric column of the table.
        out
            PNG or SVG file to write; default: none, a notebook shows the figure.

        Raises
        ------
        ValueError
            If the table has no such metric, or the design no list.
        """
        from train_ato.report.print_figures import shown_figure
        from train_ato.studies.sweep.robustness_map import box_plot

        return shown_figure(box_plot(self.spec, shown_metrics(self.table), metric), out)

    @refusing
    def plot_map(
        self, metric: str = ERROR_METRIC, border: str = "tracking", out: str | Path | None = None
    ) -> Figure:  # fmt: skip
        """Draw a metric over the first two ranges, with the border of stability.

        Parameters
        ----------
        metric, out
            As for :meth:`plot_box`.
        border
            ``tracking``: runs with the outcome ``tracked`` are inside of the border; ``verdict``: those that pass the
            criteria of the scenario.

        Raises
        ------
        ValueError
            If the table has no such metric, or the design not two ranges.
        """
        from train_ato.report.print_figures import shown_figure
        from train_ato.studies.sweep.robustness_map import robustness_map

        return shown_figure(robustness_map(self.spec, shown_metrics(self.table), metric, border), out)

    @refusing
    def plot_pareto(self, metric: str = ERROR_METRIC, out: str | Path | None = None) -> Figure:
        """Draw a metric against the variation of the command, with the Pareto front of every law.

        Parameters
        ----------
        metric, out
            As for :meth:`plot_box`.

        Raises
        ------
        ValueError
            If the table has no such metric, or no run ended.
        """
        from train_ato.report.print_figures import shown_figure
        from train_ato.studies.sweep.robustness_map import pareto_figure

        return shown_figure(pareto_figure(shown_metrics(self.table), metric, self.spec.title), out)

    def figures(self, out: str | Path, metric: str = ERROR_METRIC, border: str = "tracking") -> dict[str, Path]:
        """Write the figures that the design permits into a folder, and return their files by name."""
        plots: dict[str, Any] = {
            "box": lambda path: self.plot_box(metric, path),
            "map": lambda path: self.plot_map(metric, border, path),
            "pareto": lambda path: self.plot_pareto(metric, path),
        }
        written = {}
        for name, plot in plots.items():
            file = Path(out) / f"{name}.png"
            try:
                plot(file)
            except NotDrawable:
                file.unlink(missing_ok=True)
            else:
                written[name] = file
        return written

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {status}" for status, count in self.counts.items())
        return f"<SweepResult {self.spec.title}, {self.spec.design}: {counts}>"

    def _repr_html_(self) -> str:
        passed = int((self.table["verdict"] == "passed").sum()) if "verdict" in self.table else 0
        verdict = verdict_html(f"{passed} of {len(self.table)} runs passed; {repr(self).strip('<>')}")
        return verdict + str(self.table.drop(columns=["point", "sha256"]).to_html(max_rows=20))
