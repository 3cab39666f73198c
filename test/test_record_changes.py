"""Changes during a run: their entries in the log, and the repetition of the run with them."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from engine_runs import record_run, setup_of
from request_desk import beside_a_run

from train_ato.cli import main
from train_ato.judge.recording import OUTSIDE_KEY
from train_ato.log.difference import compare_logs
from train_ato.log.recorded import OWN_KEYS, late_commands, outside_nodes, read_changes
from train_ato.log.run_folder import STARTED, RunFolder, read_run_folder
from train_ato.loop.engine import Sink, run_engine
from train_ato.messages.codec import Wire
from train_ato.messages.topics import BY_NAME
from train_ato.messages.types import Diagnostic
from train_ato.ros.graph.recorded import complete_folder
from train_ato.scenario.changes import GIVEN, RunChanges, change_at, changes_from_json, values_of
from train_ato.scenario.scenario import LawChange, load_scenario
from train_ato.scenario.setup import RunSetup

pytestmark = pytest.mark.usefixtures("without_figure")

SECOND = 1_000_000_000


def drive(folder: Path, *assignments: str) -> Path:
    return record_run(setup_of("demo", "duration=40", *assignments), folder)


def driven_again(setup: RunSetup, folder: Path) -> Path:
    """Return a folder with the log of a run, and nothing else."""
    with RunFolder.make(folder, "again").sink(setup) as sink:
        run_engine(setup, sink=sink)
    return folder


def test_a_planned_change_is_told_at_the_step_that_begins_to_use_it(tmp_path: Path) -> None:
    """Breaks if a parameter waits for the next report, or a change between two ticks has the wrong stamp."""
    planned = "law_changes=[{at: 12.34, laws: {pid: {kp: 0.05}}}, {at: 30, law: smc}]"
    run = drive(tmp_path / "run", planned)
    assert read_changes(run).laws == [(12_400_000_000, {"pid.kp": 0.05}), (30 * SECOND, {"controller": "smc"})]
    assert json.loads((run / "summary.json").read_text())["changes"] == [
        {"at_s": 12.4, "name": "pid.kp", "value": 0.05, "planned": True},
        {"at_s": 30.0, "name": "controller", "value": "smc", "planned": True},
    ]
    assert not (run / STARTED).exists()
    plain = drive(tmp_path / "plain")
    setup, _ = read_run_folder(run)
    assert compare_logs(plain, run, Wire(setup.layout)).first is not None


def test_what_took_effect_drives_the_run_again(tmp_path: Path) -> None:
    """Breaks if two changes of one step are exchanged, or rounding moves a swap between two ticks."""
    both = "{at: 7.77, laws: {pid: {kp: 0.05, ki: 0.001}}, law: pid}"
    planned = f"law_changes=[{both}, {{at: 0, law: smc}}]"
    run = drive(tmp_path / "run", planned)
    setup, _ = read_run_folder(run)
    told = read_changes(run)
    again = told.driven(setup_of("demo", "duration=40").scenario)
    assert [swap.at for swap in again.law_changes] == [0.0, 7.8]
    other = driven_again(dataclasses.replace(setup, scenario=again), tmp_path / "again")
    assert compare_logs(run, other, Wire(setup.layout)).first is None


def test_a_swap_at_the_start_is_the_law_of_the_start(tmp_path: Path) -> None:
    """Breaks if the initial law starts with the transition of a swap."""
    swapped = drive(tmp_path / "a", "law_changes=[{at: 0, law: smc}]")
    chosen = drive(tmp_path / "b", "law=smc")
    setup, _ = read_run_folder(chosen)
    found = compare_logs(swapped, chosen, Wire(setup.layout))
    assert found.topics == {"/diagnostics": 1}
    assert "changed" in str(found.first)


def test_steps_that_were_not_reached_stay_planned() -> None:
    scenario, _ = load_scenario("demo", ("law_changes=[{at: 5, law: smc}, {at: 700, law: pid}]",))
    told = RunChanges(laws=[(3 * SECOND, {"pid.kp": 0.5}), (5 * SECOND, {"controller": "smc"})])
    driven = [(swap.at, values_of(swap)) for swap in told.driven(scenario).law_changes]
    assert driven == [(3.0, {"pid.kp": 0.5}), (5.0, {"controller": "smc"}), (700.0, {"controller": "pid"})]
    assert [row["planned"] for row in told.rows(scenario)] == [False, True]


@pytest.mark.parametrize("stamp", [0, 1, 100_000_000, 700_000_000, 86_399_900_000_000, 2_599_300_000_001])
def test_stamps_survive_the_scenario_file(stamp: int) -> None:
    """Breaks if a stamp written in seconds returns a nanosecond off: the change would move by a tick."""
    swap = change_at(stamp, {"smc.k": 0.1, "controller": "smc"})
    read = LawChange.model_validate(yaml.safe_load(yaml.safe_dump(swap.model_dump(mode="json"))))
    assert round(read.at * SECOND) == stamp
    assert values_of(read) == {"smc.k": 0.1, "controller": "smc"}


@pytest.mark.parametrize("text", ["", "[]", '{"pid.kp": [1]}', "{'a': 1}"])
def test_foreign_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="not written by this version"):
        changes_from_json(text)


@pytest.mark.campaign
@pytest.mark.parametrize("way", [[], ["--processes"]], ids=["one", "several"])
def test_a_law_set_from_another_process_is_recorded_and_verified(way, tmp_path, monkeypatch):
    """Breaks if the log lacks the time of a change of law or parameter, or ``verify`` omits the change."""
    pytest.importorskip("rclpy")
    run = tmp_path / "run"
    with beside_a_run(run, monkeypatch, "--set=duration=100", *way) as (desk, summary):
        assert desk.set("pid.kpp=1").returncode == 2
        assert desk.set("law=smc").returncode == 0
        desk.steps(3)
        assert desk.set("pid.kp=0.05").returncode == 0
        desk.steps(2)
        assert desk.set("law=pid").returncode == 0
    changes = summary["changes"]
    told = [(row["name"], row["value"], row["planned"]) for row in changes]
    assert told == [("controller", "smc", False), ("pid.kp", 0.05, False), ("controller", "pid", False)]
    first = changes[0]["at_s"]
    assert [row["at_s"] - first for row in changes] == pytest.approx([0.0, 0.3, 0.5], abs=0.11)
    assert yaml.safe_load((run / STARTED).read_text())["law_changes"] == []
    assert len(yaml.safe_load((run / "scenario.yaml").read_text())["law_changes"]) == 3
    (run / "scenario.yaml").unlink()
    plain = setup_of(str(run / STARTED))
    found = compare_logs(run, driven_again(plain, tmp_path / "plain"), Wire(plain.layout))
    assert found.first is not None
    assert found.first.stamp == round(first * SECOND)


def test_late_commands_of_a_paced_run_are_counted(tmp_path: Path) -> None:
    """Breaks if ``verify`` attributes an effect of the wall clock to the code: the last count of the plant is valid."""
    setup = setup_of()
    with RunFolder.make(tmp_path / "run", "demo").sink(setup) as sink:
        for second, late in enumerate((0, 2, 3)):
            values = {"wall_late": str(late), "wall_held": "1"}
            sink.add("/diagnostics", Diagnostic(second * SECOND, "plant", 0, "running", values), second * SECOND)
        sink.add("/diagnostics", Diagnostic(0, "controller", 0, "engaged", {"wall_late": "99"}), 0)
    assert late_commands(tmp_path / "run") == 4
    assert late_commands(drive(tmp_path / "lockstep")) == 0


NAMES = {"controller": "my_controller", "observer": "my_observer"}


def record_by_hand(
    folder: Path, changed: tuple[str, ...], told: dict[str, Any], names: dict[str, str] = NAMES, lost: Any = None
) -> dict[str, Any]:
    """Record a run with start parameters of nodes that the recorder does not have; return its summary."""
    # ``told`` has the start parameters in the first diagnostics of a node, None for a program that sends none; ``lost``
    # the stamp from which on the link has lost all messages of a node [s].
    driven = setup_of("demo", "duration=20", *changed)

    class Nodes(Sink):
        def __init__(self, sink: Any) -> None:
            self.sink = sink

        def add(self, topic: str, message: Any, stamp: int) -> None:
            sender = getattr(message, "node", "") or BY_NAME[topic].publishers[0].value
            given = told.get(getattr(message, "node", ""), {})
            if given is None or stamp * 1e-9 >= (lost or {}).get(sender, math.inf):
                return
            if given and stamp == 0:
                message = dataclasses.replace(message, values={**message.values, GIVEN: json.dumps(given)})
            self.sink.add(topic, message, stamp)

    setup = setup_of("demo", "duration=20")
    with RunFolder.make(folder, "demo").sink(setup) as sink:
        run_engine(driven, sink=Nodes(sink))
        counts = sink.counts
    assert complete_folder(setup, folder, counts, 1.0, names=names) is not None
    return json.loads((folder / "summary.json").read_text())


def test_law_and_observer_are_those_that_the_nodes_reported(tmp_path: Path) -> None:
    """Breaks if summary or scenario has the law of the recorder's scenario, or the run cannot be repeated from them."""
    changed = ("law=smc", "laws.smc.ks=0.3", "observer=ndo", "observers.ndo.omega=5.0")
    told = {"controller": {"smc.ks": 0.3, "controller": "smc"}, "observer": {"observer": "ndo", "ndo.omega": 5.0}}
    summary = record_by_hand(tmp_path / "run", changed, told)
    assert (summary["controller"], summary["observer"]) == ("smc", "ndo")
    assert (summary["status"], summary["changes"]) == ("done", [])
    scenario = yaml.safe_load((tmp_path / "run" / "scenario.yaml").read_text())
    assert (scenario["law"], scenario["laws"]["smc"]["ks"]) == ("smc", 0.3)
    assert (scenario["observer"], scenario["observers"]["ndo"]["omega"]) == ("ndo", 5.0)
    assert main(["verify", str(tmp_path / "run")]) == 0
    assert main(["verify", str(tmp_path / "run" / "run.mcap")]) == 0


