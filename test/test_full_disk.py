"""Full disk, as a limit on the size of files: one line with failure and remedy; no files of a run without start."""

import errno
import io
import json
import re
import resource
import shlex
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from engine_runs import setup_of
from programs import begun, python
from waiting import LIMIT_S, wait_for

from plant_sim.train import compile_kernel
from train_ato.api.drive import RunMode, drive, finish
from train_ato.api.following import run_following
from train_ato.api.following_live import run_following_live
from train_ato.api.progress import COMPILE_NOTE
from train_ato.api.run import Run, RunRecord
from train_ato.cli.main import main
from train_ato.judge.result import RunResult
from train_ato.log.run_folder import RunFolder
from train_ato.loop.engine import run_engine
from train_ato.program.errors import FirstFailure, RunFailed
from train_ato.scenario.following import load_following
from train_ato.scenario.scenario_files import shipped_following

ENVIRONMENT = {"PYTHONDONTWRITEBYTECODE": "1"}
"""Variables of a program: Python would leave cut files of bytecode, which later tests cannot import."""


def run(largest: int, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a command in this process with a limit on the size of its files [bytes], after compilation of the kernel."""
    compile_kernel()
    out, err, before = io.StringIO(), io.StringIO(), resource.getrlimit(resource.RLIMIT_FSIZE)
    bytecode = patch.object(sys, "dont_write_bytecode", True)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, before[1]))
    try:
        with bytecode, redirect_stdout(out), redirect_stderr(err):
            status = main([*words])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    return subprocess.CompletedProcess(words, status, out.getvalue(), err.getvalue())


def test_a_run_that_cannot_begin_leaves_nothing(tmp_path: Path) -> None:
    """No space for the scenario: exit status 2, one line with the name of the folder, and no folder."""
    done = run(1000, "run", "demo", "--engine", "--out", str(tmp_path / "out"))
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith(f"train-ato: --out {tmp_path / 'out'}: cannot be written")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("live", [False, True])
def test_following_trains_that_cannot_begin_leave_nothing(tmp_path: Path, monkeypatch: Any, *, live: bool) -> None:
    """Breaks if the common folder stays, without a run, or the file without room has no name."""

    def no_room(path: Path, *_: str) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    for module in ("train_ato.log.run_folder", "train_ato.api.following_live"):
        monkeypatch.setattr(f"{module}.write_whole", no_room)
    file, out = load_following(shipped_following()["following_metro"], ("all.duration=1",)), tmp_path / "new" / "out"
    with pytest.raises((ValueError, OSError), match=r"new/out/t1.*No space left|No space left.*new/out/t1\.yaml"):
        run_following_live(file, out) if live else run_following(file, RunMode("engine"), out)
    assert not list(tmp_path.iterdir())


WRITERS = {
    "o.html": "report r --out o.html", "ocsv": "export r --csv --out ocsv", "opar": "export r --out opar",
    "o3d": "export r --scene --figure f.png --out o3d", "orrd": "export r --rerun --out orrd",
    "o.json": "layout r --foxglove --out o.json", "o.csv": "plan level xuzhou_metro_3 --to-km 1 --out o.csv",
    "o.svg": "plan level xuzhou_metro_3 --to-km 1 --out o.svg", "o.yml": "convert xuzhou_metro_test o.yml",
    "c.png": "curves demo --out c.png", "r.png": "replay r --law pid --out r.png",
    "i.csv": "import rec.csv --consist xuzhou_metro_3 --line level --profile-only --out i.csv",
    "d.csv": "driver level xuzhou_metro_3 --until-km 0.5 --out d.csv", "osw": "sweep s.yaml --jobs 1 --out osw",
    "otun": "tune demo --law pid --set duration=2 --runs 6 --jobs 1 --out otun",
    "ofal": "falsify demo --requirement 'speed <= limit' --over o.yaml --set duration=2 --runs 2 --jobs 1 --out ofal",
}  # fmt: skip
"""Command by the begin of the file or folder that it writes."""


def test_every_writer_that_finds_no_room_names_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the line has the error of the disk only, without the file, or a writer waits for ever."""
    monkeypatch.chdir(tmp_path)
    assert main(["run", "demo", "--engine", "--set=duration=5", "--out=r"]) == 0
    Path("rec.csv").write_text("time_s,speed_kmh\n" + "".join(f"{t},{min(2 * t, 40)}\n" for t in range(40)))
    Path("s.yaml").write_text("{scenario: demo, design: grid, over: {plant.lag: [0.3, 0.4]}, set: {duration: 2}}")
    Path("o.yaml").write_text("over: {plant.lag: {from: 0.3, to: 0.5}}")
    for place, words in WRITERS.items():
        said = run(250, *shlex.split(words)).stderr
        (line,) = [line for line in said.splitlines() if line.startswith("train-ato: ")]
        known = line.startswith(
            (f"train-ato: {place}", f"train-ato: OUT {place}", "train-ato: --rerun", "train-ato: the pa")
        )
        assert known and "File too large" in line, (place, said)
        assert place != "o.html" or line.endswith("; name another place with --out")
    assert not [path for path in Path().glob("?.*") if path.name not in ("s.yaml", "o.yaml")]


SERIES = {
    "sweep": "sweep s.yaml --jobs 1",
    "tune": "tune demo --law pid --parameters kp --set duration=2 --runs 12",
    "falsify": "falsify demo --requirement 'speed <= 999 m/s' --over o.yaml --set duration=2 --runs 40",
}
"""Commands that write a folder of many runs."""


@pytest.mark.parametrize("command", SERIES)
def test_a_series_that_finds_no_more_room_keeps_its_runs_and_goes_on(command, tmp_path, monkeypatch):
    """Breaks if the finished runs are lost, or the line has neither the file nor the way to go on."""
    monkeypatch.chdir(tmp_path)
    seeds = ", ".join(map(str, range(12)))
    Path("s.yaml").write_text(f"{{scenario: demo, design: grid, over: {{seed: [{seeds}]}}, set: {{duration: 2}}}}")
    Path("o.yaml").write_text("over: {plant.lag: {from: 0.3, to: 0.5}}")
    words = shlex.split(SERIES[command])
    done = run(1500 if command == "falsify" else 3000, *words, "--out", "out")
    said = [line for line in done.stderr.splitlines() if line.startswith("train-ato: ")][-1]
    kept = len((Path("out") / "runs.jsonl").read_text().splitlines()) - 1
    assert done.returncode == 1 and kept > 0 and "Traceback" not in done.stderr
    assert re.fullmatch(
        rf"train-ato: out/\S+: File too large; ({kept}|{kept + 1}) finished runs? (is|are) in out; "
        "make room and repeat the command to go on",
        said,
    )
    assert main([*words, "--out", "out"]) == 0 and main([*words, "--out", "whole"]) == 0
    numbers = [[json.loads(line)["run"] for line in _whole_lines(Path(name))] for name in ("out", "whole")]
    assert sorted(numbers[0]) == sorted(numbers[1])


def _whole_lines(folder: Path) -> list[str]:
    return [line for line in (folder / "runs.jsonl").read_text().splitlines() if line.endswith("}")]


def test_a_comparison_without_room_for_its_files_has_its_table(tmp_path: Path) -> None:
    """Breaks if the runs of a comparison are lost with its figure."""
    words = ("compare", "demo", "--laws=pid,smc", "--set=duration=2", "--engine", "--out", str(tmp_path / "out"))
    done = run(400_000, *words)
    assert done.returncode == 1 and "comparison.html: File too large" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr and "difference from the best value" in done.stdout
    assert {law["controller"] for law in json.loads((tmp_path / "out" / "summary.json").read_text())} == {"pid", "smc"}


@pytest.mark.parametrize("way", ["--engine", "--composed"])
def test_a_log_that_cannot_go_on_is_named(way: str, tmp_path: Path) -> None:
    """Breaks if the line does not contain the unwritten file and the remedy for reading the rest."""
    folder = tmp_path / "out"
    folder.mkdir()
    options = ["--engine"] if way == "--engine" else []
    done = run(200_000, "run", "demo", *options, "--out", str(folder / "run"))
    assert done.returncode == 1
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("train-ato:")]
    assert line.startswith("train-ato: node recorder failed: ")
    assert "run.mcap.partial: writing failed" in line and "recover" in line
    assert (folder / "run" / "run.mcap.partial").is_file()


