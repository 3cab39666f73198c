"""Ctrl-C, SIGTERM and a closed terminal: every command ends with one line and leaves no incomplete result."""

import ctypes
import gc
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from programs import begun, python
from waiting import LIMIT_S, pause, wait_for

from train_ato.api.progress import COMPILE_NOTE, PLANNER_NOTE
from train_ato.cli.main import LEFT_S, main
from train_ato.program.interrupt import Interrupt, ending_like_ctrl_c, no_silent_exit
from train_ato.scenario.scenario import load_scenario

ENDED = (1, -signal.SIGINT)
"""Ctrl-C while a command loads ends it by SIGINT without a line: exit status 130 in a shell."""


@contextmanager
def started(folder: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Start a command in a session and a folder of its own, as a terminal does; nothing of it lives longer."""
    (folder / "scratch").mkdir()
    environment = {**os.environ, "TMPDIR": str(folder / "scratch"), "MARK": str(folder)}
    process = begun(*arguments, cwd=folder, env=environment, start_new_session=True)
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate(timeout=LIMIT_S)


def descendants(folder: Path) -> list[str]:
    """Return the remaining processes of the command, by the mark in their environment."""
    mark, found = f"MARK={folder}\0".encode(), []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                if mark in (entry / "environ").read_bytes():
                    found.append((entry / "cmdline").read_text())
            except OSError:
                continue
    return found


REPRODUCE = ["reproduce", "002", "--out", "out"]
RUN = ["run", "demo", "--engine", "--rate", "20", "--out", "out"]


@pytest.mark.graph
@pytest.mark.parametrize(
    ("arguments", "number"),
    [
        pytest.param(["compare", "demo", "--laws", "pid,smc,mpc,lag_smc", "--out", "out"], signal.SIGINT, id="compare"),
        pytest.param(REPRODUCE, signal.SIGINT, id="reproduce"),
        pytest.param(REPRODUCE, signal.SIGTERM, id="reproduce-term"),
        pytest.param(RUN, signal.SIGINT, id="run"),
        pytest.param(RUN, signal.SIGHUP, id="run-hup"),
    ],
)
def test_the_end_is_one_line(arguments: list[str], number: signal.Signals, tmp_path: Path) -> None:
    """Breaks on a traceback, a warning, a running worker, a scratch folder or an incomplete folder."""
    with started(tmp_path, *arguments) as process:
        wait_for(lambda: (tmp_path / "out").exists() or process.poll() is not None)
        pause(0.5)
        os.killpg(process.pid, number)
        out, err = process.communicate(timeout=LIMIT_S)
        assert process.returncode in ENDED, err
        assert out == "" or arguments[0] == "run"
        # The first run on a machine prints lines on compilation first.
        lines = [line for line in err.splitlines() if line not in (COMPILE_NOTE, PLANNER_NOTE)]
        assert len(lines) == 1, err
        assert lines[0].startswith("train-ato: interrupted")
        wait_for(lambda: not descendants(tmp_path))
    assert list((tmp_path / "scratch").iterdir()) == []
    left = {path.name for path in tmp_path.iterdir()} - {"scratch"}
    whole_run = left == {"out"} and "recorded data: out" in err and (tmp_path / "out" / "run.mcap").exists()
    assert not left or whole_run, left


SEARCH = ("xuzhou_metro", "--set=duration=10", "--runs=6000", "--out=out")


@pytest.mark.graph
@pytest.mark.parametrize("jobs", ["1", "2"])
@pytest.mark.parametrize(
    ("command", "table"),
    [
        (("tune", *SEARCH, "--law=smc", "--parameters=l1,ks"), "history.csv"),
        (("falsify", *SEARCH, "--requirement=G speed_error >= -50 km/h", "--over=o.yaml"), "runs.csv"),
    ],
)
def test_an_interrupted_search_keeps_its_results(
    command: tuple[str, ...], table: str, jobs: str, tmp_path: Path
) -> None:
    """Breaks if Ctrl-C loses the runs or the best gains, prints a traceback or leaves a worker behind."""
    (tmp_path / "o.yaml").write_text("over: {plant.mismatch.mass_scale: {from: 0.9, to: 1.3}}")
    out, runs = tmp_path / "out", tmp_path / "out" / (table if command[0] == "tune" else "runs.jsonl")
    with started(tmp_path, *command, "--jobs", jobs) as process:
        wait_for(lambda: process.poll() is not None or (runs.is_file() and runs.read_text().count("\n") >= 3))
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=LIMIT_S)
        assert process.returncode == 1 and "Traceback" not in err, err
        assert re.match("train-ato: interrupted(; results so far| after )", err.splitlines()[-1]), err
        wait_for(lambda: not descendants(tmp_path))
    assert json.loads((out / f"{command[0]}.json").read_text())["interrupted"] is True
    assert (out / table).read_text().count("\n") >= 3
    assert command[0] == "falsify" or load_scenario(str(out / "tuned.yaml"))[0].laws["smc"]


def test_ctrl_c_in_a_callback_from_c_is_not_lost() -> None:
    """Breaks if a command continues after a Ctrl-C in a callback of the compiler, where Python drops it."""

    def press() -> None:
        signal.raise_signal(signal.SIGINT)
        pause(0.01)

    def wait() -> None:
        ctypes.CFUNCTYPE(None)(press)()
        pause(LIMIT_S)

    with ending_like_ctrl_c(Interrupt()), pytest.raises(KeyboardInterrupt):
        wait()


@pytest.mark.parametrize("made_of_it", [RuntimeError, ValueError, SystemError, OSError])
def test_an_error_that_a_library_makes_of_ctrl_c_is_ctrl_c(made_of_it, monkeypatch, capsys):
    """Breaks if Ctrl-C in a compiler or validator is reported as an error of this library or as bad input."""

    def execute(options: object) -> int:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise made_of_it("no compiled object yet") from None
        return 0

    monkeypatch.setattr("train_ato.cli.list.execute", execute)
    assert main(["list"]) == 1 and capsys.readouterr().err == "train-ato: interrupted\n"


@pytest.mark.parametrize("interrupted", [True, False])
def test_destructors_of_incomplete_objects_print_nothing_after_ctrl_c(interrupted, monkeypatch):
    """Breaks if a compiler's incomplete object prints a traceback after Ctrl-C, or every such error is hidden."""

    class Incomplete:
        def __del__(self) -> None:
            raise AttributeError("no compiled object yet")

    def execute(options: object) -> int:
        incomplete = Incomplete()
        if interrupted:
            signal.raise_signal(signal.SIGINT)
        del incomplete
        return 0

    printed: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", printed.append)
    monkeypatch.setattr("train_ato.cli.list.execute", execute)
    assert main(["list"]) == int(interrupted)
    gc.collect()
    assert len(printed) == int(not interrupted)


@pytest.mark.parametrize("moment", [0.4, 0.8, 1.6])
def test_a_plan_is_interrupted_at_any_moment(moment: float, tmp_path: Path) -> None:
    """Compiled code converts Ctrl-C into its own exception; breaks if the user sees it."""
    arguments = ("plan", "highspeed_286km", "crh380a_one_mass", "--time", "4000", "--out", "plan.csv")
    with started(tmp_path, *arguments) as process:
        pause(moment)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=LIMIT_S)
    if "init_import_site" in err:
        pytest.skip("Ctrl-C fell into the start of Python itself")
    assert "Traceback" not in err
    if process.returncode == 0:
        assert "plan.csv" in out
    else:
        quiet = process.returncode == -signal.SIGINT and not err
        assert quiet or (process.returncode in ENDED and err.splitlines()[-1] == "train-ato: interrupted")
        assert out == ""


