"""Bad input: one line, exit status 2, no files left. Each row of the table is a user error."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from plant_sim.library import consist_path, line_path
from train_ato.apps.runs.progress import COMPILE_NOTE, PLANNER_NOTE
from train_ato.cli import main
from train_ato.profile.motion import change_of_speed
from train_ato.scenario.scenario import shipped_scenarios

ROOT = Path(__file__).resolve().parents[1]
DEMO = yaml.safe_load(shipped_scenarios()["demo"].read_text())


def consist(**changes: object) -> dict[str, object]:
    return {**yaml.safe_load(consist_path("hxd1_c80_105").read_text()), **changes}


def light(mass_t: float) -> dict[str, object]:
    data = consist()
    types = data["vehicle_types"]
    assert isinstance(types, dict)
    types["c80"]["mass_t"] = mass_t
    return data


def tilted(grade_permille: float) -> dict[str, object]:
    data = yaml.safe_load(line_path("daqin_section").read_text())
    data["grades"] = [{"at": data.get("begin", 0.0), "grade_permille": grade_permille}]
    return dict(data)


def short_line() -> dict[str, object]:
    return {**yaml.safe_load(line_path("daqin_section").read_text()), "end_km": 2.0}


SMALL_TICK = ["--set", "tick=0.0001", "--set", "step=0.0001"]
CASES: list[tuple[str, list[str], str]] = [
    ("unknown scenario", ["run", "demmo"], r"unknown scenario 'demmo'; did you mean 'demo'\?"),
    ("unknown variant", ["run", "daqin_heavy_haul:idael"], r"no variant 'idael'; did you mean 'ideal'\?"),
    ("missing file", ["run", "no/such.yaml"], r"no/such\.yaml: no such file"),
    ("unknown key", ["run", "demo", "--set", "plant.lagg=0.4"], r"plant\.lagg: unknown key; did you mean 'lag'"),
    ("unknown top key", ["run", "demo", "--set", "durration=4"], r"durration: unknown key; did you mean 'duration'"),
    (
        "key of another fault",
        ["run", "demo", "--set", "faults=[{do: kill, node: observer, at: 3, begin: 4}]"],
        r"faults\.0\.begin: unknown key \(known: at, at_min, at_ms, do, node\)",
    ),
    *(
        (f"plain words: {pair[:20]}", ["run", "demo", "--set", pair], rf"{words}[^^]*$")
        for pair, words in (
            ("plant=5", "plant = 5: is no block of keys; write key: value"),
            ("links.command=3", "links.command = 3: is no block of keys"),
            ("interventions=[3]", "interventions.0 = 3: is no block of keys"),
            ("criteria.requirements=5", "criteria.requirements = 5: is no block of keys"),
            ("faults=3", "faults = 3: is no list"),
            ("profile.phases=[]", "needs at least 1 entries"),
            ("criteria.requirements={'a b': 'G speed >= 0'}", "use letters, digits, _ and - only"),
            ("profile={file: /nonexist}", r"/nonexist: cannot be read \(No such file or directory\)"),
            (f"seed={'9' * 5000}", "seed: an integer of 5000 digits"),
            ("plant.sensors.freeze=[{quantity: velocity, unit: 7, begin: 1, end: 2}]", "give 0, the only one"),
        )
    ),
    ("unknown law", ["run", "demo", "--law", "pidd"], r"unknown law 'pidd'.*did you mean 'pid'"),
    ("unknown observer", ["run", "demo", "--observer", "x"], r"unknown observer 'x'.*known: .*ndo"),
    ("unknown compensation", ["run", "demo", "--compensation", "x"], r"unknown compensation 'x'.*known: .*preview"),
    ("unknown law parameter", ["run", "demo", "--set", "laws.pid.kpp=1"], r"kpp.*did you mean 'kp'"),
    ("law parameter out of range", ["run", "demo", "--set", "laws.pid.kp=-1"], r"pid\.kp.*-1"),
    ("law parameter not a number", ["run", "demo", "--set", "laws.pid.kp=fast"], r"pid\.kp.*fast"),
    ("law that needs a sensor", ["run", "demo", "--law", "smc", "--set", "plant.sensors.couplers=[]",
                                   "--set", "laws.smc.gains=printed"], "sensor"),
    ("delay NaN", ["run", "demo", "--set", "links.command.delay=.nan"], r"links\.command\.delay = nan: .*finite"),
    ("delay negative", ["run", "demo", "--set", "links.command.delay=-1"], r"links\.command\.delay: -1.*negative"),
    ("delay of the pipe", ["run", "demo", "--set", "links.brake_pipe.delay=-1"], r"-1: links: brake_pipe\.delay: -1"),
    ("delays of a message", ["run", "demo", "--set", "links.estimate.delay=[1,2]"], r"estimate\.delay: 2 values for 1"),
    ("delay believed negative", ["run", "demo", "--set", "model.delay=-1"], r": model\.delay: -1.*negative"),
    ("no kind", ["run", "demo", "--set", "plant.disturbances=[{kin: gust}]"],
     r"plant\.disturbances\.0 = \{'kin': 'gust'\}: 'kind' is missing; add it"),
    ("unknown kind", ["run", "demo", "--set", "plant.disturbances=[{kind: gusst}]"],
     r"plant\.disturbances\.0\.kind = 'gusst': is none of eq40, .*; did you mean 'gust'\?"),
    ("start faster than any train", ["run", "demo", "--set", "plant.start.speed=1e308"],
     r"plant\.start\.speed = 1e\+308"),
    ("sensor behind no vehicle", ["run", "demo", "--set", "plant.sensors.couplers=[500]"],
     r"--set plant.sensors.couplers=\[500\]: plant: sensors\.couplers lists vehicle 500: .* 0 \.\.\. 104"),
    ("jump on no vehicle", ["run", "demo", "--set", "plant.jumps=[{at: 1, what: mass, factor: 2, vehicles: [900]}]"],
     r"\[900\]\}\]: plant: jumps lists vehicle 900: .* 0 \.\.\. 105"),
    ("lag infinite", ["run", "demo", "--set", "plant.lag=.inf"], r"plant\.lag.* = inf"),
    ("tick no multiple", ["run", "demo", "--set", "step=0.03"], r"tick 0\.1 s is not a multiple of step 0\.03 s"),
    ("period no multiple", ["run", "demo", "--set", "control_period=0.15"], r"control_period 0\.15 s is not"),
    ("duration negative", ["run", "demo", "--set", "duration=-5"], r"duration = -5: input should be greater than 0"),
    ("truth value for a number", ["run", "demo", "--set", "duration=true"],
     r"duration = True: input should be a number, not true or false"),
    ("truth value among numbers", ["run", "demo", "--set", "plant.lag=[0.4, true]"],
     r"plant\.lag = \[0\.4, True\]: input should be a number"),
    ("truth value for a whole number", ["run", "demo", "--set", "seed=false"],
     r"seed = False: input should be a number"),
    ("truth value under a unit's key", ["run", "demo", "--set", "links.command.jitter_ms=true"],
     r"links\.command\.jitter_ms = True: input should be a number"),
    ("text for a number", ["run", "demo", "--set", "duration='60'"], r"duration = '60': input should be a number"),
    ("number for a truth value", ["run", "demo", "--set", "plant.ideal_actuator=1"],
     r"plant\.ideal_actuator = 1: input should be true or false"),
    ("truth value for a law's number", ["run", "demo", "--set", "laws.pid.kp=true"], r"pid\.kp: True is not a"),
    ("schema of another version", ["run", "demo", "--set", "schema=train_ato/scenario/9"],
     "schema: 'train_ato/scenario/9': not supported"),
    ("unknown consist", ["run", "demo", "--set", "plant.consist=hxd2"], r"train 'hxd2'"),
    ("param without value", ["run", "demo", "--set", "plant.lag"], r"not an assignment; write key\.key=value"),
    ("param through a value", ["run", "demo", "--set", "seed.a=1"], r"'seed' is a value, not a block"),
    ("rate 0", ["run", "demo", "--rate", "0"], r"--rate: 0: not a rate; give a number above 0"),
    ("deceleration near 0", ["run", "demo", "--set", "profile.limits.deceleration=1e-300"], r"a profile of inf knots"),
    ("more ticks than fit into the memory", ["run", "demo", *SMALL_TICK, "--set", "duration=3600"],
     r"duration 3600\.0 s has 36000000 ticks of 0\.0001 s, at most 10000000; shorten it"),
    ("more knots than a message should have", ["run", "demo", *SMALL_TICK, "--set", "duration=1"],
     r"a profile of 7\d{6} knots, at most 2000000; shorten it or increase the tick"),
    ("tick far too small", ["run", "demo", "--set", "tick=1e-300"], r"tick = 1e-300"),
    ("step too large to be true", ["run", "demo", "--set", "step=0.5"], r"step = 0\.5: .*less than or equal"),
    ("delay beyond reason", ["run", "demo", "--set", "links.command.delay=1e300"], r"delay: 1e\+300 s is longer"),
    ("name that is a path", ["run", "demo", "--set", "name=../../evil"], r"name = '\.\./\.\./evil'"),
    ("name of the folder too long", ["run", "demo", "--out", "a" * 300], r"--out a+\.\.\.: "),
    ("driver to nowhere", ["driver", "daqin_section", "hxd1_c80_105", "--until-km", "nan", "--out", "p.csv"],
     r"--until-km nan"),
    ("driver without knots", ["driver", "level", "hxd1_c80_105", "--until-km", "1", "--spacing", "0", "--out", "p.csv"],
     r"--spacing 0\.0"),
    ("driver into a file of no kind", ["driver", "level", "hxd1_c80_105", "--until-km", "1", "--out", "p.txt"],
     r"--out p\.txt: end it in \.csv"),
    ("driver into a place that cannot be written",
     ["driver", "level", "hxd1_c80_105", "--until-km", "1", "--out", "/proc/p.csv"], r"--out /proc/p\.csv: cannot be"),
    ("plan into a place that cannot be written", ["plan", "level", "xuzhou_metro_3", "--out", "/proc/p.png"],
     r"--out /proc/p\.png: cannot be written"),
    ("plan backwards", ["plan", "level", "xuzhou_metro_3", "--from-km", "10", "--to-km", "5"],
     r"options of plan: end = 5000 m must lie beyond begin"),
    ("list of an unknown name", ["list", "daqin_secton"], r"unknown name.*did you mean 'daqin_section'"),
    ("param to a value that is no YAML", ["param", "pid.kp=["], r"pid\.kp=\[: '\[' is not valid YAML"),
    ("inject with a value that is no YAML", ["inject", "gust", "duration=["], r"duration=\[: '\[' is not valid YAML"),
    ("param without a run", ["param", "law=smc", "--domain", "77"], r"--domain 77: no run holds it"),
    ("verify nothing", ["verify", "nowhere"], r"nowhere: no such log; name a run folder"),
    ("compare with an unknown law", ["compare", "demo", "--laws", "pid,pidd"], r"unknown law 'pidd'"),
    ("compare without a law", ["compare", "demo", "--laws", ","], r"--laws ,: no law"),
    ("engine with a domain", ["run", "demo", "--engine", "--domain", "5"], r"--domain 5: the engine uses no ROS"),
    ("two ways at once", ["run", "demo", "--engine", "--processes"], r"not allowed with argument"),
    ("not a run", ["info", "."], r"not a run folder"),
    ("recover nothing", ["recover", "nothing.partial"], r"nothing\.partial"),
    ("domain out of range", ["run", "demo", "--domain", "400"], r"400.*0 to 232"),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "message"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_bad_input_is_one_line_and_status_2(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Breaks on a traceback, another exit status, a vague message, or a folder that stays behind."""
    refused(arguments, message, tmp_path, monkeypatch, capsys)


