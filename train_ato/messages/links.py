"""Transport delays on topics: queues with simulation stamps as keys.

A value arrives one delay after its stamp.  The delay is constant per unit and per sign of the command (traction and
brake may differ), or varies with time at the receiver (paper 003: u(t - tau(t)), tau = 0.2 |sin t|).  Jitter and loss
use a seeded random stream.  A newer value that arrives first replaces older values in flight.  Engine and nodes use the
same class, so that every mode of running gives the same numbers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from plant_sim.elementary import sin_each
from plant_sim.si_model import SiModel
from plant_sim.streams import random_stream
from plant_sim.units import Ratio, Time
from train_ato.messages.types import Array

MAX_DELAY = 600.0
"""Maximum delay of a topic [s]."""
BLOCK = 64
"""Number of calls for which a varying delay is computed at once."""
NO_JUMP = 2**62
"""Time of a jump that does not happen [ns]."""
NEVER = 1e6
"""Delay of a command that does not arrive in any run [s]; a product of factors can exceed every number."""


class VaryingDelay(SiModel):
    """Delay varying at the receiver: ``amplitude |sin(omega t + phase)|``, added to the constant delay."""

    amplitude: Time = Field(ge=0, le=MAX_DELAY)
    omega: float = Field(1.0, gt=0, description="rad/s")
    phase: float = Field(0.0, description="rad")


class DelayJump(SiModel):
    """Change of the delays at a time: delay x product of all factors + sum of all ``add`` of the changes so far."""

    at: Time = Field(ge=0)
    factor: float = Field(1.0, ge=0, le=1000)
    add: Time = Field(0.0, ge=-MAX_DELAY, le=MAX_DELAY)


class LinkSpec(SiModel):
    """Delay of one topic; ``delay`` is one value for all units or one per unit."""

    delay: Time | tuple[Time, ...] = Field(0.0, description="delay; of commands: in traction")
    delay_brake: Time | tuple[Time, ...] | None = Field(None, description="delay of commands < 0; default: delay")
    varying: VaryingDelay | None = None
    jitter: Time = Field(
        0.0, ge=0, le=MAX_DELAY, description="upper bound of an additional, uniformly distributed delay"
    )
    loss: Ratio = Field(0.0, ge=0, lt=1, description="probability of losing a message; the last value is held")
    jump: DelayJump | None = None

    def per_unit(self, width: int, block: str) -> tuple[Array, Array]:
        """Return the delays of every unit in traction and in braking [s], shape (width,) each.

        Raises
        ------
        ValueError
            If the length of a list is not the number of units, or a delay is negative or too long.
        """
        traction = _for_units(self.delay, width, f"{block}.delay")
        if self.delay_brake is None:
            return traction, traction
        return traction, _for_units(self.delay_brake, width, f"{block}.delay_brake")

    def newest(self) -> LinkSpec:
        """Return the parameters of a link of width 1 that delivers with the slowest unit."""
        values = [value for value in (self.delay, self.delay_brake) if value is not None]
        delay = max(max(value, default=0.0) if isinstance(value, tuple) else value for value in values)
        return self.model_copy(update={"delay": delay, "delay_brake": None})

    @property
    def longest(self) -> float:
        """Largest delay without jumps [s]."""
        delay = self.newest().delay
        assert isinstance(delay, (int, float))
        return delay + self.jitter + (0.0 if self.varying is None else self.varying.amplitude)


def _for_units(value: float | tuple[float, ...], width: int, key: str) -> Array:
    values = (value,) * width if isinstance(value, (int, float)) else value
    if len(values) != width:
        raise ValueError(f"{key}: {len(values)} values for {width} units; give one value or {width}")
    if min(values, default=0.0) < 0:
        raise ValueError(f"{key}: {min(values)} s is negative; give 0 or more")
    if max(values, default=0.0) > MAX_DELAY:
        raise ValueError(f"{key}: {max(values):g} s is longer than {MAX_DELAY:g} s; check its unit")
    return np.array(values, dtype=np.float64)


class PackedQueues(NamedTuple):
    """Queues of a link as arrays: stamps of arrival [ns] and values, shape (width, room); see :meth:`Link.packed`.

    ``bounds`` are first entry and end of every queue, shape (2, width); ``held`` are the values that arrived last.
    """

    due: NDArray[np.int64]
    value: Array
    bounds: NDArray[np.int64]
    held: Array


class Link:
    """A delay line for vectors of ``width`` values.

    Parameters
    ----------
    spec
        Parameters of the delay.
    width
        Number of units, each with its own queue.
    step_ns
        Grid of the delays [ns]: the step of the plant.
    seed, name
        Seed and key of the random stream.
    initial
        Value of every unit before the first arrival.
    """

    def __init__(self, spec: LinkSpec, width: int, step_ns: int, seed: int, name: str, *, initial: float = 0.0) -> None:
        self.spec = spec
        self._step = step_ns
        traction, brake = spec.per_unit(width, f"links.{name}")
        self._forward = [float(delay) for delay in traction]
        self._backward = [float(delay) for delay in brake]
        self._in_flight: list[deque[tuple[int, float]]] = [deque() for _ in range(width)]
        self._held = np.full(width, initial)
        self._random = random_stream(seed, f"link/{name}") if spec.jitter > 0 or spec.loss > 0 else None
        self._latest_limit = -(2**62)
        self._block: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._block_start = 0
        self._jumps = () if spec.jump is None else (spec.jump,)
        self._constant = self._delays(0, 0.0)
        self.lost = 0

    def _delays(self, stamp: int, late: float) -> tuple[list[int], list[int]]:
        """Return the delays of every unit in traction and in braking [ns] with an additional one [s] at a time [ns]."""
        factor, add = 1.0, 0.0
        for jump in self._jumps:
            if stamp >= round(jump.at * 1e9):
                factor, add = factor * jump.factor, add + jump.add

        def rounded(delay: float) -> int:
            return round(min(max(0.0, delay * factor + add + late), NEVER) * 1e9 / self._step) * self._step

        return [rounded(delay) for delay in self._forward], [rounded(delay) for delay in self._backward]

    def jump(self, change: DelayJump) -> None:
        """Add a change: the delay is multiplied by the product of all factors, then the sum of all ``add`` is added."""
        self._jumps = (*self._jumps, change)

    def push(self, stamp: int, value: Array | Sequence[float]) -> None:
        """Queue ``value``, shape (width,), at ``stamp`` [ns]."""
        late = 0.0
        if self._random is not None:
            draws = self._random.random(2)
            late = float(draws[0]) * self.spec.jitter
            if draws[1] < self.spec.loss:
                self.lost += 1
                return
        changing = self._jumps or self._random is not None
        forward, backward = self._delays(stamp, late) if changing else self._constant
        commands = value.tolist() if isinstance(value, np.ndarray) else value
        for queue, command, in_traction, in_braking in zip(self._in_flight, commands, forward, backward, strict=True):
            due = stamp + (in_braking if command < 0 else in_traction)
            while queue and queue[-1][0] >= due:
                queue.pop()
            queue.append((due, command))

    def window(self, start: int, count: int) -> Array:
        """Return the arrived values at ``start``, ``start + step``, ... [ns], shape (count, width)."""
        due_by = self._due_by(start, count) if self.spec.varying is not None else None
        last = start + (count - 1) * self._step if due_by is None else int(due_by[-1])
        result = np.empty((count, self._held.size))
        result[:] = self._held
        for unit, queue in enumerate(self._in_flight):
            while queue and queue[0][0] <= last:
                due, value = queue.popleft()
                steps_to_go = -((start - due) // self._step)
                first = max(0, steps_to_go) if due_by is None else int(np.searchsorted(due_by, due))
                result[first:, unit] = value
                self._held[unit] = value
        return result

    def _due_by(self, start: int, count: int) -> NDArray[np.int64]:
        """Return the stamps of the newest values that have arrived at every step under a varying delay [ns].

        They are computed for :data:`BLOCK` calls at once: 2.3 instead of 15.6 us a call. Times must not decrease.
        """
        first = (start - self._block_start) // self._step
        if not 0 <= first <= self._block.size - count:
            now = start + self._step * np.arange(BLOCK * count, dtype=np.int64)
            limit = np.maximum.accumulate(now - self._late(now))
            self._block, self._block_start, first = np.maximum(limit, self._latest_limit), start, 0
        due = self._block[first : first + count]
        self._latest_limit = int(due[-1])
        return due

    def _late(self, now: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the varying delay at the receiver at times [ns]."""
        varying = self.spec.varying
        assert varying is not None
        late = varying.amplitude * np.abs(sin_each(varying.omega * (now * 1e-9) + varying.phase))
        delay: NDArray[np.int64] = np.rint(late * 1e9 / self._step).astype(np.int64) * self._step
        return delay

    @property
    def is_random(self) -> bool:
        """True with jitter or loss."""
        return self._random is not None

    def next_jump(self, stamp: int) -> int:
        """Return the time of the next jump after a stamp [ns], :data:`NO_JUMP` without one."""
        times = (round(jump.at * 1e9) for jump in self._jumps)
        return min((time for time in times if time > stamp), default=NO_JUMP)

    def delays(self, stamp: int) -> NDArray[np.int64]:
        """Return the delays in traction and in braking at a stamp [ns], shape (2, width)."""
        return np.array(self._delays(stamp, 0.0) if self._jumps else self._constant, dtype=np.int64)

    def longest_ns(self, stamp: int) -> int:
        """Return an upper bound of the delays of values sent and received up to a stamp [ns], without jitter [ns]."""
        times = [0, *(round(jump.at * 1e9) for jump in self._jumps)]
        longest = max(max(max(kind, default=0) for kind in self._delays(at, 0.0)) for at in times if at <= stamp)
        varying = self.spec.varying
        return longest + (0 if varying is None else round(varying.amplitude * 1e9) + self._step)

    def in_flight(self, unit: int) -> list[float]:
        """Return the values of a unit that have not arrived, in the order of their arrival."""
        return [value for _, value in self._in_flight[unit]]

    def newest_due(self, start: int, count: int) -> NDArray[np.int64]:
        """Return the stamps of the newest values that have arrived at ``start``, ``start + step``, ... [ns]."""
        now = start + self._step * np.arange(count, dtype=np.int64)
        if self.spec.varying is None:
            return now
        return np.maximum(np.maximum.accumulate(now - self._late(now)), self._latest_limit)

    def packed(self, room: int) -> PackedQueues:
        """Return the queues as arrays with room for more values in every queue."""
        width, longest = self._held.size, max(map(len, self._in_flight), default=0)
        due, value = np.zeros((width, longest + room), dtype=np.int64), np.zeros((width, longest + room))
        bounds: NDArray[np.int64] = np.zeros((2, width), dtype=np.int64)
        for unit, queue in enumerate(self._in_flight):
            bounds[1, unit] = len(queue)
            if queue:
                due[unit, : len(queue)], value[unit, : len(queue)] = zip(*queue, strict=True)
        return PackedQueues(due, value, bounds, self._held)

    def take_packed(self, queues: PackedQueues, newest_due: int) -> None:
        """Replace the queues by packed ones, whose values up to a stamp [ns] have arrived."""
        for unit, (first, end) in enumerate(queues.bounds.T.tolist()):
            entries = zip(queues.due[unit, first:end].tolist(), queues.value[unit, first:end].tolist(), strict=True)
            self._in_flight[unit] = deque(entries)
        if self.spec.varying is not None:
            self._latest_limit = newest_due

    def pop(self, now: int) -> Array:
        """Return the newest value that has arrived at ``now`` [ns], shape (width,)."""
        if self.spec.varying is not None:
            return np.asarray(self.window(now, 1)[0])
        for unit, queue in enumerate(self._in_flight):
            while queue and queue[0][0] <= now:
                self._held[unit] = queue.popleft()[1]
        return self._held.copy()


class MessageLink:
    """A delay line for messages: returns the newest message that has arrived.

    Before the first arrival it returns the first message sent, because the initial state is known.
    """

    def __init__(self, spec: LinkSpec, step_ns: int, seed: int, name: str) -> None:
        self._idle = spec == LinkSpec()
        self._link = Link(spec, 1, step_ns, seed, name)
        self._sent: dict[int, Any] = {}
        self._number = 0

    @property
    def is_idle(self) -> bool:
        """True for a link without delay, jitter and loss."""
        return self._idle

    def pass_on(self, stamp: int, message: Any) -> Any:
        """Queue a message at ``stamp`` [ns]; return the newest one that has arrived at this stamp."""
        if self._idle:
            return message
        self._number += 1
        self._sent[self._number] = message
        self._link.push(stamp, (self._number,))
        arrived = max(1, int(self._link.pop(stamp)[0]))
        for number in [number for number in self._sent if number < arrived]:
            del self._sent[number]
        return self._sent[arrived]
