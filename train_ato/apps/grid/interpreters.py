"""Python interpreters of this machine that can run a scenario."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import plant_sim

MINORS = (10, 11, 12, 13)
"""Minor versions of Python 3 that are supported."""
ROOT = Path(plant_sim.__file__).resolve().parents[1]
"""Folder with the packages ``train_ato`` and ``plant_sim``."""
PROBE_LIMIT_S = 120.0
PROBE = """
import json, sys
import numpy, numba
import train_ato.loop.engine, train_ato.log.run_folder
from train_ato.log.versions import versions
try:
    import rclpy
    ros = True
except ImportError:
    ros = False
found = numpy.show_config(mode="dicts").get("SIMD Extensions", {}).get("found", [])
print(json.dumps({"prefix": sys.prefix, "ros": ros, "features": found, "versions": versions()}))
"""


@dataclass(frozen=True)
class Interpreter:
    """Python interpreter with the packages of a run.

    Attributes
    ----------
    path : str
        Its executable.
    version, numpy, numba : str
        Versions.
    ros : bool
        True if it can import ``rclpy``.
    numpy_features : tuple of str
        Groups of processor features above the baseline for which numpy has separate code on this machine.
    own : bool
        True for the interpreter of this process.
    """

    path: str
    version: str
    numpy: str
    numba: str
    ros: bool
    numpy_features: tuple[str, ...] = ()
    own: bool = False


@dataclass(frozen=True)
class Skipped:
    """Python interpreter without a package, and the reason in one line."""

    path: str
    reason: str


def find_interpreters(
    chosen: Sequence[str] | None, scratch: Path
) -> tuple[tuple[Interpreter, ...], tuple[Skipped, ...]]:
    """Return the interpreters of the grid, that of this process first, and the skipped ones.

    Parameters
    ----------
    chosen
        Executables beside that of this process; None: those of ``PATH`` and pyenv.
    scratch
        Folder for compiled Python of the other interpreters.

    Raises
    ------
    ValueError
        If a chosen executable cannot run a scenario.
    """
    found: dict[str, Interpreter] = {}
    skipped: list[Skipped] = []
    for path in (sys.executable, *(_at_hand() if chosen is None else chosen)):
        entry, prefix = _probed(path, scratch)
        if isinstance(entry, Skipped):
            if path == sys.executable or chosen is not None:
                raise ValueError(f"--python {path}: {entry.reason}; name an interpreter with the packages of train_ato")
            skipped.append(entry)
        elif prefix not in found and entry.version not in {known.version for known in found.values()}:
            found[prefix] = entry
    return tuple(found.values()), tuple(skipped)


def _at_hand() -> Iterable[str]:
    """Return the executables of the supported versions on ``PATH`` and of pyenv, each file once."""
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv") / "versions"
    candidates = [shutil.which(f"python3.{minor}") for minor in MINORS]
    candidates += [str(path) for minor in MINORS for path in sorted(pyenv.glob(f"3.{minor}.*/bin/python3.{minor}"))]
    shims = str(pyenv.parent / "shims")
    files: dict[str, str] = {}
    for path in candidates:
        if path is not None and not path.startswith(shims):
            files.setdefault(f"{Path(path).resolve()} {Path(path).parent}", path)
    return [path for path in files.values() if Path(path) != Path(sys.executable)]


def _probed(path: str, scratch: Path) -> tuple[Interpreter | Skipped, str]:
    """Import the packages of a run in an interpreter; return it and its prefix."""
    own = path == sys.executable
    kept = {key: value for key, value in os.environ.items() if own or not key.startswith(("_ROS_WHEELS", "LD_LIBRARY"))}
    paths = os.pathsep.join(filter(None, (str(ROOT), kept.get("PYTHONPATH", ""))))
    more = {"PYTHONPATH": paths, "PYTHONPYCACHEPREFIX": f"{scratch}/python", "NUMBA_CACHE_DIR": f"{scratch}/probe"}
    try:
        done = subprocess.run(
            [path, "-c", PROBE],
            env={**kept, **more},
            capture_output=True,
            text=True,
            timeout=PROBE_LIMIT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return Skipped(path, " ".join(str(error).split())), ""
    if done.returncode != 0:
        return Skipped(path, (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]), ""
    answer = json.loads(done.stdout)
    versions = answer["versions"]
    features = tuple(answer["features"])
    return (
        Interpreter(path, versions["python"], versions["numpy"], versions["numba"], answer["ros"], features, own),
        answer["prefix"],
    )
