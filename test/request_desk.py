"""Requests of other processes to a running graph, by the commands of the program, at chosen ticks."""

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from programs import begun, python
from waiting import LIMIT_S, LOOK_S, reserved_domain, wait_for


class Desk:
    """Another process sends requests; this one pauses and resumes the train meanwhile."""

    def __init__(self, domain: int) -> None:
        from rclpy.node import Node
        from std_srvs.srv import SetBool, Trigger

        from train_ato.ros.graph.assembly import executor_of

        self.domain = domain
        self._stack = executor_of(domain)
        context, self.executor = self._stack.__enter__()
        self.node = Node("desk", context=context, enable_rosout=False)
        self.executor.add_node(self.node)
        self._pause = self.node.create_client(SetBool, "plant/pause")
        self._step = self.node.create_client(Trigger, "plant/step")
        self._requests = {self._pause: SetBool.Request, self._step: Trigger.Request}

    def close(self) -> None:
        self._stack.__exit__(None, None, None)

    def until(self, condition) -> None:
        wait_for(condition, turn=lambda: self.executor.spin_once(timeout_sec=LOOK_S))

    def _ask(self, client, **values):
        self.until(client.service_is_ready)
        future = client.call_async(self._requests[client](**values))
        self.until(future.done)
        return future.result().success

    def pause(self, on: bool) -> None:
        assert self._ask(self._pause, data=on)

    def steps(self, count: int) -> None:
        for _ in range(count):
            # A step is rejected during the previous tick.
            self.until(lambda: self._ask(self._step))

    def set(self, assignment: str) -> subprocess.CompletedProcess[str]:
        return command("param", assignment, f"--domain={self.domain}")

    def inject(self, action: str) -> subprocess.CompletedProcess[str]:
        return command("inject", action, f"--domain={self.domain}")


@contextmanager
def beside_a_run(out: Path, monkeypatch: pytest.MonkeyPatch, *options: str) -> Iterator[tuple[Desk, dict[str, Any]]]:
    """Yield a desk beside a paused run, and its summary, which is filled at its end; then verify the run."""
    from train_ato.ros.graph.environment import middleware
    from train_ato.ros.graph.remote import graph_client

    for name, value in middleware().items():
        monkeypatch.setenv(name, value)
    domain = reserved_domain()
    words = ["run", "demo", "--rate=1", "--json", f"--domain={domain}", f"--out={out}", *options]
    process = begun(*words)
    desk, summary = Desk(domain), {}
    try:
        desk.pause(True)
        yield desk, summary
        with graph_client(domain) as remote:
            assert remote.set_parameter("plant", "rate", 0.0) is None
        desk.pause(False)
    finally:
        desk.close()
    text, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, err
    summary.update(json.loads(text))
    for name in (out, out / "run.mcap"):
        verified = command("verify", str(name), "--json")
        assert verified.returncode == 0, verified.stderr
        assert json.loads(verified.stdout)["equal"] is True


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    return python("-m", "train_ato", *arguments)
