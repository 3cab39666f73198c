"""Lock of a ROS domain: one per machine, also with another TMPDIR; no symbolic link is followed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import wait_for

import train_ato
from train_ato.ros.graph import domain_lock
from train_ato.ros.graph.domain_lock import DomainLock
from train_ato.ros.graph.environment import claim_domain, held_domains

CLAIM = """
import sys
from train_ato.ros.graph.environment import claim_domain
try:
    with claim_domain(int(sys.argv[1])):
        pass
except ValueError as error:
    sys.exit(str(error))
"""


def test_runs_with_another_tmpdir_find_the_lock(tmp_path: Path) -> None:
    """Breaks if the place of the lock depends on the environment: a second run ends the first one."""
    with claim_domain() as domain:
        environment = {
            **os.environ, "TMPDIR": str(tmp_path), "PYTHONPATH": str(Path(train_ato.__file__).resolve().parents[1])
        }  # fmt: skip
        done = subprocess.run(
            [sys.executable, "-c", CLAIM, str(domain)], env=environment, capture_output=True, text=True, check=False
        )
        assert f"--domain {domain}: another run holds it" in done.stderr
        assert domain in held_domains()
    assert not DomainLock(domain).path.exists()


def test_a_domain_is_locked_until_the_last_node_of_a_killed_run_has_ended(tmp_path: Path) -> None:
    """Breaks if the next run meets the nodes of a killed one, which end about two seconds after it."""
    with claim_domain() as domain:
        pass
    words = ["run", "demo", "--processes", "--rate=5", f"--domain={domain}", f"--out={tmp_path / 'run'}"]
    environment = {**os.environ, "PYTHONPATH": str(Path(train_ato.__file__).resolve().parents[1])}
    run = subprocess.Popen(
        [sys.executable, "-m", "train_ato", *words],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    partial = tmp_path / "run" / "run.mcap.partial"
    wait_for(lambda: run.poll() is not None or (partial.exists() and partial.stat().st_size > 0), "the log")
    nodes = children(run.pid)
    run.kill()
    run.wait()
    following = DomainLock(domain)
    free = following.acquire()
    assert len(nodes) == 6 and alive(nodes)
    assert not free, "the domain is free beside nodes of the killed run"
    wait_for(lambda: not alive(nodes), "the end of the nodes")
    wait_for(following.acquire, "the free domain")
    following.release()


def children(parent: int) -> list[int]:
    """Return the child processes."""
    text = Path(f"/proc/{parent}/task/{parent}/children").read_text(encoding="ascii")
    return [int(word) for word in text.split()]


def alive(processes: list[int]) -> bool:
    """Return True if a process has not ended."""
    found = [Path(f"/proc/{process}/stat") for process in processes]
    return any(path.exists() and path.read_text().rpartition(")")[2].split()[0] != "Z" for path in found)


@pytest.mark.parametrize("kind", ["link", "dangling link", "folder", "pipe"])
def test_a_lock_that_is_no_plain_file_is_neither_followed_nor_held(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Breaks if a link is followed, counts as a run, or the wait for a pipe has no end."""
    monkeypatch.setattr(domain_lock, "LOCK_FOLDER", tmp_path)
    target = tmp_path / "target"
    if kind == "link":
        target.write_text("kept")
    path = DomainLock(7).path
    {"folder": path.mkdir, "pipe": lambda: os.mkfifo(path)}.get(kind, lambda: path.symlink_to(target))()
    with pytest.raises(ValueError, match=r"train_ato-domain-7\.lock: is not a plain file; remove it"), claim_domain(7):
        pass
    assert held_domains() == []
    assert target.exists() == (kind == "link")
    if kind == "link":
        assert target.read_text() == "kept"


def test_the_file_of_a_killed_run_is_taken_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the file itself is the lock."""
    monkeypatch.setattr(domain_lock, "LOCK_FOLDER", tmp_path)
    DomainLock(7).path.write_text("")
    assert held_domains() == []
    with claim_domain(7) as domain:
        assert domain == 7
        assert not DomainLock(7).acquire()
        assert held_domains() == [7]
    assert list(tmp_path.iterdir()) == []
