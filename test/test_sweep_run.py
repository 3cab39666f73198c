"""Sweeps on Dask workers: killed workers and sweeps, failed and refused rows, one row again, figures.

Without workers: specification, designs and checks of a sweep, and preparation with parts of former runs.
"""

import gc
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from contextlib import nullcontext, suppress
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import psutil
import pytest
import yaml
from programs import begun
from waiting import wait_for

import train_ato as ta
from plant_sim.library import consist_path, line_path
from train_ato.api.scenario_choice import choose_scenario
from train_ato.cli.main import main
from train_ato.log.run_folder import read_summary
from train_ato.loop.engine import run_engine
from train_ato.program.display_units import displayed_in
from train_ato.program.interrupt import Interrupt, ending_like_ctrl_c
from train_ato.scenario.scenario_data import PartCache, file_state
from train_ato.scenario.scenario_files import shipped_scenarios
from train_ato.scenario.setup import RunSetup
from train_ato.studies.sweep import rerun
from train_ato.studies.sweep import result as sweeps
from train_ato.studies.sweep import sweep as sweep_module
from train_ato.studies.sweep.cluster import OWNER, SCRATCH, SETTINGS, _scratch_folder, sweep_client
from train_ato.studies.sweep.groups import NotDrawable, metric_words, shown_metrics
from train_ato.studies.sweep.rerun import run_row_again
from train_ato.studies.sweep.robustness_map import CELLS, map_cells, pareto_front
from train_ato.studies.sweep.row import WALL_TIMES, drive_point, run_batch
from train_ato.studies.sweep.spec import design_points, read_sweep
from train_ato.studies.sweep.sweep import PreparedSweep, check_values, sweep_base

LAWS = '''
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from train_ato.control.guard import GuardedLaw


@dataclass
class Breaks(GuardedLaw):
    """Law with an error."""

    def demand(self, inputs):
        raise RuntimeError("broken on purpose")


@dataclass
class Kills(GuardedLaw):
    """Law that kills its process."""

    def demand(self, inputs):
        os.kill(os.getpid(), signal.SIGKILL)


@dataclass
class Freezes(GuardedLaw):
    """Law that freezes its process, the first time only."""

    def demand(self, inputs):
        frozen = Path(os.environ["FROZEN"])
        if not frozen.exists():
            frozen.touch()
            os.kill(os.getpid(), signal.SIGSTOP)
        raise RuntimeError("broken on purpose")


@dataclass
class Sleeps(GuardedLaw):
    """Law whose step never returns from C."""

    def demand(self, inputs):
        time.sleep(1e6)
'''
SPEC: dict[str, Any] = {
    "scenario": "demo", "design": "latin_hypercube", "runs": 6, "seed": 2, "set": {"duration": 30},
    "over": {
        "law": ["pid", "smc"], "links.command.delay": {"from": 0.1, "to": 3.0},
        "plant.mismatch.mass_scale": {"from": 0.7, "to": 1.3},
    },
}  # fmt: skip


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start the command in a folder, in a process group of its own."""
    return begun("sweep", *arguments, cwd=folder, start_new_session=True)


def rows_in(folder: Path) -> list[dict[str, Any]]:
    """Return the finished runs, also those that are there twice."""
    file = folder / "runs.jsonl"
    lines = file.read_text().split("\n") if file.is_file() else []
    return [json.loads(line) for line in lines[:-1] if line]


def listening(pid: int) -> set[tuple[str, int]]:
    """Return the addresses and ports on which a process and its children listen."""
    me = psutil.Process(pid)
    found = [entry for part in (me, *me.children(recursive=True)) for entry in part.net_connections("inet")]
    return {(entry.laddr.ip, entry.laddr.port) for entry in found if entry.status == psutil.CONN_LISTEN}


TIMED = ["wall_s", "evaluation_s", "overhead_s"]


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, set[str], str, str]:
    """Return the folder of a sweep with a killed worker, its listening addresses, standard output and error."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "spec.yaml").write_text(yaml.safe_dump(SPEC))
    with socket.socket() as other:
        with suppress(OSError):  # the port that Dask takes first for its pages: of another cluster, or this one
            other.bind(("127.0.0.1", 8787))
            other.listen()
        process = start(folder, "spec.yaml", "--out", "out", "--jobs", "2", "--json")
        wait_for(lambda: len(rows_in(folder / "out")) >= 2 or process.poll() is not None, "two rows")
        addresses = {address for address, _ in listening(process.pid)}
        children = psutil.Process(process.pid).children(recursive=True)
        max(children, key=lambda child: child.cpu_times().user).kill()  # a Dask worker
        output, error = process.communicate()
    assert process.returncode == 0, error
    return folder / "out", addresses, output, error


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the same sweep with one worker."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "spec.yaml").write_text(yaml.safe_dump(SPEC))
    assert main(["sweep", str(folder / "spec.yaml"), "--out", str(folder / "out"), "--jobs", "1", "--json"]) == 0
    return folder / "out"


