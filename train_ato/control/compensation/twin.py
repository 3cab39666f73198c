"""Twin: feed-forward from a simulated copy of the whole nominal train that runs ahead of the real one.

The most accurate compensation here for long trains: with it, a `pid` with low gains corrects only the error of the
model.

The feed-forward of a rigid mass does not suit a long train. The twin is the nominal multi-mass train, with ideal
actuators and the same brake policy, driven along the profile by inverse dynamics at every unit::

    u_i = .99 FC_i + W_i + Fa_i + m_i [v_d' - l1 (v_i - v_d) - l2 (x_i - x_d)]

Here FC are the coupler forces, W the resistance and Fa the shoe forces of the twin itself. With the whole FC a unit
would have exactly the speed of the profile. It would reflect a wave in the couplers like a fixed end, and the wave
would last for minutes. Without 1 % of FC the unit yields to the wave and damps it. The twin is simulated tau + Ta
ahead, and its force of that time is the feed-forward::

    u_ff(t) = u_twin(t + tau + Ta)

The state stays as measured; the law corrects the remaining error. If the delay of a unit depends on the sign of the
command, the delay for the sign of its force is used.

``identify`` compares the measured force and speed of the train with those of the twin (`train_identification.py`). The
result is the errors of mass, running resistance and air brake of the model and the wear of its draft gears. The twin
receives them once a second. A twin with the right forces also stretches its couplers like the train. An additional
force on a rigid train cannot do this. A second copy with worn gears (`ahead_train.py`) gives the effect of wear.

Needs: consist and line of the model, because all vehicles are simulated. A law that uses the feed-forward (`pid`,
`rbf_switching_smc`, `smc` with ``equivalent: feedforward``). Other laws are rejected, because the compensation has no
effect on them.
"""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from plant_sim.elementary import mean_over_units, plain_dot, total_of_units
from train_ato.control.air_brake.record_policy import BrakePolicy
from train_ato.control.algorithms.train_identification import WEAR, TrainIdentification
from train_ato.control.compensation.ahead_train import AheadTrain, TwinParameters
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.compensation.preview import PreviewFeedforward, mean_delay
from train_ato.control.contract import LawInput, Lookahead
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array

CORRECTION_TIME = 1.0
"""Time from one correction of the model of the twin to the next [s]."""
WEAR_TIME = 60.0
"""Time constant with which the twin receives the wear [s]: three of the loop that holds the copy with worn gears, since
the speeds of train and copy at a time contain the wear of the twin over the time before."""


class Twin(PreviewFeedforward):
    """Feed-forward from a simulated nominal train ahead of the real one."""

    Parameters: ClassVar[type] = TwinParameters
    feedforward_only: ClassVar[bool] = True
    simulates_train: ClassVar[bool] = True

    def __init__(self, parameters: TwinParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._delays = [*zip(self.actuators["forward"].tolist(), self.actuators["backward"].tolist(), strict=True)]
        self._longest = max(map(max, self._delays))
        self._policy: BrakePolicy | None = None
        self._ahead: AheadTrain
        self.started = False
        self._identification = TrainIdentification(period) if parameters.identify else None
        self._last = 0.0
        self._windows: list[tuple[int, int]] = []

    def set_brake_policy(self, policy: BrakePolicy) -> None:
        """Set the policy for the air brake of the twin."""
        self._policy = policy

    def reset(self) -> None:
        """Discard the twin; the next step starts a new one."""
        super().reset()
        self.started = False
        if self._identification is not None:
            self._identification = TrainIdentification(self.period)

    def step(self, inputs: CompensationInput) -> LawInput:
        """Return the measured state with the force of the twin at the time of effect."""
        t = inputs.t
        self.shoes.demand(t, inputs.pressure)
        if not self.started:
            self._ahead = AheadTrain(self.model.without_learned, self.rigid.profile, self.parameters, self._policy, t)
            self.started = True
        shoes = self.shoes.at(t, inputs.reference.velocity)
        self._ahead.forget()
        force = self._read(t)
        if self._identification is not None:
            self._identify(self._identification, inputs, shoes.total)
        return self.law_input(inputs, t + mean_delay(self.actuators, inputs.commands_in_flight), force, shoes)

    def _identify(self, identification: TrainIdentification, inputs: CompensationInput, shoes: float) -> None:
        """Compare train and twin now, and correct the twin once a ``CORRECTION_TIME``."""
        model, t, now = self.model, inputs.t, inputs.reference
        if abs(t - self._last - self.period) > 0.5 * self.period:
            identification.miss()
        speed = mean_over_units(self.model.share.tolist(), inputs.measurement.velocity.tolist())
        running = model.running_resistance(now.velocity)
        change, wave = self._ahead.by_wear(t)
        known = [model.inertia * now.acceleration + model.line_force(now.position), running, shoes, change]
        force = total_of_units(inputs.measurement.applied) - total_of_units(self._forces_at(t))
        force -= model.running_resistance(speed) - running
        force += plain_dot(self._ahead.errors, known)
        error = speed - now.velocity + self._ahead.errors[WEAR] * wave
        identification.step(error, now.velocity, force / model.inertia, np.array(known) / model.inertia, wave)
        if int(t / CORRECTION_TIME + 1e-9) != int(self._last / CORRECTION_TIME + 1e-9):
            errors, wear = identification.errors, self._ahead.errors[WEAR]
            errors[WEAR] = wear + CORRECTION_TIME / WEAR_TIME * (errors[WEAR] - wear)
            self._ahead.correct(errors)
        self._last = t

    def _forces_at(self, t: float) -> Array:
        """Return the force of every unit of the twin at a time from the last step on [N], shape (units,)."""
        return np.array([self._force(unit, t) for unit in range(self.model.n_units)])

    def _lookahead(self, inputs: CompensationInput, effect: float, later: Array) -> Lookahead:
        """Return the lookahead with the force of the twin until the last command takes effect."""
        times = later[later <= self._longest + self.lag + 1e-9].tolist()
        force = np.array([total_of_units(self._forces_at(inputs.t + time)) for time in times])
        return replace(super()._lookahead(inputs, effect, later), simulated_force=force)

    def feedforwards(self, times: Array, shoes: Array) -> Array:
        """Return the feed-forward at consecutive times [N], shape (times, units); :meth:`rewind` makes some unread."""
        self._ahead.forget()
        found, self._windows = np.empty((times.size, self.model.n_units)), []
        for index, t in enumerate(times.tolist()):
            self._windows.append(self._ahead.window)
            found[index] = self._read(t)
        return found

    def rewind(self, read: int) -> None:
        """Set the twin to its state after the first ``read`` times of the last :meth:`feedforwards`."""
        windows, self._windows = self._windows, []
        if read < len(windows):
            self._ahead.window = windows[read]

    def _read(self, t: float) -> Array:
        self._ahead.profile = self.rigid.profile
        self._ahead.run(t + self._longest + self.lag, keep_from=t)
        wanted = []
        for unit, (forward, backward) in enumerate(self._delays):
            force = self._force(unit, t + forward + self.lag)
            if force < 0.0 and backward != forward:
                force = min(0.0, self._force(unit, t + backward + self.lag))
            wanted.append(force)
        return np.array(wanted)

    def _force(self, unit: int, t: float) -> float:
        """Return the force of a unit of the twin at a time [s], with its share of the learned force [N]."""
        force: float = self._ahead.force(unit, t)
        if self.model.learned is None:
            return force
        share = self.model.share.item(unit)
        return force + share * self.model.learned_force(self.rigid.profile.at(t)[0])
