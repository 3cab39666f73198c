"""Entry point of the command line: parser, one command, errors as one line and an exit status."""

import argparse
import errno
import gc
import importlib
import os
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

from plant_sim.input_error import InputFaults
from train_ato.program.arguments import (
    BAD_INPUT,
    OneLineParser,
    add_option,
    declare_options,
    prepare_streams,
    shortened,
)
from train_ato.program.display_units import displayed_in
from train_ato.program.errors import RunFailed, unloaded_package
from train_ato.program.interrupt import Interrupt, ProcessExit, ending_like_ctrl_c, no_silent_exit, text_of_exit
from train_ato.program.version import VERSION

__all__ = ["RunFailed", "main"]

COMMANDS: tuple[tuple[str, str], ...] = (
    ("run", "run a scenario and record it"),
    ("compare", "run a scenario with several control laws; write a table, a figure and a page"),
    ("sweep", "run a scenario at many points of a design; write a table and figures"),
    ("falsify", "search the smallest change of a scenario that breaks a requirement"),
    ("tune", "search for the gains of a control law over several scenarios and seeds; write them as a scenario"),
    ("learn", "repeat a scenario, or read recorded runs, and learn the resistance that repeats by place"),
    ("reproduce", "check the claims of the papers against simulated runs"),
    ("list", "list scenarios, laws, observers, compensations, trains and lines"),
    ("new", "write a commented train, line, journey, scenario, law, observer or compensation of one's own"),
    ("docs", "open the documentation with all keys, commands and messages in a browser, without a network"),
    ("replay", "publish a recorded run on its topics, or evaluate a law on its inputs"),
    ("info", "print topics, rates, gaps and changes of a run or a log"),
    ("report", "write an HTML page with the figures of a run, or of several runs for comparison"),
    ("check-law", "test a control law against the interface of the control loop"),
    ("check-observer", "test a disturbance observer against the interface of the control loop"),
    ("check-compensation", "test a delay compensation against the interface of the control loop"),
    ("export", "write the tables of a run as Parquet or CSV"),
    ("scene", "publish the train on its line for 3D viewers, beside a running simulation or a replay"),
    ("layout", "write a layout of Foxglove or PlotJuggler for a run"),
    ("import", "convert a measured speed and force history to a run and a speed profile"),
    ("recover", "restore a readable log from an incomplete or damaged one"),
    ("param", "change a parameter of a running simulation, for example the control law"),
    ("params", "print the parameters of the nodes of a scenario as a ROS 2 parameter file"),
    ("inject", "apply a gust, a delay change, the emergency brake or an ATO request to a running simulation; pause it"),
    ("view", "show a running, a new or a recorded run in the browser"),
    ("verify", "repeat a recorded run and compare every message"),
    ("plan", "compute a speed profile from a line and a train"),
    ("convert", "write a line or a train of another format in the own one, or a line as TTOBench JSON"),
    ("curves", "compute the braking curves and supervision limits of ETCS for cases, or for a train on a line"),
    ("driver", "simulate a driver on a multi-mass train and write the run as a speed profile"),
    ("completion", "print the code that completes commands, options and names in a shell"),
)
MODULES: dict[str, str] = {
    "import": "import_run", "check-law": "check", "check-observer": "check", "check-compensation": "check",
}  # fmt: skip
"""Modules with another name than their command: ``import`` is a keyword of Python."""
WITHOUT_JSON = ("train_ato.cli.completion",)
"""Modules of the commands without data: a shell reads the result."""
WITH_UNITS = ("run", "compare", "info", "plan", "report", "export", "list", "import", "driver", "replay", "sweep",
              "curves", "tune")  # fmt: skip
"""Commands with ``--units``."""
DONE, FAILED = 0, 1
LEFT_S = 2.0
"""Wall time after a command in which its threads can end [s]; pools of workers end at once."""
COLLECTED = 20_000, 10, 10
"""New objects after which a command looks for garbage.  Most are modules and classes, which live until its end; after
Python's 700 the looks take a tenth of the processor time of ``compare``."""


class _Command(OneLineParser):
    """Parser of one command; imports the module of the command on use, so that help is fast."""

    module = ""

    def declare(self) -> None:
        """Declare the options, once."""
        if self.get_default("execute") is None:
            module = importlib.import_module(self.module)
            declare_options(self, module)
            if hasattr(module, "finish"):
                module.finish(self)
            if self.module not in WITHOUT_JSON:
                add_option(self, "--json", "print one JSON value and nothing else")
            if self.prog.rpartition(" ")[2] in WITH_UNITS:
                add_option(
                    self,
                    "--units",
                    "units of the output: us (mph, mi, ft, ton, lbf, psi) or metric (km/h, t, kN, bar). The files "
                    "of a run do not change (default: the unit in the name of each value)",
                    choices=("us", "metric"),
                )
            self.set_defaults(execute=module.execute)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Declare the options, then parse; an unknown argument is refused with the help of this command."""
        self.declare()
        known, unknown = super().parse_known_args(args, namespace)
        self.refuse_unknown(unknown)
        return known, unknown


def command_line(only: str | None = None) -> OneLineParser:
    """Return the parser of the program, with a parser for each command or, within 1 ms, for one command."""
    parser = OneLineParser(
        prog="train-ato", description="Onboard automatic train operation (ATO) on ROS 2, with a simulated train."
    )
    parser.add_argument("--version", action="version", version=f"train-ato {VERSION}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Command)
    for name, summary in COMMANDS if only is None else [(only, dict(COMMANDS)[only])]:
        command = commands.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        command.module = f"train_ato.cli.{MODULES.get(name, name.replace('-', '_'))}"
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status."""
    gc.set_threshold(*COLLECTED)
    prepare_streams()
    status = _status(arguments)
    if arguments is None:
        _name_threads_left()
    return status