def test_a_full_disk_is_named_with_a_process_for_each_node(tmp_path: Path) -> None:
    """Breaks if the reason of the recorder is lost, because its standard error is on the full disk too."""
    pytest.importorskip("rclpy")
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1500k", "tmpfs", str(disk)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no permission for a small disk")
    try:
        done = run(10**12, "run", "demo", "--processes", "--set=duration=120", "--out", str(disk / "run"))
        (line,) = [line for line in done.stderr.splitlines() if line.startswith("train-ato:")]
        assert done.returncode == 1
        assert line.startswith("train-ato: node recorder failed: ") and "No space left" in line, line
        assert "run.mcap.partial: writing failed" in line and "recover" in line
        assert main(["info", str(disk / "run")]) == 0
    finally:
        subprocess.run(["umount", "--lazy", str(disk)], check=True)


COPIES = {
    "export r --scene --out o3d": "train-ato: o3d/run.mcap.partial: writing failed (File too large); make room there",
    "recover cut": "train-ato: cut: cannot be written (File too large); make room there, or recover a copy in another "
    "folder",
}
"""Command that copies a log, with its line."""


@pytest.mark.usefixtures("without_figure")
@pytest.mark.parametrize("command", COPIES)
def test_a_copy_of_a_log_without_room_has_a_remedy_that_works(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Breaks if `recover` of the incomplete copy is the remedy: the copy is removed."""
    monkeypatch.chdir(tmp_path)
    assert main(["run", "demo", "--engine", "--set=duration=5", "--out=r"]) == 0
    Path("cut").mkdir()
    Path("cut/run.mcap.partial").write_bytes(Path("r/run.mcap").read_bytes())
    done = run(20_000, *command.split())
    assert (done.returncode, done.stderr.splitlines()[-1]) == (1, COPIES[command])
    assert [path.name for path in Path("cut").iterdir()] == ["run.mcap.partial"] and not Path("o3d").exists()


@pytest.mark.parametrize("way", ["engine", "composed"])
def test_a_run_without_room_for_the_begin_of_its_log_leaves_nothing(way: str, tmp_path: Path) -> None:
    """Breaks if an empty log stays, with `recover` as remedy, which refuses it."""
    if way == "composed":
        pytest.importorskip("rclpy")
    options = ["--engine"] if way == "engine" else []
    done = run(9_500, "run", "demo", *options, "--out", str(tmp_path / "out"))
    said = done.stderr.splitlines()[-1]
    assert done.returncode == 2 and "run.mcap.partial: cannot be written (File too large); make room" in said
    assert not list(tmp_path.iterdir())


def test_a_sweep_without_room_for_its_figures_names_its_runs(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    """Breaks if the line of a figure has neither the kept runs nor the way to go on."""

    def no_room(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "out/box.png")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("train_ato.studies.sweep.result.SweepResult.figures", no_room)
    Path("s.yaml").write_text("{scenario: demo, design: grid, over: {plant.lag: [0.3]}, set: {duration: 2}}")
    for kept in ("1 finished run is", "2 finished runs are"):
        assert main(["sweep", "s.yaml", "--jobs=1", "--out=out"]) == 1
        line = f"out/box.png: No space left on device; {kept} in out; make room and repeat the command to go on"
        assert capsys.readouterr().err.splitlines()[-1] == f"train-ato: {line}"
        (runs := Path("out/runs.jsonl")).write_text(runs.read_text() + '{"run": 2}\n')


def test_new_files_without_room_for_all_leave_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the first file stays: the repeated command refuses it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Path, "replace", lambda path, target: _moved(path, target))
    assert main(["new", "scenario", "my_metro"]) == 2
    assert not list(tmp_path.iterdir())


def _moved(path: Path, target: Path) -> Path:
    """Rename a file, for all but the train."""
    if target.name == "train.yaml":
        raise OSError(errno.ENOSPC, "No space left on device")
    return path.rename(target)


@pytest.mark.parametrize(("largest", "name"), [(300, "reproduce.json"), (29_000, "paper002.json")])
def test_a_reproduction_without_room_names_its_file(largest: int, name: str, tmp_path: Path) -> None:
    """Breaks if a claim of a paper is judged, and the message of a full disk has no file, or half of a file stays."""
    out = tmp_path / "out"
    done = run(largest, "reproduce", "002", "--jobs=1", "--claim=delay", "--out", str(out))
    line = next(row for row in done.stderr.splitlines() if row.startswith("train-ato: "))
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert line == f"train-ato: {out / name}: File too large" and not out.exists()


def test_the_original_failure_is_reported(tmp_path: Path) -> None:
    """Breaks if an error from writing the traceback or the summary replaces the original failure."""
    (tmp_path / "taken").write_text("")
    watch = FirstFailure(tmp_path / "taken" / "log")
    watch.fail("plant", OSError("run.mcap.partial: writing failed"))
    assert watch.failure == "node plant failed: run.mcap.partial: writing failed"
    setup = setup_of("demo")
    folder = RunFolder.make(tmp_path / "run", "demo")
    (folder.path / "run.mcap.partial").touch()
    (folder.path / "summary.json").mkdir()
    outcome = RunResult(None, {"changes": []}, failure="node recorder failed: no room")
    run = Run(outcome.summary, record=RunRecord(setup, folder), setup=setup, outcome=outcome)
    with pytest.raises(RunFailed, match="no room"):
        finish(run, outcome)


def test_a_run_whose_reader_has_gone_has_its_figure(tmp_path: Path) -> None:
    """Breaks if `train-ato run demo | head -1` leaves a run folder without its figure."""

    def gone(*ended: object) -> None:
        raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        drive(setup_of("demo", "duration=1"), RunMode("engine"), out=tmp_path / "run", ended=gone)
    assert (tmp_path / "run" / "figure.png").is_file()


@pytest.mark.parametrize("name", ["summary.json", "scenario.yaml", "metadata.yaml"])
def test_a_small_file_is_whole_or_missing(name: str, tmp_path: Path) -> None:
    """Breaks if a full disk leaves an empty file, or an earlier file is lost."""
    program = """
import resource, signal, sys
from pathlib import Path
from train_ato.log.whole_file import write_whole
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))
for folder in ("full", "again"):
    try:
        write_whole(Path(folder) / sys.argv[1], "x" * 5000)
    except OSError as error:
        assert error.filename == str(Path(folder) / sys.argv[1])
    else:
        sys.exit(1)
