"""A program in place of a node, by ``--external``: it needs only what the node uses, and the record says its name."""

import json
import os
import re
import runpy
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from engine_runs import setup_of

pytest.importorskip("rclpy")

from waiting import LIMIT_S, reserved_domain

import train_ato as ta
from train_ato.cli.main import main
from train_ato.control.contract import LawInput
from train_ato.control.guard import GuardedLaw
from train_ato.log.reading import iter_raw
from train_ato.ros.graph.runner import run_graph

pytestmark = pytest.mark.usefixtures("without_figure")

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = str(ROOT / "examples" / "ros" / "my_controller.py")
PLANT = str(ROOT / "examples" / "ros" / "my_plant.py")


@contextmanager
def program_on(domain: int, *command: str, ends: bool = False) -> Iterator[None]:
    """Run a Python program on a domain to the end of the block, or to its own end if it ``ends`` earlier."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    process = subprocess.Popen([sys.executable, *command], env=environment, stderr=subprocess.PIPE, text=True)
    try:
        yield
    finally:
        if not ends:
            process.send_signal(signal.SIGINT)
        assert (process.communicate(timeout=LIMIT_S)[1], process.returncode) == ("", 0)


@pytest.fixture
def free_domain() -> int:
    """Return a free domain, which the run itself claims."""
    return reserved_domain()


@dataclass
class Proportional(GuardedLaw):
    """Law of the example."""

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force of every unit [N]."""
        force = 600e3 * (inputs.reference_velocity[0] - inputs.velocity[0])
        return [max(-200e3, min(200e3, force))] * len(inputs.velocity)


def test_the_example_answers_only_with_both_readers() -> None:
    """Breaks if the example sends a command that the plant or the recorder loses."""
    example = SimpleNamespace(**runpy.run_path(EXAMPLE))
    counts, sent = [0, 1, 2], list[Any]()
    node = object.__new__(example.MyController)
    node.steps = {}
    node.command = SimpleNamespace(get_subscription_count=lambda: counts.pop(0), publish=sent.append)
    header = example.JointState().header
    for known in ({"target": 5.0}, {"units": ["unit_0"], "speed": 4.9}):
        node._answer(header, **known)
    assert counts == [] and [list(command.effort) for command in sent] == [pytest.approx([60e3])]


def test_a_controller_of_ones_own_drives_as_the_same_law_inside(free_domain: int, tmp_path: Path, capsys) -> None:
    """Breaks if a program must send more than commands, or they act at another tick or in the next run."""
    # in motion from the begin: at standstill the controller of the project uses no law
    changes = {
        "duration": 6, "supervision.enabled": False, "plant.start": {"speed_kmh": 50}, "profile.phases": None,
        "profile.points": [{"time": 0, "speed_kmh": 50}, {"time": 800, "speed_kmh": 52}],
        "profile.allow_rolling_end": True,
    }  # fmt: skip
    given: dict[str, Any] = {"set": changes}
    inside = ta.run("demo", law=Proportional(), compensation="none", **given)
    with program_on(free_domain, EXAMPLE):
        for _ in range(2):
            outside = ta.run("demo", mode="composed", external="controller", domain=free_domain, **given)
    assert outside.metrics["controller"] == "external: my_controller"
    assert outside.metrics["external"] == {"controller": "my_controller"}
    assert f"start the program in place of controller with ROS_DOMAIN_ID={free_domain}\n" in capsys.readouterr().err
    for topic in ("ato/command", "train/vehicles"):
        assert np.array_equal(outside[topic].to_numpy(), inside[topic].to_numpy()), topic
    with pytest.raises(ta.InputError, match="cannot be driven again"):
        ta.verify(outside.save(tmp_path / "outside"))


@pytest.mark.graph
@pytest.mark.parametrize(
    ("role", "mode"),
    [
        *((role, "composed") for role in ("controller", "observer", "profile", "supervisor")),
        *((role, "processes") for role in ("controller", "observer")),
    ],
)
def test_every_node_may_be_outside(role: str, mode: Any, free_domain: int) -> None:
    """Breaks if a graph needs its own node of a kind, or does not wait for one of its topics."""
    changes = {"duration": 5, "observer": "eso"}
    sets = [f"--set={key}={value}" for key, value in changes.items()]
    with program_on(free_domain, "-m", "train_ato.ros.standalone", role, "--scenario=demo", *sets, ends=True):
        outside = ta.run("demo", set=changes, mode=mode, external=role, domain=free_domain)
    inside = ta.run("demo", set=changes)
    assert outside.metrics["external"] == {role: role}
    for topic in ("ato/command", "ato/estimate", "ato/reference", "train/vehicles"):
        assert np.array_equal(outside[topic].to_numpy(), inside[topic].to_numpy()), topic