@pytest.mark.parametrize(
    ("program", "traced"), [("bin/train-ato", False), ("-m", False), ("plant_node", False), ("mine.py", True)]
)
def test_ctrl_c_while_a_command_loads_has_no_traceback(program: str, traced: bool) -> None:
    """Breaks if Ctrl-C in the first imports prints a traceback, or a program that uses the package loses it."""
    words = f"sys.argv, sys.orig_argv = ['{program}'], ['python', '-m', 'train_ato']"
    code = f"import signal, sys; {words}; import train_ato; signal.raise_signal(signal.SIGINT)"
    done = python("-c", code)
    assert (done.returncode, "KeyboardInterrupt" in done.stderr) == (-signal.SIGINT, traced)


def test_nohup_is_respected(tmp_path: Path) -> None:
    """Breaks if a closed terminal ends a command that ignores its signal, as with nohup."""
    code = (
        "import signal, sys; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "from train_ato.program.interrupt import Interrupt, ending_like_ctrl_c, interruptible\n"
        "with ending_like_ctrl_c(Interrupt()), interruptible() as interrupt:\n"
        "    signal.raise_signal(signal.SIGHUP)\n"
        "    assert not interrupt.asked\n"
        "    signal.raise_signal(signal.SIGTERM)\n"
        "    assert interrupt.asked\n"
    )
    assert (done := python("-c", code, folder=tmp_path)).returncode == 0, done.stderr


