"""Every row of the hazard table: complete references, and the hazard with and without its monitors."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from case_costs import stored_costs
from test_architecture import MODULES, imports, tree

from msgs_docs.generate import hazard_page
from msgs_docs.generate.fault_page import ROWS as FAULT_ROWS
from msgs_docs.generate.rows import read_rows

ROOT = Path(__file__).resolve().parents[1]
FIGURES = read_rows(ROOT / hazard_page.MEASURED)
FIRST = {row.hazard: row.requirement for row in reversed(hazard_page.ROWS) if row.pair is not None}
PAIRS = [
    pytest.param(row, id=row.requirement, marks=[] if row.requirement in FIRST.values() else [pytest.mark.campaign])
    for row in hazard_page.ROWS
    if row.pair is not None
]
MONITORS = {monitor for row in hazard_page.ROWS for monitor in row.monitors}
FAULT_TEST = "test/test_fault_table.py::test_the_train_is_safe_after_a_fault"
DECISIONS = {"step", "problem", "evaluate", "receive", "check", "check_limit"}
"""Methods with which a monitor decides."""
PLACES = (
    "train_ato.supervision", "train_ato.loop.train_protection", "train_ato.control.assurance",
    "train_ato.control.ato_state", "train_ato.control.command_hold", "train_ato.control.plausibility",
    "train_ato.messages.receiver",
)  # fmt: skip
"""Packages and modules with monitors."""


def in_place(module: str) -> bool:
    return any(module == place or module.startswith(f"{place}.") for place in PLACES)


def monitor_names(module: str) -> set[str]:
    """Return ``module:name`` of every public class with a decision, and of the check that is a function."""
    found = set()
    for node in tree(module).body:
        methods = {entry.name for entry in getattr(node, "body", ()) if isinstance(entry, ast.FunctionDef)}
        check = isinstance(node, ast.FunctionDef) and node.name == "validity_check"
        if check or (isinstance(node, ast.ClassDef) and methods & DECISIONS):
            found.add(f"{module}:{node.name}")
    return found


def test_requirements_and_hazards_are_complete() -> None:
    """Breaks if a requirement has no run and no test, a number is not unique, or a hazard, fault or action is lost."""
    assert [row.requirement for row in hazard_page.ROWS] == [
        f"REQ-{number:02d}" for number in range(1, len(hazard_page.ROWS) + 1)
    ]
    assert all(row.monitors and (row.pair or row.faults or row.tests) for row in hazard_page.ROWS)
    assert {row.hazard for row in hazard_page.ROWS} == hazard_page.HAZARDS.keys() == hazard_page.MEASURES.keys()
    assert {row.hazard for row in hazard_page.ROWS if row.pair is not None} == hazard_page.HAZARDS.keys()
    assert {fault for row in hazard_page.ROWS for fault in row.faults} == {row.name for row in FAULT_ROWS}
    for row in hazard_page.ROWS:
        if row.pair is not None:
            assert bool(row.pair.fault) != bool(row.pair.sets)
            assert not row.pair.fault or row.pair.fault in row.faults, row.requirement
    unsafe = {(row.action, row.guide) for row in hazard_page.ROWS}
    assert not unsafe & hazard_page.HARMLESS.keys()
    assert unsafe | hazard_page.HARMLESS.keys() == {
        (action, guide) for action in hazard_page.ACTIONS for guide in hazard_page.GUIDES
    }


def test_every_monitor_and_module_meets_a_requirement() -> None:
    """Breaks if a monitor was renamed, it or a module has no requirement, or one is removed in no pair and no test."""
    for name in MONITORS:
        assert callable(hazard_page.monitor_part(name)) or isinstance(hazard_page.monitor_part(name), property), name
    classes = {f"{module}:{path.partition('.')[0]}" for module, _, path in (name.partition(":") for name in MONITORS)}
    expected = {name for module in MODULES if in_place(module) for name in monitor_names(module)}
    assert len(expected) >= 11 and expected - classes == set()
    assert {
        name for row in hazard_page.ROWS if row.pair is not None for name in row.pair.without
    } == hazard_page.REMOVALS.keys()
    reached: set[str] = set()
    waiting = {monitor.partition(":")[0] for monitor in MONITORS}
    while waiting:
        reached |= waiting
        waiting = {other for name in waiting for other in imports(name) if in_place(other)} - reached
    modules = {name for name in MODULES if name.startswith("train_ato.supervision.")}
    assert modules - reached == set()


def test_every_named_test_is_collected() -> None:
    """Breaks if a test of a hazard is renamed, or a case loses the mark of its cost by another name."""
    named = {test for row in hazard_page.ROWS for test in row.tests}
    named |= {f"{FAULT_TEST}[{fault}]" for row in hazard_page.ROWS for fault in row.faults}
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    command = [sys.executable, "-m", "pytest", "--collect-only", "-p", "no:cacheprovider", "test"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    collected = set(done.stdout.splitlines())
    files = {line.partition("::")[0] for line in collected}  # a file is left out without its extra
    named |= {case for case in map("test/{}".format, stored_costs()) if case.partition("::")[0] in files}
    collected |= {line.partition("[")[0] for line in collected}
    assert named - collected == set()


@pytest.mark.parametrize("row", PAIRS)
def test_the_hazard_needs_the_monitor(row) -> None:
    kept, removed = hazard_page.run_pair(row.pair)
    value, bound = hazard_page.MEASURES[row.hazard](kept)
    without, _ = hazard_page.MEASURES[row.hazard](removed)
    assert value <= bound and without > bound and kept.front < kept.supervised_location
    assert kept.top_speed < kept.largest_speed
    figures = FIGURES[row.requirement]
    assert [figures["with"], figures["without"], figures["bound"]] == pytest.approx([value, without, bound], abs=1.0)


@pytest.mark.parametrize("entry", [pytest.param(entry, id=entry.hazard) for entry in hazard_page.OPEN])
def test_a_hazard_without_a_monitor_is_open(entry) -> None:
    value, bound = hazard_page.run_open(entry)
    assert value > bound and FIGURES[entry.text]["without"] == pytest.approx(value, abs=1.0)


@pytest.mark.parametrize("name", hazard_page.REMOVALS)
def test_a_removed_monitor_is_in_effect_again(name: str) -> None:
    """Breaks if a removal lasts: later tests would run without the monitor."""
    place = hazard_page.REMOVALS[name].place or name
    before = hazard_page.monitor_part(place)
    with hazard_page.removed_monitors([name]) as sets:
        assert (hazard_page.monitor_part(place) is not before) == (name in hazard_page.REPLACEMENTS)
        assert sets or name in hazard_page.REPLACEMENTS
    assert hazard_page.monitor_part(place) is before
