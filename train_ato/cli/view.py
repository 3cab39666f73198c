"""``train-ato view``: show a running, a new or a recorded run in the browser.

Options::

    run RUN            recorded run: run folder or log
    --scenario NAME    start this scenario and show its run
    --domain N         ROS domain of the run (default: ROS_DOMAIN_ID, or the only run)
    --namespace /NAME  namespace of the train, one of several: /t1
    -r, --rate R       simulated seconds per second of wall time, or max (default: 1)
    --processes        one process per node for the started run
    --law NAME         control law of the started run
    --set A.B=VALUE    change a key of the started scenario; may be repeated
    --out DIR          folder of the started run
    --port N           port of the page (default: 5010; 0: a free one)
    --address A        address of the server (default: 127.0.0.1, this machine only)
    --no-browser       print the address of the page, do not open a browser
    --foxglove PORT    additional Foxglove WebSocket server (default port: 8765)
"""

from __future__ import annotations

import argparse
import contextlib
import math
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from train_ato.cli.screen import print_result
from train_ato.program.arguments import BAD_INPUT, Options, parse_rate
from train_ato.program.errors import RunFailed, check_packages
from train_ato.program.interrupt import Interrupt, interruptible
from train_ato.ros.graph.wait_note import WaitNote

if TYPE_CHECKING:
    from train_ato.view.feed import Feed

ENDING_S = 120.0
"""Maximum wall time for a run to close its log; then it is killed [s]."""
COMPLAINT = "train-ato"
"""First word of an error line."""

OPTIONS: Options = {
    "run": {"one_of": "what", "nargs": "?"},
    "--scenario": {"one_of": "what"},
    "--domain": {"one_of": "what"},
    "--namespace": {"default": ""},
    "-r": {"type": parse_rate},
    "--set": {"action": "append"},
    "--port": {"default": 5010},
    "--address": {"default": "127.0.0.1"},
    "--foxglove": {"nargs": "?", "const": 8765},
}


def execute(options: argparse.Namespace) -> None:
    """Serve the page until Ctrl-C; a run that is started again has the same address."""
    check_packages("view", "bokeh", "jinja2", "tornado", *(["foxglove"] if options.foxglove is not None else []))
    _check(options)
    with interruptible() as interrupt:
        from train_ato.log.run_folder import next_beside

        first = True
        while _serve(options, interrupt, first=first):
            first = False
            options.out = None if options.out is None else next_beside(options.out)


def _serve(options: argparse.Namespace, interrupt: Interrupt, *, first: bool) -> bool:
    """Serve one run; return True if a page has started it again."""
    import webbrowser

    from train_ato.api.progress import console

    with contextlib.ExitStack() as stack:
        feed = stack.enter_context(_feed(options, interrupt))
        from train_ato.view.origin_gate import LOCAL_NAMES
        from train_ato.view.server import PageServer

        server = PageServer(feed, options.address, options.port)
        options.port = server.port
        foxglove = None
        if options.foxglove is not None:
            from train_ato.view.foxglove import FoxgloveServer

            foxglove = stack.enter_context(contextlib.closing(FoxgloveServer(feed, options.foxglove)))
        if first:
            if options.address not in LOCAL_NAMES:
                able = "act on the train" if feed.live else "read the run"
                text = f"every host that reaches the page can {able}, no password"
                sys.stderr.write(f"train-ato: --address {options.address}: {text}\n")
            addresses = {"page": server.url} | ({} if foxglove is None else {"foxglove": foxglove.url})
            print_result(addresses, "".join(f"{url}\n" for url in addresses.values()), as_json=options.json)
            sys.stdout.flush()
            if sys.stderr.isatty():
                console().print("Press Ctrl-C to end.")
            if not options.no_browser:
                webbrowser.open(server.url)
        server.run(lambda: interrupt.asked or feed.again)
        return feed.again and not interrupt.asked


def _check(options: argparse.Namespace) -> None:
    """Check the options before anything starts."""
    from train_ato.ros.graph.environment import check_domain

    for name, port in (("--port", options.port), ("--foxglove", options.foxglove)):
        if port is not None and not 0 <= port <= 65_535:
            raise ValueError(f"{name} {port}: out of range; give 1 to 65535, or 0 for a free port")
    if options.scenario is None:
        given = {"--law": options.law, "--set": options.set, "--out": options.out, "--rate": options.rate}
        for name, value in {**given, "--processes": options.processes}.items():
            if value:
                raise ValueError(f"{name}: only for a started run; add --scenario")
    else:
        from train_ato.scenario.scenario import load_scenario

        changes = {} if options.law is None else {"law": options.law}
        load_scenario(options.scenario, tuple(options.set), changes)
        if options.namespace:
            raise ValueError(f"--namespace {options.namespace}: the started run has one train; remove it")
    options.rate = options.rate or 1.0
    check_domain(options.domain)


