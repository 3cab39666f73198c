"""Lines against their direction of running."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from plant_trains import train

from plant_sim.input_error import build_model
from plant_sim.library import line_names, load_consist, load_line
from plant_sim.line import Line
from plant_sim.line_direction import reversed_line

MIRRORED: dict[str, Any] = {
    "schema": "train_ato/line/1",
    "name": "one way",
    "begin": -100,
    "end": 900,
    "grades": [{"at": 0, "grade": 0.02}, {"at": 300, "grade": -0.01}],
    "curves": [{"begin": 100, "end": 250, "radius": 300, "side": "left"}],
    "tunnels": [{"begin": 150, "end": 600, "resistance_n_per_kn": 0.5}],
    "speed_limits": [{"at": -100, "speed": 20}, {"at": 400, "speed": 15}],
    "stops": [{"at": 0, "name": "A"}, {"at": 850, "name": "B", "dwell": 9}],
    "neutral_sections": [{"begin": 500, "end": 550}],
    "power_limits": [{"begin": 0, "end": 100, "power": 1e6}],
    "adhesion": [{"begin": 600, "end": 700, "factor": 0.5}],
    "temporary_restrictions": [{"begin": 700, "end": 750, "speed": 10}],
}
OTHER_WAY: dict[str, Any] = {
    "schema": "train_ato/line/1",
    "name": "one way:reverse",
    "begin": -100,
    "end": 900,
    "grades": [{"at": -100, "grade": 0.01}, {"at": 500, "grade": -0.02}, {"at": 800, "grade": 0}],
    "curves": [{"begin": 550, "end": 700, "radius": 300, "side": "right"}],
    "tunnels": [{"begin": 200, "end": 650, "resistance_n_per_kn": 0.5}],
    "speed_limits": [{"at": -100, "speed": 15}, {"at": 400, "speed": 20}],
    "stops": [{"at": -50, "name": "B", "dwell": 9}, {"at": 800, "name": "A"}],
    "neutral_sections": [{"begin": 250, "end": 300}],
    "power_limits": [{"begin": 700, "end": 800, "power": 1e6}],
    "adhesion": [{"begin": 100, "end": 200, "factor": 0.5}],
    "temporary_restrictions": [{"begin": 50, "end": 100, "speed": 10}],
}
"""The line above, mirrored by hand: place x is 800 - x."""


def test_a_line_against_its_direction_by_hand() -> None:
    """Breaks if a grade keeps its sign, a step holds on the wrong side, or a section is not mirrored."""
    line, other = (build_model(Line, data, "hand") for data in (MIRRORED, OTHER_WAY))
    assert reversed_line(line) == other
    assert reversed_line(other).model_dump(exclude={"grades"}) == line.model_dump(exclude={"grades"})


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


def test_a_line_without_a_limit_at_its_begin_is_not_reversed() -> None:
    """Breaks if a train in the other direction gets no limit where the line has none."""
    line = build_model(Line, MIRRORED | {"speed_limits": [{"at": 0, "speed": 20}]}, "hand")
    with pytest.raises(ValueError, match="speed_limits: none before 0 m"):
        reversed_line(line)
    with pytest.raises(ValueError, match="the file has one line; remove it"):
        load_line("level:backwards")
