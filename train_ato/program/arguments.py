"""Standard streams, command-line parser with one-line errors, YAML values of options, checks of output files."""

import argparse
import ast
import io
import math
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from inspect import getsource
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

from train_ato.program.errors import refused_unwritten

BAD_INPUT = 2
"""Exit status of a command refused before its start."""
OPTIONS_OF_PLAN = "options of plan"
"""Source of the settings of a plan in a refusal."""


def shortened(message: str) -> str:
    """Return a message as one line with the middle of every overlong word left out."""
    return " ".join(re.sub(r"\S{301,}", lambda word: f"{word[0][:60]}...{word[0][-60:]}", message).split())


def prepare_streams() -> None:
    """Open closed standard streams to the null device, and show characters outside an encoding as escapes.

    With a closed stream (``>&-``) Python has no ``sys.stdout``, and the next file that a library opens gets its number:
    prints would go into that file.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    for name, number, mode in (("stdin", 0, "r"), ("stdout", 1, "w"), ("stderr", 2, "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


class OneLineParser(argparse.ArgumentParser):
    """Argument parser with one-line errors that name the nearest known word; an option has no other spelling."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)
        # a value as -5%, -1e3, -.5 or the post -1+200, as in Python 3.14; earlier versions take -5 and -0.5 only
        self._negative_number_matcher = re.compile(r"-(\.?\d|inf$|nan$)")

    def error(self, message: str) -> NoReturn:
        """Print the error in one line and exit with status 2."""
        for kind, plain in (("int", "a whole number"), ("float", "a number"), ("Path", "a path")):
            message = re.sub(rf"invalid {kind} value: ('.*')", rf"\1 is not {plain}", message, flags=re.DOTALL)
        fault = r"argument (?:.*/)?(-\S+): expected (?:one|at least one) argument"
        message = re.sub(fault, r"\1: it has no value; give one, as \1=VALUE if it begins with -", message)
        self.exit(BAD_INPUT, f"{self.prog}: {shortened(message)}; see `{self.prog} --help`\n")

    def refuse_unknown(self, arguments: Sequence[str]) -> None:
        """Refuse arguments that the parser has left over, if there are any."""
        if not arguments:
            return
        from plant_sim.input_error import close_match

        first = arguments[0].partition("=")[0]
        options = [name[2:] for action in self._actions for name in action.option_strings if name.startswith("--")]
        hint = close_match(first.lstrip("-"), options) if first.startswith("-") else ""  # dashes are alike in all
        if not arguments[0].startswith("-"):
            first, hint = arguments[0], "; remove it, or write lists and KEY=VALUE without spaces"
        self.error(f"unknown argument '{first}'" + hint.replace(" '", " '--"))

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a value that is none of the choices."""
        if action.choices is not None and value not in action.choices:
            from plant_sim.input_error import close_match

            choices = [str(choice) for choice in action.choices]
            raise argparse.ArgumentError(
                action, f"'{value}' is none of {', '.join(choices)}{close_match(str(value), choices)}"
            )


def parse_rate(text: str) -> float:
    """Return a rate [simulated seconds per second of wall time]; infinity for ``max``.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is neither ``max`` nor a finite number above 0.
    """
    return _positive(text, "max", "not a rate; give a number above 0, 1 for real time, or max")


def parse_limit(text: str) -> float:
    """Return a limit of wall time [s]; infinity for ``none``.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is neither ``none`` nor a finite number above 0.
    """
    return _positive(text, "none", "not a time; give seconds above 0, or none")


def _positive(text: str, unlimited: str, fault: str) -> float:
    """Return a finite number above 0, or infinity for the word ``unlimited``; raise with the fault for other texts."""
    if text == unlimited:
        return math.inf
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text}: {fault}")
    return value


TYPES: dict[str, type] = {
    **dict.fromkeys(("N", "MS", "PORT"), int),
    **dict.fromkeys(("S", "HZ", "KM", "V", "M", "D"), float),
    **dict.fromkeys(("DIR", "FILE", "RUN", "SPEC", "SPEC.yaml", "CSV", "OTHER", "OUT"), Path),
}
"""Type of a value by its name in the help; other values are texts."""


def add_option(parser: argparse._ActionsContainer, form: str, text: str, **settings: Any) -> argparse.Action:
    """Declare an option or argument in the form of its help: ``--out DIR``, ``-l, --loop``, ``run RUN``.

    An option without a value is a switch. ``settings`` are those of argparse.
    """
    names, _, value = form.replace(", -", ",-").partition(" ")
    if value:
        settings = {"metavar": value, "type": TYPES.get(value), **settings}
    elif names.startswith("-") and "choices" not in settings:
        settings = {"action": "store_true", **settings}
    if settings.get("action") in ("append", "extend"):
        settings = {"default": [], **settings}
    return parser.add_argument(*names.split(","), help=text, **settings)


Options = Mapping[str, Mapping[str, Any] | Callable[[argparse.ArgumentParser], object]]
"""Settings of options by their first name, or the function that declares an option of several commands."""


def declare_options(parser: argparse.ArgumentParser, module: ModuleType) -> None:
    """Declare the options below ``Options::`` in the docstring of a module: form, two spaces or more, help.

    Lines with eight spaces or more continue the help.

    Parameters
    ----------
    parser
        Parser of the command.
    module
        Module of the command. Its ``OPTIONS`` have what the docstring does not have, as for :func:`add_option`. Beside
        that ``one_of`` is the name of a group of options that exclude each other (``required``: one of them is),
        ``group`` the title of a group in the help, and ``words`` the values in the braces of a help.

    Raises
    ------
    ValueError
        If Python leaves docstrings out, and the source of the module cannot be read.
    RuntimeError
        For a line without its two spaces, and for settings of an option that the docstring does not have.
    """
    settings = dict(vars(module).get("OPTIONS", {}))
    try:
        text = module.__doc__ or ast.get_docstring(ast.parse(getsource(module)), clean=False)  # under python -OO
    except OSError:
        raise ValueError(f"{module.__file__}: python -OO reads the options there; add this file, or use -O") from None
    groups: dict[str, argparse._ArgumentGroup] = {}
    block = (text or "").partition("\nOptions::\n\n")[2].partition("\n\n")[0]
    for entry in re.split(r"\n {,7}(?=\S)", "\n" + block.rstrip())[1:]:
        form, _, meaning = entry.partition("  ")
        if "\n" in form or not meaning:
            raise RuntimeError(f"{module.__name__}: write two spaces before the help: {entry}")
        given = settings.pop(re.split("[ ,]", form)[0], {})
        if callable(given):
            given(parser)
            continue
        given = dict(given)
        place: argparse._ActionsContainer = parser
        if title := given.pop("group", ""):
            place = groups[title] = groups.get(title) or parser.add_argument_group(title)
        if name := given.pop("one_of", ""):
            required = given.pop("required", False)
            place = groups[name] = groups.get(name) or parser.add_mutually_exclusive_group(required=required)
        meaning = " ".join(meaning.split())
        if words := given.pop("words", {}):
            meaning = meaning.format(**words)
        add_option(place, form, re.sub(r"%(?!\()", "%%", meaning), **given)
    if settings:
        raise RuntimeError(f"{module.__name__}: settings without an option in the docstring: {', '.join(settings)}")


def add_rate(parser: argparse.ArgumentParser) -> None:
    """Declare ``--rate``, as of ``ros2 bag play``; without it there is no limit."""
    text = "simulated seconds per second of wall time, or max (default: max)"
    add_option(parser, "-r, --rate R", text, type=parse_rate)


def rate_of(options: argparse.Namespace) -> float | None:
    """Return the rate of the options of a run, None without a limit.

    Raises
    ------
    ValueError
        For ``--rate max`` without lockstep: nothing but the rate would hold the train back.
    """
    if options.rate == math.inf and not options.lockstep:
        raise ValueError("--rate max: without lockstep only the wall clock holds the train back; give a number")
    return None if options.rate == math.inf else options.rate


def add_no_lockstep(parser: argparse.ArgumentParser) -> None:
    """Declare ``--no-lockstep``."""
    add_option(
        parser,
        "--no-lockstep",
        "do not wait for late commands; they are counted, and the train keeps the last one (default of --rate: 1)",
        dest="lockstep",
        action="store_false",
    )


def add_train(parser: argparse.ArgumentParser) -> None:
    """Declare domain and namespace of a running train."""
    add_option(parser, "--domain N", "ROS domain of the run (default: ROS_DOMAIN_ID, or the only run)")
    add_option(parser, "--namespace /NAME", "namespace of the train, one of several: /t1", default="")


def add_followed(parser: argparse.ArgumentParser) -> None:
    """Declare ``--followed``."""
    add_option(parser, "--followed", "do not begin before a train behind reads the reports of this train")


def parse_yaml_value(text: str, option: str) -> Any:
    """Return a value written as YAML: ``0.4``, ``1e-3``, ``true``, ``smc``.

    Raises
    ------
    ValueError
        If the text is not valid YAML; the message begins with ``option``.
    """
    from plant_sim.data_text import parse_yaml  # help does not need yaml

    try:
        return parse_yaml(text)
    except ValueError:
        if text.strip().lstrip("+-").isdigit():
            raise ValueError(f"{option}: an integer of {len(text.strip())} digits; give a shorter one") from None
        raise ValueError(
            f"{option}: '{text[:60]}' is not valid YAML; quote a text that contains [ ] {{ }} : or #"
        ) from None


def option_name(key: str, dash: str) -> str:
    """Return the name of an option in messages: a keyword of Python, or with ``dash`` an option of the command."""
    return dash + key.replace("_", "-") if dash else key


def check_new_file(path: Path, endings: Sequence[str], option: str = "--out") -> None:
    """Refuse an output file that exists already, has a wrong ending or cannot be created."""
    if path.suffix.lower() not in endings:
        raise ValueError(f"{option} {path}: end it in {', '.join(endings)}")
    if path.exists():
        raise ValueError(f"{option} {path}: exists already; name a file that does not")
    if not path.parent.is_dir():
        raise ValueError(f"{option} {path}: folder '{path.parent}' does not exist; create it or choose another")
    with refused_unwritten(f"{option} {path}"):
        path.open("xb").close()
        path.unlink()
