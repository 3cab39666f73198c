"""Case files of braking curves: refused input, the page, published cases, conversion model and release speeds.

Curves of the shipped trains against emergency-brake runs of the plant.
"""

import copy
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import answer, complaint

from plant_sim import kernel as k
from plant_sim.library import load_consist, load_line
from plant_sim.line import AdhesionSection, Line
from plant_sim.plant_setup import PlantSetup
from plant_sim.traction import Envelope
from plant_sim.train import Train
from train_ato.cli.main import main
from train_ato.studies.curves.case_file import CurveCase, CurveInputs, read_cases
from train_ato.studies.curves.curves import case_table
from train_ato.supervision.odometry import MotionEstimate
from train_ato.supervision.plant_line import grades_permille, highest_limit, line_supervision
from train_ato.supervision.step_function import gradient_acceleration
from train_ato.supervision.track_supervision import ceiling

FILE = Path(__file__).parent / "data" / "etcs_braking_cases.json"
PUBLISHED: dict[str, dict[str, Any]] = json.loads(FILE.read_text())
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
    line = complaint(capsys, "curves", str(path))
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
    lines = complaint(capsys, "curves", str(path)).splitlines()
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
        line = complaint(capsys, "curves", str(path), *words)
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
        assert main(["curves", str(path)]) == 2 and key in capsys.readouterr().err
    assert [key for key in CurveInputs.model_fields if f"`{key}`" not in page and f'"{key}"' not in block] == []


def distances(inputs: dict[str, Any], curve: str, *speeds: float) -> list[float]:
    """Return the distances of one curve [m]."""
    case = CurveCase.model_validate({"inputs": inputs, "curves": {curve: speeds}})
    return [row[1] for row in case_table(case, "test")[curve]]


@pytest.mark.parametrize(("name", "curve"), [(n, c) for n, case in PUBLISHED.items() for c in case["curves"]])
def test_every_published_point(name: str, curve: str) -> None:
    """Breaks if a coefficient, a time or a rule of a curve differs from the standard."""
    case = read_cases(FILE)[0][name]
    found = case_table(case, name)[curve]
    bound = {"gamma": 0.05, "lambda": 0.25}[case.inputs.model]  # 0.25 m is the tolerance of the published project
    for (speed, distance), (published_speed, published) in zip(found, PUBLISHED[name]["curves"][curve], strict=True):
        assert speed == published_speed
        assert distance == pytest.approx(published, abs=bound), f"{name} {curve} {speed} km/h"


def deviation_of_cells(name: str, width_kmh: float) -> float:
    """Return the deviation [m] of published EBD figures against an integration in cells with their lower values."""
    inputs = CurveInputs.model_validate(PUBLISHED[name]["inputs"])
    train, foot = inputs.train(), 7.5  # V_ebi of the target speed 0 [km/h]
    gradient = gradient_acceleration(inputs.gradients, train.length, None, inputs.fixed_values())
    kmh, place, locations = foot, inputs.target_location_m, {}
    for index in range(int(foot / width_kmh + 1e-9) + 1, int(190.0 / width_kmh + 1e-9) + 2):
        locations[round(kmh, 6)] = place
        deceleration = train.brake.safe.above(kmh / 3.6)[0] + gradient.below(place)[0]
        place -= ((index * width_kmh) ** 2 - kmh**2) / 3.6**2 / 2 / deceleration
        kmh = index * width_kmh
    points = PUBLISHED[name]["curves"]["EBD"]
    return max(
        abs(inputs.target_location_m - locations[speed] - distance) for speed, distance in points if speed > foot
    )


@pytest.mark.parametrize("name", [name for name, case in PUBLISHED.items() if case["inputs"]["model"] == "lambda"])
def test_the_rest_of_the_deviation_is_an_integration_in_cells(name: str) -> None:
    """Breaks if the published lambda cases deviate for another reason than their cells of 0.1 km/h."""
    # The bound is the rounding of figures with two decimals.
    assert deviation_of_cells(name, 0.1) < 0.005 + 1e-4
    assert deviation_of_cells(name, 0.05) > 0.1  # the first step ends at 121.0 km/h in wide cells, 120.948 in the model