"""
    for folder in ("full", "again"):
        (tmp_path / folder).mkdir()
    (tmp_path / "again" / name).write_text("earlier")
    done = python("-c", program, name, folder=tmp_path, **ENVIRONMENT)
    assert done.returncode == 0 and not list((tmp_path / "full").iterdir())
    assert [path.read_text() for path in (tmp_path / "again").iterdir()] == ["earlier"]


def test_a_full_disk_leaves_no_empty_summary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the summary is written in place: `info` then names a file that is not JSON."""
    setup = setup_of("demo", "duration=1")
    folder = RunFolder.make(tmp_path / "run", "demo")
    folder.begin(setup)
    with folder.sink(setup) as sink:
        result = run_engine(setup, sink=sink)
    written = Path.write_text

    def full(path: Path, text: str, **options: str) -> int:
        written(path, text[:10], **options)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match=r"summary\.json"):
        folder.finish(setup, result)
    assert sorted(path.name for path in folder.path.iterdir()) == ["metadata.yaml", "run.mcap", "scenario.yaml"]


def recording_run(mode: str, folder: Path) -> subprocess.Popen[str]:
    """Return a run in a folder that has written a part of its log."""
    if mode != "--engine":
        pytest.importorskip("rclpy")
    options = [] if mode == "--composed" else [mode]
    process = begun("run", "demo", *options, "--rate=20", "--set=duration=60", "--out=out", cwd=folder)
    partial = folder / "out" / "run.mcap.partial"
    wait_for(lambda: partial.exists() and partial.stat().st_size > 100_000, "a run that records")
    return process


