"""End of a run in every way: status, reason, exit status, outcome of tracking and log."""

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from engine_runs import setup_of
from recordings import commands_in
from two_hosts import HOSTS, two_hosts  # noqa: F401
from waiting import LIMIT_S, pause, wait_for

import train_ato as ta
from train_ato.judge.recording import COMMAND, LOST_KEY, MEASUREMENT, REFERENCE, TRUTH
from train_ato.judge.result import RunResult, completed_summary
from train_ato.judge.run_end import RunEnd
from train_ato.judge.series import TopicSamples
from train_ato.judge.tracking import tracking_summary
from train_ato.judge.verdict import tracking_text, verdict_line
from train_ato.log.bag_layout import PARTIAL
from train_ato.log.overview import log_overview
from train_ato.log.recorded import open_recording
from train_ato.log.recover import recover
from train_ato.log.run_folder import RunFolder, read_summary
from train_ato.loop.engine import Sink, run_engine
from train_ato.messages.types import Diagnostic

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
    setup = setup_of("demo", "duration=20")
    return setup, run_engine(setup).recording


def cut_of(recording, topics, keep):
    """Return the recording without the messages of topics outside of ``keep``."""
    for topic in topics:
        recording = cut(recording, topic, keep)
    return recording


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


def test_commands_that_a_train_without_its_controller_does_not_take_do_not_count(whole):
    """Breaks if the commands of a second publisher count as commands: the train has braked without them."""
    setup, recording = whole
    reports = [
        Diagnostic(round(time * 1e9), "plant", 0, "", {LOST_KEY: text} if text else {})
        for time, text in ((0.0, ""), (2.0, "node controller: killed"), (3.0, ""), (5.0, "node controller: a second"))
    ]
    found = tracking_summary(setup, replace(recording, kept_reports=tuple(reports)))["tracking_findings"]
    assert found[0]["text"] == "none in the last 15 s; 50 of 200 ticks had one"


def test_a_pause_of_the_commands_is_no_tracked_run(whole):
    """Breaks if only commands missing at the end count, ticks missing in the log, or short holes of a failed run."""
    setup, recording = whole
    pause = cut(recording, COMMAND, lambda time: (time < 4.95) | (time > 6.05))
    found = tracking_summary(setup, pause)["tracking_findings"]
    assert (found[0]["outcome"], found[0]["value"]) == ("no command", pytest.approx(1.1))
    assert found[0]["text"] == "none for 1.1 s from 5.00 s on; 189 of 200 ticks had one"
    hole = cut_of(pause, (MEASUREMENT, TRUTH, REFERENCE), lambda time: (time < 4.95) | (time > 6.05))
    assert hole.time.size == 189
    assert tracking_summary(setup, hole)["tracking_findings"] == found
    short = cut(recording, COMMAND, lambda time: (time < 4.95) | (time > 5.15))
    assert tracking_summary(setup, short)["tracking"] == "tracked"
    assert tracking_summary(setup, short, "failed")["tracking"] == "no command"


@pytest.mark.parametrize("end", [{"failure": "node profile failed: it left"}, {"interruption": "stopped by SIGTERM"}])
@pytest.mark.parametrize("ticks", [1, 200])
def test_a_run_that_failed_or_was_interrupted_is_not_tracked(whole, end, ticks):
    """Breaks if a run without a deviation is tracked although it failed at its end, or after its first tick."""
    setup, recording = whole
    part = cut_of(recording, recording.topics, lambda time: time < 0.1 * ticks - 0.05)
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
    short = cut_of(whole[1], (TRUTH, MEASUREMENT), lambda time: time < 5.05)
    assert cut(short, COMMAND, lambda time: time < 4.95).time.size == 50


