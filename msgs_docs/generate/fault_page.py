"""Generate ``msgs_docs/faults.md`` from the models of the faults, the fault table and its measured runs."""

import re
import typing
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from msgs_docs.generate.fault_runs import BASES, BEGIN, ROWS, FaultRow, FaultRun, run_row
from msgs_docs.generate.rows import page_text, read_rows, table_lines, unmeasured_rows, write_rows
from train_ato.cli.inject import ACTIONS
from train_ato.messages import receiver
from train_ato.messages.faults import FAULT_TOPICS, MessageFault, NodeFault

_MODEL = re.compile(r"(?:do|topic|node|what): [\w/]+")

RECORDER_ROWS: tuple[FaultRow, ...] = tuple(
    FaultRow(f"recorder {past}", "node", (f"faults=[{{at: 4.9, do: {do}, node: recorder}}]",), "node recorder failed")
    for past, do in (("killed", "kill"), ("stopped", "stop"))
)
"""Faults that exist only with one process per node."""


def ends_process(row: FaultRow) -> bool:
    """Return True if a run with one process per node kills, stops or starts a process for the fault."""
    return any(f"do: {word}, node" in text for word in ("kill", "stop", "duplicate") for text in row.sets)


def _model(row: FaultRow) -> tuple[str, ...]:
    """Return the keys of a row with its fault, topic and node, without the other values."""
    return tuple(word for text in row.sets for word in (text.partition("=")[0], *sorted(_MODEL.findall(text))))


_FIRST = {_model(row): row for row in reversed(ROWS) if not row.slow}
"""First row of each kind of fault on each topic, node or part."""


def ways_of(row: FaultRow) -> tuple[str, ...]:
    """Return the modes of a row: long runs in the engine only, the first row of a kind also in several processes."""
    if row in RECORDER_ROWS:
        return ("processes",)
    if row.slow:
        return ("engine",)
    return ("engine", "composed", "processes") if _FIRST[_model(row)] == row else ("engine", "composed")


PAGE = Path("msgs_docs", "faults.md")
"""Path of the page in the repository."""
MEASURED = Path("msgs_docs", "faults_measured.json")
"""Figures of the runs of the table."""
NAME = "faults"
"""Name of the page for ``--measure``."""
REQUESTS = ("drop", "freeze", "cut-out", "brake-fade", "adhesion")
SHARED = ("do", "topic", "reader", "begin", "end", "node", "at")

MODES = {"engine": "E", "composed": "C", "processes": "P"}
"""Letters of the modes in the tables."""


def _key(row: FaultRow) -> list[str]:
    return [row.base, *BASES[row.base], *row.sets]


def figures_of(row: FaultRow, run: FaultRun) -> dict[str, Any]:
    """Return the figures of a run: distance to the supervised location [m], speeds [km/h], times [s]."""
    return {
        "run": _key(row),
        "margin_m": round(run.supervised_location - run.front, 1),
        "top_speed_kmh": round(3.6 * run.top_speed, 1),
        "bound_kmh": round(3.6 * run.largest_speed, 1),
        "detected_s": run.detected,
        "reacted_s": run.reacted,
    }


def measure_faults(root: Path) -> None:
    """Run all rows and write their figures."""
    figures = {row.name: figures_of(row, run_row(row)) for row in ROWS}
    write_rows(root / MEASURED, figures)


def unmeasured_faults(root: Path) -> list[str]:
    """Return one line per row without current figures, and per leftover."""
    return unmeasured_rows("fault", NAME, {row.name: _key(row) for row in ROWS}, read_rows(root / MEASURED))


def page(root: Path) -> str:
    """Return the text of the page."""
    return page_text(
        NAME,
        messages=_models(MessageFault),
        topics=", ".join(f"`{name}` ({', '.join(readers)})" for name, readers in FAULT_TOPICS.items()),
        nodes=_models(NodeFault),
        defences=_defences(),
        requests=[f"| `{name}` | {ACTIONS[name].meaning} |" for name in REQUESTS],
        **{mode: sum(mode in ways_of(row) for row in ROWS) for mode in MODES},
        begin=BEGIN,
        ended=sum(ends_process(row) and "processes" in ways_of(row) for row in ROWS),
        recorder=", ".join(f"`{row.sets[0]}`" for row in RECORDER_ROWS),
        table=_table(read_rows(root / MEASURED)),
    )


def _models(union: Any) -> list[str]:
    """Return the rows of the models of a union: word, meaning from the docstring, own keys."""
    members = typing.get_args(typing.get_args(union)[0]) or typing.get_args(union)
    rows = []
    for model in members:
        assert issubclass(model, BaseModel)
        own = [_key_text(name, entry) for name, entry in model.model_fields.items() if name not in SHARED]
        meaning = " ".join((model.__doc__ or "").replace("``", "`").split())
        rows.append((f"`{model.model_fields['do'].default}`", meaning, "; ".join(own) or "-"))
    return table_lines(("`do`", "meaning", "keys"), rows)


def _key_text(name: str, entry: Any) -> str:
    words = typing.get_args(entry.annotation)
    choices = f" ({', '.join(map(str, words))})" if words and all(isinstance(word, str) for word in words) else ""
    default = "" if entry.is_required() else f", default {entry.default}"
    return f"`{name}`{choices}{default}{f', {entry.description}' if entry.description else ''}"


def _defences() -> list[str]:
    """Return the table of the defences in the docstring of the receiver."""
    rows = []
    for line in (receiver.__doc__ or "").splitlines():
        threat, defence = line[:22].strip(), line[22:].strip()
        if defence and not line.startswith("=") and line[20:22] == "  ":
            rows.append((threat, defence))
    return table_lines(rows[0], rows[1:])


HEADS = ("fault", "kind", "`--set`", "margin [m]", "speed, bound [km/h]", "detected, demand [s]", "end", "modes")


def _table(figures: dict[str, dict[str, Any]]) -> list[str]:
    """Return the tables of the rows, one per scenario."""
    lines: list[str] = []
    for base, (name, *sets) in BASES.items():
        options = " ".join(f"--set '{text}'" for text in sets)
        lines += ["", f"`train-ato run {name} {options}` with `--set '...'` of each row:", ""]
        lines += table_lines(HEADS, (_row(row, figures.get(row.name, {})) for row in ROWS if row.base == base))
    return lines


def _row(row: FaultRow, found: dict[str, Any]) -> tuple[object, ...]:
    sets = " ".join(f"`{text}`" for text in row.sets)
    speeds = f"{found.get('top_speed_kmh', '-')}, {found.get('bound_kmh', '-')}"
    times = ", ".join("-" if found.get(key) is None else f"{found[key]:g}" for key in ("detected_s", "reacted_s"))
    end = "planned stop" if row.arrives else "standstill"
    modes = "".join(MODES[mode] for mode in ways_of(row))
    return row.name, row.kind, sets, found.get("margin_m", "-"), speeds, times, end, modes
