"""Checks of a compensation: every fault is detected."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from faultless_components import Wrapped, failures

from train_ato.apps.check_component import checking
from train_ato.apps.check_component.checking import check_component
from train_ato.control.compensation.preview import PreviewFeedforward


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
    with_air_brake = compensation in (KeepingBrakes, Fragile)
    monkeypatch.setattr(checking, "TRAINS", ("hxd1_c80_105" if with_air_brake else "freight_five",))
    assert test in {finding.test for finding in failures(check_component("compensation", compensation))}
