"""Checks of observers and compensations: accepted components and detected faults."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from pathlib import Path

import numpy as np
import pytest

from train_ato.apps.check_component import checking, common
from train_ato.apps.check_component.checking import check_component, findings_table
from train_ato.cli import main
from train_ato.control.compensation.preview import PreviewFeedforward
from train_ato.control.contract import NoParameters, parameter
from train_ato.control.observers.ndo import Ndo
from train_ato.control.registry import COMPENSATIONS, OBSERVERS

EXAMPLES = Path(__file__).parents[1] / "examples"
TEMPLATES = {"observer": "my_observer:MyObserver", "compensation": "my_compensation:MyCompensation"}
SHIPPED = [("observer", OBSERVERS.get(name)) for name in OBSERVERS.names()]
SHIPPED += [("compensation", COMPENSATIONS.get(name)) for name in COMPENSATIONS.names()]


def failures(findings):
    return [finding for finding in findings if finding.passed is False]


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


class Wrapped:
    """Calls ``of``, a component without fault, and counts its steps."""

    Parameters = NoParameters
    of = Ndo

    def __init__(self, parameters, model, period):
        self.inner = self.of(self.of.Parameters(), model, period)
        self.steps = 0

    def reset(self):
        self.inner.reset()
        self.steps = 0

    def step(self, inputs):
        self.steps += 1
        return self.inner.step(inputs)


class Idle(Wrapped):
    """Returns 0 N."""

    def step(self, inputs):
        return super().step(inputs) * 0.0


class Throwing(Wrapped):
    """Raises from its hundredth step on."""

    def step(self, inputs):
        if self.steps >= 100:
            raise ZeroDivisionError("late")
        return super().step(inputs)


class Leaving(Wrapped):
    """Ends the program."""

    def step(self, inputs):
        raise SystemExit(3)


class Unmade(Wrapped):
    """Raises in its constructor, for any train."""

    def __init__(self, parameters, model, period):
        raise TypeError("not made")


class Refusing(Wrapped):
    """Rejects every train."""

    def __init__(self, parameters, model, period):
        raise ValueError("no train")


class Mute(Wrapped):
    """Has no step()."""

    step = None


class Random(Wrapped):
    """Adds a random force."""

    def step(self, inputs):
        return super().step(inputs) + np.random.default_rng().normal()


class Short(Wrapped):
    """Returns the force of the train, not of its units."""

    def step(self, inputs):
        return super().step(inputs).sum()


class Infinite(Wrapped):
    """Returns an infinite estimate for a train at rest."""

    def step(self, inputs):
        estimate = super().step(inputs)
        return estimate / 0.0 if inputs.velocity[0] < 6.0 else estimate


class Leaky(Wrapped):
    """Keeps its state on reset()."""

    def reset(self):
        pass


class Scribbler(Wrapped):
    """Writes into its inputs after 10 s."""

    def step(self, inputs):
        estimate = super().step(inputs)
        if inputs.t > 10.0:
            inputs.applied[0] = 0.0
        return estimate


class Poisoned(Wrapped):
    """Keeps a NaN in its state."""

    total = 0.0

    def step(self, inputs):
        self.total += float(inputs.velocity[0]) * 0.0
        return super().step(inputs) + self.total


class Brittle(Wrapped):
    """Raises when a speed is not finite."""

    def step(self, inputs):
        if not np.isfinite(inputs.velocity).all():
            raise RuntimeError("no speed")
        return super().step(inputs)


class Reversed(Wrapped):
    """Returns the disturbance with the wrong sign."""

    def step(self, inputs):
        return -super().step(inputs)


class Deaf(Wrapped):
    """Returns 0 N after a NaN."""

    dead = False

    def step(self, inputs):
        self.dead = self.dead or bool(np.isnan(inputs.velocity).any())
        return super().step(inputs) * (0.0 if self.dead else 1.0)


@dataclasses.dataclass
class Beyond:
    """Has a default outside its range."""

    gain: float = parameter(3.0, "1", 0.0, 2.0, "gain")

    def reset(self):
        pass

    def step(self, inputs):
        return 0.0 * inputs.velocity


class NoReset:
    """Keyword form without reset()."""

    def step(self, inputs):
        return 0.0 * inputs.velocity


@pytest.mark.parametrize(
    ("observer", "test"),
    [
        (Beyond, "describes its parameters"),
        (NoReset, "describes its parameters"),
        (Unmade, "accepts the train"),
        (Refusing, "accepts at least one train"),
        (Mute, "has the methods and attributes of an observer"),
        (Throwing, "time of a step"),
        (Leaving, "same inputs, same bits"),
        (Random, "same inputs, same bits"),
        (Short, "finite estimate of every unit"),
        (Infinite, "finite estimate of every unit"),
        (Leaky, "reset forgets everything"),
        (Scribbler, "leaves its inputs alone"),
        (Poisoned, "hostile inputs"),
        (Brittle, "hostile inputs"),
        (Reversed, "finds a constant disturbance"),
        (Deaf, "recovers after NaN"),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_faults_of_an_observer_are_found(observer, test, monkeypatch):
    """Breaks if a contract test does not detect its fault."""
    monkeypatch.setattr(checking, "TRAINS", ("freight_five",))
    assert test in {finding.test for finding in failures(check_component("observer", observer))}


def test_an_observer_without_effect_has_a_note(monkeypatch):
    """Breaks if an estimate of 0 fails, or is reported as a disturbance found."""
    monkeypatch.setattr(checking, "TRAINS", ("xuzhou_metro_3",))
    found = check_component("observer", Idle)
    assert not failures(found)
    (note,) = [finding for finding in found if finding.test == "finds a constant disturbance"]
    assert note.passed is None and note.detail.endswith("the disturbance is not found")


def test_a_slow_observer_fails_without_further_tests(monkeypatch):
    """Breaks if an observer slower than the tick passes."""
    monkeypatch.setattr(common, "TIMING_BUDGET", 0.0)
    monkeypatch.setattr(checking, "TRAINS", ("xuzhou_metro_3",))

    class Sleeping(Wrapped):
        def step(self, inputs):
            time.sleep(0.11)
            return super().step(inputs)

    found = check_component("observer", Sleeping)
    assert [finding.test for finding in failures(found)] == ["time of a step"]
    assert "hostile inputs" not in {finding.test for finding in found}


class Layer(Wrapped):
    """Calls a compensation without fault; ``spoil`` changes its output."""

    of = PreviewFeedforward

    def set_profile(self, rigid):
        self.inner.set_profile(rigid)

    def spoil(self, inputs, output):
        return {}

    def step(self, inputs):
        output = super().step(inputs)
        return dataclasses.replace(output, **self.spoil(inputs, output))


class NoProfile(Layer):
    """Has no set_profile()."""

    set_profile = None


class NoMethod(Layer):
    """Has a number in place of an optional method."""

    on_command_sent = 3


class RandomLayer(Layer):
    """Adds a random force to the feed-forward."""

    def spoil(self, inputs, output):
        return {"feedforward": output.feedforward + np.random.default_rng().normal()}


class PassingOn(Layer):
    """Returns its own input."""

    def step(self, inputs):
        return inputs


class Wide(Layer):
    """Changes the limits of the force."""

    def spoil(self, inputs, output):
        return {"force_max": output.force_max * 2.0}


class Early(Layer):
    """Changes the time of the measurement."""

    def spoil(self, inputs, output):
        return {"t": output.t + 0.5}


class Shortsighted(Layer):
    """Omits the preview."""

    def step(self, inputs):
        return super().step(dataclasses.replace(inputs, horizon=0))


class Total(Layer):
    """Gives the feed-forward of the train, not of its units."""

    def spoil(self, inputs, output):
        return {"feedforward": np.array([output.feedforward.sum()])}


class NotANumber(Layer):
    """Gives a feed-forward of NaN for a slow train."""

    def spoil(self, inputs, output):
        return {"feedforward": output.feedforward * (math.nan if inputs.measurement.velocity[0] < 6.0 else 1.0)}


class Counting(Layer):
    """Keeps the number of its steps on reset()."""

    count = 0

    def spoil(self, inputs, output):
        self.count += 1
        return {"feedforward": output.feedforward + self.count}


class KeepingBrakes(PreviewFeedforward):
    """Keeps the brake events on reset()."""

    def reset(self):
        pass


class Overwriting(Layer):
    """Writes into the measurement."""

    def spoil(self, inputs, output):
        inputs.measurement.velocity[0] += 1.0
        return {}


class Fragile(Layer):
    """Raises for an invalid sensor value of a coupler."""

    def spoil(self, inputs, output):
        if not np.isfinite(inputs.measurement.force).all():
            raise RuntimeError("no sensor")
        return {}


class Tabulated(Layer):
    """Reads a table at the measured position."""

    def spoil(self, inputs, output):
        np.zeros(200_000)[int(inputs.measurement.position[0])]
        return {}


class Filtering(Layer):
    """Keeps an invalid reference in a filter."""

    filtered = 0.0

    def spoil(self, inputs, output):
        self.filtered = 0.5 * (self.filtered + inputs.reference.acceleration)
        return {"acceleration_at_effect": self.filtered}


class FixedLead(Layer):
    """Compensates a delay that the model does not have."""

    def spoil(self, inputs, output):
        return {"delay_to_effect": 0.5}


class Displaced(Layer):
    """Shifts the measured position."""

    def spoil(self, inputs, output):
        return {"position": output.position + 0.1}


class Opposite(Layer):
    """Gives the feed-forward with the wrong sign."""

    def spoil(self, inputs, output):
        return {"feedforward": -3.0 * output.feedforward}


@pytest.mark.parametrize(
    ("compensation", "test"),
    [
        (NoProfile, "has the methods and attributes of a compensation"),
        (NoMethod, "has the methods and attributes of a compensation"),
        (RandomLayer, "same inputs, same bits"),
        (PassingOn, "valid input of the law"),
        (Wide, "valid input of the law"),
        (Early, "valid input of the law"),
        (Shortsighted, "valid input of the law"),
        (Total, "valid input of the law"),
        (NotANumber, "valid input of the law"),
        (Counting, "reset forgets everything"),
        (KeepingBrakes, "reset forgets everything"),
        (Overwriting, "leaves its inputs alone"),
        (Fragile, "hostile inputs"),
        (Tabulated, "hostile inputs"),
        (Filtering, "hostile inputs"),
        (FixedLead, "no effect without delay"),
        (Displaced, "no effect without delay"),
        (Opposite, "the law controls the train"),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_faults_of_a_compensation_are_found(compensation, test, monkeypatch):
    """Breaks if a contract test does not detect its fault."""
    monkeypatch.setattr(checking, "TRAINS", ("hxd1_c80_105", "freight_five"))
    assert test in {finding.test for finding in failures(check_component("compensation", compensation))}


@pytest.mark.parametrize("kind", TEMPLATES)
def test_the_commands_end_with_the_status_of_the_checks(kind, monkeypatch, capsys):
    """Breaks if a fault ends with status 0, bad input with 1, or the JSON value is not alone on standard output."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.setattr(checking, "TRAINS", ("xuzhou_metro_3",))
    assert main([f"check-{kind}", TEMPLATES[kind], "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {finding["passed"] for finding in found} == {True, None}
    broken = f"{__name__}:{'Leaky' if kind == 'observer' else 'Counting'}"
    assert main([f"check-{kind}", broken]) == 1
    out, err = capsys.readouterr()
    assert "FAILED  xuzhou_metro_3" in out
    assert err.endswith(f"train-ato: {broken}: failed 1 of {len(found)} tests: reset forgets everything\n")
    assert main([f"check-{kind}", "my_observer:Nothing"]) == 2
    assert "has no class 'Nothing'" in capsys.readouterr().err