@pytest.mark.parametrize("mode", ["--engine", "--composed", "--processes"])
def test_a_folder_removed_during_the_run_is_named(mode: str, tmp_path: Path) -> None:
    """Breaks if the message names a full or read-only place, or an empty log takes the place of the removed one."""
    process = recording_run(mode, tmp_path)
    shutil.rmtree(tmp_path / "out")
    out, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 1 and out == ""
    notes = ("ROS domain ", "waiting for ", COMPILE_NOTE.strip())
    errors = [line for line in err.splitlines() if line.strip() and not line.startswith(notes)]
    assert errors == ["train-ato: --out out: was removed during the run; nothing is recorded"]
    assert not list((tmp_path / "out").glob("**/run.mcap"))


@pytest.mark.parametrize("mode", ["--engine", "--composed"])
def test_a_log_removed_during_the_run_leaves_no_empty_one(mode: str, tmp_path: Path) -> None:
    """Breaks if the message names a place to write to, or a log or bag without messages is beside the failure."""
    process = recording_run(mode, tmp_path)
    (tmp_path / "out" / "run.mcap.partial").unlink()
    _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 1
    assert err.endswith("out/run.mcap.partial: was removed during the run; nothing is recorded\n")
    assert not {"run.mcap", "metadata.yaml"} & {path.name for path in (tmp_path / "out").glob("*")}
