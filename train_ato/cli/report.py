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
    from train_ato.report.writing import Request


OPTIONS: Options = {"runs": {"nargs": "+"}, "--format": {"choices": ("png", "svg")}}


def execute(options: argparse.Namespace) -> None:
    """Write the page, and the figures with --figures."""
    check_packages("report", "bokeh", "jinja2")
    from train_ato.api.progress import activity
    from train_ato.report.page_data import motion_differences
    from train_ato.report.writing import checked, write_comparison_page, write_run

    if options.format and options.figures is None:
        raise ValueError("--format: only with --figures; remove it")
    request = checked(options.runs, options.out, options.figures, options.format or "png")
    with activity("reading") as show:
        pages = read(request, show)
        show("drawing the page")
        single = len(pages) == 1
        with refused_unwritten(request.page, "name another place with --out"):
            size = write_run(pages[0], request.page) if single else write_comparison_page(pages, request.page)
        figures = write_figures(request, pages, show)
    result: dict[str, Any] = {
        "report": str(request.page),
        "bytes": size,
        "runs": {data.label: str(run) for data, run in zip(pages, request.runs, strict=True)},
        "figures": [str(path) for path in figures],
        "left_out": {data.label: data.left_out for data in pages},
    }
    found = motion_differences([data for data in pages if data.curves]) if len(pages) > 1 else {}
    result["differences"] = {label: one.line for label, one in found.items()}
    if options.json:
        print_json(result)
        return
    for label, one in found.items():
        sys.stdout.write(f"{label} against {request.labels[0]}: {one.line}\n")
    sys.stdout.write(f"{request.page}: {size / 1e6:.1f} MB; open it in a browser (no network needed)\n")
    if figures:
        sys.stdout.write(f"{len(figures)} figures in {request.figures}\n")


def read(request: Request, show: Callable[[str], None]) -> list[PageData]:
    """Return the data of the figures of every run; runs are read one after the other."""
    from train_ato.log.recorded import open_recording
    from train_ato.report.page_data import page_data, share_of

    pages = []
    for run, label in zip(request.runs, request.labels, strict=True):
        show(f"reading {label}")
        pages.append(page_data(open_recording(run), label, share_of(len(request.runs))))
    return pages


def write_figures(request: Request, pages: list[PageData], show: Callable[[str], None]) -> list[Path]:
    """Write the figures in print quality: of one run to the folder, of several to one subfolder each."""
    if request.figures is None:
        return []
    from train_ato.report.print_figures import write_comparison_figure, write_print_figures
    from train_ato.report.writing import comparison_title

    written = []
    for data in pages:
        show(f"drawing the figures of {data.label}")
        folder = request.figures if len(pages) == 1 else request.figures / data.label.replace("/", "-")
        folder.mkdir(parents=True, exist_ok=True)
        written += write_print_figures(data, folder, request.kind)
    together = request.figures / f"comparison.{request.kind}"
    if len(pages) > 1 and write_comparison_figure(pages, together, comparison_title(pages)):
        written.append(together)
    return written
