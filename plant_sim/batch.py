"""Many trains in one call, spread over the cores: other parameters, seeds, delays or commands for each of them.

The compiled step releases the lock of the interpreter, so that threads run it at the same time. A thread integrates all
ticks of one train before the next train, because its arrays fit into the cache of a core.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from plant_sim.states import Array
from plant_sim.train import Train

MAX_TICKS = 64
"""Ticks of one compiled call; disturbances end it after their block."""


def advance_trains(trains: Sequence[Train], demands: Sequence[Array], threads: int | None = None) -> None:
    """Integrate the same or different numbers of ticks of many trains, with the bits of :meth:`Train.advance`.

    Parameters
    ----------
    trains
        Trains; every one is listed once.
    demands
        Force commands that are due at every plant step [N], one array of shape (ticks, substeps, units) per train. The
        demand of a brake pipe stays the last one.
    threads
        Number of threads; by default that of the processors.

    Raises
    ------
    ValueError
        If the numbers of trains and demands differ, a train is listed twice, or a demand has a wrong shape or is not
        finite; before the first step.

    Examples
    --------
    Three masses of a train under the same traction of 300 kN for a minute:

    >>> import numpy as np
    >>> import train_ato as ta
    >>> scenario = ta.scenario("daqin_heavy_haul")
    >>> masses = [scenario.with_({"plant.mismatch.mass_scale": scale}) for scale in (0.9, 1.0, 1.1)]
    >>> trains = [choice.prepare().train() for choice in masses]
    >>> traction = np.full((600, trains[0].substeps, 1), 300e3)
    >>> advance_trains(trains, [traction] * 3)
    >>> [round(3.6 * float(train.velocity[0]), 2) for train in trains]
    [4.93, 4.27, 3.73]
    """
    if len(trains) != len(demands):
        raise ValueError(f"{len(trains)} trains have {len(demands)} demands; give one for each train")
    if len({id(train) for train in trains}) != len(trains):
        raise ValueError("a train is listed twice; list every train once")
    arrays = [np.ascontiguousarray(demand, dtype=np.float64) for demand in demands]
    for number, (train, demand) in enumerate(zip(trains, arrays, strict=True)):
        if demand.ndim != 3 or demand.shape[1:] != (train.substeps, len(train.units)):
            wanted = ("ticks", train.substeps, len(train.units))
            raise ValueError(f"demand of train {number} has the shape {demand.shape}; give {wanted}")
        if not np.isfinite(demand).all():
            raise ValueError(f"demand of train {number} is not finite; correct it")
    workers = min(threads or os.cpu_count() or 1, len(trains))
    if workers <= 1:
        for train, demand in zip(trains, arrays, strict=True):
            _advance_train(train, demand)
        return
    with ThreadPoolExecutor(workers) as pool:
        for _ in pool.map(_advance_train, trains, arrays):
            pass


def _advance_train(train: Train, demand: Array) -> None:
    """Integrate the ticks of one train: quiet parts in compiled calls, other ticks one by one."""
    done = 0
    while done < len(demand):
        if train.is_quiet:
            done += train.advance_quiet(demand[done : done + MAX_TICKS])
        else:
            train.advance(demand[done])
            done += 1
