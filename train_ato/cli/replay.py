"""``train-ato replay``: publish a recorded run again, or try a law on its recorded inputs."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from train_ato.cli.main import RunFailed
from train_ato.cli.screen import console, print_json, table

if TYPE_CHECKING:
    from train_ato.replay.playback import ReplayState
    from train_ato.replay.publishing import Replayed

_PUBLISHING: tuple[tuple[str, str, object], ...] = (
    ("rate", "--rate", 1.0),
    ("start_offset", "--start-offset", 0.0),
    ("playback_duration", "--playback-duration", None),
    ("delay", "--delay", 0.0),
    ("loop", "--loop", False),
    ("start_paused", "--start-paused", False),
    ("clock", "--clock", None),
    ("topics", "--topics", []),
    ("exclude_topics", "--exclude-topics", []),
    ("remap", "--remap", []),
    ("wait_for_all_acked", "--wait-for-all-acked", None),
    ("disable_keyboard_controls", "--disable-keyboard-controls", False),
    ("domain", "--domain", None),
)
"""Options that have no meaning with a law: name, spelling, default."""


def _rate(text: str) -> float:
    try:
        return math.inf if text == "max" else float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: give a number above 0, 1 for real time, or max") from None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``replay``."""
    parser.epilog = (
        "While it publishes, node /rosbag2_player offers the services of `ros2 bag play` (pause, resume, "
        "toggle_paused, is_paused, get_rate, set_rate, play_next, burst, seek, play, stop): of rosbag2_interfaces if "
        "that is installed, else as std_srvs/srv/Trigger with the parameters rate, seek, burst, start_offset and "
        "playback_duration for what a request carries; see msgs_docs/replay.md. Keys: space pauses and resumes, right "
        "sends the next message of a pause, up and down change the rate by a tenth."
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder or MCAP file")
    _add_pace(parser)
    _add_choice(parser)
    law = parser.add_argument_group("another law on the recorded inputs (publishes nothing)")
    law.add_argument(
        "--controller",
        metavar="NAME",
        help="drive this law with the recorded inputs; an MCAP file alone must have the run's scenario attached",
    )
    law.add_argument("--set", action="append", default=[], metavar="A.B=V", help="change a key of the scenario")
    law.add_argument("--out", type=Path, metavar="FILE", help="figure: .png, .svg or .pdf (default: beside the log)")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def _add_pace(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-r",
        "--rate",
        type=_rate,
        default=1.0,
        metavar="R",
        help="simulated seconds per second (default: 1); max: as fast as the readers take it, in order",
    )
    parser.add_argument("--start-offset", type=float, default=0.0, metavar="S", help="begin so many seconds later")
    parser.add_argument("--playback-duration", type=float, metavar="S", help="end after so many seconds of the run")
    parser.add_argument(
        "-d", "--delay", type=float, default=0.0, metavar="S", help="wall time to wait first, in every loop"
    )
    parser.add_argument("-l", "--loop", action="store_true", help="begin again at the end, until Ctrl-C")
    parser.add_argument(
        "-p", "--start-paused", action="store_true", help="wait for the service resume; only what is latched is sent"
    )
    parser.add_argument(
        "--clock",
        type=float,
        nargs="?",
        const=40.0,
        metavar="HZ",
        help="publish /clock so often a second of wall time (without HZ: 40) instead of the recorded one",
    )
    parser.add_argument(
        "--wait-for-all-acked",
        type=int,
        metavar="MS",
        help="at the end wait so long for readers to confirm that they have everything; 0: no limit (default: 5000)",
    )


def _add_choice(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="only these topics")
    parser.add_argument("--exclude-topics", nargs="+", default=[], metavar="TOPIC", help="all but these topics")
    parser.add_argument(
        "-m", "--remap", nargs="+", default=[], metavar="A:=B", help="publish a topic under another name"
    )
    parser.add_argument("--disable-keyboard-controls", action="store_true", help="leave the keyboard alone")
    parser.add_argument("--domain", type=int, metavar="N", help="ROS domain (default: ROS_DOMAIN_ID or 0)")


def execute(options: argparse.Namespace) -> int:
    """Publish a run, or compare a law's commands with the recorded ones."""
    if options.controller is not None:
        for name, spelling, default in _PUBLISHING:
            if getattr(options, name) != default:
                raise ValueError(f"{spelling}: has no meaning with --controller, which publishes nothing; leave it out")
        from train_ato.cli.replay_law import compare

        return compare(options)
    for given, spelling in ((options.set, "--set"), (options.out, "--out")):
        if given:
            raise ValueError(f"{spelling}: belongs to a law on the recorded inputs, so it needs --controller NAME")
    return _publish(options)


def _publish(options: argparse.Namespace) -> int:
    from train_ato.replay.options import ReplayOptions, parse_remap

    _check_domain(options.domain)
    chosen = ReplayOptions(
        rate=options.rate,
        start_offset=options.start_offset,
        duration=options.playback_duration,
        delay=options.delay,
        loop=options.loop,
        start_paused=options.start_paused,
        clock_hz=options.clock,
        topics=tuple(options.topics),
        exclude=tuple(options.exclude_topics),
        remap=parse_remap(tuple(options.remap)),
        acknowledged_s=_acknowledged(options.wait_for_all_acked),
    )
    from train_ato.cli.keyboard import keyboard
    from train_ato.replay.player import middleware_profile
    from train_ato.replay.publishing import replay

    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(middleware_profile()))
    wanted = not options.disable_keyboard_controls
    with keyboard(wanted) as keys, _bar(options.run.name) as progress:
        done = replay(options.run, chosen, domain=options.domain, progress=progress, keys=keys)
    _report(options, done)
    return 0


def _check_domain(given: int | None) -> None:
    """Refuse a ROS domain that cannot be, from the option or from the environment."""
    if given is not None:
        if not 0 <= given <= 101:
            raise ValueError(f"--domain {given}: give a domain from 0 to 101")
        return
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not (text.isdecimal() and int(text) <= 232):
        raise ValueError(f"ROS_DOMAIN_ID {text}: no domain; set it to a number from 0 to 101, or give --domain")


def _acknowledged(milliseconds: int | None) -> float:
    if milliseconds is None:
        return 5.0
    return math.inf if milliseconds == 0 else milliseconds * 1e-3


@contextmanager
def _bar(title: str) -> Iterator[Callable[[ReplayState], None]]:
    """Show how far the replay is."""
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[state]}"))
    with Progress(*columns, console=console(), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(title, total=1.0, state="")

        def report(state: ReplayState) -> None:
            rate = "as fast as possible" if math.isinf(state.rate) else f"rate {state.rate:.3g}"
            text = f"{state.moment:.1f} of {state.length:.1f} s, {'paused' if state.paused else rate}"
            bar.update(task, completed=state.moment, total=max(state.length, 1e-9), state=text)

        yield report


def _report(options: argparse.Namespace, done: Replayed) -> None:
    if options.json:
        print_json(
            {
                "run": str(options.run),
                "published": done.counts,
                "end": done.end,
                "moment_s": round(done.moment, 9),
                "acknowledged": done.acknowledged,
            }
        )
    else:
        table(("topic", "messages"), sorted(done.counts.items()), f"published again from {options.run}")
    if done.end == "interrupted":
        if not options.loop:
            raise RunFailed(f"interrupted at {done.moment:.1f} s")
    elif not done.acknowledged:
        sys.stderr.write("train-ato: not every reader has confirmed that it has everything; --wait-for-all-acked MS\n")
