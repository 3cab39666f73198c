"""Shipped trains, lines, schemas, topic page and scenarios: consistent, with the data of their sources."""

import json
import re
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from case_costs import sampled
from engine_runs import setup_of
from jsonschema.validators import validator_for
from plant_trains import train
from programs import python
from pydantic import TypeAdapter, ValidationError
from refusals import one_line

import train_ato as ta
from msgs_docs.generate.reference_pages import MODELS, schema_text
from plant_sim.library import consist_names, consist_path, line_names, line_path, load_consist, load_line
from plant_sim.si_model import SiModel, blocks_of, example_of_key
from plant_sim.units import Force, Length, Mass, Place, Pressure, Speed, Time
from train_ato.program.version import VERSION
from train_ato.scenario.criteria import Expectation
from train_ato.scenario.scenario import expectation_of, load_scenario, raw_scenario
from train_ato.scenario.scenario_files import scenario_names, shipped_following, shipped_scenarios

REPO = Path(__file__).resolve().parents[1]
SCENARIOS = scenario_names()


@cache
def validator(kind: str) -> Any:
    """Return the validator of a schema, which is itself valid and takes no key that is not in it."""
    schema = json.loads(schema_text(kind))
    assert schema["additionalProperties"] is False
    made = validator_for(schema)
    made.check_schema(schema)
    return made(schema)


FILES = [
    *(("scenario", path) for path in shipped_scenarios().values()),
    *(("following", path) for path in shipped_following().values()),
    *(("consist", consist_path(name)) for name in consist_names()),
    *(("line", line_path(name)) for name in line_names()),
]


@pytest.mark.parametrize(("kind", "path"), FILES, ids=[path.stem for _, path in FILES])
def test_shipped_files_keep_to_their_schema(kind: str, path: Path) -> None:
    validator(kind).validate(yaml.safe_load(path.read_text()))


def _kinds(part: Any) -> set[str]:
    """Return the JSON types of a key and of the entries of its list."""
    inner = [*part.get("anyOf", ()), *part.get("prefixItems", ()), part.get("items")]
    given = part.get("type", ())
    return ({given} if isinstance(given, str) else set(given)).union(*(_kinds(entry) for entry in inner if entry))


@pytest.mark.parametrize("kind", MODELS)
def test_every_key_has_a_text_a_unit_and_an_example(kind: str) -> None:
    """Breaks if a key of a schema is bare: without text, a number without unit, or without an example it accepts."""
    schema = json.loads(schema_text(kind))
    blocks = {"": schema, **schema.get("$defs", {})}
    bare = []
    for block, key, part in ((b, k, p) for b, found in blocks.items() for k, p in found.get("properties", {}).items()):
        text, _, unit = part.get("description", "").partition("[")
        examples = part.get("examples", [])
        check = validator_for(schema)({**part, "$schema": schema["$schema"], "$defs": schema.get("$defs", {})})
        needs_unit = bool(_kinds(part) & {"number", "integer"})
        in_mm = key.endswith("_mm") and np.max(examples) > 25e3  # a place in millimetres is no key of a railway
        if len(text) < 3 or needs_unit != unit.endswith("]") or not examples or in_mm:
            bare.append(f"{block}.{key}: {part}")
        bare += [f"{block}.{key}: {value}" for value in examples if not check.is_valid(value)]
    assert not bare, "\n".join(bare)


