"""Sections, direction and plan of a line: its effects by place, run backwards, and drawn from curves or coordinates."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from plant_trains import line_of, plain_line, train, train_of
from refusals import one_line
from span_runs import Both, setup_of

import train_ato as ta
from plant_sim import kernel as k
from plant_sim.alignment import EARTH_RADIUS, MAX_TURN, Alignment
from plant_sim.batch import advance_trains
from plant_sim.consist import Consist
from plant_sim.data_text import parse_yaml
from plant_sim.formats.writing import lost_keys, own_yaml
from plant_sim.input_error import build_model
from plant_sim.library import line_names, load_consist, load_line
from plant_sim.line import Line, reversed_line
from plant_sim.plant_setup import PlantSetup
from plant_sim.section_effects import SectionZones, limited_segments
from plant_sim.states import Array
from plant_sim.track import Track
from train_ato.cli.info import _place
from train_ato.cli.main import main
from train_ato.control.algorithms.limits_ahead import LimitsAhead
from train_ato.control.train_model import TrainModel
from train_ato.judge.verdict import place_text
from train_ato.profile.planner.planner import Plan, plan_profile
from train_ato.profile.planner.settings import PlanSettings
from train_ato.report.writing import stop_cells
from train_ato.supervision.plant_line import grades_permille, line_supervision

FORCE, POWER = 100e3, 1e6
TUNNEL = {"begin": 0, "end": 900, "cross_section": 30}


def railcar(**vehicle: Any) -> Consist:
    """Return two cars of 40 t, 20 m and 100 kN each; air resistance 5 v² N, in a tunnel of 30 m² 12 v² N more."""
    car = {
        "mass_t": 40, "length": 20, "resistance": {"n": [0, 0, 5]}, "traction": [{"to": 60, "force": FORCE}],
        "brake": [{"to": 60, "force": FORCE}],
        "tunnel_resistance": [{"cross_section": 20, "coefficient": 16}, {"cross_section": 40, "coefficient": 8}],
    }  # fmt: skip
    return train_of({"car": {**car, **vehicle}}, 2)


def driven(line: Line, demand: float, seconds: float, consist: Consist | None = None, **setup: Any) -> Array:
    """Return position, speed and applied force of both cars after every tick, shape (ticks, 3, 2)."""
    start = setup.pop("start", {"position": 30, "speed": 20})
    made = train(consist or railcar(), line, start=start, **setup)
    rows = []
    for _ in range(round(seconds * 10)):
        made.advance(np.full((made.substeps, 2), demand))
        rows.append((made.position, made.velocity, made.applied))
    return np.array(rows)


@pytest.mark.parametrize(("demand", "key"), [(FORCE, "traction"), (-FORCE, "electric brake")])
def test_a_unit_in_a_neutral_section_has_no_force(demand: float, key: str) -> None:
    """Breaks if the section switches the whole train, ignores the place of each unit, or leaves a force on."""
    rows = driven(
        plain_line(neutral_sections=[{"begin": 100, "end": 140}]), demand, 9.0, start={"position": 30, "speed": 30}
    )
    position, force = rows[:-1, 0], rows[1:, 2]  # the force of a tick is that of the place at its begin
    inside = (position >= 100) & (position < 140)
    assert inside.any(axis=0).all() and (inside[:, 0] != inside[:, 1]).any(), "both cars pass, one after the other"
    np.testing.assert_array_equal(force[inside], 0.0)
    np.testing.assert_array_equal(force[~inside], demand)


def test_units_have_power_where_their_pantograph_is() -> None:
    """Breaks if plant or plan switch a unit by its own place, with the pantograph on the rear car."""
    rear = railcar().model_copy(update={"pantographs": (1,)})
    line = plain_line(neutral_sections=[{"begin": 100, "end": 140}])
    rows = driven(line, FORCE, 9.0, rear, start={"position": 30, "speed": 30})
    position, force = rows[:-1, 0], rows[1:, 2]
    inside = (position[:, 1] >= 100) & (position[:, 1] < 140)
    assert inside.any() and (force[inside] == 0.0).all() and (force[~inside] == FORCE).all()
    section = {"speed_limits": [{"at": 0, "speed_kmh": 100}], "neutral_sections": [{"begin": 1000, "end": 1100}]}
    forces = []
    for consist in (rear, railcar()):
        found = plan_profile(plain_line(**section), consist, PlanSettings(begin=50, end=2900))
        fed = found.front - 30  # centre of the rear car
        forces.append(np.abs(found.force[(fed > 1000) & (fed < 1100)]).max())
        off, on = (found.summary()["without_power"][0][key] for key in ("off_s", "on_s"))
        first = 30 if consist is rear else 10  # from the front to the first centre with a pantograph
        places = [np.interp(at, found.profile.time, found.front) for at in (off, on)]
        assert places == pytest.approx([1000 + first, 1130], abs=0.1)
    assert forces[0] < 1.0 < 1e3 < forces[1], "the front car has power again while the rear one is in the section"
    assert build_model(Consist, yaml.safe_load(own_yaml(rear)), "again") == rear
    assert rear.model_copy(update={"pantographs": ()}).supplies == (0, 1) and rear.supplies == (1, 1)
    with pytest.raises(ValueError, match=r"pantographs: lists a vehicle outside 0 \.\.\. 1; correct it"):
        Consist.model_validate(rear.model_dump(by_alias=True) | {"pantographs": [2]})


def test_boards_switch_all_units_off_and_on_together() -> None:
    """Breaks if plant, plan or law ahead switch at another place, or a unit alone in a coasted section."""
    section = {"begin": 100, "end": 140, "announced_before": 90, "off_before": 25, "on_after": 10, "coasting": True}
    line = plain_line(neutral_sections=[section])
    start = {"position": 30, "speed": 30}
    rows = driven(line, FORCE, 9.0, start=start)
    position, force = rows[:-1, 0], rows[1:, 2]
    inside = (position[:, 0] >= 75) & (position[:, 1] < 150)  # first car at the board, rear one beyond the other
    assert inside.sum() > 10 and (force[inside] == 0.0).all() and (force[~inside] == FORCE).all()
    alone = driven(plain_line(neutral_sections=[section | {"coasting": False}]), FORCE, 9.0, start=start)
    own = (alone[:-1, 0] >= 75) & (alone[:-1, 0] < 150)
    assert (alone[1:, 2][own] == 0.0).all() and (alone[1:, 2][~own] == FORCE).all()
    ahead = LimitsAhead(TrainModel(railcar(), line, np.ones(2), np.ones(2), 0.4, 0.1)).force(
        position[:, 0].copy(), np.full(len(position), 25.0)
    )[1]
    assert ((ahead == 0.0).all(axis=1) == inside).mean() > 0.99 and ((ahead == 0.0).any(axis=1) == inside).mean() > 0.99
    assert SectionZones(line, load_consist("hxd1_c80_105")).breaks.size == 2, "wagons have no limits of their own"
    assert SectionZones(line, railcar(), [0.0, 0.0]).breaks.tolist() == [75, 150], "a train without length"
    far = {key: value for key, value in section.items() if key not in ("begin", "end")}
    longer = plain_line(
        speed_limits=[{"at": 0, "speed_kmh": 100}], neutral_sections=[far | {"begin": 1000, "end": 1100}]
    )
    found = plan_profile(longer, railcar(), PlanSettings(begin=50, end=2900))
    coasted = (found.front - 10 > 975) & (found.front - 30 < 1110)
    assert np.abs(found.force[coasted]).max() < 1.0 < np.abs(found.force[found.front - 10 < 970]).max()
    (row,) = found.summary()["without_power"]
    times = [np.interp(at, found.front, found.profile.time) for at in (910, 985, 1140)]
    assert [row[key] for key in ("announced_s", "off_s", "on_s")] == pytest.approx(times, abs=0.01)
    assert row["phase"] == "coasting"
    assert build_model(Line, yaml.safe_load(own_yaml(longer)), "again") == longer
    assert [key for key in lost_keys(longer, ("neutral_sections", "speed_limits", "begin")) if "neutral" in key] == [
        f"neutral_sections[].{key}" for key in ("announced_before", "off_before", "on_after", "coasting")
    ]
    with pytest.raises(ValueError, match="announced_before 20 m is behind off_before 25 m; give at least as much"):
        plain_line(neutral_sections=[section | {"announced_before": 20}])


def test_keys_of_neutral_sections_and_power_limits() -> None:
    """Breaks if independent_power or electric_brake have no effect, or a power limit is of a unit or of the brake."""
    section = {"begin": 0, "end": 500}
    diesel = driven(plain_line(neutral_sections=[section]), FORCE, 1.0, railcar(independent_power=True))
    rheostatic = driven(plain_line(neutral_sections=[{**section, "electric_brake": True}]), -FORCE, 1.0)
    assert (diesel[:, 2] == FORCE).all() and (rheostatic[:, 2] == -FORCE).all()
    current = {"begin": 0, "end": 500, "current": 800, "voltage": 1500, "efficiency": POWER / (800 * 1500)}
    for limit in ({"begin": 0, "end": 500, "power_mw": 1}, current):
        rows = driven(plain_line(power_limits=[limit]), FORCE, 5.0)
        power = (rows[1:, 2] * 0.5 * (rows[:-1, 1] + rows[1:, 1])).sum(axis=1)
        step = FORCE / 40e3 * 0.1 / rows[0, 1, 0]  # relative change of the speed within a tick
        assert power == pytest.approx(POWER, rel=step)
        assert (driven(plain_line(power_limits=[limit]), -FORCE, 1.0)[:, 2] == -FORCE).all()


@pytest.mark.parametrize("slope", [0.0, -2e3, 1e3])
def test_a_limited_envelope_is_the_smaller_of_envelope_and_power(slope: float) -> None:
    """Breaks if a limit inside a segment is missed, for rising, constant and falling envelopes."""
    rows = [(20.0, 90e3, slope, 0.0), (60.0, 10e3, 0.0, 1.2e6)]
    limited = limited_segments(rows, POWER)
    for speed in np.linspace(0.2, 60.0, 300):
        row = next(entry for entry in rows if speed <= entry[0])
        own = row[1] + row[2] * speed + row[3] / speed
        found = next(entry for entry in limited if speed <= entry[0])
        assert found[1] + found[2] * speed + found[3] / speed == pytest.approx(min(own, POWER / speed), rel=1e-9)


def test_adhesion_by_place_limits_traction_and_returns() -> None:
    """Breaks if the factor does not act, is not taken back, or a line without adhesion sections gets one."""
    rows = driven(plain_line(adhesion=[{"begin": 100, "end": 300, "factor": 0.4}]), 1e9, 12.0,
                  railcar(traction=[{"to": 60, "force": 1e6}]))  # fmt: skip
    position, force, speed = rows[:-1, 0], rows[1:, 2], 3.6 * rows[1:, 1]
    inside = (position >= 100) & (position < 300)
    coefficient = np.where(inside, 0.4, 1.0) * (0.161 + 7.5 / (speed + 44))
    assert inside.any() and (position > 300).any()
    assert force == pytest.approx(coefficient * 40e3 * 9.81, rel=5e-3)
    assert train(railcar(), plain_line()).setup.adhesion is None


def test_tunnel_air_of_plant_and_plan() -> None:
    """The speed is 1/(1/v0 + C/M t), C of 17 N s²/m² per car in the tunnel; the plan subtracts it from the traction."""
    seconds = 20.0
    for line, coefficient in ((plain_line(tunnels=[TUNNEL]), 17.0), (plain_line(), 5.0)):
        speed = driven(line, 0.0, seconds)[-1, 1, 0]
        assert speed == pytest.approx(1.0 / (1.0 / 20.0 + coefficient / 40e3 * seconds), rel=1e-5)
    plain = driven(plain_line(tunnels=[TUNNEL]), 0.0, seconds, railcar(tunnel_resistance=[]))[-1, 1, 0]
    assert plain == pytest.approx(1.0 / (1.0 / 20.0 + 5.0 / 40e3 * seconds), rel=1e-5)
    weak = railcar(traction=[{"to": 2.5, "force": FORCE}, {"to": 60, "power": 250e3}])
    line = plain_line(speed_limits=[{"at": 0, "speed_kmh": 100}], tunnels=[{**TUNNEL, "end": 3000}])
    found = plan_profile(line, weak, PlanSettings(begin=50, end=2900))
    speed, power = np.array(found.profile.velocity), found.force * np.array(found.profile.velocity)
    balance = ((1 - found.settings.force_margin) * 500e3 / 34) ** (1 / 3)  # traction = 34 v² N
    assert power.max() <= 500e3 * (1 + 1e-6) and 0.95 * balance < speed.max() <= balance


def test_compiled_ticks_have_the_bits_of_single_ticks_at_sections() -> None:
    """Breaks if a compiled call passes the limit of a section."""
    line = plain_line(
        neutral_sections=[{"begin": 700, "end": 760}], adhesion=[{"begin": 1500, "end": 1700, "factor": 0.3}]
    )
    single, batch = (train(railcar(), line, start={"position": 30, "speed": 40}) for _ in range(2))
    commands = np.full((450, single.substeps, 2), 0.2 * FORCE)
    quiet = 0
    for due in commands:
        quiet += single.is_quiet
        single.advance(due)
    advance_trains([batch], [commands])
    assert quiet > 0 and single.position[0] > 1700
    assert single.arrays.state.tobytes() == batch.arrays.state.tobytes()


@pytest.fixture(scope="module")
def plans() -> dict[str, Plan]:
    """Plans of the railcar over 3 km, with one kind of section each."""
    limits = [{"at": 0, "speed_kmh": 100}]
    lines: dict[str, dict[str, Any]] = {
        "plain": {},
        "neutral": {"neutral_sections": [{"begin": 1000, "end": 1100}]},
        "power": {"power_limits": [{"begin": 0, "end": 3000, "power_kw": 600}]},
        "adhesion": {"adhesion": [{"begin": 0, "end": 3000, "factor": 0.2}]},
        "tunnel": {"tunnels": [{**TUNNEL, "end": 3000}]},
        "temporary": {"temporary_restrictions": [{"begin": 1000, "end": 1200, "speed_kmh": 40}]},
    }
    settings = PlanSettings(begin=50, end=2900)
    return {
        name: plan_profile(plain_line(speed_limits=limits, **entries), railcar(), settings)
        for name, entries in lines.items()
    }


def test_a_plan_keeps_every_section(plans: dict[str, Plan]) -> None:
    for name, found in plans.items():
        front, speed, force = np.array(found.profile.position) + 10, np.array(found.profile.velocity), found.force
        if name not in ("plain", "tunnel"):
            assert found.running_time > plans["plain"].running_time
        if name == "neutral":
            both = (front > 1030.0) & (front < 1110.0)  # both centres are in the section
            assert np.abs(force[both]).max() < 1.0
            one = (front > 1010.0) & (front < 1130.0) & ~both
            assert 0.1 * FORCE < np.abs(force[one]).max() <= FORCE * (1 + 1e-6)
        if name == "power":
            assert (force * speed).max() <= 600e3 * (1 + 1e-6)
        if name == "adhesion":
            grip = 0.2 * (0.161 + 7.5 / (3.6 * speed + 44)) * 80e3 * 9.81
            assert (np.abs(force) <= grip * (1 + 1e-6)).all()
        if name == "tunnel":
            cruising = np.abs(found.profile.acceleration) < 1e-6
            assert force[cruising].max() == pytest.approx(34 * speed.max() ** 2, rel=1e-3)
        if name == "temporary":
            inside = (front > 1000) & (front < 1240)
            assert speed[inside].max() <= 40 / 3.6 * (1 + 1e-6)


def test_the_plant_follows_the_plan_through_the_sections(plans: dict[str, Plan]) -> None:
    """The planned force, as feedforward, is reached everywhere; breaks if plant and plan limit differently."""
    for name in ("neutral", "power", "adhesion"):
        found = plans[name]
        profile = found.profile
        made = train(railcar(), found.line, start={"position": float(profile.position[0])}, holding_speed=0.0)
        short = 0.0
        for front, force in zip(found.front.tolist(), found.force[:-1].tolist(), strict=False):
            dead = [name == "neutral" and 1000 <= front - behind < 1100 for behind in (10, 30)]
            parts = [0.0 if off else 1.0 / max(dead.count(False), 1) for off in dead]
            made.advance(np.tile(np.multiply(parts, force), (made.substeps, 1)))
            short = max(short, abs(float(made.applied.sum()) - float(force)) if made.velocity[0] > 1.0 else 0.0)
        at_most = 0.02 * 2 * FORCE  # a tick of another place, and the speed within it, at the limit of a section
        assert short < at_most, name


def test_the_supervisor_has_temporary_restrictions_and_the_lowest_adhesion() -> None:
    """Breaks if protection ignores a restriction, or brakes with an adhesion that the line does not have."""
    limits: dict[str, Any] = {"speed_limits": [{"at": 0, "speed_kmh": 100}]}
    restricted = plain_line(**limits, temporary_restrictions=[{"begin": 1000, "end": 1200, "speed_kmh": 40}])
    assert [(entry.at, round(3.6 * entry.speed)) for entry in restricted.restricted_limits] == [
        (0, 100), (1000, 40), (1200, 100),
    ]  # fmt: skip
    track = line_supervision(railcar(), restricted, PlantSetup(), 3000.0)
    assert [(limits.target.location, round(3.6 * limits.target.speed)) for limits in track.targets[:-1]] == [(1000, 40)]
    brakes = [
        line_supervision(railcar(), plain_line(**limits, **more), PlantSetup(), 3000.0).train.brake.safe
        for more in ({}, {"adhesion": [{"begin": 5000, "end": 5100, "factor": 0.1}]})
    ]
    assert brakes[1].at(20.0) <= 0.1 * (0.161 + 7.5 / (72 + 44)) * 9.81 < brakes[0].at(20.0)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"neutral_sections": [{"begin": 200, "end": 100}]}, "must be beyond begin 200 m"),
        ({"power_limits": [{"begin": 0, "end": 1}]}, "power, or current with voltage and efficiency"),
        ({"power_limits": [{"begin": 0, "end": 1, "current": 800, "voltage": 1500}]}, "power, or current with"),
        ({"adhesion": [{"begin": 0, "end": 1, "factor": 0}]}, "adhesion.0.factor"),
        ({"temporary_restrictions": [{"begin": 0, "end": 1, "speed": 9}]}, "has no speed limit"),
        ({"tunnels": [{"begin": 0, "end": 1}]}, "resistance_n_per_kn or cross_section"),
    ],
)
def test_a_faulty_section_is_refused_in_one_line(entries: dict[str, Any], message: str) -> None:
    """Breaks if a section without an effect, or with two meanings, is accepted."""
    with one_line(f"^line.yaml: .*{message}"):
        build_model(Line, {"schema": "train_ato/line/1", "name": "faulty", "end": 1000, **entries}, "line.yaml")


def test_golden_trains_have_no_sections() -> None:
    """Breaks if a shipped train or line gets effects by place, which would change the numbers of its runs."""
    made = train(load_consist("xuzhou_metro_3"), plain_line(tunnels=[{"begin": 0, "end": 9, "resistance_n_per_kn": 1}]))
    assert not made._sections.exist and made.is_quiet
    assert (
        made.arrays.vehicle[k.C2, 0]
        == made.consist.vehicles[0].resistance.polynomial(made.consist.mass, made.consist.gravity)[2]
    )


def test_compiled_ticks_of_a_run_stop_at_sections() -> None:
    """Breaks if a compiled span of the engine passes a section, or a line with sections has no compiled ticks."""
    line = load_line("xuzhou_metro_test").model_dump(mode="json", by_alias=True, exclude_unset=True)
    line |= {"neutral_sections": [{"begin": 700, "end": 760}]}
    setup = setup_of("xuzhou_metro", {"duration": 70, "law": "pid", "compensation": "none", "plant.line": line})
    assert setup.train()._sections.exist
    both = Both(setup)
    both.assert_equal(least=0.2)
    assert both.part < 1.0


ROUNDED: dict[str, Any] = {
    "schema": "train_ato/line/1", "name": "crest", "end": 3000,
    "grades": [{"at": 0, "grade_permille": 10}, {"at": 1000, "grade_permille": -6}, {"at": 2000, "grade": 0}],
    "vertical_curves": [{"at": 1000, "radius": 20e3}],
}  # fmt: skip


def test_a_vertical_curve_rounds_the_change_of_grade() -> None:
    """Breaks if a crest is a kink: 16 per mille with 20 km are 320 m, 0.64 m below the kink (R change² / 8)."""
    line = Line.model_validate(ROUNDED)
    track, kink = Track(line), Track(line.model_copy(update={"vertical_curves": ()}))
    places = np.array([840.0, 920.0, 1000.0, 1080.0, 1160.0, 2500.0])
    lowered = kink.elevation(places) - track.elevation(places)
    assert lowered == pytest.approx([0.0, 0.16, 0.64, 0.16, 0.0, 0.0], abs=1e-9)  # (x - 840)² / 2R, and mirrored
    inside = (track.breaks > 840) & (track.breaks < 1160)
    slope = 10e-3 - (track.breaks[inside] - 840) / 20e3
    assert np.abs(track.grade[1:][inside] - slope).max() <= 0.125e-3 + 1e-12
    assert dict(grades_permille(line))[2000.0] == 0 and min(g for _, g in grades_permille(line)) == -6
    back = reversed_line(line)
    assert Track(back).elevation(3000 - places) == pytest.approx(
        track.elevation(places) - track.elevation(np.array([3e3]))
    )
    assert build_model(Line, parse_yaml(own_yaml(line)), "again") == line


@pytest.mark.parametrize(("curves", "problem"), [
    ([{"at": 900, "radius": 20e3}], "no grade changes there"),
    ([{"at": 1000, "radius": 130e3}], "reach over the grade at 2000 m|reach beyond the line"),
    ([{"at": 0, "radius": 20e3}], "reach beyond the line or the rounding before"),
    ([{"at": 1000, "radius": 100e3}, {"at": 2000, "radius": 100e3}], "rounding before"),
    ([{"at": 1000, "radius": 10}], "greater than or equal to 100"),
])  # fmt: skip
def test_a_vertical_curve_without_room_is_refused(curves: list[dict[str, Any]], problem: str) -> None:
    """Breaks if two roundings overlap: the height at their end would not be that of the line."""
    with pytest.raises(ValueError, match=problem):
        build_model(Line, {**ROUNDED, "vertical_curves": curves}, "hand")


MIRRORED: dict[str, Any] = {
    "schema": "train_ato/line/1", "name": "one way", "begin": -100, "end": 900,
    "grades": [{"at": 0, "grade": 0.02}, {"at": 300, "grade": -0.01}],
    "curves": [{"begin": 100, "end": 250, "radius": 300, "side": "left"}],
    "tunnels": [{"begin": 150, "end": 600, "resistance_n_per_kn": 0.5}],
    "speed_limits": [{"at": -100, "speed": 20}, {"at": 400, "speed": 15}],
    "stops": [{"at": 0, "name": "A"}, {"at": 850, "name": "B", "dwell": 9}],
    "neutral_sections": [{"begin": 500, "end": 550}], "power_limits": [{"begin": 0, "end": 100, "power": 1e6}],
    "adhesion": [{"begin": 600, "end": 700, "factor": 0.5}],
    "temporary_restrictions": [{"begin": 700, "end": 750, "speed": 10}],
}  # fmt: skip
OTHER_WAY: dict[str, Any] = {
    "schema": "train_ato/line/1", "name": "one way:reverse", "begin": -100, "end": 900,
    "grades": [{"at": -100, "grade": 0.01}, {"at": 500, "grade": -0.02}, {"at": 800, "grade": 0}],
    "curves": [{"begin": 550, "end": 700, "radius": 300, "side": "right"}],
    "tunnels": [{"begin": 200, "end": 650, "resistance_n_per_kn": 0.5}],
    "speed_limits": [{"at": -100, "speed": 15}, {"at": 400, "speed": 20}],
    "stops": [{"at": -50, "name": "B", "dwell": 9}, {"at": 800, "name": "A"}],
    "neutral_sections": [{"begin": 250, "end": 300}], "power_limits": [{"begin": 700, "end": 800, "power": 1e6}],
    "adhesion": [{"begin": 100, "end": 200, "factor": 0.5}],
    "temporary_restrictions": [{"begin": 50, "end": 100, "speed": 10}],
}  # fmt: skip
"""The line above, mirrored by hand: place x is 800 - x."""


def test_a_line_against_its_direction_by_hand() -> None:
    """Breaks if a grade keeps its sign, a step holds on the wrong side, or a train gets no limit at its begin."""
    line, other = (build_model(Line, data, "hand") for data in (MIRRORED, OTHER_WAY))
    assert reversed_line(line) == other
    assert reversed_line(other).model_dump(exclude={"grades"}) == line.model_dump(exclude={"grades"})
    line = build_model(Line, MIRRORED | {"speed_limits": [{"at": 0, "speed": 20}]}, "hand")
    with pytest.raises(ValueError, match="speed_limits: none before 0 m"):
        reversed_line(line)
    with pytest.raises(ValueError, match="the file has one line; remove it"):
        load_line("level:backwards")


def test_a_mirrored_line_run_backwards_gives_the_same_run(tmp_path: Path) -> None:
    """Breaks if any force of the plant does not turn with the line: the runs have equal bits."""
    file = tmp_path / "other.yaml"
    file.write_text(yaml.safe_dump(OTHER_WAY))
    states = []
    for line in (build_model(Line, MIRRORED, "hand"), load_line(f"{file}:reverse")):
        made = train(load_consist("xuzhou_metro_3"), line, start={"position": 20, "speed": 8}, lag=0.4)
        for _ in range(700):
            made.advance(np.full((made.substeps, 1), 6e4))
        assert made.position[0] > 900
        states.append(made.arrays.state.tobytes())
    assert states[0] == states[1]


@pytest.mark.parametrize("name", line_names())
def test_shipped_lines_twice_reversed_are_the_same(name: str) -> None:
    """Breaks if a shipped line loses an entry against its direction."""
    line, again = load_line(name), reversed_line(reversed_line(load_line(name)))
    for one, other in ((line, again), (again, line)):
        assert [(e.at, e.grade) for e in one.grades] == [(pytest.approx(e.at), e.grade) for e in other.grades]
        assert [(e.at, e.speed) for e in one.speed_limits] == [
            (pytest.approx(e.at), e.speed) for e in other.speed_limits
        ]
        assert [(e.begin, e.radius) for e in one.curves] == [(pytest.approx(e.begin), e.radius) for e in other.curves]


def test_a_quarter_circle_by_hand() -> None:
    """Breaks if an arc turns to the wrong side, or the straight after it has another heading."""
    radius = 400.0
    quarter = radius * np.pi / 2
    curve = {"begin": 1000, "end": 1000 + quarter, "radius": radius, "side": "left"}
    places = np.array([-50.0, 0.0, 1000.0, 1000.0 + quarter, 1500.0 + quarter])
    found = Alignment(line_of(5e3, curves=[curve])).at(places)
    np.testing.assert_allclose(found.x, [-50, 0, 1000, 1400, 1400], atol=1e-9)
    np.testing.assert_allclose(found.y, [0, 0, 0, 400, 900], atol=1e-9)
    np.testing.assert_allclose(found.heading, [0, 0, 0, np.pi / 2, np.pi / 2], atol=1e-12)
    assert not found.z.any() and not found.slope.any()


def test_curves_turn_in_turn_and_height_is_the_sum_of_the_grades() -> None:
    """Breaks if all curves turn to one side, the height does not begin at 0, or a grade goes on beyond the line."""
    curves = [{"begin": 500, "end": 900, "radius": 800}, {"begin": 2000, "end": 2400, "radius": 800}]
    found = Alignment(line_of(5e3, curves=curves)).at(np.array([1000.0, 3000.0]))
    assert found.heading == pytest.approx([0.5, 0.0])
    grades = [{"at": 1000, "grade": 0.01}, {"at": 2000, "grade": -0.02}]
    found = Alignment(line_of(5e3, begin=500, grades=grades)).at(np.array([500.0, 1500.0, 2000.0, 3000.0, 6000.0]))
    np.testing.assert_allclose(found.z, [0, 5, 10, -10, -50], atol=1e-9)
    np.testing.assert_allclose(found.slope, np.arctan([0, 0.01, -0.02, -0.02, 0]))


def test_coordinates_give_plan_and_heading() -> None:
    """Breaks if latitude and longitude are exchanged, the plan ignores the coordinates, or takes a single one."""
    north = np.degrees(1000.0 / EARTH_RADIUS)
    found = line_of(
        5e3,
        coordinates=[
            {"at": 0, "latitude": 40.0, "longitude": 113.0},
            {"at": 1000, "latitude": 40.0 + north, "longitude": 113.0},
        ],
    )
    pose = Alignment(found).at(np.array([0.0, 500.0, 2000.0]))
    np.testing.assert_allclose(pose.x, 0.0, atol=1e-6)
    np.testing.assert_allclose(pose.y, [0.0, 500.0, 2000.0], rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(pose.heading, np.pi / 2)
    latitude, longitude = Alignment(found).coordinates(np.array([500.0]))
    assert (latitude[0], longitude[0]) == pytest.approx((40.0 + north / 2, 113.0))
    assert Alignment(line_of(5e3)).coordinates(np.array([0.0])) is None
    with pytest.raises(ValueError, match="coordinates has one entry; give at least two"):
        line_of(5e3, coordinates=[{"at": 0, "latitude": 40, "longitude": 113}])


@given(
    st.lists(st.tuples(st.floats(0, 4000), st.floats(1, 2000), st.floats(200, 5000)), max_size=5),
    st.lists(st.floats(-100, 6000), min_size=2, max_size=20),
)
def test_the_plan_is_as_long_as_the_line_and_has_no_gap(curves, places) -> None:
    """Breaks if pieces do not join: over a small step the plan moves by exactly that step, along the heading."""
    alignment = Alignment(line_of(5e3, curves=[{"begin": b, "end": b + n, "radius": r} for b, n, r in curves]))
    place = np.array(places)
    here, ahead = alignment.at(place), alignment.at(place + 1e-3)
    np.testing.assert_allclose(np.hypot(ahead.x - here.x, ahead.y - here.y), 1e-3, rtol=1e-5)
    np.testing.assert_allclose(np.cos(np.arctan2(ahead.y - here.y, ahead.x - here.x) - here.heading), 1.0, atol=1e-5)


@pytest.mark.parametrize("name", ["daqin_section", "highspeed_286km", "level", "xuzhou_metro_test"])
def test_a_drawn_track_follows_every_shipped_line(name: str) -> None:
    """Breaks if the points of the drawing are too far apart in a curve, or miss an end of the line."""
    found = load_line(name)
    alignment = Alignment(found)
    places = alignment.drawn_places()
    assert (places[0], places[-1]) == (found.begin, found.end)
    heading = alignment.at(places).heading
    assert np.abs(np.diff(heading)).max(initial=0.0) <= MAX_TURN + 1e-9 and len(places) < 3000


POSTS = Path(__file__).parent.parent / "examples" / "metro" / "posts.yaml"
TRAIN = POSTS.with_name("train.yaml")


def test_falling_kilometres_with_a_jump_are_read_and_shown_again() -> None:
    """Breaks if a post beyond the jump is off by its 150 m, or the direction is turned: places by hand."""
    line = load_line(str(POSTS))
    assert [stop.at for stop in line.stops] == [200, 2750, 2800 + 2050]
    assert [grade.at for grade in line.grades] == [0, 1500, 2850, 4250] and line.end == 5000
    assert [line.post_at(x) for x in (0, 2799.5, 2800, 2850, 5000)] == [
        "17+000", "14+200.5", "14+050", "14+000", "11+850",
    ]  # fmt: skip
    assert [line.place_of(text) for text in ("14+200", "14+050", "11+850")] == [2800, 2800, 5000]
    assert build_model(Line, yaml.safe_load(own_yaml(line)), "again") == line
    in_km = POSTS.read_text().replace("begin:", "begin_km:").replace("end:", "end_km:").replace("at:", "at_km:")
    assert build_model(Line, yaml.safe_load(in_km), "a post is no number of kilometres") == line
    assert "- at: 14+000" in own_yaml(line)
    back = load_line(f"{POSTS}:reverse")
    assert [back.post_at(5000 - x) for x in (0, 2799.5, 2850, 5000)] == ["17+000", "14+200.5", "14+000", "11+850"]
    assert load_line("level").post_at(1234.0) == "1.234"
    extent = "km 0.000 ... 5.000, posts 17+000 ... 11+850"
    assert line.with_posts(f"km 2.850, km 9.000, {extent}") == f"km 14+000, km 9.000, {extent}"
    broken = build_model(Line, yaml.safe_load(POSTS.read_text().replace("17+000, end", "17+000.4, end")), "of 2800.4 m")
    assert broken.with_posts("km 2.850") == "km 14+000"


def test_curves_model_and_measured_run_have_the_limits_of_the_category_of_the_train(tmp_path: Path, capsys) -> None:
    """Breaks if one of them has the other limits of the line: 80 km/h for a train with 40, or no note of 54 km/h."""
    (tmp_path / "train.yaml").write_text(TRAIN.read_text() + "categories: [freight]\n")
    limits = "category_limits: [{category: freight, speed_limits: [{at: 17+000, speed_kmh: 40}]}]\n"
    (tmp_path / "line.yaml").write_text(POSTS.read_text() + limits)
    (tmp_path / "s.yaml").write_text(
        "{schema: train_ato/scenario/1, name: s, duration: 9, plant: {consist: train.yaml, line: line.yaml},"
        " model: {line: line.yaml}, profile: {plan: {}}}"
    )
    (found,) = ta.curves(tmp_path / "s.yaml").values()
    assert found["inputs"]["max_speed_kmh"] == pytest.approx(40.0)
    model = setup_of(str(tmp_path / "s.yaml"), {}).model
    assert [limit.speed for limit in model.line.speed_limits] == pytest.approx([40 / 3.6])
    (tmp_path / "a.csv").write_text("time_s,speed_kmh\n0,0\n60,54\n120,54\n180,0\n")
    options = ["--line", str(tmp_path / "line.yaml"), "--from-km", "0.2", "--largest-gap", "60", "--profile-only"]
    assert main(["import", str(tmp_path / "a.csv"), "--train", str(tmp_path / "train.yaml"), *options,
                 "--out", str(tmp_path / "p.csv")]) == 0  # fmt: skip
    assert "permits 40" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "shown"),
    [
        ("curves {scenario} --at-km 14+000", "on posts, end of authority at km 14+000:"),
        ("plan {line} {train} --time 9", "between km 16+800 and km 12+000"),
        ("list {mile} --units us", "from mi 10 to mi 13"),
        ("list {mile} --units us", "40 ... 60 mph"),
        (
            "convert {mile} {line}.railml",
            "two overlap at 18507.5 m, and railML has one at a place; write train_ato YAML",
        ),
        ("list {line}:reverse", "from km 11+850 to km 17+000"),
        ("list xuzhou_metro_test:reverse", "-0.9 m at its end"),
        ("list {table}", "from km 0 to km 1.609344"),
    ],
)
def test_commands_show_places_and_limits_as_the_line_has_them(command, shown, tmp_path, capsys):
    """Breaks if a refusal has distances for posts, or US units are those of rounded kilometres: 40 mph as 39.8."""
    files = {"line": POSTS, "train": TRAIN, "scenario": tmp_path / "s.yaml", "mile": tmp_path / "mile.yaml"}
    files["table"] = tmp_path / "a.csv"
    files["table"].write_text("mi,grade_percent\n0,1\n1,1\n")
    block = f"plant: {{consist: {TRAIN}, line: {POSTS}}}, profile: {{plan: {{}}}}"
    files["scenario"].write_text(f"{{schema: train_ato/scenario/1, name: s, duration: 9, {block}}}")
    limits = "[{at_mi: 10, speed_mph: 40}, {at_mi: 11, speed_mph: 60}]"
    bends = "[{begin_mi: 11, end_mi: 12, radius: 900}, {begin_mi: 11.5, end_mi: 12, radius: 900}]"
    places = f"begin_mi: 10, end_mi: 13, speed_limits: {limits}, curves: {bends}"
    files["mile"].write_text(f"{{schema: train_ato/line/1, name: m, {places}}}")
    main(command.format(**files).split())
    assert shown in "".join(capsys.readouterr())


@pytest.mark.parametrize(("changes", "problem"), [
    ({"grades": [{"at": "14+100", "grade": 0}]}, r"grades\[0\].at: '14\+100': the line has this kilometre nowhere"),
    ({"chainage": [{"begin": "10+000", "end": "12+000"}, {"begin": "11+500", "end": "14+500"}],
      "grades": [{"at": "11+700", "grade": 0}]}, r"this kilometre at 1700 and 2200 m; write the distance"),
    ({"end": 4900}, "its sections have 5000 m, the line 4900 m"),
    ({"chainage": [{"begin": "10+000", "end": "10+000"}]}, r"hand: chainage\.0: a section .* has no length"),
    ({"chainage": 5}, r"hand: chainage = 5: is no list; write"),
    ({"chainage": [None]}, r"hand: chainage\.0 = None: is no block of keys; write"),
    ({"chainage": [{"begin": "10+000"}]}, r"hand: chainage\.0\.end: this key is missing"),
    ({"begin": "17+000"}, r"hand: begin = '17\+000': input should be a number"),
    ({"end": [5]}, r"hand: end = \[5\]: input should be a valid number"),
    ({"stops": [{"at": "16+800", "at_km": "16+900"}]}, r"stops\.0: at and at_km are the same quantity"),
    ({"curves": [{"begin": "15+900", "end": "16+200", "radius": 400}]}, r"curves\.0: end 800 m must be beyond"),
    ({"chainage": []}, "should be a number, not text"),
    ({"stops": [{"at": "12+000"}, {"at": "14+250"}]}, r"stops\[1\]: 2750 m after 4850 m"),
])  # fmt: skip
def test_a_post_without_one_place_is_refused(changes: dict[str, Any], problem: str) -> None:
    """Breaks if a kilometre that exists twice or not at all is given a place in silence."""
    with pytest.raises(ValueError, match=problem):
        build_model(Line, {**yaml.safe_load(POSTS.read_text()), **changes}, "hand")


def test_plan_run_and_displays_show_the_posts(tmp_path: Path) -> None:
    """Breaks if a report has distances where the driver sees posts, or a plan refuses a post as its begin."""
    found = ta.plan(POSTS, TRAIN, begin="16+800", end="14+250")
    assert [stop["post"] for stop in found.summary()["stops"]] == ["16+800", "14+250"]
    with pytest.raises(ValueError, match=r"'14\+100': the line has this kilometre nowhere"):
        ta.plan(POSTS, TRAIN, end="14+100")
    data = {
        "name": "posts", "duration": 175, "plant": {"line": str(POSTS), "consist": str(TRAIN)},
        "profile": {"plan": {"end": 2750}}, "criteria": {"stop_window": 1.0},
    }  # fmt: skip
    run = ta.run(data)
    assert [stop["post"] for stop in run.metrics["stops"]] == ["14+250"]
    assert stop_cells(run.metrics)[0][1] == "14+250" and run.result.stops[0].post == "14+250"
    (row,) = (row for row in run.metrics["criteria"] if row["criterion"] == "stop_window")
    assert row["post"].startswith("14+25") and f"km {row['post']}" in place_text(row)
    assert _place({"at_s": 1.0, "km": 2.75, "post": "14+250"}) == ("1.0", "14+250")
    with pytest.raises(ValueError, match=r"at km 9\.000 .*km 0\.000 \.\.\. 5\.000, posts 17\+000 \.\.\. 11\+850\)"):
        ta.plan(POSTS, TRAIN, end=9000)
    dead = {**yaml.safe_load(POSTS.read_text()), "neutral_sections": [{"begin": "16+000", "end": "15+900"}]}
    (tmp_path / "dead.yaml").write_text(yaml.safe_dump(dead, sort_keys=False))
    (row,) = ta.plan(tmp_path / "dead.yaml", TRAIN, begin="16+800", end="14+250").summary()["without_power"]
    assert row["post"] == "16+000"


def test_a_line_within_a_scenario_names_its_own_fault() -> None:
    """Breaks if a line that is wrong as a whole is called a missing text, because a line may be a name too."""
    line = {
        "schema": "train_ato/line/1", "name": "l", "end": 20e3,
        "grades": [{"at": 0.0, "grade": 0.0}, {"at": 6e3, "grade": 0.004}],
        "vertical_curves": [{"at": 6e3, "radius": 5e6}],
    }  # fmt: skip
    with pytest.raises(ValueError, match=r"plant\.line: vertical_curves\[0\].* lower its radius$"):
        ta.scenario({"name": "x", "duration": 1, "plant": {"line": line, "consist": "xuzhou_metro_3"},
                     "profile": {"plan": {}}})  # fmt: skip
