"""Gains on speed and position error for a train: the loop that the gains ``model`` of every law share.

Near its reference a train is an integrator of the force behind the dead time theta = delay + lag + period. Every law is
a feed-forward with the feedback ``-M (kp e' + ki e)`` on the errors of speed and position. For an integrator with dead
time the rule of Skogestad (SIMC, Journal of Process Control 13, 2003, table 1) is kp = 1/(2 theta), ki = kp/(8 theta).
Elastic couplers lower kp:

* A mode r of the couplers has the frequency w and the damping zeta. In it the feedback through delay and lag has the
  phase phi(w) and the gain A(w). It adds the damping rate kp p A cos(phi)/2. Here p = M sum s_i phi_r(i)² is the part
  of the units with the shares s_i in the mode. Beyond a quarter of a turn the feedback excites the mode. kp is at most
  half of the limit 2 zeta w/(p A |cos phi|), with a phase a fifth larger. The damping by friction counts a third,
  because a cycle from draft to buff through the slack has only half of it. zeta is at least ``MIN_DAMPING``. Without
  this bound every gain would excite a mode of springs without dampers, and the gain 0 loses the train. Half is a
  compromise, measured on random trains of `check-law`. With a quarter a train of 12 vehicles, whose couplers swing
  after two accelerations, exceeds its speed by 1.16 instead of 1.25 km/h under `pid`. But a train of 89 vehicles stops
  .42 instead of .06 m beyond the target, and under `lag_smc` 1.24 instead of .28 m.
* A group of power units is at most two thirds of the wave impedance of the hauled vehicles beside it.

ki is then at most kp²/4, which gives two equal poles.

Such a loop is slow: 82 wagons in linear gears without slack have kp = .015/s at a delay of 1.1 s. An error that the
feed-forward leaves lasts 4/kp. A reference that departs with the acceleration a before the first command acts leaves a
speed error a theta, so that a plan departs after delay and lag.

Own gains can be unstable or close to it (`is_unstable`). H(s) is the response of the force over the inertia to the
speed error, through delay, lag and half of a period. The gains are named in two cases:

* the train as one mass is unstable: s + H(s) has a root with a positive real part. A predicted state has no delay
  there;
* a mode of the couplers gains more by -Re H than it loses; or
* -Re H M at a mode is above .547 of the wave impedance Z of the hauled vehicles. A locomotive of mass m with slack in
  its couplers oscillates where j w m + M H + N Z = 0. N is the mean of Z over a cycle through the slack, and it grows
  with the amplitude up to 1. For every -Re H M < Z there is therefore a cycle, and above Z there is no bound. A small
  cycle stays in the slack, and every gain that controls such a train has it while the train coasts. 48 runs of `demo`
  and `daqin_heavy_haul` with six laws gave the bound. All 23 runs below it were tracked, 4 of 14 up to .7 of Z, and
  none of 11 above. The others had a limit cycle of more than a tenth of the largest force. Other trains differ: 95
  vehicles with a dead time of .36 s were tracked up to .9. 11 vehicles have a cycle of 77 kN at .31, without a line of
  warning. The modulus margin of the loop with linear couplers separates no better. Prediction as a rigid train does not
  help, because its loop has the same limit.

H is (kp s + ki)/(s (1 + s lag)) with the delay for all laws with gains on the errors of speed and position. `smc`,
`rbf_smc`, `lag_smc` and `gpc` state their own. For `mpc`, whose observer has the modes, no limit is derived: on `demo`
3.4 times the default of ``omega`` is tracked.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant_sim.elementary import cos_each
from train_ato.control.algorithms.coupler_modes import TrainModes
from train_ato.control.algorithms.train_constants import MATCHED_SHARE, dead_time, wave_gain
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array

JUDGED_ERROR = 0.35
"""Error [m] at which a gain that depends on it is judged; with equal gains that of `fixed_time_smc` is least there."""
MAX_GAIN = 1.0
"""Largest gain on the speed error [1/s], for trains without dead time: above it the noise of the speed is the force."""
MODE_SHARE = 0.5
"""Gain over the one at which a mode is undamped."""
FRICTION_SHARE = 1.0 / 3.0
"""Part of the damping by friction that counts."""
MIN_DAMPING = 0.001
"""Least damping ratio of a mode: half of it lets an undamped mode of 1 rad/s double in 23 min."""
WAVE_SHARE = 0.547
"""Force that drives a wave over the wave impedance, above which the units can swing in the slack."""
PHASE_MARGIN = 1.2
"""Factor on the phase of delay and lag."""

Complex = NDArray[np.complexfloating[Any, Any]]
Response = Callable[[Complex, Complex], tuple[Complex, Complex]]


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
            MAX_GAIN, 1.0 / (2.0 * theta), wave_gain(model, MATCHED_SHARE),
            MODE_SHARE * _gain_of_modes(model, TrainModes.of(model), 0.5 * period),
        )  # fmt: skip
        return cls(kp, min(kp / (8.0 * theta), 0.25 * kp * kp), theta)


def is_unstable(law: Any, model: TrainModel, period: float, *, predicted: bool = False) -> bool:
    """Return True if a law states a feedback that is unstable on a train.

    Parameters
    ----------
    law
        With ``response(predicted)`` or ``feedback()``, gains on the errors of speed and position; others are silent.
    model, period
        The train, and the control period [s].
    predicted
        The law has the state of a rigid train at the time of effect.
    """
    if hasattr(law, "response"):
        response = law.response(predicted)
    else:
        gains = law.feedback() if hasattr(law, "feedback") else None
        response = feedback_of(gains[0], gains[1], model.lag) if gains is not None and any(gains) else None
    return response is not None and not is_stable(model, period, response, predicted=predicted)


def feedback_of(speed: float, position: float, lag: float) -> Response:
    """Return the response of gains on the errors of speed [1/s] and position [1/s²] through a lag [s]."""
    return lambda s, late: ((speed * s + position) * late, s * (1.0 + lag * s))


def is_stable(model: TrainModel, period: float, response: Response, *, predicted: bool = False) -> bool:
    """Return True if a feedback is stable as far as train, couplers, delay and lag of the model say.

    Parameters
    ----------
    model
        The train.
    period
        Control period [s].
    response
        Response N/D of the force over the inertia to the speed error, for s and exp(-s delay).
    predicted
        The state is that of a rigid train at the time of effect.
    """
    delay = dead_time(model) - model.lag
    s = 1j * np.geomspace(1e-4, 1e3, 16000)
    if not _holds_mass(response, s, 0.5 * period + (0.0 if predicted else delay)):
        return False
    modes = TrainModes.of(model)
    if not modes.omega.size:
        return True
    above, below = response(s, np.exp(-s * (delay + 0.5 * period)))
    phase, gain = -np.unwrap(np.angle(above / below)), np.abs(above / below)
    against = np.interp(modes.omega, s.imag, -gain * np.cos(np.minimum(phase, math.pi)))
    excited = 0.5 * model.inertia * modes.units * against
    return bool((excited <= _decay(modes)).all() and against.max() <= wave_gain(model, WAVE_SHARE))


def _holds_mass(response: Response, s: Complex, delay: float) -> bool:
    """Return True if no root of s D + N has a positive real part: the phase on the imaginary axis is n pi/2."""
    above, below = response(s, np.exp(-s * delay))
    far = np.array([1e6j, 1e7j])
    order = round(math.log10(np.divide(*np.abs(far * response(far, np.zeros(2, complex))[1])[::-1])))
    turned = np.unwrap(np.angle(s * below + above))
    return bool(turned[0] < 0.75 * math.pi and turned[-1] > 0.5 * math.pi * order - 0.75 * math.pi)


def _decay(modes: TrainModes) -> Array:
    """Return the rate at which every mode decays [1/s]."""
    return modes.omega * np.maximum(modes.viscous + FRICTION_SHARE * modes.friction, MIN_DAMPING)


def _gain_of_modes(model: TrainModel, modes: TrainModes, sampling: float) -> float:
    """Return the gain on the speed error at which a mode of the couplers is undamped [1/s], infinite without one.

    ``sampling`` is the mean delay by the sampling [s]. The phase has the factor :data:`PHASE_MARGIN`.
    """
    lagging = modes.omega * model.lag
    phase = modes.omega * (dead_time(model) - model.lag + sampling) + np.array(list(map(math.atan, lagging.tolist())))
    excited = -cos_each(np.minimum(PHASE_MARGIN * phase, math.pi))
    rate = _decay(modes)
    reached = model.inertia * modes.units * excited / np.sqrt(1.0 + lagging * lagging)
    return float((2.0 * rate[reached > 0.0] / reached[reached > 0.0]).min(initial=math.inf))
