"""``train-ato completion SHELL``: code that completes commands, options and names in a shell, with argcomplete.

Options::

    shell SHELL  one of %(choices)s
"""

import argparse
import os
import shlex
import sys
from collections.abc import Callable, Iterable
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any

from train_ato.program.arguments import OneLineParser, Options

SHELLS = ("bash", "zsh", "fish")
PROGRAM = "train-ato"
MISSING = "completion: the package argcomplete is not installed; install it with `pip install argcomplete`"

OPTIONS: Options = {"shell": {"choices": SHELLS}}


def finish(parser: argparse.ArgumentParser) -> None:
    """Add the lines for the files of a shell below the options."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = (
        f'bash, zsh:  eval "$({PROGRAM} completion bash)"    or completion zsh; in ~/.bashrc or ~/.zshrc\n'
        f"fish:       {PROGRAM} completion fish | source      in ~/.config/fish/config.fish"
    )


def execute(options: argparse.Namespace) -> None:
    """Print the code for the shell."""
    try:
        import argcomplete
    except ImportError:
        raise ValueError(MISSING) from None
    sys.stdout.write(argcomplete.shellcode([PROGRAM], shell=options.shell) + "\n")


def print_completions(parser: OneLineParser) -> None:
    """Answer the request of a shell in the environment, and end the process.

    Parameters
    ----------
    parser
        Parser of the program.  Only the command in the line declares its options: the others need not be imported.
    """
    try:
        import argcomplete
    except ImportError:
        sys.exit(1)
    words = _words(os.environ.get("COMP_LINE", ""))
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name in set(words) & set(action.choices):
                command: Any = action.choices[name]
                command.declare()
                _add_names(command)
    argcomplete.autocomplete(parser)


def _words(line: str) -> list[str]:
    """Return the words of a command line, also of one with an open quotation mark."""
    try:
        return shlex.split(line)
    except ValueError:
        return line.split()


def _add_names(command: argparse.ArgumentParser) -> None:
    """Give each argument the function that lists its known names."""
    for action in command._actions:
        names = NAMES.get(action.dest)
        if names is _scenarios and command.prog.endswith(" run"):
            names = _runnable
        if names is not None and action.choices is None and not isinstance(action, argparse._StoreTrueAction):
            action.completer = _completer(names, files=action.dest in WITH_FILES)  # type: ignore[attr-defined]


def _completer(names: Callable[[], Iterable[str]], *, files: bool) -> Callable[..., list[str]]:
    """Return the completer of a word: known names, then files."""

    def complete(prefix: str, **_: Any) -> list[str]:
        from argcomplete.completers import FilesCompleter

        before, comma, last = prefix.rpartition(",")
        found = [f"{before}{comma}{name}" for name in names() if name.startswith(last)]
        return found + (list(FilesCompleter()(prefix)) if files else [])

    return complete


def _runnable() -> Iterable[str]:
    from train_ato.scenario.scenario_files import shipped_following

    return (*_scenarios(), *shipped_following())


def _called(module: str, function: str) -> Callable[[], Iterable[str]]:
    """Return a function of names that imports its module at its call: only the completed argument needs it."""
    return lambda: map(str, attrgetter(function)(import_module(module))())


_scenarios = _called("train_ato.scenario.scenario_files", "scenario_names")
_laws = _called("train_ato.control.registry", "LAWS.names")
_observers = _called("train_ato.control.registry", "OBSERVERS.names")
_compensations = _called("train_ato.control.registry", "COMPENSATIONS.names")
_consists = _called("plant_sim.library", "consist_names")
_lines = _called("plant_sim.library", "line_names")
_domains = _called("train_ato.ros.graph.environment", "held_domains")


def _listed() -> Iterable[str]:
    for names in (_runnable, _laws, _observers, _compensations, _consists, _lines):
        yield from names()


def _runs() -> Iterable[str]:
    """Return the run folders below ``runs``."""
    return sorted(str(path.parent) for path in Path("runs").glob("*/scenario.yaml"))


NAMES: dict[str, Callable[[], Iterable[str]]] = {
    "scenario": _scenarios, "case": _scenarios, "law": _laws, "laws": _laws, "observer": _observers,
    "compensation": _compensations, "consist": _consists, "line": _lines, "run": _runs, "runs": _runs,
    "domain": _domains, "name": _listed, "external": _called("train_ato.messages.topics", "EXTERNAL.__iter__"),
}  # fmt: skip
"""Known names of an argument, by its name in the parser."""
WITH_FILES = ("scenario", "case", "consist", "line", "run", "runs", "name")
"""Arguments that also accept a file or a folder."""
