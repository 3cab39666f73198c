"""What is asked of a report, checked before anything is read or written."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from train_ato.given import check_new_file
from train_ato.record.reading import log_file
from train_ato.report.words import COMPARISON, REPORT


@dataclass(frozen=True)
class Request:
    """A page of some runs, and figures for print if a folder for them is given.

    Attributes
    ----------
    runs
        Run folders or logs.
    labels
        What they are called, each another name.
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
    """Return a request that can be carried out.

    Raises
    ------
    ValueError
        One line: no such run, a run named twice, a file that exists or cannot be written.
    """
    for run in runs:
        log_file(run)
    places = [run.resolve() for run in runs]
    twice = [run for run, place in zip(runs, places, strict=True) if places.count(place) > 1]
    if twice:
        raise ValueError(f"{twice[0]}: named twice; a comparison needs different runs")
    if page is None:
        folder = runs[0] if runs[0].is_dir() else runs[0].parent
        page = folder / REPORT if len(runs) == 1 else Path(COMPARISON)
    else:
        check_new_file(page, (".html", ".htm"))
    if figures is not None and any(place.exists() and not place.is_dir() for place in (figures, *figures.parents)):
        raise ValueError(f"--figures {figures}: is a file or lies in one; name a folder")
    return Request(tuple(runs), labels_of(places), page, figures, kind)


def labels_of(places: list[Path]) -> tuple[str, ...]:
    """Return the names of the runs' folders, longer where two are called alike."""
    folders = [place if place.is_dir() else place.parent for place in places]
    names = [folder.name for folder in folders]
    often = Counter(names)
    longer = [f"{folder.parent.name}/{folder.name}" for folder in folders]
    chosen = [long if often[name] > 1 else name for name, long in zip(names, longer, strict=True)]
    still = Counter(chosen)
    return tuple(str(place) if still[name] > 1 else name for name, place in zip(chosen, places, strict=True))