LAWS = """
import os, sys, time
from pathlib import Path
from train_ato.control.laws.pid import Pid

class Ends(Pid):
    def step(self, inputs):
        while inputs.t > 1.0:
            {then}
        return super().step(inputs)
"""
"""Module of a law that does not return after 1 s."""


@pytest.mark.parametrize(
    ("mode", "end"),
    [
        *itertools.product(("--engine", "--composed"), ("sys.exit(0)", "os._exit(0)")),
        ("--engine", "os.execl('/bin/true', 'true')"),
        ("--processes", "os.execv('/bin/true', ['true'])"),
    ],
)
def test_a_law_that_exits_fails_the_run(mode: str, end: str, tmp_path: Path) -> None:
    """Breaks if the end of the process in a law ends a run with status 0, or the message does not name the law."""
    if mode != "--engine":
        pytest.importorskip("rclpy")
    (tmp_path / "own_laws.py").write_text(LAWS.format(then=end))
    options = [] if mode == "--composed" else [mode]
    with started(tmp_path, "run", "demo", *options, "--law", "own_laws:Ends", "--out", "out") as process:
        _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 1
    call = end.partition(",")[0].rstrip(")").replace("execl", "execv")
    line = 1 + LAWS[: LAWS.index("{then}")].count("\n")
    assert re.search(rf"node controller failed: law Ends: called {re.escape(call)}\), \S*own_laws\.py:{line}\b", err)
    assert "Traceback" not in err and (tmp_path / "out" / "summary.json").is_file()


@pytest.mark.parametrize(("end", "kind"), [("sys.exit(0)", "SystemExit"), ("os._exit(0)", "ProcessExit")])
def test_a_module_that_exits_is_refused(end, kind, tmp_path, monkeypatch, capsys):
    """Breaks if the end of the process at the import or in the constructor of a law ends the command."""
    (tmp_path / f"{kind.lower()}_law.py").write_text(f"import os, sys; {end}")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert main(["run", "demo", "--engine", "--law", f"{kind.lower()}_law:Law"]) == 2
    assert f"module '{kind.lower()}_law' cannot be imported: called {end}, " in capsys.readouterr().err
    made = f"import os, sys\nclass Law:\n    def __init__(self):\n        {end}\n    def reset(self):\n        pass\n"
    (tmp_path / f"{kind.lower()}_made.py").write_text(f"{made}    def step(self, inputs):\n        pass\n")
    assert main(["run", "demo", "--engine", "--law", f"{kind.lower()}_made:Law"]) == 2
    assert f"law Law: called {end}, {tmp_path / kind.lower()}_made.py:4\n" in capsys.readouterr().err