def _status(arguments: Sequence[str] | None) -> int:
    """Run one command and return its exit status; an error is one line."""
    interrupt = Interrupt()
    try:
        with ending_like_ctrl_c(interrupt):
            if "_ARGCOMPLETE" in os.environ:
                from train_ato.cli.completion import print_completions

                print_completions(command_line())
            given = list(sys.argv[1:] if arguments is None else arguments)
            if not given:
                command_line().print_help()
                return DONE
            given = _with_known_command(given)
            only = None if given[0].startswith("-") else given[0]
            return _executed(command_line(only).parse_args(given))
    except RunFailed as error:
        return FAILED if error.printed else print_error(error, FAILED)
    except KeyboardInterrupt:
        return print_error("interrupted", FAILED)
    except Exception as error:
        if interrupt.asked:  # some libraries convert KeyboardInterrupt into their own exception
            return print_error("interrupted", FAILED)
        return _status_of(error)


def _name_threads_left() -> None:
    """Name the threads of a component for which Python waits before the process can end."""
    left = [thread for thread in threading.enumerate() if not thread.daemon and thread is not threading.main_thread()]

    def name() -> None:
        time.sleep(LEFT_S)
        if names := ", ".join(dict.fromkeys(thread.name for thread in left if thread.is_alive())):
            text = f"ended, but a thread of a law or another component goes on: {names}; start it with daemon=True"
            print_error(text, DONE)

    if left:
        threading.Thread(target=name, daemon=True).start()


def _executed(options: argparse.Namespace) -> int:
    """Execute the command; ``sys.exit(0)`` and ``os._exit()`` in the code of a user are failures."""
    from train_ato.cli.screen import kept_for_result

    as_json, units = getattr(options, "json", False), getattr(options, "units", None)
    try:
        with no_silent_exit(), displayed_in(units), kept_for_result(as_json=as_json):
            options.execute(options)
        return DONE
    except SystemExit as error:
        if error.code and not isinstance(error, ProcessExit):  # rich, for a closed pipe
            raise
        raise RunFailed(f"a law or another component {text_of_exit(error)}; raise an error there") from None


def _with_known_command(arguments: list[str]) -> list[str]:
    """Return the command line of a known command."""
    if arguments[0] in ("-h", "--help", "--version") or arguments[0] in dict(COMMANDS):
        return arguments
    if arguments[0].startswith("-"):
        option = arguments[0].partition("=")[0]
        raise ValueError(f"{option}: an option comes after the command; write train-ato COMMAND ... {option}")
    from plant_sim.input_error import close_match

    near = close_match(arguments[0], dict(COMMANDS))
    raise ValueError(f"unknown command '{arguments[0]}'{near}; see `train-ato --help`")


def _status_of(error: Exception) -> int:
    """Print an error as one line and return the exit status; raise an unexpected one again."""
    if isinstance(error, ValueError):
        return print_error(error, BAD_INPUT)
    from train_ato.ros import missing_ros

    if (without := missing_ros(error)) is not None:
        return print_error(without, BAD_INPUT)
    if unloaded := unloaded_package(error):
        return print_error(unloaded, BAD_INPUT)
    if isinstance(error, BrokenPipeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader has closed: `train-ato list | head`
        return FAILED
    if isinstance(error, Warning):
        filters = "`python -W`, PYTHONWARNINGS or the law has; limit it to a module of your own"
        return print_error(f"{type(error).__name__}: {error}; it is an error by a filter that {filters}", BAD_INPUT)
    if isinstance(error, MemoryError):
        return print_error("not enough memory; check the units of the largest values", FAILED)
    if isinstance(error, OSError):
        return print_error(error, BAD_INPUT if error.errno == errno.ENAMETOOLONG else FAILED)
    raise error


def print_error(error: object, status: int) -> int:
    """Print an error, one line for each fault of an input, and return the exit status."""
    if os.environ.get("TRAIN_ATO_DEBUG") and isinstance(error, Exception):
        raise error
    lines = error.lines if isinstance(error, InputFaults) else (str(error),)
    if isinstance(error, OSError) and error.filename is not None:
        remedy = "; shorten it" if error.errno == errno.ENAMETOOLONG else ""
        lines = (f"{error.filename}: {error.strerror}{remedy}",)
    elif isinstance(error, OSError) and error.strerror:
        remedy = "; free space there, or set TMPDIR" if error.errno == errno.ENOENT else ""
        gone = error.strerror == os.strerror(errno.ENOENT)  # of no file: getcwd()
        lines = ("the present folder was removed; change to another one" if gone else f"{error.strerror}{remedy}",)
    if "embedded null" in str(error):
        lines = ("a name has a null character; remove it",)
    sys.stderr.write("".join(f"train-ato: {shortened(line)}\n" for line in lines))
    return status


if __name__ == "__main__":
    sys.exit(main())
