"""Faults of a law, an observer or a compensation in one line: name, reason, file and line."""

import inspect
import math
import traceback
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

import numpy as np

from train_ato.control.contract import LawInput, LawOutput, LawPlan
from train_ato.program.errors import RunFailed
from train_ato.program.interrupt import STEP_LIMIT_S, ComponentCall, StepLimit, TimedOut, text_of_exit

_OF_PROJECT = ("train_ato", "plant_sim")
_OF_UNITS = (
    "position", "velocity", "applied", "reference_position", "reference_velocity", "reference_acceleration",
    "feedforward", "disturbance", "shoe_force", "force_min", "force_max",
)  # fmt: skip
"""Inputs of a law with one entry per power unit."""


class ComponentFailed(RunFailed):
    """Failure of a component that a user can write; the train is braked to standstill before the run ends."""

    def __init__(self, message: object = "", node: str = "controller") -> None:
        super().__init__(message)
        self.node = node


def short_name(name: str) -> str:
    """Return the name of a component in messages: its class without the module."""
    return name.rpartition(":")[2]


def is_own(component: object) -> bool:
    """Return True for a component outside of this project."""
    return type(component).__module__.partition(".")[0] not in _OF_PROJECT


def step_limit(component: object) -> AbstractContextManager[None]:
    """Return the context of a step of a component: with a limit of its time for one outside of this project."""
    return StepLimit() if is_own(component) else nullcontext()


def raise_if_interrupted(error: BaseException) -> None:
    """Raise an exception that is Ctrl-C, or a kind that is no fault of a component, again."""
    if isinstance(error, KeyboardInterrupt) and ComponentCall.interrupted:
        raise error


def fault_of_error(kind: str, name: str, error: BaseException) -> str:
    """Return the fault of a component by an exception that its step has raised.

    Parameters
    ----------
    kind, name
        For example ``law`` and ``my_law:MyLaw``.
    error
        The exception; its traceback begins in this project.
    """
    return f"{kind} {short_name(name)}: {text_of_error(error)}"


def printable(text: str) -> str:
    """Return a text of a component for a log, which keeps no half of a character."""
    return text.encode("utf-8", "backslashreplace").decode()


def text_of_error(error: BaseException) -> str:
    """Return an exception in the code of a user in one line: its kind, its reason, file and line."""
    if isinstance(error, SystemExit):
        text = text_of_exit(error)
    elif isinstance(error, TimedOut):
        text = f"step() did not return within {STEP_LIMIT_S:g} s"
    else:
        try:
            reason = printable(str(error))
        except Exception:
            reason = "its text cannot be made"
        text = ": ".join(filter(None, (type(error).__name__, " ".join(reason.split()))))
    return f"{text}{place_of(error)}"


@contextmanager
def refused_at_start(kind: str, name: str, component: object) -> Iterator[None]:
    """Raise an error in the constructor, ``bind`` or ``reset`` of a component of a user as ValueError in one line.

    Parameters
    ----------
    kind, name
        For example ``law`` and ``my_law:MyLaw``.
    component
        Component or its class; an error in one of this project remains as it is.
    """
    try:
        yield
    except ValueError:
        raise
    except (Exception, SystemExit) as error:
        if component.__module__.partition(".")[0] in _OF_PROJECT:
            raise
        raise ValueError(fault_of_error(kind, name, error)) from error


def place_of(error: BaseException) -> str:
    """Return file and line of the last frame outside of this project and of libraries, as text with a comma.

    A file that cannot be compiled has no frame; the text of its SyntaxError names the place.
    """
    frames = [
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if frame.f_globals.get("__name__", "").partition(".")[0] not in _OF_PROJECT
    ]
    libraries = ("site-packages", "/lib/python", "<frozen ")
    own = [frame for frame in frames if not any(each in frame[0] for each in libraries)]
    if not own:
        last = list(traceback.walk_tb(error.__traceback__))[-1:]
        own = [(frame.f_code.co_filename, line) for frame, line in last]
        own = [frame for frame in own if not frame[0].startswith("<frozen ")]
    return f", {own[-1][0]}:{own[-1][1]}" if own else ""