def test_a_killed_worker_loses_and_doubles_nothing(swept: tuple[Path, set[str], str, str], whole: Path) -> None:
    """Breaks if a run of a killed worker is missing, twice or another one, or other machines reach a process."""
    folder, addresses, output, error = swept
    tables = [sweeps.read_results(at / "results.parquet")[0].drop(columns=TIMED) for at in (folder, whole)]
    assert tables[0].equals(tables[1])
    assert sorted(row["run"] for row in rows_in(folder)) == list(range(1, 7))
    assert json.loads(output)["counts"] == {"done": 6}
    assert error == ""  # without the option no dashboard is served or named
    assert addresses == {"127.0.0.1"}


def test_a_local_scheduler_executes_no_code_of_others_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Breaks if another local process is a client of the scheduler, its pages have any host, or a folder stays."""
    from distributed import Client

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with sweep_client(None, 1, dashboard=True) as client:
        address = client.scheduler_info()["address"]
        assert client.submit(os.getpid).result(timeout=60) != os.getpid()
        assert address.startswith("tls://127.0.0.1:")
        for stranger in (address, address.replace("tls://", "tcp://")):
            gc.collect()  # Dask hangs if a refused client is collected while the next one starts
            with pytest.raises((OSError, TypeError)):
                Client(stranger, timeout=2, set_as_default=False)
        page = urlsplit(client.dashboard_link)
        for host, status in (("127.0.0.1", 200), ("localhost", 200), ("evil.example", 403)):
            connection = HTTPConnection(page.hostname or "", page.port, timeout=60)
            connection.request("GET", page.path, headers={"Host": f"{host}:{page.port}"})
            assert connection.getresponse().status == status
            connection.close()
    assert list(tmp_path.iterdir()) == []


def test_only_the_folders_of_ended_sweeps_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the folder of a killed sweep stays, or that of a running sweep or of another program is removed."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for name in ("train_ato_sweep_killed", "train_ato_sweep_foreign", "other"):
        (tmp_path / name / "dask-scratch-space").mkdir(parents=True)
    for name in ("train_ato_sweep_killed", "other"):
        (tmp_path / name / OWNER).touch()
    (tmp_path / "train_ato_sweep_link").symlink_to(tmp_path / "other")
    kept = {"train_ato_sweep_foreign", "train_ato_sweep_link", "other"}
    with _scratch_folder() as running:
        assert {path.name for path in tmp_path.iterdir()} == {*kept, Path(running).name}
        with _scratch_folder() as second:
            assert {path.name for path in tmp_path.iterdir()} == {*kept, Path(running).name, Path(second).name}
    assert {path.name for path in tmp_path.iterdir()} == kept
    assert (tmp_path / "other" / OWNER).is_file()


def test_without_a_dashboard_nothing_answers_http() -> None:
    """Breaks if the pages of scheduler or workers are served without a dashboard."""
    with sweep_client(None, 1) as client:
        assert client.submit(os.getpid).result(timeout=60)
        for _, port in listening(os.getpid()):
            for path in ("/", "/status", "/info/main/workers.html", "/health", "/metrics"):
                connection = HTTPConnection("127.0.0.1", port, timeout=60)
                try:
                    connection.request("GET", path)
                    assert connection.getresponse().status == 404
                except (ConnectionError, HTTPException):
                    pass  # TLS
                finally:
                    connection.close()


def test_rows_are_those_of_runs_alone(whole: Path) -> None:
    """Breaks if a part of another run, or the worker, changes a metric: compared with ``ta.run``, bit for bit."""
    table, identity = sweeps.read_results(whole / "results.parquet")
    assert identity["spec"]["runs"] == 6 and identity["versions"]["train_ato"] == ta.__version__
    for index in (0, 5):
        row = table.iloc[index]
        run = ta.run(ta.scenario("demo").with_(SPEC["set"]), set=json.loads(row["point"]))
        kept = [key for key, value in run.metrics.items() if type(value) in (int, float)]
        kept = [key for key in kept if key not in (*WALL_TIMES, "seed")]
        assert [row[key] for key in kept] == [run.metrics[key] for key in kept]
        assert (row["verdict"], row["tracking"]) == (run.metrics.get("verdict"), run.metrics["tracking"])


@pytest.mark.usefixtures("without_figure")
def test_one_row_again_is_equal_and_a_changed_one_is_found(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a row cannot be run from the table alone, or a changed figure or hash in it is not found."""
    import pyarrow.parquet

    results = whole / "results.parquet"
    found = run_row_again(results, 5, tmp_path / "run")
    assert found.difference == "" and found.folder == tmp_path / "run"
    assert read_summary(tmp_path / "run")["controller"] == found.point["law"]
    table = pyarrow.parquet.read_table(results)
    for name, value in (("position_rmse_m", 1.0), ("sha256", "0" * 64)):
        frame = table.to_pandas()
        frame.loc[4, name] = value
        changed = tmp_path / f"{name}.parquet"
        again = pyarrow.Table.from_pandas(frame).replace_schema_metadata(
            {sweeps.METADATA: table.schema.metadata[sweeps.METADATA]}
        )
        pyarrow.parquet.write_table(again, changed)
        assert main(["sweep", str(changed), "--row", "5", "--out", str(tmp_path / f"run_{name}")]) == 1
        assert f"row 5: {name}: " in capsys.readouterr().err
    refused = {"status": "refused", "reason": "no such law", "metrics": {}}
    assert (
        rerun._first_difference({"status": "done"}, refused)
        == "status: 'done' in the table, 'refused' now (no such law)"
    )
    assert main(["sweep", str(results), "--row", "7"]) == 2
    assert "no such run; give 1 to 6" in capsys.readouterr().err