def _waiting(check: Callable[[], None], interrupt: Interrupt) -> Callable[[str], None]:
    """Return the function of a wait for a part: it raises the failure of ``check`` and Ctrl-C, and notes the part."""
    note = WaitNote()

    def wait(awaited: str) -> None:
        check()
        if interrupt.asked:
            raise KeyboardInterrupt
        note(awaited)

    return wait


@contextlib.contextmanager
def _feed(options: argparse.Namespace, interrupt: Interrupt) -> Iterator[Feed]:
    """Yield the data source of the page."""
    from train_ato.ros.graph.environment import applied, variables

    if options.run is not None:
        from train_ato.view.recorded import RecordedFeed

        yield RecordedFeed(options.run, options.namespace)
        return
    with (
        _run(options, interrupt) as (domain, wait),
        # the middleware may still write its log into the folder
        tempfile.TemporaryDirectory(prefix="train_ato_view_", ignore_cleanup_errors=True) as scratch,
        applied(variables(domain, Path(scratch))),
    ):
        from train_ato.view.live import LiveFeed

        feed = LiveFeed(domain, wait, options.rate if _waits(options) else None, options.namespace)
        try:
            yield feed
        finally:
            feed.close()


@contextlib.contextmanager
def _run(options: argparse.Namespace, interrupt: Interrupt) -> Iterator[tuple[int, Callable[[str], None]]]:
    """Yield the ROS domain of the run: of a running simulation, or of a run started here and ended with the page."""
    from train_ato.ros.graph.environment import claim_domain, held_domains
    from train_ato.ros.graph.remote import resolve_domain

    if options.scenario is None:
        domain = resolve_domain(options.domain, options.namespace)
        here = domain in held_domains(options.namespace)  # not that of another host
        yield domain, _waiting(lambda: _check_held(domain, options.namespace) if here else None, interrupt)
        return
    with claim_domain() as domain:
        pass
    run = _Started(_command(options, domain))
    wait = _waiting(run.check, interrupt)
    try:
        while domain not in held_domains():
            wait("the run to load its scenario and the kernels of the train")
            time.sleep(0.1)
        yield domain, wait
    finally:
        run.end()


def _check_held(domain: int, namespace: str) -> None:
    """Check that a run still has the domain."""
    from train_ato.ros.graph.environment import held_domains

    if domain not in held_domains(namespace):
        raise ValueError(f"--domain {domain}: the run has ended; give the domain of a running simulation")


def _waits(options: argparse.Namespace) -> bool:
    """Return True if the started run waits for its first page; a run for Foxglove, which may have none, does not."""
    return options.scenario is not None and options.foxglove is None


def _command(options: argparse.Namespace, domain: int) -> list[str]:
    command = [sys.executable, "-m", "train_ato", "run", options.scenario, "--domain", str(domain)]
    command += ["--start-limit", "none"]
    if _waits(options):
        from train_ato.view.live import WAITING_RATE

        command += ["--rate", repr(WAITING_RATE)]
    else:
        command += ["--rate", repr(options.rate)] if options.rate < math.inf else []
    command += ["--processes"] if options.processes else []
    command += ["--law", options.law] if options.law else []
    command += ["--out", str(options.out)] if options.out else []
    for assignment in options.set:
        command += ["--set", assignment]
    return command


class _Started:
    """A run in a separate process; its output is forwarded, its error line is stored."""

    def __init__(self, command: list[str]) -> None:
        # A separate session: Ctrl-C reaches only this process, which then ends the run.
        self._process = subprocess.Popen(
            command, stdout=sys.stderr, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        self._complaint = ""
        self._reader = threading.Thread(target=self._read, name="messages of the run", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if line.startswith(COMPLAINT):
                if self._complaint:  # it was a note, not the reason of the end
                    sys.stderr.write(f"{COMPLAINT}: {self._complaint}\n")
                self._complaint = line.partition(": ")[2].strip()
            else:
                sys.stderr.write(line)

    def check(self) -> None:
        """Raise the error of the run if it has ended."""
        if self._process.poll() is None:
            return
        self._reader.join()
        if self._process.returncode == BAD_INPUT:
            raise ValueError(self._complaint)
        if self._process.returncode == 0:
            raise RunFailed("the run ended before the page was ready; show its record with `train-ato view RUN`")
        raise RunFailed(self._complaint or "the run ended before its start was complete")

    def end(self) -> None:
        """Interrupt the run and wait until its log is closed."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(timeout=ENDING_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._reader.join()
        if self._process.stderr is not None:
            self._process.stderr.close()
