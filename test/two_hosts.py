"""Two hosts of this machine: network namespaces joined by a link."""

import os
import subprocess
from collections.abc import Iterator

import pytest

HOSTS = ("10.77.0.1", "10.77.0.2")
PRIVATE = ("unshare", "--mount", "sh", "-c", "mount -t tmpfs none /dev/shm && echo made && exec sleep infinity")
"""Program with a shared memory of its own: nodes of one host use it, nodes of two hosts must not."""


@pytest.fixture
def two_hosts() -> Iterator[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Return the command prefixes of two hosts: network and shared memory of their own, joined by link ``cable``."""
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root")
    names = [f"ato{os.getpid()}{side}" for side in "ab"]
    steps = [["netns", "add", name] for name in names]
    ends = [["name", "cable", "netns", name] for name in names]
    steps.append(["link", "add", *ends[0], "type", "veth", "peer", *ends[1]])
    for name, address in zip(names, HOSTS, strict=True):
        steps += [
            ["-n", name, "address", "add", f"{address}/24", "dev", "cable"],
            ["-n", name, "link", "set", "cable", "up"],
            ["-n", name, "link", "set", "lo", "up"],
        ]
    hosts: list[subprocess.Popen[str]] = []
    try:
        for step in steps:
            done = subprocess.run(["ip", *step], capture_output=True, text=True)
            if done.returncode:
                pytest.skip(f"no network namespaces here: ip {' '.join(step)}: {done.stderr.strip()}")
        for name in names:
            host = ["ip", "netns", "exec", name, *PRIVATE]
            hosts.append(subprocess.Popen(host, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True))
            said = hosts[-1].stdout.readline().strip()
            if said != "made":
                pytest.skip(f"no mount namespaces here: {said}")
        yield tuple(("nsenter", f"--target={host.pid}", "--net", "--mount") for host in hosts)
    finally:
        for host in hosts:
            host.kill()
            host.communicate()
        for name in names:
            subprocess.run(["ip", "netns", "delete", name], capture_output=True)
