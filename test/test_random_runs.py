"""Random runs, and combinations of laws, observers and compensations."""

import dataclasses
import functools
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from case_costs import sampled
from engine_runs import setup_of
from law_trains import printed
from refusals import one_line

from msgs_docs.generate.random_runs import SCENARIOS, SPREAD, Draw, Figures, draws, drive_draw, summary, with_law
from plant_sim.library import consist_path
from train_ato.cli import main
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS
from train_ato.loop.controller import ControllerStage
from train_ato.loop.engine import run_engine
from train_ato.profile.profile import Profile
from train_ato.scenario.setup import RunSetup


def test_equal_seeds_give_equal_runs_over_all_laws_and_scenarios():
    """Breaks if a run of the page cannot be repeated, or a law, a scenario or the runs without fault are left out."""
    chosen = list(draws(400, 7))
    assert chosen == list(draws(400, 7))
    assert chosen[:5] != list(draws(5, 8))
    assert {draw.law for draw in chosen} == set(LAWS.names())
    assert {draw.base for draw in chosen} == set(SCENARIOS)
    assert "" in {draw.fault for draw in chosen}


def test_a_new_law_changes_only_the_runs_that_it_takes(monkeypatch):
    """Breaks if a draw depends on the number of laws: one more law then changes the law of nearly all runs."""
    before, names = list(draws(400, 7)), LAWS.names()
    monkeypatch.setattr(LAWS, "names", lambda: [*names, "new"])
    after = list(draws(400, 7))
    assert [replace(draw, law="new", sets=with_law(draw, "new").sets) for draw in after] == [
        with_law(draw, "new") for draw in before
    ]
    changed = {new.law for old, new in zip(before, after, strict=True) if old != new}
    assert changed == {"new"}
    assert abs(sum(draw.law == "new" for draw in after) - 400 / (1 + len(names))) < 4 * (400 / len(names)) ** 0.5


def test_no_fault_replaces_the_spread():
    """Breaks if a draw sets a key of the spread twice, so that the train is weaker than the stated bound."""
    for draw in draws(200, 9):
        for key in (*SPREAD, "plant.adhesion"):
            assert sum(text.startswith(f"{key}=") for text in draw.sets) <= 1


@pytest.mark.parametrize(
    "draw", sampled(draws(10, 2), every=3), ids=lambda draw: f"{draw.base}, {draw.law}, {draw.fault}"
)
def test_a_random_run_stays_before_the_supervised_location(draw):
    """Breaks if a fault, a law or the spread of the train takes it beyond the supervised location."""
    run = drive_draw(draw)
    assert run.margin > 0.0, draw.command
    assert run.excess < 0.0, draw.command


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(6))
def test_many_random_runs_stay_before_the_supervised_location(seed):
    """As above, with draws that are not on the page."""
    for draw in draws(10, 1000 + seed):
        test_a_random_run_stays_before_the_supervised_location(draw)


def test_the_verdict_fails_without_supervision():
    """Breaks if the figures of a run cannot show a train beyond the supervised location."""
    name, *sets = SCENARIOS["metro"][1:3]
    frozen = "plant.sensors.freeze=[{begin: 10, end: 9999}]"
    draw = Draw(0, "metro", "pid", "frozen", name, (*sets[0], frozen, "duration=300"))
    assert drive_draw(draw).margin > 0.0
    bare = replace(draw, sets=(*draw.sets, "supervision.enabled=false"))
    assert drive_draw(bare).margin < 0.0


def test_a_run_is_driven_on_until_its_train_is_at_standstill():
    """Breaks if a margin is that of a train on its way, or a train in motion at the last end is not reported."""
    name, sets = SCENARIOS["metro"][1:3]
    whole = drive_draw(Draw(0, "metro", "pid", "", name, sets))
    early = drive_draw(Draw(0, "metro", "pid", "", name, (*sets, "duration=50")))
    assert not early.moving
    assert early.margin == whole.margin
    assert drive_draw(Draw(0, "metro", "pid", "", name, (*sets, "duration=5"))).moving


def test_the_summary_counts_and_names_bad_runs():
    """Breaks if a run beyond the supervised location is missing in the figures of the page."""
    chosen = list(draws(3, 3))
    good = Figures(margin=100.0, short=0.0, excess=-1.0, moving=False, interventions=0, failure="")
    found = summary(chosen, [good, replace(good, margin=-0.5), replace(good, excess=0.2, moving=True)])
    assert found["beyond"] == 1
    assert [row["number"] for row in found["bad"]] == [1, 2]
    assert sum(group["moving_at_end"] for group in found["scenarios"].values()) == 1


PLACES = {
    "demo": (100.0, 6.0, 0.8), "daqin_heavy_haul": (700.0, 6.0, 0.7), "xuzhou_metro:disturbed": (20.0, 4.0, 0.6),
    "freight_consensus:aligned": (1.0, 0.2, 5.5), "freight_consensus:realistic": (60.0, 6.0, 3.5),
    "crh380a_funnel:short": (60.0, 4.0, 0.4), "crh380a_gpc:short": (60.0, 6.0, 0.75),
}  # fmt: skip
"""Scenario, the time in its profile at which the train is put on it, rolling, how long it drives [s], and the largest
speed error [m/s]: the actuators start without a force, and the last cars of paper 002 are pushed about by 3 m/s.
"""
REFUSED = dict.fromkeys(("fixed_time_smc", "funnel", "lag_smc", "rbf_smc", "smc"), ("pade", "twin"))
REFUSED |= dict.fromkeys(("gpc", "mpc"), ("pade", "twin", "predictor", "train_predictor"))
"""Compensations that a law refuses; with hauled vehicles mpc follows the force of `twin`."""


