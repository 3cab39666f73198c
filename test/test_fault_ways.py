"""Rows of the fault table as node graphs, in one process and in several: the log, or the verdicts, of the engine."""

import re

import pytest

pytest.importorskip("rclpy")

import numpy as np
from remains import check_nothing_left
from waiting import LIMIT_S

from msgs_docs.generate.fault_page import RECORDER_ROWS, ROWS, STANDSTILL, FaultRun, ends_process, setup_of, ways_of
from train_ato.log.difference import compare_logs
from train_ato.log.reading import iter_raw
from train_ato.log.recover import recover
from train_ato.log.run_folder import RunFolder
from train_ato.loop.engine import run_engine
from train_ato.messages.codec import Wire
from train_ato.messages.faults import node_faults
from train_ato.ros.graph.runner import run_graph

SILENT_S = 10.0
"""Wall time without an answer after which a stopped node is lost [s]."""
KEPT = 1.0
"""Largest loss at the end of a log [s]."""
WALL = ("wall_s", "real_time_factor", "step_time_us_median", "step_time_us_p99")

pytestmark = pytest.mark.campaign


CASES = [(row, way) for way in ("composed", "processes") for row in ROWS if way in ways_of(row)]
LOST = [row for row, way in CASES if way == "processes" and ends_process(row)]
ANSWERS = {
    "controller": "ato/command", "supervisor": "atp/brake_release", "profile": "ato/reference",
    "observer": "ato/estimate",
}  # fmt: skip
"""Topic of the answers of a node."""


def test_each_way_has_48_rows():
    """Breaks if rows are deleted, or a kind of fault has no row in a way."""
    for way in ("composed", "processes"):
        rows = [row for row, of_row in CASES if of_row == way]
        assert len(rows) >= 48
        assert {row.kind for row in rows} == {row.kind for row in ROWS if not row.slow}


def graph_run(row, way, folder, rate=0.0, timeout=LIMIT_S):
    """Run a row as a graph in a folder and return it."""
    setup = setup_of(row)
    folder.mkdir()
    return FaultRun(setup, run_graph(setup, folder, mode=way, rate=rate, timeout=timeout))


def stamps(folder, topic):
    """Return the stamps of a topic in a log [s]."""
    return np.array([stamp for _, stamp, _ in iter_raw(folder, (topic,))]) * 1e-9


@pytest.mark.parametrize(
    ("row", "way"),
    [pytest.param(row, way, id=f"{way}: {row.name}") for row, way in CASES if way == "composed" or row not in LOST],
)
def test_the_log_of_a_fault_is_that_of_the_engine(row, way, tmp_path):
    """Breaks if a fault, a refusal or a reaction depends on the mode, or the graph leaves or loses something."""
    run = graph_run(row, way, tmp_path / way)
    engine = RunFolder.make(tmp_path / "engine", "run")
    with engine.sink(run.setup) as sink:
        expected = run_engine(run.setup, sink=sink)
    assert run.result.failure == expected.failure
    found = compare_logs(engine.path, tmp_path / way, Wire(run.setup.layout))
    assert found.first is None and found.messages > run.setup.ticks
    of_run, of_engine = ({k: v for k, v in r.summary.items() if k not in WALL} for r in (run.result, expected))
    assert of_run == of_engine
    check_nothing_left(tmp_path / way)


def failure_of(fault):
    """Return the pattern of the failure of a run whose node was killed, stopped or doubled."""
    return {
        "kill": rf"node {fault.node} failed: its process was ended by SIGKILL",
        "stop": rf"node {fault.node} failed: no answer to stamp {fault.at:.3f} s within {SILENT_S:g} s",
        "duplicate": r"node \w+ failed: \S+ has more than one publisher",
    }[fault.do]


@pytest.mark.parametrize("row", LOST, ids=lambda row: row.name)
def test_a_lost_process_stops_the_train(row, tmp_path):
    """Breaks if the train goes on without a node, the run ends while it moves, or the log is not complete."""
    # A second node starts late: the demand counts from the last answer that the train used.
    folder = tmp_path / "run"
    rate = 2.0 if "duplicate" in row.sets[0] else 0.0
    run = graph_run(row, "processes", folder, rate, SILENT_S if "do: stop" in row.sets[0] else LIMIT_S)
    (fault,) = node_faults(run.setup.scenario.faults)
    assert re.match(failure_of(fault), run.result.failure) and run.front < run.supervised_location
    assert run.top_speed < run.largest_speed and run.end_speed < STANDSTILL
    last = stamps(folder, ANSWERS[fault.node]).max()
    assert last >= fault.at - KEPT
    detected = last if fault.do == "duplicate" else run.detected
    assert run.reacted - detected < 1.5 + 1e-9, "a demand to coast or brake within 1.5 s of simulated time"
    ticks = np.arange(run.result.summary["ticks"]) * run.setup.tick
    np.testing.assert_allclose(stamps(folder, "train/vehicles")[: ticks.size], ticks, atol=1e-6)
    check_nothing_left(folder)


@pytest.mark.parametrize("row", RECORDER_ROWS, ids=lambda row: row.name)
def test_a_lost_recorder_keeps_the_log(row, tmp_path):
    """Breaks if the run goes on without a record, or more than the last second is lost."""
    folder = tmp_path / "run"
    # The last second of the log is one of wall time; at this rate it has two.
    run = graph_run(row, "processes", folder, 0.5, SILENT_S)
    (fault,) = node_faults(run.setup.scenario.faults)
    assert run.result.failure.startswith(row.reaction)
    recover(folder)
    assert stamps(folder, "train/vehicles").max() > fault.at - KEPT
    check_nothing_left(folder)