def test_the_width_of_the_cells_in_the_page() -> None:
    page = PAGE.read_text()
    gradients = ("Gamma PasInP", "Lambda PasInP TractCutOff 2 + SBInterface + TCOInterface")
    for width in (0.1, 0.2):
        gamma, driven = (deviation_of_cells(name, width) for name in gradients)
        assert f"{gamma:.3f} m and {driven:.3f} m with cells of {width:g} km/h" in " ".join(page.split())


@pytest.mark.parametrize(("position", "length", "emergency", "service"), [
    # T_be and T_bs [s] of A.3.8 and A.3.9, by hand: a + b L/100 + c (L/100)²
    ("PassengerTrainInP", 300.0, 5.02, 8.4), ("PassengerTrainInP", 900.0, 16.07, 24.6),
    ("FreightTrainInP", 300.0, 5.02, 11.31), ("FreightTrainInP", 900.0, 16.07, 27.93),
    ("FreightTrainInP", 901.0, 16.451403, 27.995618), ("FreightTrainInP", 1500.0, 30.35, 55.8),
    ("FreightTrainInG", 300.0, 12.45, 14.08), ("FreightTrainInG", 900.0, 16.05, 27.93),
    ("FreightTrainInG", 1500.0, 30.35, 55.8),
])  # fmt: skip
@pytest.mark.parametrize(("target", "correction"), [(0.0, 0.0), (60.0, None)])
def test_build_up_times(position, length, emergency, service, target, correction):
    """Breaks if a position, a length step, the shortest length or the correction for target speeds is wrong."""
    if correction is None:
        correction = 0.16 if position == "FreightTrainInG" else 0.2
    inputs = LAMBDA | {
        "brake_position": position, "length_m": length, "service_brake_command": True, "target_speed_kmh": target,
    }  # fmt: skip
    ebd, ebi, sbi2 = (distances(inputs, curve, 90.0)[0] for curve in ("EBD", "EBI", "SBI2"))
    assert ebi - ebd == pytest.approx(25.0 * (1 + correction) * emergency, abs=1e-6)
    assert sbi2 - ebi == pytest.approx(25.0 * (1 + correction) * service, abs=1e-6)


@pytest.mark.parametrize(
    ("percentage", "limit", "values"),
    [  # brake percentage, end of the first step [km/h] and deceleration at 10, 95, 110, 140, 170, 195 km/h
        (30.0, 72.245, (0.301, 0.24579, 0.287485, 0.217623, 0.210945, 0.209281)),
        (65.0, 100.584, (0.5635, 0.5635, 0.519891, 0.412313, 0.398772, 0.392701)),
        (100.0, 120.948, (0.826, 0.826, 0.826, 0.6171, 0.5915, 0.58173)),
        (250.0, 179.027, (1.951, 1.951, 1.951, 1.951, 1.951, 1.475119)),
    ],
)
def test_basic_deceleration(percentage: float, limit: float, values: tuple[float, ...]) -> None:
    """Breaks if a coefficient or the rule for steps below the first one is wrong."""
    model = CurveInputs.model_validate(LAMBDA | {"brake_percentage": percentage}).train().brake.safe
    assert model.bounds[0] * 3.6 == pytest.approx(limit, abs=1e-3)
    found = [model.at(kmh / 3.6) for kmh in (10, 95, 110, 140, 170, 195)]
    assert found == pytest.approx(values, abs=1e-5)