@pytest.mark.parametrize("kind", MODELS)
def test_the_model_accepts_every_example(kind: str) -> None:
    """Breaks if an example of a key is refused by the checks that a schema does not have."""
    blocks: list[Any] = [MODELS[kind]]
    refused = []
    for block in blocks:  # grows while it is read
        for name, field in block.model_fields.items():
            blocks += [inner for inner in blocks_of(field.annotation) if inner not in blocks]
            try:
                TypeAdapter(field.rebuild_annotation()).validate_python(example_of_key(field))
            except ValidationError as error:
                refused.append(f"{block.__name__}.{name}: {example_of_key(field)}: {error}")
    assert not refused, "\n".join(refused)


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_shipped_scenario_can_start(name: str) -> None:
    """Breaks if a scenario or a variant names a missing object, or gains that keep a train are called unstable."""
    setup = setup_of(name)
    # The first has a limit cycle, the others lose the train.
    unstable = ("xuzhou_metro:long_delay", "freight_consensus:delay_0_8", "freight_consensus:delay_1_0")
    assert ("unstable" in setup.advice()) == (name in unstable)
    assert setup.scenario.name == name and setup.scenario.summary


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_shipped_scenario_states_its_verdict(name: str) -> None:
    expected, criteria = expectation_of(name), load_scenario(name)[0].criteria
    assert expected is not None
    stated = criteria.model_dump(exclude_defaults=True)
    stated = {*stated, *(stated.pop("requirements", None) or {})} - {"tracking"}
    assert {*expected.criteria} <= stated
    assert (expected.verdict == "none") == (not stated)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_shipped_scenario_has_its_expected_verdict(name: str) -> None:
    """Breaks if a run as shipped fails without a word, or passes although its file says that it fails."""
    expected = expectation_of(name)
    assert expected is not None
    try:
        metrics = ta.run(name, progress=False).metrics
    except ta.RunFailed:
        metrics = {"verdict": "aborted"}
    failed = [row["criterion"] for row in metrics.get("criteria", ()) if row["passed"] is False]
    assert (metrics.get("verdict", "none"), failed) == (expected.verdict, [*expected.criteria])


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        ("lost", "expect: verdict = 'lost'"),
        ("{verdict: failed, because: light}", "name the criteria that fail"),
        ("{verdict: failed, criteria: [jerk]}", "give the cause with because"),
        ("{verdict: passed, because: light}", "remove because"),
        ("{verdict: passed, criteria: [jerk]}", "remove criteria"),
        ("{verdict: none}", "give the cause with because"),
        ("{verdikt: passed}", "unknown key; did you mean 'verdict'?"),
        ("[passed]", "holds a list in place of keys and values"),
    ],
)
def test_a_bad_expected_verdict_is_refused(text: str, refusal: str, tmp_path: Path) -> None:
    """Breaks if ``expect`` of a file or variant is not checked before the run, or its refusal does not name it."""
    path = tmp_path / "own.yaml"
    path.write_text(f"schema: train_ato/scenario/1\nbase: demo\nexpect: {text}\nvariants: {{a: {{expect: {text}}}}}\n")
    for name in (str(path), f"{path}:a"):
        with pytest.raises(ValueError, match=re.escape(refusal)) as refused:
            load_scenario(name)
        assert str(path) in str(refused.value) and "expect" in str(refused.value)


def test_an_expected_verdict_is_that_of_one_file_or_variant(tmp_path: Path) -> None:
    """Breaks if a scenario has the verdict of its base, two variants that of the last, or a run depends on the key."""
    path = tmp_path / "own.yaml"
    path.write_text("schema: train_ato/scenario/1\nbase: demo:tuned\nvariants: {a: {seed: 2}, b: {expect: passed}}\n")
    assert [expectation_of(f"{path}{part}") for part in ("", ":a", ":tuned", ":a+b")] == [None] * 4
    assert expectation_of(f"{path}:b") == Expectation(verdict="passed")
    assert load_scenario(f"{path}:b")[0] == load_scenario(str(path))[0].model_copy(update={"name": "demo:b"})


@pytest.mark.parametrize("name", sampled(SCENARIOS, every=2))
def test_resolved_scenario_prepares_the_same_run(name: str, tmp_path: Path) -> None:
    """Breaks if a value is lost or rounded when the scenario is written out."""
    setup = setup_of(name)
    path = tmp_path / "scenario.yaml"
    path.write_text(setup.resolved_yaml())
    again = setup_of(str(path))
    assert (again.consist, again.line) == (setup.consist, setup.line)
    assert again.resolved_yaml() == setup.resolved_yaml()
    for column in ("time", "position", "velocity", "acceleration"):
        assert getattr(again.profile, column).tobytes() == getattr(setup.profile, column).tobytes()


def test_version_is_the_same_everywhere() -> None:
    """Breaks if package.xml or the changelog has another version."""
    assert f"<version>{VERSION}</version>" in (REPO / "package.xml").read_text()
    assert re.search(rf"^## {re.escape(VERSION)}", (REPO / "CHANGELOG.md").read_text(), re.M)


