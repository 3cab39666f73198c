"""``train-ato report``: a recorded run, or several side by side, as one page that works without a network."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.cli.screen import console, print_json

if TYPE_CHECKING:
    from train_ato.report.digest import Digest
    from train_ato.report.requests import Request


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``report``."""
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="run folder or log; several are compared")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="HTML file to write (default: report.html in the run folder; comparison.html here for several)",
    )
    parser.add_argument(
        "--figures", type=Path, metavar="DIR", help="also write every figure for print into this folder"
    )
    parser.add_argument("--format", choices=("png", "svg"), default="png", help="of the figures (default: png)")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def execute(options: argparse.Namespace) -> int:
    """Write the page, and the figures if asked for."""
    from train_ato.report.requests import checked

    request = checked(options.runs, options.out, options.figures, options.format)
    with console().status("reading") as status:
        digests = read(request, status)
        status.update("drawing the page")
        size = write_page(request, digests)
        figures = write_figures(request, digests, status)
    result: dict[str, Any] = {
        "report": str(request.page),
        "bytes": size,
        "runs": {digest.label: str(run) for digest, run in zip(digests, request.runs, strict=True)},
        "figures": [str(path) for path in figures],
        "left_out": {digest.label: digest.left_out for digest in digests},
    }
    if options.json:
        print_json(result)
        return 0
    sys.stdout.write(f"{request.page}: {size / 1e6:.1f} MB; open it in a browser, it needs no network\n")
    if figures:
        sys.stdout.write(f"{len(figures)} figures in {request.figures}\n")
    return 0


def read(request: Request, status: Any) -> list[Digest]:
    """Read the runs one after the other; of each only what its figures need is kept."""
    from train_ato.report.digest import digest, share_of
    from train_ato.report.recording import read_recording

    digests = []
    for run, label in zip(request.runs, request.labels, strict=True):
        status.update(f"reading {label}")
        digests.append(digest(read_recording(run), label, share_of(len(request.runs))))
    return digests


def write_page(request: Request, digests: list[Digest]) -> int:
    """Write the page and return its size in bytes."""
    from train_ato.report.writing import write_comparison, write_run

    return write_run(digests[0], request.page) if len(digests) == 1 else write_comparison(digests, request.page)


def write_figures(request: Request, digests: list[Digest], status: Any) -> list[Path]:
    """Write the figures for print: of one run into the folder, of several into a folder for each."""
    if request.figures is None:
        return []
    from train_ato.report.plates import write_comparison, write_plates

    written = []
    for digest in digests:
        status.update(f"drawing the figures of {digest.label}")
        folder = request.figures if len(digests) == 1 else request.figures / digest.label.replace("/", "-")
        folder.mkdir(parents=True, exist_ok=True)
        written += write_plates(digest, folder, request.kind)
    together = request.figures / f"comparison.{request.kind}"
    if len(digests) > 1 and write_comparison(digests, together, f"{len(digests)} runs side by side"):
        written.append(together)
    return written
