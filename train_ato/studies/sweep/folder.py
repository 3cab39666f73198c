"""Folder of a sweep: its specification, one line for every finished run, and the table of results.

``sweep.json`` has the specification and the versions, ``runs.jsonl`` the finished runs
(:mod:`train_ato.api.series_folder`).
"""

from pathlib import Path
from typing import Any

from train_ato.api.series_folder import SeriesFolder
from train_ato.log.versions import versions
from train_ato.studies.sweep.row import SweepBase, data_hash
from train_ato.studies.sweep.spec import SweepSpec, read_sweep

RESULTS = "results.parquet"


def sweep_identity(spec: SweepSpec, base: SweepBase) -> dict[str, Any]:
    """Return specification, hashes of scenario and code, and versions of a sweep."""
    return {
        "schema": SweepFolder.schema(),
        "spec": {**spec.data, "scenario": spec.scenario},
        "scenario": data_hash([base.data, spec.data], base.path.parent),
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