def test_package_xml_names_every_dependency() -> None:
    """Breaks if a dependency is added to setup.py and not to package.xml, as a key of rosdep or among those without."""
    listed = re.search(r"install_requires=\[(.*?)\]", (REPO / "setup.py").read_text(), re.S)
    assert listed is not None
    wanted = {name.lower() for name in re.findall(r'"([A-Za-z0-9-]+)', listed[1])}
    root = ElementTree.parse(REPO / "package.xml").getroot()
    keys = {str(entry.text).removeprefix("python3-").removesuffix("-pip") for entry in root.iter("exec_depend")}
    without = re.search(r"with pip: ([^.]*)\.", (REPO / "package.xml").read_text())
    assert without is not None
    aliases = {"pyyaml": "yaml", "pillow": "pil"}
    assert {aliases.get(name, name) for name in wanted} <= keys | set(without[1].split())


def test_setup_runs_as_a_link_of_colcon(tmp_path: Path) -> None:
    """Breaks if setup.py looks for its files beside the link that `colcon build --symlink-install` makes in `build`."""
    for name in ("setup.py", "setup.cfg", "train_ato", "plant_sim"):
        (tmp_path / name).symlink_to(REPO / name)
    done = python("setup.py", "-q", "--version", folder=tmp_path)
    assert (done.returncode, done.stdout.split()[-1:]) == (0, [VERSION]), done.stderr


def overlay(folder: Path, base: str, more: str = "") -> str:
    path = folder / "mine.yaml"
    path.write_text(f"schema: train_ato/scenario/1\nbase: {base}\nname: mine\n{more}")
    return str(path)


def test_base_can_be_a_variant(tmp_path: Path) -> None:
    """Breaks if the variant of a base is ignored, an unknown one accepted, or the variants of the base are lost."""
    name = overlay(tmp_path, "xuzhou_metro:slower", "laws: {pid: {kp: 1.0}}\n")
    scenario = load_scenario(name)[0]
    assert scenario.plant.lag == 0.5 and scenario.laws["pid"] == {"kp": 1.0, "ki": 0.43, "integral_limit": 0.7}
    assert load_scenario(f"{name}:ideal")[0].plant.lag == 0.0
    with pytest.raises(ValueError, match="no variant 'slow'"):
        load_scenario(overlay(tmp_path, "xuzhou_metro:slow"))


def test_base_can_have_files_in_another_folder(tmp_path: Path) -> None:
    """Breaks if the profile file of a base is searched beside the overlay."""
    run = ta.run(overlay(tmp_path, "daqin_heavy_haul"), set={"duration": 1})
    assert run.metrics["ticks"] == 10


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("demo", {}),
        ("xuzhou_metro:slower", {"duration": 20, "laws.smc.ks": 0.1}),
        ("daqin_heavy_haul:tuned", {"plant": {"consist": "hxd1_c80_105", "line": "level"}}),
    ],
)
def test_overlay_of_a_choice_has_the_same_content(name: str, changes: dict[str, object], tmp_path: Path) -> None:
    """Breaks if a change of `with_` is lost in the overlay, also one that replaces a whole block."""
    choice = ta.scenario(name).with_(changes)
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(choice.as_overlay))
    found, expected = (
        each.checked.model_copy(update={"name": "", "profile": None}) for each in (ta.scenario(str(path)), choice)
    )
    assert found == expected
    assert raw_scenario(str(path))[1]["profile"].keys() == raw_scenario(name)[1]["profile"].keys()


TRAINS = {
    "hxd1_c80_105": (106, 10_684, 35.222 + 105 * 12, 1), "hxd1_c80_210": (212, 21_368, 2 * (35.222 + 105 * 12), 2),
    "xuzhou_metro_3": (1, 181.2925, 118, 1), "crh380a_one_mass": (1, 442, 203, 1),
    "crh380a_three_units": (3, 442, 203, 3), "crh380a_eight_cars": (8, 442, 203, 6), "freight_five": (5, 400, 400, 5),
}  # fmt: skip
"""Number of vehicles, mass [t], length [m] and number of power units of every shipped train."""


