"""``train-ato replay``: publish a recorded run on its topics, or evaluate a law on its inputs.

Options::

    run RUN                      run folder or MCAP file
    -r, --rate R                 simulated seconds per second (default: 1); max: limited only by the subscribers
    --start-offset S             start at this simulated time
    --playback-duration S        simulated duration
    -d, --delay S                wall time before the start of every loop
    -l, --loop                   repeat until Ctrl-C
    -p, --start-paused           start in pause; only latched topics are sent before the service resume
    --clock HZ                   publish /clock at this rate of wall time (without HZ: 40) instead of the recorded one
    --wait-for-all-acked MS      maximum wait at the end for the acknowledgement of all messages; 0: no limit (default:
                                 5000)
    --topics TOPIC               publish only these topics
    --exclude-topics TOPIC       publish all other topics
    -m, --remap A:=B             publish a topic under another name
    --disable-keyboard-controls  do not read keys from the terminal
    --domain N                   ROS domain (default: ROS_DOMAIN_ID or 0)
    --law NAME                   law to evaluate; a single MCAP file needs the scenario as an attachment
    --set A.B=V                  change a key of the scenario; may be repeated
    --out FILE                   figure: .png, .svg or .pdf (default: beside the log)
"""

from __future__ import annotations

import argparse
import math
import os
import re
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from train_ato.cli.screen import print_json, print_table
from train_ato.program.arguments import Options, parse_rate

if TYPE_CHECKING:
    from train_ato.playback.playback import Playback, ReplayState
    from train_ato.playback.publishing import Replayed

RATE_STEP = 1.1
KEYS: dict[bytes, Callable[[Playback], None]] = {
    b" ": lambda playback: playback.toggle_paused(),
    b"\x1b[C": lambda playback: playback.play_next(),
    b"\x1b[A": lambda playback: playback.set_rate(playback.state.rate * RATE_STEP),
    b"\x1b[B": lambda playback: playback.set_rate(playback.state.rate / RATE_STEP),
}
"""Terminal codes of space and the arrows right, up and down."""


def pressed(text: bytes) -> Iterator[Callable[[Playback], None]]:
    """Yield the actions of the keys in terminal input; other keys are ignored."""
    while text:
        for key, action in KEYS.items():
            if text.startswith(key):
                yield action
                text = text[len(key) :]
                break
        else:
            text = text[1:]


@contextmanager
def keyboard(*, wanted: bool) -> Iterator[Callable[[Playback], None] | None]:
    """Read single keys from the terminal of this process; restore its settings on exit.

    Yields
    ------
    callable or None
        Function that performs the actions of the pressed keys; None without a terminal.
    """
    if not (wanted and sys.stdin and sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()):
        yield None
        return
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)

    def perform(playback: Playback) -> None:
        while select.select([terminal], [], [], 0)[0]:
            text = os.read(terminal, 64)
            if not text:
                return
            for action in pressed(text):
                with suppress(ValueError):  # play_next needs a pause
                    action(playback)

    try:
        yield perform
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


_LAW = {"group": "evaluation of a law on the recorded inputs (no publishing)"}
OPTIONS: Options = {
    "-r": {"type": parse_rate, "default": 1.0},
    "--start-offset": {"default": 0.0},
    "-d": {"default": 0.0},
    "--clock": {"nargs": "?", "const": 40.0},
    "--topics": {"nargs": "+", "default": []},
    "--exclude-topics": {"nargs": "+", "default": []},
    "-m": {"nargs": "+", "default": []},
    "--law": _LAW,
    "--set": {**_LAW, "action": "append"},
    "--out": _LAW,
}


def finish(parser: argparse.ArgumentParser) -> None:
    """Keep the options without effect with --law; add the services and keys below all options."""
    own = ("help", "run", "law", "set", "out")
    parser.set_defaults(publishing=[action for action in parser._actions if action.dest not in own])
    parser.epilog = (
        "During the replay the node /rosbag2_player has the services of `ros2 bag play`: pause, resume, "
        "toggle_paused, is_paused, get_rate, set_rate, play_next, burst, seek, play, stop. Their types are those of "
        "rosbag2_interfaces if it is installed, otherwise std_srvs/srv/Trigger with the parameters rate, seek, burst, "
        "start_offset and playback_duration; see msgs_docs/replay.md. Keys: space pauses and resumes, right sends the "
        "next message during a pause, up and down change the rate by 10 %."
    )


def execute(options: argparse.Namespace) -> None:
    """Publish a run, or compare the commands of a law with the recorded ones."""
    if options.law is not None:
        for action in options.publishing:
            if getattr(options, action.dest) != action.default:
                raise ValueError(
                    f"{action.option_strings[-1]}: no effect with --law, which does not publish; remove it"
                )
        compare_laws(options)
        return
    for given, spelling in ((options.set, "--set"), (options.out, "--out")):
        if given:
            raise ValueError(f"{spelling}: only for the evaluation of a law; add --law NAME")
    _publish(options)


