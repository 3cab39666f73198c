"""Gains on speed and position error for a train: the loop that the gains ``model`` of every law share.

Near its reference a train is an integrator of the force behind the dead time theta = delay + lag + period, and every
law is a feed-forward with the feedback ``-M (kp e' + ki e)`` on the errors of speed and position. The rule of
Skogestad (SIMC, Journal of Process Control 13, 2003, table 1) for an integrator with dead time is kp = 1/(2 theta),
ki = kp/(8 theta). Elastic couplers lower kp:

* In a mode r of the couplers, of frequency w and damping zeta, the feedback through delay and lag has the phase phi(w)
  and the gain A(w). It adds the damping rate kp p A cos(phi)/2, with the part p = M sum s_i phi_r(i)² of the units of
  shares s_i in the mode. Beyond a quarter of a turn it excites the mode; kp is at most half of the limit
  2 zeta w/(p A |cos phi|), with a phase a fifth larger. A third of the damping by friction counts: a cycle from draft
  to buff through the slack has half of it. zeta is at least ``LEAST_DAMPING``: every gain excites a mode of springs
  without dampers, and the gain 0 loses the train.
  Half is a compromise, measured on random trains of `check-law`: with a quarter a train of 12 vehicles, whose couplers
  swing after two accelerations, exceeds its speed by 1.16 in place of 1.25 km/h under `pid`, and one of 89 vehicles
  stops .42 in place of .06 m beyond the target, under `lag_smc` 1.24 in place of .28 m.
* A group of power units is at most two thirds of the wave impedance of the hauled vehicles beside it.

ki is then at most kp²/4, which gives two equal poles.

Such a loop is slow: 82 wagons in linear gears without slack have kp = .015/s at a delay of 1.1 s. An error that the
feed-forward leaves lasts 4/kp. A reference that departs with the acceleration a before the first command acts leaves a
speed error a theta, so that a plan departs after delay and lag.

Gains of one's own are unstable (`is_unstable`) if one of these has no margin left: the train as one mass has no phase
left at the crossover of (kp s + ki)/s² with delay, lag and half of a period (for ki = 0 without lag: kp = pi/2 over the
delay); kp is beyond the limit of a mode; or the force half a turn behind is above the wave impedance. With `pid` under
`preview`, kp and ki in the ratio of the rule, on 16 trains (12 of `check-law`), the largest kp that was tracked was .45
to 1.08 of the limit, in steps of a factor of about 1.4.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from plant_sim.elementary import cos_each
from train_ato.control.algorithms.coupler_modes import TrainModes
from train_ato.control.algorithms.train_constants import MATCHED_SHARE, dead_time, wave_gain

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel

LARGEST_GAIN = 1.0
"""Largest gain on the speed error [1/s], for trains without dead time: above it the noise of the speed is the force."""
MODE_SHARE = 0.5
"""Gain over the one at which a mode is undamped."""
FRICTION_SHARE = 1.0 / 3.0
"""Part of the damping by friction that counts."""
LEAST_DAMPING = 0.001
"""Least damping ratio of a mode: half of it lets an undamped mode of 1 rad/s double in 23 min."""
PHASE_MARGIN = 1.2
"""Factor on the phase of delay and lag."""


@dataclass(frozen=True)
class LoopGains:
    """Gains of the common loop.

    Attributes
    ----------
    speed : float
        kp, on the speed error [1/s].
    position : float
        ki, on the position error [1/s²].
    dead_time : float
        theta [s].
    """

    speed: float
    position: float
    dead_time: float

    @classmethod
    def of(cls, model: TrainModel, period: float) -> LoopGains:
        """Return the gains for a train and a control period [s]."""
        theta = dead_time(model) + period
        kp = min(
            LARGEST_GAIN, 1.0 / (2.0 * theta), wave_gain(model, MATCHED_SHARE),
            MODE_SHARE * _gain_of_modes(model, TrainModes.of(model), 0.5 * period, PHASE_MARGIN),
        )  # fmt: skip
        return cls(kp, min(kp / (8.0 * theta), 0.25 * kp * kp), theta)


def is_unstable(law: Any, model: TrainModel, period: float) -> bool:
    """Return True if a law states gains on the errors of speed and position that are unstable on a train."""
    gains = law.feedback() if hasattr(law, "feedback") else None
    return gains is not None and any(gains) and not is_stable(model, period, *gains)


def is_stable(model: TrainModel, period: float, speed: float, position: float) -> bool:
    """Return True if a feedback is stable as far as train, couplers, delay and lag of the model say.

    Parameters
    ----------
    model
        The train.
    period
        Control period [s].
    speed, position
        Gains on the errors of speed [1/s] and position [1/s²].
    """
    delay, lag = dead_time(model) - model.lag + 0.5 * period, model.lag
    crossover = _root(
        lambda w: w**4 * (1.0 + (w * lag) ** 2) - (speed * w) ** 2 - position**2, speed + math.sqrt(position)
    )
    if crossover * delay + math.atan(crossover * lag) > math.atan2(speed * crossover, position):
        return False
    turned = _root(lambda w: w * delay + math.atan(w * lag) - math.pi, math.pi / delay)
    modes = TrainModes.of(model)
    reflects = modes.omega.max(initial=0.0) > turned
    wave = wave_gain(model, 1.0) * math.hypot(1.0, turned * lag) if reflects else math.inf
    return speed <= min(wave, _gain_of_modes(model, modes, 0.5 * period))


def _root(function: Callable[[float], float], high: float) -> float:
    """Return the root of a function that is negative from 0 up to it, and not from there to ``high`` on."""
    low = 0.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if function(middle) < 0.0 else (low, middle)
    return low


def _gain_of_modes(model: TrainModel, modes: TrainModes, sampling: float, margin: float = 1.0) -> float:
    """Return the gain on the speed error at which a mode of the couplers is undamped [1/s], infinite without one.

    Parameters
    ----------
    model, modes
        The train, and its modes.
    sampling
        Mean delay by the sampling [s].
    margin
        Factor on the phase.
    """
    lagging = modes.omega * model.lag
    phase = modes.omega * (dead_time(model) - model.lag + sampling) + np.array(list(map(math.atan, lagging.tolist())))
    excited = -cos_each(np.minimum(margin * phase, math.pi))
    rate = modes.omega * np.maximum(modes.viscous + FRICTION_SHARE * modes.friction, LEAST_DAMPING)
    reached = model.inertia * modes.units * excited / np.sqrt(1.0 + lagging * lagging)
    return float((2.0 * rate[reached > 0.0] / reached[reached > 0.0]).min(initial=math.inf))
