"""Fixed-time sliding mode with an alternating surface per vehicle, paper 002, eqs. (12)-(36).

Every vehicle is driven and keeps its position in the train. It uses its own state, the states of its neighbours and a
virtual leader. The settling time does not depend on the initial error; the force does.

Per unit i, x*_i = x_r minus its offset, all terms as accelerations::

    E = x - x*,  E' = v + d1_hat - v_r,  S = E' + S_au(E)                                            (17), (18)
    a = -known - d_hat/m + x_r'' - (dS_au/dE) E' - alpha2 sig^p2(S) - beta2 sig^g2(S)                (14), (36)
    S_au = alpha1 sig^m1(E) + beta1 E                    for |E| > eps                               (19)
           l1 E + l2 sig^m2(E)                           otherwise
    l1 = (alpha1 eps^(m1-1) + beta1)/2,  l2 = (alpha1 eps^(m1-m2) + beta1 eps^(1-m2))/2              (20)
    known = -(couplers to the neighbours + resistance + shoes)/m

sig^p(z) = |z|^p sign z, m2 = p2 = 5/7, m1 = g2 = 5/3, eps = 1 m. The observer's d_hat is m (d2 + d1').

Corrections: x_r'' is missing in the paper. (20) joins the branches smoothly only for eps = 1 and alpha1 = beta1, so
that each pair is one gain. In the derivative of the fractional power |E| is at least 1e-3. A speedometer does not
measure the speed offset d1_hat. It is estimated from position and speed (``unmatched``). x -> x_r and v -> v_r are
incompatible while it is not 0.

``states: estimated`` is (36) as printed. A cascade (7), (11) inside the law estimates x, v, d1, d1' and d2, also for
the forces of the couplers, and d_hat is not used. The default uses the measured x and v and d_hat of the observer node.
The graph of the paper is the chain of the train. There are no links between the cars. The message of the plant has the
states of the neighbours.

The gain 50 of the paper settles 108 m in 0.06 s and needs 1.6e10 m/s². The paper states 1.7 s. Gains from 1.7 to 2 give
this time and still need 2e6 m/s². A real train (0.5 m/s², lag, delay) needs 0.3 with `eso`, and is unstable for delays
of 0.6 s and more: see `lag_smc`. ``equivalent: feedforward`` is for such trains. The feed-forward then replaces x_r''
and -known, and the inertia of the train replaces that of the vehicle.

Gains of the model: ``equivalent: feedforward``, and one gain g for surface and reaching law. For errors of the size z
(in m and m/s) kp = g (1 + 1.43 z^(-2/7) + 1.67 z^(2/3)). This is 4.1 g at 1, 4.1 g at .1 and 6.4 g at .01. The rule is
g = kp/5 with the kp of `pid` on the same train. The law is then below the limit of stability, 3.1 kp, for all errors
above .3 mm and .3 mm/s.

Needs: with ``equivalent: measured`` the force of every coupler beside a power unit. A train of driven vehicles with
linear draft gears without slack gives it (one vehicle is sufficient), and so do sensors. The error message names the
missing couplers. An observer for d_hat (`cascaded`, `eso`). Compensations that give only a feed-forward are rejected.
With ``equivalent: feedforward`` any train.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_pow
from plant_sim.record import Records, quantity
from train_ato.control.algorithms.couplers import UnitCouplers
from train_ato.control.algorithms.loop_gains import JUDGED_ERROR, LoopGains
from train_ato.control.algorithms.luenberger import Tracked, luenberger_gains, unknown_rate
from train_ato.control.algorithms.sliding import sig
from train_ato.control.contract import LawInput, RefusedParameter, choice, flag, parameter
from train_ato.control.gains import gains_choice
from train_ato.control.guard import is_valid
from train_ato.control.law import LawForm, LawNow, LawUnit, RecordLaw
from train_ato.control.observers.cascaded import Cascade, CascadedParameters
from train_ato.control.train_model import TrainModel

LARGE, SMALL = 5.0 / 3.0, 5.0 / 7.0
"""Exponents m1 = g2 and m2 = p2."""
BRANCH_ERROR = 1.0
"""eps, error at which the surface changes its branch [m]."""
MIN_ERROR = 1e-3
"""Smallest |E| in the derivative of the fractional power [m]."""


@dataclass(frozen=True)
class FixedTimeSmcParameters:
    """Parameters of :class:`FixedTimeSmc`."""

    gains: str = gains_choice()
    surface: float = parameter(0.3, "1/s", 0.0, 1e3, "alpha1 = beta1, gain of the surface; 50 in the paper")
    reaching: float = parameter(0.3, "1/s", 0.0, 1e3, "alpha2 = beta2, gain of the reaching law; 50 in the paper")
    unmatched: bool = flag("estimate the speed offset d1 between position and speed", default=False)
    states: str = choice(
        "x and v of (36): measured, or estimates of the cascade as in the paper", "measured", "estimated"
    )
    offset_bandwidth: float = parameter(10.0, "1/s", 1e-3, 1e6, "bandwidth of the estimate of d1")
    equivalent: str = choice(
        "equivalent control from couplers and resistance, or from the feed-forward", "measured", "feedforward"
    )


@dataclass(frozen=True)
class FixedTimeSmcConstants(FixedTimeSmcParameters):
    """Constants of :func:`fixed_time_smc`: its parameters and the values computed from them."""

    measured: bool = quantity("", "the equivalent control is that of the measured forces")
    tracks: bool = quantity("", "d1 is estimated here, from the measured states")
    value_gain: float = quantity("1", "gain of the estimate of d1 on the position")
    rate_gain: float = quantity("1/s", "gain of the estimate of d1")
    period: float = quantity("s", "control period")


@dataclass
class FixedTimeSmcUnit(Tracked):
    """State of :func:`fixed_time_smc` for one unit; ``unknown_rate`` is its d1 [m/s]."""

    mass: float = quantity("kg", "mass of the unit's vehicle, or its share of the train's inertia")
    speed: float = quantity("m/s", "speed of the last step")


@compiled
def alternating(error: float, gain: float) -> tuple[float, float]:
    """Return S_au [m/s] and dS_au/dE [1/s] for alpha1 = beta1 = gain [1/s] and eps = 1 m."""
    size = abs(error) if abs(error) >= MIN_ERROR else MIN_ERROR
    if abs(error) > BRANCH_ERROR:
        return gain * (sig(error, LARGE) + error), gain * (LARGE * libm_pow(size, LARGE - 1.0) + 1.0)
    return gain * (error + sig(error, SMALL)), gain * (1.0 + SMALL * libm_pow(size, SMALL - 1.0))


@compiled
def speed_offset(p: FixedTimeSmcConstants, own: FixedTimeSmcUnit, x: LawUnit) -> float:
    """Return the estimate of d1 in x' = v + d1 [m/s] after a sample."""
    before = own.speed if own.known else x.velocity
    own.speed = x.velocity
    return float(unknown_rate(own, p.period, p.value_gain, p.rate_gain, x.position, 0.5 * (x.velocity + before)))


