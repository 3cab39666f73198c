"""Preparation with parts of former runs: the same run, bit for bit, and new parts for other values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from train_ato.apps.runs.scenario_choice import choose_scenario
from train_ato.loop.engine import run_engine
from train_ato.loop.scenario_data import PartCache, file_state
from train_ato.loop.setup import RunSetup
from train_ato.scenario.scenario import shipped_scenarios

CHANGES = (
    {},
    {"plant.lag": 0.3},
    {"links.command.delay": 0.6},
    {"plant.line": "level"},
    {"plant.consist": "xuzhou_metro_3"},
    {"plant.grade_over_length": True},
    {"profile.limits": {"jerk": 0.5}},
    {"tick": 0.2},
    {"seed": 7},
)


def equal(one: RunSetup, other: RunSetup) -> bool:
    """Return True if two setups have the same scenario, profile and model, bit for bit."""
    arrays = ("time", "position", "velocity", "acceleration")
    same = all(getattr(one.profile, name).tobytes() == getattr(other.profile, name).tobytes() for name in arrays)
    places = np.linspace(one.line.begin, one.line.end, 50)
    forces = [(one.model.line_force(place), other.model.line_force(place)) for place in places.tolist()]
    model = one.model.lag == other.model.lag and np.array_equal(one.model.delay, other.model.delay)
    return same and model and all(a == b for a, b in forces) and one.resolved_yaml() == other.resolved_yaml()


def test_parts_of_former_runs_give_the_same_run() -> None:
    """Breaks if a value that determines a part is not in its key: the part of another run is used."""
    demo, parts = choose_scenario("demo").with_(duration=20), PartCache()
    for change in (*CHANGES, *CHANGES):
        try:
            fresh = demo.with_(change).prepare()
        except ValueError as error:
            with pytest.raises(ValueError) as refused:
                demo.with_(change).prepare(parts=parts)
            assert str(refused.value) == str(error)
        else:
            assert equal(demo.with_(change).prepare(parts=parts), fresh), change


def test_a_run_with_former_parts_has_the_same_metrics() -> None:
    """Breaks if a run changes a part that the next run shares."""
    demo, parts = choose_scenario("demo").with_(duration=30), PartCache()
    skipped = ("wall_s", "real_time_factor", "step_time_us_median", "step_time_us_p99")
    summaries = [run_engine(demo.prepare(parts=parts)).summary for _ in range(2)]
    first, second = ({key: value for key, value in summary.items() if key not in skipped} for summary in summaries)
    assert first == second


def test_equal_values_share_a_part_and_the_oldest_is_dropped() -> None:
    """Breaks if nothing is reused, or the memory of a worker grows with every run."""
    made: list[int] = []
    cache = PartCache(size=2)

    def part(key: int) -> int:
        return cache.get(("part", key), lambda: made.append(key) or key)  # type: ignore[func-returns-value]

    assert [part(key) for key in (1, 2, 1, 3, 1, 2)] == [1, 2, 1, 3, 1, 2]
    assert made == [1, 2, 3, 2]


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    """Breaks if a data file that changes between two runs is not read again."""
    line = choose_scenario("demo").prepare().line.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    file, parts = tmp_path / "line.yaml", PartCache()
    demo = choose_scenario("demo").with_({"plant.line": str(file), "duration": 20})
    file.write_text(yaml.safe_dump(line))
    assert demo.prepare(parts=parts).line.name == line["name"]
    before = file_state(file)
    file.write_text(yaml.safe_dump({**line, "name": "another_line"}))
    assert before != file_state(file)
    assert demo.prepare(parts=parts).line.name == "another_line"
    assert file_state(tmp_path / "missing") is None


@pytest.mark.parametrize("name", ["demo", "xuzhou_metro", "daqin_heavy_haul", "crh380a_gpc"])
def test_the_resolved_scenario_is_the_text_of_yaml(name: str) -> None:
    """Breaks if the text that is joined from blocks is not that of the whole mapping: runs would get other hashes."""
    assert name in shipped_scenarios()
    setup = choose_scenario(name).prepare()
    whole = yaml.safe_dump(setup._resolved_data, sort_keys=False, allow_unicode=True, width=120)
    assert setup.resolved_yaml() == whole
