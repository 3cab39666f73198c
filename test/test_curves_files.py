"""Case files of braking curves: refused inputs, files and options, and the example of the page."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from train_ato.apps.curves.case_file import CurveInputs
from train_ato.cli.main import main

PUBLISHED: dict[str, dict[str, Any]] = json.loads(
    (Path(__file__).parent / "data" / "etcs_braking_cases.json").read_text()
)
LAMBDA = PUBLISHED["Lambda PasInP 100%"]["inputs"]
GAMMA = PUBLISHED["Gamma PasInP"]["inputs"]
PAGE = Path(__file__).parents[1] / "msgs_docs" / "supervision.md"

REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("lambda too small", {"brake_percentage": 29.0}, "brake_percentage: 29 % is outside the conversion model"),
    ("lambda too large", {"brake_percentage": 251.0}, "brake_percentage: 251 % is outside the conversion model"),
    ("too fast", {"max_speed_kmh": 205.0}, "max_speed_kmh: 205 km/h is outside the conversion model"),
    ("passenger train too long", {"length_m": 901.0}, "length_m: 901 m is outside .*at most 900 m"),
    ("freight train too long", {"length_m": 1501.0, "brake_position": "FreightTrainInG"}, "at most 1500 m"),
    ("unknown key", {"lenght_m": 3.0}, "inputs.lenght_m: unknown key; did you mean 'length_m'"),
    ("negative length", {"length_m": -700.0}, "inputs.length_m = -700.0: input should be greater than 0"),
    ("NaN", {"length_m": float("nan")}, "inputs.length_m = nan: .*finite"),
    ("text", {"length_m": "700"}, "inputs.length_m = '700': input should be a number, not text"),
    ("gradients out of order", {"gradients": [[0, 1], [500, 2], [400, 0]]}, "gradients: starts must rise"),
    ("gradient as a ratio times 1e6", {"gradients": [[0, 2000]]}, "gradients: a grade is above 500"),
    ("unknown position", {"brake_position": "P"}, "inputs.brake_position = 'P': input should be 'PassengerTrainInP'"),
    ("without percentage", {"brake_percentage": None},
     "key brake_percentage is missing, a lambda train needs it; add it"),
    ("gamma without deceleration", {"model": "gamma"},
     "key A_brake_emergency is missing, a gamma train needs it; add it"),
    ("steps out of order", {"Kv_int": [[0, 1], [90, 0.8], [80, 0.7]]},
     "steps of Kv_int: give .start, value. by rising start"),
    ("factor 0", {"Kv_int": 0}, r"inputs\.Kv_int = 0: input should be greater than or equal to 0.000001"),
    ("factor 0 of the length", {"Kr_int": 0.0}, r"inputs\.Kr_int = 0\.0: input should be greater than or equal to"),
    ("step of 0", {"Kv_int": [[0, 1], [90, 0]]}, "steps of Kv_int: a value is outside 1e-06 ... 2; correct it"),
    ("weak brake", {"Kv_int": 1e-6, "gradients": [[0, -1]]},
     r"the brake \(8.26e-07 m/s² at 7.5 km/h\) is not stronger than the gradient \(0.0096"),
    ("gamma key", {"Kdry": 0.9}, "key Kdry belongs to a gamma train; remove it, or write the model gamma"),
    ("lambda key", {"model": "gamma", "A_brake_emergency": 1.0, "T_brake_emergency": 2.0, "Kv_int_b": 0.9},
     "key Kv_int_b belongs to a lambda train; remove it, or write the model lambda"),
    ("pivot alone", {"A_P12": 0.5},
     "pivots A_P12 and A_P23 belong to Kv_int_b, which is missing; add it, or remove them"),
    ("subset b of a freight train", {"Kv_int_b": 0.5, "brake_position": "FreightTrainInP"},
     "key Kv_int_b belongs to a passenger train in P; remove it"),
    ("too steep", {"gradients": [[0, -100]]}, "is not stronger than the gradient"),
    ("release without an end", {"release_computed_at_m": 0}, "release_computed_at_m: only an end of authority"),
    ("release speed at level 1", {"target_type": "EOA", "release_computed_at_m": 0, "level": 1},
     "release_computed_at_m: the delay of the trip at level 1 .T41. is not covered; write level 2"),
    ("end of authority with a speed", {"target_type": "EOA", "target_speed_kmh": 30}, "target_speed_kmh: an end of"),
]  # fmt: skip


@pytest.mark.parametrize(("what", "change", "text"), REFUSED, ids=[row[0] for row in REFUSED])
def test_refused_inputs(what, change, text, tmp_path, capsys):
    """Breaks if bad input is accepted, gives a traceback, or the line lacks file, case and key."""
    path = tmp_path / "case.json"
    path.write_text(json.dumps({"first": {"inputs": LAMBDA | change, "curves": {"EBD": [10]}}}))
    assert main(["curves", str(path)]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and line.startswith(f"train-ato: {path}: first: ")
    assert re.search(text, line), line


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1, 2]", "holds a list in place of cases"),
        ("{", "not valid JSON"),
        ("{}", "no case"),
        (json.dumps({"inputs": LAMBDA, "curves": {"EBD": ["10"]}}), r"curves\.EBD\.0"),
        (json.dumps({"inputs": LAMBDA, "curves": {"EBD": [[10, float("nan")]]}}), r"curves\.EBD\.0.*finite"),
        (json.dumps({"inputs": LAMBDA, "curves": {"EBD": [True]}}), r"curves\.EBD\.0: row True is no speed"),
        (json.dumps({"inputs": LAMBDA, "curves": {"EBD": [-1]}}), r"curves\.EBD\.0: row -1 has a speed out of range"),
        ('{"inputs": {}, "inputs": {}}', "key 'inputs' is repeated"),
        ('{"inputs": {"model": "gamma"}, "curves": {"XYZ": [1]}}', "XYZ|missing"),
    ],
)
def test_refused_files(text: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a file that holds no cases gives a traceback, or a line that names no file."""
    path = tmp_path / "case.json"
    path.write_text(text)
    assert main(["curves", str(path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == (4 if "missing" in message else 1)  # one for each fault
    assert all(line.startswith(f"train-ato: {path}") for line in lines)
    assert re.search(message, "\n".join(lines)), lines


def test_files_that_an_option_or_a_name_does_not_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if --deviation without distances prints nothing, or cases without .json end in an error of scenarios."""
    text = json.dumps({"inputs": GAMMA, "curves": {"EBI": [10.0]}})
    speeds, other = tmp_path / "speeds.json", tmp_path / "cases.txt"
    for path, words, message in (
        (speeds, ["--deviation"], "no distance for --deviation; write [speed, distance] in place of speeds"),
        (speeds, ["--deviation", "--json"], "no distance for --deviation"),
        (other, [], "cases need a name ending in .json; rename the file"),
        (speeds, ["--acceleration", "0.3"], "--acceleration: belongs to a scenario; write A_est1 in "),
        (speeds, ["--balise-m", "3"], "--balise-m: belongs to a scenario; write distance_since_balise_m in "),
        (speeds, ["--max-speed-kmh", "3"], "write max_speed_kmh in "),
        (speeds, ["--at-km", "3"], "write target_location_m in "),
    ):
        path.write_text(text)
        assert main(["curves", str(path), *words]) == 2
        line = capsys.readouterr().err
        assert message in line and str(path) in line and line.count("\n") == 1


def test_the_case_file_of_the_page_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the example of supervision.md is refused or not minimal, or the page does not name a key."""
    page = PAGE.read_text()
    (block,) = re.findall(r"^```json\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    path = tmp_path / "page.json"
    path.write_text(block)
    assert main(["curves", str(path)]) == 0
    capsys.readouterr()
    example = json.loads(block)
    for key in example["inputs"]:
        path.write_text(json.dumps(example | {"inputs": {k: v for k, v in example["inputs"].items() if k != key}}))
        assert main(["curves", str(path)]) == 2
        assert key in capsys.readouterr().err
    assert [key for key in CurveInputs.model_fields if f"`{key}`" not in page and f'"{key}"' not in block] == []
