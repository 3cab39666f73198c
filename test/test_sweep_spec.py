"""Specification, designs and checks of a sweep, without workers; preparation with parts of former runs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from train_ato.api.scenario_choice import choose_scenario
from train_ato.loop.engine import run_engine
from train_ato.scenario.scenario_data import PartCache, file_state
from train_ato.scenario.scenario_files import shipped_scenarios
from train_ato.scenario.setup import RunSetup
from train_ato.studies.sweep.cluster import sweep_client
from train_ato.studies.sweep.result import sweep_table
from train_ato.studies.sweep.robustness_map import CELLS, map_cells, pareto_front
from train_ato.studies.sweep.row import drive_point
from train_ato.studies.sweep.spec import design_points, read_sweep
from train_ato.studies.sweep.sweep import check_values, sweep_base

GOOD: dict[str, Any] = {"scenario": "demo", "over": {"seed": [1, 2]}}
REFUSED = [
    ({"over": {"seed": [1]}}, "scenario: None: is no scenario"),
    (GOOD | {"ovr": 1}, "ovr: unknown key; did you mean 'over'?"),
    (GOOD | {"design": "sobel"}, "design: 'sobel' is unknown; did you mean 'sobol'?"),
    (GOOD | {"runs": 5}, "runs: a grid has its own number of runs"),
    (GOOD | {"design": "random"}, "runs: is missing"),
    (GOOD | {"design": "random", "runs": 0}, "runs: 0: is not an integer of 1"),
    (GOOD | {"design": "sobol", "runs": 100}, "use 64 or 128"),
    (GOOD | {"seed": -1}, "seed: -1"),
    (GOOD | {"set": {"seed": 3}}, "set: seed: varies in over"),
    (GOOD | {"set": [1]}, "set: [1]: not a mapping"),
    ({"scenario": "demo", "over": {"seed": {"from": 1, "to": 1000, "steps": 1000}, "plant.lag":
      {"from": 0.1, "to": 0.2, "steps": 1001}}}, "at most 1000000"),
]  # fmt: skip
BAD_VALUES = [
    ({"seeds": [1, 2]}, {}, "over: seeds: 1: "),
    ({"plant.lag_kmh": [1.0]}, {}, "over: plant.lag_kmh: 1.0"),
    ({"plant.lag": [0.2, -1.0]}, {}, "over: plant.lag: -1.0"),
    ({"plant.lag": {"from": -1.0, "to": 0.5}}, {}, "over: plant.lag: -1.0"),
    ({"law": ["pid", "pdi"]}, {}, "over: law: 'pdi': "),
    ({"observer": ["nod"]}, {}, "over: observer: 'nod': "),
    ({"laws.pid.kpp": [1.0, 2.0]}, {}, "over: laws.pid.kpp: 1.0"),
    ({"seed": [1]}, {"plant.lagg": 0.4}, "set: plant.lagg"),
]


@pytest.mark.parametrize(("data", "text"), REFUSED)
def test_a_wrong_specification_is_refused(data: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError) as error:
        read_sweep(data, "study.yaml")
    assert text in str(error.value) and str(error.value).startswith("study.yaml: ")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("over", "fixed", "text"), BAD_VALUES)
def test_every_value_is_checked_before_the_start(over: dict[str, Any], fixed: dict[str, Any], text: str) -> None:
    """Breaks if an unknown key, a value out of range or an unknown name of a component starts a sweep."""
    spec = read_sweep({"scenario": "demo", "over": over, "set": fixed}, "study.yaml")
    with pytest.raises(ValueError) as error:
        check_values(spec, sweep_base(spec), design_points(spec))
    assert str(error.value).startswith(f"study.yaml: {text}")


@pytest.mark.parametrize("address", ["foo", "tcp://host:port", "foo://host:8786"])
def test_a_wrong_address_is_refused_without_a_client(address: str) -> None:
    """Breaks if Dask gets a wrong address: the end of its client prints a traceback after 20 s."""
    with pytest.raises(ValueError, match=f"--scheduler {address}: .*; write tcp://HOST:PORT"), sweep_client(address, 1):
        pass


def test_a_folder_without_a_sweep_is_named_so(tmp_path: Path) -> None:
    """Breaks if the message denies a folder that exists."""
    with pytest.raises(ValueError, match="is a folder without a sweep"):
        read_sweep(tmp_path)


def test_a_value_is_valid_with_the_others_of_its_point() -> None:
    """Breaks if two keys that are only valid together are refused."""
    over = {"step": [0.005, 0.004], "tick": [0.1]}
    spec = read_sweep({"scenario": "demo", "over": over | {"control_period": [0.1]}, "set": {"duration": 20}})
    check_values(spec, sweep_base(spec), design_points(spec))


def test_a_file_beside_the_specification_comes_first(tmp_path: Path) -> None:
    """Breaks if a scenario file is sought in the current folder only."""
    (tmp_path / "own.yaml").write_text(choose_scenario("demo").with_(duration=20).yaml)
    (tmp_path / "study.yaml").write_text(yaml.safe_dump({"scenario": "own.yaml", "over": {"seed": [1]}}))
    spec = read_sweep(tmp_path / "study.yaml")
    assert (spec.title, sweep_base(spec).choice().checked.duration) == ("own", 20.0)


def test_a_grid_has_every_combination_once() -> None:
    over = {"law": ["pid", "smc"], "plant.lag": {"from": 0.1, "to": 0.3, "steps": 3}}
    points = design_points(read_sweep({"scenario": "demo", "over": over}))
    assert [tuple(point.values()) for point in points] == [
        ("pid", 0.1), ("pid", 0.2), ("pid", 0.3), ("smc", 0.1), ("smc", 0.2), ("smc", 0.3),
    ]  # fmt: skip


@pytest.mark.parametrize("design", ["random", "latin_hypercube", "sobol"])
def test_a_design_is_reproducible_and_inside(design: str) -> None:
    """Breaks if the seed has no effect, a value is outside of its range, or a design does not fill the range."""
    # A Latin hypercube has exactly one of n points in each n-th of the range, a scrambled Sobol sequence of 2^k points
    # as well; 32 uniform numbers all miss some of 4 quarters with a probability of 4 (3/4)^32 = 4e-4, and the seed is
    # fixed.
    over: dict[str, Any] = {"law": ["pid", "smc"], "plant.lag": {"from": 0.01, "to": 1.0, "scale": "log"}, **{
        "links.command.delay": {"from": 0.0, "to": 2.0}, "seed": {"from": 1, "to": 9}}}  # fmt: skip
    data = {"scenario": "demo", "design": design, "runs": 32, "seed": 5, "over": over}
    points = design_points(read_sweep(data))
    assert points == design_points(read_sweep(data)) != design_points(read_sweep(data | {"seed": 6}))
    assert len(points) == 32 and {point["law"] for point in points} == {"pid", "smc"}
    assert all(isinstance(point["seed"], int) and 1 <= point["seed"] <= 9 for point in points)
    delays = np.array([point["links.command.delay"] for point in points]) / 2.0
    lags = np.log(np.array([point["plant.lag"] for point in points]) / 0.01) / np.log(100.0)
    parts = 4 if design == "random" else 32
    for shares in (delays, lags):
        counts = np.bincount(np.minimum((shares * parts).astype(int), parts - 1), minlength=parts)
        assert counts.min() >= 1 and (design == "random" or counts.max() == 1)


def test_a_row_has_the_end_of_its_run() -> None:
    """Breaks if a refused or failed run has no row with its reason, or a row lacks the hash of its scenario."""
    demo, parts = choose_scenario("demo").with_(duration=20), PartCache()
    done = drive_point(demo, 1, {"law": "smc", "seed": 3}, parts)
    assert (done["status"], done["reason"], done["law"], done["seed"]) == ("done", "", "smc", 3)
    assert done["metrics"]["ticks"] == 200 and len(done["sha256"]) == 64 and "wall_s" not in done["metrics"]
    assert drive_point(demo, 2, {"law": "smc", "seed": 3}, parts)["metrics"] == done["metrics"]
    assert drive_point(demo, 2, {"law": "smc", "seed": 4}, parts)["sha256"] != done["sha256"]
    refused = drive_point(demo, 3, {"plant.line": "nowhere"}, parts)
    assert refused["status"] == "refused" and "nowhere" in refused["reason"] and "sha256" not in refused
    table = sweep_table([done, refused], ["law"])
    assert table["status"].tolist() == ["done", "refused"] and np.isnan(table["speed_rmse_kmh"][1])


def test_columns_of_mixed_values_are_json() -> None:
    """Breaks if a key with values of several types cannot be written as a column."""
    row = {"run": 1, "status": "done", "reason": ""}
    rows = [{**row, "point": {"a": [1]}}, {**row, "run": 2, "point": {"a": "x"}}]
    assert sweep_table(rows, ["a"])["a"].tolist() == ["[1]", '"x"']


def test_the_pareto_front_is_the_set_without_a_better_run() -> None:
    """Breaks if a beaten run is on the front or an unbeaten one is not; compared with all pairs."""
    first, second = np.random.default_rng(4).integers(0, 12, (2, 60)).astype(float)
    front = pareto_front(first, second)
    values = set(zip(first.tolist(), second.tolist(), strict=True))
    beaten = {(a, b) for a, b in values for c, d in values if c <= a and d <= b and (c, d) != (a, b)}
    assert set(zip(first[front].tolist(), second[front].tolist(), strict=True)) == values - beaten
    assert len(front) == len(values - beaten) and (np.diff(first[front]) > 0).all()


def test_a_place_of_the_map_is_stable_if_all_its_runs_are() -> None:
    """Breaks if a good run hides a bad one at the same place, or a cell has not the value of the nearest run."""
    first, second = np.array([0.25, 0.25, 0.75]), np.array([0.5, 0.5, 0.5])
    cells = map_cells(first, second, np.array([1.0, 0.0, 1.0]), np.array([1.0, -3.0, 2.0]))
    assert cells.stable.tolist() == [0.0, 1.0] and cells.value.tolist() == [3.0, 2.0]
    assert (cells.nearest[:, : CELLS // 2] == 0).all() and (cells.nearest[:, CELLS // 2 :] == 1).all()


@pytest.mark.parametrize(("name", "runs"), [("sweep", 200), ("map", 64 * 64)])
def test_an_example_is_a_valid_specification(name: str, runs: int) -> None:
    """Breaks if a key or a value of an example is refused, or the map is not the one of its measured time."""
    spec = read_sweep(Path(__file__).parent.parent / "examples" / f"{name}.yaml")
    points = design_points(spec)
    check_values(spec, sweep_base(spec), points)
    assert len(points) == runs


CHANGES = (
    {}, {"plant.lag": 0.3}, {"links.command.delay": 0.6}, {"plant.line": "level"}, {"plant.consist": "xuzhou_metro_3"},
    {"plant.grade_over_length": True}, {"profile.limits": {"jerk": 0.5}}, {"tick": 0.2}, {"seed": 7},
)  # fmt: skip


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
