"""Limits ahead of a law: speed limit over the whole train, forces of the units in sections, and mpc with them."""

import dataclasses
import math
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from law_trains import model as train_model
from span_runs import setup_of
from test_line_sections import driven, plain_line, railcar

import train_ato as ta
from plant_sim.library import load_consist, load_line
from plant_sim.line import SpeedLimit
from plant_sim.record import records_of
from train_ato.cli.main import main
from train_ato.control.algorithms.limits_ahead import LimitsAhead, limits_at_nodes, within_units
from train_ato.control.contract import LawPlan, Lookahead
from train_ato.control.mpc.force_plan import ForcePlan
from train_ato.control.mpc.predictive_plan import lowest_limit
from train_ato.control.registry import load_class
from train_ato.loop.engine import run_engine
from train_ato.messages.validity import MAX_SPEED
from train_ato.studies.check_component.checking import check_component

_model = partial(train_model, delay=1.0, lag=0.4)


def test_the_speed_limit_is_that_of_the_whole_train() -> None:
    """Breaks if a limit begins or ends with another place than front and rear of the train."""
    line = plain_line(speed_limits=[
        {"at": 0, "speed": 20}, {"at": 300, "speed": 10}, {"at": 310, "speed": 30}, {"at": 900, "speed": 15},
    ])  # fmt: skip
    consist = railcar()
    model = _model(consist, line)
    limits = records_of(SpeedLimit, line.restricted_limits)
    places = np.arange(60.05, 1000.0, 0.1)
    half = consist.vehicles[0].length / 2
    expected = [lowest_limit(limits, place + half, place + half - consist.length) for place in places]
    assert LimitsAhead(model).speed_limit(places).tolist() == expected and len(set(expected)) == 4
    plan = ForcePlan(model, 0.1, omega=0.1, lookahead=60.0, nodes=8, jerk=1.0, overspeed=0.0, coupler_limit=0.0)
    assert (plan.constants.front, plan.constants.rear) == (half, half - consist.length)


def test_limits_and_forces_without_entries_of_the_line() -> None:
    """Breaks if a law receives an infinity, or the compiled envelopes differ in one bit from the present limits."""
    line = load_line("xuzhou_metro_test").model_copy(update={"speed_limits": ()})
    found = LimitsAhead(_model(load_consist("xuzhou_metro_3"), line)).speed_limit(np.array([0.0, 1e4]))
    assert found.tolist() == [MAX_SPEED, MAX_SPEED]
    model = _model(load_consist("crh380a_three_units"), load_line("level"))
    speeds = np.linspace(-5.0, 110.0, 300)
    low, high = LimitsAhead(model).force(np.linspace(0.0, 4e4, 300), speeds)
    for k, speed in enumerate(speeds.tolist()):
        expected = model.limits_of_units([speed] * model.n_units)
        assert (low[k].tolist(), high[k].tolist()) == expected, speed


@pytest.mark.parametrize("pantographs", [(), (1,)])
@pytest.mark.parametrize(("sections", "demand"), [
    ({"neutral_sections": [{"begin": 100, "end": 140}]}, 1e6),
    ({"neutral_sections": [{"begin": 100, "end": 140}]}, -1e6),
    ({"neutral_sections": [{"begin": 100, "end": 140, "electric_brake": True}]}, -1e6),
    ({"power_limits": [{"begin": 80, "end": 160, "power_kw": 500}]}, 1e6),
    ({"adhesion": [{"begin": 90, "end": 150, "factor": 0.2}]}, 1e6),
    ({"adhesion": [{"begin": 90, "end": 150, "factor": 0.2}]}, -1e6),
])  # fmt: skip
def test_the_forces_are_those_of_the_plant(sections, demand, pantographs) -> None:
    """Breaks if a section acts at another place, on another unit or with another force than in the plant."""
    line = plain_line(**sections)
    consist = railcar().model_copy(update={"pantographs": pantographs})
    rows = driven(line, demand, 6.0, consist, start={"position": 60, "speed": 25})
    limits = LimitsAhead(_model(consist, line))
    forces = limits.force(rows[:, 0, 0].copy(), rows[:, 1, 0].copy())[int(demand > 0)]
    borders = limits._zones.breaks
    places = np.stack((rows[:, 0], rows[:, 0][:, list(consist.supplies)]), axis=2)
    compared = np.abs(places[..., None] - borders).min(axis=(2, 3)) > 4.0
    assert forces[compared] == pytest.approx(rows[:, 2][compared], rel=0.02, abs=1.0)
    works = sections.get("neutral_sections", [{}])[0].get("electric_brake", False)
    assert (len(set(np.round(forces[compared], -2).tolist())) == 1) is works and compared.sum() > 60


def test_the_other_units_take_over() -> None:
    """Breaks if the force of a unit without power is lost while others have some left, or a limit is exceeded."""
    share, low, high = [0.25, 0.5, 0.25], [-100.0] * 3, [100.0, 0.0, 30.0]
    assert within_units([20.0, 40.0, 20.0], share, low, high) == pytest.approx([50.0, 0.0, 30.0])
    assert within_units([80.0, 90.0, 80.0], share, low, high) == pytest.approx([100.0, 0.0, 30.0])
    assert within_units([-20.0, -40.0, -20.0], share, low, high) == [-20.0, -40.0, -20.0]


