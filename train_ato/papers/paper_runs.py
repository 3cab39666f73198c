"""File ``cases.yaml`` of a paper: labels and changes of its laws, variants of its trains, and single runs.

The changes are those of a scenario.  The runs of every law on every train are made of the first two by the paper.
"""

from collections.abc import Mapping
from importlib.resources import files
from typing import Any, NamedTuple

from plant_sim.data_text import parse_yaml
from train_ato.papers.claims import Case, PrintedForm


class PaperRuns(NamedTuple):
    """Content of ``cases.yaml``.

    Attributes
    ----------
    laws : mapping
        Label and changes of a law by key, in the order of the table.
    trains : mapping
        Label and variants of a train by key, in the order of the table.
    single : dict of Case
        Single runs by key.
    printed_forms : tuple of PrintedForm
        Printed forms, each with the runs to compare.
    """

    laws: Mapping[str, tuple[str, Mapping[str, Any]]]
    trains: Mapping[str, tuple[str, str]]
    single: dict[str, Case]
    printed_forms: tuple[PrintedForm, ...]


def read_paper_runs(package: str) -> PaperRuns:
    """Read the file of a paper in its package."""
    data = parse_yaml((files(package) / "cases.yaml").read_text(encoding="utf-8"))
    return PaperRuns(
        {key: (label, changes) for key, (label, changes) in data["laws"].items()},
        {key: (label, variants) for key, (label, variants) in data.get("trains", {}).items()},
        {key: Case(**case) for key, case in data["single"].items()},
        tuple(PrintedForm(**form) for form in data["printed_forms"]),
    )
