"""Bad input: one line, exit status 2, no files left, remedies that are accepted. Each row is a user error."""

import itertools
import json
import os
import re
import shlex
import subprocess
import sys
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import yaml
from case_costs import sampled
from commands import complaint
from engine_runs import no_figure, setup_of
from programs import begun, python

import train_ato as ta
from plant_sim.library import consist_path, line_path
from train_ato.api.progress import COMPILE_NOTE, PLANNER_NOTE
from train_ato.cli import main
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS
from train_ato.log.whole_file import write_whole
from train_ato.profile.motion import change_of_speed
from train_ato.scenario.overlays import caused_by

ROOT = Path(__file__).resolve().parents[1]
NINES = "9" * 5000


def data(path: Path, **changes: object) -> dict[str, Any]:
    return {**yaml.safe_load(path.read_text()), **changes}


TRAIN, TRACK = consist_path("hxd1_c80_105"), line_path("daqin_section")


def light(mass_t: float) -> dict[str, Any]:
    train = data(TRAIN)
    train["vehicle_types"]["c80"]["mass_t"] = mass_t
    return train


def refused_commands() -> dict[str, str]:
    """Return the message of every command line of the table."""
    text = (ROOT / "test" / "data" / "refused_commands.txt").read_text(encoding="utf-8").replace("=>\n    ", "=> ")
    return dict(row.split(" => ", 1) for row in text.splitlines() if row and not row.startswith("#"))


