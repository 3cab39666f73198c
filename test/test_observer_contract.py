"""Checks of an observer: every fault is detected."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest
from faultless_components import Wrapped, failures

from train_ato.apps.check_component import checking, common
from train_ato.apps.check_component.checking import check_component
from train_ato.control.contract import parameter


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
