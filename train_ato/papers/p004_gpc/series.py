"""Series of paper 004 beyond the topics: oscillation of the command at constant speed."""

from __future__ import annotations

import numpy as np

from train_ato.loop.recording import Recording

STEADY = 1e-3
"""Reference acceleration of a constant speed [m/s²]."""
WINDOW = 10.0
"""Length of the mean from which the oscillation is counted [s]."""


def command_oscillation(recording: Recording, begin: float) -> tuple[float, float, float]:
    """Return amplitude [kN], period [s] and variation [kN/s] of the command of the train at constant speed.

    The longest interval of constant speed after a time is evaluated: half of the range of the command, crossings of
    its mean over 10 s, and sum of its changes over the time.

    Raises
    ------
    ValueError
        If no interval of constant speed is longer than the window.
    """
    time, force = recording.time, recording.command.sum(axis=1) / 1e3
    steady = np.flatnonzero((time > begin) & (np.abs(recording.reference_acceleration) < STEADY))
    part = max(np.split(steady, np.flatnonzero(np.diff(steady) > 1) + 1), key=len)
    count = round(WINDOW / (time[1] - time[0]))
    if part.size <= count:
        raise ValueError(f"no constant speed for {WINDOW:g} s after {begin:g} s")
    t, u = time[part], force[part]
    off = u[count // 2 : u.size - (count - 1) // 2] - np.convolve(u, np.ones(count) / count, "valid")
    crossings = np.count_nonzero(np.diff(off > 0.0))
    length = float(t[-1] - t[0])
    period = 2.0 * (off.size - 1) * length / (t.size - 1) / crossings if crossings else np.nan
    return 0.5 * float(np.ptp(u)), period, float(np.abs(np.diff(u)).sum()) / length
