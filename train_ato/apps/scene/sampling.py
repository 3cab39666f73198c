"""States of the vehicles at the rate of the scene, from the messages of a log or of a running graph."""

from __future__ import annotations

from train_ato.apps.scene.train_scene import DEFAULT_RATE, SceneMessages, TrainScene
from train_ato.loop.setup import RunSetup
from train_ato.messages.codec.cdr import SECOND, stamp_of
from train_ato.messages.codec.codec import Wire

VEHICLES = "train/vehicles"


def check_rate(rate: float) -> float:
    """Return a rate of the scene.

    Raises
    ------
    ValueError
        If it is not above 0 and at most 1000 per simulated second.
    """
    if not 0 < rate <= 1000:
        raise ValueError(f"rate {rate:g}: is not above 0 and at most 1000; give messages per simulated second")
    return rate


class SceneSampler:
    """Scene for every first state of a period.

    Parameters
    ----------
    setup
        Train and line.
    rate
        Messages per simulated second; states come at most once per tick.
    full_force
        Coupler force with the full colour [N]; None: the largest one so far.
    """

    def __init__(self, setup: RunSetup, rate: float = DEFAULT_RATE, full_force: float | None = None) -> None:
        self.scene = TrainScene(setup, full_force)
        self._wire = Wire(setup.layout)
        self._period = round(SECOND / check_rate(rate))
        self._last = -1

    def take(self, data: bytes) -> SceneMessages:
        """Return the messages for a state of the vehicles; none if its period has some already."""
        number = stamp_of(data) // self._period
        if number == self._last:
            return []
        self._last = number
        return self.scene.at(self._wire.decode(VEHICLES, data))
