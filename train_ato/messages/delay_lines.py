"""Transport delays on topics: queues with simulation stamps as keys.

A value arrives one delay after its stamp.  The delay is constant per unit and per sign of the command (traction and
brake may differ), or varies with time at the receiver (paper 003: u(t - tau(t)), tau = 0.2 |sin t|).  Jitter and loss
use a seeded random stream.  A newer value that arrives first replaces older values in flight.  Nodes and
compiled ticks call :func:`push` and :func:`arrive` with the records of a link.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_sin, random_stream
from plant_sim.record import Records, fill, quantity, zeros
from plant_sim.si_model import SiModel, option
from plant_sim.units import Number, Ratio, Time, Unit, Usual
from train_ato.messages.types import Array

MAX_DELAY = 600.0
"""Maximum delay of a topic [s]."""
ROOM, DRAWN = 16, 64
"""First room of a queue, and number of values for which random numbers are drawn at once: a draw of one costs 1 us."""
NO_CHANCE = (0.0, 1.0)
"""Random numbers of a value without jitter and loss."""
NO_JUMP = 2**62
"""Time of a jump that does not happen [ns]."""
NEVER = 1e6
"""Delay of a command that does not arrive in any run [s]; a product of factors can exceed every number."""


Stamps = NDArray[np.int64]
LinkRecords = tuple[Any, Any, Stamps, Array]
"""Records of the delay and of the units, due times [ns] and values of the entries of the queues."""


class VaryingDelay(SiModel):
    """Delay varying at the receiver: ``amplitude |sin(omega t + phase)|``, added to the constant delay."""

    amplitude: Time = Field(ge=0, le=MAX_DELAY, description="largest additional delay", examples=[0.2])
    omega: Annotated[float, Unit("rad/s")] = option(1.0, "angular frequency", gt=0)
    phase: Annotated[float, Unit("rad")] = option(0.0, "phase at time 0", example=1.57)


class DelayJump(SiModel):
    """Change of the delays at a time: delay x product of all factors + sum of all ``add`` of the changes so far."""

    at: Time = Field(ge=0, description="time of the change", examples=[60.0])
    factor: Number = option(1.0, "factor on the delays", example=2.0, ge=0, le=1000)
    add: Time = option(0.0, "time that is added to the delays", example=0.2, ge=-MAX_DELAY, le=MAX_DELAY)


class LinkSpec(SiModel):
    """Delay of one topic; ``delay`` is one value for all units or one per unit."""

    delay: Annotated[Time | tuple[Time, ...], Usual(1e-3, 60)] = option(
        0.0, "delay of the topic; of commands: in traction", example=0.3
    )
    delay_brake: Annotated[Time | tuple[Time, ...] | None, Usual(1e-3, 60)] = option(
        None, "delay of commands below 0; default: delay", example=0.5
    )
    varying: VaryingDelay | None = None
    jitter: Annotated[Time, Usual(1e-4, 60)] = option(
        0.0, "largest additional delay, with uniform distribution", example=0.02, ge=0, le=MAX_DELAY
    )
    loss: Ratio = option(0.0, "probability of losing a message; the last value is held", example=0.01, ge=0, lt=1)
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

    def newest(self) -> "LinkSpec":
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


@dataclass
class DelayLine:
    """Delay of all values of a link."""

    step: int = quantity("ns", "grid of the delays")
    factor: float = quantity("", "product of the factors of all changes so far")
    add: float = quantity("s", "sum of the additions of all changes so far")
    jitter: float = quantity("s", "upper bound of the additional random delay")
    loss: float = quantity("", "probability of losing a value")
    amplitude: float = quantity("s", "largest additional delay at the receiver")
    omega: float = quantity("rad/s", "angular frequency of the delay at the receiver")
    phase: float = quantity("rad", "phase of the delay at the receiver")
    newest: int = quantity("ns", "due time of the newest values that have arrived, with a delay at the receiver")
    lost: int = quantity("", "values lost so far")


@dataclass
class UnitQueue:
    """Values in flight to one unit: the entries from ``first`` to before ``end`` of its row."""

    forward: float = quantity("s", "delay in traction")
    backward: float = quantity("s", "delay in braking")
    first: int = quantity("", "number of the first entry")
    end: int = quantity("", "number behind the last entry")
    held: float = quantity("", "value that arrived last")


@compiled
def delay_ns(line: DelayLine, delay: float, late: float) -> int:
    """Return a delay with all changes and an additional delay [s] on the grid of the link [ns]."""
    changed = delay * line.factor + line.add + late
    if not changed > 0.0:
        changed = 0.0
    if changed > NEVER:
        changed = NEVER
    return int(np.rint(changed * 1e9 / line.step)) * line.step


@compiled
def push(
    lines: Records[DelayLine], units: Records[UnitQueue], due: Stamps, value: Array,
    stamp: int, sent: Array, late: float, chance: float,
) -> None:  # fmt: skip
    """Queue the values of a stamp, or lose them.

    Parameters
    ----------
    lines, units, due, value
        Records of the link; every queue has room for one more value.
    stamp
        Time of the values [ns].
    sent
        Values, shape (units,); one below 0 has the delay in braking.
    late, chance
        Random numbers in [0, 1): part of the jitter, and loss if below its probability.
    """
    line = lines[0]
    if chance < line.loss:
        line.lost += 1
        return
    for u in range(units.size):
        queue = units[u]
        arrival = stamp + delay_ns(line, queue.backward if sent[u] < 0.0 else queue.forward, late * line.jitter)
        while queue.end > queue.first and due[u, queue.end - 1] >= arrival:
            queue.end -= 1
        due[u, queue.end], value[u, queue.end] = arrival, sent[u]
        queue.end += 1


@compiled
def arrive(
    lines: Records[DelayLine], units: Records[UnitQueue], due: Stamps, value: Array, start: int, acting: Array
) -> None:
    """Write the values that act at ``start``, ``start + step``, ... [ns], shape (steps, units)."""
    line = lines[0]
    for row in range(acting.shape[0]):
        due_by = start + row * line.step
        if line.amplitude > 0.0:
            late = line.amplitude * abs(libm_sin(line.omega * (due_by * 1e-9) + line.phase))
            line.newest = max(line.newest, due_by - int(np.rint(late * 1e9 / line.step)) * line.step)
            due_by = line.newest
        for u in range(units.size):
            queue = units[u]
            while queue.first < queue.end and due[u, queue.first] <= due_by:
                queue.held = value[u, queue.first]
                queue.first += 1
            acting[row, u] = queue.held


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
        self._line, self._units = zeros(DelayLine, 1), zeros(UnitQueue, width)
        varying = VaryingDelay(amplitude=0.0) if spec.varying is None else spec.varying
        fill(self._line, varying, step=step_ns, jitter=spec.jitter, loss=spec.loss, factor=1.0, add=0.0,
             newest=-NO_JUMP, lost=0)  # fmt: skip
        self._units["forward"], self._units["backward"] = spec.per_unit(width, f"links.{name}")
        self._units["held"] = initial
        self._due: Stamps = np.zeros((width, ROOM), dtype=np.int64)
        self._value, self._free = np.zeros((width, ROOM)), ROOM
        self._sent = np.zeros(width)
        self._random = random_stream(seed, f"link/{name}") if spec.jitter > 0 or spec.loss > 0 else None
        self._drawn, self._next = np.zeros((0, 2)), 0
        self._jumps: list[DelayJump] = []
        self._changes_at = NO_JUMP
        if spec.jump is not None:
            self.jump(spec.jump)

    @property
    def lost(self) -> int:
        """Number of values lost so far."""
        return int(self._line["lost"][0])

    def jump(self, change: DelayJump) -> None:
        """Add a change: the delay is multiplied by the product of all factors, then the sum of all ``add`` is added."""
        self._jumps.append(change)
        self._changes_at = min(self._changes_at, _stamp_of(change))

    def next_jump(self, stamp: int) -> int:
        """Return the time of the next jump after a stamp [ns], :data:`NO_JUMP` without one."""
        return min((time for time in map(_stamp_of, self._jumps) if time > stamp), default=NO_JUMP)

    def push(self, stamp: int, value: Array | Sequence[float]) -> None:
        """Queue ``value``, shape (width,), at ``stamp`` [ns]."""
        lines, units, due, values = self.records(stamp, 1)
        self._sent[:] = value
        late, chance = NO_CHANCE
        if self._random is not None:
            late, chance = self.draws(1)[0].tolist()
            self._next += 1
        push(lines, units, due, values, stamp, self._sent, late, chance)

    def window(self, start: int, count: int) -> Array:
        """Return the arrived values at ``start``, ``start + step``, ... [ns], shape (count, width)."""
        acting = np.empty((count, self._sent.size))
        arrive(self._line, self._units, self._due, self._value, start, acting)
        return acting

    def pop(self, now: int) -> Array:
        """Return the newest value that has arrived at ``now`` [ns], shape (width,)."""
        return np.asarray(self.window(now, 1)[0])

    def delivers_only(self, value: float | None) -> bool:
        """Return True if all values that have arrived or are in flight are the same value."""
        queues = zip(self._units["first"].tolist(), self._units["end"].tolist(), strict=True)
        flying = all((row[first:end] == value).all() for row, (first, end) in zip(self._value, queues, strict=True))
        return flying and bool((self._units["held"] == value).all())

    def repeat(self, stamp: int, period: int, count: int, value: float) -> None:
        """Queue a value and take the arrived one, at a number of stamps with a period [ns]."""
        for now in range(stamp, stamp + count * period, period):
            self.push(now, (value,))
            self.pop(now)

    def records(self, stamp: int, count: int) -> LinkRecords:
        """Return the records at a stamp [ns], with the changes up to it and room for ``count`` more values."""
        if stamp >= self._changes_at:
            factor, add = 1.0, 0.0
            for jump in self._jumps:
                if stamp >= _stamp_of(jump):
                    factor, add = factor * jump.factor, add + jump.add
            self._line["factor"], self._line["add"] = factor, add
            self._changes_at = self.next_jump(stamp)
        self._free -= count
        if self._free < 0:
            self._make_room(count)
        return self._line, self._units, self._due, self._value

    def _make_room(self, count: int) -> None:
        """Move the queues to the first columns, in longer arrays if necessary."""
        first, end = self._units["first"], self._units["end"]
        longest = int((end - first).max(initial=0))
        room = self._due.shape[1]
        while room < 2 * (longest + count):
            room *= 2
        due, value = np.zeros((first.size, room), dtype=np.int64), np.zeros((first.size, room))
        for unit, (begin, behind) in enumerate(zip(first.tolist(), end.tolist(), strict=True)):
            due[unit, : behind - begin] = self._due[unit, begin:behind]
            value[unit, : behind - begin] = self._value[unit, begin:behind]
        self._units["end"], self._units["first"] = end - first, 0
        self._due, self._value, self._free = due, value, room - longest - count

    def draws(self, count: int) -> Array:
        """Return the random numbers of the next values without use of them, shape (count, 2)."""
        if self._random is None:
            return np.tile(NO_CHANCE, (count, 1))
        while len(self._drawn) < self._next + count:
            more = self._random.random((DRAWN, 2))
            self._drawn, self._next = np.concatenate((self._drawn[self._next :], more)), 0
        return self._drawn[self._next : self._next + count]

    def skip_draws(self, count: int) -> None:
        """Use the random numbers of some values, which compiled code has queued."""
        self._next += count


def _stamp_of(jump: DelayJump) -> int:
    """Return the time of a jump [ns]."""
    return round(jump.at * 1e9)


class MessageLink:
    """A delay line for messages: returns the newest message that has arrived.

    Before the first arrival it returns the first message sent, because the initial state is known. ``is_idle`` is True
    without delay, jitter and loss.
    """

    def __init__(self, spec: LinkSpec, step_ns: int, seed: int, name: str) -> None:
        self.is_idle = spec == LinkSpec()
        self._link = Link(spec, 1, step_ns, seed, name)
        self._sent: dict[int, Any] = {}
        self._number = 0

    def pass_on(self, stamp: int, message: Any) -> Any:
        """Queue a message at ``stamp`` [ns]; return the newest one that has arrived at this stamp."""
        if self.is_idle:
            return message
        self._number += 1
        self._sent[self._number] = message
        self._link.push(stamp, (self._number,))
        arrived = max(1, int(self._link.pop(stamp)[0]))
        for number in [number for number in self._sent if number < arrived]:
            del self._sent[number]
        return self._sent[arrived]
