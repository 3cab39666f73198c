"""Domain of a run: lock in the scope of the network, and the environment."""

import os
import sys
from pathlib import Path
from typing import Any

import pytest
from programs import python
from waiting import wait_for

from train_ato.cli import main
from train_ato.messages.topic import Role
from train_ato.ros.graph import environment
from train_ato.ros.graph.domain_lock import TRAINS, DomainLock
from train_ato.ros.graph.environment import (
    check_domain,
    claim_domain,
    domain_of_environment,
    held_domains,
    middleware,
    print_domain,
)
from train_ato.ros.graph.node_process import NodeProcess
from train_ato.ros.graph.remote import resolve_domain

CLAIM = """
import sys
from train_ato.ros.graph.environment import claim_domain
try:
    with claim_domain(int(sys.argv[1])):
        pass
except ValueError as error:
    sys.exit(str(error))
"""


def test_a_private_run_keeps_out_of_the_domains_of_namespaces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a run without a domain meets the nodes of trains that share one."""
    with claim_domain(namespace="/a") as domain:
        monkeypatch.setattr(environment, "DOMAINS", range(domain, domain + 1))
        with pytest.raises(ValueError, match="are held by other runs; end one of them"), claim_domain():
            pass
        with claim_domain(domain, namespace="/b"):
            pass


def test_of_several_runs_the_one_of_the_environment_is_meant(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a command in a shell with ROS_DOMAIN_ID does not reach the run of this domain."""
    with claim_domain() as domain, claim_domain() as another:
        for own in (domain, another):
            monkeypatch.setenv("ROS_DOMAIN_ID", str(own))
            assert resolve_domain(None) == own
        assert resolve_domain(domain) == domain
        free = next(number for number in range(102) if number not in held_domains())
        monkeypatch.setenv("ROS_DOMAIN_ID", str(free))
        with pytest.raises(
            ValueError, match=f"ROS_DOMAIN_ID {free}: no run .*holds it; .*; give --domain N, or unset it"
        ):
            resolve_domain(None)  # never another run than that of the variable
        with monkeypatch.context() as network:
            network.setenv("ROS_STATIC_PEERS", "127.0.0.1")  # its lock is on the other host
            assert resolve_domain(None) == free
        monkeypatch.delenv("ROS_DOMAIN_ID")
        with pytest.raises(ValueError, match="several runs are in progress"):
            resolve_domain(None)


def test_a_train_of_a_namespace_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if no command reaches a train in a namespace, or if the refusal does not say how to."""
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    first, second, absent = (f"/{name}_{os.getpid()}" for name in ("a", "b", "c"))
    with claim_domain(namespace=first) as domain, claim_domain(domain, namespace=second):
        for space in (first, second):
            assert resolve_domain(None, space) == resolve_domain(domain, space) == domain
        there = f"running: .*{domain} --namespace {first}, {domain} --namespace {second}"
        with pytest.raises(ValueError, match=f"--domain {domain}: no run without a namespace holds it; {there}"):
            resolve_domain(domain)
        with pytest.raises(ValueError, match=f"no run of the namespace {absent} is in progress .*{there[8:]}"):
            resolve_domain(None, absent)
    with claim_domain() as domain, claim_domain(domain, namespace=TRAINS), claim_domain(domain, namespace=first):
        shown = f"no run without a namespace holds it; running: (.*, )?{domain} --namespace {first}"
        with pytest.raises(ValueError, match=shown) as said:
            resolve_domain(domain)
        assert f" {domain}," not in str(said.value)
    with pytest.raises(ValueError, match="--namespace t1: give a name such as /t1"):
        resolve_domain(None, "t1")


def test_a_domain_is_locked_until_the_process_of_a_node_has_ended(tmp_path: Path, monkeypatch: Any) -> None:
    """Breaks if the process of a node does not inherit the lock, or the lock does not end with it."""
    (program := tmp_path / "node").write_text("#!/bin/sh\nexec cat\n")  # to the end of its standard input
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    with claim_domain() as domain:
        node = NodeProcess(Role.PLANT, [], domain, tmp_path)
    following = DomainLock(domain)
    assert not following.acquire()
    assert node.process.stdin is not None
    node.process.stdin.close()
    assert node.process.wait() == 0
    wait_for(following.acquire, "the free domain")
    following.release()


def test_the_lock_has_the_scope_of_the_network(tmp_path: Path) -> None:
    """Breaks if containers of one network take one domain, or the place of the lock depends on the environment."""
    with claim_domain() as domain:
        with pytest.raises(ValueError, match=f"--domain {domain}: another run holds it"), claim_domain(domain):
            pass
        names = Path("/proc/net/unix").read_text(encoding="ascii", errors="replace")
        assert f"@{DomainLock(domain).name}\n" in names
    assert domain not in held_domains()
    with claim_domain() as domain:
        done = python("-c", CLAIM, str(domain), TMPDIR=str(tmp_path))
        assert f"--domain {domain}: another run holds it" in done.stderr
        assert domain in held_domains()
    assert domain not in held_domains()


@pytest.mark.parametrize("text", ["0", "101", "232"])
def test_every_valid_domain_of_the_environment_is_taken(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the domain of every other ROS program, or a high one, is refused or ignored."""
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    assert domain_of_environment() == int(text)
    check_domain(None)
    check_domain(int(text))


@pytest.mark.parametrize("text", ["233", "300", "abc", "-1", "1.5"])
def test_a_wrong_domain_of_the_environment_is_refused(text, monkeypatch, capsys):
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    assert main(["run", "demo", "--json"]) == 2
    assert (
        capsys.readouterr().err
        == f"train-ato: ROS_DOMAIN_ID {text}: not a ROS domain; set it to 0 to 232, or unset it\n"
    )


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "/proc/none.xml", "no such file"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "cut.xml", "no XML"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "empty.xml", "no XML"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "other.xml", "<package> in place of <dds> or <profiles>"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNETT", "unknown"),
        ("ROS_STATIC_PEERS", "127.0.0.1;a host;", "host 'a host' is not found"),
    ],
)
def test_a_variable_without_effect_is_refused(name, value, says, monkeypatch, tmp_path):
    """Breaks if a profile without effect opens the run to the network, or a misspelt range is taken as not set."""
    monkeypatch.chdir(tmp_path)
    Path("cut.xml").write_text("<profiles")
    Path("empty.xml").touch()
    Path("other.xml").write_text("<package/>")
    monkeypatch.setenv(name, value)
    with pytest.raises(ValueError, match=f"{name}={value}: {says}"):
        middleware()


def test_the_start_of_a_program_names_its_namespace(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the line for a program in place of a node leads it to the topics of another train, or of none."""
    print_domain(7, "controller", "/t1")
    start = "start the program in place of controller with ROS_DOMAIN_ID=7 and --ros-args -r __ns:=/t1"
    assert capsys.readouterr().err == f"ROS domain 7; {start}\n"
