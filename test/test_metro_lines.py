"""Gains of the metro train on lines on which they were not chosen alone: mirrored, and moved by 350 m."""

from __future__ import annotations

import pytest
from metro_lines import LINE, SECTION, changed_line, metrics_on_lines

from plant_sim.library import load_line
from plant_sim.line import Line

HALF_WARNING = 2.0
"""Half of dV_warning_min of SUBSET-026, A.3.1, the reason of the criterion of the speed error [km/h]."""


def grade_at(line: Line, place: float) -> float:
    return next(entry.grade for entry in reversed(line.grades) if entry.at <= place)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("move", [350.0, -350.0, 0.0])
def test_a_changed_line_has_the_grades_of_the_shipped_one_at_other_places(mirrored: bool, move: float) -> None:
    """Breaks if a mirrored grade keeps its sign, or a line is moved in the wrong direction."""
    shipped, changed = load_line(LINE), Line.model_validate(changed_line(mirrored, move))
    for place in (1000.0, 2222.0, 3600.0, 4300.0, 5900.0, 7200.0):
        there = place - move
        wanted = -grade_at(shipped, SECTION - there - 1e-6) if mirrored else grade_at(shipped, there)
        assert grade_at(changed, place) == pytest.approx(wanted), place
    assert len(changed.curves) == len(shipped.curves)


@pytest.mark.campaign
def test_the_metro_keeps_speed_and_stop_on_every_line() -> None:
    """Breaks if the gains are chosen on one line: a long integral hurries after a shortage of traction, 3.3 km/h."""
    found = dict(metrics_on_lines("step=0.005"))
    assert len(found) == 6
    for name, metrics in found.items():
        assert metrics["tracking"] == "tracked", name
        assert metrics["overspeed_max_kmh"] < HALF_WARNING, name
        assert abs(metrics["stop_error_m"]) <= 0.3, name
        assert metrics["takeovers"] == 0, name
