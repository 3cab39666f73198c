"""Checks of observers and compensations: accepted components and exit status."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from faultless_components import failures

from train_ato.apps.check_component import checking
from train_ato.apps.check_component.checking import check_component, findings_table
from train_ato.cli import main
from train_ato.control.registry import COMPENSATIONS, OBSERVERS

EXAMPLES = Path(__file__).parents[1] / "examples"
TEMPLATES = {"observer": "my_observer:MyObserver", "compensation": "my_compensation:MyCompensation"}
BROKEN = {"observer": "test_observer_contract:Leaky", "compensation": "test_compensation_contract:Counting"}
SHIPPED = [("observer", OBSERVERS.get(name)) for name in OBSERVERS.names()]
SHIPPED += [("compensation", COMPENSATIONS.get(name)) for name in COMPENSATIONS.names()]


@pytest.mark.parametrize(("kind", "component"), SHIPPED, ids=lambda value: getattr(value, "__name__", value))
def test_every_shipped_component_passes(kind, component):
    """Breaks if a shipped observer or compensation violates its contract on a shipped train."""
    found = check_component(kind, component)
    assert not failures(found), findings_table(found)
    assert {finding.test for finding in found} >= set(checking.KINDS[kind].tests)


@pytest.mark.parametrize("kind", TEMPLATES)
def test_the_template_passes(kind, monkeypatch):
    """Breaks if a template fails a contract test, or is longer than a screen."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    found = check_component(kind, TEMPLATES[kind])
    assert not failures(found), findings_table(found)
    source = EXAMPLES / f"{TEMPLATES[kind].partition(':')[0]}.py"
    assert len(source.read_text(encoding="utf-8").splitlines()) <= 60


@pytest.mark.parametrize("kind", TEMPLATES)
def test_the_commands_end_with_the_status_of_the_checks(kind, monkeypatch, capsys):
    """Breaks if a fault ends with status 0, bad input with 1, or the JSON value is not alone on standard output."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.setattr(checking, "TRAINS", ("xuzhou_metro_3",))
    assert main([f"check-{kind}", TEMPLATES[kind], "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {finding["passed"] for finding in found} == {True, None}
    broken = BROKEN[kind]
    assert main([f"check-{kind}", broken]) == 1
    out, err = capsys.readouterr()
    assert "FAILED  xuzhou_metro_3" in out
    assert err.endswith(f"train-ato: {broken}: failed 1 of {len(found)} tests: reset forgets everything\n")
    assert main([f"check-{kind}", "my_observer:Nothing"]) == 2
    assert "has no class 'Nothing'" in capsys.readouterr().err