@compiled
def fixed_time_smc(
    p: FixedTimeSmcConstants, state: Records[FixedTimeSmcUnit], now: LawNow, units: Records[LawUnit]
) -> None:
    """Compute the demand of the fixed-time sliding mode: (36) [N]."""
    for u in range(units.size):
        x, own = units[u], state[u]
        offset = speed_offset(p, own, x) if p.tracks else own.unknown_rate
        rate = x.velocity + offset - x.reference_velocity
        auxiliary, slope = alternating(x.position - x.reference_position, p.surface)
        surface = rate + auxiliary
        pull = -slope * rate - p.reaching * (sig(surface, SMALL) + sig(surface, LARGE))
        equivalent = x.feedforward
        if p.measured:
            equivalent = x.coupler_force + x.resistance + x.shoe_force
            pull += now.acceleration_at_effect
        x.wanted = equivalent - x.disturbance + own.mass * pull


class FixedTimeSmc(RecordLaw):
    """Fixed-time sliding mode per vehicle, with the states of its neighbours (paper 002)."""

    Parameters: ClassVar[type] = FixedTimeSmcParameters
    form = LawForm(fixed_time_smc, FixedTimeSmcConstants, FixedTimeSmcUnit)
    uses_train_forces = False

    @classmethod
    def model_gains(cls, model: TrainModel, period: float) -> dict[str, Any]:
        """Return the parameters with the bandwidth of `pid` on the same train."""
        gain = LoopGains.of(model, period).speed / 5.0
        return {"equivalent": "feedforward", "surface": gain, "reaching": gain}

    def __init__(self, parameters: FixedTimeSmcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        measured, estimated = parameters.equivalent == "measured", parameters.states == "estimated"
        self.uses_effect = measured
        self.uses_feedforward, self.feedforward_hint = not measured, "equivalent: feedforward"
        self._beside = UnitCouplers(model)
        if (measured or estimated) and self._beside.unknown:
            setting = "equivalent: feedforward" if measured else "states: measured"
            raise RefusedParameter(
                f"{'equivalent: measured' if measured else 'states: estimated'} needs the force of "
                f"{self._beside.unknown_names()} beside driven vehicles",
                setting,
                f"drive every vehicle with linear draft gears between them, or {self._beside.sensors_text()}",
            )
        self.couplers = self._beside if measured else None
        self._estimators = [Cascade(CascadedParameters(), period) for _ in range(self.n)] if estimated else []
        self.in_loop = not estimated
        self._modelled: list[float] | None = None
        self.state["mass"] = model.unit_inertia if measured else model.inertia * model.share
        value_gain, rate_gain = luenberger_gains(parameters.offset_bandwidth, period)
        self.set_constants(
            measured=measured, tracks=parameters.unmatched and not estimated, value_gain=value_gain, rate_gain=rate_gain
        )

    def feedback(self) -> tuple[float, float] | None:
        """Return the gain on the speed error [1/s] for ``JUDGED_ERROR``, and 0; None for measured couplers."""
        p, error = self.parameters, JUDGED_ERROR
        surface, reaching = SMALL * error ** (SMALL - 1.0), LARGE * error ** (LARGE - 1.0)
        gain = p.surface * (1.0 + surface) + p.reaching * (surface + reaching)
        return None if p.equivalent == "measured" else (gain, 0.0)

    def clear_state(self) -> None:
        """Clear the speed offsets and the estimates."""
        super().clear_state()
        for estimator in self._estimators:
            estimator.reset()
        self._modelled = None

    def on_missed_sample(self) -> None:
        """Handle a missed sample: the gap does not change the speed offsets."""
        super().on_missed_sample()
        for estimator in self._estimators:
            estimator.restart()
        self._modelled = None

    def call(self, inputs: LawInput) -> int:
        """Step the law, with ``states: estimated`` on the estimates of the cascades."""
        return super().call(self._estimated(inputs) if self._estimators and is_valid(inputs) else inputs)

    def _estimated(self, inputs: LawInput) -> LawInput:
        """Return the inputs with the estimates of position, speed and disturbance of the cascades."""
        masses = self.model.unit_inertia.tolist()
        units = self.units
        units["position"], units["velocity"] = inputs.position, inputs.velocity
        self._beside.write(inputs.coupler_force, units)
        opposing = units["coupler_force"] + units["resistance"] + inputs.shoe_force
        now = ((inputs.applied - opposing) / self.model.unit_inertia).tolist()
        before = self._modelled or now
        self._modelled = now
        measured = zip(inputs.position.tolist(), inputs.velocity.tolist(), strict=True)
        for unit, (x, v) in enumerate(measured):
            self._estimators[unit].step(x, v, 0.5 * (before[unit] + now[unit]))
        if self.parameters.unmatched:
            self.state["unknown_rate"] = [found.d1 for found in self._estimators]
        return replace(
            inputs,
            position=np.array([found.position for found in self._estimators]),
            velocity=np.array([found.velocity for found in self._estimators]),
            disturbance=np.array(
                [m * (found.d2 + found.d1_rate) for m, found in zip(masses, self._estimators, strict=True)]
            ),
        )
