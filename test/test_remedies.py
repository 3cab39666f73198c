"""Refusals name settings, and every setting they name is accepted."""

from __future__ import annotations

import itertools
import re
from itertools import product
from pathlib import Path

import pytest
from case_costs import sampled

from train_ato.cli import main
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import load_scenario

UNMEASURED = "plant.sensors.couplers=[]"
PLACES: dict[str, tuple[str, ...]] = {
    "demo": (),
    "demo without sensors": (UNMEASURED,),
    "xuzhou_metro": (),
    "freight_consensus:aligned": (),
    "crh380a_gpc:short": (),
}
"""Scenario, and assignments."""
SPECIAL = (
    ("demo", ("observer=ndo", "observers.ndo.scope=vehicle", UNMEASURED)),
    ("demo", ("observer=eso", "observers.eso.scope=vehicle", UNMEASURED)),
    ("demo", ("compensation=predictor", "compensations.predictor.train=chain")),
    ("demo", ("compensation=predictor", "compensations.predictor.delay=estimated", "model.delay=0")),
    ("demo", ("compensation=twin", "laws.pid.feedforward=false")),
    ("demo", ("law=smc", "laws.smc.gains=printed", "compensation=twin", UNMEASURED)),
    ("demo", ("law=fixed_time_smc", "laws.fixed_time_smc.gains=printed", "compensation=twin", UNMEASURED)),
    ("demo", ("compensation=twin", "laws.smc.gains=printed", "law_changes=[{at: 3, law: smc}]")),
    ("xuzhou_metro", ("brake.policy=trigger",)),
    ("daqin_heavy_haul", ("replan={}",)),
    ("daqin_heavy_haul", ("brake.policy=none",)),
)
"""Other refusals of components: scenario, and assignments."""


def refusal(name: str, *assignments: str) -> str:
    """Return the message of a refused scenario, "" for an accepted one."""
    try:
        prepare(*load_scenario(name.partition(" ")[0], (*PLACES.get(name, ()), *assignments)))
    except ValueError as error:
        return str(error)
    return ""


def settings_of(message: str) -> list[list[str]]:
    """Return the settings of a refusal, one list of assignments for each remedy of every problem together."""
    parts = []
    for part in message.split("; also "):
        found: list[tuple[str, ...]] = []
        for key, value, more in re.findall(r"\bset ([\w.]+): ([\w.]+)(?: and remove ([\w.]+))?", part):
            found.append((f"{key}={value}", *([removed(more)] if more else [])))
        found += [(f"{key}={value}",) for key, value in re.findall(r"\(([\w.]+): (\[[\d, ]+\])\)", part)]
        for names in re.findall(r"\bcompensation: ([\w, ]+) \(--compensation", part):
            found += [(f"compensation={name}",) for name in re.split(r", | or ", names)]
        found += [(f"{key}=0.5",) for key in re.findall(r"give ([\w.]+) a value above 0", part)]
        found += [(removed(key),) for key in re.findall(r"(?<!and )\bremove ([\w.]+)", part)]
        parts.append(found)
    return [list(itertools.chain(*choice)) for choice in itertools.product(*parts)]


def removed(key: str) -> str:
    """Return the assignment that removes a key."""
    return f"{key}={'[]' if key == 'brake.events' else 'null'}"


def check_remedies(name: str, assignments: tuple[str, ...], message: str) -> None:
    settings = settings_of(message)
    assert settings, f"no setting in: {message}"
    assert "\n" not in message
    for setting in settings:
        again = refusal(name, *assignments, *setting)
        assert again == "", f"{message}\n{' '.join(setting)}: {again}"


@pytest.mark.parametrize(("law", "name"), sampled(product(LAWS.names(), PLACES), every=3))
def test_every_remedy_of_a_refused_pair_is_accepted(name: str, law: str) -> None:
    """Breaks if a remedy of law and compensation is refused, also by another check."""
    for compensation in COMPENSATIONS.names():
        assignments = (f"law={law}", f"compensation={compensation}")
        if message := refusal(name, *assignments):
            check_remedies(name, assignments, message)


@pytest.mark.parametrize(("name", "assignments"), SPECIAL)
def test_every_remedy_of_another_refusal_is_accepted(name: str, assignments: tuple[str, ...]) -> None:
    """Breaks if a remedy of a parameter is refused, or a refusal has none."""
    message = refusal(name, *assignments)
    assert message, "accepted"
    if "law_changes" in assignments[-1]:  # a change of the law in a list has no key of its own
        assert "set laws.smc.equivalent: feedforward" in message
    check_remedies(name, assignments, message)


@pytest.mark.parametrize(
    ("option", "kind"), [("--law", LAWS), ("--observer", OBSERVERS), ("--compensation", COMPENSATIONS)]
)
def test_an_unknown_component_names_its_option(
    option: str, kind: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if the message names the scenario file, which has no error."""
    wrong = f"{next(iter(kind.names()))}x"  # type: ignore[attr-defined]
    assert main(["run", "demo", "--engine", option, wrong, f"--out={tmp_path / 'run'}"]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"train-ato: {option}: unknown {option[2:]} '{wrong}' (did you mean ")
    assert ".yaml" not in said and said.count("\n") == 1
    if option != "--law":
        assert main(["compare", "demo", option, wrong]) == 2
        assert capsys.readouterr().err.startswith(f"train-ato: {option}: unknown ")


def test_a_refused_pair_names_its_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the message names the scenario file for a choice of the command line."""
    out = f"--out={tmp_path / 'run'}"
    for given, spelled in (("--compensation=twin", "--compensation twin"), ("--set=compensation=twin",) * 2):
        assert main(["run", "demo", "--engine", "--law=lag_smc", given, out]) == 2
        causes, problem, _ = capsys.readouterr().err.partition(": law 'lag_smc' with compensation 'twin': ")
        assert problem
        found = {cause.replace("--set ", "--set=") for cause in causes.removeprefix("train-ato: ").split(", ")}
        assert found == {"--law lag_smc", spelled}
    assert main(["compare", "demo", "--laws=pid,smcc", out]) == 2
    assert capsys.readouterr().err.startswith("train-ato: --laws: unknown law 'smcc' (did you mean 'smc'?)")
