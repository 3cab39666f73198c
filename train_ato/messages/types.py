"""What the parts of the stack hand to each other each tick, free of ROS.

Stamps are integer nanoseconds since the start of the run; arrays are float64 over power units, front first, unless
a docstring says otherwise.  Forces are > 0 forward, coupler forces > 0 in draft.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from plant_sim.states import Array, BrakeCylinders, CarStates, Disturbance, Measurement, Pipe

__all__ = [
    "Array",
    "BrakeCylinders",
    "CarStates",
    "Command",
    "Diagnostic",
    "Disturbance",
    "DisturbanceEstimate",
    "Measurement",
    "Pipe",
    "Reference",
    "Tick",
    "Trajectory",
]


@dataclass(frozen=True, slots=True)
class Tick:
    """A simulation stamp alone (topics ``/clock`` and ``record/acknowledged``)."""

    stamp: int


@dataclass(frozen=True, slots=True)
class Reference:
    """Reference of vehicle 0's centre now (topic ``ato/reference``): m, m/s, m/s².

    ``planned`` names the profile it was read from: the stamp at which that was planned [ns], 0 for the first.
    """

    stamp: int
    position: float
    velocity: float
    acceleration: float
    planned: int = 0


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Knots of a whole profile (``ato/profile``) or the steps of the speed limit (``ato/limits``), shape (k,) each.

    ``stamp`` is when the profile was planned, 0 for the first.  ``time`` is in ns since the start of the run; for
    limits it is 0 and ``acceleration`` is empty.
    """

    stamp: int
    name: str
    time: NDArray[np.int64]
    position: Array
    velocity: Array
    acceleration: Array


@dataclass(frozen=True, slots=True)
class DisturbanceEstimate:
    """Disturbance force per power unit [N], > 0 forward (topic ``ato/estimate``)."""

    stamp: int
    force: Array


@dataclass(frozen=True, slots=True)
class Command:
    """Force demand per power unit [N] as sent (topic ``ato/command``)."""

    stamp: int
    force: Array


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """State of one node (topic ``/diagnostics``): level 0 ok, 1 warning, 2 error; values as text."""

    stamp: int
    node: str
    level: int
    message: str
    values: dict[str, str] = field(default_factory=dict)