def test_a_program_in_place_of_a_node_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the summary names a law of the scenario that did not drive, or ``verify`` drives it in its place."""
    summary = record_by_hand(tmp_path / "run", ("law=smc",), {"controller": None})
    assert summary["controller"] == summary["compensation"] == "external: my_controller"
    assert (summary["observer"], summary["external"]) == ("none", {"controller": "my_controller"})
    assert not {"gains", "advice"} & {*summary}
    assert main(["verify", str(tmp_path / "run")]) == 2
    assert "cannot be driven again, a node was a program outside of this project: controller was my_controller" in (
        capsys.readouterr().err
    )


@pytest.mark.parametrize(("node", "sent_s"), [*((node, 1.0) for node in OWN_KEYS), *((node, 0.0) for node in NAMES)])
def test_a_node_whose_report_was_lost_is_no_other_program(node: str, sent_s: float, tmp_path: Path) -> None:
    """Breaks if the log of a link cut at the start names another program, without any sign of one, as the driver."""
    names = {role: role for role in OWN_KEYS}
    lost = dict.fromkeys(OWN_KEYS, 1.0) | {node: sent_s}
    summary = record_by_hand(tmp_path / "run", (), {node: None}, names, lost)
    assert "external" not in summary
    assert (summary["controller"], summary["observer"], summary["compensation"]) == ("pid", "none", "preview")


PLANT = Diagnostic(0, "plant", 0, "running", {OWN_KEYS["plant"]: "0"})
SENT = dict.fromkeys(OWN_KEYS, 0.5)


@pytest.mark.parametrize("node", [*OWN_KEYS][1:])
def test_signs_of_a_program_in_place_of_a_node(node: str) -> None:
    """Breaks if one sign of another program is not enough, or a missing report is one."""
    others = [Diagnostic(0, role, 0, "", {key: ""}) for role, key in OWN_KEYS.items() if role not in (node, "plant")]

    def found(*reports: Diagnostic, plant: Diagnostic = PLANT, name: str = node, sent_s: float = 0.5) -> dict[str, str]:
        return outside_nodes(
            [plant, *others, *reports], supervised=True, names={node: name}, sent_s=SENT | {node: sent_s}
        )

    assert found() == {}
    assert found(Diagnostic(0, node, 0, "", {OWN_KEYS[node]: ""}), sent_s=60.0) == {}
    met = dataclasses.replace(PLANT, values={**PLANT.values, OUTSIDE_KEY: f"lidar {node}"})
    assert found(plant=met) == {node: node}
    assert found(plant=met, name="mine") == found(name="mine") == {node: "mine"}
    assert found(name="mine", sent_s=0.0) == {}
    assert found(Diagnostic(0, node, 0, "", {})) == {node: node}
    assert found(Diagnostic(0, node, 0, "", {node: "my law"}), plant=met) == {node: "my law"}
    assert found(sent_s=3.0) == {node: node}
