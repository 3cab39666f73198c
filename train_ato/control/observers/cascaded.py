"""Cascaded observer of paper 002, eqs. (6)-(11), in sampled form, for every driven vehicle.

The observer estimates two disturbances. d2 is an acceleration of the vehicle. d1 is an offset between the speed of the
vehicle and the rate of its position.

Per unit, with the modelled acceleration a = (u_applied - couplers - resistance - shoes)/m::

    x' = v + d1,  v' = a + d2;     estimate = m (d2 + d1')

This is the force after the change of variable v~ = v + d1 of the paper (12), (35). The sampled forms are in `Cascade`.
``method: levant`` is best up to 1 ms, and `eso` is better for 10 ms and more. ``explicit`` is the printed form.
``unmatched: false`` omits d1, so that the estimate is m d2.

Needs: measured position, speed and force. As in `ndo`, the balance is that of every unit's vehicle if the coupler
forces are available, otherwise that of the train. The loop must be fast. With periods of 50 ms and more, or with
noise on the position, d1' is noise.
"""

import math
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_pow
from plant_sim.record import fill, quantity, zeros
from train_ato.control.algorithms.sliding import clamped, saturation
from train_ato.control.contract import choice, flag, parameter
from train_ato.control.observers.force_balance import BalanceConstants, ForceBalance
from train_ato.control.observers.record_observer import Body, ObserverForm, RecordObserver
from train_ato.control.train_model import TrainModel


@dataclass(frozen=True)
class CascadedParameters:
    """Parameters of :class:`Cascaded`."""

    method: str = choice(
        "implicit signs, Levant's differentiators, or explicit signs as in the paper", "implicit", "levant", "explicit"
    )
    k1: float = parameter(20.0, "m/s", 0.0, 1e4, "gain of the position channel")
    k2: float = parameter(20.0, "m/s²", 0.0, 1e4, "gain of the speed channel")
    k3: float = parameter(10.0, "1/s", 0.0, 1e4, "gain of the second stage")
    k4: float = parameter(100.0, "m/s²", 0.0, 1e5, "switching gain of the second stage")
    filter_time: float = parameter(0.02, "s", 0.0, 10.0, "low-pass filter of the switching signals")
    jerk_offset: float = parameter(100.0, "m/s³", 1e-6, 1e6, "bound of |d1''|, levant only")
    jerk: float = parameter(30.0, "m/s³", 1e-6, 1e6, "bound of |d2'|, levant only")
    unmatched: bool = flag("estimate the speed offset d1 as well", default=True)


@dataclass(frozen=True)
class CascadedConstants(CascadedParameters, BalanceConstants):
    """Constants of a cascade: its parameters, those of the balance and the values computed from them."""

    decay: float = quantity("1", "factor of the low-pass filters in a sample")
    layer: float = quantity("m", "boundary layer of the position, levant only")
    fast_layer: float = quantity("m/s", "boundary layer of the speed, levant only")
    root: float = quantity("(m/s³)^(1/3)", "third root of the bound of d1''")
    root_squared: float = quantity("(m/s³)^(2/3)", "its square")


@dataclass
class CascadeBody(Body):
    """State of a cascade."""

    position: float = quantity("m", "estimated position")
    velocity: float = quantity("m/s", "estimated speed")
    d1: float = quantity("m/s", "speed offset")
    d1_rate: float = quantity("m/s²", "its rate")
    d2: float = quantity("m/s²", "disturbance")
    offset: float = quantity("m/s", "filtered signal of the position, printed forms only")


@compiled
def explicit_cascade(p: CascadedConstants, own: CascadeBody, x: float, v: float, acceleration: float) -> None:
    """Update the observer (7), (11) as printed: explicit steps and sign functions."""
    h, decay = p.period, p.decay
    phi1, phi2 = p.k1 * saturation(x - own.position, 0.0), p.k2 * saturation(v - own.velocity, 0.0)
    own.position += h * (own.velocity + phi1)
    own.velocity += h * (acceleration + phi2)
    own.offset = decay * own.offset + (1.0 - decay) * phi1
    own.d2 = decay * own.d2 + (1.0 - decay) * phi2
    rate = p.k3 * (phi1 - own.d1) - p.k4 * saturation(own.d1 - own.offset, 0.0)
    own.d1 += h * rate
    own.d1_rate = decay * own.d1_rate + (1.0 - decay) * rate


@compiled
def implicit_cascade(p: CascadedConstants, own: CascadeBody, x: float, v: float, acceleration: float) -> None:
    """Update the observer (7), (11) with implicit signs."""
    h, decay = p.period, p.decay
    phi2 = clamped((v - own.velocity) / h - acceleration, -p.k2, p.k2)
    mean = own.velocity + 0.5 * h * (acceleration + phi2)
    phi1 = clamped((x - own.position) / h - mean, -p.k1, p.k1)
    own.position += h * (mean + phi1)
    own.velocity += h * (acceleration + phi2)
    own.offset = decay * own.offset + (1.0 - decay) * phi1
    own.d2 = decay * own.d2 + (1.0 - decay) * phi2
    free = own.d1 + h * p.k3 * (phi1 - own.d1)
    off = free - own.offset
    beyond = abs(off) - h * p.k4
    found = own.offset + (beyond if beyond > 0.0 else 0.0) * saturation(off, 0.0)
    rate = (found - own.d1) / h
    own.d1 = found
    own.d1_rate = decay * own.d1_rate + (1.0 - decay) * rate


