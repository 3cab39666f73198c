"""``train-ato view``: a page to look at: a run that is going on, one that it starts, or a recorded one."""

from __future__ import annotations

import argparse
import contextlib
import signal
import subprocess
import sys
import tempfile
import time
import webbrowser
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from train_ato.cli.screen import console
from train_ato.failure import RunFailed
from train_ato.graph.environment import applied, check_domain, claim_domain, held_domains, variables
from train_ato.graph.remote import the_running_domain
from train_ato.interrupt import interruptible

if TYPE_CHECKING:
    from train_ato.view.feed import Feed

STARTING_S = 90.0
ENDING_S = 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``view``."""
    what = parser.add_mutually_exclusive_group()
    what.add_argument("run", nargs="?", type=Path, metavar="RUN", help="a recorded run: its folder or its log")
    what.add_argument("--scenario", metavar="NAME", help="start this scenario and look at it")
    what.add_argument(
        "--domain", type=int, metavar="N", help="ROS domain of a run that goes on (default: the only one)"
    )
    parser.add_argument(
        "--pace", type=float, default=1.0, metavar="F", help="of the started run (default 1; 0: as fast as it goes)"
    )
    parser.add_argument("--processes", action="store_true", help="start one process for each node")
    parser.add_argument("--controller", metavar="NAME", help="control law of the started run")
    parser.add_argument(
        "--set", action="append", default=[], metavar="A.B=VALUE", help="change a key of the started scenario"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the started run")
    parser.add_argument("--port", type=int, default=5010, metavar="N", help="of the page (default 5010; 0: a free one)")
    parser.add_argument("--address", default="127.0.0.1", metavar="A", help="to listen at (default: this machine only)")
    parser.add_argument("--no-browser", action="store_true", help="only print the address of the page")
    parser.add_argument(
        "--foxglove",
        nargs="?",
        const=8765,
        type=int,
        metavar="PORT",
        help="serve a Foxglove WebSocket too (default 8765)",
    )


def execute(options: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    _check(options)
    with contextlib.ExitStack() as stack:
        interrupt = stack.enter_context(interruptible())
        feed = stack.enter_context(_feed(options))
        from train_ato.view.server import PageServer

        server = PageServer(feed, options.address, options.port)
        foxglove = None
        if options.foxglove is not None:
            from train_ato.view.foxglove import serve_foxglove

            foxglove = stack.enter_context(serve_foxglove(feed, options.foxglove))
        sys.stdout.write(f"{server.url}\n")
        if foxglove is not None:
            sys.stdout.write(f"{foxglove.url}\n")
        sys.stdout.flush()
        if sys.stderr.isatty():
            console().print("Ctrl-C ends it.")
        if not options.no_browser:
            webbrowser.open(server.url)
        server.run(lambda: interrupt.asked)
    return 0


def _check(options: argparse.Namespace) -> None:
    """Refuse what cannot be meant, before anything starts."""
    if not 0 <= options.port <= 65_535:
        raise ValueError(f"--port {options.port}: give 1 to 65535, or 0 for a free one")
    if not 0 <= options.pace < float("inf"):
        raise ValueError(f"--pace {options.pace}: give a positive number, 1 for real time; 0 is as fast as it goes")
    if options.scenario is None:
        given = {"--controller": options.controller, "--set": options.set, "--out": options.out}
        for name, value in {**given, "--processes": options.processes}.items():
            if value:
                raise ValueError(f"{name}: only for a run that is started here; name it with --scenario")
    check_domain(options.domain)


@contextlib.contextmanager
def _feed(options: argparse.Namespace) -> Iterator[Feed]:
    """Give what is to be shown."""
    if options.run is not None:
        from train_ato.view.recorded import RecordedFeed

        yield RecordedFeed(options.run)
        return
    with (
        _run(options) as domain,
        tempfile.TemporaryDirectory(prefix="train_ato_view_") as scratch,
        applied(variables(domain, Path(scratch))),
    ):
        from train_ato.view.live import LiveFeed

        feed = LiveFeed(domain)
        try:
            yield feed
        finally:
            feed.close()


@contextlib.contextmanager
def _run(options: argparse.Namespace) -> Iterator[int]:
    """Give the domain of the run: one that goes on, or of one that is started here and ended with the page."""
    if options.scenario is None:
        yield the_running_domain(options.domain)
        return
    with claim_domain() as domain:
        pass
    command = [sys.executable, "-m", "train_ato", "run", options.scenario, "--domain", str(domain)]
    command += ["--pace", repr(options.pace)] if options.pace else []
    command += ["--processes"] if options.processes else []
    command += ["--controller", options.controller] if options.controller else []
    command += ["--out", str(options.out)] if options.out else []
    for assignment in options.set:
        command += ["--set", assignment]
    # A session of its own: Ctrl-C reaches this process, which ends the run when the page is gone.
    run = subprocess.Popen(command, stdout=sys.stderr, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        _wait_for(run, domain)
        yield domain
    finally:
        if run.poll() is None:
            run.send_signal(signal.SIGINT)
        try:
            run.communicate(timeout=ENDING_S)
        except subprocess.TimeoutExpired:
            run.kill()
            run.communicate()


def _wait_for(run: subprocess.Popen[str], domain: int) -> None:
    """Wait until the run holds its domain; what it complains of is passed on."""
    last = time.monotonic() + STARTING_S
    while domain not in held_domains():
        if run.poll() is not None:
            assert run.stderr is not None
            text = run.stderr.read().strip().removeprefix("train-ato: ")
            if run.returncode == 2:
                raise ValueError(text)
            raise RunFailed(text or "the run ended before it could be looked at")
        if time.monotonic() > last:
            raise RunFailed(f"the run did not start within {STARTING_S:g} s")
        time.sleep(0.1)
