"""``train-ato report``: write an HTML page of one recorded run, or of several runs for comparison.

Options::

    runs RUN       run folder or log; several runs are compared
    --out FILE     HTML file (default: report.html in the run folder; for several runs comparison.html in this folder)
    --figures DIR  folder for the figures in print quality (default: none)
    --format       format of the figures of --figures (default: png)
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.cli.screen import print_json
from train_ato.program.arguments import Options
from train_ato.program.errors import check_packages, refused_unwritten

if TYPE_CHECKING:
    from train_ato.report.page_data import PageData


OPTIONS: Options = {"runs": {"nargs": "+"}, "--format": {"choices": ("png", "svg")}}


def execute(options: argparse.Namespace) -> None:
    """Write the page, and the figures with --figures."""
    check_packages("report", "bokeh", "jinja2")
    from train_ato.api.progress import activity
    from train_ato.log.recorded import open_recording
    from train_ato.report.page_data import motion_differences, page_data, share_of
    from train_ato.report.writing import checked, write_page

    if options.format and options.figures is None:
        raise ValueError("--format: only with --figures; remove it")
    target, labels = checked(options.runs, options.out, options.figures)
    with activity("reading") as show:
        pages = []
        for run, label in zip(options.runs, labels, strict=True):
            show(f"reading {label}")
            pages.append(page_data(open_recording(run), label, share_of(len(labels))))
        show("drawing the page")
        with refused_unwritten(target, "name another place with --out"):
            size = write_page(pages, target, compared=len(pages) > 1)
        figures = write_figures(options.figures, options.format or "png", pages, show) if options.figures else []
    result: dict[str, Any] = {
        "report": str(target),
        "bytes": size,
        "runs": {label: str(run) for label, run in zip(labels, options.runs, strict=True)},
        "figures": [str(path) for path in figures],
        "left_out": {data.label: data.left_out for data in pages},
    }
    found = motion_differences([data for data in pages if data.curves]) if len(pages) > 1 else {}
    result["differences"] = {label: one.line for label, one in found.items()}
    if options.json:
        print_json(result)
        return
    for label, one in found.items():
        sys.stdout.write(f"{label} against {labels[0]}: {one.line}\n")
    sys.stdout.write(f"{target}: {size / 1e6:.1f} MB; open it in a browser (no network needed)\n")
    if figures:
        sys.stdout.write(f"{len(figures)} figures in {options.figures}\n")


def write_figures(folder: Path, kind: str, pages: list[PageData], show: Callable[[str], None]) -> list[Path]:
    """Write the figures in print quality: of one run to the folder, of several to one subfolder each."""
    from train_ato.report.print_figures import write_comparison_figure, write_print_figures
    from train_ato.report.writing import comparison_title

    written = []
    for data in pages:
        show(f"drawing the figures of {data.label}")
        place = folder if len(pages) == 1 else folder / data.label.replace("/", "-")
        place.mkdir(parents=True, exist_ok=True)
        written += write_print_figures(data, place, kind)
    together = folder / f"comparison.{kind}"
    if len(pages) > 1 and write_comparison_figure(pages, together, comparison_title(pages)):
        written.append(together)
    return written
