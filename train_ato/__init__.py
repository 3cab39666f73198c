"""Onboard automatic train operation as a ROS 2 node graph, with the train that it drives.

>>> import train_ato as ta
>>> run = ta.run("demo", law="smc", set={"duration": 20})
>>> run.metrics["controller"]
'smc'

``run`` runs a scenario. ``Env`` drives it step by step, ``compare`` runs it with several laws, and ``sweep`` runs it at
many points. ``tune`` searches for the gains of a law, ``learn`` learns from run to run, and ``falsify`` searches for a
break of a requirement. ``linearise`` returns A, B, C and D. ``open_run`` opens a run folder, ``load`` returns its
tables, and ``scenario`` returns a scenario that can be changed.

``plan`` plans a speed profile, and ``curves`` computes braking curves. ``import_run`` converts a measured run.
``replay`` evaluates a law on recorded inputs, and ``difference`` compares two runs over time and place. ``verify``
repeats a run and compares every message. ``check_law`` runs the contract tests on a law. ``convert`` writes a line or
train in another format. ``laws``, ``observers``, ``compensations``, ``scenarios``, ``trains`` and ``lines`` list the
names. A law is a class with ``parameter`` fields and the methods of ``Law``.

Every error is an ``Error`` with one line for each fault: ``InputError`` before anything starts (also a ValueError),
``RunFailed`` during a run, ``RunInterrupted`` after Ctrl-C.
"""

# ruff: noqa: E402
import signal
import sys

_name, _words = "".join(sys.argv[:1]).rpartition("/")[2], " ".join(sys.orig_argv)
_nodes = ("plant", "profile", "observer", "controller", "supervisor", "recorder")
_begun = _name in ("train-ato", *(f"{node}_node" for node in _nodes)) or (_name == "-m" and "-m train_ato" in _words)
if _begun and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends a program without a traceback while it loads

import importlib
from types import FunctionType
from typing import TYPE_CHECKING, Any

import train_ato.scenario as _package
from train_ato.program.errors import refusing
from train_ato.program.version import VERSION

if TYPE_CHECKING:
    from train_ato.api.catalogue import compensations as compensations
    from train_ato.api.catalogue import laws as laws
    from train_ato.api.catalogue import lines as lines
    from train_ato.api.catalogue import observers as observers
    from train_ato.api.catalogue import scenarios as scenarios
    from train_ato.api.catalogue import trains as trains
    from train_ato.api.compare import Comparison as Comparison
    from train_ato.api.compare import compare as compare
    from train_ato.api.converting import convert as convert
    from train_ato.api.drive import run as run
    from train_ato.api.env.env import Env as Env
    from train_ato.api.env.env import EnvState as EnvState
    from train_ato.api.env.vector_env import VectorEnv as VectorEnv
    from train_ato.api.env.vector_env import vector_env as vector_env
    from train_ato.api.importing import import_run as import_run
    from train_ato.api.linearise import linearise as linearise
    from train_ato.api.planning import plan as plan
    from train_ato.api.run import Run as Run
    from train_ato.api.run import open_run as open_run
    from train_ato.api.run_difference import RunDifference as RunDifference
    from train_ato.api.run_difference import difference as difference
    from train_ato.api.scenario_choice import choose_scenario
    from train_ato.api.verifying import verify as verify
    from train_ato.control.contract import Law as Law
    from train_ato.control.contract import parameter as parameter
    from train_ato.judge.typed_result import TypedResult as TypedResult
    from train_ato.log.table_loading import Frames as Frames
    from train_ato.log.table_loading import load as load
    from train_ato.playback.replaying import replay as replay
    from train_ato.program.errors import Error as Error
    from train_ato.program.errors import InputError as InputError
    from train_ato.program.errors import RunFailed as RunFailed
    from train_ato.program.errors import RunInterrupted as RunInterrupted
    from train_ato.studies.check_component.checking import check_law as check_law
    from train_ato.studies.curves.curves import curves as curves
    from train_ato.studies.falsify.study import falsify as falsify
    from train_ato.studies.learn import LearnResult as LearnResult
    from train_ato.studies.learn import learn as learn
    from train_ato.studies.sweep.result import SweepResult as SweepResult
    from train_ato.studies.sweep.sweep import sweep as sweep
    from train_ato.studies.tune.tune import tune as tune
    from train_ato.studies.tune.tune_result import TuneResult as TuneResult

_PLACES = {
    name: f"train_ato.{module}"
    for module, names in {
        "api.catalogue": "compensations laws lines observers scenarios trains",
        "api.compare": "Comparison compare",
        "api.converting": "convert",
        "api.drive": "run",
        "api.env.env": "Env EnvState",
        "api.env.vector_env": "VectorEnv vector_env",
        "api.importing": "import_run",
        "api.linearise": "linearise",
        "api.planning": "plan",
        "api.run": "Run open_run",
        "api.run_difference": "RunDifference difference",
        "api.verifying": "verify",
        "control.contract": "Law parameter",
        "judge.typed_result": "TypedResult",
        "log.table_loading": "Frames load",
        "playback.replaying": "replay",
        "program.errors": "Error InputError RunFailed RunInterrupted",
        "studies.check_component.checking": "check_law",
        "studies.curves.curves": "curves",
        "studies.falsify.study": "falsify",
        "studies.learn": "LearnResult learn",
        "studies.sweep.result": "SweepResult",
        "studies.sweep.sweep": "sweep",
        "studies.tune.tune": "tune",
        "studies.tune.tune_result": "TuneResult",
    }.items()
    for name in names.split()
}
"""Modules of the public names; they are imported on first use, so that ``import train_ato`` is fast."""

__all__ = sorted([*_PLACES, "__version__", "scenario"])
__version__ = VERSION


if TYPE_CHECKING:
    scenario = choose_scenario
else:

    def scenario(name: Any) -> Any:
        """Return a scenario from its name, file, content or object, with ``with_()``, ``yaml`` and ``variants``.

        See :func:`train_ato.api.scenario_choice.choose_scenario`.
        """
        from train_ato.api.scenario_choice import choose_scenario

        return refusing(choose_scenario)(name)

    scenario.__dict__ = vars(_package)  # the package of this name keeps its modules as attributes


def __getattr__(name: str) -> Any:
    """Import the module of a public name."""
    if name not in _PLACES:
        raise AttributeError(f"module 'train_ato' has no attribute '{name}'")
    found = getattr(importlib.import_module(_PLACES[name]), name)
    globals()[name] = refusing(found) if isinstance(found, FunctionType) and name != "parameter" else found
    return globals()[name]


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


if hasattr(getattr(sys.modules.get("gymnasium"), "vector", None), "AutoresetMode"):  # imported before, 1.1 or later
    importlib.import_module("train_ato.api.env.gymnasium_env")  # registers its environments