@pytest.mark.graph
def test_pressure_and_state_of_the_ato_may_be_left_out(free_domain: int, tmp_path: Path) -> None:
    """Breaks if the air brake waits for an absent pressure, or the profile for an absent state of the ATO."""
    with program_on(free_domain, EXAMPLE):
        options = ["--external=controller", f"--domain={free_domain}", "--set=duration=5", f"--out={tmp_path / 'run'}"]
        assert main(["run", "daqin_heavy_haul", *options]) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["ticks"], summary["brake_interventions"], summary["held_steps"]) == (50, 0, 0)
    assert summary["strongest_reaction"] == "none" and summary["external"] == {"controller": "my_controller"}


@pytest.mark.graph
def test_commands_without_a_stamp_are_taken_without_lockstep(free_domain: int, tmp_path: Path) -> None:
    """Breaks if an unstamped command is ignored: the train then brakes, as without a controller."""
    program = tmp_path / "unstamped.py"
    program.write_text(Path(EXAMPLE).read_text().replace("header=header, ", ""))
    folder = tmp_path / "run"
    folder.mkdir()
    setup = setup_of("demo", "duration=2")
    # a tick of 0.5 s of wall time: a busy machine answers in it
    options: dict[str, Any] = {"rate": 0.2, "timeout": LIMIT_S, "domain": free_domain, "external": "controller"}
    with program_on(free_domain, str(program)):
        summary = run_graph(setup, folder, mode="composed", lockstep=False, **options).summary
    assert (summary["status"], summary["external"]) == ("done", {"controller": "my_controller"})
    assert summary["ticks"] == 20 and summary.get("ignored", {}).get("plant", 0) < 10
    stamps = [stamp for _, stamp, _ in iter_raw(folder, ("ato/command",))]
    assert len(stamps) > 10 and stamps == sorted(stamps) and 0 <= stamps[0] <= stamps[-1] <= 2e9


@pytest.mark.graph
@pytest.mark.parametrize("mode", ["composed", "processes"])
def test_a_controller_of_ones_own_that_dies_stops_the_train(mode: Any, free_domain: int, tmp_path: Path) -> None:
    """Breaks if the run goes on, or blames another node."""
    program = tmp_path / "dies.py"
    at = "            self.steps.clear()\n"
    end = "            if header.stamp.nanosec == 500_000_000: raise SystemExit(0)\n"
    program.write_text(Path(EXAMPLE).read_text().replace(at, at + end))
    assert end in program.read_text()
    with (
        program_on(free_domain, str(program), ends=True),
        pytest.raises(ta.RunFailed, match="node controller failed: it left the run at ") as caught,
    ):
        ta.run("demo", mode=mode, external="controller", domain=free_domain, set={"duration": 60})
    assert caught.value.run.metrics["strongest_reaction"] != "none"


LATE = """
from my_controller import Clock, ExternalShutdownException, MyController, Node, rclpy, suppress

class Late(MyController):
    later = []

    def create_subscription(self, *reader):
        self.later.append(reader)

    def begin(self, _):
        while self.later:
            super().create_subscription(*self.later.pop())

rclpy.init()
node = Late()
Node.create_subscription(node, Clock, "/clock", node.begin, 1000)
with suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(node)
"""


@pytest.mark.graph
@pytest.mark.parametrize("mode", ["composed", "processes"])
def test_a_reader_that_comes_after_the_first_message_gets_it(mode: Any, free_domain: int, tmp_path: Path) -> None:
    """Breaks if the run waits for the answer of a program that has lost the first message."""
    (tmp_path / "my_controller.py").write_text(f"from rosgraph_msgs.msg import Clock\n{Path(EXAMPLE).read_text()}")
    (program := tmp_path / "late.py").write_text(LATE)
    given: dict[str, Any] = {"set": {"duration": 2}, "mode": mode, "external": "controller", "domain": free_domain}
    with program_on(free_domain, str(program)):
        driven = ta.run("demo", **given)
    assert (driven.metrics["status"], driven.metrics["ticks"], driven.metrics.get("ignored")) == ("done", 20, None)
    assert np.array_equal(np.round(driven["train/measurement"].index / 0.1), range(20))


