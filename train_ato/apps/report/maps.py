"""Heat maps: a quantity of every vehicle over time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from train_ato.apps.report.curves import KILO, NEVER_APPLIED, NO_COUPLER, NotAvailable
from train_ato.loop.recording import BRAKE_SHOES, TRUTH, Recording
from train_ato.messages.types import Array


def coupler_map(recording: Recording) -> tuple[Array, Array]:
    """Return time [s] and the force of every coupler [kN], shape (k, vehicles - 1), > 0 draft."""
    found = recording.of(TRUTH, "coupler_force")
    if found is None:
        raise NotAvailable("the log has no train/vehicles")
    if found[1].shape[1] < 2:
        raise NotAvailable(NO_COUPLER)
    return found[0], found[1][:, :-1] / KILO


def shoe_map(recording: Recording) -> tuple[Array, Array]:
    """Return time [s] and the shoe force of every vehicle [kN], shape (k, vehicles)."""
    found = recording.of(BRAKE_SHOES, "shoe_force")
    if found is None:
        raise NotAvailable(recording.without_brake)
    if not np.any(found[1]):
        raise NotAvailable(NEVER_APPLIED)
    return found[0], found[1] / KILO


MAPS: dict[str, Callable[[Recording], tuple[Array, Array]]] = {"couplers": coupler_map, "shoes": shoe_map}
"""Figures of all vehicles over time."""