@pytest.mark.parametrize(("name", "figures"), TRAINS.items())
def test_trains(name: str, figures: tuple[int, float, float, int]) -> None:
    """Numbers, masses and lengths of the papers; every file has a source and runs."""
    consist, (vehicles, mass_t, length, units) = load_consist(name), figures
    assert (len(consist.vehicles), len(consist.power_units)) == (vehicles, units)
    assert consist.mass == pytest.approx(1e3 * mass_t)
    assert consist.length == pytest.approx(length)
    assert consist.name == name
    assert len(consist.source) > 40
    plant = train(consist)
    plant.advance(np.zeros((plant.substeps, units)))


def test_a_vehicle_is_half_of_both_lengths_behind_the_one_before_it() -> None:
    """Breaks if the distance of two centres is the length of one: locomotive 35.222 m, wagons 12 m."""
    assert load_consist("hxd1_c80_105").offsets[:3] == pytest.approx((0.0, 23.611, 35.611))


class Given(SiModel):
    mass: Mass = 0.0
    length: Length = 0.0
    place: Place = 0.0
    speed: Speed = 0.0
    time: Time = 0.0
    force: Force = 0.0
    pressure: Pressure = 0.0


@pytest.mark.parametrize(("key", "value", "si"), [
    ("mass_ton", 1, 2000 * 0.45359237), ("mass_lb", 1, 0.45359237), ("length_mi", 1, 1609.344),
    ("length_ft", 5280, 1609.344), ("place_mi", 1, 1609.344), ("place_ft", 1, 0.3048),
    ("speed_mph", 1, 1609.344 / 3600), ("time_h", 1, 3600), ("force_lbf", 1, 0.45359237 * 9.80665),
    ("force_klbf", 1, 1000 * 0.45359237 * 9.80665), ("pressure_psi", 1, 0.45359237 * 9.80665 / 0.0254**2),
    ("pressure_bar", 1, 1e5),
])  # fmt: skip
def test_suffixes_of_the_united_states_have_their_defined_values(key: str, value: float, si: float) -> None:
    """Breaks if a ton is a long one, a mile is nautical, or a factor is used the wrong way round."""
    assert getattr(Given.model_validate({key: value}), key.partition("_")[0]) == pytest.approx(si, rel=1e-12)


def test_every_shipped_file_is_tested() -> None:
    assert set(consist_names()) == set(TRAINS)
    assert set(line_names()) == {"daqin_section", "xuzhou_metro_test", "highspeed_286km", "level"}
    for name in line_names():
        assert load_line(name).name == name
        assert load_line(name).source


def test_resistance_of_crh380a_is_shared() -> None:
    """Paper 003: f(v) = 2475.2 + 57.28 v + 6.931 v² N, the same total in all three files."""
    for name in ("crh380a_one_mass", "crh380a_three_units", "crh380a_eight_cars"):
        consist = load_consist(name)
        total = np.sum([v.resistance.polynomial(v.mass, consist.gravity) for v in consist.vehicles], axis=0)
        assert total == pytest.approx([2475.2, 57.28, 6.931])
        assert sum(v.traction[0].force for v in consist.vehicles if v.traction) == pytest.approx(240e3)


def test_daqin_section_has_the_described_shape() -> None:
    """Long falling grades and their pieces, undulation, 13 curves, 80 km/h, level before 0 and beyond 45 km."""
    line = load_line("daqin_section")
    at = np.array([entry.at for entry in line.grades] + [line.end])
    grade = 1e3 * np.array([entry.grade for entry in line.grades])
    falling = np.zeros(len(grade), dtype=bool)
    for begin, end in ((19.4e3, 25.3e3), (33.4e3, 36.3e3), (39.3e3, 42.2e3)):
        inside = (at[:-1] >= begin - 1e-6) & (at[1:] <= end + 1e-6)
        falling |= inside
        lengths, steep = np.diff(at)[inside], grade[inside]
        assert lengths.sum() == pytest.approx(end - begin)
        assert lengths.min() >= 560 - 1e-6 and lengths.max() <= 640 + 1e-6
        assert steep.min() >= -11.2 - 1e-9 and steep.max() <= -8.6 + 1e-9
    others = grade[~falling]
    assert (others.min(), others.max()) == pytest.approx((-5.0, 2.0))
    assert (at[-2], grade[-1]) == (pytest.approx(45e3), 0.0) and line.end >= 48e3
    radii = [curve.radius for curve in line.curves]
    assert (len(radii), min(radii), max(radii)) == (13, 600, 1200)
    assert [entry.speed for entry in line.speed_limits] == [pytest.approx(80 / 3.6)]


