"""Requests of other processes to a running graph, by the commands of the program, at chosen ticks."""

import os
import subprocess
import sys
from pathlib import Path

from waiting import LIMIT_S, LOOK_S, wait_for

ROOT = Path(__file__).resolve().parents[1]


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


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    return started(*arguments, run=subprocess.run, capture_output=True, timeout=LIMIT_S)


def started(*arguments: str, run=subprocess.Popen, **options):
    words = [sys.executable, "-m", "train_ato", *arguments]
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'test'}"}
    return run(words, text=True, cwd=ROOT, env=environment, **options)
