"""First failure of a run: node and reason in one line, traceback in a file."""

import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import wraps
from importlib.util import find_spec
from numbers import Integral, Real
from pathlib import Path
from types import NoneType
from typing import Any, TypeVar, cast

_OWN = ("train_ato", "plant_sim")
_PACKAGES = {
    "bokeh": "bokeh", "jinja2": "Jinja2", "tornado": "tornado", "foxglove": "foxglove-sdk", "scipy": "scipy",
    "pyarrow": "pyarrow", "matplotlib": "matplotlib", "pandas": "pandas", "pebble": "pebble", "rainflow": "rainflow",
    "mcap": "mcap", "zstandard": "zstandard", "rosbags": "rosbags", "rich": "rich", "argcomplete": "argcomplete",
    "numpy": "numpy", "numba": "numba", "pydantic": "pydantic", "yaml": "PyYAML",
}  # fmt: skip
"""Required packages and those of the extras, by the name that Python imports."""
_Function = TypeVar("_Function", bound=Callable[..., Any])


def of_own_code(error: BaseException) -> bool:
    """Return true for an exception from code of this project below the frame that caught it.

    Other exceptions come from a library during the processing of an external message.
    """
    frames = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
    return any(name.partition(".")[0] in _OWN for name in frames[1:])


class Error(Exception):
    """Base of every error of the Python interface; its message has one line for each fault."""


class InputError(Error, ValueError):
    """Refusal of bad input before anything starts; each line has key, value, problem and remedy."""


class RunFailed(Error):
    """Failure of a run; the message has node and reason in one line.

    Attributes
    ----------
    run : Run or None
        Record of the run up to its end, for runs started by :func:`train_ato.run`.
    printed : bool
        True: the command has printed the message.
    """

    def __init__(self, message: object = "", run: Any = None) -> None:
        super().__init__(message)
        self.run = run
        self.printed = False


class RunInterrupted(RunFailed, KeyboardInterrupt):
    """End of a run by Ctrl-C; ``run`` is its record up to the end."""


@contextmanager
def refused_unwritten(place: object, remedy: str = "choose another place", left: Path | None = None) -> Iterator[None]:
    """Refuse a place to which the block cannot write, with a remedy, and remove the incomplete file ``left``."""
    try:
        yield
    except OSError as error:
        if left is not None:
            with suppress(OSError):
                left.unlink()
        raise ValueError(f"{place}: cannot be written ({error.strerror}); {remedy}") from None


def missing_packages(*modules: str) -> str:
    """Return which packages of an extra are not installed and the pip command that installs them, else ""."""
    missing = [_PACKAGES[name] for name in modules if find_spec(name) is None]
    verb = "is" if len(missing) == 1 else "are"
    return f"{', '.join(missing)} {verb} not installed; run `pip install {' '.join(missing)}`" if missing else ""


def unloaded_package(error: Exception) -> str:
    """Return which required package does not load, and the pip command; "" for another error or a module of a user."""
    if not isinstance(error, ImportError):
        return ""
    passed = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
    own = {*_OWN, "__main__", *sys.stdlib_module_names}
    name = next((top for top in (each.partition(".")[0] for each in (*passed, error.name or "")) if top not in own), "")
    if name not in _PACKAGES:
        return ""
    if missing := missing_packages(name):
        return missing
    reason, package = str(error).partition("\n")[0], _PACKAGES[name]
    return f"{name} does not load ({reason}); run `pip install --force-reinstall {package}`"


def check_packages(user: str, *modules: str) -> None:
    """Refuse missing packages of an extra before anything starts."""
    if missing := missing_packages(*modules):
        raise InputError(f"{user}: {missing}")


_KINDS: dict[str, tuple[Any, str]] = {
    "int": (Integral, "a whole number"), "float": (Real, "a number"), "str": (str, "a text"),
    "None": (NoneType, "None"), "str | Path": ((str, Path), "a path"), "Mapping": (Mapping, "a mapping"),
    "Sequence": ((list, tuple), "a list"),
}  # fmt: skip
"""Types and words of the annotations that :func:`check_kinds` compares."""


def check_kinds(annotations: Mapping[str, Any], values: Mapping[str, Any]) -> None:
    """Refuse values by name that are not of the kinds of their annotations; entries of lists are not compared."""
    for name in (entry for entry in annotations if entry in values):
        text = str(getattr(annotations[name], "__name__", annotations[name]))
        text = re.sub(r"\[[^][]*(\[[^][]*\][^][]*)*\]|\b(\w+\.)+", "", text)
        kinds = re.findall(r"str \| Path|[^ |]+", text)
        known = [_KINDS[kind] for kind in kinds if kind in _KINDS]
        if len(known) == len(kinds) and not any(isinstance(values[name], kind) for kind, _ in known):
            raise InputError(f"{name} = {values[name]!r}: give {' or '.join(words for _, words in known)}")


def refusing(function: _Function) -> _Function:
    """Return a function whose refusals are :class:`InputError`; a ValueError of a library or a user's law stays.

    A TypeError or AttributeError by an argument that is not of its kind is a refusal too.
    """

    @wraps(function)
    def call(*given: Any, **named: Any) -> Any:
        try:
            return function(*given, **named)
        except (TypeError, AttributeError):
            from inspect import signature

            with suppress(TypeError):  # of a wrong number of arguments
                check_kinds(function.__annotations__, signature(function).bind(*given, **named).arguments)
            raise
        except ValueError as error:
            raised_in = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)][-1]
            if "embedded null" in str(error):
                raise InputError("a name has a null character; remove it") from None
            if isinstance(error, Error) or raised_in.partition(".")[0] not in _OWN:
                raise
            raise InputError(str(error)) from None

    return cast("_Function", call)


class NodeFault(ValueError):
    """Fault of another node or program, found by its messages."""

    def __init__(self, node: str, reason: str) -> None:
        super().__init__(reason)
        self.node = node


class FirstFailure:
    """First failure in this process; it ends the run.

    Parameters
    ----------
    log_folder
        Folder of the traceback file for developers; None: no file.

    Attributes
    ----------
    failure : str or None
        Node and reason in one line.
    of_component : bool
        True for a failure of the control stack or one of its components, which has braked the train to a stop.
    """

    def __init__(self, log_folder: Path | None = None) -> None:
        self.of_component = False
        self._log_folder = log_folder
        self.failure: str | None = None

    def fail(self, node: str, reason: str | BaseException) -> None:
        """Store the failure of a node; later failures are consequences and are ignored."""
        if self.failure is not None:
            return
        node = getattr(reason, "node", node)
        self.of_component = isinstance(reason, RunFailed)
        text = " ".join(str(reason).split()) or type(reason).__name__
        if isinstance(reason, BaseException) and not isinstance(reason, (ValueError, OSError, RunFailed)):
            text = f"{type(reason).__name__}: {text}"
        self.failure = f"node {node} failed: {text}"
        if isinstance(reason, BaseException) and self._log_folder is not None:
            trace = "".join(traceback.format_exception(reason))
            with suppress(OSError):  # a full disk must not hide the failure itself
                self._log_folder.mkdir(parents=True, exist_ok=True)
                (self._log_folder / f"{node}.traceback.txt").write_text(
                    trace, encoding="utf-8", errors="backslashreplace"
                )
