"""Panels of the layouts: one table for all viewers, reduced to the signals of a log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from plant_sim.units import KMH
from train_ato.apps.layout.signals import LogSignals, Signal
from train_ato.messages.layout import FIXED_NAMES, Owner

BLUE, ORANGE, GREEN, PURPLE, SKY, RED, BLACK, GREY = (
    "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#222222", "#7f8790",
)  # fmt: skip
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED, BLACK, GREY)
"""Colours of several parts of a train, distinct for colour-blind readers (Okabe and Ito)."""
MOST_CURVES = 5
"""Vehicles, and power units, in one panel."""
KILO = 1e-3


@dataclass(frozen=True)
class LayoutCurve:
    """Curve of a panel: signal, label and colour."""

    signal: Signal
    label: str
    color: str


@dataclass(frozen=True)
class LayoutPanel:
    """Panel with curves of one unit.

    Attributes
    ----------
    key, title : str
        Name in the layout, and text above the panel.
    unit, si_unit : str
        Unit after the multiplication with ``factor``, and that of the messages.
    steps : bool
        Values that hold until the next one.
    along : bool
        Values of all vehicles at one time, in place of values over time.
    """

    key: str
    title: str
    unit: str
    si_unit: str
    factor: float
    curves: tuple[LayoutCurve, ...]
    steps: bool = False
    along: bool = False


def panels_of(log: LogSignals) -> dict[str, LayoutPanel]:
    """Return the panels with at least one curve, by key."""
    made = (
        LayoutPanel("speed", "speed, profile and limits of the supervisor", "km/h", "m/s", KMH, _curves(_speeds(log))),
        LayoutPanel("force", "force of the power units", "kN", "N", KILO, _curves(_forces(log))),
        LayoutPanel("coupler", "coupler forces (draft > 0)", "kN", "N", KILO, _curves(_couplers(log))),
        LayoutPanel("pipe", "brake pipe", "kPa", "Pa", KILO, _curves(_pressures(log))),
        LayoutPanel("ato", "state of the ATO, 3 engaged", "", "", 1.0, _curves(_ato(log)), steps=True),
        LayoutPanel("protection", "traction cut-off and brakes", "", "", 1.0, _curves(_brakes(log)), steps=True),
        LayoutPanel(
            "along", "coupler forces along the train (draft > 0)", "kN", "N", KILO,
            _curves(_all(log, "train/vehicles", "coupler behind the vehicle", RED)), along=True,
        ),
        LayoutPanel(
            "shoes", "shoe forces along the train", "kN", "N", KILO,
            _curves(_all(log, "train/brake_shoes", "shoes", "#8c510a")), along=True,
        ),
    )  # fmt: skip
    return {panel.key: panel for panel in made if panel.curves}


Wanted = Iterator[tuple[Signal | None, str, str]]
"""Signal or None, label, colour."""


def _curves(wanted: Wanted) -> tuple[LayoutCurve, ...]:
    return tuple(LayoutCurve(signal, label, color) for signal, label, color in wanted if signal is not None)


def spread(count: int, most: int = MOST_CURVES) -> list[int]:
    """Return at most ``most`` numbers below ``count``, from the first to the last one in equal distances."""
    if count <= most:
        return list(range(count))
    return [round(place * (count - 1) / (most - 1)) for place in range(most)]


def _speeds(log: LogSignals) -> Wanted:
    names = FIXED_NAMES[Owner.SUPERVISED_SPEED][1:]
    for name, color in zip(names, (GREEN, ORANGE, PURPLE, BLACK), strict=True):
        yield log.joint("atp/speeds", name, "velocity"), name.replace("_", " "), color
    yield log.field("ato/reference", "points[0].velocities[0]"), "profile", GREY
    truth = log.joint("train/vehicles", "vehicle_0", "velocity")
    yield truth or log.joint("train/measurement", "unit_0", "velocity"), "train", BLUE


def _forces(log: LogSignals) -> Wanted:
    count = log.count("train/measurement", "unit")
    for number, unit in enumerate(spread(count)):
        name, which = f"unit_{unit}", f" {unit}" if count > 1 else ""
        color = CYCLE[number]
        yield log.joint("ato/command", name, "effort"), f"command{which}", ORANGE if count == 1 else color
        yield log.joint("train/measurement", name, "effort"), f"applied{which}", color
        if count == 1:
            yield log.joint("ato/estimate", name, "effort"), "disturbance estimate", GREEN


def _couplers(log: LogSignals) -> Wanted:
    couplers = log.count("train/vehicles", "vehicle") - 1
    for number, vehicle in enumerate(spread(couplers)):
        signal = log.joint("train/vehicles", f"vehicle_{vehicle}", "effort")
        yield signal, f"behind vehicle {vehicle}", CYCLE[number]


def _pressures(log: LogSignals) -> Wanted:
    yield log.field("ato/brake_pipe_command", "fluid_pressure"), "command", ORANGE
    yield log.field("train/brake_pipe", "fluid_pressure"), "head", BLUE
    yield log.field("train/brake_pipe_tail", "fluid_pressure"), "tail", SKY


def _ato(log: LogSignals) -> Wanted:
    yield log.joint("ato/state", FIXED_NAMES[Owner.ATO][0], "effort"), "state of the ATO", BLUE


def _brakes(log: LogSignals) -> Wanted:
    for name, color in zip(FIXED_NAMES[Owner.BRAKE_LINE], (ORANGE, PURPLE, BLACK), strict=True):
        yield log.joint("train/protection", name, "position"), name.replace("_", " "), color


def _all(log: LogSignals, topic: str, label: str, color: str) -> Wanted:
    more_than_one = log.count(topic, "vehicle") > 1
    yield log.field(topic, "effort") if more_than_one else None, label, color