def test_a_topic_that_ends_before_the_log_has_a_gap(tmp_path):
    """Breaks if the gaps of a topic are only those between two of its messages."""
    setup = setup_of("demo", "duration=20")
    folder = RunFolder.make(tmp_path / "run", "run")

    class Lossy(Sink):
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
    """Way to end a run, options, the node, ``run`` or ``link`` that is struck and how, and the expected end."""

    # ``hand``: a process for every node, without a runner; ``hosts``: the same, the recorder and the plant on one host,
    # the others on another; ``processes``, ``composed``, ``engine``: modes of ``train-ato run``; ``python``: a script.
    way: str
    options: tuple[str, ...]  # of the plant by hand, or of the command
    victim: str
    strike: signal.Signals | Callable[[int, Path], None]  # for the process of the victim and the folder
    status: str
    reason: str  # its begin
    code: int  # of the plant by hand, or of the command

    def __str__(self) -> str:
        name = self.strike.name if isinstance(self.strike, signal.Signals) else self.strike.__name__
        return f"{self.way} {' '.join(self.options[:1])} {self.victim} {name}"

    @property
    def by_hand(self) -> bool:
        return self.way in ("hand", "hosts")


def left(role):
    return f"node {role} failed: it left the run at "


def full_disk(process: int, out: Path) -> None:
    """Leave no room in any file of a process beyond the present size of the log."""
    size = (out / PARTIAL).stat().st_size
    resource.prlimit(process, resource.RLIMIT_FSIZE, (size, size))


def late(process: int, out: Path) -> None:
    """Suspend a process for 1 s."""
    os.kill(process, signal.SIGSTOP)
    pause(1.0)
    os.kill(process, signal.SIGCONT)


def wrong_stamps(process: int, out: Path) -> None:
    """Do nothing: the controller of this case, :data:`UNSTAMPED`, sends wrong stamps from 2 s on."""


def cut_link(process: int, out: Path, again_s: float | None = None) -> None:
    """Cut the link of a host for some time, or for good."""
    link = ("nsenter", f"--target={process}", "--net", "--mount", "ip", "link", "set", "cable")
    subprocess.run([*link, "down"], check=True)
    if again_s is not None:
        pause(again_s)
        subprocess.run([*link, "up"], check=True)


def cut_1_s(process: int, out: Path) -> None:
    cut_link(process, out, 1.0)


def cut_15_s(process: int, out: Path) -> None:
    cut_link(process, out, 15.0)


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
    Case("hand", PACED, "recorder", full_disk, "killed", "", 1),
    Case("processes", PACED, "recorder", full_disk, "failed", "node recorder failed: ", 1),
    *(Case(way, PACED, "run", full_disk, "failed", "node recorder failed: ", 1) for way in ("composed", "python")),
    Case("engine", PACED, "run", full_disk, "failed", "", 1),
    *(Case(way, PACED, "plant", late, "done", "", 0) for way in ("hand", "processes")),
    *(Case(way, PACED, "run", late, "done", "", 0) for way in ("composed", "python")),
    *(
        Case("hand", (*options, "--timeout=10"), "controller", wrong_stamps, "failed", "node controller failed: ", 1)
        for options in (PACED, FREE)
    ),
    *(Case("hosts", options, "link", cut_link, "failed", "node ", 1) for options in (PACED, FREE)),
    Case("hosts", PACED, "link", cut_15_s, "failed", "node ", 1),
    *(Case("hosts", options, "link", cut_1_s, "done", "", 0) for options in (PACED, FREE)),
]  # fmt: skip
SCRIPT = """
import sys
import train_ato as ta
out, duration, free = sys.argv[1], float(sys.argv[2]), "--no-lockstep" in sys.argv
try:
    ta.run("demo", set={"duration": duration}, mode="composed", out=out, rate=2, lockstep=not free)
except ta.RunFailed as error:
    sys.exit(f"{error}")
"""
"""A script that runs a scenario."""
UNSTAMPED = """
import sys
from dataclasses import replace
from train_ato.cli.nodes import controller
from train_ato.messages.topics import EPOCH_NS
from train_ato.ros.nodes.endpoints import NodeEndpoints
publish = NodeEndpoints.publish
def unstamped(self, *messages):
    late = [topic == "ato/command" and message.stamp >= 2e9 for topic, message in messages]
    publish(self, *[(one[0], replace(one[1], stamp=-EPOCH_NS)) if gone else one for gone, one in zip(late, messages)])
NodeEndpoints.publish = unstamped
sys.exit(controller())
"""
"""A controller that forgets the stamps of its commands."""