def test_a_sweep_continues_with_the_missing_runs(whole: Path, tmp_path: Path) -> None:
    """Breaks if finished runs are run again, an incomplete last line is a row, or missing runs are not run."""
    folder = tmp_path / "out"
    shutil.copytree(whole, folder)
    lines = (folder / "runs.jsonl").read_text().splitlines(keepends=True)
    (folder / "runs.jsonl").write_text("".join(lines[:4]) + lines[4][:40])
    kept = (folder / "runs.jsonl").read_bytes()
    over = SPEC["over"] | {"law": np.array(["pid", "smc"])}  # as its list
    result = ta.sweep(SPEC | {"over": over}, out=folder, jobs=1, progress=False)
    assert (folder / "runs.jsonl").read_bytes().startswith(kept)
    table, _ = sweeps.read_results(whole / "results.parquet")
    assert result.table.drop(columns=TIMED).equals(table.drop(columns=TIMED))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"seed": 3}, "the specification is another one"),
        ({"scenario": "own.yaml"}, "the specification is another one"),
        ({}, "train_ato has changed"),
    ],
)
def test_another_sweep_is_not_continued(whole: Path, tmp_path: Path, change: dict[str, Any], text: str) -> None:
    """Breaks if rows of another specification or of other code are mixed with those of this sweep."""
    folder = tmp_path / "out"
    shutil.copytree(whole, folder)
    if not change:
        identity = json.loads((folder / "sweep.json").read_text())
        (folder / "sweep.json").write_text(json.dumps(identity | {"code": "0" * 64}))
    spec = SPEC | change
    if "scenario" in change:
        spec["scenario"] = str(tmp_path / "own.yaml")
        (tmp_path / "own.yaml").write_text(ta.scenario("demo").yaml)
    with pytest.raises(ValueError, match=text):
        ta.sweep(spec, out=folder, jobs=1, progress=False)
    assert (folder / "runs.jsonl").read_bytes() == (whole / "runs.jsonl").read_bytes()


def test_the_folder_of_a_sweep_continues_it_wherever_its_file_lies(tmp_path: Path, monkeypatch: Any) -> None:
    """Breaks if the scenario beside a file has another hash by its whole path, which the folder keeps."""
    (tmp_path / "own.yaml").write_text(ta.scenario("demo").yaml)
    (tmp_path / "sweep.yaml").write_text("{scenario: own.yaml, over: {plant.lag: [0.1, 0.2]}}")
    monkeypatch.chdir(tmp_path)
    spec = read_sweep(Path("sweep.yaml"))
    kept = sweeps.sweep_identity(spec, sweep_base(spec))
    again = read_sweep(kept["spec"])
    assert sweeps.sweep_identity(again, sweep_base(again)) == kept


def test_metrics_of_a_sweep_have_the_units_of_their_words(whole: Path) -> None:
    """Breaks if --units us names metres as feet, or changes words and no numbers, in the table and the figures."""
    table, _ = sweeps.read_results(whole / "results.parquet")
    assert shown_metrics(table).equals(table)
    with displayed_in("us"):
        assert metric_words(table, "position_error_max_m") == "position error, largest in ft"
        found = shown_metrics(table)["position_error_max_m"] * 0.3048
    assert np.allclose(found, table["position_error_max_m"], equal_nan=True)


def test_two_sweeps_do_not_write_into_one_folder(whole: Path) -> None:
    """Breaks if two processes append to the same file."""
    with sweeps.SweepFolder(whole).appending(), pytest.raises(ValueError, match="another sweep writes"):
        ta.sweep(SPEC, out=whole, jobs=1, progress=False)


