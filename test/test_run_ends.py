"""End of a run in every way: status, reason, exit status, outcome of tracking and log."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from train_ato.judge.recording import COMMAND, MEASUREMENT, REFERENCE, TRUTH
from train_ato.judge.result import RunResult
from train_ato.judge.run_end import RunEnd
from train_ato.judge.series import TopicSamples
from train_ato.judge.tracking import tracking_summary
from train_ato.judge.verdict import tracking_text, verdict_line
from train_ato.log.overview import log_overview
from train_ato.log.run_folder import RunFolder
from train_ato.loop.engine import run_engine
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare

ROLES = ("recorder", "supervisor", "profile", "observer", "controller", "plant")
DURATION = 60
FREE = ("--no-lockstep", "--rate=2", "--timeout=60")
PACED = ("--rate=2",)


@pytest.mark.parametrize(
    ("ticks", "failure", "interruption", "status", "reason"),
    [
        (10, None, None, "done", ""),
        (9, None, None, "interrupted", "ended after 9 of 10 ticks"),
        (0, None, None, "interrupted", "ended after 0 of 10 ticks"),
        (9, None, "stopped by SIGTERM", "interrupted", "stopped by SIGTERM"),
        (10, "node observer failed: it left", None, "failed", "node observer failed: it left"),
        (9, "node observer failed: it left", "stopped by SIGTERM", "failed", "node observer failed: it left"),
    ],
)
def test_a_run_with_fewer_ticks_than_planned_is_never_done(ticks, failure, interruption, status, reason):
    """Breaks if missing ticks count as a complete run, or the notice loses status, reason or ticks."""
    end = RunEnd.judged(ticks, 10, failure, interruption)
    assert (end.status, end.reason) == (status, reason)
    assert RunEnd.of(end.notice(5)) == end


@pytest.fixture(scope="module")
def whole():
    setup = prepare(*load_scenario("demo", ("duration=20",)))
    return setup, run_engine(setup).recording


def cut(recording, topic, keep):
    """Return the recording without the messages of a topic outside of ``keep``."""
    found = recording.topics[topic]
    rows = keep(found.time)
    short = TopicSamples(found.time[rows], {name: values[rows] for name, values in found.values.items()})
    return replace(recording, topics={**recording.topics, topic: short})


def test_a_command_missing_at_the_end_is_no_tracked_run(whole):
    """Breaks if the ticks after the last command are left out: the run of a lost controller is tracked."""
    setup, recording = whole
    short = cut(recording, COMMAND, lambda time: time < 4.95)
    assert short.time.size == 200
    assert tracking_summary(setup, recording)["tracking"] == "tracked"
    found = tracking_summary(setup, short)
    assert found["tracking"] == "no command"
    assert found["tracking_findings"][0]["value"] == pytest.approx(15.0)
    assert found["tracking_findings"][0]["text"] == "none in the last 15 s; 50 of 200 ticks had one"


def test_a_pause_of_the_commands_is_no_tracked_run(whole):
    """Breaks if only commands missing at the end count, ticks missing in the log, or short holes of a failed run."""
    setup, recording = whole
    pause = cut(recording, COMMAND, lambda time: (time < 4.95) | (time > 6.05))
    found = tracking_summary(setup, pause)["tracking_findings"]
    assert (found[0]["outcome"], found[0]["value"]) == ("no command", pytest.approx(1.1))
    assert found[0]["text"] == "none for 1.1 s from 5.00 s on; 189 of 200 ticks had one"
    hole = pause
    for topic in (MEASUREMENT, TRUTH, REFERENCE):
        hole = cut(hole, topic, lambda time: (time < 4.95) | (time > 6.05))
    assert hole.time.size == 189
    assert tracking_summary(setup, hole)["tracking_findings"] == found
    short = cut(recording, COMMAND, lambda time: (time < 4.95) | (time > 5.15))
    assert tracking_summary(setup, short)["tracking"] == "tracked"
    assert tracking_summary(setup, short, "failed")["tracking"] == "no command"


@pytest.mark.parametrize("end", [{"failure": "node profile failed: it left"}, {"interruption": "stopped by SIGTERM"}])
@pytest.mark.parametrize("ticks", [1, 200])
def test_a_run_that_failed_or_was_interrupted_is_not_tracked(whole, end, ticks):
    """Breaks if a run without a deviation is tracked although it failed at its end, or after its first tick."""
    setup, part = whole
    for topic in part.topics:
        part = cut(part, topic, lambda time: time < 0.1 * ticks - 0.05)
    assert part.time.size == ticks
    status = "failed" if "failure" in end else "interrupted"
    end = {"failure": None, "interrupted": status == "interrupted", **end}
    summary = RunResult.of(setup, part, 1.0, ticks, (), **end).summary
    assert (summary["status"], summary["tracking"]) == (status, status)
    assert tracking_text(summary) == f"{status}: the run, after {ticks / 10:.1f} of 20.0 s"
    assert verdict_line(summary).startswith(f"{status}: the run, ")


def test_a_run_whose_recorder_lost_a_message_is_not_tracked(whole):
    """Breaks if a failed run with a hole in its log is tracked."""
    setup, _ = whole
    result = run_engine(setup)
    counts = {**result.published, COMMAND: result.published[COMMAND] - 1}
    assert result.checked_against(result.published).summary["tracking"] == "tracked"
    summary = result.checked_against(counts).summary
    assert (summary["status"], summary["tracking"]) == ("failed", "log incomplete")
    assert summary["tracking_findings"][0]["text"] == "recorder: 199 of 200 messages of ato/command recorded"


def test_a_held_tick_holds_the_command_and_a_missing_reference_is_that_of_the_profile(whole):
    """Breaks if a held tick has the command 0 or NaN, or a lost profile node makes the errors 0 or NaN."""
    _, recording = whole
    short = cut(recording, COMMAND, lambda time: (time < 4.95) | (time > 6.0))
    np.testing.assert_array_equal(short.command[50:60], np.repeat(recording.command[49:50], 10, axis=0))
    short = cut(recording, REFERENCE, lambda time: time < 4.95)
    np.testing.assert_allclose(short.reference_position, recording.reference_position, atol=1e-6)


def test_the_last_incomplete_tick_does_not_count(whole):
    """Breaks if a tick that the plant has begun, but not integrated, counts as one."""
    _, recording = whole
    short = cut(cut(recording, TRUTH, lambda time: time < 5.05), MEASUREMENT, lambda time: time < 5.05)
    short = cut(short, COMMAND, lambda time: time < 4.95)
    assert short.time.size == 50


def test_a_topic_that_ends_before_the_log_has_a_gap(tmp_path):
    """Breaks if the gaps of a topic are only those between two of its messages."""
    setup = prepare(*load_scenario("demo", ("duration=20",)))
    folder = RunFolder.make(tmp_path / "run", "run")

    class Lossy:
        def __init__(self, sink):
            self.sink = sink

        def add(self, topic, message, stamp):
            if topic != COMMAND or stamp < 5e9:
                self.sink.add(topic, message, stamp)

    with folder.sink(setup) as sink:
        run_engine(setup, sink=Lossy(sink))
    topics = {topic.name: topic for topic in log_overview(folder.path / "run.mcap").topics}
    command = topics["/ato/command"]
    assert (command.gaps, command.longest_gap_at_s) == (1, pytest.approx(4.9))
    assert command.longest_gap_s == pytest.approx(20.0 - 4.9)
    assert topics["/train/measurement"].gaps == topics["/atp/speeds"].gaps == 0


class Case(NamedTuple):
    """A way to end a run.

    Attributes
    ----------
    way
        ``hand``: a process for every node, without a runner; ``processes``, ``composed``, ``engine``: modes of
        ``train-ato run``; ``python``: :func:`train_ato.run` in a script.
    options
        Of the plant by hand, or of the command.
    victim
        Node, or ``run``, that gets the signal, after the first commands.
    number
        Signal.
    status, reason, code
        Expected status; begin of the expected reason; exit status of the plant by hand, or of the command.
    """

    way: str
    options: tuple[str, ...]
    victim: str
    number: signal.Signals
    status: str
    reason: str
    code: int

    def __str__(self) -> str:
        return f"{self.way} {' '.join(self.options[:1])} {self.victim} {self.number.name}"


def left(role):
    return f"node {role} failed: it left the run at "


TERM, INT, KILL, STOP = signal.SIGTERM, signal.SIGINT, signal.SIGKILL, signal.SIGSTOP
BY_SIGNAL = "node {} failed: its process was ended by {}"
BY_RUN = "the run was stopped by {} after "
CASES = [
    *(Case("hand", options, role, KILL, "failed", left(role), 1) for options in (PACED, FREE) for role in ROLES[1:5]),
    Case("hand", PACED, "plant", INT, "interrupted", "node plant was stopped by SIGINT", 0),
    Case("hand", FREE, "plant", INT, "interrupted", "node plant was stopped by SIGINT", 0),
    Case("hand", PACED, "plant", TERM, "interrupted", "node plant was stopped by SIGTERM", 0),
    Case("hand", PACED, "plant", KILL, "failed", "node plant failed: its messages ended", -9),
    Case("hand", PACED, "recorder", INT, "interrupted", "the recorder was stopped by SIGINT", 1),
    Case("hand", PACED, "recorder", TERM, "interrupted", "the recorder was stopped by SIGTERM", 1),
    *(Case("hand", options, "controller", TERM, "failed", left("controller"), 1) for options in (PACED, FREE)),
    Case("hand", (*PACED, "--timeout=3"), "controller", STOP, "failed", "node controller failed: ", 1),
    *(Case("processes", PACED, role, TERM, "failed", BY_SIGNAL.format(role, "SIGTERM"), 1) for role in ROLES[1:5]),
    Case("processes", PACED, "plant", TERM, "interrupted", "node plant was stopped by SIGTERM", 1),
    Case("processes", PACED, "plant", INT, "interrupted", "node plant was stopped by SIGINT", 1),
    Case("processes", PACED, "plant", KILL, "failed", BY_SIGNAL.format("plant", "SIGKILL"), 1),
    Case("processes", FREE[:2], "controller", KILL, "failed", BY_SIGNAL.format("controller", "SIGKILL"), 1),
    Case("processes", (*PACED, "--restart"), "observer", TERM, "done", "", 0),
    Case("processes", PACED, "run", INT, "interrupted", BY_RUN.format("SIGINT"), 1),
    Case("composed", PACED, "run", INT, "interrupted", BY_RUN.format("SIGINT"), 1),
    Case("composed", FREE[:2], "run", TERM, "interrupted", BY_RUN.format("SIGTERM"), 1),
    Case("engine", PACED, "run", TERM, "interrupted", BY_RUN.format("SIGTERM"), 1),
    Case("hand", PACED, "recorder", KILL, "killed", "", 1),
    Case("hand", PACED, "recorder", STOP, "failed", "node recorder failed: its process was suspended for ", 1),
    Case("processes", PACED, "recorder", KILL, "failed", BY_SIGNAL.format("recorder", "SIGKILL"), 1),
    Case("python", PACED, "run", INT, "interrupted", BY_RUN.format("SIGINT"), 1),
    Case("python", FREE[:2], "run", TERM, "interrupted", BY_RUN.format("SIGTERM"), 1),
]  # fmt: skip


SCRIPT = """
import sys
import train_ato as ta
out, duration, free = sys.argv[1], float(sys.argv[2]), "--no-lockstep" in sys.argv
try:
    ta.run("demo", set={"duration": duration}, mode="composed", out=out, rate=2, lockstep=not free)