@pytest.fixture(scope="module")
def exported_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a run of 15 s with the folder of an export."""
    folder = tmp_path_factory.mktemp("run") / "run"
    with no_figure():
        ta.run("demo", set={"duration": 15}, progress=False).save(folder)
    (folder / "export").mkdir()
    return folder


@pytest.mark.parametrize(("command", "message"), refused_commands().items())
def test_bad_input_is_one_line_and_status_2(command, message, exported_run, tmp_path, monkeypatch, capfd) -> None:
    """Breaks on a traceback, another exit status, a vague message, or a file that stays behind or is overwritten."""
    command, _, given = command.partition(" < ")
    if command.startswith(("replay", "view")):
        pytest.importorskip("rclpy")
    for name, text in {"there.yaml": "mine", "taken.html": "mine", "mine.png": "mine", "given.yaml": given}.items():
        (tmp_path / name).write_text(json.loads(text) if text and name == "given.yaml" else text)
    places = {"{run}": exported_run, "{source}": ROOT / "test" / "conftest.py", "{nines}": NINES, "{long}": "a" * 300}
    words = shlex.split(command)
    for mark, text in places.items():
        words = [word.replace(mark, str(text)) for word in words]
    pattern = message[1:] if message.startswith("~") else re.escape(message)
    refused(words, pattern, tmp_path, monkeypatch, capfd)
    assert all((tmp_path / name).read_text() == "mine" for name in ("there.yaml", "taken.html", "mine.png"))


FILES: list[tuple[str, str, dict[str, object], str]] = [
    ("negative mass", "consist", light(-3), r"train\.yaml: vehicle_types\.c80\.mass_t = -3: .*greater than 0"),
    ("mass of 2^40 t", "consist", light(2.0**40),
     r"train\.yaml: vehicle_types\.c80: mass 1\.\d*e\+15 kg is above 1000000000 kg"),
    ("mass of 2^64 t", "consist", light(2.0**64),
     r"train\.yaml: vehicle_types\.c80\.mass_t = 1\.8.*: input should be between -1e\+15 and 1e\+15; correct it"),
    ("mass that is a truth value", "consist", light(True),
     r"train\.yaml: vehicle_types\.c80\.mass_t = True: .*a number"),
    ("grade that is a truth value", "line", data(TRACK, grades=[{"at": 0.0, "grade_permille": True}]),
     r"track\.yaml: grades\.0\.grade_permille = True: .*a number"),
    ("empty consist", "consist", data(TRAIN, train=[]), r"train\.yaml: train.*at least 1"),
    ("unknown type", "consist", data(TRAIN, train=[{"type": "c70"}]), r"train\.yaml: .*'c70'"),
    ("profile beyond it", "line", data(TRACK, end_km=2.0), r"beyond the end of line 'daqin_section' at km 2\.000"),
]  # fmt: skip


@pytest.mark.parametrize(("what", "data", "message"), [case[1:] for case in FILES], ids=[case[0] for case in FILES])
def test_bad_data_files(what, data, message, tmp_path, monkeypatch, capsys):
    """Breaks if a train or line file is taken as it comes, or the message does not name it."""
    name = "train.yaml" if what == "consist" else "track.yaml"
    (tmp_path / name).write_text(yaml.safe_dump(data))
    refused(["run", "demo", "--set", f"plant.{what}={name}"], message, tmp_path, monkeypatch, capsys)


@pytest.mark.parametrize("text", ["x: " + "[" * 50_000, "- " * 50_000], ids=["flow", "block"])
@pytest.mark.parametrize("reader", ["line", "profile"])
def test_deep_yaml_of_other_formats(reader, text, tmp_path, monkeypatch, capsys):
    """Breaks if a file is composed by recursion in C: the stack overflows and the process ends with SIGSEGV."""
    (tmp_path / "deep.yaml").write_text(text)
    profile = ["run", "demo", "--engine", "--set", f"profile={{file: {tmp_path}/deep.yaml}}"]
    command = ["plan", "level", "deep.yaml"] if reader == "line" else profile
    refused(command, r"deep\.yaml: not valid.*nested deeper than 100 levels", tmp_path, monkeypatch, capsys)


def test_large_jerk_limits_nothing() -> None:
    """Breaks if the ramps of a large jerk limit cancel the speed curve by rounding and the motion becomes endless."""
    found = [
        sum(piece.duration for piece in change_of_speed(0.0, 20.0, lambda speed: 0.8 + 0 * speed, jerk))
        for jerk in (1e6, 1e12, 1e300)
    ]
    assert found[1:] == pytest.approx(found[:1] * 2, rel=1e-9)
    assert found[0] == pytest.approx(25.0, rel=0.01)  # 20 m/s at 0.8 m/s²


@pytest.mark.parametrize("command", [["run", "demo"], ["run", "demo", "--processes"], ["replay", "{golden}"]])
def test_a_middleware_that_is_not_installed(command, tmp_path, monkeypatch, capsys):
    """Breaks if rcl ends the process with status 102 after the folder was made."""
    pytest.importorskip("rclpy")
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_of_another_vendor")
    words = [word.format(golden=ROOT / "test" / "golden" / "short_train") for word in command]
    message = r"RMW_IMPLEMENTATION=rmw_of_another_vendor: this middleware is not installed; `unset RMW_IMPLEMENTATION`"
    refused(words, message, tmp_path, monkeypatch, capsys)


@pytest.mark.usefixtures("without_figure")
def test_a_summary_that_is_none(tmp_path, monkeypatch, capsys):
    """Breaks if an edited summary ends in a traceback, or the message does not name the file."""
    monkeypatch.chdir(tmp_path)
    assert main(["run", "demo", "--engine", "--json", "--set", "duration=1", "--out", "run"]) == 0
    capsys.readouterr()
    changes = ("3", "[3]", '[{"at_s": 1, "name": "kp", "value": []}]')
    texts = ("{", "[]", "", *(f'{{"changes": {each}}}' for each in changes), '{"status": []}', "[" * 100_000)
    for text in texts:
        Path("run/summary.json").write_text(text)
        refused(["info", "run"], r"run/summary\.json: ", tmp_path, monkeypatch, capsys)
        refused(["verify", "run"], r"run/summary\.json: ", tmp_path, monkeypatch, capsys)


BOMB = "a: &a [x, x]\n" + "".join(
    f"{k}: &{k} [{', '.join(['*' + p] * 9)}]\n" for p, k in zip("abcdefgh", "bcdefghi", strict=True)
)
"""A few hundred bytes that unfold to 10^8 words."""


def refused(arguments: list[str], message: str, folder: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(folder)
    before = sorted(path.name for path in folder.rglob("*"))
    try:
        status = main(arguments)
    except SystemExit as end:
        status = int(end.code or 0)
    captured = capsys.readouterr()
    assert status == 2, captured.err
    assert captured.out == ""
    assert "^" not in captured.err, "no pattern of a library"
    rows = [line for line in captured.err.strip().splitlines() if line not in (COMPILE_NOTE, PLANNER_NOTE)]
    lines = [line for line in rows if not line.startswith("note: ")]
    assert len(lines) == 1, captured.err
    assert re.search(message, captured.err), captured.err
    assert sorted(path.name for path in folder.rglob("*")) == before


OWN = "schema: train_ato/scenario/1\nbase: "
BAD_FILES = (
    "", "[1, 2]", "hello", "5", "!!python/object/apply:os.system [ls]", "schema: !own x", "name: a\nname: b",
    "a:\n\t- b", "? [a]\n: 1", f"duration: {NINES}", f'{{"a": {NINES}}}', '{"a": 1, "a": 2}', "{", "\x00\x01",
    "name: \xe9", f"{OWN}demo\ndurration: 3", f"{OWN}demo\nplant: 5", f"{OWN}demmo", f"{OWN}demo\nduration: .nan",
    f"{OWN}demo\nseed: -1", BOMB, "[" * 5000,
)  # fmt: skip
"""Content of files that no command reads."""
READERS = (
    "run {} --engine", "compare {} --laws pid", "sweep {}", "tune {} --law pid --out o", "list {}", "curves {}",
    "tune demo --law pid --over {} --out o", "falsify {} --requirement 'G speed >= 0' --over x", "learn {} --out l.yml",
    "falsify demo --requirement 'G speed >= 0' --over {}", "plan {} xuzhou_metro_3", "plan level {}",
    "plan xuzhou_metro_test xuzhou_metro_3 --journey {}", "plan daqin_section hxd1_c80_105 --trip {}",
    "driver {} hxd1_c80_105 --until-km 1 --out d.csv", "convert {} c.yaml", "view --scenario {}",
    "import {} --train xuzhou_metro_3 --line level --out i", "run demo --engine --set plant.line={}",
    "compare demo --laws pid --set plant.consist={}", "tune demo --law pid --out o --set 'profile={{file: {}}}'",
    "run demo --engine --set model.learned={}", "info {}", "report {}", "export {}", "recover {}", "verify {}",
    "replay {}", "replay {} --law pid", "view {}", "layout {} --foxglove", "scene {}",
)  # fmt: skip
"""Command lines with the place of a file."""
OPTIONS = (
    "run demo --engine --seed {}", "run demo --engine --rate {}", "sweep x.yaml --jobs {}", "compare demo --laws {}",
    "tune demo --law pid --out o --runs {}", "tune demo --law pid --out o --criterion x={}", "reproduce {}",
    "tune demo --law pid --out o --parameters {}", "learn demo --out l.yaml --spacing {}", "check-law {}",
    "falsify demo --requirement 'G speed >= 0' --over x --runs {}", "plan level xuzhou_metro_3 --to-km {}",
    "plan level xuzhou_metro_3 --jerk {}", "plan level xuzhou_metro_3 --period {}", "curves demo --at-km {}",
    "plan xuzhou_metro_test xuzhou_metro_3 --time {}", "export x --rate {}", "replay x --rate {}", "param {}",
    "driver level xuzhou_metro_3 --out d.csv --until-km {}", "info x --requirement {}", "param law=pid --domain {}",
    "verify x --relative {}", "check-observer {}", "run demo --engine --law {}", "view --scenario demo --port {}",
    "import x.csv --consist xuzhou_metro_3 --line level --tick {}",
)  # fmt: skip
PYTHON_WORDS = (
    r"Traceback|set_int_max_str|\^\[|NoneType|object has no|\[Errno|<class|invalid literal|subscriptable|unhashable|"
    r"give 0 \.\.\. -1|\b(?:not|holds) (?:str|int|dict|list|float)\b|invalid (?:int|float) value|"
    r"[a-z]+_type\b|(?:Type|Value|Key|Attribute|Index|Overflow)Error|shipped/demo\.yaml|embedded null|codec"
)
"""Words of Python or of its libraries, and files that are right."""


def test_a_file_has_one_line_for_each_of_its_faults(tmp_path, monkeypatch, capsys):
    """Breaks if a file with several faults must be run again for each, or one fault hides those of another block."""
    monkeypatch.chdir(tmp_path)
    head = "schema: train_ato/scenario/1\nbase: demo\n"
    vehicles = "train: [{type: v}], vehicle_types: {v: {mass_t: -3, lenght: 4}}"
    Path("own.yaml").write_text(
        f"{head}durration: 3\ntick: -1\nseed: x\ncriteria: {{stop_window: -1, jerk: fast}}\n"
        f"plant: {{lagg: 1, consist: {{schema: train_ato/consist/1, name: a, summary: b, {vehicles}}}}}\n"
        "profile: {phases: [{accelerate_kmh: 3}, {brake_to: -}]}\n"
    )
    places = [re.split(": | = ", line)[2] for line in complaint(capsys, "run", "own.yaml", "--engine").splitlines()]
    wrong = ["durration", "tick", "seed", "criteria.stop_window", "criteria.jerk", "plant.lagg"]
    wrong += [f"plant.consist.vehicle_types.v.{key}" for key in ("mass_t", "lenght", "length", "resistance")]
    wrong += ["profile.phases.0.accelerate_kmh", "profile.phases.1.brake_to"]
    assert sorted(places) == sorted(wrong)
    Path("own.yaml").write_text(head + "".join(f"k{number}: 1\n" for number in range(30)))
    lines = complaint(capsys, "run", "own.yaml", "--engine").splitlines()
    assert (len(lines), lines[-1]) == (21, "train-ato: own.yaml: 10 more faults; correct these first")


def told_in_plain_words(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Check status and text of a refusal: one line with a remedy; a file has one for each of at most 20 faults."""
    before = sorted(Path().iterdir())
    try:
        status: object = main(words)
    except SystemExit as exit_:
        status = exit_.code
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("note: ")]
    assert status == 2, (words, lines)
    assert 1 <= len(lines) <= 21, (words, lines)
    places = {tuple(line.split(": ")[:2]) for line in lines}
    assert len(places) == 1 or words[0] == "import", (words, lines)
    assert len(lines) == 1 or words[0] == "import" or not places.pop()[1].startswith("-"), "an option has one fault"
    for line in lines:
        assert len(line) < 1200 and not re.search(PYTHON_WORDS, line), (words, line)
        assert re.search(r"; |must |did you mean|use one of|name one|give |see ", line), (words, line)
    assert sorted(Path().iterdir()) == before


