"""Runs with all nodes in one process: recorded messages, equal to the other ways, and texts of failures."""

import json
from pathlib import Path

import numpy as np
import pytest
from engine_runs import setup_of
from programs import begun

from train_ato.cli import main
from train_ato.log.difference import compare_logs
from train_ato.log.run_folder import read_run_folder
from train_ato.messages.codec import Wire

pytest.importorskip("rclpy")

from recordings import message_counts
from waiting import wait_for

from train_ato.log.reading import read_log
from train_ato.loop.controller import ControllerStage
from train_ato.loop.observer import ObserverStage
from train_ato.loop.profile import ProfileStage
from train_ato.messages.topics import BY_NAME
from train_ato.ros.graph import shared_memory
from train_ato.ros.graph.composed import run_composed
from train_ato.ros.graph.graph_result import GraphOptions
from train_ato.ros.graph.runner import run_graph
from train_ato.ros.nodes.controller import ControllerNode
from train_ato.ros.nodes.endpoints import NodeEndpoints

pytestmark = pytest.mark.usefixtures("without_figure")

TICK = 100_000_000


@pytest.fixture(scope="module")
def setup():
    return setup_of("demo", "duration=12")


def test_a_composed_run_records_every_message(setup, tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    outcome = run_graph(setup, out, mode="composed", progress=lambda _: None)
    assert outcome.failure is None and not outcome.interrupted
    recorded = {name.lstrip("/"): count for name, count in message_counts(out).items()}
    published = {name.lstrip("/"): n for name, n in outcome.published.items() if n and BY_NAME[name].recorded}
    assert recorded == published and recorded["train/vehicles"] == setup.ticks + 1
    assert recorded["ato/command"] == setup.ticks
    assert outcome.published["recorder/progress"] == (setup.ticks + 1) // 100
    assert sorted(path.name for path in out.iterdir()) == ["metadata.yaml", "run.mcap"]


@pytest.mark.parametrize(
    ("role", "target", "name"),
    [
        ("profile", ProfileStage, "on_measurement"),
        ("observer", ObserverStage, "step"),
        ("controller", ControllerStage, "command"),
    ],
)
def test_a_node_that_fails_is_named_and_the_log_is_closed(role, target, name, setup, tmp_path, monkeypatch):
    original = getattr(target, name)
    calls = []

    def fails(self, *arguments):
        calls.append(1)
        if len(calls) == 30:
            raise ZeroDivisionError("rail broken")
        return original(self, *arguments)

    monkeypatch.setattr(target, name, fails)
    outcome = run_graph(setup, tmp_path, mode="composed")
    assert outcome.failure == f"node {role} failed: ZeroDivisionError: rail broken"
    assert outcome.summary["ticks"] == 29 and message_counts(tmp_path)["/train/measurement"] == 30
    assert "rail broken" in (tmp_path / "log" / f"{role}.traceback.txt").read_text()


@pytest.mark.parametrize(
    ("role", "topic", "stamp", "chain"),
    [
        ("profile", "ato/reference", "2.000", ""),
        ("controller", "ato/state", "2.400", ": node profile waits for its ato/state"),
        *(
            pytest.param(role, topic, "2.000", "", marks=pytest.mark.graph)
            for role, topic in (
                ("observer", "ato/estimate"),
                ("controller", "ato/command"),
                ("supervisor", "atp/brake_release"),
            )
        ),
        ("supervisor", "atp/speeds", "2.000", ": node controller waits for its atp/speeds"),
    ],
)
def test_a_silent_node_is_named(role, topic, stamp, chain, setup, tmp_path, monkeypatch):
    """Fails when the run goes on with old values, hangs, or blames a node that waits for the silent one."""
    original = NodeEndpoints.publish

    def swallows(self, *messages):
        original(self, *(one for one in messages if one[0] != topic or one[1].stamp < 20 * TICK))

    monkeypatch.setattr(NodeEndpoints, "publish", swallows)
    outcome = run_graph(setup, tmp_path, mode="composed", timeout=2.0)
    assert outcome.failure == f"node {role} failed: no answer to stamp {stamp} s within 2 s{chain}"
    assert outcome.summary["ticks"] >= 20, "the plant goes on until the train is at standstill"


def test_a_lost_message_fails_the_run_by_its_topic(setup, tmp_path, domain, monkeypatch):
    """The count says sent, the recorder never got it: as a queue that overflowed would look."""
    original = NodeEndpoints.publish

    def loses(self, *messages):
        if any(name == "ato/estimate" and message.stamp == 119 * TICK for name, message in messages):
            self.published["train/vehicles"] = self.published.get("train/vehicles", 0) + 1
        original(self, *messages)

    monkeypatch.setattr(NodeEndpoints, "publish", loses)
    end = run_composed(setup, tmp_path, domain, GraphOptions(draining=3.0))
    assert end.failure == "node recorder failed: 121 messages of train/vehicles are recorded, 122 were published"
    assert (tmp_path / "run.mcap").is_file()


def test_a_full_disk_fails_the_recorder_by_name(setup, tmp_path, monkeypatch):
    from train_ato.log.mcap_writer import McapWriter

    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(McapWriter, "write_chunk", full)
    outcome = run_graph(setup, tmp_path, mode="composed")
    assert outcome.failure.startswith("node recorder failed: ")
    assert "No space left on device" in outcome.failure and not (tmp_path / "run.mcap").exists()


def test_a_planned_swap_is_shown_by_the_parameter_and_has_no_jump(setup, tmp_path, domain):
    """The first output after a swap equals the last command before it, up to the usual change of a tick."""
    swapping = setup_of("demo", "duration=40", "law_changes=[{at: 30, law: smc}]")
    shown = []
    original = ControllerNode._sync_parameters
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            ControllerNode,
            "_sync_parameters",
            lambda self, law: (
                original(self, law),
                shown.append((law, self.endpoints.node.get_parameter("law").value)),
            ),
        )
        end = run_composed(swapping, tmp_path, domain, GraphOptions())
    assert end.failure is None
    assert shown == [({}, "pid"), ({"controller": "smc"}, "smc")]  # at the start the gains that are taken
    commands = [m for _, _, m in read_log(tmp_path, Wire(setup.layout).decode, ("ato/command",))]
    force = np.array([m.force[0] for m in commands])
    assert abs(force[300] - force[299]) <= 1e-3 * np.abs(force).max()


