"""Generate ``msgs_docs/faults.md`` from the models of the faults, the fault table and its measured runs."""

from __future__ import annotations

import re
import typing
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from msgs_docs.generate.fault_runs import BASES, BEGIN, ROWS, FaultRow, FaultRun, run_row
from msgs_docs.generate.rows import read_rows, write_rows
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
SHARED = ("do", "topic", "reader", "begin", "end", "node", "at")

INTRODUCTION = """# Faults

Made by `python -m msgs_docs.generate`; do not edit by hand.

A fault is data of the scenario or a request during a run. Engine, composed graph and processes apply it at the
receiving end of a topic, after the transport of the mode, so that all three give the same numbers. Random faults have
a stream of the seed each. The diagnostics of the reading node contain the faults that act (`faults`) and, per topic,
the messages that did not arrive (`missed`), those that were refused (`refused`) and the last reason (`refusal`).

    train-ato run xuzhou_metro --set supervision.enabled=true --set 'faults=[{do: drop, topic: ato/command, begin: 20}]'

A run without supervision uses what arrives, as it is: nothing is refused, and a message that is not finite can end
it.
"""
NODES = """
With one process per node, `kill` and `stop` are SIGKILL and SIGSTOP of the process in place of its first message from
`at` on, and `duplicate` starts a second process when the plant reaches `at` (the run needs a `--rate` that leaves
time for its start). The plant goes on without the lost node until the train is at standstill; then the run fails with
the name of the node. The recorder can be killed and stopped in this mode only.
"""
DEFENCES = """
## Defences at the receiving end

`train_ato/messages/receiver.py`, in runs with supervision. A refused message counts as a missing one.
"""
REACTIONS = """
A missing command acts by its age in the train (`supervision.failsafe`): the last one is held, the drives are off, the
service brake, the emergency brake. Without a recent brake release the train has the emergency brake. Without a valid
measurement or reference the ATO holds its last command for `hold_limit`, then fails and brakes; without its
disturbance estimate it goes on with 0. Without valid odometry the supervisor demands the emergency brake at once.

The messages carry no safety code. Corruption and masquerade with possible values, true stamps and consistent content
are not detected at the receiving end; such commands are limited by the supervisor, such odometry by the comparison
with the measurement of the ATO. A brake release has an alive counter: one with an old content and a new
stamp is refused.
"""
OTHERS = """
## Faults of sensors, links and the train

| fault | key |
|---|---|
| noise, bias, resolution, frozen channel, wheel slip | `plant.sensors` |
| delay, jitter, loss, jump of the delay | `links.<topic>` |
| drives cut out, brake fade, adhesion, mass, resistance, train separation | `plant.jumps` |
| mismatch of the train, gusts and other outside forces | `plant.mismatch`, `plant.disturbances` |
| gust, delay jump, emergency brake at a time | `interventions` |

A full disk, a killed recorder and a second publisher of a topic fail the run with the name of the node; the log is kept
([log.md](log.md)). No simulated time depends on the date of the machine. Some waits in the ROS wheels end at a date, so
a step of the date backward can delay a run with `--rate`; such runs need a clock without steps. A suspended run in one
process goes on afterwards; with one process per node, a plant that was suspended for more than 3 s fails the run by its
name.
"""
TABLE = """
## Measured reactions

Every row is a run of the engine, and a test of `test/test_fault_table.py`: the train never is beyond the supervised
location (100 m behind the stop) or faster than the bound, which is the ceiling of the emergency brake with the
overshoot until the traction is off. At most 1.5 s after the detection there is a demand to coast or to brake. Faults of
messages and nodes begin at {begin} s, at 43 km/h with full acceleration. Margin: distance from the foremost place of
the front to the supervised location. Measured by `python -m msgs_docs.generate --measure faults`.

Modes of the tests: E engine (`--engine`, {engine} rows), C all nodes in one process (no option, {composed} rows), P one
process per node (`--processes`, {processes} rows: the first one of each kind of fault on a topic, a node or a part).
`pytest test/test_fault_ways.py` runs C and P. The log is that of the engine, bit for bit. In {ended} rows of P, `kill`,
`stop` and `duplicate` are signals to the process of the node and second processes: the train keeps the same bounds, and
the log ends with the run. No process, shared memory, lock or traceback on stderr is left. Two more rows of P lose the
recorder, and at most the last second of the log: {recorder}.
"""
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
    figures = read_rows(root / MEASURED)
    remedy = f"run python -m msgs_docs.generate --measure {NAME}"
    lines = [
        f"fault '{row.name}': not measured; {remedy}"
        for row in ROWS
        if figures.get(row.name, {}).get("run") != _key(row)
    ]
    return lines + [f"fault '{name}': no such row; {remedy}" for name in figures.keys() - {row.name for row in ROWS}]


