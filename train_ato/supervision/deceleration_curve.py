"""Deceleration curve through a location and a speed: SUBSET-026, 3.13.8, as arcs of parabola in closed form."""

from dataclasses import dataclass
from math import inf, isnan, nan, sqrt
from typing import Any

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.record import Records, quantity, zeros
from plant_sim.units import KMH
from train_ato.supervision.step_function import StepFunction

MAX_PIECES = 100_000
"""Largest number of arcs, beyond that of any real line."""
TOLERANCE = 1e-9
"""Distance from the end of a curve within which it is evaluated [m/s]."""


@dataclass
class Arc:
    """Arc of a deceleration curve: its end with the lower speed, and the deceleration up to the next end."""

    speed: float = quantity("m/s", "speed at the end of the arc")
    location: float = quantity("m", "location of the end of the arc")
    deceleration: float = quantity("m/s²", "deceleration on the arc")


@compiled
def location_at(arcs: Records[Arc], end_speed: float, speed: float) -> float:
    """Return the location [m] at which a curve has a speed >= 0 [m/s]; NaN above its end speed or below its arcs."""
    if speed > end_speed + TOLERANCE:
        return nan
    low, high = 0, arcs.size
    while low < high:
        middle = (low + high) // 2
        if arcs[middle].speed < speed:
            low = middle + 1
        else:
            high = middle
    arc = arcs[max(low - 1, 0)]
    if speed < arc.speed - TOLERANCE:
        return nan
    return arc.location - (speed * speed - arc.speed * arc.speed) / (2.0 * arc.deceleration)


@compiled
def advanced_speed(arcs: Records[Arc], place: float, time: float, gain: float, shift: float) -> float:
    """Return the speed V [m/s] with location(V + gain) - time V - shift = place, in closed form per arc.

    Parameters
    ----------
    arcs
        The curve.
    place
        Position of the train [m].
    time
        Time at the constant speed V before the curve is reached [s].
    gain, shift
        Rise of the speed [m/s], and distance that does not depend on V [m], before the curve is reached.

    Returns
    -------
    float
        Speed [m/s]; -gain or less beyond the end of the curve.
    """
    wanted = place + shift - time * gain  # location(u) - time u at u = V + gain
    low, high = 0, arcs.size
    while low < high:
        middle = (low + high) // 2
        if arcs[middle].location - time * arcs[middle].speed >= wanted:
            low = middle + 1
        else:
            high = middle
    arc = arcs[max(low - 1, 0)]
    v, a = arc.speed, arc.deceleration
    rest = wanted - arc.location - v * v / (2.0 * a)
    discriminant = a * time * a * time - 2.0 * a * rest
    return sqrt(max(discriminant, 0.0)) - a * time - gain