class Raises:
    """Observer that raises after 5 s."""

    def reset(self) -> None:
        """Begin again."""
        self.left = 50

    def step(self, inputs: Any) -> np.ndarray:
        """Return no disturbance."""
        self.left -= 1
        if not self.left:
            raise ValueError("no measurement")
        return np.zeros(1)


@pytest.mark.graph
@pytest.mark.parametrize("mode", ["composed", "processes"])
def test_an_observer_that_raises_stops_the_train_of_an_external_controller(mode: Any, free_domain: int) -> None:
    """Breaks if the run ends while the train moves, or the line lacks the file: nothing stops the controller itself."""
    said = re.escape(f"node observer failed: observer Raises: ValueError: no measurement, {__file__}:")
    with program_on(free_domain, EXAMPLE), pytest.raises(ta.RunFailed, match=said) as caught:
        ta.run("demo", observer=Raises, mode=mode, external="controller", domain=free_domain)
    assert caught.value.run.metrics["strongest_reaction"] == "service brake"
    assert caught.value.run["train/measurement"].to_numpy()[-1, 1] == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("mode", ["composed", pytest.param("processes", marks=pytest.mark.graph)])
def test_a_plant_of_ones_own_is_driven(mode: Any, free_domain: int, tmp_path: Path) -> None:
    """Breaks if a program must send more than measurements, or if it gets a command of another tick."""
    given: dict[str, Any] = {"set": {"duration": 20}, "mode": mode, "external": "plant", "domain": free_domain}
    with program_on(free_domain, PLANT):
        driven = ta.run("xuzhou_metro:ideal", **given)
    assert (driven.metrics["status"], driven.metrics["ticks"]) == ("done", 400)
    assert driven.metrics["external"] == {"plant": "my_plant"}
    assert abs(driven.metrics["position_error_max_m"]) < 0.1  # as with the plant of the project, 0.07 m in 460 s
    measured, force = driven["train/measurement"].to_numpy(), driven["ato/command"].to_numpy()[:, 0]
    assert measured.shape[0] == 401 and force.shape[0] == 400 and force.any()
    position, speed = 0.0, 0.0
    for tick, (was_at, had, applied) in enumerate(measured):
        assert (was_at, had, applied) == (position, speed, force[tick - 1] if tick else 0.0), tick
        resistance = 4e3 + 8.0 * speed**2 if speed > 0 else 0.0
        speed = max(0.0, speed + (force[min(tick, 399)] - resistance) / 192_200 * 50 * 1e-3)
        position += speed * 50 * 1e-3
    with pytest.raises(ta.InputError, match=r"cannot be driven again.*plant was my_plant"):
        ta.verify(driven.save(tmp_path / "driven"))


@pytest.mark.graph
@pytest.mark.parametrize("mode", ["composed", "processes"])
def test_a_plant_of_ones_own_keeps_real_time(mode: Any, free_domain: int) -> None:
    """Breaks if the run waits for the answers, or records what the program sends after the last tick."""
    with program_on(free_domain, PLANT, "--real-time"):
        changes = {"duration": 2}
        driven = ta.run("xuzhou_metro:ideal", set=changes, mode=mode, external="plant", domain=free_domain)
    assert (driven.metrics["status"], driven.metrics["ticks"]) == ("done", 40)
    assert np.array_equal(np.round(driven["train/measurement"].index / 0.05), range(41))


SUPERVISED = """
        if self.tick % EVERY == 0:
            head, names = Header(stamp=self.stamp), ["wheel", "radar", "wheel_since_balise", "radar_since_balise"]
            position = [59 + self.position] * 2 + [self.position] * 2
            self.odometry.publish(JointState(header=head, name=names, position=position, velocity=[self.speed] * 4))
            keys = "traction_active", "service_brake_active", "emergency_brake_active"
            status = DiagnosticStatus(name="my_plant: brakes", values=[KeyValue(key=key, value="0") for key in keys])
            self.protection.publish(DiagnosticArray(header=head, status=[status]))
"""


