"""Draft gears on a test bench: curves by hand, loops, and conservation of energy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from draft_gear_bench import force_along
from hypothesis import given
from hypothesis import strategies as st
from plant_trains import GEARS, QKX, RIGID, heavy, train
from pydantic import TypeAdapter

from plant_sim.gears import DraftGear
from plant_sim.states import Array

SLOW, FAST = 1e-3, 1e-6
"""Steps [s] that make a path slow enough for no damping and no switching, or fast."""
CLIP = GEARS["printed clip"]
_GEAR: TypeAdapter[Any] = TypeAdapter(DraftGear)


def gear(data: dict[str, Any], **changes: Any) -> Any:
    return _GEAR.validate_python({**data, **changes})


def path(*turns: float, step: float = 2e-5) -> Array:
    """Return deflections from 0 through the turning points in steps of at most `step`."""
    parts = [np.zeros(1)]
    for a, b in zip((0.0, *turns), turns, strict=False):
        parts.append(np.linspace(a, b, 2 + int(abs(b - a) / step))[1:])
    return np.concatenate(parts)


def work(force: Array, deflection: Array) -> Array:
    """Return the work done on the gear up to each entry [J]."""
    return np.concatenate(([0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(deflection))))


@pytest.mark.parametrize(
    ("data", "stroke", "at_stroke", "ratio"),
    [(CLIP, 0.166, 2270e3, 0.25), (QKX, 0.156, 2000e3, 0.40)],
    ids=["MT-2", "QKX100"],
)
def test_curves_of_the_spec(data: dict[str, Any], stroke: float, at_stroke: float, ratio: float) -> None:
    """Loading reaches fl(D) at the stroke, unloading is r fl, the stop adds 200 MN/m, buff mirrors draft."""
    # Without damping. Loading at d = 20 mm by hand for MT-2: 60 kN 20/22 + 2.5 MN/m 20 mm + a2 d² = 130.6 kN.
    loading = force_along(gear(data, damping=0.0), path(0.005 + stroke), FAST)
    assert loading[-1] == pytest.approx(at_stroke, rel=1e-6)
    beyond = force_along(gear(data, damping=0.0), path(0.005 + stroke + 0.002), FAST)
    assert beyond[-1] == pytest.approx(at_stroke + 400e3, rel=1e-6)
    if data is CLIP:
        a2 = (2270e3 - 60e3 * 0.166 / 0.168 - 2.5e6 * 0.166) / 0.166**2
        by_hand = 60e3 * 20 / 22 + 2.5e6 * 0.02 + a2 * 0.02**2
        assert by_hand == pytest.approx(130.6e3, rel=1e-3)
        assert force_along(gear(data, damping=0.0), path(0.025), FAST)[-1] == pytest.approx(by_hand, rel=1e-6)
    loop = path(0.1, 0.05)
    back = force_along(gear(data, damping=0.0), loop, FAST)
    up = back[np.searchsorted(loop[: np.argmax(loop)], 0.05)]
    assert back[-1] == pytest.approx(ratio * up, rel=2e-3)
    np.testing.assert_allclose(force_along(gear(data), -loop, FAST), -force_along(gear(data), loop, FAST))


@pytest.mark.parametrize("name", ["slack", "clip", "printed clip", "smoothed", "table"])
def test_no_force_in_the_slack(name: str) -> None:
    """Between -5 mm and +5 mm a coupling with 10 mm of slack has no force, after any history."""
    deflection = path(0.08, -0.06, 0.03, 0.0)
    force = force_along(gear(GEARS[name]), deflection, SLOW)
    inside = np.abs(deflection) < 0.005
    assert inside.any()
    assert not force[inside].any()
    assert (force * deflection)[~inside].min() >= -1e3 * 0.08


def test_transition_between_branches() -> None:
    """Eqs. (7)-(9): after a turn the force falls by k = 60 MN/m times the path down to the unloading branch."""
    deflection = path(0.08, 0.079)
    force = force_along(gear(CLIP, damping=0.0), deflection, SLOW)
    top = int(np.argmax(deflection))
    assert force[top] - force[-1] == pytest.approx(60e6 * 1e-3, rel=1e-6)


def test_smoothed_law_has_no_jump() -> None:
    """The printed eq. (6) (factor sgn(dv)) jumps by twice the mean at dv = 0; this form passes the mean."""
    deflection = np.full(5, 0.05)
    slow = force_along(gear(QKX, damping=0.0), np.concatenate((path(0.05), deflection)), FAST)
    top, rest = slow[len(slow) - 6], slow[-1]
    assert rest == pytest.approx(top * (1 + 0.4) / 2, rel=1e-3)


def test_table_equals_its_source_curve() -> None:
    """A table of the MT-2 curve gives the MT-2 loop within the error of its linear pieces."""
    d = np.linspace(0.0, 0.166, 333)
    loading = force_along(gear(CLIP, damping=0.0, slack=0.0), d, SLOW)
    table = {
        "kind": "table",
        "deflection": d.tolist(),
        "loading": loading.tolist(),
        "unloading": (0.25 * loading).tolist(),
        "slack_mm": 10,
    }
    turns = path(0.09, 0.04, 0.12, -0.07, 0.02)
    difference = force_along(gear(table), turns, SLOW) - force_along(gear(CLIP, damping=0.0), turns, SLOW)
    assert np.abs(difference).max() < 2.5e3


def test_draft_and_buff_have_their_own_tables() -> None:
    """Breaks if one table, its stroke or its hysteresis is used on both sides: 100 and 400 kN at 20 mm, by hand."""
    buff = {"deflection": [0, 0.08], "loading": [50e3, 1450e3], "unloading": [0, 700e3]}
    draft = {"deflection": [0, 0.1], "loading": [0, 500e3], "unloading": [0, 200e3], "slack": 0.01, "buff": buff}
    made = gear({"kind": "table", **draft})
    turns = path(0.025, -0.025, -0.087, 0.0, 0.107)
    force = dict(zip(np.round(turns, 6).tolist(), force_along(made, turns, SLOW).tolist(), strict=True))
    assert force_along(made, path(0.025), SLOW)[-1] == pytest.approx(100e3)  # 20 mm of 5 MN/m
    assert force_along(made, path(0.025, -0.025), SLOW)[-1] == pytest.approx(-(50e3 + 350e3))  # 17.5 MN/m
    assert force[-0.087] == pytest.approx(-(1450e3 + 2e-3 * 200e6))  # 82 mm: 2 mm beyond the stroke of buff
    assert force[0.107] == pytest.approx(500e3 + 2e-3 * 200e6)
    back = force_along(made, path(-0.085, -0.045), SLOW)[-1]
    assert back == pytest.approx(-350e3)  # unloading at 40 of 80 mm
    with pytest.raises(ValueError, match="below the largest slope"):
        gear({"kind": "table", **draft}, transition_stiffness=10e6)


def test_table_beyond_its_end_adds_the_stop() -> None:
    """Beyond the last deflection the stop of 200 MN/m adds to the last loading force."""
    force = force_along(gear(GEARS["table"], damping=0.0), path(0.005 + 0.166 + 0.001), SLOW)
    assert force[-1] == pytest.approx(2270e3 + 200e3, rel=1e-6)


def test_transition_damping_stays_between_the_branches() -> None:
    """At any rate the damping acts between the branches only: a fast turn ends at the lower branch."""
    turn = path(0.08, 0.0799)
    damped = gear({**CLIP, "transition_damping": 5e6}, damping=0.0)
    slow, fast = (force_along(damped, turn, step) for step in (1.0, 1e-6))
    top = int(np.argmax(turn))
    assert fast[: top + 1] == pytest.approx(slow[: top + 1])
    assert slow[-1] == pytest.approx(slow[top] - 60e6 * 1e-4, rel=1e-3)
    assert fast[-1] == pytest.approx(0.25 * slow[top], rel=1e-2)


@pytest.mark.parametrize("name", ["clip", "printed clip", "smoothed", "table"])
def test_a_loop_dissipates(name: str) -> None:
    """A loop to 80 mm and back dissipates more than half of the work (r = 0.25 and 0.20), in draft and buff."""
    deflection = path(0.08, 0.0, -0.08, 0.0)
    done = work(force_along(gear(GEARS[name], damping=0.0), deflection, 1e-4), deflection)
    half = len(deflection) // 2
    assert done[half] > 0.6 * done[: half + 1].max()
    assert done[-1] == pytest.approx(2.0 * done[half], rel=1e-2)


@given(
    turns=st.lists(st.floats(-0.17, 0.17), min_size=1, max_size=8),
    name=st.sampled_from(["linear", "slack", "clip", "printed clip", "smoothed", "table"]),
    step=st.sampled_from([1e-5, 1e-3]),
)
def test_a_gear_never_creates_energy(turns: list[float], name: str, step: float) -> None:
    """From rest, no path returns more energy than its input, at any time."""
    deflection = path(*turns, 0.0)
    done = work(force_along(gear(GEARS[name]), deflection, step), deflection)
    assert done.min() >= -1e-3 * done.max() - 1.0


def test_rigid_gear_has_no_path() -> None:
    """The loop of a rigid coupling is rejected."""
    with pytest.raises(ValueError, match="rigid"):
        force_along(gear(RIGID), path(0.01), SLOW)


def test_curve_that_falls_is_refused() -> None:
    """A force at the stroke that is too small for the stiffness is rejected with a remedy."""
    with pytest.raises(ValueError, match="raise it or lower stiffness"):
        train(heavy({**CLIP, "force_at_stroke": 200e3}, 2))


TABLE = {"kind": "table", "deflection": [0, 0.02, 0.06], "loading": [0, 4e5, 2e6], "unloading": [0, 1e5, 6e5]}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"unloading": [5e4, 1e5, 6e5], "loading": [8e4, 4e5, 2e6]}, "a relaxed gear has no force"),
        ({"loading": [0, 7e5, 6.5e5]}, "loading must rise"),
        ({"unloading": [0, 3e5, 2e5]}, "unloading must rise"),
        ({"transition_stiffness": 1e7}, "below the largest slope 40000000 N/m"),
    ],
)
def test_curves_that_no_gear_has_are_refused(changes: dict[str, Any], says: str) -> None:
    """Breaks if a table with a force at rest, or with a slope above the transition stiffness, is accepted."""
    assert gear(TABLE)
    with pytest.raises(ValueError, match=says):
        gear(TABLE, **changes)