def test_service_deceleration_and_factors() -> None:
    """Breaks if the service brake has the whole percentage, a factor is of the wrong step, or subsets are not mixed."""
    strong, limit = LAMBDA | {"brake_percentage": 200.0, "Kv_int": 0.5}, LAMBDA | {"brake_percentage": 135.0}
    assert distances(strong, "SBD", 150.0) == pytest.approx(distances(limit, "SBD", 150.0))
    assert distances(LAMBDA | {"brake_percentage": 134.0}, "SBD", 150.0)[0] > distances(limit, "SBD", 150.0)[0]
    stepped = LAMBDA | {"Kv_int": [[0, 0.7], [80, 0.9]], "Kr_int": [[0, 1.0], [500, 0.9]]}
    brake = CurveInputs.model_validate(stepped).train().brake.safe
    assert brake.at(80 / 3.6) == pytest.approx(0.826 * 0.7 * 0.9)
    assert brake.at(81 / 3.6) == pytest.approx(0.826 * 0.9 * 0.9)
    assert CurveInputs.model_validate(stepped | {"length_m": 500.0}).train().brake.safe.at(1.0) == pytest.approx(0.5782)
    subsets = LAMBDA | {"Kv_int": 1.0, "Kv_int_b": 0.6, "A_P12": 0.726, "A_P23": 0.926}
    assert CurveInputs.model_validate(subsets).train().brake.safe.at(1.0) == pytest.approx(0.826 * 0.8)
    dry = GAMMA | {"Kdry": 0.8, "Kwet": [[0, 0.9], [100, 0.5]], "available_adhesion": 0.5}
    gamma = CurveInputs.model_validate(dry | {"A_brake_emergency": [[0, 1.2], [60, 1.0]]}).train().brake.safe
    assert [gamma.at(kmh / 3.6) for kmh in (30, 70, 130)] == pytest.approx([0.912, 0.76, 0.6])


def test_command_repeats_the_structure_of_its_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if --json changes names, inputs or order of the points, or a single case has another form."""
    found = answer(capsys, "curves", str(FILE))
    assert list(found) == list(PUBLISHED)
    for name, case in PUBLISHED.items():
        assert found[name]["inputs"] == case["inputs"]
        assert {c: [row[0] for row in rows] for c, rows in found[name]["curves"].items()} == {
            c: [row[0] for row in rows] for c, rows in case["curves"].items()
        }
    single = copy.deepcopy(PUBLISHED["Gamma PasInP"])
    single["curves"] = {"EBI": [100], "SBI": [50.0]}
    path = tmp_path / "single.json"
    path.write_text(json.dumps(single))
    assert main(["curves", str(path), "--json", "--out", str(tmp_path / "x.png")]) == 0
    assert json.loads(capsys.readouterr().out)["curves"]["EBI"][0][1] == pytest.approx(460.6, abs=0.05)
    assert (tmp_path / "x.png").read_bytes()[:4] == b"\x89PNG"
    path.write_text(json.dumps({"only": single}))
    assert list(answer(capsys, "curves", str(path))) == ["only"]
    assert main(["curves", str(FILE)]) == 0 and "460.60" in capsys.readouterr().out


def test_deviation_is_the_largest_of_each_curve(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the deviation is that of another point, or speeds without a distance count."""
    case = {"inputs": GAMMA, "curves": {"EBI": [10.0, [100.0, 461.0], [120.0, 646.0]], "EBD": [50.0]}}
    path = tmp_path / "case.json"
    path.write_text(json.dumps(case))
    found = answer(capsys, "curves", str(path), "--deviation")["deviation_m"]
    assert found == {"EBI": pytest.approx(0.96, abs=0.02), "EBD": None}
    assert main(["curves", str(FILE), "--deviation"]) == 0
    assert "Gamma PasInP" in capsys.readouterr().out


