"""``train-ato run``: run a scenario, record it, compute its metrics, draw it.

Options::

    scenario SCENARIO  a shipped scenario, NAME:variant, shipped following trains, or a YAML file of either
    --observer         and --compensation, --seed, --set: changes of the scenario
    --law NAME         control law: a name, or MODULE:CLASS without registration
    --engine           plain Python loop without ROS, same log
    --processes        one process for each node (default: all nodes in one)
    --restart          with --processes: restart a node whose process ends
    --restart-limit N  restarts of each node, then the run fails (default: {limit})
    --external NODE    wait for a program of yours in place of this node: controller, observer, profile, supervisor or
                       plant
    --rate             simulated seconds per second of wall time
    --no-lockstep      do not wait for late commands
    --out DIR          run folder to make (default: runs/NAME-N)
    --compression      compression of the log
    --strict           exit status 1 if the run is not tracked (lost, limit cycle, stopped short, ...) or fails a
                       criterion
    --start-limit S    wall time for the nodes to find each other, or none (default: 30, with --processes 180,
                       --external none)
    --domain N         ROS domain, 0 to 232 (default: ROS_DOMAIN_ID, or a free one)
    --namespace /NAME  namespace of all nodes, for one of several trains in a domain: /t1
    --followed         wait for the train behind
    --live             run following trains at the same time, a program each with live reports in one ROS domain
"""

from __future__ import annotations

import argparse
import gc
import math
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.cli.scenario_options import add_change_options, prepare_from
from train_ato.log.compression import add_compression
from train_ato.program.arguments import Options, add_followed, add_no_lockstep, add_rate, parse_limit, rate_of
from train_ato.program.errors import RunFailed

if TYPE_CHECKING:
    from train_ato.api.drive import RunMode
    from train_ato.api.following import FollowingResult
    from train_ato.api.run import Run
    from train_ato.scenario.criteria import Expectation
    from train_ato.scenario.following import FollowingFile
    from train_ato.scenario.setup import RunSetup

LIMIT = 3
EXPLAINED = "msgs_docs/report.md, Output of a run"
"""Page that explains every line of the output."""

OPTIONS: Options = {
    "--observer": add_change_options,
    "--engine": {"one_of": "mode"},
    "--processes": {"one_of": "mode"},
    "--restart-limit": {"words": {"limit": LIMIT}},
    "--rate": add_rate,
    "--no-lockstep": add_no_lockstep,
    "--compression": add_compression,
    "--start-limit": {"type": parse_limit},
    "--namespace": {"default": ""},
    "--followed": add_followed,
}


def restart_limit(*, wanted: bool, limit: int | None) -> int:
    """Return the permitted number of restarts of each node; 0 without restarts."""
    if not wanted and limit is not None:
        raise ValueError(f"--restart-limit {limit}: nothing is restarted; add --restart")
    if limit is not None and limit < 1:
        raise ValueError(f"--restart-limit {limit}: give 1 or more, or remove --restart")
    return (limit or LIMIT) if wanted else 0


def _run_mode(options: argparse.Namespace) -> RunMode:
    """Return the checked mode of the options, and check their folder."""
    from train_ato.api.drive import RunMode
    from train_ato.log.run_folder import check_free
    from train_ato.program.errors import check_packages

    check_packages("run", "matplotlib")  # of the figure at the end
    mode = "engine" if options.engine else "processes" if options.processes else "composed"
    restarts = restart_limit(wanted=options.restart, limit=options.restart_limit)
    run_mode = RunMode(
        mode, rate_of(options), options.lockstep, options.domain, options.compression, restarts, options.start_limit,
        options.external, options.namespace, options.followed,
    )  # fmt: skip
    run_mode.check("--")
    if options.out is not None:
        check_free(options.out)
    return run_mode


def prepared(options: argparse.Namespace) -> tuple[RunSetup, RunMode, Path]:
    """Return the checked run, its mode and its folder; imports are late, so that help and completion are fast."""
    from train_ato.log.run_folder import next_free
    from train_ato.scenario.setup import without_effect

    run_mode = _run_mode(options)
    setup = prepare_from(options)
    run_mode.check_setup(setup, "--")
    for advice in dict.fromkeys((setup.advice(), without_effect(setup.scenario))):  # that of a driver's run is both
        sys.stderr.write(f"train-ato: {advice}\n" if advice else "")
    if run_mode.mode != "engine":
        from train_ato.ros.graph.environment import opened_by

        if opened := opened_by():
            sys.stderr.write(f"train-ato: other hosts may join this run ({opened})\n")
    return setup, run_mode, options.out if options.out is not None else next_free(setup.scenario.name)