def _publish(options: argparse.Namespace) -> None:
    from train_ato.playback.log import ReplayOptions, parse_remap

    acknowledged = options.wait_for_all_acked
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
        acknowledged_s=5.0 if acknowledged is None else acknowledged * 1e-3 or math.inf,
    )
    from train_ato.playback.publishing import REPLAY_PROFILE, publish_run
    from train_ato.ros.graph.environment import middleware

    os.environ.update(middleware(REPLAY_PROFILE))
    wanted = not options.disable_keyboard_controls
    with keyboard(wanted=wanted) as keys, _bar(options.run.name) as progress:
        done = publish_run(options.run, chosen, domain=options.domain, progress=progress, keys=keys)
    _report(options, done)


@contextmanager
def _bar(title: str) -> Iterator[Callable[[ReplayState], None]]:
    """Show a progress bar of the replay; yield its update function."""
    from train_ato.api.progress import share_bar

    with share_bar(title) as update:

        def report(state: ReplayState) -> None:
            rate = "as fast as possible" if math.isinf(state.rate) else f"rate {state.rate:.3g}"
            text = f"{state.moment:.1f} of {state.length:.1f} s, {'paused' if state.paused else rate}"
            update(state.moment / max(state.length, 1e-9), text)

        yield report


def _report(options: argparse.Namespace, done: Replayed) -> None:
    from train_ato.cli.main import RunFailed

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
        print_table(("topic", "messages"), sorted(done.counts.items()), f"published from {options.run}")
    if done.end == "interrupted":
        if not options.loop:
            raise RunFailed(f"interrupted at {done.moment:.1f} s")
    elif not done.acknowledged:
        sys.stderr.write("train-ato: not all messages are acknowledged; increase --wait-for-all-acked MS\n")


OUTPUT_ROWS: tuple[tuple[str, str], ...] = (
    ("force_max_kn", "force demand, largest in kN"),
    ("force_min_kn", "force demand, smallest in kN"),
    ("force_rms_kn", "force demand, rms in kN"),
    ("variation_kn_per_s", "variation in kN/s"),
)
DIFFERENCE_ROWS: tuple[tuple[str, str], ...] = (
    ("ticks", "ticks compared"), ("equal_ticks", "ticks with the same output"),
    ("difference_rms_kn", "difference, rms in kN"), ("difference_max_kn", "difference, largest in kN"),
    ("difference_max_at_s", "largest at s"), ("difference_mean_kn", "difference, mean in kN"),
    ("brake_pipe_difference_max_kpa", "brake pipe, largest difference in kPa"),
)  # fmt: skip


def compare_laws(options: argparse.Namespace) -> None:
    """Evaluate a law on the recorded inputs; the law of the run itself keeps its planned changes."""
    from train_ato.cli.scenario_options import check_component_name
    from train_ato.log.run_folder import read_run_folder
    from train_ato.playback.replaying import evaluated, output_names, setup_with_law

    check_component_name("--law", "law", options.law)
    recorded, recorded_summary = read_run_folder(options.run)
    changed = setup_with_law(recorded, options.run, options.law, lambda choice: choice.assigned(options.set))
    figure = _figure_path(options)
    result = evaluated(recorded, changed, options.run, recorded_summary, figure)
    summary = {
        "run": str(options.run),
        "recorded_controller": recorded_summary.get("controller", recorded.scenario.law),
        "controller": options.law,
        **result.summary(),
        "figure": str(figure),
    }
    if options.json:
        print_json(summary)
    else:
        print_table(
            ("output", *output_names(recorded, recorded_summary, options.law)),
            ((text, summary["recorded"][key], summary["replayed"][key]) for key, text in OUTPUT_ROWS),
            f"{summary['controller']} on the recorded inputs of {summary['run']}",
        )
        print_table(("quantity", "value"), ((text, summary[key]) for key, text in DIFFERENCE_ROWS if key in summary))
        sys.stdout.write(
            f"Open loop: these commands did not act on the recorded train.\nfigure in {summary['figure']}\n"
        )


def _figure_path(options: argparse.Namespace) -> Path:
    """Return the path of the figure; check it before the computation."""
    from train_ato.log.reading import log_file
    from train_ato.playback.replaying import FORMATS

    wanted: Path | None = options.out
    if wanted is not None:
        if wanted.suffix not in FORMATS:
            raise ValueError(f"--out {wanted}: unknown ending; use {', '.join(FORMATS)}")
        if wanted.exists():
            raise ValueError(f"--out {wanted}: exists already; give another name")
        if not wanted.parent.is_dir():
            raise ValueError(f"--out {wanted}: no folder {wanted.parent}; create it")
    else:
        log = log_file(options.run)
        name = re.sub(r"[^A-Za-z0-9_.-]+", "-", options.law)
        stem = "replay" if options.run.is_dir() else f"{log.stem}-replay"
        wanted = log.with_name(f"{stem}-{name}.png")
    if not os.access(wanted.parent, os.W_OK):
        raise ValueError(f"{wanted}: the folder is not writable; give another place with --out")
    return wanted
