"""Batch: many trains in one call, with the bits of single ticks."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
from plant_trains import TICK_NS, heavy, train

from plant_sim import kernel as k
from plant_sim.batch import advance_trains
from plant_sim.library import load_line
from plant_sim.states import Array
from plant_sim.train import Train

WIND = {"kind": "turbulence", "acceleration_rms": 0.01}
CASES: dict[str, dict[str, Any]] = {
    "released": {},
    "mass": {"mismatch": {"mass_scale": 1.1}, "lag": 0.4},
    "wind": {"disturbances": [WIND, {"kind": "eq40", "vehicles": [0, 3, 7]}], "adhesion": {"kind": "curtius_kniffler"}},
    "cubes": {"disturbances": [{"kind": "eq40", "vehicles": [0, 2], "speed_power": 3, "scale": 0.01}]},
    "jump": {"jumps": [{"at": 2.05, "what": "mass", "factor": 1.1, "vehicles": [3]}]},
    "parting": {"jumps": [{"at": 1.0, "what": "coupler", "vehicles": [4]}]},
}


def plant(name: str, pipe_pa: float | None = None) -> Train:
    """Return a short train of a case after its first tick, optionally with a demand of the brake pipe."""
    start = {"position_km": 20.15, "speed_kmh": 40}
    made = train(heavy(wagons=9), load_line("daqin_section"), start=start, **CASES[name])
    made.advance(np.zeros((made.substeps, 1)), pipe_pa)
    return made


def demands(ticks: int) -> Array:
    """Return commands [N] of shape (ticks, substeps, 1) with traction and electric brake."""
    ramp = 400e3 * np.sin(np.arange(ticks * 20) * 2e-3)
    return ramp.reshape(ticks, 20, 1)


@pytest.mark.parametrize("pipe_pa", [None, 550e3], ids=["released", "braked"])
def test_batch_has_the_bits_of_single_ticks(pipe_pa: float | None) -> None:
    """Breaks if a jump, wave, disturbance or the end of their block is lost between two compiled calls."""
    single = [plant(name, pipe_pa) for name in CASES]
    batch = [plant(name, pipe_pa) for name in CASES]
    commands = [demands(90 + 7 * number) for number in range(len(CASES))]
    for one, demand in zip(single, commands, strict=True):
        for due in demand:
            one.advance(due)
    advance_trains(batch, commands, threads=2)
    for name, one, other in zip(CASES, single, batch, strict=True):
        assert one.stamp == other.stamp, name
        for part in ("state", "gear", "unit", "setting"):
            assert getattr(one.arrays, part).tobytes() == getattr(other.arrays, part).tobytes(), (name, part)
        np.testing.assert_array_equal(one.outside_force, other.outside_force)
        one.advance(demands(1)[0])
        other.advance(demands(1)[0])
        assert one.arrays.state.tobytes() == other.arrays.state.tobytes(), name


def test_quiet_ticks_are_one_call() -> None:
    """Breaks if quiet ticks are integrated one by one, which holds the lock of the interpreter."""
    quiet = plant("released")
    assert quiet.is_quiet
    assert quiet.advance_quiet(demands(50)) == 50
    assert quiet.stamp == 51 * TICK_NS
    assert not plant("released", 550e3).is_quiet
    assert not plant("jump").is_quiet
    assert not plant("cubes").is_quiet


@pytest.mark.skipif(not hasattr(k.advance_ticks, "targetoptions"), reason="without compiler")
def test_compiled_ticks_release_the_lock_of_the_interpreter() -> None:
    """Breaks if threads wait for each other: another thread then sees the train at the begin and at the end only."""
    moving, long = plant("released"), demands(50_000)
    moving.advance_quiet(demands(2))  # compiled or loaded from the cache
    worker = threading.Thread(target=moving.advance_quiet, args=(long,))
    positions = {float(moving.arrays.state[k.X, 0])}
    worker.start()
    while worker.is_alive():
        positions.add(float(moving.arrays.state[k.X, 0]))
    assert len(positions) > 3


def test_batch_is_checked_before_the_first_step() -> None:
    """Breaks if a bad demand of the last train is found after the others have moved."""
    trains, good = [plant("released"), plant("mass")], demands(3)
    for bad, text in (
        ([good], "2 trains have 1 demands"),
        ([good, good[:, :5]], r"demand of train 1 has the shape \(3, 5, 1\)"),
        ([good, np.full_like(good, np.nan)], "demand of train 1 is not finite"),
    ):
        with pytest.raises(ValueError, match=text):
            advance_trains(trains, bad)
    with pytest.raises(ValueError, match="listed twice"):
        advance_trains([trains[0], trains[0]], [good, good])
    assert trains[0].stamp == TICK_NS
