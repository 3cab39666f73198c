"""Every law with every observer and compensation on the shipped trains: it runs or is rejected with a reason."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from case_costs import sampled
from law_trains import printed

from plant_sim.library import consist_path
from train_ato.cli import main
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS
from train_ato.loop.controller import ControllerStage
from train_ato.loop.engine import run_engine
from train_ato.loop.setup import RunSetup, prepare
from train_ato.profile.profile import Profile
from train_ato.scenario.scenario import load_scenario

PLACES = {
    "demo": (100.0, 6.0, 0.8),
    "daqin_heavy_haul": (700.0, 6.0, 0.7),
    "xuzhou_metro:disturbed": (20.0, 4.0, 0.6),
    "freight_consensus:aligned": (1.0, 0.2, 5.5),
    "freight_consensus:realistic": (60.0, 6.0, 3.5),
    "crh380a_funnel:short": (60.0, 4.0, 0.4),
    "crh380a_gpc:short": (60.0, 6.0, 0.75),
}
"""Scenario, the time in its profile at which the train is put on it, rolling, how long it drives [s], and the largest
speed error [m/s]: the actuators start without a force, and the last cars of paper 002 are pushed about by 3 m/s.
"""
AHEAD = 30.0
"""Part of the profile that is kept beyond the run [s]."""
OWN_EQUIVALENT = ("fixed_time_smc", "funnel", "gpc", "lag_smc", "rbf_smc", "smc")
REFUSED = {(law, compensation) for law in OWN_EQUIVALENT for compensation in ("pade", "twin")}
REFUSED |= {("gpc", "predictor"), ("gpc", "train_predictor")}
REFUSED |= {("mpc", compensation) for compensation in ("pade", "twin", "predictor", "train_predictor")}
HAULED = ("demo", "daqin_heavy_haul")
"""Scenarios with hauled vehicles: there mpc follows the force of `twin`."""


@functools.cache
def rolling(name: str) -> RunSetup:
    """Return a scenario that starts in the middle of its profile, at the position and speed of the profile."""
    at, seconds, _ = PLACES[name]
    setup = prepare(*load_scenario(name))
    first, count = round(at / setup.tick), round(seconds / setup.tick)
    part = slice(first, first + count + round(AHEAD / setup.tick))
    whole = setup.profile
    profile = Profile.uniform(0.0, setup.tick, whole.position[part], whole.velocity[part], whole.acceleration[part])
    start = setup.plant.start.model_copy(
        update={"position": float(profile.position[0]), "speed": float(profile.velocity[0])}
    )
    plant = setup.plant.model_copy(update={"start": start})
    scenario = setup.scenario.model_copy(update={"plant": plant})
    return dataclasses.replace(setup, scenario=scenario, profile=profile, ticks=count)


def combined(name: str, law: str, observer: str, compensation: str) -> RunSetup:
    """Return the run of one combination with printed gains, or raise the error of the command line."""
    base = rolling(name)
    choice = {"law": law, "observer": observer, "compensation": compensation, "laws": {law: printed(law)}}
    setup = dataclasses.replace(base, scenario=base.scenario.model_copy(update=choice))
    setup.law(law)
    return setup


def check_combination(name: str, law: str, observer: str, compensation: str) -> None:
    """Check a rejection if one is expected, otherwise finite forces inside the limits and a bounded speed error."""
    if (law, compensation) in REFUSED and not (name in HAULED and (law, compensation) == ("mpc", "twin")):
        with pytest.raises(ValueError, match=f"^law '{law}' with compensation '{compensation}': .*; set ") as no:
            combined(name, law, observer, compensation)
        assert "\n" not in str(no.value)
        return
    setup = combined(name, law, observer, compensation)
    outcome = run_engine(setup)
    recording = outcome.recording
    assert outcome.failure is None
    assert recording is not None
    assert outcome.summary["held_steps"] == 0
    assert np.isfinite(recording.command).all()
    limits = [setup.model.force_limits(speed) for speed in recording.velocity]
    for command, (low, high) in zip(recording.command, limits, strict=True):
        slack = 0.01 * (high - low)  # the limits are those at the measured speed
        assert ((command >= low - slack) & (command <= high + slack)).all()
    assert np.abs(recording.velocity - recording.reference_velocity[:, None]).max() < PLACES[name][2]


@pytest.mark.parametrize(("law", "name"), sampled(itertools.product(LAWS.names(), PLACES), every=3))
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


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (["--law=smc", "--compensation=twin", "--set=laws.smc.gains=printed"],
         "set laws.smc.equivalent: feedforward, or compensation: none"),
        (["--law=funnel", "--compensation=pade", "--set=laws.funnel.gains=printed"],
         "does not use it; set laws.funnel.feedforward: true"),
        (["--law=gpc", "--compensation=predictor"], "so does this law; set laws.gpc.delay: none, or comp"),
        (["--compensation=twin", "--set=laws.pid.feedforward=false"], "set laws.pid.feedforward: true"),
        (["--law=smc", "--set=plant.sensors.couplers=[]", "--set=laws.smc.gains=printed"],
         "coupler_0, or a unit of 184 t .*fit the sensors .plant."),
        (["--law=fixed_time_smc", "--set=plant.sensors.couplers=[]", "--set=laws.fixed_time_smc.gains=printed"],
         "coupler_0 beside driven .*; drive every"),
        (["--observer=ndo", "--set=observers.ndo.scope=vehicle", "--set=plant.sensors.couplers=[]"], "scope: train"),
        (["--compensation=predictor", "--set=compensations.predictor.train=chain"], "every vehicle driven, here 1"),
        (["--set=law_changes=[{at: 3, law: smc}]", "--compensation=twin", "--set=laws.smc.gains=printed"],
         "'smc' with compensation 'twin'"),
    ],
)  # fmt: skip
def test_refused_before_the_start(
    changes: list[str], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line with the reason, exit status 2, no run folder."""
    out = tmp_path / "run"
    assert main(["run", "demo", "--engine", "--set=duration=5", f"--out={out}", *changes]) == 2
    said = capsys.readouterr().err
    assert re.search(reason, said)
    assert said.count("\n") == 1
    assert not out.exists()