def _mapped_by(process: int | str) -> set[Path]:
    """Return the files of Fast DDS in the shared memory of a process; an ended one has none."""
    try:
        lines = Path(f"/proc/{process}/maps").read_text().splitlines()
    except OSError:
        return set()
    return {Path(line.split()[-1]) for line in lines if f"{shared_memory.SHARED}/fastrtps_" in line}


def test_the_memory_of_a_killed_run_is_removed_by_the_next_one(setup, tmp_path):
    """Breaks if the files of a run that was ended by SIGKILL remain, or those of another running run are removed."""
    runs, files = [], []
    for name in ("killed", "running"):
        words = ["run", "demo", "--set=duration=6000", "--rate=20", f"--out={tmp_path / name}"]
        runs.append(begun(*words, stdout=None, stderr=None))
    try:
        for name, process in zip(("killed", "running"), runs, strict=True):
            partial = tmp_path / name / "run.mcap.partial"
            wait_for(lambda partial=partial: partial.exists() and partial.stat().st_size > 0, "a run that records")
            files.append(_mapped_by(process.pid))
            assert files[-1]
        runs[0].kill()
        runs[0].wait()
        (tmp_path / "next").mkdir()
        assert run_graph(setup, tmp_path / "next", mode="composed").failure is None
        left = {path for path in files[0] - files[1] if path.exists()}
        # runs of other tests use some ports again: these files are in use
        assert not left.difference(*(_mapped_by(folder.name) for folder in Path("/proc").glob("[0-9]*")))
        assert runs[1].poll() is None and all(path.exists() for path in files[1])
    finally:
        for process in runs:
            process.terminate()
            process.wait()


ROUGH = [
    "--set=duration=65",
    "--set=links.command={delay: 0.3, varying: {amplitude: 0.2}, jitter: 0.1, loss: 0.05}",
    "--set=plant.sensors={couplers: [0, 52], position_noise: 0.1, velocity_noise: 0.02, force_noise: 1000}",
    "--set=plant.disturbances=[{kind: eq40}]",
    "--set=law_changes=[{at: 30, law: smc}, {at: 45, law: pid}]",
    "--observer=ndo",
]
"""65 s of the 106-vehicle train with varying delay, jitter, loss, noise, a disturbance and two swaps of the law."""
WALL = ("wall_s", "real_time_factor", "step_time_us_median", "step_time_us_p99", "mode")


def drive(folder: Path, name: str, *options: str) -> Path:
    out = folder / name
    assert main(["run", "demo", "--json", f"--out={out}", *options]) == 0
    return out


@pytest.fixture(scope="module")
def engine_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory.mktemp("engine"), "run", "--engine", *ROUGH)


@pytest.mark.parametrize("way", [[], ["--processes"]], ids=["composed", "processes"])
def test_every_message_is_equal_in_all_ways(way: list[str], engine_run: Path, tmp_path: Path) -> None:
    """Breaks if a result depends on the order of arrival, on the process of a random number, or on the encoding."""
    run = drive(tmp_path, "run", *way, *ROUGH)
    setup, summary = read_run_folder(run)
    assert compare_logs(engine_run, run, Wire(setup.layout)).first is None
    of_engine = json.loads((engine_run / "summary.json").read_text())
    assert {k: v for k, v in summary.items() if k not in WALL} == {k: v for k, v in of_engine.items() if k not in WALL}
    assert (run / "scenario.yaml").read_text() == (engine_run / "scenario.yaml").read_text()


def test_another_seed_is_seen_and_the_resolved_scenario_is_enough(engine_run: Path, tmp_path: Path, capsys) -> None:
    """Breaks if the comparison above cannot fail, or a file named by the scenario is not in the run folder."""
    run = drive(tmp_path, "run", "--engine", *ROUGH, "--seed=2")
    setup, _ = read_run_folder(run)
    found = compare_logs(engine_run, run, Wire(setup.layout))
    assert {"ato/command", "train/vehicles", "train/measurement"} <= set(found.topics)
    capsys.readouterr()
    assert main(["verify", str(engine_run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["equal"] is True
