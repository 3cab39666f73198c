"""Run a scenario: in the engine, as ROS nodes in one process, or as a process for each node."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from train_ato.api.progress import progress_bar
from train_ato.api.run import Run, RunRecord
from train_ato.api.scenario_choice import Changes, GivenScenario, choose_scenario, given_objects, put_components
from train_ato.judge.result import RunResult
from train_ato.log.compression import DEFAULT
from train_ato.log.run_folder import RunFolder, next_beside
from train_ato.log.versions import SCENARIO
from train_ato.loop.engine import run_engine
from train_ato.messages.topics import EXTERNAL
from train_ato.program.errors import RunFailed, RunInterrupted
from train_ato.program.interrupt import interruptible, no_silent_exit
from train_ato.ros import require_ros
from train_ato.scenario.leader import check_namespace
from train_ato.scenario.setup import RunSetup

if TYPE_CHECKING:
    from train_ato.api.env.observation import OnTick, StopWhen, TickCalls

Mode = Literal["engine", "composed", "processes"]
MODES = ("engine", "composed", "processes")


def run(
    scenario: GivenScenario,
    *,
    law: Any = None,
    observer: Any = None,
    compensation: Any = None,
    set: Changes | None = None,
    seed: int | None = None,
    mode: Mode = "engine",
    out: str | Path | None = None,
    progress: bool | None = None,
    rate: float | None = None,
    lockstep: bool = True,
    restarts: int = 0,
    domain: int | None = None,
    external: str | None = None,
    on_tick: OnTick | None = None,
    stop_when: StopWhen | None = None,
) -> Run:
    """Run a scenario and return the run.

    Parameters
    ----------
    scenario
        Shipped name, ``name:variant``, a YAML file, or :func:`train_ato.scenario`.
    law
        Control law: a registered name, ``"module:Class"``, a law class, or a law object such as ``MyLaw(gain=0.1)``
        (see :mod:`train_ato.control.contract`). The object itself runs, except in other processes. Default: the law of
        the scenario.
    observer, compensation
        Disturbance observer and delay compensation, each in the forms of ``law``; default: those of the
        scenario.
    set
        Other keys of the scenario, as for ``train-ato run --set``: ``{"laws.smc.ks": 0.0}``.
    seed
        Seed of every random stream.
    mode
        ``"engine"``: a plain loop without ROS; ``"composed"``: ROS nodes in this process; ``"processes"``: a process
        for each node. The numbers are the same, bit for bit.
    out
        Run folder to make; default: none, :meth:`Run.save` makes one later.
    progress
        Show a progress bar; default: in a terminal and in a notebook.
    rate
        Maximum simulated seconds per second of wall time; default: as fast as possible, without lockstep 1.
    lockstep
        False: the graph does not wait for commands. A late command is counted, and the train keeps the last one
        meanwhile.
    restarts
        With a process for each node: maximum number of restarts of each node; default: none, the run fails with a node.
    domain
        ROS domain of a graph; default: the domain of ``ROS_DOMAIN_ID``, or a free domain without this variable.
    external
        Node of the graph in whose place a program of yours runs: ``"controller"``, ``"observer"``, ``"profile"``,
        ``"supervisor"``, or with ``"composed"`` ``"plant"``.
    on_tick
        Called in every tick before the law, with the observation of :class:`train_ato.Env` by name. It can return
        numbers by name, which are in the log as diagnostics ``signals``. Only in the engine.
    stop_when
        Called with the same; True ends the run after this tick, with the status ``interrupted``. Only in the engine.

    Returns
    -------
    Run
        Metrics, tables by topic, plots.

    Raises
    ------
    ValueError
        Bad input, in one line with the remedy; nothing was started.
    RunFailed
        The run failed; the exception's ``run`` has the record up to the failure and the traceback, or is None if only
        the run folder exists.
    RunInterrupted
        Ctrl-C ended the run; also with ``run``. It is a ``RunFailed`` and a ``KeyboardInterrupt``.

    Examples
    --------
    >>> import train_ato as ta
    >>> run = ta.run("demo", law="smc", set={"laws.smc.ks": 0.0, "duration": 20})
    >>> run.metrics["controller"], run.metrics["simulated_s"]
    ('smc', 20.0)
    >>> run["ato/command"].columns.tolist()
    ['unit_0_force_n']
    >>> signals = lambda obs: {"ahead": obs["position_error"][0]}
    >>> run = ta.run("demo", on_tick=signals, stop_when=lambda obs: obs["time"] > 1)
    >>> run.metrics["ticks"], run.recording.reported("signals", "ahead")[0].size
    (12, 12)
    """
    run_mode = RunMode(mode, rate, lockstep, domain, restarts=restarts, external=external)
    run_mode.check()
    choice = choose_scenario(scenario).changed(set, seed)
    parts = {"law": law, "observer": observer, "compensation": compensation}
    checked = put_components(choice.checked, importable=mode == "processes", changes=set, **parts)
    objects = given_objects(checked, **parts)
    if objects and mode == "processes":
        sys.stderr.write(
            f"train-ato: mode 'processes': another process has no access to an object of this one; it makes its own "
            f"{' and '.join(objects)} with the same keywords\n"
        )
        objects = {}
    setup = replace(choice.prepare(checked), given=objects)
    calls = None
    if on_tick is not None or stop_when is not None:
        if mode != "engine":
            raise ValueError(f"mode '{mode}': on_tick and stop_when need the engine; remove them or the mode")
        from train_ato.api.env.observation import TickCalls

        calls = TickCalls(setup, on_tick, stop_when)
    return drive(setup, run_mode, out=None if out is None else Path(out), shown=progress, calls=calls)


@dataclass(frozen=True)
class RunMode:
    """Mode and rate of a run.

    Attributes
    ----------
    mode : str
        One of ``MODES``.
    rate : float or None
        Maximum simulated seconds per second of wall time; None is as fast as possible, without lockstep 1.
    domain : int or None
        ROS domain; None takes that of ``ROS_DOMAIN_ID``, without it a free one.
    lockstep, compression, restarts, start_limit, external, namespace, followed
        As in :class:`~train_ato.ros.graph.graph_result.GraphOptions`.  The engine is always in lockstep.
    """

    mode: str = "engine"
    rate: float | None = None
    lockstep: bool = True
    domain: int | None = None
    compression: str = DEFAULT
    restarts: int = 0
    start_limit: float | None = None
    external: str | None = None
    namespace: str = ""
    followed: bool = False

    def check(self, dash: str = "") -> None:
        """Check the values; ``dash`` precedes the names in messages."""
        if self.mode not in MODES:
            raise ValueError(f"{dash}mode {self.mode!r}: choose from {', '.join(MODES)}")
        if self.rate is not None and not 0 < self.rate < float("inf"):
            raise ValueError(f"{dash}rate {self.rate}: give a number above 0, 1 for real time")
        if self.mode == "engine" and not self.lockstep:
            given = "--no-lockstep: remove it or --engine" if dash else "lockstep=False: remove it, or choose a graph"
            raise ValueError(f"{given}; the engine is always in lockstep")
        if self.restarts < 0:
            raise ValueError(f"restarts {self.restarts}: give 1 or more, or 0 for none")
        if self.restarts and self.mode != "processes":
            raise ValueError(
                f"{dash}restart: only a node in a process of its own can be restarted; add {dash}processes"
            )
        if self.external is not None and self.external not in EXTERNAL:
            raise ValueError(f"{dash}external {self.external!r}: choose from {', '.join(EXTERNAL)}")
        if self.external is not None and self.mode == "engine":
            given = f"{dash}engine" if dash else "mode 'engine', or choose 'composed' or 'processes'"
            raise ValueError(f"{dash}external {self.external}: the engine has no nodes; remove {given}")
        if self.external == "plant":
            self._check_external_plant(dash)
        if self.namespace or self.followed:
            self._check_namespace(dash)
        if self.mode == "engine":
            if self.domain is not None:
                raise ValueError(f"{dash}domain {self.domain}: the engine uses no ROS; remove it or {dash}engine")
            if self.start_limit is not None:
                raise ValueError(f"{dash}start-limit: the engine has no nodes; remove it or {dash}engine")
            return
        from train_ato.ros.graph.environment import check_domain

        check_domain(self.domain)
        require_ros()

    def _check_namespace(self, dash: str) -> None:
        """Refuse a namespace that ROS 2 does not have, without nodes, or in a domain without other trains."""
        if not self.namespace:
            raise ValueError(f"{dash}followed: the topic of the reports is in a namespace; add {dash}namespace")
        given = f"{dash}namespace {self.namespace}"
        try:
            check_namespace(self.namespace)
        except ValueError as error:
            raise ValueError(f"{dash}namespace {error}") from None
        if self.mode == "engine":
            raise ValueError(f"{given}: the engine has no nodes; remove it or {dash}engine")
        if self.domain is None and not os.environ.get("ROS_DOMAIN_ID"):
            raise ValueError(f"{given}: several trains share a domain; add {dash}domain or set ROS_DOMAIN_ID")

    def _check_external_plant(self, dash: str) -> None:
        """Refuse the options of the plant node."""
        no_lockstep = f"{dash}no-lockstep" if dash else "lockstep=False"
        options = {f"{dash}rate": self.rate is not None, no_lockstep: not self.lockstep}
        if self.restarts:
            raise ValueError(f"{dash}restart: an external plant does not wait for a new process; remove it")
        if wrong := next((name for name, set_ in options.items() if set_), ""):
            raise ValueError(f"{wrong}: the external plant is the source of time; remove it")

    def check_setup(self, setup: RunSetup, dash: str = "") -> None:
        """Refuse an absent external node, and restarts without supervision: nothing would stop the train meanwhile."""
        if self.mode == "engine" and setup.layout.behind and not setup.ahead:
            leader = setup.scenario.leader
            assert leader is not None
            given = f"remove {dash}engine" if dash else "choose mode 'composed' or 'processes'"
            raise ValueError(f"leader.train: {leader.train}: its reports come in a ROS domain; {given}")
        if self.restarts and not setup.layout.supervised:
            raise ValueError(
                f"{dash}restart: the run has no supervision, so nothing brakes the train while a node is away; "
                f"set supervision.enabled: true or remove {dash}restart"
            )
        if self.followed and not setup.layout.supervised:
            raise ValueError(f"{dash}followed: reports need a supervisor; set supervision.enabled: true")
        if self.external == "supervisor" and not setup.layout.supervised:
            raise ValueError(f"{dash}external supervisor: the run has none; set supervision.enabled: true")


def drive(
    setup: RunSetup,
    run_mode: RunMode,
    *,
    out: Path | None = None,
    shown: bool | None = None,
    title: str = "",
    option: str = "out",
    ended: Callable[[Run, RunFailed | None], None] | None = None,
    calls: TickCalls | None = None,
) -> Run:
    """Execute a prepared run and return it.

    Parameters
    ----------
    setup
        The run.
    run_mode
        Checked mode and rate.
    out
        Run folder to make; None records in memory or in a temporary folder.
    shown
        True: show a progress bar; None: in a terminal and in a notebook.
    title
        Text before the bar; default: name of the scenario.
    option
        Name of ``out`` in messages.
    ended
        Called with the run and its failure when log and summary are written, before the figure is drawn.
    calls
        Functions called in every tick of the engine.

    Raises
    ------
    ValueError, RunFailed, RunInterrupted
        As :func:`run`.
    """
    run_mode.check_setup(setup)
    folder = None if out is None else RunFolder.make(out, setup.scenario.name, option)
    try:
        record = RunRecord(setup, folder, run_mode.compression)
        from plant_sim.train import compile_kernel

        compile_kernel()
        with no_silent_exit():
            outcome = _driven(setup, run_mode, record, shown=shown, title=title or setup.scenario.name, calls=calls)
        if folder is not None and not (folder.path / SCENARIO).is_file():
            raise FileNotFoundError(folder.path)
        outcome = replace(outcome, summary={**outcome.summary, "mode": run_mode.mode, **_reach(run_mode)})
        result = Run(outcome.summary, record=record, setup=setup, outcome=outcome)
        stopped = outcome.domain is not None or (calls is not None and calls.stopped)
        failure = None if stopped and not outcome.failure else _failure(result, outcome, folder)
        if folder is not None:
            finish(result, outcome, None if ended is None else partial(ended, result, failure))
    except ValueError as error:
        if folder is not None and folder.recorded:
            raise RunFailed(f"{error}; recorded data: {folder.path}") from None
        _discard(folder)
        raise
    except OSError as error:
        if folder is None or folder.recorded:
            raise
        raise _unwritten(folder, option, error) from None
    except KeyboardInterrupt:
        if folder is None or not folder.recorded:
            _discard(folder)
            raise
        raise RunInterrupted(f"interrupted; recorded data: {folder.path}") from None
    if failure is not None:
        raise failure
    if outcome.domain is None:
        return result
    again, same = None if out is None else next_beside(out), replace(run_mode, domain=outcome.domain)
    place = "" if again is None else f" in {again}"
    sys.stderr.write(f"train-ato: {outcome.summary['interruption']}; it begins again{place}\n")
    return drive(setup, same, out=again, shown=shown, title=title, option=option, ended=ended, calls=calls)


def _failure(run: Run, outcome: RunResult, folder: RunFolder | None) -> RunFailed | None:
    """Return the error of a run that failed or was interrupted."""
    if outcome.failure:
        return RunFailed(outcome.failure, run)
    if outcome.interrupted:
        place = f"; recorded data: {folder.path}" if folder else ""
        return RunInterrupted(f"interrupted: {outcome.summary['interruption']}{place}", run)
    return None


def _unwritten(folder: RunFolder, option: str, error: OSError) -> RunFailed | ValueError:
    """Discard a folder without a record; return the error of its removal during the run, or of a failed write."""
    removed = folder.begun and not (folder.path / SCENARIO).exists()
    folder.discard()
    if not removed and "was removed" in str(error):  # the log alone
        return RunFailed(error)
    if removed:
        return RunFailed(f"{option} {folder.path}: was removed during the run; nothing is recorded")
    return ValueError(f"{option} {folder.path}: cannot be written ({error.strerror or error}); give a writable folder")


def finish(run: Run, outcome: RunResult, ended: Callable[[], None] | None = None) -> None:
    """Write summary and figure; if a failed run also filled the disk, report the original failure.

    ``ended`` is called between them.
    """
    told = False
    try:
        run.folder()
        try:
            if ended is not None:
                ended()
                told = True
        finally:  # also if the reader of the output has gone: `train-ato run demo | head -1`
            run.finish()
    except OSError:
        if not outcome.failure:
            raise
        failure = RunFailed(outcome.failure)
        failure.printed = told
        raise failure from None


def _reach(run_mode: RunMode) -> dict[str, str]:
    """Return the summary entry of a run that other hosts may join."""
    if run_mode.mode == "engine":
        return {}
    from train_ato.ros.graph.environment import opened_by

    return {"reach": "network"} if opened_by() else {}


def _discard(folder: RunFolder | None) -> None:
    if folder is not None:
        folder.discard()


def _driven(
    setup: RunSetup, run_mode: RunMode, record: RunRecord, *, shown: bool | None, title: str, calls: TickCalls | None
) -> RunResult:
    """Execute the run in its mode; the log is closed however the run ends."""
    with progress_bar(title, shown=shown) as progress:
        if run_mode.mode == "engine":
            try:
                with interruptible() as interrupt:
                    if record.lasting is not None:
                        record.begin_log()
                    outcome = run_engine(
                        setup,
                        sink=record,
                        progress=progress,
                        rate=run_mode.rate or 0.0,
                        log_folder=record.log_folder,
                        interrupt=interrupt,
                        on_tick=calls,
                    )
            finally:
                record.close_log()
            return record.counted(outcome)
        from train_ato.ros.graph.runner import run_graph

        same = ("lockstep", "domain", "compression", "restarts", "start_limit", "external", "namespace", "followed")
        options = {name: getattr(run_mode, name) for name in same}
        place, rate = record.folder().path, run_mode.rate or 0.0
        resets = run_mode.external is None and not run_mode.namespace
        return run_graph(setup, place, mode=run_mode.mode, progress=progress, rate=rate, resets=resets, **options)