@pytest.mark.parametrize(("line", "part"), sampled(product(READERS, range(3)), every=3))
def test_a_bad_file_is_refused_in_plain_words(line, part, tmp_path, monkeypatch, capsys):
    """Breaks if a command names a class, a pattern or a shipped file, or begins its work, for one kind of bad file."""
    # The quick case of a command has every third file, the next command the files after them.
    monkeypatch.chdir(tmp_path)
    names = ["none.yaml", "folder", "a" * 300 + ".yaml", "folder/none.yaml", "bad.csv/x.yaml", "bad.csv"]
    for number, text in enumerate(BAD_FILES):
        names.append(f"bad{number}.{'json' if text.startswith('{') else 'yaml'}")
        Path(names[-1]).write_bytes(text.encode("latin-1"))
    Path("bad.csv").write_text("tiem,speed\n0,nan\n")
    Path("folder").mkdir()
    for name in names[(READERS.index(line) + part) % 3 :: 3]:
        told_in_plain_words([word.format(name) for word in shlex.split(line)], capsys)


@pytest.mark.parametrize(
    ("name", "text", "held"),
    [
        ("a.yaml", "schema: train_ato/consist/1", r"a train \(train_ato\), no scenario; name it as plant.consist"),
        ("a.yaml", "schema: train_ato/line/1", r"a line \(train_ato\), no scenario; name it as plant.line"),
        ("a.json", '{"track_sections": []}', r"a line \(OSRD\), no scenario; name it as plant.line in one"),
        ("a.yaml", "{vehicles: [], trains: []}", r"a train \(railtoolkit\), no scenario; name it as plant.consist"),
        ("a.yaml", "schema: train_ato/sweep/1", "not supported; write 'train_ato/scenario/1'"),
    ],
)
def test_a_train_or_line_as_a_scenario_is_named(name, text, held, tmp_path, monkeypatch, capsys):
    """Breaks if the remedy for a train or a line in the place of a scenario is another word for its schema."""
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(text)
    err = complaint(capsys, "run", name, "--engine")
    assert re.match(f"train-ato: {name}: .*{held}", err) and len(err.splitlines()) == 1