def execute(options: argparse.Namespace) -> None:
    """Run one scenario, or the trains of a following file."""
    from train_ato.scenario.following import find_following

    if (file := find_following(options.scenario)) is not None:
        _execute_following(options, file)
        return
    if options.live:
        raise ValueError(f"--live: {options.scenario} has one train; remove it, or name following trains")
    from train_ato.api.drive import drive
    from train_ato.api.progress import COMPILE_NOTE, compilation_noted
    from train_ato.judge.verdict import unmet_requirements
    from train_ato.scenario.scenario import expectation_of

    setup, run_mode, out = prepared(options)
    gc.freeze()  # most objects live until the end; after an engine run a look at them at the exit takes 0.2 s
    with compilation_noted(COMPILE_NOTE):
        changes = (options.assignments, options.law, options.observer, options.compensation, options.seed)
        expected, said = None if any(changes) else expectation_of(options.scenario), setup.advice()
        ended = partial(_print_end, as_json=options.json, expected=expected, said=said)
        run = drive(setup, run_mode, out=out, option="--out", ended=ended)
    if options.strict and (unmet := unmet_requirements(run.metrics)):
        raise RunFailed(f"{run.path}: {unmet}")


def _execute_following(options: argparse.Namespace, file: Path) -> None:
    """Run trains behind each other."""
    from train_ato.api.following import run_following
    from train_ato.api.progress import COMPILE_NOTE, compilation_noted
    from train_ato.judge.verdict import unmet_requirements
    from train_ato.log.run_folder import next_free
    from train_ato.scenario.following import load_following

    for name in ("law", "observer", "compensation", "external"):
        if (value := getattr(options, name)) is not None:
            remedy = "remove it" if name == "external" else f"write --set all.{name}={value}"
            raise ValueError(f"--{name} {value}: a following file has several trains; {remedy}")
    for name in ("restart", "restart_limit", "namespace", "followed"):
        value = getattr(options, name)
        if value or (value is not None and name == "restart_limit"):
            raise ValueError(f"--{name.replace('_', '-')}: not with a following file; remove it")
    run_mode = _run_mode(options)
    if options.live and options.engine:
        raise ValueError("--live: the engine has no nodes, and trains meet in a ROS domain; remove it or --engine")
    trains = load_following(file, tuple(options.assignments), options.seed)
    out = options.out if options.out is not None else next_free(trains.spec.name)
    with compilation_noted(COMPILE_NOTE):
        result = _run_live(trains, run_mode, out) if options.live else run_following(trains, run_mode, out)
    print_following(result.summary, out, as_json=options.json)
    unmet = [f"{row['name']}: {text}" for row in result.summary["trains"] if (text := unmet_requirements(row))]
    if options.strict and (unmet := result.summary["broken"] or unmet):
        raise RunFailed(f"{out}: {unmet[0]}")


def _run_live(trains: FollowingFile, run_mode: RunMode, out: Path) -> FollowingResult:
    """Run trains at the same time, each in the given mode."""
    from train_ato.api.following_live import run_following_live

    given = {"rate": run_mode.rate, "start-limit": run_mode.start_limit}
    words = [f"--{name}={value}" for name, value in given.items() if value is not None and math.isfinite(value)]
    words.append(f"--compression={run_mode.compression}")
    words += ["--processes"] if run_mode.mode == "processes" else []
    words += [] if run_mode.lockstep else ["--no-lockstep"]
    return run_following_live(trains, out, ("--start-limit=none", *words), run_mode.domain)


FOLLOWING_ROWS = (
    "tracking", "speed_rmse_kmh", "position_error_max_m", "gap_min_m", "contacts", "headway_error_max_m",
    "headway_error_rms_m", "headway_speed_error_max_kmh", "speed_amplification", "brake_interventions", "takeovers",
    "coupler_draft_max_kn", "coupler_buff_max_kn", "energy_traction_kwh",
)  # fmt: skip
"""Figures of every train of a following file."""