def test_a_short_section_keeps_its_impulse_between_the_nodes() -> None:
    """Breaks if a section between two nodes is lost or counts for the whole distance to the next node."""
    nodes = np.array([0.0, 1.0, 2.0, 4.0])
    force = np.full((15, 2), 50.0)
    force[3 + 1 * 4 + 1 : 3 + 1 * 4 + 3] = 0.0  # of the 4 steps from the second node, 2 values
    open_range = np.array([[-np.inf], [np.inf]]).repeat(4, axis=1)
    force[2] = 20.0  # row of the effect
    found = limits_at_nodes(-force, force, nodes, parts=4, effect=2, limits=open_range)
    assert found[1, 0] == 40.0 and found[1, 3] == 100.0
    lost = 100.0 - found[1]
    assert lost[1] * 1.0 + lost[2] * 1.5 == pytest.approx(100.0 * 2 * 0.25)
    assert (found[0] == -found[1]).all()


def _largest_errors(known):
    """Return the largest errors of speed [m/s] and position [m] and the cautious steps of mpc in a neutral section."""
    plain = setup_of("crh380a_gpc:short", {}).model.line.model_dump(mode="json", by_alias=True, exclude_unset=True)
    changes = {"plant.line": {**plain, "neutral_sections": [{"begin": 800, "end": 1000}]}}
    if not known:
        changes["model.line"] = plain
    law = {"supervision.enabled": False, "law": "mpc", "compensation": "none", "duration": 110}
    recording = run_engine(setup_of("crh380a_gpc:short", {**law, **changes})).recording
    measured, reference = recording.topics["train/measurement"], recording.topics["ato/reference"]
    errors = [np.abs(measured[name][:, 0] - reference[name][:, 0]).max() for name in ("velocity", "position")]
    cautious = recording.diagnostics["controller"].numbers("mpc.cautious_steps")
    assert cautious is not None and all(map(math.isfinite, errors))
    return *errors, cautious[-1]


def test_mpc_makes_no_spike_before_a_neutral_section(tmp_path, monkeypatch) -> None:
    """Breaks if the last steps before the section correct a small error by a large force: 35 kN in one step."""
    monkeypatch.chdir(tmp_path)
    assert main(["new", "scenario", "my_metro"]) == 0
    with Path("line.yaml").open("a", encoding="utf-8") as line:
        line.write("neutral_sections: [{begin_km: 0.5, end_km: 0.58, off_before: 40, on_after: 30, coasting: true}]\n")
    run = ta.run("my_metro.yaml", law="mpc", set={"duration": 60, "criteria": {}}, progress=False)
    place = run["train/measurement"]["unit_0_position_m"].to_numpy()
    force = run["ato/command"]["unit_0_force_n"].to_numpy()
    first = np.searchsorted(place, 460)
    assert np.abs(force[first - 60 : first]).max() < 12e3, "5 % of the largest force; the plan coasts there"
    assert np.abs(force[(place > 460) & (place < 605)]).max() == 0.0


def test_mpc_gains_from_a_known_neutral_section() -> None:
    """Breaks if the plan does not use the forces ahead: it loses the force and takes its own model for wrong."""
    (speed, position, cautious), (without, far, doubted) = _largest_errors(known=True), _largest_errors(known=False)
    print(f"mpc: {without:.2f} m/s and {far:.1f} m unknown, {speed:.2f} m/s and {position:.1f} m known")
    assert speed < 0.7 * without and position < 0.5 * far and cautious == 0
    assert doubted > 0


@pytest.fixture
def planning_law(monkeypatch):
    """Make the template of a law that looks ahead importable; return its name."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "examples"))
    return "my_planning_law:MyPlanningLaw"


def test_the_template_of_a_planning_law_passes(planning_law) -> None:
    findings = check_component("law", load_class(planning_law))
    assert not [finding for finding in findings if finding.passed is False]


def test_the_template_gains_speed_before_a_neutral_section(planning_law) -> None:
    """Breaks if a law of one's own does not receive the forces ahead, or its plan is not in the log."""
    plain = setup_of("crh380a_gpc:short", {}).model.line.model_dump(mode="json", by_alias=True, exclude_unset=True)
    errors = []
    for gained in (0.5, 0.0):
        changes = {
            "plant.line": {**plain, "neutral_sections": [{"begin": 800, "end": 1000}]}, "supervision.enabled": False,
            "law": planning_law, "compensation": "preview", "duration": 95, f"laws.{planning_law}.gained": gained,
        }  # fmt: skip
        recording = run_engine(setup_of("crh380a_gpc:short", changes)).recording
        measured, reference = recording.topics["train/measurement"], recording.topics["ato/reference"]
        errors.append(float(np.abs(measured["velocity"][:, 0] - reference["velocity"][:, 0]).max()))
        assert recording.diagnostics["controller"].texts("plan.status")[10] == "solved"
    print(f"{planning_law}: {errors[1]:.2f} m/s without, {errors[0]:.2f} m/s with speed gained")
    assert errors[0] < 0.75 * errors[1]


@pytest.mark.parametrize("of", [LawPlan, Lookahead])
def test_the_page_of_the_contract_names_every_field(of) -> None:
    page = (Path(__file__).parents[1] / "msgs_docs" / "contract.md").read_text(encoding="utf-8")
    missing = [entry.name for entry in dataclasses.fields(of) if not re.search(rf"`[\w.]*\b{entry.name}`", page)]
    assert not missing
