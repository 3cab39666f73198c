"""Figure of a plan over the distance: limits and profile, force within its envelopes, grade."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.track import Track
from plant_sim.units import unit_symbols
from train_ato.messages.types import Array
from train_ato.profile.planner.line_tables import LineForce, SpeedLimits
from train_ato.profile.planner.planner import Plan
from train_ato.profile.trip.plan import TripPlan
from train_ato.program.display_units import display_unit, shown_text
from train_ato.report.print_figures import SHEET_SIZE, styled, write_figure
from train_ato.report.quantities import GREY, INK, ORANGE, QUANTITIES, axis_title

LIMIT, PROFILE, FORCE = (QUANTITIES[name].colour for name in ("limit", "speed", "applied"))
ENVELOPE, GRADE, DARK = GREY, ORANGE, INK
LIMIT_WORDS = "speed limit over the train length"
SHORT_LINE_KM = 1.0
"""Below this length the axis is in metres."""

Lines = Iterable[tuple[Array, str, str | None]]
"""Values [SI], colour and label of the lines of a panel."""


def _sheet(*ratios: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels over the distance, by their heights."""
    figure = Figure(figsize=(11, 8.5), dpi=110, layout="constrained")
    return figure, list(figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios))


def _draw(panel: Axes, place: Array, unit: str, lines: Lines, **style: Any) -> None:
    """Draw lines over the place of display in a unit."""
    for values, colour, label in lines:
        panel.plot(place, shown_per(unit) * values, color=colour, label=label, **style)


@styled(SHEET_SIZE)
def draw_plan(plan: Plan, path: Path) -> None:
    """Draw a plan as PNG, PDF or SVG."""
    figure, (speed, force, grade) = _sheet(3, 2, 1.4)
    span = plan.arrivals[-1][0] - plan.arrivals[0][0]
    unit = "km" if span >= SHORT_LINE_KM * 1e3 else "m"
    scale = shown_per(unit)
    place = plan.front * scale
    _draw(speed, place, "km/h", [(plan.limit, LIMIT, LIMIT_WORDS)], lw=1.2, drawstyle="steps-post")
    _draw(speed, place, "km/h", [(plan.profile.velocity, PROFILE, "profile")], lw=1.6)
    for at, _, _ in plan.arrivals:
        speed.axvline(at * scale, color=DARK, lw=0.8, ls=":")
    speed.set_ylabel(axis_title("speed in km/h"))
    speed.set_ylim(bottom=0)
    _draw_force(force, plan, place)
    _draw_grade(grade, plan, scale)
    _set_places(grade, plan.line, "place of the front", unit)
    for panel in (speed, force, grade):
        panel.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False, fontsize="small")
        panel.margins(x=0.01)
    figure.suptitle(
        f"{plan.train.name} on {plan.line.name}: {plan.running_time:.1f} s, {shown_text(f'{span / 1e3:.3f} km')}, "
        f"{plan.summary()['energy_kwh']:.0f} kWh"
    )
    write_figure(figure, path)


def _set_places(panel: Axes, line: Line, what: str, unit: str) -> None:
    """Set title and numbers of an axis of places: posts on a line with chainage."""
    if not line.chainage:
        panel.set_xlabel(axis_title(f"{what} in {unit}"))
        return
    scale = shown_per(unit)
    panel.xaxis.set_major_formatter(lambda place, _: line.post_at(round(place / scale)))
    panel.set_xlabel(f"post at the {what}")


def shown_per(unit: str) -> float:
    """Return the factor from SI to the unit in which a unit is shown."""
    return unit_symbols()[unit][1] * display_unit(unit)[1]


def _draw_force(panel: Axes, plan: Plan, place: Array) -> None:
    traction, electric, air = plan.train.forces_at(plan.profile.velocity)
    keep = 1.0 - plan.settings.force_margin
    envelopes = (keep * traction, "envelopes minus force margin"), (-keep * (electric + air), None)
    _draw(panel, place, "kN", [(values, ENVELOPE, label) for values, label in envelopes], lw=1.0)
    if np.any(air > 0):
        _draw(panel, place, "kN", [(-keep * electric, ENVELOPE, "electric part")], lw=1.0, ls="--")
    _draw(panel, place, "kN", [(plan.force, FORCE, "force of the train")], lw=1.2)
    panel.set_ylabel(axis_title("force in kN"))


