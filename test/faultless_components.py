"""Observers and compensations without fault, as a base of faulty ones."""

from __future__ import annotations

from train_ato.control.contract import NoParameters
from train_ato.control.observers.ndo import Ndo


def failures(findings):
    return [finding for finding in findings if finding.passed is False]


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
