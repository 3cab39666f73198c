"""Trains behind each other at the same time: a program for each in one ROS domain, with live reports."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import yaml

from train_ato.api.following import FollowingResult, Preparation, result_of
from train_ato.api.run import open_run
from train_ato.log.run_folder import RunFolder
from train_ato.log.whole_file import write_whole
from train_ato.program.errors import RunFailed, RunInterrupted
from train_ato.program.interrupt import Interrupt, interruptible
from train_ato.ros.graph.domain_lock import TRAINS
from train_ato.ros.graph.environment import claim_domain, domain_of_environment, print_domain
from train_ato.scenario.following import FollowingFile
from train_ato.scenario.leader import check_namespace

_LOOK_S = 0.1
_SAYS = "train-ato: "
"""Begin of a line of a program."""
_PACKAGE_ROOT = str(Path(__file__).resolve().parents[2])


def write_live_scenarios(file: FollowingFile, out: Path) -> tuple[dict[str, Path], RunFolder]:
    """Make a folder with the scenario of every train, with live reports of the train ahead; return the files by train.

    The namespace of a train is its name.
    """
    names = [train.name for train in file.spec.trains]
    for name in names:
        try:
            check_namespace(f"/{name}")
        except ValueError:
            raise ValueError(f"{file.path}: name = '{name}': is no namespace of ROS 2; replace - by _") from None
    Preparation(file).check()
    folder = RunFolder.make(out, file.spec.name)
    found = {name: folder.path / f"{name}.yaml" for name in names}
    with folder.kept_if_recorded():
        for number, name in enumerate(names):
            data = {"schema": "train_ato/scenario/1", **file.scenario_of(number)}
            if number:
                data["leader"] = {**data.get("leader", {}), "train": f"/{names[number - 1]}"}
            write_whole(found[name], yaml.safe_dump(data, sort_keys=False))
    return found, folder


def run_following_live(
    file: FollowingFile, out: Path, options: Sequence[str] = (), domain: int | None = None
) -> FollowingResult:
    """Run all trains at the same time; the first failure of a program ends the others.

    Parameters
    ----------
    file
        Checked following file.
    out
        Folder to make, with scenario, messages and run folder of each train, and the common summary.
    options
        Further options of ``train-ato run`` for every train.
    domain
        ROS domain; None: as for a run.

    Raises
    ------
    ValueError
        Bad input, before the first program.
    RunFailed, RunInterrupted
        If a train fails, by its name.
    """
    name = "--domain" if domain is not None else "ROS_DOMAIN_ID"
    wanted = domain if domain is not None else domain_of_environment()
    with claim_domain(wanted, name) as held, claim_domain(held, namespace=TRAINS):
        scenarios, folder = write_live_scenarios(file, out)
        with folder.kept_if_recorded():
            _run_programs(scenarios, folder, options, held)
            return result_of(file.spec, {name: open_run(out / name) for name in scenarios}, out)


def _run_programs(scenarios: dict[str, Path], folder: RunFolder, options: Sequence[str], domain: int) -> None:
    """Run a program for every train."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([_PACKAGE_ROOT, os.environ.get("PYTHONPATH", "")])}
    out, last = folder.path, [*scenarios][-1]
    print_domain(domain)
    programs = {}
    for name, path in scenarios.items():
        words = ["run", str(path), f"--namespace=/{name}", f"--domain={domain}", f"--out={out / name}", *options]
        words += [] if name == last else ["--followed"]
        with path.with_suffix(".txt").open("wb") as said:
            programs[name] = subprocess.Popen(
                [sys.executable, "-m", "train_ato", *words], env=environment,
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=said,
            )  # fmt: skip
    with interruptible() as interrupt:
        failed = _wait(programs, interrupt)
    if interrupt.asked:
        raise RunInterrupted(f"interrupted; recorded data: {out}" if folder.recorded else "interrupted")
    if failed:
        lines = scenarios[failed].with_suffix(".txt").read_text(errors="replace").splitlines()
        reason = next((line for line in reversed(lines) if line.startswith(_SAYS)), "").removeprefix(_SAYS)
        status = programs[failed].returncode
        ended = (
            f"its program ended with status {status}" if status > 0 else f"its program was killed by signal {-status}"
        )
        raise RunFailed(f"train {failed}: {reason or ended}")


def _wait(programs: dict[str, subprocess.Popen[bytes]], interrupt: Interrupt) -> str:
    """Wait for all programs; return the name of the first that failed, "" without one, and end the others then."""
    failed, ended = "", False
    try:
        while any(program.poll() is None for program in programs.values()):
            time.sleep(_LOOK_S)
            failed = failed or next((name for name, program in programs.items() if program.poll()), "")
            if (failed or interrupt.asked) and not ended:
                ended = True
                for program in programs.values():
                    program.send_signal(signal.SIGINT)
    finally:
        for program in programs.values():
            if program.poll() is None:
                program.kill()
                program.wait()
    return failed or next((name for name, program in programs.items() if program.poll()), "")