@pytest.mark.graph
@pytest.mark.parametrize("every", [8, 4, 16])
def test_a_plant_of_ones_own_is_supervised(every: int, free_domain: int, tmp_path: Path) -> None:
    """Breaks if the supervisor needs more than odometry and brakes, or another period stops without a word."""
    text, program = Path(PLANT).read_text(), tmp_path / "supervised.py"
    begin, before = 'super().__init__("my_plant")\n', '        state = {"position"'
    assert begin in text and before in text
    kinds = "DiagnosticArray, DiagnosticStatus, KeyValue"
    more = '        self.odometry = self.create_publisher(JointState, "train/odometry", 9)\n'
    more += '        self.protection = self.create_publisher(DiagnosticArray, "train/protection", 9)\n'
    program.write_text(
        f"from diagnostic_msgs.msg import {kinds}\n"
        + text.replace(begin, begin + more).replace(before, f"        EVERY = {every}{SUPERVISED}{before}")
    )
    changes = {"duration": 20, "supervision.enabled": True}
    mode: dict[str, Any] = {"mode": "composed", "external": "plant", "domain": free_domain}
    with program_on(free_domain, str(program)):
        if every > 8:
            with pytest.raises(ta.RunFailed, match=r"node plant failed: no answer to stamp 0.4.* waits for"):
                ta.run("xuzhou_metro:ideal", set=changes, **mode)
            return
        summary = (driven := ta.run("xuzhou_metro:ideal", set=changes, **mode)).metrics
    assert (summary["status"], summary["ticks"], summary["brake_interventions"]) == ("done", 400, 0)
    assert driven["train/measurement"].to_numpy()[-1, 1] > 5.0


@pytest.mark.graph
@pytest.mark.parametrize("mode", ["composed", "processes"])
def test_a_plant_of_ones_own_that_dies_fails_the_run(mode: Any, free_domain: int, tmp_path: Path) -> None:
    """Breaks if the run waits for ever, or blames another node."""
    program, at = tmp_path / "dies.py", "        self.tick += 1\n"
    program.write_text(Path(PLANT).read_text().replace(at, f"{at}        if self.tick == 30: raise SystemExit(0)\n"))
    with (
        program_on(free_domain, str(program), ends=True),
        pytest.raises(ta.RunFailed, match=r"node plant failed: it left the run at 1\.450 s") as caught,
    ):
        ta.run("xuzhou_metro:ideal", mode=mode, external="plant", domain=free_domain)
    assert caught.value.run.metrics["ticks"] == 29


@pytest.mark.graph
def test_a_node_that_dies_beside_a_plant_of_ones_own_fails_the_run(free_domain: int) -> None:
    """Breaks if the run waits for ever for the process of a node, or blames the plant."""
    changes = {"duration": 20, "faults": [{"do": "kill", "node": "observer", "at": 1}]}
    with (
        program_on(free_domain, PLANT),
        pytest.raises(ta.RunFailed, match="node observer failed: its process was ended by SIGKILL") as caught,
    ):
        ta.run("xuzhou_metro:ideal", set=changes, mode="processes", external="plant", domain=free_domain)
    assert 19 <= caught.value.run.metrics["ticks"] <= 20


@pytest.mark.parametrize(("options", "text"), [
    (["--external=recorder"], "'recorder': choose from controller, observer, profile, supervisor, plant"),
    (["--external=plant", "--processes", "--restart"], "an external plant does not wait for a new process"),
    (["--external=plant", "--rate=1"], "--rate: the external plant is the source of time; remove it"),
    (["--external=plant", "--no-lockstep"], "--no-lockstep: the external plant is the source of time; remove it"),
    (["--external=controller", "--engine"], "the engine has no nodes; remove --engine"),
    (["--external=supervisor", "--set=supervision.enabled=false"], "the run has none; set supervision.enabled"),
])  # fmt: skip
def test_an_external_node_that_cannot_be_is_refused(options: list[str], text: str, capsys) -> None:
    """Breaks if a run begins that waits for ever."""
    assert main(["run", "demo", *options]) == 2
    said = capsys.readouterr()
    assert said.out == "" and text in said.err and len(said.err.splitlines()) == 1