except ta.RunInterrupted as error:
    sys.exit(f"{error}")
"""
"""A script that runs a scenario."""


def begun(folder: Path) -> bool:
    """Return True if the log of a run has commands."""
    from train_ato.log.mcap_records import stream

    partial = folder / "run.mcap.partial"
    return partial.exists() and any(m.channel.topic == "/ato/command" for m in stream(partial, broken=True))


def node_of(run: subprocess.Popen[str], role: str, folder: Path) -> int:
    from remains import processes_of

    return run.pid if role == "run" else processes_of(folder.resolve())[role]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_end_of_a_run_has_its_status_and_reason(case: Case, tmp_path: Path) -> None:
    """Breaks if a run has the status of another end, its log is not closed, or it is tracked without commands."""
    pytest.importorskip("rclpy")
    from waiting import LIMIT_S, wait_for

    from train_ato.ros.graph import shared_memory
    from train_ato.ros.graph.environment import claim_domain

    out, processes = tmp_path / "out", {}
    scenario, duration = "demo", f"duration={DURATION}"
    with claim_domain() as domain:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(tmp_path / "log")}
        command = [sys.executable, "-m"]
        if case.way == "hand":
            more = {"recorder": ["--out", str(out)], "plant": ["--recorded", *case.options]}
            started = {
                role: ["train_ato.cli.nodes", role, "--scenario", scenario, *more.get(role, [])] for role in ROLES
            }
        elif case.way == "python":
            environment.pop("ROS_DOMAIN_ID")
            command[1:], started = ["-c", SCRIPT], {"run": [str(out), str(DURATION), *case.options]}
        else:
            environment.pop("ROS_DOMAIN_ID")
            mode = [] if case.way == "composed" else [f"--{case.way}"]
            started = {"run": ["train_ato", "run", scenario, *mode, "--json", "--out", str(out), *case.options]}
        try:
            for role, words in started.items():
                processes[role] = subprocess.Popen(
                    [*command, *words, *([] if case.way == "python" else ["--set", duration])],
                    env=environment,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    text=True,
                )
            wait_for(lambda: begun(out), "commands in the log")
            hit = processes.get(case.victim)
            os.kill(hit.pid if hit is not None else node_of(processes["run"], case.victim, out), case.number)
            main = processes["plant" if case.way == "hand" else "run"]
            said, _ = main.communicate(timeout=LIMIT_S)
            if case.way == "hand":
                processes["recorder"].send_signal(signal.SIGCONT)
                processes["recorder"].communicate(timeout=LIMIT_S)
        finally:
            for process in processes.values():
                process.kill()
                process.communicate(timeout=LIMIT_S)
            shared_memory.clean()
    if case.status == "killed":
        assert main.returncode == case.code, said
        assert {path.name for path in out.iterdir()} == {"run.mcap.partial"}, "readable by recover"
        assert "node recorder failed: it left the run at " in said
        return
    summary = json.loads((out / "summary.json").read_text())
    reason = summary.get("failure") or summary.get("interruption") or ""
    assert (main.returncode, summary["status"]) == (case.code, case.status), said
    assert reason.startswith(case.reason), reason
    assert "Traceback" not in said
    assert (case.status == "done") == (summary["ticks"] == 10 * DURATION)
    if case.victim == "recorder":  # the log ends before the run
        return
    topics = {topic.name: topic for topic in log_overview(out / "run.mcap").topics}
    vehicles = topics["/train/vehicles"]
    killed = (case.victim, case.number) == ("plant", KILL)  # it has sent some topics of its last tick, in any order
    assert vehicles.messages - 1 - summary["ticks"] in ((-1, 0, 1) if killed else (-1, 0))
    assert case.status == "done" or summary["tracking"] != "tracked"


def test_the_lateness_of_ticks_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Periods of 10 ms, one of 38 ms and a pause: one late tick, 28 ms, 28 of 138 ms behind; the pause is none."""
    pytest.importorskip("rclpy")
    from train_ato.ros.nodes import answer_watch

    clock = [0]
    monkeypatch.setattr(answer_watch.time, "monotonic_ns", lambda: clock[0])
    monkeypatch.setattr(answer_watch.time, "time_ns", lambda: clock[0] + 7)
    lateness = answer_watch.TickLateness()
    assert lateness.report() == {}
    for step in [0, *[10] * 10, 38]:
        clock[0] += step * 1_000_000
        lateness.begin(0.01)
    found = lateness.report()
    assert found["wall_tick_begin_ns"] == "7"
    assert found["wall_tick_steps_us"].split() == [*["10000"] * 10, "38000"]
    assert (found["wall_ticks_late"], found["wall_lateness_max_s"]) == ("1", "0.028000")
    assert found["wall_behind_share"] == f"{28 / 138:.6f}"
    lateness.restart()
    clock[0] += 10**9
    lateness.begin(0.01)
    assert lateness.report()["wall_ticks_late"] == "1"
