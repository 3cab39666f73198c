"""Bounds of the values of a message that are physically possible."""

MAX_POSITION = 1e8
"""Largest valid position [m]."""
MAX_SPEED = 1e3
"""Largest valid speed [m/s], acceleration [m/s²] and jerk [m/s³]."""
MAX_FORCE = 1e10
"""Largest valid force [N]."""
MAX_PRESSURE = 1e7
"""Largest valid pressure [Pa]."""
MAX_MAGNITUDES = {"m": MAX_POSITION, "m/s": MAX_SPEED, "m/s²": MAX_SPEED, "N": MAX_FORCE, "Pa": MAX_PRESSURE}
"""Largest valid magnitude by unit."""