@pytest.mark.parametrize(("text", "says"), [
    ("text: [", "line 1"), ("[1, 2]", "keys and values"), ("end_km: 1\ngradez: []", "gradez"), ("", "end"),
    ("end: -5", "end -5 m must be beyond begin 0 m"), ("end: .nan", "end"),
    ("end_km: 54000", r"a line of 54000 km, at most 20000 km; check the unit of end"),
    ("schema: train_ato/line/9\nname: x\nend: 5", "schema"), ("end: 5\nend_km: 1", "the same quantity"),
    ("end: 5\ngrades: [{at: 0, grade: 12}]", "write grade_permille"),
])  # fmt: skip
def test_bad_line_files(tmp_path: Path, text: str, says: str) -> None:
    """One line with file and key or position; no traceback of YAML or pydantic."""
    file = tmp_path / "own.yaml"
    whole = text.startswith(("text", "[", "schema"))
    file.write_text(text if whole else f"schema: train_ato/line/1\nname: x\n{text}", encoding="utf-8")
    with one_line(r"own\.yaml", says):
        load_line(str(file))


@pytest.mark.parametrize(("old", "new", "names"), [
    ("mass_t: 184", "mass_t: -184", "mass"), ("count: 105", "count: 0", "count"),
    ("count: 105", "count: 2000000", "2000001 vehicles, more than 5000"),
    ("default_gear: mt2_mt2", "default_gear: mt3", "mt3"), ("kind: clip", "kind: clap", "draft_gears"),
    ("name: hxd1_c80_105", "nom: hxd1_c80_105", "nom"), ("traction:", "tracktion:", "did you mean 'traction'"),
    ("mass_t: 184", "mass: 184", "write mass_t"),
    ("mass_t: 184", "mass_t: 184\n    adhesive_mass_t: 200", "exceeds the mass"),
    ("{to_kmh: 65, force_kn: 779", "{to_kmh: 4, force_kn: 779", "rising speed"),
    ("{to_kmh: 75, force_kn: 461}", "{to_kmh: 75, force_kn: -461}", "above 0"),
    ("{to_kmh: 5, slope_kn_per_kmh: 92.2}", "{to_kmh: 5, slope_kn_per_kmh: -9}", "above 0"),
    ("transition_stiffness: 60.0e+6", "transition_stiffness: 6.0e+6", "raise it"),
    ("behind: [0]", "behind: [0, 0]", "twice"), ("reduction_kpa: [0, 50]", "reduction_kpa: [10, 50]", "begin at 0"),
    ("braking_factor: [0, 0.17]", "braking_factor: [0, 1.7]", "up to 1"),
    ("braking_factor: [0, 0.17]", "braking_factor: [0.3, 0.17]", "must rise"),
    ("charged_kpa: 600", "charged: 6", "absolute"),
])  # fmt: skip
def test_bad_consist_files(tmp_path: Path, old: str, new: str, names: str) -> None:
    """Typical mistakes in a train file, each with its own message."""
    from plant_sim import library

    shipped = Path(library.__file__).parent / "data" / "consists" / "hxd1_c80_105.yaml"
    text = shipped.read_text(encoding="utf-8")
    assert old in text
    file = tmp_path / "own.yaml"
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ValueError, match=r"own\.yaml") as caught:
        load_consist(str(file))
    assert names in str(caught.value)
    assert all(line.startswith(f"{file}: ") for line in str(caught.value).split("\n"))


def test_unknown_names() -> None:
    """Breaks if the message lacks the shipped names or the nearest one."""
    for load, name, text in (
        (load_line, "daquin_section", "did you mean 'daqin_section'"), (load_consist, "no_such_train", "freight_five"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=text):
            load(name)