def page(root: Path) -> str:
    """Return the text of the page."""
    lines = [INTRODUCTION, "## Faults of messages", "", *_models(MessageFault), ""]
    topics = ", ".join(f"`{name}` ({', '.join(readers)})" for name, readers in FAULT_TOPICS.items())
    lines += [
        f"Keys of all of them: `topic`, `reader` (default: all), `begin`, `end`. Topics and their readers: {topics}."
    ]
    lines += ["", "## Faults of nodes", "", *_models(NodeFault), "", "Keys of all of them: `node`, `at`.", NODES]
    lines += [DEFENCES.strip("\n"), "", *_defences(), REACTIONS, OTHERS.strip("\n"), "", *_requests()]
    lines += [_filled(TABLE), *_table(read_rows(root / MEASURED))]
    text = "\n".join(lines)
    while "\n\n\n" in text:
        text = text.replace("\n\n\n", "\n\n")
    return text.strip("\n") + "\n"


def _filled(text: str) -> str:
    """Return the introduction of the table with the numbers of its rows."""
    values = {mode: str(sum(mode in ways_of(row) for row in ROWS)) for mode in MODES}
    values["begin"] = str(BEGIN)
    values["ended"] = str(sum(ends_process(row) and "processes" in ways_of(row) for row in ROWS))
    values["recorder"] = ", ".join(f"`{row.sets[0]}`" for row in RECORDER_ROWS)
    for name, value in values.items():
        text = text.replace(f"{{{name}}}", value)
    return text


def _models(union: Any) -> list[str]:
    """Return the rows of the models of a union: word, meaning from the docstring, own keys."""
    members = typing.get_args(typing.get_args(union)[0]) or typing.get_args(union)
    rows = ["| `do` | meaning | keys |", "|---|---|---|"]
    for model in members:
        assert issubclass(model, BaseModel)
        own = [_key_text(name, entry) for name, entry in model.model_fields.items() if name not in SHARED]
        meaning = " ".join((model.__doc__ or "").replace("``", "`").split())
        rows.append(f"| `{model.model_fields['do'].default}` | {meaning} | {'; '.join(own) or '-'} |")
    return rows


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
            rows.append(f"| {threat} | {defence} |")
    return [rows[0], "|---|---|", *rows[1:]]


def _requests() -> list[str]:
    names = ("drop", "freeze", "cut-out", "brake-fade", "adhesion")
    rows = [f"| `{name}` | {ACTIONS[name].meaning} |" for name in names]
    intro = "`train-ato inject ACTION` during a run. The log contains each of them, and `train-ato verify` repeats it."
    return ["## Faults on request", "", intro, "", "| action | meaning |", "|---|---|", *rows]


def _table(figures: dict[str, dict[str, Any]]) -> list[str]:
    """Return the tables of the rows, one per scenario."""
    lines: list[str] = []
    for base, (name, *sets) in BASES.items():
        options = " ".join(f"--set '{text}'" for text in sets)
        lines += ["", f"`train-ato run {name} {options}` with `--set '...'` of each row:", ""]
        lines += [
            "| fault | kind | `--set` | margin [m] | speed, bound [km/h] | detected, demand [s] | end | modes |",
            "|---|---|---|---|---|---|---|---|",
        ]
        lines += [_row(row, figures.get(row.name, {})) for row in ROWS if row.base == base]
    return lines


def _row(row: FaultRow, found: dict[str, Any]) -> str:
    sets = " ".join(f"`{text}`" for text in row.sets)
    speeds = f"{found.get('top_speed_kmh', '-')}, {found.get('bound_kmh', '-')}"
    times = ", ".join("-" if found.get(key) is None else f"{found[key]:g}" for key in ("detected_s", "reacted_s"))
    end = "planned stop" if row.arrives else "standstill"
    modes = "".join(MODES[mode] for mode in ways_of(row))
    return f"| {row.name} | {row.kind} | {sets} | {found.get('margin_m', '-')} | {speeds} | {times} | {end} | {modes} |"