FILES: list[tuple[str, str, dict[str, object], str]] = [
    ("negative mass", "consist", light(-3), r"train\.yaml: vehicle_types\.c80\.mass = -3000\.0: .*greater than 0"),
    (
        "mass of 2^64 t",
        "consist",
        light(2.0**64),
        r"train\.yaml: vehicle_types\.c80: mass 1\.8.* kg is above 1000000000 kg",
    ),
    (
        "mass that is a truth value",
        "consist",
        light(True),
        r"train\.yaml: vehicle_types\.c80\.mass_t = True: .*a number",
    ),
    ("grade that is a truth value", "line", tilted(True), r"track\.yaml: grades\.0\.grade_permille = True: .*a number"),
    ("empty consist", "consist", consist(train=[]), r"train\.yaml: train.*at least 1"),
    ("unknown type", "consist", consist(train=[{"type": "c70"}]), r"train\.yaml: .*'c70'"),
    ("profile beyond the line", "line", short_line(), r"beyond the end of line 'daqin_section' at km 2\.000"),
]


@pytest.mark.parametrize(("what", "data", "message"), [case[1:] for case in FILES], ids=[case[0] for case in FILES])
def test_bad_data_files(
    what: str,
    data: dict[str, object],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Breaks if a train or line file is taken as it comes, or the message does not name it."""
    name = "train.yaml" if what == "consist" else "track.yaml"
    (tmp_path / name).write_text(yaml.safe_dump(data))
    refused(["run", "demo", "--set", f"plant.{what}={name}"], message, tmp_path, monkeypatch, capsys)


@pytest.mark.parametrize("text", ["x: " + "[" * 50_000, "- " * 50_000], ids=["flow", "block"])
@pytest.mark.parametrize("reader", ["line", "profile"])
def test_deep_yaml_of_other_formats(
    reader: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
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
def test_a_middleware_that_is_not_installed(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if rcl ends the process with status 102 after the folder was made."""
    pytest.importorskip("rclpy")
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_of_another_vendor")
    words = [word.format(golden=ROOT / "test" / "golden" / "short_train") for word in command]
    message = r"RMW_IMPLEMENTATION=rmw_of_another_vendor: this middleware is not installed; `unset RMW_IMPLEMENTATION`"
    refused(words, message, tmp_path, monkeypatch, capsys)


def test_existing_and_unwritable_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a run writes into another's folder, or begins without a place to record to."""
    (tmp_path / "there").mkdir()
    (tmp_path / "file").write_text("")
    refused(["run", "demo", "--out", "there"], r"--out there: exists already", tmp_path, monkeypatch, capsys)
    refused(["run", "demo", "--out", "file/run"], r"--out file/run: cannot be made", tmp_path, monkeypatch, capsys)


def test_a_summary_that_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
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


@pytest.mark.parametrize(
    "text", ["[1, 2]", "{a: [", "!!python/object/apply:os.system ['true']", "\x00", "[" * 5000, "a: 1\na: 2\n", BOMB]
)
def test_scenario_files_that_are_none(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if YAML is loaded unsafely or a parser's traceback reaches the user."""
    (tmp_path / "mine.yaml").write_text(text)
    refused(["run", "mine.yaml"], r"mine\.yaml: ", tmp_path, monkeypatch, capsys)


def refused(
    arguments: list[str],
    message: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(folder)
    before = sorted(path.name for path in folder.rglob("*"))
    try:
        status = main(arguments)
    except SystemExit as end:
        status = int(end.code or 0)
    captured = capsys.readouterr()
    assert status == 2, captured.err
    assert captured.out == ""
    rows = [line for line in captured.err.strip().splitlines() if line not in (COMPILE_NOTE, PLANNER_NOTE)]
    lines = [line for line in rows if not line.startswith("note: ")]
    assert len(lines) == 1, captured.err
    assert re.search(message, captured.err), captured.err
    assert sorted(path.name for path in folder.rglob("*")) == before


NINES = "9" * 5000
OWN = "schema: train_ato/scenario/1\nbase: "
BAD_FILES = (
    "", "[1, 2]", "hello", "5", "!!python/object/apply:os.system [ls]", "schema: !own x", "name: a\nname: b",
    "a:\n\t- b", "? [a]\n: 1", f"duration: {NINES}", f'{{"a": {NINES}}}', '{"a": 1, "a": 2}', "{", "\x00\x01",
    "name: \xe9", f"{OWN}demo\ndurration: 3", f"{OWN}demo\nplant: 5", f"{OWN}demmo", f"{OWN}demo\nduration: .nan",
    f"{OWN}demo\nseed: -1",
)  # fmt: skip
"""Content of files that no command reads."""
READERS = (
    "run {} --engine", "compare {} --laws pid", "sweep {}", "tune {} --law pid --out o", "list {}", "curves {}",
    "tune demo --law pid --over {} --out o", "falsify {} --requirement 'G speed >= 0' --over x", "learn {} --out l.yml",
    "falsify demo --requirement 'G speed >= 0' --over {}", "plan {} xuzhou_metro_3", "plan level {}",
    "plan xuzhou_metro_test xuzhou_metro_3 --journey {}", "plan daqin_section hxd1_c80_105 --trip {}",
    "driver {} hxd1_c80_105 --until-km 1 --out d.csv", "convert {} c.yaml", "view --scenario {}",
    "import {} --consist xuzhou_metro_3 --line level --out i", "run demo --engine --set plant.line={}",
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


def test_a_file_has_one_line_for_each_of_its_faults(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a file with several faults must be run again for each, or one fault hides those of another block."""
    monkeypatch.chdir(tmp_path)
    head = "schema: train_ato/scenario/1\nbase: demo\n"
    vehicles = "train: [{type: v}], vehicle_types: {v: {mass_t: -3, lenght: 4}}"
    Path("own.yaml").write_text(
        f"{head}durration: 3\ntick: -1\nseed: x\ncriteria: {{stop_window: -1, jerk: fast}}\n"
        f"plant: {{lagg: 1, consist: {{schema: train_ato/consist/1, name: a, summary: b, {vehicles}}}}}\n"
        "profile: {phases: [{accelerate_kmh: 3}, {brake_to: -}]}\n"
    )
    assert main(["run", "own.yaml", "--engine"]) == 2
    places = [re.split(": | = ", line)[2] for line in capsys.readouterr().err.splitlines()]
    wrong = ["durration", "tick", "seed", "criteria.stop_window", "criteria.jerk", "plant.lagg"]
    wrong += [f"plant.consist.vehicle_types.v.{key}" for key in ("mass", "lenght", "length", "resistance")]
    wrong += ["profile.phases.0.accelerate_kmh", "profile.phases.1.brake_to"]
    assert sorted(places) == sorted(wrong)
    Path("own.yaml").write_text(head + "".join(f"k{number}: 1\n" for number in range(30)))
    assert main(["run", "own.yaml", "--engine"]) == 2
    lines = capsys.readouterr().err.splitlines()
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


@pytest.mark.parametrize("line", READERS)
def test_a_bad_file_is_refused_in_plain_words(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a command names a class, a pattern or a shipped file, or begins its work, for one kind of bad file."""
    monkeypatch.chdir(tmp_path)
    names = ["none.yaml", "folder", "a" * 300 + ".yaml", "folder/none.yaml", "bad.csv/x.yaml", "bad.csv"]
    for number, text in enumerate(BAD_FILES):
        names.append(f"bad{number}.{'json' if text.startswith('{') else 'yaml'}")
        Path(names[-1]).write_bytes(text.encode("latin-1"))
    Path("bad.csv").write_text("tiem,speed\n0,nan\n")
    Path("folder").mkdir()
    for name in names:
        told_in_plain_words([word.format(name) for word in shlex.split(line)], capsys)


@pytest.mark.parametrize("line", OPTIONS)
def test_a_bad_value_is_refused_in_plain_words(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
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
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    errors = [line for line in done.stderr.splitlines() if not line.startswith("train-ato")]
    assert (done.returncode, errors) == (0, [])
    assert "run a scenario and record it" in done.stdout


@pytest.mark.parametrize("arguments", [["list"], ["list", "--json"], ["list", "pid"]])
def test_a_closed_reader_is_not_an_error(arguments: list[str]) -> None:
    """`train-ato list | head -0`: breaks if a traceback or an error of the pipe is printed."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "train_ato", *arguments],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=writer, stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    os.close(writer)
    assert done.stderr == ""


def shell(words: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a command with redirections of a shell; ``train-ato`` is the command of the source tree."""
    command = words.replace("train-ato", f"{shlex.quote(sys.executable)} -m train_ato")
    return subprocess.run(
        ["bash", "-c", command], cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT), **variables},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_do_not_end_a_run(closed: str, tmp_path: Path) -> None:
    """Breaks on a traceback after the run, a run that is refused in silence, or prints in a file of the run."""
    done = shell(f"train-ato run demo --engine --set duration=2 --out run {closed}", tmp_path)
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert main(["verify", str(tmp_path / "run")]) == 0
    assert shell(f"train-ato run demmo {closed}", tmp_path).returncode == 2


def test_characters_outside_an_encoding_are_escapes(tmp_path: Path) -> None:
    """Breaks if a run is done and then refused because a stream cannot show a letter, or the JSON is not valid."""
    run = "train-ato run demo --engine --set duration=2"
    done = shell(run, tmp_path, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr.replace(COMPILE_NOTE, "").strip()) == (0, "")
    assert r"\xb5s" in done.stdout
    text = shell(f"{run} --set 'summary=µ' --json", tmp_path, PYTHONIOENCODING="ascii").stdout
    assert json.loads(text)["ticks"] == 20
    assert json.loads(shell("train-ato list --json", tmp_path, PYTHONIOENCODING="ascii").stdout)


def test_a_full_disk_is_a_failure_and_no_bad_input(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if the exit status of a failed write is that of a wrong argument, or the file has no name."""

    def execute(options: object) -> int:
        raise OSError(28, "No space left on device", "out/run.mcap")

    monkeypatch.setattr("train_ato.cli.list.execute", execute)
    assert main(["list"]) == 1
    assert capsys.readouterr().err == "train-ato: out/run.mcap: No space left on device\n"


def test_sys_exit_in_a_component_is_a_failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if ``sys.exit(0)`` in the code of a user ends a command with status 0."""
    monkeypatch.setattr("train_ato.cli.list.execute", lambda options: sys.exit(0))
    assert main(["list"]) == 1
    assert "called sys.exit(0)" in capsys.readouterr().err