def _draw_grade(panel: Axes, plan: Plan, scale: float) -> None:
    front = np.linspace(plan.arrivals[0][0], plan.arrivals[-1][0], 4000)
    track = Track(plan.line)
    local = np.interp(front, track.breaks, np.arange(track.breaks.size))
    index = np.floor(local).astype(int) + 1
    inside = (front >= track.breaks[0]) & (front < track.breaks[-1])
    here = 1e3 * np.where(inside, track.grade[index], 0.0)
    panel.step(front * scale, here, color=GRADE, lw=0.8, label="grade at the front")
    mean_force = LineForce(plan.line, plan.train, over_length=plan.settings.grade_over_length).at(front)
    mean = 1e3 * mean_force / (plan.train.mass * plan.train.gravity)
    panel.plot(front * scale, mean, color=DARK, lw=1.2, label="mean over the train, with curves and tunnels")
    panel.set_ylabel("grade in ‰")


@styled(SHEET_SIZE)
def draw_trip(plan: TripPlan, line: Line, consist: Consist, path: Path) -> None:
    """Draw a trip plan as PNG, PDF or SVG."""
    figure, (speed, force, coupler, grade) = _sheet(3, 2, 2, 1)
    km, run = shown_per("km"), plan.run
    _draw_trip_speed(speed, plan, line, consist)
    place = run.position * km
    _draw(force, place, "kN", [(run.force, FORCE, "drives"), (-run.shoes, ORANGE, "shoes")], lw=1.2)
    force.set_ylabel(axis_title("force in kN"))
    draft, buff = run.couplers.max(axis=1, initial=0.0), run.couplers.min(axis=1, initial=0.0)
    _draw(coupler, place, "kN", [(draft, FORCE, "largest draft"), (buff, ORANGE, "largest buff")], lw=0.8)
    coupler.set_ylabel(axis_title("couplers in kN"))
    track = Track(line)
    places = np.linspace(float(run.position[0]), float(run.position[-1]), 2000)
    grade.plot(places * km, 1e3 * track.grade[np.searchsorted(track.breaks, places, side="right")], color=GREY, lw=1)
    grade.set_ylabel("grade in ‰")
    _set_places(grade, line, "place of vehicle 0's centre", "km")
    speed.legend(loc="lower center", ncols=3)  # the profile is above it, except at both ends
    for panel in (force, coupler):
        panel.legend(loc="upper right")
    for panel in (speed, force, coupler):
        panel.margins(x=0.01)
    figures = plan.summary()
    figure.suptitle(
        f"{consist.name} on {line.name}: {figures['running_time_s']:.0f} s, {figures['energy_kwh']:.0f} kWh, "
        f"{len(plan.applications)} application{'' if len(plan.applications) == 1 else 's'}"
    )
    write_figure(figure, path)


def _draw_trip_speed(panel: Axes, plan: TripPlan, line: Line, consist: Consist) -> None:
    """Draw limit, profile and the planned applications."""
    position, km = plan.profile.position, shown_per("km")
    limit = SpeedLimits(line, np.inf).at(position + consist.vehicles[0].length / 2, consist.length)
    _draw(panel, position * km, "km/h", [(limit, LIMIT, LIMIT_WORDS)], lw=1.2)
    _draw(panel, position * km, "km/h", [(plan.profile.velocity, PROFILE, "profile")], lw=1.6)
    for number, entry in enumerate(plan.applications):
        label = "air brake applied" if number == 0 else None
        panel.axvspan(entry.apply * km, entry.release * km, color=ORANGE, alpha=0.2, label=label)
    panel.set_ylabel(axis_title("speed in km/h"))
