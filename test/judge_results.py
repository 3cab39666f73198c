"""Makers of results for the trials of judges (``data/judge_trials.yaml``), by paper, with chosen errors."""

from functools import cache
from typing import Any

import numpy as np
from recordings import with_series
from reproduce_results import FIGURES, result, series

from train_ato.judge.recording import Recording
from train_ato.messages.types import Array
from train_ato.papers.claims import Result
from train_ato.papers.p000_heavy_haul.cases import PERIOD
from train_ato.papers.p000_heavy_haul.checks import LOCOMOTIVE, disturbance_40, unexplained
from train_ato.papers.p001_metro.checks import INERTIA
from train_ato.papers.p002_freight.checks import STIFFNESS_KN
from train_ato.profile.profile import Profile
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare

COUNT = 8000
PHASE = 2.0 * np.pi * 20.0 * np.arange(COUNT) / COUNT
WAVE, ACROSS = np.sin(PHASE), np.cos(PHASE)
REGIME = np.where(np.arange(400) < 200, 0.8, 0.0)
"""Reference acceleration that ends after 10 s [m/s²]."""
FORMS = ("printed", "implicit", "levant", "eso")
FASTEST = 2.0 * np.pi * 4 / 6.9
"""Frequency of a position error with whole periods from 3 s to 9.9 s [rad/s]."""
LIMITED = 200e3
COMFORT = {"stop_error_m": 0.1, "jerk_1s_max": 0.3, "acceleration_max": 0.5, "energy_traction_kwh": 2000.0}


def of_locomotive(rms: float = 0.01, largest: float = 0.05, **more: Any) -> Result:
    """Return a run with these speed errors [km/h]."""
    return result(speed_rmse_kmh=rms, speed_error_max_kmh=largest, **more)


def swinging(kmh: float = 0.1, force: float = 0.0, largest: float | None = None) -> Result:
    """Return a run with an oscillating speed error and command, with its figures."""
    run = series(kmh / 3.6 * WAVE, force * WAVE)
    return result(run, speed_rmse_kmh=kmh / 2**0.5, speed_error_max_kmh=kmh if largest is None else largest)


def shaped(low: float = -0.1, high: float = 0.1, likeness: float = -1.0) -> Result:
    """Return a run with a range of the speed error and a correlation of error and force."""
    error = np.where(WAVE > 0.0, high, -low) * WAVE / 3.6
    return result(series(error, 1e6 * (likeness * error / error.std() + (1.0 - likeness**2) ** 0.5 * 2**0.5 * ACROSS)))


def modelled(error: float = 4e-5) -> Result:
    """Return a run at constant speed whose force leaves this acceleration to the network, which has learnt nothing."""
    return result(series(np.zeros(COUNT), np.full(COUNT, error * LOCOMOTIVE * 1.01 / 0.01)))


def ndo_observed(share: float = 0.05) -> Result:
    """Return a run whose estimate misses the truth by a share of its deviation."""
    run = series(np.zeros(COUNT), np.zeros(COUNT))
    truth = unexplained(run, PERIOD, 0.01, disturbance_40(run, PERIOD))
    return result(with_series(run, estimate=LOCOMOTIVE * (truth + share * truth.std())))


def metro(rms: float = 0.01, largest: float = 0.05, over: float = 0.01, shake: float = 0.1, **more: Any) -> Result:
    """Return a run with rms and largest error [m/s], overshoot [m/s] and variation [m/s² per s]."""
    run = with_series(series(np.full(REGIME.size, over), np.zeros(REGIME.size)), reference_acceleration=REGIME)
    figures = {"command_variation_kn_per_s": shake * INERTIA / 1e3, **more}
    return result(run, speed_rmse_kmh=3.6 * rms, speed_error_max_kmh=3.6 * largest, **figures)


def oscillating(rms: float = 0.01, **more: Any) -> Result:
    """Return a run of 450 s that oscillates with a period of 3.2 s."""
    wave = rms * 2**0.5 * np.sin(2 * np.pi * 0.05 * np.arange(9000) / 3.2)
    return result(series(wave, np.zeros(9000)), speed_rmse_kmh=3.6 * rms, **more)


def observers(**changes: float) -> Result:
    """Return figures of accurate observers, with changes."""
    found = {f"{form} {part}": 0.02 for form in FORMS for part in ("d1", "d2", "d1'")}
    found |= {f"{form} {key}": 0.05 for form in FORMS for key in ("settling", "again")}
    return Result(found | changes, None)