def commands(case: Case, out: Path, hosts: dict[str, tuple[str, ...]]) -> dict[str, list[str]]:
    """Return the command of every process of a case."""
    python, length = (sys.executable, "-m"), f"--set=duration={DURATION}"
    if case.way == "python":
        return {"run": [sys.executable, "-c", SCRIPT, str(out), str(DURATION), *case.options]}
    if not case.by_hand:
        mode = [] if case.way == "composed" else [f"--{case.way}"]
        return {"run": [*python, "train_ato", "run", "demo", *mode, "--json", f"--out={out}", length, *case.options]}
    more = {"recorder": [f"--out={out}"], "plant": ["--recorded", *case.options]}
    found = {}
    for role in ROLES:
        forgets = (role, case.strike) == ("controller", wrong_stamps)
        program = (sys.executable, "-c", UNSTAMPED) if forgets else (*python, "train_ato.cli.nodes", role)
        found[role] = [*hosts.get(role, ()), *program, "--scenario=demo", length, *more.get(role, [])]
    return found


def ended(case: Case, out: Path, hosts: dict[str, tuple[str, ...]], environment: dict[str, str]) -> tuple[int, str]:
    """Run the processes of a case and strike the victim; return exit status and text of the plant, or the command."""
    from remains import processes_of

    processes = {}
    try:
        for role, words in commands(case, out, hosts).items():
            processes[role] = subprocess.Popen(
                words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            )
        wait_for(lambda: commands_in(out) or not all(each.poll() is None for each in processes.values()))
        assert commands_in(out), [each.communicate()[0] for each in processes.values() if each.poll() is not None]
        if case.victim == "link":
            hit = int(hosts["controller"][1].partition("=")[2])
        else:
            hit = processes[case.victim].pid if case.victim in processes else processes_of(out.resolve())[case.victim]
        if isinstance(case.strike, signal.Signals):
            os.kill(hit, case.strike)
        else:
            case.strike(hit, out)
        main = processes["plant" if case.by_hand else "run"]
        said, _ = main.communicate(timeout=LIMIT_S)
        if case.by_hand:
            if case.strike is STOP:
                processes["recorder"].send_signal(signal.SIGCONT)
            processes["recorder"].communicate(timeout=LIMIT_S)
        for role in ROLES[1:5] if case.way == "hosts" else ():
            assert processes[role].wait(timeout=LIMIT_S) == case.code
        return main.returncode, said
    finally:
        for process in processes.values():
            process.kill()
            process.communicate(timeout=LIMIT_S)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_end_of_a_run_has_its_status_and_reason(case: Case, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Breaks if a run has the status of another end, its log is not whole, or it is tracked without commands."""
    pytest.importorskip("rclpy")
    from train_ato.ros.graph import shared_memory
    from train_ato.ros.graph.environment import claim_domain

    out, hosts, peers = tmp_path / "out", {}, {}
    if case.way == "hosts":
        here, there = request.getfixturevalue("two_hosts")
        hosts = {role: here if role in ("recorder", "plant") else there for role in ROLES}
        peers = {"ROS_STATIC_PEERS": ";".join(HOSTS), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    environment = {**os.environ, "ROS_LOG_DIR": str(tmp_path / "log"), **peers}
    environment.pop("ROS_DOMAIN_ID", None)
    try:
        with claim_domain() as domain:
            code, said = ended(
                case, out, hosts, {**environment, "ROS_DOMAIN_ID": str(domain)} if case.by_hand else environment
            )
    finally:
        shared_memory.clean()
    check_end(case, out, code, said)
    for host in {*hosts.values()}:  # a network that loses packets would never bring a datagram of many fragments
        lines = subprocess.run([*host, "cat", "/proc/net/snmp"], capture_output=True, text=True).stdout.splitlines()
        assert dict(zip(lines[0].split(), lines[1].split(), strict=True))["FragCreates"] == "0"


def check_end(case: Case, out: Path, code: int, said: str) -> None:
    """Check status, reason, exit status, outcome of tracking and log."""
    broken = case.strike is full_disk or (case.victim, case.strike) == ("recorder", KILL)
    assert (out / PARTIAL).exists() == broken, said
    if broken:
        recover(out)
    recording = open_recording(out)
    summary = completed_summary(recording) if broken else read_summary(out)
    reason = summary.get("failure") or summary.get("interruption") or ""
    assert (code, summary["status"]) == (case.code, case.status), said
    assert reason.startswith(case.reason), reason
    assert reason in said or case.way == "hand"  # the node that has ended says it, not the plant
    assert "Traceback" not in said
    others = {"killed": (), "done": ("tracked", "disengaged", "no command"), "failed": ("no command",),
              "interrupted": ("disengaged", "no command")}[case.status]  # fmt: skip
    expected = others if case.status == "done" else (case.status, *others)
    assert summary["tracking"] in expected, summary["tracking_findings"]
    if broken:
        assert ("node recorder failed: " if case.strike is KILL or case.way == "hand" else "writing failed") in said
    if case.strike is wrong_stamps:
        assert "a command stamped 0 came; echo the stamp of train/measurement" in reason
    if case.strike is late:
        assert summary["ticks_late"] > 0 and summary["lateness_max_s"] >= 0.9
    if case.way == "hosts":
        assert summary["reach"] == "network"
    if case.status == "done" and "--restart" not in case.options:
        lockstep = "--no-lockstep" not in case.options  # else lost commands disengage the ATO
        assert (summary["tracking"] == "tracked", summary["commands_missed"] == 0) == (lockstep, lockstep)
        assert not lockstep or ta.verify(out).equal
    if broken or case.victim == "recorder":  # the log ends before the run
        assert recording.time.size > 0
        return
    assert (case.status == "done") == (summary["ticks"] == 10 * DURATION)
    topics = {topic.name: topic for topic in log_overview(out / "run.mcap").topics}
    killed = (case.victim, case.strike) == ("plant", KILL)  # it has sent some topics of its last tick, in any order
    assert topics["/train/vehicles"].messages - 1 - summary["ticks"] in ((-1, 0, 1) if killed else (-1, 0))


def test_the_lateness_of_ticks_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Periods of 10 ms, one of 38 ms and a pause: one late tick, 28 ms, 28 of 138 ms behind; the pause is none."""
    pytest.importorskip("rclpy")
    from train_ato.ros.nodes import answer_watch

    clock, ahead = [0], [7]
    monkeypatch.setattr(answer_watch.time, "monotonic_ns", lambda: clock[0])
    monkeypatch.setattr(answer_watch.time, "time_ns", lambda: clock[0] + ahead[0])
    lateness = answer_watch.TickLateness()
    assert lateness.report() == {}
    for step in [0, *[10] * 10, 38]:
        clock[0] += step * 1_000_000
        lateness.begin(0.01)
        ahead[0] = 10**12 + 7  # the wall clock is set
    found = lateness.report()
    assert found["wall_tick_begin_ns"] == str(ahead[0])
    assert found["wall_tick_steps_us"].split() == [*["10000"] * 10, "38000"]
    assert (found["wall_ticks_late"], found["wall_lateness_max_s"]) == ("1", "0.028000")
    assert found["wall_behind_share"] == f"{28 / 138:.6f}"
    lateness.restart()
    clock[0] += 10**9
    lateness.begin(0.01)
    assert lateness.report()["wall_ticks_late"] == "1"
    last = lateness.report()  # at the end of a run, after no further tick
    assert last["wall_ticks_late"] == "1" and "wall_tick_begin_ns" not in last


def test_the_time_without_an_answer_leaves_out_suspensions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a brake release counts as a command, the older one does not count, or a suspension fails the run."""
    pytest.importorskip("rclpy")
    from train_ato.ros.nodes import answer_watch

    clock = [50.0]
    monkeypatch.setattr(answer_watch.time, "monotonic", lambda: clock[0])
    watch = answer_watch.AnswerWatch()

    def silence() -> tuple[float, ...]:
        found = watch.silent_for(released=False), watch.release_silent_for(), watch.silent_for(released=True)
        return tuple(round(value, 9) for value in found)

    clock[0] = 51.0
    watch.heard = clock[0]
    assert silence() == (0.0, 1.0, 1.0)
    clock[0] = 51.25
    watch.heard_release = clock[0]
    assert silence() == (0.25, 0.0, 0.25)
    watch.restart()
    watch.begin()
    clock[0] += answer_watch.SUSPENDED_S
    watch.check()
    assert watch.suspended == 0.0 and silence() == (0.25,) * 3
    clock[0] += 8.0
    watch.check()
    assert watch.suspended == 8.0 and silence() == (0.35,) * 3, "a suspension counts as one period of 0.1 s"