def test_odometry_and_release_speed_of_a_case(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the position error, A_est1, A_est2 or the EOA does not reach curves or release speed."""
    inputs = GAMMA | {"t_traction_cutoff_s": 1.0, "gradients": []}
    (exact,) = distances(inputs, "EBI", 72.0)
    (far,) = distances(inputs | {"distance_since_balise_m": 400.0}, "EBI", 72.0)
    assert far - exact == pytest.approx(25.0)
    (driven,) = distances(inputs | {"A_est1": 0.5, "A_est2": 0.2}, "EBI", 72.0)  # rises: 0.5 · 1 s, 0.2 · 1.5 s
    assert driven - exact == pytest.approx((20.8**2 - 20**2) / 2 + 0.25 * 1.0 + (0.5 + 0.15) * 1.5)
    end = {"target_type": "EOA", "eoa_location_m": 6950.0, "release_computed_at_m": 6800.0}
    path = tmp_path / "case.json"
    path.write_text(json.dumps({"inputs": inputs | end, "curves": {"EBI": [20]}}))
    release = answer(capsys, "curves", str(path))["release"]["speed_kmh"]
    reached = (release + 2.0) / 3.6
    assert 6975.0 + 2.5 * reached + reached**2 / 2 == pytest.approx(7000.0)  # trip 10 m + 10 % of 150 m beyond the end
    assert main(["curves", str(path)]) == 0
    assert f"release speed {release:.2f} km/h" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("behind", "limit", "expected"),
    [  # by hand: the trip is 10 m + 10 % of (1000 m + behind) beyond the end, the rest of the 300 m to the SvL is for
        # u = V + f41(V) with 2.5 s u + u²/2, f41 = 2 km/h + (V - 30 km/h)/47: V + f41 = 45.15 and 24.43 km/h
        (800.0, 160.0, 42.88),
        (1500.0, 160.0, 22.43),
        (800.0, 40.0, 40.0),
    ],
)
def test_release_speed_counts_distances_from_the_last_balise(behind: float, limit: float, expected: float) -> None:
    """Breaks if 10 % of the distance to the EOA are taken from the front, or the speed limit does not limit it."""
    # The odometer error grows from the last balise on; the share from the front gave 59.13 and 49.49 km/h.
    end = {"target_type": "EOA", "eoa_location_m": 6700.0, "release_computed_at_m": 5700.0, "gradients": []}
    case = CurveInputs.model_validate(GAMMA | end | {"distance_since_balise_m": behind, "mrsp_kmh": limit})
    assert case.release(case.limits())["speed_kmh"] == pytest.approx(expected, abs=0.005)


STEP_NS, TICK_NS = 5_000_000, 100_000_000
LAG: dict[str, Any] = {"lag": 0.4}
RUNS: list[tuple[str, str, dict[str, Any], float, float, tuple[float, ...]]] = [
    # consist, line, plant, maximum speed [km/h], end of authority [m], speeds [km/h]
    ("hxd1_c80_105", "level", LAG, 80, 30e3, (10, 40, 80)),
    ("hxd1_c80_105", "daqin_section", LAG, 80, 22.5e3, (20, 50, 80)),
    ("hxd1_c80_210", "daqin_section", LAG, 80, 36e3, (40, 80)),
    ("xuzhou_metro_3", "xuzhou_metro_test", LAG | {"grade_over_length": True}, 80, 4e3, (20, 80)),
    ("crh380a_three_units", "highspeed_286km", LAG, 350, 60e3, (100, 300)),
    ("crh380a_one_mass", "highspeed_286km", {}, 350, 100e3, (200, 350)),
    ("freight_five", "level", LAG | {"reversing": True}, 80, 10e3, (4, 30, 80)),
    ("xuzhou_metro_3", "level", LAG | {"adhesion": {"kind": "constant", "coefficient": 0.08}}, 80, 4e3, (20, 80)),
    ("freight_five", "level", LAG | {"rate_limit_kn_per_s": 20}, 80, 10e3, (30, 80)),
]


def plant_at(consist: Any, line: Any, plant: dict[str, Any], front: float, speed: float) -> Train:
    """Return a train with its front at a position [m] and a speed [m/s]."""
    start = {"position": front - consist.vehicles[0].length / 2, "speed": speed}
    return Train(consist, line, PlantSetup.model_validate(plant | {"start": start}), step_ns=STEP_NS, tick_ns=TICK_NS)


def acceleration(train: Train, force: float) -> float:
    """Return the mean acceleration of a train over one tick with a part of its traction [m/s²]."""
    before = train.momentum
    demand = [force * max(train.consist.vehicles[i].traction[0].force, 1.0) for i in train.units]
    train.advance(np.tile(demand, (train.substeps, 1)))
    return (train.momentum - before) / float(train.arrays.vehicle[k.MASS].sum()) / (TICK_NS * 1e-9)


def emergency_stop(train: Train) -> float:
    """Apply the emergency brake until standstill; return the final position of the front [m]."""
    train.apply_emergency_brake()
    while np.abs(train.velocity).max() > 0.02:
        train.advance(np.zeros((train.substeps, len(train.units))))
        assert train.time < 900
    return float(train.position[0]) + train.consist.vehicles[0].length / 2


@pytest.mark.parametrize(
    ("consist_name", "line_name", "plant", "top", "end", "kmh"), [(*row[:5], kmh) for row in RUNS for kmh in row[5]]
)
def test_emergency_brake_on_the_intervention_curve_stops_before_the_location(
    consist_name: str, line_name: str, plant: dict[str, Any], top: float, end: float, kmh: float
) -> None:
    """Breaks if the model brakes harder or earlier than the plant, or a gradient is not part of the curve."""
    # The train coasts, and its own acceleration enters the curve as the estimated one.
    consist, line, speed = load_consist(consist_name), load_line(line_name), kmh / 3.6
    limits = line_supervision(consist, line, PlantSetup.model_validate(plant), end, max_speed=top / 3.6).targets[-1]
    front = limits.emergency(speed)
    for _ in range(3):  # the acceleration depends on the position, and this on the acceleration
        coasting = acceleration(plant_at(consist, line, plant, front, speed), 0.0)
        front = limits.emergency(speed, MotionEstimate(coasting))
    stop = emergency_stop(plant_at(consist, line, plant, front, speed))
    assert front < stop < end
    # the step of the model loses up to half the distance of the build-up, and leaves out the running resistance
    build_up = speed * limits.train.brake.emergency_time.to_standstill
    assert end - stop < 0.5 * build_up + 0.2 * (end - front), "the curve is far longer than the brake needs"


def test_traction_at_the_intervention_is_covered_by_the_estimated_acceleration() -> None:
    """Breaks if the traction that fades with the lag of the actuators is not part of the traction time."""
    consist, line = load_consist("xuzhou_metro_3"), load_line("level")
    limits = line_supervision(consist, line, PlantSetup.model_validate(LAG), 10e3, max_speed=80 / 3.6).targets[-1]
    train = plant_at(consist, line, LAG, 0.0, 5.0)
    for _ in range(30):
        driving = acceleration(train, 1.0)
    assert driving > 0.9
    begin = float(train.position[0]) + consist.length / 2
    needed = 10e3 - limits.emergency(float(train.velocity[0]), MotionEstimate(driving))
    stopping = emergency_stop(train) - begin
    assert 0.9 * needed < stopping < needed


@pytest.mark.parametrize("name", ["hxd1_c80_105", "hxd1_c80_210", "crh380a_eight_cars"])
def test_deceleration_is_never_above_that_of_the_full_brakes(name: str) -> None:
    """Breaks if a speed step is above the smallest force inside it or far below, or electric brakes are in the EBD."""
    consist, setup = load_consist(name), PlantSetup.model_validate(LAG)
    brake = line_supervision(consist, load_line("level"), setup, 30e3, max_speed=100 / 3.6).train.brake
    mass = sum(vehicle.mass * vehicle.rotating_mass_factor for vehicle in consist.vehicles)
    for kmh in np.linspace(0.0, 107.0, 215):
        factor = (2 * kmh + 150) / (3 * kmh + 150)
        force = sum(v.shoes.standstill_force * factor for v in consist.vehicles if v.shoes is not None)
        service = sum(Envelope(v.brake).force(kmh / 3.6) for v in consist.vehicles)
        if consist.air_brake is None:
            force = 1.2 * mass * factor
        else:
            service += consist.air_brake.braking_factor[-1] * force
        assert 0.9 * force / mass < brake.safe.at(kmh / 3.6) <= force / mass * (1 + 1e-12)
        if brake.service is not None:
            assert brake.service.at(kmh / 3.6) <= service / mass * (1 + 1e-12)


def test_propagation_wave_and_filling_are_in_the_build_up_time() -> None:
    """Breaks if the wave time, the cylinder time or the two sources of the longer train are not used."""
    setup, line = PlantSetup.model_validate(LAG), load_line("level")
    one = line_supervision(load_consist("hxd1_c80_105"), line, setup, 30e3).train.brake
    two = line_supervision(load_consist("hxd1_c80_210"), line, setup, 30e3).train.brake
    # 105 wagons behind the locomotive: the middle one is 661.6 m behind its centre, 200 m/s and 4 s
    middle = 4.0 + (35.222 + 12) / 2 / 200 + 52 * 12 / 200
    assert one.emergency_time.to_standstill == pytest.approx(middle, rel=0.015)
    assert two.emergency_time.to_standstill < one.emergency_time.to_standstill
    given = load_consist("hxd1_c80_105")
    assert given.air_brake is not None
    slow = given.model_copy(update={"air_brake": given.air_brake.model_copy(update={"apply_wave": 100.0})})
    later = line_supervision(slow, line, setup, 30e3).train.brake.emergency_time.to_standstill
    assert later - one.emergency_time.to_standstill == pytest.approx(52 * 12 / 200, rel=0.06)


def test_times_and_curve_of_the_brakes() -> None:
    """Breaks if a reaction time is missing or shortens a time, or a default of the service brake is exchanged."""
    consist, line, setup = load_consist("xuzhou_metro_3"), load_line("level"), PlantSetup.model_validate(LAG)
    at_once, later = (line_supervision(consist, line, setup, 4e3, reaction=time).train for time in (0.0, 0.75))
    for name in ("emergency_time", "service_time"):
        before, after = getattr(at_once.brake, name), getattr(later.brake, name)
        assert after.to_standstill - before.to_standstill == pytest.approx(0.75)
        assert after.to_speed - before.to_speed == pytest.approx(0.75)
    assert later.t_traction_cut_off - at_once.t_traction_cut_off == pytest.approx(0.75)
    plain = line_supervision(consist, line, setup, 4e3)
    assert plain.train.brake.service is not None and plain.without_service_curve is None
    assert plain.train.service_command is False
    assert line_supervision(consist, line, setup, 4e3, service_brake=True).train.service_command is True
    alone = line_supervision(consist, line, setup, 4e3, service_curve=False)
    assert alone.train.brake.service is None and alone.without_service_curve is not None
    assert alone.train.brake.emergency_time == plain.train.brake.emergency_time


def test_line_gives_its_limits_and_grades_to_the_supervision() -> None:
    """Breaks if a limit or a grade of the line is lost, or the end of authority appears without a target."""
    consist, setup = load_consist("freight_five"), PlantSetup.model_validate(LAG)
    grades = [{"at": 0, "grade": 0.004}, {"at": 900, "grade": -0.009}, {"at": 5000, "grade": 0.02}]
    limits = [{"at": 0, "speed": 15.0}, {"at": 2000, "speed": 20.0}, {"at": 4000, "speed": 10.0}]
    entries = {"name": "short", "begin": 0, "end": 5000, "grades": grades, "speed_limits": limits}
    line = Line.model_validate({"schema": "train_ato/line/1", **entries})
    assert grades_permille(line) == [(0.0, 4.0), (900.0, -9.0), (5000.0, 0.0)]
    assert highest_limit(line) == 20.0 and highest_limit(load_line("level")) == 80 / 3.6
    track = line_supervision(consist, line, setup, None)
    assert track.train.max_speed == 20.0
    targets = [(entry.target.location, entry.target.speed) for entry in track.targets]
    assert targets == [(0.0, 15.0), (4000.0, 10.0)], "a train before the line has the maximum speed"
    permitted = [ceiling(track.records.ceilings, place, place).permitted for place in (1000.0, 3000.0, 4500.0)]
    assert permitted == [15.0, 20.0, 10.0]
    dry, wet = (line_supervision(consist, line, setup, 3000.0, kdry=kdry).targets for kdry in (1.0, 0.8))
    assert [entry.target.location for entry in dry] == [0.0, 3000.0]
    assert dry[-1].target.kind == "EOA" and wet[-1].emergency(10.0) < dry[-1].emergency(10.0)


@pytest.mark.parametrize("factors", [(0.5, 0.8, 1.5), (1.5,)])
@pytest.mark.parametrize(
    ("adhesion", "lowered"),
    [
        ({"kind": "constant", "coefficient": 0.16}, {"kind": "constant", "coefficient": 0.08}),
        ({"kind": "curtius_kniffler", "factor": 0.7}, {"kind": "curtius_kniffler", "factor": 0.35}),
        (None, {"kind": "curtius_kniffler", "factor": 0.5}),
    ],
)
def test_the_curves_have_the_lowest_adhesion_of_the_line(
    factors: tuple[float, ...], adhesion: dict[str, Any] | None, lowered: dict[str, Any]
) -> None:
    """Breaks if sections raise the adhesion, another than the lowest counts, or dry rail has no limit."""
    metro, level = load_consist("xuzhou_metro_3"), load_line("level")
    strong = metro.emergency_brake.model_copy(update={"deceleration": 3.0})  # more than dry rails permit
    consist = metro.model_copy(update={"emergency_brake": strong})
    sections = tuple(AdhesionSection(begin=1e3 * k, end=1e3 * k + 500, factor=f) for k, f in enumerate(factors))
    line = level.model_copy(update={"adhesion": sections})
    if factors == (1.5,):
        lowered = adhesion or {"kind": "curtius_kniffler"}
    speeds = []
    for place, limit in ((line, adhesion), (level, lowered), (level, None)):
        setup = PlantSetup.model_validate(LAG | {"adhesion": limit})
        limits = line_supervision(consist, place, setup, 4e3, max_speed=80 / 3.6).targets[-1]
        speeds.append([limits.emergency(speed) for speed in (2.0, 10.0, 20.0)])
    assert speeds[0] == speeds[1]
    assert all(limited < free - 1.0 for limited, free in zip(speeds[0][1:], speeds[2][1:], strict=True))


def test_command_for_a_scenario(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the scenario's train, line or options do not reach the curves, or they pass for those of a run."""
    monkeypatch.setattr("plant_sim.formats.fields.PRINTED", set())  # a note is printed once in a process
    assert main(["curves", "demo", "--at-km", "22.5"]) == 0
    assert "Kdry_rst = 1; the supervisor of a run has supervision.kdry = 0.8" in capsys.readouterr().err
    found = answer(capsys, "curves", "demo", "--at-km", "22.5")
    assert found["inputs"]["length_m"] == pytest.approx(1295.222)
    assert len(found["inputs"]["A_brake_emergency"]) == 7
    exact = {row[0]: row[1] for row in found["curves"]["EBI"]}
    assert main(["curves", "demo", "--at-km", "22.5", "--json", "--balise-m", "500", "--acceleration", "0.05"]) == 0
    wide = {row[0]: row[1] for row in json.loads(capsys.readouterr().out)["curves"]["EBI"]}
    assert all(wide[speed] > exact[speed] + 30.0 for speed in exact)
