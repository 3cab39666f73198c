"""Figure of a plan over the distance: limits and profile, force within its envelopes, grade."""

from pathlib import Path

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
SHORT_LINE_KM = 1.0
"""Below this length the axis is in metres."""


@styled(SHEET_SIZE)
def draw_plan(plan: Plan, path: Path) -> None:
    """Draw a plan as PNG, PDF or SVG."""
    figure = Figure(figsize=(11, 8.5), dpi=110, layout="constrained")
    speed, force, grade = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 1.4))
    span = plan.arrivals[-1][0] - plan.arrivals[0][0]
    unit = "km" if span >= SHORT_LINE_KM * 1e3 else "m"
    scale = shown_per(unit)
    place = plan.front * scale
    _draw_speed(speed, plan, place, scale)
    _draw_force(force, plan, place)
    _draw_grade(grade, plan, scale)
    _set_places(grade, plan.line, "place of the front", unit)
    for panel in (speed, force, grade):
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


def _draw_speed(panel: Axes, plan: Plan, place: Array, scale: float) -> None:
    panel.step(
        place,
        shown_per("km/h") * plan.limit,
        where="post",
        color=LIMIT,
        lw=1.2,
        label="speed limit over the train length",
    )
    panel.plot(place, shown_per("km/h") * plan.profile.velocity, color=PROFILE, lw=1.6, label="profile")
    for at, _, _ in plan.arrivals:
        panel.axvline(at * scale, color=DARK, lw=0.8, ls=":")
    panel.set_ylabel(axis_title("speed in km/h"))
    panel.set_ylim(bottom=0)
    panel.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False, fontsize="small")


def _draw_force(panel: Axes, plan: Plan, place: Array) -> None:
    traction, electric, air = plan.train.forces_at(plan.profile.velocity)
    keep = 1.0 - plan.settings.force_margin
    panel.plot(place, keep * traction * shown_per("kN"), color=ENVELOPE, lw=1.0, label="envelopes minus force margin")
    panel.plot(place, -keep * (electric + air) * shown_per("kN"), color=ENVELOPE, lw=1.0)
    if np.any(air > 0):
        panel.plot(place, -keep * electric * shown_per("kN"), color=ENVELOPE, lw=1.0, ls="--", label="electric part")
    panel.plot(place, plan.force * shown_per("kN"), color=FORCE, lw=1.2, label="force of the train")
    panel.set_ylabel(axis_title("force in kN"))
    panel.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False, fontsize="small")


def _draw_grade(panel: Axes, plan: Plan, scale: float) -> None:
    front = np.linspace(plan.arrivals[0][0], plan.arrivals[-1][0], 4000)
    track = Track(plan.line)
    local = np.interp(front, track.breaks, np.arange(track.breaks.size))
    index = np.floor(local).astype(int) + 1
    inside = (front >= track.breaks[0]) & (front < track.breaks[-1])
    panel.step(
        front * scale, 1e3 * np.where(inside, track.grade[index], 0.0), color=GRADE, lw=0.8, label="grade at the front"
    )
    mean_force = LineForce(plan.line, plan.train, over_length=plan.settings.grade_over_length).at(front)
    weight = plan.train.mass * plan.train.gravity
    panel.plot(
        front * scale,
        1e3 * mean_force / weight,
        color=DARK,
        lw=1.2,
        label="mean over the train, with curves and tunnels",
    )
    panel.set_ylabel("grade in ‰")
    panel.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False, fontsize="small")


@styled(SHEET_SIZE)
def draw_trip(plan: TripPlan, line: Line, consist: Consist, path: Path) -> None:
    """Draw a trip plan as PNG, PDF or SVG."""
    figure = Figure(figsize=(11, 8.5), dpi=110, layout="constrained")
    speed, force, coupler, grade = figure.subplots(4, 1, sharex=True, height_ratios=(3, 2, 2, 1))
    _draw_trip_speed(speed, plan, line, consist)
    place, run = plan.run.position * shown_per("km"), plan.run
    force.plot(place, run.force * shown_per("kN"), color=FORCE, lw=1.2, label="drives")
    force.plot(place, -run.shoes * shown_per("kN"), color=ORANGE, lw=1.2, label="shoes")
    force.set_ylabel(axis_title("force in kN"))
    coupler.plot(
        place, run.couplers.max(axis=1, initial=0.0) * shown_per("kN"), color=FORCE, lw=0.8, label="largest draft"
    )
    coupler.plot(
        place, run.couplers.min(axis=1, initial=0.0) * shown_per("kN"), color=ORANGE, lw=0.8, label="largest buff"
    )
    coupler.set_ylabel(axis_title("couplers in kN"))
    track = Track(line)
    places = np.linspace(float(run.position[0]), float(run.position[-1]), 2000)
    grade.plot(
        places * shown_per("km"),
        1e3 * track.grade[np.searchsorted(track.breaks, places, side="right")],
        color=GREY,
        lw=1,
    )
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
        f"{len(plan.applications)} applications"
    )
    write_figure(figure, path)


def _draw_trip_speed(panel: Axes, plan: TripPlan, line: Line, consist: Consist) -> None:
    """Draw limit, profile and the planned applications."""
    position = plan.profile.position
    limit = SpeedLimits(line, np.inf).at(position + consist.vehicles[0].length / 2, consist.length)
    panel.plot(
        position * shown_per("km"),
        shown_per("km/h") * limit,
        color=LIMIT,
        lw=1.2,
        label="speed limit over the train length",
    )
    panel.plot(
        position * shown_per("km"), shown_per("km/h") * plan.profile.velocity, color=PROFILE, lw=1.6, label="profile"
    )
    for number, entry in enumerate(plan.applications):
        label = "air brake applied" if number == 0 else None
        panel.axvspan(
            entry.apply * shown_per("km"), entry.release * shown_per("km"), color=ORANGE, alpha=0.2, label=label
        )
    panel.set_ylabel(axis_title("speed in km/h"))
