"""Generate the lower part of ``msgs_docs/requirements.md``: signals and units."""

from __future__ import annotations

from pathlib import Path

from msgs_docs.generate.node_page import MARK
from train_ato.scenario.dimension import UNITS
from train_ato.scenario.signals import SIGNALS

__all__ = ["PAGE", "page"]

PAGE = Path("msgs_docs", "requirements.md")
"""Path of the page in the repository."""


def page(written: Path = PAGE) -> str:
    """Return the page: the text above the mark, and below it signals and units."""
    above, mark, _ = written.read_text(encoding="utf-8").partition(MARK)
    if not mark:
        raise ValueError(f"{written}: the line '{MARK}' is missing; put it back below the text")
    rows = [
        f"| `{signal.name}` | {signal.unit} | {signal.meaning} | {signal.needs or '-'} |" for signal in SIGNALS.values()
    ]
    units = ", ".join(f"`{unit}`" for unit in UNITS)
    lines = [
        "",
        "## Signals",
        "",
        "| signal | unit | meaning | needs |",
        "|---|---|---|---|",
        *rows,
        "",
        "## Units",
        "",
        f"{units}.",
        "",
    ]
    return above + MARK + "\n" + "\n".join(lines)
