"""Linear model of the train of a scenario."""

import numpy as np

from train_ato.api.scenario_choice import Changes, GivenScenario, choose_scenario
from train_ato.control.algorithms.linear_train import LinearTrain

MAX_SPEED_KMH = 1000.0
"""Largest speed [km/h]."""


def linearise(scenario: GivenScenario, *, speed_kmh: float, set: Changes | None = None) -> LinearTrain:
    """Return the linear model A, B, C, D of the nominal train of a scenario at a constant speed on level line.

    Parameters
    ----------
    scenario
        Shipped name, ``name:variant``, a YAML file, or :func:`train_ato.scenario`.
    speed_kmh
        Constant speed [km/h], above 0.
    set
        Other keys of the scenario, as for :func:`train_ato.run`.

    Returns
    -------
    LinearTrain
        Matrices with names and units, delays apart; ``poles``, ``response()``, ``scipy()``, ``control()``.

    Raises
    ------
    ValueError
        One line: bad scenario or speed.

    Examples
    --------
    Largest gain of a feedback of the speed through the delay [N/(m/s)], where the phase is -180 degrees:

    >>> import numpy as np, train_ato as ta
    >>> model = ta.linearise("xuzhou_metro", speed_kmh=60)
    >>> model.inputs, model.outputs[1]
    ((('unit_0_command', 'N'),), ('unit_0_speed', 'm/s'))
    >>> speed = model.response(np.geomspace(0.1, 10, 1000))[:, 1, 0]
    >>> crossing = np.flatnonzero(np.diff(np.unwrap(np.angle(speed)) > -np.pi))[0]
    >>> print(f"{1.0 / abs(speed[crossing]):.2e}")
    7.07e+05
    """
    if (
        isinstance(speed_kmh, bool)
        or not isinstance(speed_kmh, (int, float, np.number))
        or not 0.0 < speed_kmh <= MAX_SPEED_KMH
    ):
        raise ValueError(f"speed_kmh {speed_kmh!r}: give a speed above 0, at most {MAX_SPEED_KMH:g} km/h")
    return LinearTrain.of(choose_scenario(scenario).changed(set, None).prepare().model, speed_kmh / 3.6)
