"""Smallest variation of the command of five units on soft couplers for a position error: a front of LQG regulators.

    python studies_done/freight_front.py [--delay S] [--json]

The train of freight_consensus:realistic as a linear system, with lag, delay, disturbances and sensor noise of the
scenario and without its profile, which adds 2.5 kN/s. Every mode of the couplers has a steady-state Kalman filter, the
exact prediction over the delay and a linear-quadratic regulator of the rate of the command; JERK is its weight of the
rate. Two models of the disturbance:

* walk: noise on speed and acceleration and a random walk of the acceleration, as in the law mpc;
* lines: oscillators at 1, 2, 3 and 4 rad/s on drift speed and acceleration, the true spectrum. No law has it before
  the run: this is the floor.

Columns: position error rms [m], variation of the command and of its mean over the units [kN/s], largest coupler force
of the run and after 25 s [kN]. The disturbance has another phase from 10 and from 20 s on.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from plant_sim.disturbances import Paper002, TravellingLoad
from train_ato.control.algorithms.coupled_units import matrix_exponential
from train_ato.control.mpc.unit_deviations import filter_gain, regulator_gain
from train_ato.messages.types import Array

UNITS, MASS, STIFFNESS, DAMPING, DRAG = 5, 80e3, 160e3, 800.0, 8e-4
LAG, TICK, PARTS, DURATION = 0.4, 0.1, 10, 350.0
POSITION_NOISE, SPEED_NOISE = 0.02, 0.005
POSITION, JERKS = 0.1, (0.03, 0.06, 0.12, 0.25, 0.5, 1.0)
"""Weights of position [m] and rate of the command over the mass [m/s³]."""
LINES = (1.0, 2.0, 3.0, 4.0)
MODELS = {"walk": (0.005, 0.005, 0.01, 0.0), "lines": (0.005, 0.005, 0.001, 0.001)}
"""Process noise in a second: speed [m/s], acceleration and its walk [m/s²], amplitude of the lines [m/s, m/s²]."""


class Mode(NamedTuple):
    """Regulator of one mode: step of the estimate, prediction over the delay, gains."""

    step: Array
    predict: Array
    correction: Array
    gain: Array


def sampled(rates: Array, inputs: Array, h: float) -> Array:
    """Return the map of states and constant inputs to the states ``h`` s later."""
    n, m = rates.shape[0], inputs.shape[1]
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = rates, inputs
    return matrix_exponential(whole * h)[:n]


def mode(eigenvalue: float, model: str, delay: int, jerk: float) -> Mode:
    """Return the regulator of a mode; states x, v, F/m, walk and lines, input u/m."""
    speed, acceleration, walk, line = MODELS[model]
    if eigenvalue > 1e-9:
        speed, acceleration = 0.1, 0.05
    lines = LINES if line else ()
    size = 4 + 4 * len(lines)
    rates = np.zeros((size, size))
    rates[0, 1] = rates[1, 2] = rates[1, 3] = 1.0
    rates[1, :2] = -STIFFNESS * eigenvalue / MASS, -DAMPING * eigenvalue / MASS - DRAG
    rates[2, 2], rates[3, 3] = -1.0 / LAG, -1e-3
    for k, omega in enumerate(lines * 2):
        at = 4 + 2 * k
        rates[at : at + 2, at : at + 2] = [[-1e-3, omega], [-omega, -1e-3]]
        rates[int(k >= len(lines)), at] = 1.0
    step = sampled(rates, np.eye(size)[:, 2:3] / LAG, TICK)
    a, b = step[:, :size], step[:, size:]
    noise = np.array([speed, acceleration, 1e-6, walk, *[line] * (size - 4)]) ** 2 * TICK
    measured = np.eye(size)[:3]
    deviations = np.array([POSITION_NOISE, SPEED_NOISE, 1e-6])
    correction = filter_gain(a, measured, np.diag(noise), np.diag(deviations**2))
    whole, cost = np.eye(size + 1), np.zeros((size + 1, size + 1))
    whole[:size, :size], whole[:size, size:], cost[0, 0] = a, b, POSITION**-2
    change = np.vstack((b, np.ones((1, 1))))
    gain = regulator_gain(whole, change, cost, np.full((1, 1), (jerk * TICK) ** -2.0))
    predict = [np.linalg.matrix_power(a, delay)]
    predict += [np.linalg.matrix_power(a, delay - 1 - k) @ b for k in range(delay)]
    return Mode(step, np.hstack(predict), correction, gain[0])


def outside(ticks: int) -> Array:
    """Return drift speeds [m/s] and accelerations [m/s²] of the scenario, shape (steps, 2 units)."""
    t = (np.arange(ticks * PARTS) + 0.5) * TICK / PARTS
    own = Paper002(kind="paper002", unmatched_scale=0.05, matched_scale=0.02).tick(t, np.ones(UNITS))
    load = TravellingLoad(
        kind="travelling_load", acceleration=-0.1, begin=90, duration=20, interval=6.7, period=150
    ).tick(t, np.ones(UNITS))
    assert own.drift is not None
    return np.hstack((own.drift, own.force + load.force))


def simulate(modes: list[Mode], shapes: Array, delay: int) -> dict[str, float]:
    """Return the columns for one set of regulators."""
    ticks = round(DURATION / TICK)
    difference = np.eye(UNITS)[:-1] - np.eye(UNITS)[1:]
    spring = STIFFNESS / MASS * difference.T @ difference
    damper = DAMPING / MASS * difference.T @ difference + DRAG * np.eye(UNITS)
    zero, one = np.zeros((UNITS, UNITS)), np.eye(UNITS)
    rates = np.block([[zero, one, zero], [-spring, -damper, one], [zero, zero, -one / LAG]])
    inputs = np.block([[zero, one, zero], [zero, -damper, one], [one / LAG, zero, zero]])
    step = sampled(rates, inputs, TICK / PARTS)
    random, forces = np.random.default_rng(1), outside(ticks)
    noise = random.standard_normal((ticks, 2, UNITS)) * np.array([[POSITION_NOISE], [SPEED_NOISE]])
    state, estimates = np.zeros(3 * UNITS), [np.zeros(each.step.shape[0]) for each in modes]
    commands, positions, couplers = np.zeros((ticks + delay, UNITS)), np.zeros((ticks, UNITS)), np.zeros(ticks)
    for k in range(ticks):
        measured = shapes.T @ (state.reshape(3, UNITS) + np.vstack((noise[k], np.zeros(UNITS)))).T
        sent = commands[k : k + delay] @ shapes
        command = np.zeros(UNITS)
        for j, each in enumerate(modes):
            estimate = estimates[j]
            estimate = estimate + each.correction @ (measured[j] - estimate[:3])
            ahead = each.predict @ np.concatenate((estimate, sent[:, j]))
            last = sent[-1, j]
            command[j] = last - each.gain @ np.append(ahead, last)
            estimates[j] = each.step @ np.append(estimate, sent[0, j])
        commands[k + delay] = shapes @ command
        positions[k] = state[:UNITS]
        for force in forces[k * PARTS : (k + 1) * PARTS]:
            state = step @ np.concatenate((state, commands[k], force))
            stretch = difference @ (STIFFNESS * state[:UNITS] + DAMPING * state[UNITS : 2 * UNITS])
            couplers[k] = max(couplers[k], np.abs(stretch).max() / 1e3)
    change = MASS * np.diff(commands[delay:], axis=0)
    return {
        "rms_m": float(np.sqrt((positions**2).mean())),
        "variation_kn_per_s": float(np.abs(change).sum()) / DURATION / 1e3,
        "of_mean_kn_per_s": float(np.abs(change.sum(axis=1)).sum()) / DURATION / 1e3,
        "coupler_kn": float(couplers.max()),
        "after_25_s_kn": float(couplers[250:].max()),
    }


def rows(seconds: list[float]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table."""
    difference = np.eye(UNITS)[:-1] - np.eye(UNITS)[1:]
    eigenvalues, shapes = np.linalg.eigh(difference.T @ difference)
    for delay in seconds:
        ticks = round(delay / TICK)
        for model in MODELS:
            for jerk in JERKS:
                modes = [mode(value, model, ticks, jerk) for value in eigenvalues.tolist()]
                yield {"delay_s": delay, "model": model, "jerk": jerk, **simulate(modes, shapes, ticks)}


def main() -> None:
    """Print the table as Markdown, or one JSON value."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--delay", type=float, action="append", metavar="S", help="default: 0.8 and 1.0")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = []
    if not options.json:
        print("| delay s | disturbance | jerk m/s³ | rms m | kN/s | of the mean | couplers kN | after 25 s |")
        print("|---" * 8 + "|")
    for row in rows(options.delay or [0.8, 1.0]):
        found.append(row)
        if not options.json:
            cells = [format(value, ".3f" if name == "rms_m" else ".1f") for name, value in list(row.items())[3:]]
            print(f"| {row['delay_s']:g} | {row['model']} | {row['jerk']:g} | {' | '.join(cells)} |", flush=True)
    if options.json:
        print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