def test_only_the_figures_of_the_design_are_drawn(whole: Path, tmp_path: Path) -> None:
    """Breaks if a figure of the design is missing, or one is drawn that the design does not permit."""
    table, _ = sweeps.read_results(whole / "results.parquet")
    result = sweeps.SweepResult(read_sweep(SPEC), table)
    assert set(result.figures(tmp_path)) == {"box", "map", "pareto"}
    assert {path.name for path in whole.glob("*.png")} == {"box.png", "map.png", "pareto.png"}
    one = sweeps.SweepResult(read_sweep({**SPEC, "over": {"plant.lag": {"from": 0.1, "to": 0.2}}}), table)
    for plot in (one.plot_box, one.plot_map):
        with pytest.raises(NotDrawable):
            plot()
    with pytest.raises(ValueError, match="did you mean 'speed_rmse_kmh'"):
        result.plot_box("speed_rsme_kmh")
    with pytest.raises(ValueError, match="border 'stable': is unknown"):
        result.plot_map(border="stable")
    lost = table.assign(tracking="lost")
    with pytest.raises(NotDrawable, match="no run is tracked"):
        sweeps.SweepResult(read_sweep(SPEC), lost).plot_pareto()
    assert sweeps.SweepResult(read_sweep(SPEC), lost).plot_map() is not None


@pytest.fixture
def own_laws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write a module with laws for this process and its workers."""
    (tmp_path / "own_laws.py").write_text(LAWS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)


@pytest.mark.graph
def test_the_run_of_a_frozen_worker_is_named_and_runs_again(tmp_path, own_laws, monkeypatch) -> None:
    """Breaks if a sweep waits for ever for a frozen worker, or does not say which run it waits for."""
    monkeypatch.setenv("FROZEN", str(tmp_path / "frozen"))
    monkeypatch.setitem(SETTINGS, "distributed.scheduler.worker-ttl", "15s")
    monkeypatch.setattr("train_ato.studies.sweep.sweep.SILENT_S", 0.0)
    spec = {"scenario": "demo", "over": {"law": ["pid", "own_laws:Freezes"]}, "set": {"duration": 20}}
    said: list[str] = []
    found = sweep_module.PreparedSweep(read_sweep(spec), jobs=2).run(announce=said.append)
    assert (tmp_path / "frozen").exists()
    assert found.table["status"].tolist() == ["done", "failed"]
    assert "broken on purpose" in found.table["reason"][1]
    assert said[-1].startswith("no run has ended for ") and said[-1].endswith("under way: run 2"), said


def test_a_run_that_does_not_end_is_a_row(own_laws: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a run that never ends in a living worker keeps its sweep from its end, or costs the rows of others."""
    monkeypatch.setattr(sweep_module, "LOOK_S", 1.0)
    monkeypatch.setattr(sweep_module, "END_S", 40.0)
    monkeypatch.setattr(sweep_module, "END_BATCHES", 0.0)
    spec = {"scenario": "demo", "over": {"law": ["pid", "own_laws:Sleeps", "smc"]}, "set": {"duration": 2}}
    said: list[str] = []
    found = sweep_module.PreparedSweep(read_sweep(spec), jobs=1).run(announce=said.append)
    assert found.table["status"].tolist() == ["done", "failed", "done"]
    assert re.fullmatch(r"did not end within \d+ s, twice; its worker was ended", found.table["reason"][1])
    assert re.fullmatch(r"run 2 did not end within \d+ s; once more at the end, alone", said[0])


@pytest.mark.graph
def test_failed_and_refused_runs_are_rows(tmp_path: Path) -> None:
    """Breaks if a law that fails, or kills its process, ends the sweep or costs the rows of the others."""
    (tmp_path / "own_laws.py").write_text(LAWS)
    over = {"law": ["own_laws:Kills", "pid", "own_laws:Breaks"], "plant.line": ["level", "nowhere"]}
    (tmp_path / "spec.yaml").write_text(yaml.safe_dump({"scenario": "demo", "over": over, "set": {"duration": 20}}))
    process = start(tmp_path, "spec.yaml", "--out", "out", "--jobs", "2")
    _, error = process.communicate()
    assert process.returncode == 1 and "2 of 6 runs failed; first: run 1: its worker process was killed" in error
    assert "Traceback" not in error
    table, _ = sweeps.read_results(tmp_path / "out" / "results.parquet")
    statuses = ["failed", "refused", "done", "refused", "failed", "refused"]
    assert table["status"].tolist() == statuses
    assert "broken on purpose" in table["reason"][4]
    assert table["reason"].str.contains("nowhere").tolist() == [status == "refused" for status in statuses]


