"""Figure of a trip plan over the distance: limits and profile, forces of drives and shoes, coupler forces, grade."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.track import Track
from train_ato.apps.report.print_parts import SHEET_SIZE, styled, write_figure
from train_ato.apps.report.quantities import GREY, ORANGE, QUANTITIES
from train_ato.profile.planner.line_tables import SpeedLimits
from train_ato.profile.trip.plan import TripPlan

LIMIT, PROFILE, FORCE = (QUANTITIES[name].colour for name in ("limit", "speed", "applied"))


@styled(SHEET_SIZE)
def draw_trip(plan: TripPlan, line: Line, consist: Consist, path: Path) -> None:
    """Draw a trip plan as PNG, PDF or SVG.

    Raises
    ------
    ValueError
        If the file cannot be written.
    """
    figure = Figure(figsize=(11, 8.5), dpi=110, layout="constrained")
    speed, force, coupler, grade = figure.subplots(4, 1, sharex=True, height_ratios=(3, 2, 2, 1))
    _draw_speed(speed, plan, line, consist)
    place, run = plan.run.position / 1e3, plan.run
    force.plot(place, run.force / 1e3, color=FORCE, lw=1.2, label="drives")
    force.plot(place, -run.shoes / 1e3, color=ORANGE, lw=1.2, label="shoes")
    force.set_ylabel("force in kN")
    coupler.plot(place, run.couplers.max(axis=1, initial=0.0) / 1e3, color=FORCE, lw=0.8, label="largest draft")
    coupler.plot(place, run.couplers.min(axis=1, initial=0.0) / 1e3, color=ORANGE, lw=0.8, label="largest buff")
    coupler.set_ylabel("couplers in kN")
    track = Track(line)
    places = np.linspace(float(run.position[0]), float(run.position[-1]), 2000)
    grade.plot(places / 1e3, 1e3 * track.grade[np.searchsorted(track.breaks, places, side="right")], color=GREY, lw=1)
    grade.set_ylabel("grade in ‰")
    grade.set_xlabel("place of vehicle 0's centre in km")
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


def _draw_speed(panel: Axes, plan: TripPlan, line: Line, consist: Consist) -> None:
    """Draw limit, profile and the planned applications."""
    position = plan.profile.position
    limit = SpeedLimits(line, np.inf).at(position + consist.vehicles[0].length / 2, consist.length)
    panel.plot(position / 1e3, 3.6 * limit, color=LIMIT, lw=1.2, label="speed limit over the train length")
    panel.plot(position / 1e3, 3.6 * plan.profile.velocity, color=PROFILE, lw=1.6, label="profile")
    for number, entry in enumerate(plan.applications):
        label = "air brake applied" if number == 0 else None
        panel.axvspan(entry.apply / 1e3, entry.release / 1e3, color=ORANGE, alpha=0.2, label=label)
    panel.set_ylabel("speed in km/h")
