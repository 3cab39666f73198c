"""Plan and profile of lines: closed forms by hand, and the properties of any line."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant_sim.alignment import EARTH_RADIUS, LARGEST_TURN, Alignment
from plant_sim.library import load_line
from plant_sim.line import Line


def line(**parts) -> Line:
    return Line.model_validate({"schema": "train_ato/line/1", "name": "l", "begin": 0, "end": 5000, **parts})


def test_a_quarter_circle_by_hand() -> None:
    """Breaks if an arc turns to the wrong side, or the straight after it has another heading."""
    radius = 400.0
    quarter = radius * np.pi / 2
    found = Alignment(line(curves=[{"begin": 1000, "end": 1000 + quarter, "radius": radius, "side": "left"}])).at(
        np.array([-50.0, 0.0, 1000.0, 1000.0 + quarter, 1500.0 + quarter])
    )
    np.testing.assert_allclose(found.x, [-50, 0, 1000, 1400, 1400], atol=1e-9)
    np.testing.assert_allclose(found.y, [0, 0, 0, 400, 900], atol=1e-9)
    np.testing.assert_allclose(found.heading, [0, 0, 0, np.pi / 2, np.pi / 2], atol=1e-12)
    assert not found.z.any() and not found.slope.any()


def test_curves_without_a_side_turn_in_turn() -> None:
    """Breaks if all curves turn to one side: a long line becomes a spiral."""
    curves = [{"begin": 500, "end": 900, "radius": 800}, {"begin": 2000, "end": 2400, "radius": 800}]
    found = Alignment(line(curves=curves)).at(np.array([1000.0, 3000.0]))
    assert found.heading == pytest.approx([0.5, 0.0])


def test_height_is_the_sum_of_the_grades() -> None:
    """Breaks if the height does not begin at 0, or a grade goes on beyond the line."""
    grades = [{"at": 1000, "grade": 0.01}, {"at": 2000, "grade": -0.02}]
    found = Alignment(line(begin=500, grades=grades)).at(np.array([500.0, 1500.0, 2000.0, 3000.0, 6000.0]))
    np.testing.assert_allclose(found.z, [0, 5, 10, -10, -50], atol=1e-9)
    np.testing.assert_allclose(found.slope, np.arctan([0, 0.01, -0.02, -0.02, 0]))


def test_coordinates_give_plan_and_heading() -> None:
    """Breaks if latitude and longitude are exchanged, or the plan ignores the coordinates."""
    north = np.degrees(1000.0 / EARTH_RADIUS)
    found = line(
        coordinates=[
            {"at": 0, "latitude": 40.0, "longitude": 113.0},
            {"at": 1000, "latitude": 40.0 + north, "longitude": 113.0},
        ]
    )
    pose = Alignment(found).at(np.array([0.0, 500.0, 2000.0]))
    np.testing.assert_allclose(pose.x, 0.0, atol=1e-6)
    np.testing.assert_allclose(pose.y, [0.0, 500.0, 2000.0], rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(pose.heading, np.pi / 2)
    latitude, longitude = Alignment(found).coordinates(np.array([500.0]))
    assert (latitude[0], longitude[0]) == pytest.approx((40.0 + north / 2, 113.0))
    assert Alignment(line()).coordinates(np.array([0.0])) is None


def test_one_coordinate_is_refused() -> None:
    with pytest.raises(ValueError, match="coordinates has one entry; give at least two"):
        line(coordinates=[{"at": 0, "latitude": 40, "longitude": 113}])


@given(
    st.lists(
        st.tuples(st.floats(0, 4000), st.floats(1, 2000), st.floats(200, 5000)),
        max_size=5,
    ),
    st.lists(st.floats(-100, 6000), min_size=2, max_size=20),
)
def test_the_plan_is_as_long_as_the_line_and_has_no_gap(curves, places) -> None:
    """Breaks if pieces do not join: over a small step the plan moves by exactly that step, along the heading."""
    alignment = Alignment(line(curves=[{"begin": b, "end": b + n, "radius": r} for b, n, r in curves]))
    place = np.array(places)
    here, ahead = alignment.at(place), alignment.at(place + 1e-3)
    step = np.hypot(ahead.x - here.x, ahead.y - here.y)
    np.testing.assert_allclose(step, 1e-3, rtol=1e-5)
    np.testing.assert_allclose(np.cos(np.arctan2(ahead.y - here.y, ahead.x - here.x) - here.heading), 1.0, atol=1e-5)


@pytest.mark.parametrize("name", ["daqin_section", "highspeed_286km", "level", "xuzhou_metro_test"])
def test_a_drawn_track_follows_every_shipped_line(name: str) -> None:
    """Breaks if the points of the drawing are too far apart in a curve, or miss an end of the line."""
    found = load_line(name)
    alignment = Alignment(found)
    places = alignment.drawn_places()
    assert (places[0], places[-1]) == (found.begin, found.end)
    heading = alignment.at(places).heading
    assert np.abs(np.diff(heading)).max(initial=0.0) <= LARGEST_TURN + 1e-9
    assert len(places) < 3000