def output_fault(name: str, law: Any, output: Any, units: int) -> str:
    """Return the fault of an output that is not one of the contract, with its remedy; "" without one.

    Parameters
    ----------
    name, law
        Name of the law, and the law.
    output
        Result of its step.
    units
        Number of power units.
    """
    force, found = output.force if isinstance(output, LawOutput) else None, ""
    if not isinstance(output, LawOutput):
        found = type(output).__name__
    elif not isinstance(force, np.ndarray):
        found = f"force of type {type(force).__name__}"
    elif force.dtype.kind not in "fiu":
        found = f"force of type {type(force.item(0) if force.size else force).__name__}"
    elif force.shape != (units,):
        found = f"{str(force.tolist())[:60]} N, shape {force.shape}"
    elif not all(map(math.isfinite, force.tolist())):
        found = f"{str(force.tolist())[:60]} N"
    elif output.brake_pipe is not None and not isinstance(output.brake_pipe, (int, float)):
        found = f"brake_pipe of type {type(output.brake_pipe).__name__}"
    elif output.brake_pipe is not None and not math.isfinite(output.brake_pipe):
        found = f"brake_pipe {output.brake_pipe} Pa"
    elif not isinstance(output.held, str):
        found = f"held of type {type(output.held).__name__}"
    elif output.plan is not None and not isinstance(output.plan, LawPlan):
        found = f"plan of type {type(output.plan).__name__}"
    if not found:
        return ""
    place, method = step_of(law)
    asked = f"a list of {units} forces" if method == "demand" else f"LawOutput(force=array of {units})"
    return f"law {short_name(name)}: {method}() returned {found}; return {asked}{place}"


def estimate_fault(name: str, observer: Any, estimate: Any, units: int) -> str:
    """Return the fault of an estimate that is no finite array of the units, with its remedy; "" without one."""
    found = f"shape {estimate.shape}" if isinstance(estimate, np.ndarray) else type(estimate).__name__
    if isinstance(estimate, np.ndarray) and estimate.shape == (units,) and estimate.dtype.kind in "fiu":
        if all(map(math.isfinite, estimate.tolist())):
            return ""
        found = f"{str(estimate.tolist())[:60]} N"
    text = f"observer {short_name(name)}: step() returned {found}; return an array of {units}"
    return f"{text}{step_of(observer)[0]}"


def diagnostics_fault(name: str, law: Any, found: Any) -> str:
    """Return the fault of the diagnostics of a law that are no dictionary, with its remedy; "" without one."""
    if isinstance(found, Mapping):
        return ""
    text = f"law {short_name(name)}: diagnostics() returned {type(found).__name__}; return a dictionary of texts"
    return f"{text}{step_of(law, 'diagnostics')[0]}"


def inputs_fault(compensation: Any, inputs: Any, units: int) -> str:
    """Return the fault of the inputs by a compensation that a law cannot read, with its remedy; "" without one."""
    found, asked = type(inputs).__name__, "LawInput(...)"
    if isinstance(inputs, LawInput):
        shapes = {key: np.shape(getattr(inputs, key)) for key in _OF_UNITS}
        wrong = [f"{key} of shape {shape}" for key, shape in shapes.items() if shape != (units,)]
        if not wrong:
            return ""
        found, asked = wrong[0], f"an array of {units}"
    return answer_fault(compensation, f"{found}; return {asked}")


def answer_fault(compensation: Any, found: str) -> str:
    """Return the fault of a compensation by what its step has returned, with its place."""
    return f"compensation {type(compensation).__name__}: step() returned {found}{step_of(compensation)[0]}"


def step_of(law: Any, *methods: str) -> tuple[str, str]:
    """Return file and line of a method, by default the step, outside of this project after a comma, and its name."""
    if is_own(law):
        project = inspect.getfile(RunFailed).rpartition("/train_ato/")[0] + "/train_ato/"
        names = methods or ("step", "demand")
        for name, method in ((name, vars(each).get(name)) for each in type(law).__mro__ for name in names):
            code = getattr(method, "__code__", None)
            if code is not None and not code.co_filename.startswith(project):
                return f", {code.co_filename}:{code.co_firstlineno}", name
    return "", "step"


def unless_raised(result: Any) -> Any:
    """Return the result of a call in a compiled tick that is left to Python, or raise it if it is an exception."""
    if isinstance(result, BaseException):
        raise result
    return result