def test_a_thread_from_before_the_run_may_end_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the worker of a library whose parent is gone stays, or a thread that the run begins ends it."""
    ended: list[str] = []
    monkeypatch.setattr(os, "_exit", sys.exit)
    in_run = threading.Event()

    def end(name: str) -> None:
        in_run.wait()
        try:
            os._exit(1)
        except SystemExit as error:
            ended.append(f"{name}: {type(error).__name__}")

    threads = [threading.Thread(target=end, args=("before",))]
    threads[0].start()
    with no_silent_exit():
        threads.append(threading.Thread(target=end, args=("within",)))
        threads[1].start()
        in_run.set()
        for thread in threads:
            thread.join(timeout=LIMIT_S)
    assert sorted(ended) == ["before: SystemExit", "within: ProcessExit"]


def test_a_thread_of_a_law_that_goes_on_is_named(tmp_path: Path) -> None:
    """Breaks if a complete run seems to hang: Python waits for the thread before the process ends."""
    goes_on = f"def goes_on():\n    threading.main_thread().join()\n    time.sleep({2.5 * LEFT_S})\n"
    begins = "threading.Thread(target=goes_on, name='my server').start()"
    law = "from train_ato.control.laws.pid import Pid as Law"
    (tmp_path / "served.py").write_text(f"import threading, time\n{law}\n{goes_on}{begins}\n")
    with started(
        tmp_path, "run", "demo", "--engine", "--set=duration=1", "--law", "served:Law", "--out", "out"
    ) as process:
        _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0
    assert "train-ato: ended, but a thread of a law or another component goes on: my server; start it with" in err


@pytest.mark.parametrize("then", ["time.sleep(1000)", "pass"], ids=["sleeps", "loops"])
@pytest.mark.parametrize("mode", ["--engine", "--composed"])
def test_ctrl_c_ends_a_law_that_does_not_return(mode: str, then: str, tmp_path: Path) -> None:
    """Breaks if Ctrl-C waits for the end of a step that never ends, or the message does not name the law."""
    if mode != "--engine":
        pytest.importorskip("rclpy")
    (tmp_path / "own_laws.py").write_text(LAWS.format(then=f'Path("hangs").touch(); {then}'))
    options = [] if mode == "--composed" else [mode]
    with started(tmp_path, "run", "demo", *options, "--law", "own_laws:Ends", "--out", "out") as process:
        wait_for((tmp_path / "hangs").exists, "a law that does not return")
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 1
    assert "node controller failed: law 'own_laws:Ends' did not return; Ctrl-C ended it" in err
    assert (tmp_path / "out" / "summary.json").is_file()


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGTERM, 128 + signal.SIGTERM), (signal.SIGINT, -signal.SIGINT)]
)
def test_a_signal_ends_the_script_of_two_runs(number: signal.Signals, status: int, tmp_path: Path) -> None:
    """Breaks if the first run swallows the signal and the script goes on, or its log is not closed."""
    script = tmp_path / "two_runs.py"
    script.write_text(
        "import os, sys\n"
        "from pathlib import Path\n"
        "from train_ato.log.run_folder import RunFolder\n"
        "from train_ato.loop.engine import run_engine\n"
        "from train_ato.scenario.setup import prepare\n"
        "from train_ato.scenario.scenario import load_scenario\n"
        "setup = prepare(*load_scenario('demo', ('duration=20',)))\n"
        "for name in ('one', 'two'):\n"
        "    with RunFolder.make(Path(name), name).sink(setup) as sink:\n"
        f"        run_engine(setup, sink=sink, compiled=False, progress=lambda p: os.kill(os.getpid(), {number:d}))\n"
    )
    ended = python(str(script), folder=tmp_path)
    assert ended.returncode == status, ended.stderr
    assert (tmp_path / "one" / "run.mcap").is_file() and not (tmp_path / "two").exists()
    assert number == signal.SIGINT or ended.stderr == ""


def test_the_first_worker_of_a_program_gets_no_ctrl_c(tmp_path: Path) -> None:
    """Breaks if the start of the resource tracker of multiprocessing unblocks Ctrl-C for the worker that follows."""
    script = tmp_path / "workers.py"
    script.write_text(
        "import multiprocessing, signal, threading\n"
        "from train_ato.program.interrupt import workers_without_ctrl_c\n"
        "def work():\n"
        "    print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []), flush=True)\n"
        "def start():\n"
        "    process = multiprocessing.get_context('spawn').Process(target=work)\n"
        "    process.start()\n"
        "    process.join()\n"
        "if __name__ == '__main__':\n"
        "    with workers_without_ctrl_c():\n"
        "        thread = threading.Thread(target=start)\n"  # the pools start their workers in a thread
        "        thread.start()\n"
        "    thread.join()\n"
    )
    found = python(str(script), folder=tmp_path)
    assert (found.returncode, found.stdout) == (0, "True\n"), found.stderr
