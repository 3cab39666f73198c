"""Hosts that can join a run: this machine only, others if the user permits them."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from recordings import commands_in

pytest.importorskip("rclpy")

from foreign_node import ForeignNode
from two_hosts import HOSTS, two_hosts  # noqa: F401
from waiting import LIMIT_S, reserved_domain, wait_for

from train_ato.ros.graph.environment import middleware, opened_by

VARIABLES = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS", "FASTRTPS_DEFAULT_PROFILES_FILE")
BRAKE = """
import sys
from foreign_node import ForeignNode
from std_srvs.srv import SetBool
with ForeignNode(int(sys.argv[1])) as foreign:
    try:
        answer = foreign.call(SetBool, "plant/emergency_brake", SetBool.Request(data=True), limit=float(sys.argv[2]))
        print("answered", answer.success)
    except AssertionError:
        print("not found", sorted(foreign.node.get_node_names()))
"""
"""Program of another host: discover the plant and brake its train."""


def environment(**variables: str) -> dict[str, str]:
    """Return an environment with only these variables of ROS set."""
    return {**{name: value for name, value in os.environ.items() if name not in VARIABLES}, **variables}


class Drive:
    """``train-ato run`` in a separate process, optionally on another host."""

    def __init__(self, folder: Path, *options: str, host: tuple[str, ...] = (), **variables: str) -> None:
        self.domain = reserved_domain()
        self.out = folder / "run"
        words = ["run", "demo", "--set=duration=3600", "--rate=20", f"--domain={self.domain}", f"--out={self.out}"]
        words = [*host, sys.executable, "-m", "train_ato", *words, *options]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen(words, env=environment(**variables), **pipes)

    def wait(self) -> None:
        """Wait until the train moves."""
        wait_for(lambda: self.process.poll() is not None or commands_in(self.out), "the first command")
        assert self.process.poll() is None, self.process.communicate()

    def end(self) -> str:
        """End the run with Ctrl-C and return its stderr."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.process.communicate(timeout=LIMIT_S)[1]


@pytest.fixture
def drive(tmp_path: Path) -> Iterator[type[Drive]]:
    begun = []

    def start(*options, **more):
        begun.append(Drive(tmp_path, *options, **more))
        begun[-1].wait()
        return begun[-1]

    yield start
    for run in begun:
        run.end()


@pytest.mark.parametrize(
    ("options", "variables", "loopback"),
    [
        ([], {}, True),
        ([], {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, True),
        pytest.param(["--processes"], {}, True, marks=pytest.mark.graph),
        ([], {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, False),
    ],
    ids=["composed", "localhost", "processes", "subnet"],
)
def test_sockets_of_a_run(options, variables, loopback, drive):
    """Fails if a socket of a default run is open to a network: one on all interfaces, or in a multicast group."""
    run = drive(*options, **variables)
    parent = str(run.process.pid)
    pids = {parent, *Path(f"/proc/{parent}/task/{parent}/children").read_text().split()}
    listed = subprocess.run(["ss", "-lnupH"], capture_output=True, text=True, check=True).stdout.splitlines()
    sockets = [line.split()[3] for line in listed if pids & set(re.findall(r"pid=(\d+)", line))]
    assert len(sockets) >= (10 if options else 2)
    outside = [address for address in sockets if not address.startswith("127.0.0.1:")]
    assert (outside == []) is loopback, sockets
    said = run.end()
    assert ("other hosts may join this run" in said) is not loopback
    reach = json.loads((run.out / "summary.json").read_text()).get("reach")
    assert reach == (None if loopback else "network")


@pytest.mark.graph
@pytest.mark.parametrize(
    ("variables", "answer"),
    [({}, "not found ['intruder']"), ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "answered True")],
    ids=["default", "subnet"],
)
def test_another_host_joins_only_where_it_is_asked_for(variables, answer, two_hosts, drive):  # noqa: F811
    """Breaks if another host finds the nodes of a default run, or a permitted second machine does not work."""
    here, there = two_hosts
    run = drive(host=here, **variables)
    foreign = environment(ROS_STATIC_PEERS=HOSTS[0], ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")
    limit = "20" if variables else "8"
    words = [*there, sys.executable, "-c", BRAKE, str(run.domain), limit]
    found = subprocess.run(words, env=foreign, capture_output=True, text=True, timeout=90)
    assert found.stdout.strip() == answer, found.stderr


@pytest.mark.graph
def test_a_default_program_of_this_machine_meets_a_default_run(drive, monkeypatch):
    """Fails if tools that use the default profile of Fast DDS no longer find the run on this machine."""
    from std_srvs.srv import SetBool

    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    run = drive()
    with ForeignNode(run.domain) as foreign:
        request = SetBool.Request(data=True)
        assert foreign.call(SetBool, "plant/pause", request, limit=20.0).success


@pytest.mark.parametrize(
    ("given", "range_", "profile", "opened"),
    [
        ({}, "SYSTEM_DEFAULT", "fastdds.xml", None),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, "SYSTEM_DEFAULT", "fastdds.xml", None),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "SUBNET", "fastdds_network.xml", "_RANGE=SUBNET"),
        ({"ROS_STATIC_PEERS": "127.0.0.1;::1"}, "LOCALHOST", "fastdds_network.xml", "ROS_STATIC_PEERS=127.0.0.1;::1"),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "own.xml"}, "LOCALHOST", "own.xml", "_FILE=own.xml"),
    ],
)
def test_the_middleware_follows_the_user(given, range_, profile, opened, monkeypatch, tmp_path):
    """A process started by a run gets the same settings."""
    monkeypatch.chdir(tmp_path)
    Path("own.xml").write_text("<profiles/>")
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    for _ in range(2):
        found = middleware()
        assert found["ROS_AUTOMATIC_DISCOVERY_RANGE"] == range_
        assert Path(found["FASTRTPS_DEFAULT_PROFILES_FILE"]).name == profile
        assert (opened_by() or "").endswith(opened or "")
        assert (opened_by() is None) is (opened is None)
        for name, value in found.items():
            monkeypatch.setenv(name, value)