@pytest.mark.graph
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_an_ended_sweep_keeps_its_rows_and_leaves_no_process(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Breaks if the end of the sweep loses finished runs, leaves a worker or folder, or cannot be continued."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    slow = SPEC | {"over": SPEC["over"] | {"law": ["gpc"]}, "set": {"duration": 400}, "runs": 12}  # not compiled
    (tmp_path / "spec.yaml").write_text(yaml.safe_dump(slow))
    process = start(tmp_path, "spec.yaml", "--out", "out", "--jobs", "2")
    wait_for(lambda: len(rows_in(tmp_path / "out")) >= 2 or process.poll() is not None, "two rows")
    children = psutil.Process(process.pid).children(recursive=True)
    os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(number)
    _, error = process.communicate()
    before = rows_in(tmp_path / "out")
    wait_for(lambda: not any(child.is_running() for child in children), "the end of the workers")
    assert "Traceback" not in error
    if number != signal.SIGKILL:
        assert process.returncode == 1 and "interrupted; " in error
        assert len(sweeps.read_results(tmp_path / "out" / "results.parquet")[0]) >= 2
    process = start(tmp_path, "out", "--jobs", "2", "--json")
    output, error = process.communicate()
    assert process.returncode == 0, error
    rows = rows_in(tmp_path / "out")
    assert rows[: len(before)] == before and sorted(row["run"] for row in rows) == list(range(1, 13))
    assert list(tmp_path.glob(f"{SCRATCH}*")) == []
    assert json.loads(output)["counts"] == {"done": 12}


@pytest.mark.graph
def test_a_running_scheduler_is_used(tmp_path: Path) -> None:
    """Breaks if ``--scheduler`` starts own workers, or a scheduler without answer is not refused in one line."""
    from distributed import LocalCluster

    options = {"host": "127.0.0.1", "dashboard_address": None, "worker_dashboard_address": "127.0.0.1:0"}
    spec = SPEC | {"runs": 4, "set": {"duration": 20}}
    with LocalCluster(n_workers=1, threads_per_worker=1, local_directory=tmp_path, **options) as cluster:
        address = cluster.scheduler_address
        assert ta.sweep(spec, scheduler=address, progress=False).counts == {"done": 4}
        with pytest.raises(ValueError, match="the scheduler has its own workers"):
            ta.sweep(spec, scheduler=address, jobs=2)
    with pytest.raises(ValueError, match="no Dask scheduler answers"):
        ta.sweep(spec, scheduler=address)


@pytest.mark.parametrize("changed", ["line.yaml", "train.yaml", "swept_law.py", ""])
def test_a_sweep_does_not_go_on_with_other_files(changed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if rows of an old line, train or law are mixed with those of the new one, in fixed or varied keys."""
    shutil.copy(line_path("daqin_section"), tmp_path / "line.yaml")
    shutil.copy(consist_path("hxd1_c80_105"), tmp_path / "train.yaml")
    (tmp_path / "swept_law.py").write_text("from train_ato.control.laws.pid import Pid as Own\n")
    monkeypatch.delitem(sys.modules, "swept_law", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    scenario = {"base": "demo", "plant": {"consist": "train.yaml"}, "duration": 20}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump({"schema": "train_ato/scenario/1", **scenario}))
    over = {"law": ["pid", "swept_law:Own"], "plant.line": ["line.yaml"]}
    spec = read_sweep({"scenario": str(tmp_path / "own.yaml"), "design": "grid", "over": over})
    identities = []
    for more in ("", "# longer\n"):
        if changed:
            with (tmp_path / changed).open("a") as file:
                file.write(more)
        identities.append(PreparedSweep(spec).identity)
    folder = sweeps.SweepFolder.opened(tmp_path / "out")
    folder.begin(identities[0])
    folder.begin(identities[0])
    refused = pytest.raises(ValueError, match="the scenario has changed; name a new folder")
    with refused if changed else nullcontext():
        folder.begin(identities[1])


def test_ctrl_c_pressed_three_times_keeps_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a second or third Ctrl-C, in the end of the workers or the writing, loses ``results.parquet``."""

    def pressed(client: Any, base: Any, points: Any, take: Any, announce: Any, **_: Any) -> None:
        take(run_batch(base, points[:2]))
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            signal.raise_signal(signal.SIGINT)

    def written(*arguments: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        sweeps.write_results(*arguments)

    monkeypatch.setattr(sweep_module, "sweep_client", lambda *_, **__: nullcontext())
    monkeypatch.setattr(sweep_module, "Execution", pressed)
    monkeypatch.setattr(sweep_module, "write_results", written)
    with ending_like_ctrl_c(Interrupt()), pytest.raises(ta.RunInterrupted, match="2 finished runs"):
        ta.sweep(SPEC | {"set": {"duration": 5}}, out=tmp_path / "out", progress=False)
    assert len(sweeps.read_results(tmp_path / "out" / "results.parquet")[0]) == 2
    monkeypatch.setattr(sweep_module, "Execution", lambda *_, **__: signal.raise_signal(signal.SIGINT))
    with ending_like_ctrl_c(Interrupt()), pytest.raises(ta.RunInterrupted, match=r"^interrupted$"):
        ta.sweep(SPEC | {"set": {"duration": 5}}, out=tmp_path / "none", progress=False)
    assert not (tmp_path / "none").exists()


GOOD: dict[str, Any] = {"scenario": "demo", "over": {"seed": [1, 2]}}
REFUSED = [
    ({"over": {"seed": [1]}}, "scenario: None: is no scenario"),
    (GOOD | {"ovr": 1}, "ovr: unknown key; did you mean 'over'?"),
    (GOOD | {"design": "sobel"}, "design: 'sobel' is unknown; did you mean 'sobol'?"),
    (GOOD | {"runs": 5}, "runs: a grid has its own number of runs"),
    (GOOD | {"design": "random"}, "runs: is missing"),
    (GOOD | {"design": "random", "runs": 0}, "runs: 0: is not an integer of 1"),
    (GOOD | {"design": "sobol", "runs": 100}, "use 64 or 128"),
    (GOOD | {"seed": -1}, "seed: -1"),
    (GOOD | {"set": {"seed": 3}}, "set: seed: varies in over"),
    (GOOD | {"set": [1]}, "set: [1]: not a mapping"),
    ({"scenario": "demo", "over": {"seed": {"from": 1, "to": 1000, "steps": 1000}, "plant.lag":
      {"from": 0.1, "to": 0.2, "steps": 1001}}}, "at most 1000000"),
]  # fmt: skip
BAD_VALUES = [
    ({"seeds": [1, 2]}, {}, "over: seeds: 1: "),
    ({"plant.lag_kmh": [1.0]}, {}, "over: plant.lag_kmh: 1.0"),
    ({"plant.lag": [0.2, -1.0]}, {}, "over: plant.lag: -1.0"),
    ({"plant.lag": {"from": -1.0, "to": 0.5}}, {}, "over: plant.lag: -1.0"),
    ({"law": ["pid", "pdi"]}, {}, "over: law: 'pdi': "),
    ({"observer": ["nod"]}, {}, "over: observer: 'nod': "),
    ({"laws.pid.kpp": [1.0, 2.0]}, {}, "over: laws.pid.kpp: 1.0"),
    ({"seed": [1]}, {"plant.lagg": 0.4}, "set: plant.lagg"),
]


@pytest.mark.parametrize(("data", "text"), REFUSED)
def test_a_wrong_specification_is_refused(data: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError) as error:
        read_sweep(data, "study.yaml")
    assert text in str(error.value) and str(error.value).startswith("study.yaml: ")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("over", "fixed", "text"), BAD_VALUES)
def test_every_value_is_checked_before_the_start(over: dict[str, Any], fixed: dict[str, Any], text: str) -> None:
    """Breaks if an unknown key, a value out of range or an unknown name of a component starts a sweep."""
    spec = read_sweep({"scenario": "demo", "over": over, "set": fixed}, "study.yaml")
    with pytest.raises(ValueError) as error:
        check_values(spec, sweep_base(spec), design_points(spec))
    assert str(error.value).startswith(f"study.yaml: {text}")


@pytest.mark.parametrize("address", ["foo", "tcp://host:port", "foo://host:8786"])
def test_a_wrong_address_is_refused_without_a_client(address: str) -> None:
    """Breaks if Dask gets a wrong address: the end of its client prints a traceback after 20 s."""
    with pytest.raises(ValueError, match=f"--scheduler {address}: .*; write tcp://HOST:PORT"), sweep_client(address, 1):
        pass


def test_a_folder_without_a_sweep_is_named_so(tmp_path: Path) -> None:
    """Breaks if the message denies a folder that exists."""
    with pytest.raises(ValueError, match="is a folder without a sweep"):
        read_sweep(tmp_path)


def test_a_value_is_valid_with_the_others_of_its_point() -> None:
    """Breaks if two keys that are only valid together are refused."""
    over = {"step": [0.005, 0.004], "tick": [0.1]}
    spec = read_sweep({"scenario": "demo", "over": over | {"control_period": [0.1]}, "set": {"duration": 20}})
    check_values(spec, sweep_base(spec), design_points(spec))


def test_gains_that_no_run_has_are_noted(capfd: pytest.CaptureFixture[str]) -> None:
    """Breaks without the note on gains of another law, or if a law of the sweep has it."""
    for law, over in (("pid", {}), ("pid", {"law": ["pid", "smc"]}), ("smc", {})):
        spec = read_sweep(
            {"scenario": "demo", "over": {"laws.smc.ks": [1.0], **over}, "set": {} if over else {"law": law}}
        )
        check_values(spec, sweep_base(spec), design_points(spec))
    note = "over: laws.smc.ks: no run has the law smc, so its values change nothing; set law: smc"
    assert capfd.readouterr().err.splitlines() == [f"note: sweep: {note}"]


def test_a_file_beside_the_specification_comes_first(tmp_path: Path) -> None:
    """Breaks if a scenario file is sought in the current folder only."""
    (tmp_path / "own.yaml").write_text(choose_scenario("demo").with_(duration=20).yaml)
    (tmp_path / "study.yaml").write_text(yaml.safe_dump({"scenario": "own.yaml", "over": {"seed": [1]}}))
    spec = read_sweep(tmp_path / "study.yaml")
    assert (spec.title, sweep_base(spec).choice().checked.duration) == ("own", 20.0)


def test_a_grid_has_every_combination_once() -> None:
    over = {"law": ["pid", "smc"], "plant.lag": {"from": 0.1, "to": 0.3, "steps": 3}}
    points = design_points(read_sweep({"scenario": "demo", "over": over}))
    assert [tuple(point.values()) for point in points] == [
        ("pid", 0.1), ("pid", 0.2), ("pid", 0.3), ("smc", 0.1), ("smc", 0.2), ("smc", 0.3),
    ]  # fmt: skip


@pytest.mark.parametrize("design", ["random", "latin_hypercube", "sobol"])
def test_a_design_is_reproducible_and_inside(design: str) -> None:
    """Breaks if the seed has no effect, a value is outside of its range, or a design does not fill the range."""
    # A Latin hypercube has exactly one of n points in each n-th of the range, a scrambled Sobol sequence of 2^k points
    # as well; 32 uniform numbers all miss some of 4 quarters with a probability of 4 (3/4)^32 = 4e-4, and the seed is
    # fixed.
    over: dict[str, Any] = {"law": ["pid", "smc"], "plant.lag": {"from": 0.01, "to": 1.0, "scale": "log"}, **{
        "links.command.delay": {"from": 0.0, "to": 2.0}, "seed": {"from": 1, "to": 9}}}  # fmt: skip
    data = {"scenario": "demo", "design": design, "runs": 32, "seed": 5, "over": over}
    points = design_points(read_sweep(data))
    assert points == design_points(read_sweep(data)) != design_points(read_sweep(data | {"seed": 6}))
    assert len(points) == 32 and {point["law"] for point in points} == {"pid", "smc"}
    assert all(isinstance(point["seed"], int) and 1 <= point["seed"] <= 9 for point in points)
    delays = np.array([point["links.command.delay"] for point in points]) / 2.0
    lags = np.log(np.array([point["plant.lag"] for point in points]) / 0.01) / np.log(100.0)
    parts = 4 if design == "random" else 32
    for shares in (delays, lags):
        counts = np.bincount(np.minimum((shares * parts).astype(int), parts - 1), minlength=parts)
        assert counts.min() >= 1 and (design == "random" or counts.max() == 1)


def test_a_law_that_ends_its_process_fails_its_run_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if `os._exit` of a law ends the worker: its row has then another reason, and other runs are repeated."""
    monkeypatch.setattr("os._exit", lambda status: 1 / 0)
    law = "import os\nfrom train_ato.control.guard import GuardedLaw\nclass Law(GuardedLaw):\n"
    law += "    def __init__(self, ends: float = 0.0):\n        if ends: os._exit(4)\n"
    body = "    def demand(self, inputs):\n        os._exit(5)\n"
    (tmp_path / "exiting_law.py").write_text(law + body)
    monkeypatch.syspath_prepend(tmp_path)
    metro = choose_scenario("xuzhou_metro").with_(duration=5)
    for point, status in (({}, 5), ({"laws.exiting_law:Law.ends": 1.0}, 4)):
        row = drive_point(metro, 1, {"law": "exiting_law:Law", **point}, PartCache())
        assert f"called os._exit({status})" in row["reason"]


def test_a_row_has_the_end_of_its_run() -> None:
    """Breaks if a refused or failed run has no row with its reason, or a row lacks the hash of its scenario."""
    demo, parts = choose_scenario("demo").with_(duration=20), PartCache()
    done = drive_point(demo, 1, {"law": "smc", "seed": 3}, parts)
    assert (done["status"], done["reason"], done["law"], done["seed"]) == ("done", "", "smc", 3)
    assert done["metrics"]["ticks"] == 200 and len(done["sha256"]) == 64 and "wall_s" not in done["metrics"]
    assert drive_point(demo, 2, {"law": "smc", "seed": 3}, parts)["metrics"] == done["metrics"]
    assert drive_point(demo, 2, {"law": "smc", "seed": 4}, parts)["sha256"] != done["sha256"]
    refused = drive_point(demo, 3, {"plant.line": "nowhere"}, parts)
    assert refused["status"] == "refused" and "nowhere" in refused["reason"] and "sha256" not in refused
    table = sweeps.sweep_table([done, refused], ["law"])
    assert table["status"].tolist() == ["done", "refused"] and np.isnan(table["speed_rmse_kmh"][1])


def test_columns_of_mixed_values_are_json() -> None:
    """Breaks if a key with values of several types cannot be written as a column."""
    row = {"run": 1, "status": "done", "reason": ""}
    rows = [{**row, "point": {"a": [1]}}, {**row, "run": 2, "point": {"a": "x"}}]
    assert sweeps.sweep_table(rows, ["a"])["a"].tolist() == ["[1]", '"x"']


def test_the_pareto_front_is_the_set_without_a_better_run() -> None:
    """Breaks if a beaten run is on the front or an unbeaten one is not; compared with all pairs."""
    first, second = np.random.default_rng(4).integers(0, 12, (2, 60)).astype(float)
    front = pareto_front(first, second)
    values = set(zip(first.tolist(), second.tolist(), strict=True))
    beaten = {(a, b) for a, b in values for c, d in values if c <= a and d <= b and (c, d) != (a, b)}
    assert set(zip(first[front].tolist(), second[front].tolist(), strict=True)) == values - beaten
    assert len(front) == len(values - beaten) and (np.diff(first[front]) > 0).all()


def test_a_place_of_the_map_is_stable_if_all_its_runs_are() -> None:
    """Breaks if a good run hides a bad one at the same place, or a cell has not the value of the nearest run."""
    first, second = np.array([0.25, 0.25, 0.75]), np.array([0.5, 0.5, 0.5])
    cells = map_cells(first, second, np.array([1.0, 0.0, 1.0]), np.array([1.0, -3.0, 2.0]))
    assert cells.stable.tolist() == [0.0, 1.0] and cells.value.tolist() == [3.0, 2.0]
    assert (cells.nearest[:, : CELLS // 2] == 0).all() and (cells.nearest[:, CELLS // 2 :] == 1).all()


@pytest.mark.parametrize(("name", "runs"), [("sweep", 200), ("map", 64 * 64)])
def test_an_example_is_a_valid_specification(name: str, runs: int) -> None:
    """Breaks if a key or a value of an example is refused, or the map is not the one of its measured time."""
    spec = read_sweep(Path(__file__).parent.parent / "examples" / f"{name}.yaml")
    points = design_points(spec)
    check_values(spec, sweep_base(spec), points)
    assert len(points) == runs


CHANGES = (
    {}, {"plant.lag": 0.3}, {"links.command.delay": 0.6}, {"plant.line": "level"}, {"plant.consist": "xuzhou_metro_3"},
    {"plant.grade_over_length": True}, {"profile.limits": {"jerk": 0.5}}, {"tick": 0.2}, {"seed": 7},
)  # fmt: skip


def equal(one: RunSetup, other: RunSetup) -> bool:
    """Return True if two setups have the same scenario, profile and model, bit for bit."""
    arrays = ("time", "position", "velocity", "acceleration")
    same = all(getattr(one.profile, name).tobytes() == getattr(other.profile, name).tobytes() for name in arrays)
    places = np.linspace(one.line.begin, one.line.end, 50)
    forces = [(one.model.line_force(place), other.model.line_force(place)) for place in places.tolist()]
    model = one.model.lag == other.model.lag and np.array_equal(one.model.delay, other.model.delay)
    return same and model and all(a == b for a, b in forces) and one.resolved_yaml() == other.resolved_yaml()


def test_parts_of_former_runs_give_the_same_run() -> None:
    """Breaks if a value that determines a part is not in its key: the part of another run is used."""
    demo, parts = choose_scenario("demo").with_(duration=20), PartCache()
    for change in (*CHANGES, *CHANGES):
        try:
            fresh = demo.with_(change).prepare()
        except ValueError as error:
            with pytest.raises(ValueError) as refused:
                demo.with_(change).prepare(parts=parts)
            assert str(refused.value) == str(error)
        else:
            assert equal(demo.with_(change).prepare(parts=parts), fresh), change


def test_a_run_with_former_parts_has_the_same_metrics() -> None:
    """Breaks if a run changes a part that the next run shares."""
    demo, parts = choose_scenario("demo").with_(duration=30), PartCache()
    skipped = ("wall_s", "real_time_factor", "step_time_us_median", "step_time_us_p99")
    summaries = [run_engine(demo.prepare(parts=parts)).summary for _ in range(2)]
    first, second = ({key: value for key, value in summary.items() if key not in skipped} for summary in summaries)
    assert first == second


def test_equal_values_share_a_part_and_the_oldest_is_dropped() -> None:
    """Breaks if nothing is reused, or the memory of a worker grows with every run."""
    made: list[int] = []
    cache = PartCache(size=2)

    def part(key: int) -> int:
        return cache.get(("part", key), lambda: made.append(key) or key)  # type: ignore[func-returns-value]

    assert [part(key) for key in (1, 2, 1, 3, 1, 2)] == [1, 2, 1, 3, 1, 2]
    assert made == [1, 2, 3, 2]


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    line = choose_scenario("demo").prepare().line.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    file, parts = tmp_path / "line.yaml", PartCache()
    demo = choose_scenario("demo").with_({"plant.line": str(file), "duration": 20})
    file.write_text(yaml.safe_dump(line))
    assert demo.prepare(parts=parts).line.name == line["name"]
    before = file_state(file)
    file.write_text(yaml.safe_dump({**line, "name": "another_line"}))
    assert before != file_state(file)
    assert demo.prepare(parts=parts).line.name == "another_line"
    assert file_state(tmp_path / "missing") is None


@pytest.mark.parametrize("name", ["demo", "xuzhou_metro", "daqin_heavy_haul", "crh380a_gpc"])
def test_the_resolved_scenario_is_the_text_of_yaml(name: str) -> None:
    """Breaks if the text that is joined from blocks is not that of the whole mapping: runs would get other hashes."""
    assert name in shipped_scenarios()
    setup = choose_scenario(name).prepare()
    whole = yaml.safe_dump(setup._resolved_data, sort_keys=False, allow_unicode=True, width=120)
    assert setup.resolved_yaml() == whole