@pytest.mark.parametrize("line", OPTIONS)
def test_a_bad_value_is_refused_in_plain_words(line, tmp_path, monkeypatch, capsys):
    """Breaks if an option names a Python type, repeats 5 000 digits, or accepts a value that is none."""
    monkeypatch.chdir(tmp_path)
    for value in ("nan", "-1", "x", "inf", NINES, "1e400", "", "0x10", "no:Law", "..:x"):
        told_in_plain_words([word.replace("{}", value) for word in shlex.split(line)], capsys)


def test_help_and_usage_errors_need_no_heavy_library() -> None:
    """Breaks if a command imports a heavy library before its options are read: help would take a second."""
    libraries = {"numpy", "numba", "matplotlib", "pydantic", "rclpy", "pandas", "pyarrow", "rich"}
    code = (
        "import sys; from train_ato.cli import main; from train_ato.cli.main import COMMANDS\n"
        "for words in ([], *([name] for name, _ in COMMANDS)):\n"
        "    for option in ('--help', '--no-such-option'):\n"
        "        try: main([*words, option])\n"
        "        except SystemExit: pass\n"
        f"    heavy = {libraries} & set(sys.modules)\n"
        "    if heavy: sys.exit(f'{words}: {sorted(heavy)}')"
    )
    done = python("-c", code)
    errors = [line for line in done.stderr.splitlines() if not line.startswith("train-ato")]
    assert (done.returncode, errors) == (0, []) and "run a scenario and record it" in done.stdout