@functools.cache
def rolling(name: str) -> RunSetup:
    """Return a scenario that starts in the middle of its profile, at the position and speed of the profile."""
    at, seconds, _ = PLACES[name]
    setup = setup_of(name)
    first, count = round(at / setup.tick), round(seconds / setup.tick)
    part = slice(first, first + count + round(30.0 / setup.tick))  # the profile goes on for 30 s beyond the run
    whole = setup.profile
    profile = Profile.uniform(0.0, setup.tick, whole.position[part], whole.velocity[part], whole.acceleration[part])
    start = setup.scenario.plant.start.model_copy(
        update={"position": float(profile.position[0]), "speed": float(profile.velocity[0])}
    )
    plant = setup.scenario.plant.model_copy(update={"start": start})
    scenario = setup.scenario.model_copy(update={"plant": plant})
    return dataclasses.replace(setup, scenario=scenario, profile=profile, ticks=count)


def combined_of_combinations(name: str, law: str, observer: str, compensation: str) -> RunSetup:
    """Return the run of one combination with printed gains, or raise the error of the command line."""
    base = rolling(name)
    choice = {"law": law, "observer": observer, "compensation": compensation, "laws": {law: printed(law)}}
    setup = dataclasses.replace(base, scenario=base.scenario.model_copy(update=choice))
    setup.law(law)
    return setup


def check_combination(name: str, law: str, observer: str, compensation: str) -> None:
    """Check a rejection if one is expected, otherwise finite forces inside the limits and a bounded speed error."""
    hauled = name in ("demo", "daqin_heavy_haul") and (law, compensation) == ("mpc", "twin")
    if compensation in REFUSED.get(law, ()) and not hauled:
        with one_line(f"^law '{law}' with compensation '{compensation}': .*; set "):
            combined_of_combinations(name, law, observer, compensation)
        return
    setup = combined_of_combinations(name, law, observer, compensation)
    outcome = run_engine(setup)
    recording = outcome.recording
    assert outcome.failure is None and outcome.summary["held_steps"] == 0
    assert np.isfinite(recording.command).all()
    limits = [setup.model.force_limits(speed) for speed in recording.velocity]
    for command, (low, high) in zip(recording.command, limits, strict=True):
        slack = 0.01 * (high - low)  # the limits are those at the measured speed
        assert ((command >= low - slack) & (command <= high + slack)).all()
    assert np.abs(recording.velocity - recording.reference_velocity[:, None]).max() < PLACES[name][2]


@pytest.mark.parametrize(("law", "name"), sampled(itertools.product(LAWS.names(), PLACES), every=5))
def test_every_law_with_every_compensation(law: str, name: str) -> None:
    """With alternating observers; breaks on a failure, invalid forces or an unexpected rejection."""
    observers = OBSERVERS.names()
    shift = LAWS.names().index(law)
    for index, compensation in enumerate(COMPENSATIONS.names()):
        check_combination(name, law, observers[(index + shift) % len(observers)], compensation)


@pytest.mark.campaign
@pytest.mark.parametrize("name", PLACES)
@pytest.mark.parametrize("law", LAWS.names())
def test_every_combination(name: str, law: str) -> None:
    """The same with all observers."""
    for compensation in COMPENSATIONS.names():
        for observer in OBSERVERS.names():
            check_combination(name, law, observer, compensation)


def test_a_train_that_nothing_drives_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A train of wagons only is rejected in one line before the start."""
    consist = yaml.safe_load(consist_path("hxd1_c80_105").read_text(encoding="utf-8"))
    consist["train"] = consist["train"][1:]
    path = tmp_path / "wagons.yaml"
    path.write_text(yaml.safe_dump(consist), encoding="utf-8")
    changes = [f"--set=plant.consist={path}", "--set=plant.sensors.couplers=[]", "--set=duration=5"]
    assert main(["run", "demo", "--engine", f"--out={tmp_path / 'run'}", *changes]) == 2
    assert "law 'pid': no vehicle of the train has traction or brake" in capsys.readouterr().err


def test_a_swap_during_the_run_is_checked_like_a_start() -> None:
    """The running controller keeps its law; a compatible law is accepted."""
    setup = rolling("demo")
    scenario = setup.scenario.model_copy(update={"compensation": "twin"})
    role = ControllerStage(dataclasses.replace(setup, scenario=scenario))
    with pytest.raises(ValueError, match="law 'lag_smc' with compensation 'twin'"):
        role.validate({"controller": "lag_smc"})
    with pytest.raises(ValueError, match=r"set laws\.pid\.feedforward: true"):
        role.validate({"pid.feedforward": False})
    with pytest.raises(ValueError, match="unknown law ''"):  # `ros2 param set` takes it; the next step made this law
        role.validate({"controller": ""})
    role.validate({"controller": "rbf_switching_smc"})


def test_compare_leaves_out_what_does_not_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With `twin` the laws that use its feed-forward run, the others are listed with the reason."""
    arguments = ["compare", "demo", "--compensation=twin", "--set=duration=5", f"--out={tmp_path / 'run'}"]
    assert main(arguments) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "refused: lag_smc: with compensation 'twin': 'twin' gives only a feed-forward, and this law" in said
    assert "refused: pid" not in said
