"""Own trains and lines with the supervisor: plans below the warning speed, no intervention, refusals, takeovers."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from train_ato.apps.runs.protection_note import protection_note
from train_ato.loop.engine import run_engine
from train_ato.loop.setup import RunSetup, prepare
from train_ato.loop.verdict import verdict_line
from train_ato.scenario.scenario import load_scenario

CAR = {
    "mass_t": 20, "length": 15, "rotating_mass_factor": 1.1, "resistance": {"n_per_kn_kmh": [2.0, 0.02, 0.001]},
    "traction": [{"to_kmh": 30, "force_kn": 26}, {"to_kmh": 110, "power_kw": 216}],
    "brake": [{"to_kmh": 110, "force_kn": 28}],
}  # fmt: skip
GEARS = {
    "draft_gears": {"bar": {"kind": "linear", "stiffness_mn_per_m": 15, "damping_mns_per_m": 0.3}},
    "default_gear": "bar",
}
LINES: dict[str, tuple[list[tuple[float, float]], list[tuple[float, float]], list[float]]] = {
    # grades [m, per mille], speed limits [m, km/h], stops [m]; the train starts at 100 m
    "braking on -50 per mille": (
        [(0, 0), (300, 40), (800, -50), (1400, 10)], [(0, 60), (900, 40), (1300, 70)], [1900],
    ),
    "stop on -40 per mille": ([(0, 0), (300, -40)], [(0, 70)], [1200]),
    "limits and three stops": (
        [(0, 0), (400, -25), (1000, 25), (1500, -25)], [(0, 80), (700, 40), (1100, 60), (1900, 40)], [800, 1500, 2400],
    ),
}  # fmt: skip
"""Lines whose plans without the limits of the supervisor are above its warning speed."""


def write(folder: Path, line: str, cars: int, changes: dict[str, Any] | None = None) -> str:
    """Write train, line and scenario; return the file of the scenario."""
    grades, limits, stops = LINES[line]
    train = {"schema": "train_ato/consist/1", "name": "own", "vehicle_types": {"car": CAR},
             "train": [{"type": "car", "count": cars}], **(GEARS if cars > 1 else {})}  # fmt: skip
    track = {
        "schema": "train_ato/line/1", "name": "own", "end_km": 4,
        "grades": [{"at": at, "grade_permille": grade} for at, grade in grades],
        "speed_limits": [{"at": at, "speed_kmh": speed} for at, speed in limits],
        "stops": [{"at": at, "name": f"{at}", "dwell": 10} for at in stops],
    }  # fmt: skip
    scenario = {
        "schema": "train_ato/scenario/1", "name": "own", "duration": 300, "law": "mpc",
        "plant": {"consist": "train.yaml", "line": "line.yaml", "lag": 0.3}, "links": {"command": {"delay": 0.3}},
        "profile": {"plan": {"begin": 100, "end": stops[-1]}}, **copy.deepcopy(changes or {}),
    }  # fmt: skip
    for name, data in (("train", train), ("line", track), ("own", scenario)):
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(data))
    return str(folder / "own.yaml")


def prepared(file: str, *assignments: str) -> RunSetup:
    return prepare(*load_scenario(file, assignments))


@pytest.mark.parametrize(("line", "cars"), [(line, cars) for line, cars in zip(LINES, (4, 1, 2), strict=True)])
def test_a_plan_is_driven_without_a_takeover(line: str, cars: int, tmp_path: Path) -> None:
    """Breaks if the plan has the service deceleration of the train on a grade where the braking curves have less."""
    summary = run_engine(prepared(write(tmp_path, line, cars))).summary
    assert (summary["brake_interventions"], summary["takeovers"]) == (0, 0)
    assert summary["tracking"] == "tracked"
    assert [row["beyond_m"] for row in summary["stops"]] == pytest.approx([0.0] * len(LINES[line][2]), abs=0.3)


@pytest.mark.parametrize("line", LINES)
def test_the_plan_is_slower_only_where_the_supervisor_limits_it(line: str, tmp_path: Path) -> None:
    """Breaks if the ceiling of a target holds on the whole line, or a plan is above the one without a ceiling."""
    file = write(tmp_path, line, 4)
    limited, free = prepared(file).profile, prepared(file, "supervision.plan_margin=null").profile
    places = np.linspace(float(free.position[0]) + 1.0, float(free.position[-1]) - 1.0, 200)
    lower = np.interp(places, free.position, free.velocity) - np.interp(places, limited.position, limited.velocity)
    assert lower.min() > -0.1
    assert lower.max() > 1.0
    assert np.abs(lower[:15]).max() < 0.1


def test_a_plan_with_enough_distance_is_the_same(tmp_path: Path) -> None:
    """Breaks if a plan below the warning speed is made again: its bits would change."""
    file = write(tmp_path, "braking on -50 per mille", 4, {"profile": {"plan": {"end": 250, "deceleration": 0.3}}})
    limited, free = prepared(file).profile, prepared(file, "supervision.plan_margin=null").profile
    assert np.array_equal(limited.velocity, free.velocity)
    assert np.array_equal(limited.position, free.position)


def test_a_plan_departs_when_the_first_command_acts(tmp_path: Path) -> None:
    """Breaks if a plan without a departure begins before delay .35 s and lag .3 s, in ticks of .1 s: at .7 s.

    A given departure remains, also 0.
    """

    def departure(**plan: float) -> float:
        changes = {"profile": {"plan": {"begin": 100, "end": 1200, **plan}}, "tick": 0.1, "step": 0.01}
        file = write(tmp_path, "stop on -40 per mille", 1, {**changes, "links": {"command": {"delay": 0.35}}})
        profile = prepared(file).profile
        return float(profile.time[np.flatnonzero(profile.velocity > 0.0)[0] - 1])

    assert departure() == pytest.approx(0.7)
    assert departure(departure=0.0) == 0.0
    assert departure(departure=4.0) == pytest.approx(4.0)


def test_a_stop_that_no_plan_reaches_is_refused(tmp_path: Path) -> None:
    """Breaks if a run starts whose stop is beyond the place where the supervisor brakes the train to standstill."""
    file = write(tmp_path, "stop on -40 per mille", 1)
    with pytest.raises(ValueError, match=r"own\.yaml: profile\.plan: no profile .* increase supervision\.overlap") as e:
        prepared(file, "supervision.overlap=0")
    assert "\n" not in str(e.value)


def test_takeovers_are_named_with_time_and_place(tmp_path: Path) -> None:
    """Breaks if the first line or the line on stderr says nothing of a train that the braking law drives."""
    file = write(tmp_path, "braking on -50 per mille", 4)
    summary = run_engine(prepared(file, "supervision.plan_margin=null", "duration=80")).summary
    count, begin = summary["takeovers"], summary["first_takeover_s"]
    assert count > 0
    assert 30.0 < begin < 70.0
    assert f"{count} takeovers of the braking law from {begin:.1f} s on" in verdict_line(summary)
    note = protection_note(summary, "runs/own-1")
    assert f"{count} takeovers by the braking law, the first at {begin:.1f} s (" in note
    assert " km/h at 6" in note  # the place of the front
    assert "train-ato report runs/own-1" in note


@pytest.mark.parametrize(("mass", "traction"), [(1.15, 0.8), (1.0, 0.7)])
def test_a_train_that_catches_up_holds_the_speed_limit_without_chatter(
    mass: float, traction: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Breaks if a speed limit is a deadbeat control through the lag: the command then turns more than 200 times.

    The train is late at the speed limit after a rising grade that its traction cannot climb as planned.
    """
    monkeypatch.setitem(LINES, "late", ([(0, 0), (300, 25), (600, -5)], [(0, 50), (1500, 40)], [2500]))
    wrong = (f"plant.mismatch.mass_scale={mass}", f"plant.mismatch.traction_scale={traction}")
    recording = run_engine(prepared(write(tmp_path, "late", 4), "supervision.enabled=false", *wrong)).recording
    changes = np.diff(np.asarray(recording.command).sum(axis=1))
    large = np.sign(changes[np.abs(changes) > 2e3])  # [N] in a tick
    assert np.count_nonzero(np.diff(large)) < 100  # one in 3 s; a chatter of .6 s has ten times as many
    assert np.abs(recording.velocity[:, 0] - recording.reference_velocity).max() > 1.0  # it was late
    assert recording.velocity.max() < (50 / 3.6 + 0.1) + 0.1  # overshoot
