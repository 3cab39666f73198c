"""What keeps every law's output finite and inside the limits, whatever it is fed.

A measurement that is not finite, or beyond anything a train can do, is not used: the last demand is held and the law
goes on with the next sound one.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from operator import le
from typing import TYPE_CHECKING, Any

import numpy as np

from train_ato.control.contract import LawInput, LawOutput
from train_ato.control.parts.shares import mean_over_units
from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.model import TrainModel

FARTHEST = 1e8
"""Position beyond which a measurement is not believed [m]."""
FASTEST = 1e3
"""Speed or coupler rate beyond which a measurement is not believed [m/s]."""
STRONGEST = 1e10
"""Force beyond which a measurement is not believed [N]."""


def within(values: Array, bound: float) -> bool:
    """Tell whether every entry is finite and at most ``bound`` in magnitude (a NaN is not)."""
    return all(-bound <= value <= bound for value in values.tolist())


def sound(inputs: LawInput) -> bool:
    """Tell whether every number a law may use is finite and physically possible.

    The magnitudes of one kind are summed and the sum compared: a NaN or an infinity among them cannot pass.
    """
    low, high = inputs.force_min.tolist(), inputs.force_max.tolist()
    places = [*inputs.position.tolist(), *inputs.reference_position.tolist()]
    speeds = [
        *inputs.velocity.tolist(), *inputs.reference_velocity.tolist(), *inputs.reference_acceleration.tolist(),
        inputs.acting_acceleration, inputs.acting_jerk,
    ]  # fmt: skip
    forces = [
        *low, *high, *inputs.feedforward.tolist(), *inputs.disturbance.tolist(), *inputs.applied.tolist(),
        *inputs.coupler_force.tolist(), *inputs.shoe_force.tolist(), inputs.train_shoe_force,
    ]  # fmt: skip
    return (
        sum(map(abs, speeds)) <= FASTEST * len(low)
        and sum(map(abs, places)) <= FARTHEST
        and sum(map(abs, forces)) <= STRONGEST
        and all(map(le, low, high))
        and abs(inputs.t) <= FARTHEST
    )


def unusable(inputs: LawInput) -> list[str]:
    """Name the inputs because of which :func:`sound` says no."""
    bounds = {"t": FARTHEST, "position": FARTHEST, "reference_position": FARTHEST}
    bounds |= dict.fromkeys(
        ("velocity", "reference_velocity", "reference_acceleration", "acting_acceleration", "acting_jerk"), FASTEST
    )
    bounds |= dict.fromkeys(
        ("feedforward", "disturbance", "applied", "coupler_force", "shoe_force", "train_shoe_force"), STRONGEST
    )
    found = [name for name, bound in bounds.items() if not within(np.atleast_1d(getattr(inputs, name)), bound)]
    limits = bounded(inputs.force_min.tolist(), inputs.force_max.tolist())
    return found or ["their sum" if limits else "force_min, force_max"]


def bounded(low: Sequence[float], high: Sequence[float]) -> bool:
    """Tell whether the limits themselves can be used."""
    return all(-STRONGEST <= a <= b <= STRONGEST for a, b in zip(low, high, strict=True))


class GuardedLaw:
    """Base of the laws here: ``demand()`` gives the force wanted, this class the one that may be sent.

    Attributes
    ----------
    cut : list of bool
        Units whose last demand was beyond a limit; integrators and weights hold while it lasts.
    horizon : int
        Entries of the preview the law wants.
    leaves_feedforward, predicts_delay : str
        Words for a refusal, see :class:`train_ato.control.contract.Law`.
    share : list of float
        Part of a total force that every unit takes.
    """

    horizon = 0
    leaves_feedforward = ""
    predicts_delay = ""

    def __init__(self, parameters: Any, model: TrainModel, period: float) -> None:
        self.parameters = parameters
        self.model = model
        self.period = period
        self.n = model.n_units
        self.share: list[float] = model.share.tolist()
        self.cut = [False] * self.n
        self._held = [0.0] * self.n

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force wanted of every unit [N]; the inputs are sound."""
        raise TypeError(f"{type(self).__name__} has no demand()")

    def forget(self) -> None:
        """Forget what was learnt and stored."""

    def mean(self, values: list[float]) -> float:
        """Return the mean over the units by their shares; of one unit its own value."""
        return values[0] if self.n == 1 else mean_over_units(self.share, values)

    def missed(self) -> None:
        """Take note that one measurement was not usable: difference quotients must not bridge it."""

    def reset(self) -> None:
        """Forget everything, the last demand included."""
        self.forget()
        self.cut = [False] * self.n
        self._held = [0.0] * self.n

    def step(self, inputs: LawInput) -> LawOutput:
        """Return the force demand of every unit, finite and inside the limits."""
        if not sound(inputs):
            self.missed()
            return self._hold(inputs, f"unusable inputs: {', '.join(unusable(inputs))}")
        wanted = self.demand(inputs)
        if not all(map(isfinite, wanted)):
            self.forget()
            return self._hold(inputs, f"its result was {str(wanted)[:60]} N")
        held, cut = self._held, self.cut
        low, high = inputs.force_min.tolist(), inputs.force_max.tolist()
        for unit, force in enumerate(wanted):
            within_limits = low[unit] if force < low[unit] else high[unit] if force > high[unit] else force
            cut[unit] = within_limits != force
            held[unit] = within_limits
        return LawOutput(np.array(held))

    def _hold(self, inputs: LawInput, reason: str) -> LawOutput:
        """Return the last demand, inside the limits if those can be used."""
        low, high = inputs.force_min.tolist(), inputs.force_max.tolist()
        if bounded(low, high):
            within_limits = [min(max(u, a), b) for u, a, b in zip(self._held, low, high, strict=True)]
            return LawOutput(np.array(within_limits), held=reason)
        return LawOutput(np.array(self._held), held=reason)