def print_following(summary: dict[str, Any], out: Path, *, as_json: bool) -> None:
    """Print the verdict with the broken requirements, and a column of figures for every train, advice on stderr."""
    from train_ato.cli.screen import print_json, print_table
    from train_ato.judge.metric_names import metric_heading

    for train in summary["trains"]:
        name, advice = train["name"], train.get("advice")
        if advice:
            advice = advice.replace("--compensation ", "--set compensation=").replace("--set ", f"--set {name}.")
            sys.stderr.write(f"train-ato: {name}: {advice}\n")
    if as_json:
        print_json({**summary, "run": str(out)})
        return
    trains = summary["trains"]
    reasons = [*summary["broken"], f"{summary['contacts']} contacts"]
    sys.stdout.write(f"{summary['verdict']}: " + "\n  ".join(reasons) + "\n")
    rows = [(metric_heading(key), *(train.get(key) for train in trains)) for key in FOLLOWING_ROWS]
    print_table(("metric", *(train["name"] for train in trains)), rows, summary["following"])
    folders = ", ".join(str(out / train["name"]) for train in trains)
    sys.stdout.write(f"a log of each train: {folders}; common summary: {out / 'summary.json'}\n")


def _print_end(run: Run, failure: RunFailed | None, *, as_json: bool, expected: Expectation | None, said: str) -> None:
    """Print result, failure and advice that was not ``said`` at the begin of a run, before its figure is drawn."""
    if expected is None and (advice := run.metrics.get("advice", said)) != said:
        sys.stderr.write(f"train-ato: {advice}\n")
    print_run(run, as_json=as_json, failure="" if failure is None else str(failure), expected=expected)
    sys.stdout.flush()
    if failure is not None:
        from train_ato.cli.main import FAILED, print_error

        print_error(failure, FAILED)
        failure.printed = True


def print_run(run: Run, *, as_json: bool, failure: str = "", expected: Expectation | None = None) -> None:
    """Print the result, a failure first; brake interventions, takeovers or a disengaged ATO have a line on stderr.

    An expected verdict has a line if it is not ``passed``, or not the verdict of the run.
    """
    from train_ato.cli.screen import print_json, print_table
    from train_ato.judge.metric_names import result_rows
    from train_ato.judge.protection_record import protection_note
    from train_ato.judge.verdict import three_digits, verdict_line
    from train_ato.report.words import driven_laws

    summary: dict[str, Any] = {**run.metrics, "run": str(run.path)}
    if failure and not as_json:
        sys.stdout.write(f"failed: {failure}\n")
    if note := protection_note(summary, summary["run"]):
        sys.stderr.write(f"train-ato: {note}\n")
    if as_json:
        print_json(summary)
        return
    if line := verdict_line(summary):
        sys.stdout.write(f"{line}\n")
    if expected is not None and (expected.verdict, summary.get("verdict")) != ("passed", "passed"):
        sys.stdout.write(f"expected verdict of this scenario: {expected.text}\n")
    head = f"{summary['scenario']}  {driven_laws(summary)} / {summary['observer']} / {summary['compensation']}"
    print_table(("metric", "value"), result_rows(summary), head)
    if held := summary.get("held_steps"):
        sys.stdout.write(f"in {held} ticks the last command was repeated: no valid command or measurement\n")
    factor, step = summary.get("real_time_factor"), summary.get("step_time_us_median")
    speed = (f" ({three_digits(factor)} times real time" if factor else "") + (
        f", {step:.0f} µs per step of the law" if step else ""
    )
    slowest, tick = summary.get("step_time_us_p99") or 0.0, summary.get("simulated_s", 0.0) / max(summary["ticks"], 1)
    if slowest * 1e-6 > tick:  # in lockstep the train waits for the law
        speed += f", one step in 100 longer than {three_digits(slowest * 1e-6)} s, at a tick of {three_digits(tick)} s"
    end = f"{summary['ticks']} ticks in {summary['wall_s']:.1f} s{speed}{')' if speed else ''}; recorded in {run.path}"
    sys.stdout.write(f"{end}\nevery line is explained in {EXPLAINED}\n")
