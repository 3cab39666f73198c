"""Line in space: plan, heading, height and slope over the distance, for displays; the physics do not use it.

A line without coordinates is laid out from its curve radii and grades, from its begin towards the east; curves without
a side turn left and right in turn.  With coordinates the plan is their polyline on the local tangent plane.  Axes as in
REP 103: x east, y north, z up, in m from the begin of the line.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plant_sim.line import Coordinate, Curve, Line
from plant_sim.states import Array
from plant_sim.track import Track

EARTH_RADIUS = 6_371_008.8
"""Mean radius of the earth [m] (IUGG)."""
MAX_STEP = 500.0
"""Largest distance between two points of a drawn track [m]."""
MAX_TURN = np.radians(2.0)
"""Largest change of the heading between two points of a drawn track [rad]."""


@dataclass(frozen=True)
class TrackPose:
    """Position and direction of the track at some places, shape (k,) each.

    Attributes
    ----------
    x, y, z : Array
        East, north and up [m].
    heading : Array
        Direction of rising distance, from east towards north [rad].
    slope : Array
        Angle of the grade, > 0 uphill [rad].
    """

    x: Array
    y: Array
    z: Array
    heading: Array
    slope: Array

    @property
    def quaternion(self) -> tuple[Array, Array, Array, Array]:
        """x, y, z and w of the rotation by the heading about z, then by the slope about y (nose up)."""
        yaw, pitch = self.heading / 2, -self.slope / 2
        return (
            -np.sin(yaw) * np.sin(pitch), np.cos(yaw) * np.sin(pitch), np.sin(yaw) * np.cos(pitch),
            np.cos(yaw) * np.cos(pitch),
        )  # fmt: skip

    @property
    def forward(self) -> tuple[Array, Array, Array]:
        """x, y and z of the direction of rising distance, of length 1."""
        level = np.cos(self.slope)
        return np.cos(self.heading) * level, np.sin(self.heading) * level, np.sin(self.slope)


class Alignment:
    """Plan and profile of a line over the distance; straight and level outside it."""

    def __init__(self, line: Line) -> None:
        track = Track(line)
        self._begin, self._end = line.begin, line.end
        self._track = track
        self._coordinates = line.coordinates
        self._plan = _Polyline(line.coordinates) if line.coordinates else _Arcs(line)

    def at(self, place: Array) -> TrackPose:
        """Return position and direction at places along the line [m], shape (k,)."""
        place = np.asarray(place, dtype=np.float64)
        x, y, heading = self._plan.at(place)
        z = self._track.elevation(place) - self._track.elevation(np.array([self._begin]))
        grade = self._track.grade[np.searchsorted(self._track.breaks, place, side="right")]
        return TrackPose(x, y, z, heading, np.arctan(grade))

    def coordinates(self, place: Array) -> tuple[Array, Array] | None:
        """Return latitude and longitude [deg] at places [m], shape (k,) each; None for a line without coordinates."""
        if not self._coordinates:
            return None
        at = [entry.at for entry in self._coordinates]
        latitude = np.interp(place, at, [entry.latitude for entry in self._coordinates])
        return latitude, np.interp(place, at, [entry.longitude for entry in self._coordinates])

    def drawn_places(self) -> Array:
        """Return places for a drawing of the line [m]: every change, and points in between as the heading changes."""
        edges = np.unique(np.concatenate((self._track.breaks, self._plan.breaks, [self._begin, self._end])))
        edges = edges[(edges >= self._begin) & (edges <= self._end)]
        turns = np.abs(self._plan.curvature_at((edges[:-1] + edges[1:]) / 2)) * np.diff(edges)
        counts = 1 + np.ceil(np.maximum(turns / MAX_TURN, np.diff(edges) / MAX_STEP)).astype(int)
        pieces = [np.linspace(a, b, count) for a, b, count in zip(edges, edges[1:], counts, strict=False)]
        return np.unique(np.concatenate(pieces))


class _Arcs:
    """Plan of straights and circular arcs."""

    def __init__(self, line: Line) -> None:
        self.breaks: Array = np.unique([line.begin, line.end, *(p for c in line.curves for p in (c.begin, c.end))])
        middles = np.concatenate(([-np.inf], (self.breaks[1:] + self.breaks[:-1]) / 2, [np.inf]))
        curvature = np.zeros(len(middles))
        for curve, sign in _sides(line.curves):
            curvature[(middles > curve.begin) & (middles < curve.end)] += sign / curve.radius
        self._curvature = curvature
        length = np.diff(self.breaks)
        turn = curvature[1:-1] * length
        self._heading: Array = np.concatenate(([0.0], np.cumsum(turn)))
        x, y = _chord(self._heading[:-1], turn, length)
        self._x: Array = np.concatenate(([0.0], np.cumsum(x)))
        self._y: Array = np.concatenate(([0.0], np.cumsum(y)))
        first = int(np.searchsorted(self.breaks, line.begin))
        self._x, self._y = self._x - self._x[first], self._y - self._y[first]

    def at(self, place: Array) -> tuple[Array, Array, Array]:
        """Return x, y [m] and heading [rad] at some places."""
        begin = np.maximum(np.searchsorted(self.breaks, place, side="right") - 1, 0)
        length = place - self.breaks[begin]
        turn = self.curvature_at(place) * length
        x, y = _chord(self._heading[begin], turn, length)
        return self._x[begin] + x, self._y[begin] + y, self._heading[begin] + turn

    def curvature_at(self, place: Array) -> Array:
        """Return the curvature at some places [1/m], > 0 left."""
        return np.asarray(self._curvature[np.searchsorted(self.breaks, place, side="right")])


class _Polyline:
    """Plan of straight pieces between coordinates, on the tangent plane at the first one (equirectangular)."""

    def __init__(self, coordinates: Sequence[Coordinate]) -> None:
        latitude = np.radians([entry.latitude for entry in coordinates])
        longitude = np.radians([entry.longitude for entry in coordinates])
        self._x = x = EARTH_RADIUS * np.cos(latitude[0]) * (longitude - longitude[0])
        self._y = y = EARTH_RADIUS * (latitude - latitude[0])
        self.breaks = places = np.array([entry.at for entry in coordinates])
        self._directions = np.diff(x) / np.diff(places), np.diff(y) / np.diff(places)

    def at(self, place: Array) -> tuple[Array, Array, Array]:
        """Return x, y [m] and heading [rad] at some places."""
        begin = np.clip(np.searchsorted(self.breaks, place, side="right") - 1, 0, len(self.breaks) - 2)
        length = place - self.breaks[begin]
        east, north = (part[begin] for part in self._directions)
        return self._x[begin] + length * east, self._y[begin] + length * north, np.arctan2(north, east)

    def curvature_at(self, place: Array) -> Array:
        """Return 0: the pieces are straight."""
        return np.zeros_like(place)


def _chord(heading: Array, turn: Array, length: Array) -> tuple[Array, Array]:
    """Return the chord of arcs that begin with a heading and turn by an angle [rad]; exact for straights too."""
    chord = length * np.sinc(turn / (2 * np.pi))
    return chord * np.cos(heading + turn / 2), chord * np.sin(heading + turn / 2)


def _sides(curves: Sequence[Curve]) -> list[tuple[Curve, float]]:
    """Return the curves with the sign of their curvature, 1 for a turn to the left; without a side they alternate."""
    found, sign = [], 1.0
    for curve in sorted(curves, key=lambda curve: curve.begin):
        if curve.side is not None:
            sign = 1.0 if curve.side == "left" else -1.0
        found.append((curve, sign))
        sign = -sign
    return found