@compiled
def levant_cascade(p: CascadedConstants, own: CascadeBody, x: float, v: float, acceleration: float) -> None:
    """Update robust exact differentiators of second and first order for the same quantities."""
    h = p.period
    mean = 0.5 * (v + own.speed)
    own.position += h * (mean + own.d1 + 0.5 * h * own.d1_rate)
    own.d1 += h * own.d1_rate
    miss = x - own.position
    size, direction = abs(miss), saturation(miss, p.layer)
    own.position += h * 2.0 * p.root * libm_pow(size, 2.0 / 3.0) * direction
    own.d1 += h * 2.12 * p.root_squared * libm_pow(size, 1.0 / 3.0) * direction
    own.d1_rate += h * 1.1 * p.jerk_offset * direction
    own.velocity += h * (acceleration + own.d2)
    miss = v - own.velocity
    direction = saturation(miss, p.fast_layer)
    own.velocity += h * 1.5 * math.sqrt(p.jerk * abs(miss)) * direction
    own.d2 += h * 1.1 * p.jerk * direction


def cascade_constants(parameters: CascadedParameters, period: float) -> dict[str, float]:
    """Return the constants that follow from the parameters and the sampling period [s]."""
    p = parameters
    root = p.jerk_offset ** (1.0 / 3.0)
    decay = math.exp(-period / p.filter_time) if p.filter_time > 0.0 else 0.0
    layers = {"layer": p.jerk_offset * period**3, "fast_layer": p.jerk * period * period}
    return {"decay": decay, "root": root, "root_squared": root**2, **layers}


def stepped(update: Any) -> Any:
    """Return the compiled step of a cascade: an update, or at the first sample the start."""

    @compiled
    def step(p: CascadedConstants, own: CascadeBody, x: float, v: float, acceleration: float) -> None:
        if own.known:
            update(p, own, x, v, acceleration)
        else:
            own.position, own.velocity = x, v
        own.speed, own.known = v, True

    return step


CASCADES = {
    name: stepped(update)
    for name, update in (("implicit", implicit_cascade), ("levant", levant_cascade), ("explicit", explicit_cascade))
}
"""Steps of the cascades by method."""


def _alone(step: Any) -> Any:
    @compiled
    def first(p: Any, state: Any, x: float, v: float, acceleration: float) -> None:
        step(p[0], state[0], x, v, acceleration)

    return first


_ALONE = {name: _alone(step) for name, step in CASCADES.items()}


def _estimate(name: str, meaning: str) -> Any:
    return property(lambda cascade: float(cascade.state[name][0]), doc=meaning)


class Cascade:
    """Cascade of one vehicle outside an observer.

    Plant, with d1 unmatched (m/s) and d2 matched (m/s²)::

        x' = v + d1,   v' = a + d2                                                           (6)

    The paper (7), (11): xh' = vh + phi1, phi1 = k1 sign(x - xh); vh' = a + phi2, phi2 = k2 sign(v - vh); d1h' = k3
    (phi1 - d1h) - k4 sign(d1h - d1), d2h = LPF(phi2). Its e3 = d1h - d1 contains the unknown d1. Here the filtered
    phi1 replaces it. The explicit form needs a very short step. It has 10 % error after 0.02 s at 10 µs and is
    useless at 50 ms. It is :func:`explicit_cascade`. Two sampled forms are better:

    * :func:`implicit_cascade`: the sign is the projection that brings the error to 0 within one sample, if k is
      sufficient;
    * :func:`levant_cascade`: robust exact differentiators of the same signals (d1 and d1' from x - int v, d2 from
      v - int a), best up to 1 ms.

    Parameters
    ----------
    parameters
        Method and gains.
    period
        Sampling period [s].
    """

    position: float = _estimate("position", "Estimated position [m].")
    velocity: float = _estimate("velocity", "Estimated speed [m/s].")
    d1: float = _estimate("d1", "Speed offset [m/s].")
    d1_rate: float = _estimate("d1_rate", "Rate of the speed offset [m/s²].")
    d2: float = _estimate("d2", "Disturbance [m/s²].")

    def __init__(self, parameters: CascadedParameters, period: float) -> None:
        self._constants, self.state = zeros(CascadedConstants, 1), zeros(CascadeBody, 1)
        balance = {field.name: 0.0 for field in fields(BalanceConstants)}
        more = cascade_constants(parameters, period)
        fill(self._constants, parameters, **{**balance, "period": period}, **more)
        self._step = _ALONE[parameters.method]

    def reset(self) -> None:
        """Restart at the next sample with estimates of 0."""
        self.state[:] = 0

    def restart(self) -> None:
        """Restart at the next sample with the present estimates."""
        self.state["known"] = False

    def step(self, x: float, v: float, acceleration: float) -> None:
        """Update the estimates by position [m], speed [m/s] and mean modelled acceleration of the sample [m/s²]."""
        self._step(self._constants, self.state, x, v, acceleration)


def cascaded_form(cascade: Any) -> ObserverForm:
    """Return the observer with a compiled step of a cascade."""

    @compiled
    def cascaded(
        p: CascadedConstants, own: CascadeBody, position: float, speed: float, driven: float, resistance: float
    ) -> float:
        cascade(p, own, position, speed, driven - 0.5 * (own.resistance + resistance))
        return own.d2 + (1.0 if p.unmatched else 0.0) * own.d1_rate

    return ObserverForm(cascaded, CascadedConstants, CascadeBody)


FORMS = {method: cascaded_form(step) for method, step in CASCADES.items()}
"""The observer by method."""


class Cascaded(RecordObserver):
    """Cascaded observer of matched and unmatched disturbance (paper 002)."""

    Parameters: ClassVar[type] = CascadedParameters

    def __init__(self, parameters: CascadedParameters, model: TrainModel, period: float) -> None:
        self.form = FORMS[parameters.method]
        balance = ForceBalance(model, "auto", 0.0, period)
        super().__init__(parameters, model, period, balance, **cascade_constants(parameters, period))