class DecelerationCurve:
    """Speed over the position of a train that decelerates with brake and gradient: EBD, SBD.

    Parameters
    ----------
    location, speed
        Location [m] and speed [m/s] that the curve crosses.
    brake
        Deceleration of the brake [m/s²] over the speed [m/s].
    gradient
        Deceleration by the gradient [m/s²] over the position [m].
    needed_speed
        Speed that the curve must reach [m/s].
    top_speed
        Speed at which the curve ends, unless a gradient ends it before [m/s].

    Attributes
    ----------
    arcs : Array of :class:`Arc`
        Arcs by rising speed and falling location.
    end_speed : float
        Largest speed of the curve [m/s]; infinite if its last arc has no end.

    Raises
    ------
    ValueError
        If the gradient is at least as strong as the brake before the needed speed is reached. Above it, and beyond the
        crossing, the curve ends there.
    """

    def __init__(
        self,
        location: float,
        speed: float,
        brake: StepFunction,
        gradient: StepFunction,
        *,
        needed_speed: float,
        top_speed: float,
    ) -> None:
        above, self.end_speed = self._backward(location, speed, brake, gradient, needed_speed, max(top_speed, speed))
        below = self._forward(location, speed, brake, gradient)
        rows = [*below, *above]
        self.arcs = zeros(Arc, len(rows))
        for name, values in zip(self.arcs.dtype.names, zip(*rows, strict=True), strict=True):
            self.arcs[name] = values

    @staticmethod
    def _backward(
        d: float, v: float, brake: StepFunction, gradient: StepFunction, needed_speed: float, top_speed: float
    ) -> tuple[list[tuple[float, float, float]], float]:
        """Return speed, location and deceleration of the arcs before the crossing, by rising speed, and their end."""
        arcs: list[tuple[float, float, float]] = []
        while len(arcs) < MAX_PIECES:
            braking, v_end = brake.above(v)
            slope, d_end = gradient.below(d)
            a = braking + slope
            if a <= 0.0 and (v < needed_speed or not arcs):
                raise ValueError(_too_weak(braking, slope, d, v))
            if a <= 0.0 or (arcs and v >= top_speed):
                return arcs, v
            arcs.append((v, d, a))
            v_end = inf if v_end is None else v_end
            d_next = d - (v_end * v_end - v * v) / (2.0 * a)
            if d_end is not None and d_next < d_end:
                v, d = sqrt(v * v + 2.0 * a * (d - d_end)), d_end
            elif v_end == inf:
                return arcs, inf
            else:
                v, d = v_end, d_next
        raise ValueError(f"more than {MAX_PIECES} arcs of a braking curve; simplify the gradients")

    @staticmethod
    def _forward(d: float, v: float, brake: StepFunction, gradient: StepFunction) -> list[tuple[float, float, float]]:
        """Return speed, location and deceleration of the arcs beyond the crossing, by rising speed from 0."""
        arcs: list[tuple[float, float, float]] = []
        while v > 0.0:
            braking, v_end = brake.below(v)
            slope, d_end = gradient.above(d)
            a = braking + slope
            if a <= 0.0:
                break
            v_end = 0.0 if v_end is None else v_end
            d_next = d + (v * v - v_end * v_end) / (2.0 * a)
            if d_end is not None and d_next > d_end:
                v_end, d_next = sqrt(max(v * v - 2.0 * a * (d_end - d), 0.0)), d_end
            arcs.append((v_end, d_next, a))
            v, d = v_end, d_next
        return arcs[::-1]

    def location(self, speed: float) -> float:
        """Return the location [m] at which the curve has a speed >= 0 [m/s].

        Raises
        ------
        ValueError
            If the curve ends above or below that speed.
        """
        found: float = location_at(self.arcs, self.end_speed, speed)
        if isnan(found):
            raise self.refusal(speed)
        return found

    def refusal(self, speed: float) -> ValueError:
        """Return the error for a speed [m/s] that the curve does not have."""
        if speed > self.end_speed:
            return ValueError(
                f"the braking curve ends at {self.end_speed * KMH:.4g} km/h; give lower speeds than "
                f"{speed * KMH:.4g} km/h"
            )
        return ValueError(
            f"the braking curve ends at {self.arcs['speed'][0] * KMH:.4g} km/h, beyond its target the gradient is "
            f"stronger than the brake; give speeds above that, not {speed * KMH:.4g} km/h"
        )

    def speed(self, location: float) -> float:
        """Return the speed [m/s] of the curve at a location [m]; 0 beyond it, the last arc continued before it."""
        arc: Any = self.arcs[max(int(np.count_nonzero(self.arcs["location"] > location)) - 1, 0)]
        v, end, deceleration = arc.tolist()
        return sqrt(max(v * v + 2.0 * deceleration * (end - location), 0.0))


def _too_weak(braking: float, slope: float, location: float, speed: float) -> str:
    return (
        f"the brake ({braking:.4g} m/s² at {speed * KMH:.4g} km/h) is not stronger than the gradient "
        f"({0.0 - slope:.4g} m/s² at {location:.6g} m): no braking curve; give a stronger brake or a smaller gradient"
    )
