"""Arguments of a report, checked before reading and writing."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from train_ato.apps.report.words import COMPARISON, REPORT
from train_ato.arguments import check_new_file
from train_ato.log.reading import log_file


@dataclass(frozen=True)
class Request:
    """Arguments of a report: a page, and figures for print if their folder is set.

    Attributes
    ----------
    runs
        Run folders or logs.
    labels
        Different names of the runs.
    page
        File to write.
    figures
        Folder of the figures for print, and their format.
    """

    runs: tuple[Path, ...]
    labels: tuple[str, ...]
    page: Path
    figures: Path | None = None
    kind: str = "png"


def checked(runs: list[Path], page: Path | None, figures: Path | None, kind: str) -> Request:
    """Check and return the arguments of a report.

    Raises
    ------
    ValueError
        No such run, equal runs, or a file that exists or is not writable.
    """
    for run in runs:
        log_file(run)
    places = [run.resolve() for run in runs]
    twice = [run for run, place in zip(runs, places, strict=True) if places.count(place) > 1]
    if twice:
        raise ValueError(f"{twice[0]}: named twice; give different runs")
    if page is None:
        folder = runs[0] if runs[0].is_dir() else runs[0].parent
        page = folder / REPORT if len(runs) == 1 else Path(COMPARISON)
    else:
        check_new_file(page, (".html", ".htm"))
    if figures is not None and any(place.exists() and not place.is_dir() for place in (figures, *figures.parents)):
        raise ValueError(f"--figures {figures}: is a file or is inside a file; give a folder")
    return Request(tuple(runs), labels_of(places), page, figures, kind)


def labels_of(places: list[Path]) -> tuple[str, ...]:
    """Return the names of the run folders, with parent folders if names are equal."""
    folders = [place if place.is_dir() else place.parent for place in places]
    names = [folder.name for folder in folders]
    often = Counter(names)
    longer = [f"{folder.parent.name}/{folder.name}" for folder in folders]
    chosen = [long if often[name] > 1 else name for name, long in zip(names, longer, strict=True)]
    still = Counter(chosen)
    return tuple(str(place) if still[name] > 1 else name for name, place in zip(chosen, places, strict=True))
