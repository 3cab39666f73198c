"""Sections of a line: neutral sections, power limits, adhesion, tunnels and temporary restrictions, plant and plan."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from plant_trains import plain_line, train
from span_runs import Both, setup_of

from plant_sim import kernel as k
from plant_sim.batch import advance_trains
from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line
from plant_sim.line import Line
from plant_sim.plant_setup import PlantSetup
from plant_sim.section_effects import limited_segments
from plant_sim.states import Array
from train_ato.profile.planner.planner import Plan, plan_profile
from train_ato.profile.planner.settings import PlanSettings
from train_ato.supervision.plant_line import line_supervision

FORCE, POWER = 100e3, 1e6
TUNNEL = {"begin": 0, "end": 900, "cross_section": 30}


def railcar(**vehicle: Any) -> Consist:
    """Return two cars of 40 t, 20 m and 100 kN each; air resistance 5 v² N, in a tunnel of 30 m² 12 v² N more."""
    car = {
        "mass_t": 40, "length": 20, "resistance": {"n": [0, 0, 5]}, "traction": [{"to": 60, "force": FORCE}],
        "brake": [{"to": 60, "force": FORCE}],
        "tunnel_resistance": [{"cross_section": 20, "coefficient": 16}, {"cross_section": 40, "coefficient": 8}],
    }  # fmt: skip
    return Consist.model_validate(
        {
            "schema": "train_ato/consist/1",
            "name": "railcar",
            "vehicle_types": {"car": {**car, **vehicle}},
            "train": [{"type": "car", "count": 2}],
            "draft_gears": {"rigid": {"kind": "rigid"}},
            "default_gear": "rigid",
        }
    )


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


def test_a_diesel_train_and_a_rheostatic_brake_work_in_a_neutral_section() -> None:
    """Breaks if the keys independent_power and electric_brake have no effect."""
    section = {"begin": 0, "end": 500}
    diesel = driven(plain_line(neutral_sections=[section]), FORCE, 1.0, railcar(independent_power=True))
    rheostatic = driven(plain_line(neutral_sections=[{**section, "electric_brake": True}]), -FORCE, 1.0)
    assert (diesel[:, 2] == FORCE).all() and (rheostatic[:, 2] == -FORCE).all()


def test_the_power_of_a_train_in_a_power_limit_is_that_limit() -> None:
    """Breaks if the limit is that of every unit, acts on the brake, or is not power at the wheels."""
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


def test_tunnel_air_slows_a_coasting_train_by_its_coefficient() -> None:
    """The speed is 1/(1/v0 + C/M t), C of 17 N s²/m² per car in the tunnel; breaks if the coefficient is lost."""
    seconds = 20.0
    for line, coefficient in ((plain_line(tunnels=[TUNNEL]), 17.0), (plain_line(), 5.0)):
        speed = driven(line, 0.0, seconds)[-1, 1, 0]
        assert speed == pytest.approx(1.0 / (1.0 / 20.0 + coefficient / 40e3 * seconds), rel=1e-5)
    plain = driven(plain_line(tunnels=[TUNNEL]), 0.0, seconds, railcar(tunnel_resistance=[]))[-1, 1, 0]
    assert plain == pytest.approx(1.0 / (1.0 / 20.0 + 5.0 / 40e3 * seconds), rel=1e-5)


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
    """Breaks if the planner ignores a kind of section, or plans with it where the line has none."""
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


def test_a_plan_in_a_tunnel_is_within_the_traction() -> None:
    """Breaks if the tunnel air of a train that cannot keep the limit is not subtracted from its traction."""
    weak = railcar(traction=[{"to": 2.5, "force": FORCE}, {"to": 60, "power": 250e3}])
    line = plain_line(speed_limits=[{"at": 0, "speed_kmh": 100}], tunnels=[{**TUNNEL, "end": 3000}])
    found = plan_profile(line, weak, PlanSettings(begin=50, end=2900))
    speed, power = np.array(found.profile.velocity), found.force * np.array(found.profile.velocity)
    balance = ((1 - found.settings.force_margin) * 500e3 / 34) ** (1 / 3)  # traction = 34 v² N
    assert power.max() <= 500e3 * (1 + 1e-6) and 0.95 * balance < speed.max() <= balance


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
    from plant_sim.input_error import build_model

    with pytest.raises(ValueError, match=message) as caught:
        build_model(Line, {"schema": "train_ato/line/1", "name": "faulty", "end": 1000, **entries}, "line.yaml")
    assert "\n" not in str(caught.value) and str(caught.value).startswith("line.yaml: ")


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
