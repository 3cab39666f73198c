"""Entry point of the command line: parses, calls one command, turns errors into one line and an exit status."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any

from train_ato.arguments import BAD_INPUT, OneLineParser
from train_ato.failure import RunFailed
from train_ato.interrupt import Interrupt, ending_like_ctrl_c
from train_ato.version import VERSION

__all__ = ["RunFailed", "main"]

COMMANDS: tuple[tuple[str, str], ...] = (
    ("run", "drive a scenario and record it"),
    ("compare", "drive a scenario with several laws: one table, one figure, one page"),
    ("reproduce", "the papers' claims beside what is measured here"),
    ("list", "scenarios, laws, observers, compensations, consists and lines"),
    ("replay", "publish a recorded run again, or try a law on its inputs"),
    ("info", "what a run or a log holds: topics, rates, gaps, changes"),
    ("report", "a run, or several side by side, as one page of figures that works without a network"),
    ("check-law", "the contract tests on a law of your own"),
    ("export", "the tables of a run as Parquet or CSV"),
    ("import", "a recorded speed and force history as a run and a profile"),
    ("recover", "make a readable log of one that was cut or damaged"),
    ("set", "change a parameter of a running controller, for example swap its law"),
    ("do", "act on a running train: gust, delay jump, emergency brake, pause, step"),
    ("view", "a page to look at: a run that goes on, one that it starts, or a recorded one"),
    ("verify", "run a recorded scenario again and compare every message"),
    ("plan", "the driving profile alone"),
    ("drive", "a profile driven by a smooth driver on the flexible train"),
)
MODULES: dict[str, str] = {"import": "import_run"}
"""Modules of the commands that cannot be called like them: ``import`` is a word of Python's own."""
DONE, FAILED = 0, 1


class _Command(OneLineParser):
    """One command; its module is imported when the command is the one asked for, so that help stays fast."""

    module = ""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Declare the options, then parse."""
        if self.get_default("execute") is None:
            module = importlib.import_module(self.module)
            module.add_arguments(self)
            self.set_defaults(execute=module.execute)
        return super().parse_known_args(args, namespace)


def _parser() -> argparse.ArgumentParser:
    parser = OneLineParser(
        prog="train-ato", description="Onboard automatic train operation on ROS 2, with the train it drives."
    )
    parser.add_argument("--version", action="version", version=f"train-ato {VERSION}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Command)
    for name, summary in COMMANDS:
        command = commands.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        command.module = f"train_ato.cli.{MODULES.get(name, name.replace('-', '_'))}"
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status."""
    interrupt = Interrupt()
    try:
        with ending_like_ctrl_c(interrupt):
            options = _parser().parse_args(arguments)
            return int(options.execute(options) or DONE)
    except KeyboardInterrupt:
        return _complain("interrupted", FAILED)
    except RunFailed as error:
        return _complain(error, FAILED)
    except Exception as error:
        if interrupt.asked:  # compilers and validators make errors of their own of it
            return _complain("interrupted", FAILED)
        return _failed(error)


def _failed(error: Exception) -> int:
    """Tell of an error in one line; one that is a mistake of ours goes on as it is."""
    if isinstance(error, ValueError):
        return _complain(error, BAD_INPUT)
    if isinstance(error, BrokenPipeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # who read has left: `train-ato list | head`
        return FAILED
    if isinstance(error, OSError):
        return _complain(error, FAILED)
    raise error


def _complain(error: object, status: int) -> int:
    if os.environ.get("TRAIN_ATO_DEBUG") and isinstance(error, Exception):
        raise error
    text = " ".join(str(error).split())
    if isinstance(error, OSError) and error.filename is not None:
        text = f"{error.filename}: {error.strerror}"
    sys.stderr.write(f"train-ato: {text}\n")
    return status


if __name__ == "__main__":
    sys.exit(main())
