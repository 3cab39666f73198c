"""Requests to the ATO during a run: their entries in the log, and the repetition of the run with them."""

import dataclasses
import json
from pathlib import Path

import pytest
import yaml
from engine_runs import record_run
from request_desk import beside_a_run

from train_ato.cli.main import main
from train_ato.log.difference import compare_logs
from train_ato.log.recorded import read_changes
from train_ato.log.run_folder import RunFolder, read_run_folder
from train_ato.loop.engine import run_engine
from train_ato.messages.codec import Wire
from train_ato.messages.types import Diagnostic
from train_ato.scenario.changes import RunChanges
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare

SECOND = 1_000_000_000
AT_REST = "[{at: 1, do: disengage}, {at: 2.5, do: engage}, {at: 2.5, do: disengage}, {at: 9, do: reset}]"
"""Requests to a train that does not yet move; the third waits for the engagement, the last is never possible."""
LOST = "faults=[{topic: ato/reference, begin: 0.5, end: 3, do: drop}]"
"""A loss of the reference, after which the ATO fails before the train moves; the run goes on."""


def test_an_accepted_request_is_in_summary_log_and_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a request is missing in ``changes``, has its planned time, or one that was not accepted is listed."""
    run = record_run(prepare(*load_scenario("demo", ("duration=15", f"ato_requests={AT_REST}"))), tmp_path / "run")
    rows = json.loads((run / "summary.json").read_text())["changes"]
    assert [(row["at_s"], row["name"], row["value"], row["planned"]) for row in rows] == [
        (1.2, "ato_request", "disengage", True),
        (2.8, "ato_request", "engage", True),
        (3.2, "ato_request", "disengage", True),
    ]
    assert read_changes(run).requests == [
        (1_200_000_000, "disengage"), (2_800_000_000, "engage"), (3_200_000_000, "disengage"),
    ]  # fmt: skip
    assert main(["info", str(run / "run.mcap"), "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["changes"]
    assert [(row["at_s"], row["value"]) for row in listed] == [(1.2, "disengage"), (2.8, "engage"), (3.2, "disengage")]


def test_accepted_requests_drive_the_run_again(tmp_path: Path) -> None:
    """Breaks if the repeated run lacks a request, has it at another step, or forgets one that still waits."""
    setup = prepare(*load_scenario("demo", ("duration=15", f"ato_requests={AT_REST}")))
    run = record_run(setup, tmp_path / "run")
    plain = dataclasses.replace(setup, scenario=setup.scenario.model_copy(update={"ato_requests": ()}))
    again = dataclasses.replace(setup, scenario=read_changes(run).driven(plain.scenario))
    assert [(entry.at, entry.do) for entry in again.scenario.ato_requests] == [
        (1.2, "disengage"), (2.8, "engage"), (3.2, "disengage"),
    ]  # fmt: skip
    folder = RunFolder.make(tmp_path / "again", "again")
    with folder.sink(again) as sink:
        run_engine(again, sink=sink)
    assert compare_logs(run, folder.path, Wire(setup.layout)).first is None
    assert [entry.do for entry in read_changes(run).driven(setup.scenario).ato_requests][-1] == "reset"


def test_a_request_is_planned_if_the_scenario_has_it() -> None:
    """Breaks if an accepted request counts as a plan of another kind or of a later time, or as two plans."""
    scenario, _ = load_scenario(
        "demo", ("ato_requests=[{at: 1, do: reset}, {at: 2, do: engage}, {at: 9, do: engage}]",)
    )
    found = RunChanges(requests=[(3 * SECOND, "engage"), (4 * SECOND, "engage")])
    assert [row["planned"] for row in found.rows(scenario)] == [True, False]
    assert [(entry.at, entry.do) for entry in found.driven(scenario).ato_requests] == [
        (1.0, "reset"), (3.0, "engage"), (4.0, "engage"), (9.0, "engage"),
    ]  # fmt: skip


def test_a_request_of_another_version_is_refused() -> None:
    """Breaks if a repeated run omits a request that this version cannot read."""
    message = Diagnostic(SECOND, "controller", 0, "engaged", {"ato_request": "fly"})
    with pytest.raises(ValueError, match="ato_request 'fly': not written by this version"):
        RunChanges.of([message])
    other = Diagnostic(SECOND, "plant", 0, "running", {"ato_request": "engage"})
    assert RunChanges.of([other]).requests == []


@pytest.mark.campaign
def test_live_requests_are_recorded_and_verified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a service call is missing in the log or ``verify`` omits it, or a refusal has no reason."""
    pytest.importorskip("rclpy")
    run = tmp_path / "run"
    with beside_a_run(run, monkeypatch, f"--set={LOST}", "--set=duration=60") as (desk, summary):
        early = desk.inject("engage")
        assert early.returncode == 2
        assert "engage: refused by the controller: engage: the ATO is" in early.stderr
        desk.steps(32)  # past the loss of the reference, in the state failure
        for action in ("reset", "engage", "disengage"):
            done = desk.inject(action)
            assert done.returncode == 0, done.stderr
            assert f"controller on domain {desk.domain}: {action}" in done.stdout
            desk.steps(8)
    rows = summary["changes"]
    assert [(row["name"], row["value"], row["planned"]) for row in rows] == [
        ("ato_request", action, False) for action in ("reset", "engage", "disengage")
    ]
    planned = yaml.safe_load((run / "scenario.yaml").read_text())["ato_requests"]
    assert [(entry["at"], entry["do"]) for entry in planned] == [(row["at_s"], row["value"]) for row in rows]
    setup, _ = read_run_folder(run)
    silent = dataclasses.replace(setup, scenario=setup.scenario.model_copy(update={"ato_requests": ()}))
    other = RunFolder.make(tmp_path / "other", "other")
    with other.sink(silent) as sink:
        run_engine(silent, sink=sink)
    first = compare_logs(run, other.path, Wire(setup.layout)).first
    assert first is not None
    assert first.stamp == round(rows[0]["at_s"] * SECOND)