def five(
    place: float = 0.0,
    speed: float = 0.0,
    until: float = 40.0,
    stretch: float = 0.0,
    offset: float = 0.0,
    motion: float = 0.0,
    **figures: float,
) -> Result:
    """Return a run of five cars: errors up to a time, stretch of couplers, speed offset d1, rms of an oscillation."""
    recording = run(place, speed, units=5, until=until, duration=30.0, tick=0.01, force=1e6)
    wave = motion * 2**0.5 / FASTEST * np.sin(FASTEST * recording.time)[:, None]
    recording = with_series(
        recording, position=recording.position + stretch * np.arange(5) + wave, velocity=recording.velocity - offset
    )
    return Result({"coupler_draft_max_kn": 10.0, "coupler_buff_max_kn": -10.0, **figures}, recording)


def five_or_nominal(gain: bool = False, **figures: Any) -> Result:
    return Result({"settling": 0.05, "acceleration": 1e6, **figures}, None) if gain else five(**figures)


def loaded(first: float = 0.0, later: float = 0.0) -> Result:
    """Return a run with stretched couplers after the step at 10 s and after that at 20 s [m]."""
    result = five()
    t = result.recording.time
    force = 1e3 * STIFFNESS_KN * np.where(t > 19.0, later, np.where((t >= 10.0) & (t < 11.0), first, 0.0))
    return Result(result.summary, with_series(result.recording, coupler_draft_max=force))


def driven(place: float = 0.01, speed: float = 0.01, coupler: float = 0.1) -> Result:
    """Return a run with errors over all of its time and a largest coupler stretch [m]."""
    return five(place, speed, coupler_draft_max_kn=STIFFNESS_KN * coupler)


def throughout(place: float = 0.01, speed: float = 0.001, until: float = 100.0, **more: Any) -> Result:
    """Return a run of 100 s with errors to its end, unless a time is given."""
    return tracked(place, speed, until=until, **more)


def saturated(place: float = 44.0, speed: float = 4.0, length: float = 77.0, until: float = 100.0) -> Result:
    """Return a run of 100 s that brakes at the limit for a time from 2 s on."""
    result = tracked(place, speed, until=until)
    t = result.recording.time
    return with_command(result, np.where((t >= 2.0) & (t <= 2.0 + length), -LIMITED, 0.0))


@cache
def profile(scenario: str) -> Profile:
    """Return the profile of a shipped scenario."""
    return prepare(*load_scenario(scenario)).profile


def on_profile(
    off: float = 1.0, fast: float = 0.1, own: float = 0.01, scenario: str = "crh380a_funnel:short"
) -> Result:
    """Return a run with constant errors to the profile of a scenario [m, m/s] and to its own reference [m]."""
    base = run(tick=0.5)
    wanted = np.array([profile(scenario).at(float(t))[:2] for t in base.time])
    position = wanted[:, 0] + off
    recording = with_series(
        base, position=position, front_position=position, front_velocity=wanted[:, 1] + fast,
        reference_position=position - own,
    )  # fmt: skip
    return Result({"command_variation_kn_per_s": 1.0}, recording)


def moving(speed: float = 0.01, place: float = 0.1, **figures: Any) -> Result:
    """Return a run of 100 s with constant errors."""
    result = tracked(place, speed, until=100.0)
    return Result({**result.summary, **COMFORT, **figures}, result.recording)


def steady(speed: float = 0.01) -> Result:
    """Return a run of 400 s with a constant speed error."""
    return tracked(0.0, speed, until=400.0, duration=400.0)


def limited(place: float = 1.0, off: float = 1.0) -> Result:
    """Return a run with errors to its own reference and to the profile for 225.7 kN [m]."""
    return on_profile(off, 0.0, place, "crh380a_gpc:short")


def run(
    place: float = 0.0,
    speed: float = 0.0,
    *,
    units: int = 1,
    until: float = 20.0,
    duration: float = 100.0,
    tick: float = 0.05,
    force: float = 0.0,
    spacing: float = 80.0,
) -> Recording:
    """Return the series of a train with constant errors [m, m/s] up to a time [s] and none later."""
    count = round(duration / tick)
    base = series(np.zeros(count), np.full(count, force), tick)
    t = base.time
    off = np.where(t < until, 1.0, 0.0)
    columns = np.ones(units)
    position = base.reference_position + place * off
    velocity = base.reference_velocity + speed * off
    return with_series(
        base, position=position[:, None] - spacing * np.arange(units), velocity=velocity[:, None] * columns,
        front_position=position, front_velocity=velocity, applied=base.applied * columns,
        command=base.command * columns,
    )  # fmt: skip


def tracked(place: float = 0.0, speed: float = 0.0, **more: float) -> Result:
    """Return a result of one unit with a largest position and speed error [m, m/s]."""
    figures = {key: more.pop(key) for key in list(more) if key in FIGURES}
    recording = run(place, speed, **more)  # type: ignore[arg-type]
    return Result({**FIGURES, **figures}, recording)


def with_command(result: Result, command: Array) -> Result:
    """Return the result with another command [N]."""
    recording = with_series(result.recording, command=command[:, None], applied=command[:, None])
    return Result(result.summary, recording)