@pytest.mark.parametrize("arguments", [["list"], ["list", "--json"], ["list", "pid"]])
def test_a_closed_reader_is_not_an_error(arguments: list[str]) -> None:
    """`train-ato list | head -0`: breaks if a traceback or an error of the pipe is printed."""
    reader, writer = os.pipe()
    os.close(reader)
    process = begun(*arguments, stdout=writer)
    os.close(writer)
    assert process.communicate()[1] == ""


def shell(words: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a command with redirections of a shell; ``train-ato`` is the command of the source tree."""
    command = words.replace("train-ato", f"{shlex.quote(sys.executable)} -m train_ato")
    environment = {**os.environ, **variables}
    return subprocess.run(["bash", "-c", command], cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_do_not_end_a_run(closed: str, tmp_path: Path) -> None:
    """Breaks on a traceback after the run, a run that is refused in silence, or prints in a file of the run."""
    done = shell(f"train-ato run demo --engine --set duration=2 --out run {closed}", tmp_path)
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert main(["verify", str(tmp_path / "run")]) == 0
    assert shell(f"train-ato run demmo {closed}", tmp_path).returncode == 2


def test_a_removed_folder_is_named(tmp_path: Path) -> None:
    """Breaks if the remedy is one for temporary files."""
    (tmp_path / "gone").mkdir()
    done = shell("rmdir ../gone; train-ato list", tmp_path / "gone")
    assert done.stderr.endswith("train-ato: the present folder was removed; change to another one\n")


def test_a_page_of_a_name_that_is_no_text_is_written(tmp_path: Path) -> None:
    """Breaks if a report of a folder whose name is not in UTF-8 is refused by the encoding."""
    write_whole(tmp_path / "page", "r\udcff")
    assert (tmp_path / "page").read_text() == r"r\udcff"


def test_characters_outside_an_encoding_are_escapes(tmp_path: Path) -> None:
    """Breaks if a run is done and then refused because a stream cannot show a letter, or the JSON is not valid."""
    run = "train-ato run demo --engine --set duration=2"
    done = shell(run, tmp_path, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr.replace(COMPILE_NOTE, "").strip()) == (0, "")
    assert r"\xb5s" in done.stdout
    text = shell(f"{run} --set 'summary=µ' --json", tmp_path, PYTHONIOENCODING="ascii").stdout
    assert json.loads(text)["ticks"] == 20
    assert json.loads(shell("train-ato list --json", tmp_path, PYTHONIOENCODING="ascii").stdout)


def test_a_full_disk_little_memory_and_sys_exit_in_a_component_are_failures(monkeypatch, capsys):
    """Breaks if a failed write has the status of a wrong argument, or ``sys.exit(0)`` of a user that of success."""

    def execute(options: object) -> int:
        raise OSError(28, "No space left on device", "out/run.mcap")

    monkeypatch.setattr("train_ato.cli.list.execute", execute)
    assert main(["list"]) == 1
    assert capsys.readouterr().err == "train-ato: out/run.mcap: No space left on device\n"
    monkeypatch.setattr("train_ato.cli.list.execute", lambda options: bytearray(2**62))
    assert main(["list"]) == 1
    assert capsys.readouterr().err == "train-ato: not enough memory; check the units of the largest values\n"
    monkeypatch.setattr("train_ato.cli.list.execute", lambda options: exec("raise DeprecationWarning('old')"))
    assert main(["list"]) == 2 and "DeprecationWarning: old; it is an error by a filter" in capsys.readouterr().err
    monkeypatch.setattr("train_ato.cli.list.execute", lambda options: sys.exit(0))
    assert main(["list"]) == 1 and "called sys.exit(0)" in capsys.readouterr().err


UNMEASURED = "plant.sensors.couplers=[]"
PLACES: dict[str, tuple[str, ...]] = {
    "demo": (), "demo without sensors": (UNMEASURED,), "xuzhou_metro": (), "freight_consensus:aligned": (),
    "crh380a_gpc:short": (),
}  # fmt: skip
"""Scenario, and assignments."""
SPECIAL = (
    ("demo", ("observer=ndo", "observers.ndo.scope=vehicle", UNMEASURED)),
    ("demo", ("observer=eso", "observers.eso.scope=vehicle", UNMEASURED)),
    ("demo", ("compensation=predictor", "compensations.predictor.train=chain")),
    ("demo", ("compensation=predictor", "compensations.predictor.delay=estimated", "model.delay=0")),
    ("demo", ("compensation=twin", "laws.pid.feedforward=false")),
    ("demo", ("law=smc", "laws.smc.gains=printed", "compensation=twin", UNMEASURED)),
    ("demo", ("law=fixed_time_smc", "laws.fixed_time_smc.gains=printed", "compensation=twin", UNMEASURED)),
    ("demo", ("compensation=twin", "laws.smc.gains=printed", "law_changes=[{at: 3, law: smc}]")),
    ("xuzhou_metro", ("brake.policy=trigger",)),
    ("daqin_heavy_haul", ("replan={}",)),
    ("daqin_heavy_haul", ("brake.policy=none",)),
)
"""Other refusals of components: scenario, and assignments."""


def refusal(name: str, *assignments: str) -> str:
    """Return the message of a refused scenario, "" for an accepted one."""
    try:
        setup_of(name.partition(" ")[0], *PLACES.get(name, ()), *assignments)
    except ValueError as error:
        return str(error)
    return ""


def settings_of(message: str) -> list[list[str]]:
    """Return the settings of a refusal, one list of assignments for each remedy of every problem together."""
    parts = []
    for part in message.split("; also "):
        found: list[tuple[str, ...]] = []
        for key, value, more in re.findall(r"\bset ([\w.]+): ([\w.]+)(?: and remove ([\w.]+))?", part):
            found.append((f"{key}={value}", *([removed(more)] if more else [])))
        found += [(f"{key}={value}",) for key, value in re.findall(r"\(([\w.]+): (\[[\d, ]+\])\)", part)]
        for names in re.findall(r"\bcompensation: ([\w, ]+) \(--compensation", part):
            found += [(f"compensation={name}",) for name in re.split(r", | or ", names)]
        found += [(f"{key}=0.5",) for key in re.findall(r"give ([\w.]+) a value above 0", part)]
        found += [(removed(key),) for key in re.findall(r"(?<!and )\bremove ([\w.]+)", part)]
        parts.append(found)
    return [list(itertools.chain(*choice)) for choice in itertools.product(*parts)]


def removed(key: str) -> str:
    """Return the assignment that removes a key."""
    return f"{key}={'[]' if key == 'brake.events' else 'null'}"


def check_remedies(name: str, assignments: tuple[str, ...], message: str) -> None:
    settings = settings_of(message)
    assert settings, f"no setting in: {message}"
    assert "\n" not in message
    for setting in settings:
        again = refusal(name, *assignments, *setting)
        assert again == "", f"{message}\n{' '.join(setting)}: {again}"


@pytest.mark.parametrize(("law", "name"), sampled(product(LAWS.names(), PLACES), every=7))
def test_every_remedy_of_a_refused_pair_is_accepted(name: str, law: str) -> None:
    """Breaks if a remedy of law and compensation is refused, also by another check."""
    for compensation in COMPENSATIONS.names():
        assignments = (f"law={law}", f"compensation={compensation}")
        if message := refusal(name, *assignments):
            check_remedies(name, assignments, message)


@pytest.mark.parametrize(("name", "assignments"), SPECIAL)
def test_every_remedy_of_another_refusal_is_accepted(name: str, assignments: tuple[str, ...]) -> None:
    """Breaks if a remedy of a parameter is refused, or a refusal has none."""
    message = refusal(name, *assignments)
    assert message, "accepted"
    if "law_changes" in assignments[-1]:  # a change of the law in a list has no key of its own
        assert "set laws.smc.equivalent: feedforward" in message
    check_remedies(name, assignments, message)


@pytest.mark.parametrize(
    ("option", "kind"), [("--law", LAWS), ("--observer", OBSERVERS), ("--compensation", COMPENSATIONS)]
)
def test_an_unknown_component_names_its_option(option, kind, tmp_path, capsys):
    """Breaks if the message names the scenario file, which has no error."""
    wrong = f"{next(iter(kind.names()))}x"  # type: ignore[attr-defined]
    said = complaint(capsys, "run", "demo", "--engine", option, wrong, f"--out={tmp_path / 'run'}")
    assert said.startswith(f"train-ato: {option}: unknown {option[2:]} '{wrong}'; did you mean ")
    assert ".yaml" not in said and said.count("\n") == 1
    if option != "--law":
        assert complaint(capsys, "compare", "demo", option, wrong).startswith(f"train-ato: {option}: unknown ")


def test_a_refused_pair_names_its_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the message names the scenario file for a choice of the command line."""
    out = f"--out={tmp_path / 'run'}"
    for given, spelled in (("--compensation=twin", "--compensation twin"), ("--set=compensation=twin",) * 2):
        assert main(["run", "demo", "--engine", "--law=lag_smc", given, out]) == 2
        causes, problem, _ = capsys.readouterr().err.partition(": law 'lag_smc' with compensation 'twin': ")
        assert problem
        found = {cause.replace("--set ", "--set=") for cause in causes.removeprefix("train-ato: ").split(", ")}
        assert found == {"--law lag_smc", spelled}
    assert main(["compare", "demo", "--laws=pid,smcc", out]) == 2
    assert capsys.readouterr().err.startswith("train-ato: --laws: unknown law 'smcc'; did you mean 'smc'?")


def test_a_change_is_named_by_its_key_a_name_in_quotes_or_its_file() -> None:
    """Breaks if the refusal of a change names the file of the scenario, which has no fault, or another change."""
    changes = [("seed", "--seed 1"), ("plant.line", "--line nowhere"), ("profile.file", "--profile a/plan.csv")]
    for problem, option in (
        ("seed = 1: too small", "--seed 1"),
        ("no line 'nowhere'; see list", "--line nowhere"),
        ("a/plan.csv: no columns", "--profile a/plan.csv"),
    ):
        told = str(caused_by(ValueError(f"a.yaml: {problem}"), Path("a.yaml"), changes))
        assert told.startswith(f"{option}: ") and "a.yaml" not in told
    assert str(caused_by(ValueError("a.yaml: law = x: none"), Path("a.yaml"), changes)) == "a.yaml: law = x: none"
