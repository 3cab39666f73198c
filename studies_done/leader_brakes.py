"""Emergency brakes of a leader: two metro trains, the one behind on its own profile towards the train that stops.

Run: ``python studies_done/leader_brakes.py [--runs N] [--json]``; 1 000 runs take ten minutes of processor time.
Every case is a run of the engine with train, sensors and supervisor, of 120 s or more, until both trains are at rest.
Drawn are: time of the brake and speed of the leader, distance of the trains, delay and loss of the link, authority
(absolute or relative), with or without the braking law that takes over before the supervisor, and both trains: of the
leader the nominal one or that with the shortest stop of its safety data, of the follower up to 3 % more mass and up to
15 % less resistance. The goal: no contact, and no moving train at the end.
"""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

import numpy as np

import train_ato as ta
from train_ato.api.following import follower_figures, train_reports
from train_ato.supervision.train_report import reports_text

PROFILE = {
    "phases": [{"accelerate_to_kmh": 50}, {"cruise_until": 900}, {"brake_to": 0}],
    "limits": {"jerk": 0.6, "acceleration": 0.8, "deceleration": 0.8},
}
METRO: dict[str, Any] = {
    "base": "xuzhou_metro", "tick": 0.1, "step": 0.005, "supervision": {"enabled": True},
}
SHORTEST = {"mass_scale": 0.97, "resistance_scale": 1.15, "electric_brake_scale": 1.05, "brake_scale": 1.05}

STANDS = 0.01
"""Largest speed of a train at rest [m/s]."""
LONGEST = 960.0
"""Longest run [s]."""


def case(seed: int, duration: float = 120.0) -> dict[str, Any]:
    """Return the figures of the follower behind one emergency brake; a train that moves has twice the duration [s]."""
    draw = np.random.default_rng(seed)
    authority = "relative" if draw.random() < 0.5 else "absolute"
    place, at = draw.uniform(45, 75), draw.uniform(2, 25)
    headway = draw.uniform(13, 30) if authority == "relative" else draw.uniform(21, 35)
    ahead = ta.run({
        **METRO, "duration": duration, "seed": 2 * seed, "profile": {**PROFILE, "since": place},
        "plant": {"mismatch": SHORTEST if draw.random() < 0.5 else {}},
        "interventions": [{"at": at, "do": "emergency_brake"}],
    })  # fmt: skip
    link = {"delay": draw.uniform(0.0, 1.6), "loss": draw.uniform(0.0, 0.3)}
    reports = reports_text(train_reports(ahead.recording, ahead.setup))
    own = ta.run({
        **METRO, "duration": duration, "seed": 2 * seed + 1, "profile": {**PROFILE, "since": place - headway},
        "plant": {"mismatch": {"mass_scale": draw.uniform(1, 1.03), "resistance_scale": draw.uniform(0.85, 1)}},
        "leader": {"reports": reports, "authority": authority, "link": link},
        "supervision": {"enabled": True, "assurance": bool(draw.random() < 0.5)},
    })  # fmt: skip
    moving = sum(abs(float(run.recording.front_velocity[-1])) > STANDS for run in (ahead, own))
    if moving and duration < LONGEST:
        return case(seed, 2.0 * duration)
    figures = follower_figures(ahead.recording, own.recording, own.setup)
    braked = float(np.interp(at, ahead.recording.time, ahead.recording.front_velocity))
    return {
        **figures, "seed": seed, "authority": authority, "braked_from_kmh": 3.6 * braked,
        "moving": moving, "duration_s": duration,
        "interventions": own.metrics["brake_interventions"], "takeovers": own.metrics["takeovers"],
    }  # fmt: skip


def main() -> int:
    """Print the figures of both authorities; return 1 for a contact or a train that moves at the end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--first", type=int, default=0, help="seed of the first run")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = [case(seed) for seed in range(options.first, options.first + options.runs)]
    missed = any(row["contacts"] or row["moving"] for row in rows)
    if options.json:
        json.dump(rows, sys.stdout)
        return int(missed)
    for authority in ("absolute", "relative"):
        found = [row for row in rows if row["authority"] == authority]
        gaps = [row["gap_min_m"] for row in found]
        acted = sum(bool(row["interventions"] or row["takeovers"]) for row in found)
        print(
            f"{authority}: {len(found)} brakes, {sum(row['contacts'] for row in found)} contacts, smallest gap "
            f"{min(gaps):.1f} m, median {np.median(gaps):.1f} m, {acted} with a brake of the follower, "
            f"{sum(row['moving'] for row in found)} trains moving at the end"
        )
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