def test_a_train_that_nothing_drives_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A train of wagons only is rejected in one line before the start."""
    consist = yaml.safe_load(consist_path("hxd1_c80_105").read_text(encoding="utf-8"))
    consist["train"] = consist["train"][1:]
    path = tmp_path / "wagons.yaml"
    path.write_text(yaml.safe_dump(consist), encoding="utf-8")
    changes = [f"--set=plant.consist={path}", "--set=plant.sensors.couplers=[]", "--set=duration=5"]
    assert main(["run", "demo", "--engine", f"--out={tmp_path / 'run'}", *changes]) == 2
    assert "law 'pid': no vehicle of the train has traction or brake" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("law", "compensation", "values"),
    [
        ("smc", "twin", {"equivalent": "feedforward"}),
        ("rbf_smc", "pade", {"equivalent": "feedforward"}),
        ("gpc", "predictor", {"delay": "none"}),
        ("rbf_switching_smc", "twin", {}),
    ],
)
def test_the_remedy_is_accepted(law: str, compensation: str, values: dict[str, object]) -> None:
    """Breaks if the remedy of a rejection is rejected too."""
    setup = rolling("demo")
    scenario = setup.scenario.model_copy(update={"compensation": compensation, "laws": {law: values}})
    assert isinstance(dataclasses.replace(setup, scenario=scenario).law(law), LAWS.get(law))


def test_a_swap_during_the_run_is_checked_like_a_start() -> None:
    """The running controller keeps its law; a compatible law is accepted."""
    setup = rolling("demo")
    scenario = setup.scenario.model_copy(update={"compensation": "twin"})
    role = ControllerStage(dataclasses.replace(setup, scenario=scenario))
    with pytest.raises(ValueError, match="law 'lag_smc' with compensation 'twin'"):
        role.validate("controller", "lag_smc")
    with pytest.raises(ValueError, match=r"set laws\.pid\.feedforward: true"):
        role.validate("pid.feedforward", False)
    role.validate("controller", "rbf_switching_smc")


def test_compare_leaves_out_what_does_not_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With `twin` the laws that use its feed-forward run, the others are listed with the reason."""
    arguments = ["compare", "demo", "--compensation=twin", "--set=duration=5", f"--out={tmp_path / 'run'}"]
    assert main(arguments) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "refused: lag_smc: with compensation 'twin': 'twin' gives only a feed-forward, and this law" in said
    assert "refused: pid" not in said
