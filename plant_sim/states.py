"""What the plant tells each tick: the truth, and what is measured of it.

Stamps are integer nanoseconds since the start of the run.  Forces are > 0 forward, coupler forces > 0 in draft.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CarStates:
    """Truth of every vehicle (topic ``train/cars``).

    Attributes
    ----------
    stamp : int
        Simulation time [ns].
    position, velocity : Array, shape (n,)
        Centre [m] and speed [m/s] of every vehicle.
    coupler_force : Array, shape (n,)
        Force of the coupler behind every vehicle [N]; the last entry is 0.
    """

    stamp: int
    position: Array
    velocity: Array
    coupler_force: Array


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the onboard ATO sees (topic ``train/measurement``): with noise, quantisation, faults.

    Attributes
    ----------
    position, velocity, applied : Array, shape (units,)
        Measured position [m], speed [m/s] and the force that acts now, after delay, lag and limit [N].
    deflection, rate, force : Array, shape (sensors,)
        Coupler deflection [m], rate [m/s] and force [N] where a sensor is fitted (``coupler_i`` behind vehicle i).
    """

    stamp: int
    position: Array
    velocity: Array
    applied: Array
    deflection: Array
    rate: Array
    force: Array


@dataclass(frozen=True, slots=True)
class BrakeCylinders:
    """Air brake of every vehicle (topic ``train/brake_cylinders``): shoe force [N], shape (n,)."""

    stamp: int
    shoe_force: Array


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Outside force on every vehicle, mean over the last tick (topic ``train/disturbance``) [N], shape (n,)."""

    stamp: int
    force: Array


@dataclass(frozen=True, slots=True)
class Pipe:
    """Absolute pressure at the head [Pa]: ``train/brake_pipe`` as it is, ``ato/brake_pipe`` as demanded."""

    stamp: int
    pressure: float
