"""``train-ato driver``: simulate a driver on the nominal multi-mass train and write the run as a speed profile.

Options::

    line LINE        shipped line or file
    consist CONSIST  shipped train or file
    --until-km KM    last position of vehicle 0 [km], or a post as 84+500; the train is still moving there
    --speed-kmh V    target speed of the driver, also above the limits of the line (default: 70)
    --spacing S      time between the knots of the profile (default: 0.5)
    --out FILE       profile to write (.csv, .yaml)
"""

from __future__ import annotations

import argparse
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

from train_ato.cli.plan import kilometre
from train_ato.cli.screen import print_result
from train_ato.program.arguments import Options, check_new_file
from train_ato.program.display_units import shown_text

if TYPE_CHECKING:
    from plant_sim.consist import Consist
    from plant_sim.line import Line
    from train_ato.profile.profile import Profile


OPTIONS: Options = {
    "--until-km": {"type": kilometre, "required": True},
    "--speed-kmh": {"default": 70.0},
    "--spacing": {"default": 0.5},
    "--out": {"required": True},
}


def execute(options: argparse.Namespace) -> None:
    """Simulate the driver, write the profile, and print the brake events in the form of a scenario."""
    from plant_sim.library import load_consist, load_line
    from train_ato.profile import driver
    from train_ato.profile.file import write_profile

    check_new_file(options.out, (".csv", ".yaml", ".yml"))
    consist, line = load_consist(options.consist), load_line(options.line)
    until = _until(options, line)
    speed = options.speed_kmh / 3.6
    profile, changes = driver.simulate_driver(consist, line, until, speed, options.spacing, _print_position)
    shown = options.until_km if isinstance(options.until_km, str) else f"{options.until_km:.10g}"
    source = (
        f"simulated driver ({driver.SLEW / 1e3:g} kN/s, {driver.TRACTION:g} of the traction, {driver.BRAKE:g} of the "
        f"brake, {options.speed_kmh:g} km/h, {driver.GAIN:g} 1/s) on {consist.name} and {line.name}, speed averaged "
        f"over {driver.AVERAGE:g} s three times: "
        f"train-ato driver {options.line} {options.consist} --until-km {shown} "
        f"--speed-kmh {options.speed_kmh:.10g} --spacing {options.spacing:.10g}"
    )
    write_profile(profile, options.out, source)
    events = [{"time": round(time, 3), "reduction_kpa": round(reduction / 1e3, 3)} for time, reduction in changes]
    result = {
        "file": str(options.out),
        "running_time_s": profile.end,
        "distance_m": float(profile.position[-1] - profile.position[0]),
        "speed_max_kmh": 3.6 * float(profile.velocity.max()),
        "speed_end_kmh": 3.6 * float(profile.velocity[-1]),
        "events": events,
    }
    text = (
        f"{profile.end:.1f} s, {result['distance_m']:.0f} m, at most {result['speed_max_kmh']:.1f} km/h, written to "
        f"{options.out}\n"
    )
    if events:
        text += "brake:\n  policy: planned\n  events:\n"
    text += "".join(f"    - {{time: {e['time']}, reduction_kpa: {e['reduction_kpa']:g}}}\n" for e in events)
    _note_excess(profile, consist, line)
    print_result(result, text, as_json=options.json)


def _note_excess(profile: Profile, consist: Consist, line: Line) -> None:
    """Print the largest speed above the limits of the line on stderr: the driver does not see them."""
    import numpy as np

    from plant_sim.line import line_for
    from train_ato.judge.metrics import limit_over_train

    with suppress(ValueError):  # limits of other categories of trains only
        line = line_for(line, consist.categories, consist.rating)
    if not line.speed_limits:
        return
    front = profile.position + consist.vehicles[0].length / 2
    limit = limit_over_train(line, front, consist.length)
    row = int(np.argmax(profile.velocity - limit))
    if profile.velocity[row] > limit[row]:
        place = f"{3.6 * profile.velocity[row]:.1f} km/h at km {front[row] / 1e3:.3f}"
        text = line.with_posts(f"{place}, where the line has {3.6 * limit[row]:g} km/h")
        sys.stderr.write(f"note: the driver does not keep speed limits: {shown_text(text)}\n")


def _until(options: argparse.Namespace, line: Line) -> float:
    """Return the last position [m] after a check of the numbers of the options."""
    asked = options.until_km
    try:
        until = line.place_of(asked) if isinstance(asked, str) else asked * 1e3
    except ValueError as error:
        raise ValueError(f"--until-km {error}") from None
    if not line.begin < until <= line.end:
        raise ValueError(
            f"--until-km {asked}: not on line '{line.name}' ({line.extent}); give a place on it, beyond its begin"
        )
    if not 1 <= options.speed_kmh <= 500:
        raise ValueError(f"--speed-kmh {options.speed_kmh}: out of range; give 1 to 500 km/h")
    if not 0.1 <= options.spacing <= 10:
        raise ValueError(f"--spacing {options.spacing}: out of range; give 0.1 to 10 s")
    return until


def _print_position(place: float) -> None:
    from train_ato.api.progress import console

    if sys.stderr.isatty():
        console().print(f"km {place / 1e3:.1f}", end="\r")
