"""Law mpc on freight_consensus:realistic with and without its use of persistent sines in the disturbances.

    python studies_done/freight_lines.py [--only TEXT]

Every row is a run with changes of the scenario: other delays, errors of the model, and disturbances with and without
sines. Columns: position error rms [m], variation of the command [kN/s], largest coupler force of the run and after 40 s
[kN], outcome of tracking, each without / with the sines, and the frequencies in use at the end [rad/s].
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any
from unittest.mock import patch

import numpy as np

import train_ato as ta
from train_ato.control.mpc.disturbance_lines import LineSpectrum
from train_ato.control.laws.mpc import Mpc
from train_ato.judge.verdict import tracking_text

BEGIN = 40.0
"""Time from which the forces of the last column count [s]."""


def sines(*omegas: float, **more: Any) -> dict[str, Any]:
    """Return a disturbance of sines of .1 m/s² [rad/s]."""
    terms = [{"omega": omega, "acceleration": 0.1} for omega in omegas]
    return {"kind": "harmonic", "terms": terms, **more}


def turbulence(rms: float, correlation: float) -> dict[str, Any]:
    """Return random wind of an acceleration [m/s²] and a correlation time [s]."""
    return {"kind": "turbulence", "acceleration_rms": rms, "correlation": correlation}


SOURCES: dict[str, list[dict[str, Any]]] = {
    "no disturbance": [],
    "turbulence .05 m/s², 5 s": [turbulence(0.05, 5.0)],
    "turbulence .1 m/s², 1 s": [turbulence(0.1, 1.0)],
    "gust": [{"kind": "gust", "acceleration": -0.2, "begin": 30, "end": 40}],
    "sines .73, 2.37": [sines(0.73, 2.37)],
    "sines 1.5, 1.8": [sines(1.5, 1.8)],
    "sine 1.5 on one unit, turbulence": [sines(1.5, vehicles=[0]), turbulence(0.05, 1.0)],
}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "delay .3 s": ("+delay_0_3", {}),
    "delay .6 s": ("", {}),
    "delay .8 s": ("+delay_0_8", {}),
    "delay 1.0 s": ("+delay_1_0", {}),
    "delay 1.25 of the model": ("+delay_1_0", {"links.command.delay": 1.25, "model.delay": 1.0}),
    "mass .8": ("+delay_1_0", {"plant.mismatch.mass_scale": 0.8}),
    "mass 1.2": ("+delay_1_0", {"plant.mismatch.mass_scale": 1.2}),
    "gain .8": ("+delay_1_0", {"plant.mismatch.actuator_gain": 0.8}),
    **{name: ("+delay_1_0", {"plant.disturbances": sources}) for name, sources in SOURCES.items()},
}


def figures(variant: str, changes: dict[str, Any]) -> tuple[float, float, float, float, str, str]:
    """Return the columns of one run."""
    laws: list[Mpc] = []
    begin = Mpc.__init__

    def kept(law: Mpc, *arguments: Any) -> None:
        laws.append(law)
        begin(law, *arguments)

    scenario = f"freight_consensus:realistic{variant}"
    with patch.object(Mpc, "__init__", kept):
        run = ta.run(scenario, law="mpc", compensation="none", set=changes, progress=False)
    vehicles, metrics = run["train/vehicles"], run.metrics
    late = vehicles.filter(like="coupler").to_numpy()[vehicles.index.to_numpy() > BEGIN]
    largest = max(metrics["coupler_draft_max_kn"], -metrics["coupler_buff_max_kn"])
    rms, variation = metrics["position_rmse_m"], metrics["command_variation_kn_per_s"]
    lines = max((str(law.diagnostics()["disturbance_lines"]) for law in laws), key=len)  # others only state their gains
    return rms, variation, largest, float(np.abs(late).max()) / 1e3, tracking_text(metrics), lines


def rows(only: str) -> Iterator[str]:
    """Yield the rows of the table."""
    for name, (variant, changes) in CASES.items():
        if only in name:
            with patch.object(LineSpectrum, "peaks", lambda self: []):
                without = figures(variant, changes)
            found = figures(variant, changes)
            pairs = zip(without[:4], found[:4], (".3f", ".1f", ".1f", ".1f"), strict=True)
            cells = [f"{format(one, style)} / {format(other, style)}" for one, other, style in pairs]
            outcome = found[4] if found[4] == without[4] else f"{without[4]} / {found[4]}"
            yield f"| {name} | {outcome} | {' | '.join(cells)} | {found[5] or '-'} |"


def main() -> None:
    """Print the table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", metavar="TEXT")
    options = parser.parse_args()
    print("| case | outcome | rms m | kN/s | couplers kN | after 40 s | frequencies rad/s |")
    print("|---" * 7 + "|")
    for line in rows(options.only):
        print(line, flush=True)


if __name__ == "__main__":
    main()
