"""Writes ``msgs_docs/laws``.

``python -m train_ato.law_docs`` writes the text again, with the figures that were measured last; a test fails when it
is older than the code.  ``--measure [NAME ...]`` drives the runs of all pages or of some and makes their figures and
tables anew (five minutes on two cores).
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from train_ato.control.parameters import closest
from train_ato.law_docs.blocks import Block, blocks
from train_ato.law_docs.pages import Measured, index, page

FOLDER = Path("msgs_docs", "laws")
"""Where they are written, below the top of the repository, where the command is started."""
MEASURED = "measured.json"


def read_measured(folder: Path = FOLDER) -> Measured:
    """Return the figures that were measured last."""
    path = folder / MEASURED
    found: Measured = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return found


def texts(measured: Measured) -> dict[str, str]:
    """Return every page by its file name."""
    return {"README.md": index(measured)} | {f"{block.page}.md": page(block, measured) for block in blocks()}


def chosen(names: list[str]) -> list[Block]:
    """Return the blocks that are named by page, all of them if none is.

    Raises
    ------
    ValueError
        If there is no such page.
    """
    known = {block.page: block for block in blocks()}
    for name in names:
        if name not in known:
            raise ValueError(f"--measure {name}: no such page{closest(name, known)}; there are: {', '.join(known)}")
    return [known[name] for name in names or known]


def main(arguments: list[str] | None = None) -> int:
    """Write the pages; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m train_ato.law_docs", description=__doc__)
    parser.add_argument("--measure", nargs="*", metavar="NAME", help="drive the runs of all pages, or of these")
    options = parser.parse_args(arguments)
    FOLDER.mkdir(parents=True, exist_ok=True)
    measured: dict[str, Any] = dict(read_measured())
    if options.measure is not None:
        try:
            wanted = chosen(options.measure)
        except ValueError as error:
            parser.error(str(error))
        from train_ato.cli.screen import share_bar
        from train_ato.law_docs.measure import measure

        with share_bar("runs of the pages") as report:
            measured |= measure(wanted, FOLDER, report)
        text = json.dumps(dict(sorted(measured.items())), indent=1, ensure_ascii=False)
        (FOLDER / MEASURED).write_text(text + "\n", encoding="utf-8")
    for name, content in texts(measured).items():
        (FOLDER / name).write_text(content, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
