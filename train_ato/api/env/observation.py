"""Observation of the environment by name and unit: the knowledge of the onboard ATO, not the truth.

After a lost measurement its values are NaN, as for a law.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Any

import numpy as np

from plant_sim import kernel as k
from plant_sim.compiled import compiled
from plant_sim.elementary import numpy_total
from plant_sim.input_error import close_match
from plant_sim.railway import between_entries, envelope_force
from train_ato.control.algorithms.limits_ahead import LimitsAhead, step_value
from train_ato.control.component_fault import place_of
from train_ato.control.train_model import GRID
from train_ato.loop.controller import ControllerStage, Received
from train_ato.loop.engine import TickLoop
from train_ato.messages.topic import FIXED_NAMES, Owner
from train_ato.messages.types import Array, Measurement
from train_ato.scenario.setup import RunSetup

DISTANCES = (0.0, 50.0, 100.0, 200.0, 400.0, 800.0, 1600.0)
"""Distances ahead of vehicle 0's centre for limits and gradients [m]."""
STEEPEST = 300.0
"""Bound of the gradients [per mille]."""
MAX_DEFLECTION, MAX_COUPLER_FORCE = 10.0, 1e8
"""Bounds of the deflection [m] and of the force [N] of a coupler."""
MAX_ACCELERATION = 10.0
"""Bound of the acceleration of the reference [m/s²]."""
MARGIN = 2.0
"""Bound of speeds and forces over the largest of train and line."""
UNKNOWN = np.full(3, np.nan)
"""Reference before its first message has arrived."""
BRAKES = FIXED_NAMES[Owner.BRAKE_LINE]
LIMITS = FIXED_NAMES[Owner.SUPERVISED_SPEED][1:]


@dataclass
class Known:
    """Knowledge of the ATO at a step.

    Attributes
    ----------
    received : Received
        Messages that have arrived.
    in_flight : Array, shape (d, units)
        Commands sent and not yet in effect [N].
    state : Array, shape (9,)
        1 if the ATO is engaged, so that the force of the caller drives. Newest traction cut-off, service and emergency
        brake (1: in effect). Supervised speed limits [m/s]. Direction of the reference along the line, 1 or -1; at rest
        that of the last motion, at the start that of the first.
    """

    received: Received
    in_flight: Array
    state: Array = field(default_factory=lambda: np.array([1.0, *[0.0] * (len(BRAKES) + len(LIMITS)), 1.0]))

    @property
    def measurement(self) -> Measurement:
        """Newest measurement."""
        return self.received.measurement

    @property
    def engaged(self) -> bool:
        """True if the ATO is engaged."""
        return bool(self.state[ENGAGED])

    @classmethod
    def of(cls, controller: ControllerStage) -> "Known":
        """Return the knowledge at the first step."""
        known, speeds = cls(controller.received, controller.in_flight), controller.setup.profile.velocity
        for speed in speeds[np.flatnonzero(speeds)[:1]]:
            known.state[DIRECTION] = np.sign(speed)
        return known

    def take(self, controller: ControllerStage) -> None:
        """Take the messages of a step; those of the supervisor are kept between its steps."""
        received = self.received = controller.received
        self.in_flight = controller.in_flight
        self.state[ENGAGED] = controller.ato.drives and not controller.ato.assured
        if received.protection is not None:
            self.state[ENGAGED + 1 : SUPERVISED] = received.protection.active
        if received.speeds is not None:
            self.state[SUPERVISED:DIRECTION] = received.speeds.speed[1:]
        if received.reference is not None and received.reference.velocity != 0.0:
            self.state[DIRECTION] = np.sign(received.reference.velocity)

    def values(self, sight: "Sight") -> Array:
        """Return the values of all quantities, see :func:`write_values`."""
        seen, expected, estimate = self.measurement, self.received.reference, self.received.estimate
        found, measured = np.empty(sight.size), np.array((seen.position, seen.velocity, seen.applied))
        reference = UNKNOWN
        if expected is not None:
            reference = np.array((expected.position, expected.velocity, expected.acceleration))
        disturbance = sight.undisturbed if estimate is None else estimate.force
        couplers = np.array((seen.deflection, seen.rate, seen.force))
        write_values(
            found, seen.stamp * 1e-9, measured, couplers, reference, disturbance, self.in_flight, self.state,
            sight.arrays,
        )  # fmt: skip
        return found


ENGAGED, SUPERVISED, DIRECTION = 0, 1 + len(BRAKES), 1 + len(BRAKES) + len(LIMITS)
"""Places in the state of :class:`Known`, the second one of the first limit."""


@compiled(allocates=False)
def write_values(  # type: ignore[no-untyped-def]
    found, t, measured, couplers, reference, disturbance, in_flight, state, sight
):
    """Write the values of all quantities in their order, :func:`observed`.

    Parameters
    ----------
    found : Array, shape (values,)
        Receives the values.
    t
        Time of the measurement [s].
    measured, couplers : Array, shape (3, units) and (3, sensors)
        Position [m], speed [m/s] and force [N]; deflection [m], rate [m/s] and force [N].
    reference : Array, shape (3,)
        Position [m], speed [m/s] and acceleration [m/s²] of vehicle 0's centre.
    disturbance : Array, shape (units,)
        Estimate of the observer [N].
    in_flight, state
        See :class:`Known`.
    sight
        Arrays of :class:`Sight`.
    """
    offsets, rows, segments, table, numbers, places, speeds, distances = sight
    end, weight, line_begin = numbers
    found[0], at, units = t, 1, offsets.size
    for part in (measured, couplers):
        for row in range(3):
            for value in part[row]:
                found[at] = value
                at += 1
    for value in reference:
        found[at] = value
        at += 1
    for u in range(units):
        found[at + u] = measured[0, u] + offsets[u] - reference[0]
        found[at + units + u] = measured[1, u] - reference[1]
        found[at + 2 * units + u] = disturbance[u]
        speed = abs(measured[1, u])
        found[at + 3 * units + u] = -envelope_force(rows, segments[u, 0], segments[u, 1], speed)
        found[at + 4 * units + u] = envelope_force(rows, segments[u, 2], segments[u, 3], speed)
    at += 5 * units
    for row in range(in_flight.shape[0]):
        for u in range(units):
            found[at] = in_flight[row, u]
            at += 1
    direction = state[DIRECTION]
    found[at] = direction * (end - offsets[0] - measured[0, 0])
    at += 1
    for distance in distances:
        place = measured[0, 0] + offsets[0] + direction * distance
        found[at] = step_value(places, speeds, place)
        grade = place  # of a lost measurement without a number
        if isfinite(place):
            grade = 1e3 / weight * between_entries(table, (place - line_begin) / GRID)
        found[at + distances.size] = grade
        at += 1
    at += distances.size
    for value in state[:DIRECTION]:
        found[at] = value
        at += 1


class Sight:
    """Nominal train and line behind the values of an observation.

    Attributes
    ----------
    arrays : tuple of Array
        Offsets of the units, rows and segments of their envelopes, line force, end of the profile with weight of the
        train and begin of the table, places and values of the limits, distances ahead.
    flight : int
        Number of commands in flight.
    size : int
        Number of values.
    undisturbed : Array, shape (units,)
        Disturbance without an observer.
    """

    def __init__(self, setup: RunSetup) -> None:
        model, limits = setup.model, LimitsAhead(setup.model)
        rows, segments = model.envelopes
        self.flight = len(model.commands_in_flight())
        weight, line_begin = model.mass * setup.consist.gravity, model.specific_line_force()[1]
        numbers = np.array((float(setup.profile.position[-1]), weight, line_begin))
        self.arrays = (
            np.array(model.offsets), rows, segments, np.array(model.tables[1]), numbers, limits.places, limits.speeds,
            np.array(DISTANCES),
        )  # fmt: skip
        self.undisturbed = np.zeros(model.n_units)
        whole = 1 + 8 * model.n_units + 3 * len(setup.layout.sensors) + 3 + self.flight * model.n_units
        self.size = whole + 1 + 2 * len(DISTANCES) + DIRECTION


@dataclass(frozen=True)
class Quantity:
    """One quantity of the observation.

    Attributes
    ----------
    name, unit, meaning : str
        Name, unit of the values, and description.
    low, high : Array, shape (k,)
        Bounds of its values, from train and line.
    begin : int
        Place of its first value in those of :func:`write_values`.
    """

    name: str
    unit: str
    meaning: str
    low: Array
    high: Array
    begin: int = 0

    @property
    def part(self) -> slice:
        """Its place in the values of :func:`write_values`."""
        return slice(self.begin, self.begin + self.low.size)


def observed(setup: RunSetup, names: Sequence[str] | None = None) -> dict[str, Quantity]:
    """Return quantities of a run by name, in the order of the flat vector.

    Parameters
    ----------
    setup
        Prepared run.
    names
        Chosen quantities; None: all that the run has.
    """
    known, begin = {}, 0
    for entry in (*_of_train(setup), *_of_line(setup), *_of_supervisor(setup)):
        if entry.low.size and _exists(entry.name, setup):
            known[entry.name] = replace(entry, begin=begin)
        begin += entry.low.size
    if names is not None and (not isinstance(names, (list, tuple)) or not names):
        raise ValueError(f"observe {names!r}: give names in a list, for example ('speed', 'speed_error')")
    for name in names or ():
        if name not in known:
            raise ValueError(
                f"observe: unknown quantity '{name}'{close_match(name, tuple(known))}; use {', '.join(known)}"
            )
    return known if names is None else {name: known[name] for name in names}


def _exists(name: str, setup: RunSetup) -> bool:
    """Return False for limits of a line without limits, and for quantities of a supervisor without one."""
    if name == "limits_ahead":
        return bool(setup.line.restricted_limits)
    return setup.layout.supervised or name not in ("ato_engaged", "brakes", "supervised_limits")


def _within(name: str, unit: str, meaning: str, bound: Array) -> Quantity:
    return Quantity(name, unit, meaning, -bound, bound)


def _of_train(setup: RunSetup) -> Iterator[Quantity]:
    """Measurement, reference, errors, estimate, force limits and commands in flight."""
    model = setup.model
    begin, end = setup.line.begin - 2.0 * setup.consist.length, setup.line.end + setup.consist.length
    one, each, sensors = np.ones(1), np.ones(model.n_units), np.ones(len(setup.layout.sensors))
    limits = [limit.speed for limit in setup.line.restricted_limits]
    fastest = MARGIN * max([float(np.abs(setup.profile.velocity).max()), *limits])
    least = -np.array([envelope.largest() for envelope in model.brake])
    most = np.array([envelope.largest() for envelope in model.traction])
    forces = MARGIN * np.maximum(most, -least)
    flight = len(model.commands_in_flight())
    length = end - begin
    yield Quantity("time", "s", "time since the start", 0.0 * one, setup.ticks * setup.tick * one)
    yield Quantity("position", "m", "measured centre of every unit along the line", begin * each, end * each)
    yield _within("speed", "m/s", "measured speed of every unit", fastest * each)
    yield _within("force", "N", "measured force of every unit", forces)
    yield _within("coupler_deflection", "m", "measured deflection of every coupler with a sensor, > 0 draft",
                  MAX_DEFLECTION * sensors)  # fmt: skip
    yield _within("coupler_rate", "m/s", "measured rate of the deflection", fastest * sensors)
    yield _within("coupler_force", "N", "measured force, > 0 draft", MAX_COUPLER_FORCE * sensors)
    yield Quantity("reference_position", "m", "reference of vehicle 0's centre", begin * one, end * one)
    yield _within("reference_speed", "m/s", "its speed", fastest * one)
    yield _within("reference_acceleration", "m/s²", "its acceleration", MAX_ACCELERATION * one)
    yield _within("position_error", "m", "position minus reference of every unit", length * each)
    yield _within("speed_error", "m/s", "speed minus reference of every unit", 2.0 * fastest * each)
    yield _within("disturbance", "N", "estimate of the observer, > 0 forward", MAX_COUPLER_FORCE * each)
    yield Quantity("force_min", "N", "limit of every unit at its speed in braking", least, 0.0 * each)
    yield Quantity("force_max", "N", "limit of every unit at its speed in traction", 0.0 * each, most)
    yield Quantity("commands_in_flight", "N", "commands sent and not yet in effect, oldest first, unit by unit",
                   np.tile(least, flight), np.tile(most, flight))  # fmt: skip


def _of_line(setup: RunSetup) -> Iterator[Quantity]:
    """Way to the end, limits and gradients at :data:`DISTANCES` ahead."""
    line = setup.line
    limits = [limit.speed for limit in line.restricted_limits]
    most = np.full(len(DISTANCES), max(limits, default=0.0))
    length = np.array((line.end - line.begin + 3.0 * setup.consist.length,))
    yield _within("distance_to_end", "m", "way of vehicle 0's centre to the end of the profile", length)
    yield Quantity("limits_ahead", "m/s", f"lowest limit over the train {DISTANCES} m ahead", 0.0 * most, most)
    yield _within("gradients_ahead", "per mille", f"grade, curve and tunnel over the train {DISTANCES} m ahead",
                  STEEPEST + 0.0 * most)  # fmt: skip


def _of_supervisor(setup: RunSetup) -> Iterator[Quantity]:
    """State of the ATO, brakes and limits of the supervisor."""
    limits_of_line = [limit.speed for limit in setup.line.restricted_limits]
    fastest = MARGIN * max([float(np.abs(setup.profile.velocity).max()), *limits_of_line])
    brakes, limits = np.ones(len(BRAKES)), np.ones(len(LIMITS))
    yield Quantity("ato_engaged", "", "1: the force of the caller drives", np.zeros(1), np.ones(1))
    yield Quantity("brakes", "", "1: in effect; traction cut-off, service brake, emergency brake", 0.0 * brakes, brakes)
    yield Quantity("supervised_limits", "m/s", f"limits of the supervisor: {', '.join(LIMITS)}", 0.0 * limits,
                   fastest * limits)  # fmt: skip


def flat_vector(values: dict[str, Array]) -> Array:
    """Return an observation as one vector."""
    return np.concatenate(list(values.values()))


OnTick = Callable[[dict[str, Array]], Mapping[str, float] | None]
StopWhen = Callable[[dict[str, Array]], bool]


class TickCalls:
    """Calls of ``on_tick`` and ``stop_when`` with the observation of every tick.

    Parameters
    ----------
    setup
        Prepared run.
    on_tick
        Receives the observation by name (:func:`train_ato.api.env.observation.observed`); returns own numbers by name
        for the log, or None.
    stop_when
        Receives the same; True ends the run after this tick.

    Attributes
    ----------
    stopped : bool
        True after ``stop_when`` has ended the run.
    """

    def __init__(self, setup: RunSetup, on_tick: OnTick | None, stop_when: StopWhen | None) -> None:
        for name, function in (("on_tick", on_tick), ("stop_when", stop_when)):
            if not (function is None or callable(function)):
                raise ValueError(f"{name} {function!r}: give a function of the observation")
        self._quantities, self._sight = observed(setup), Sight(setup)
        self._on_tick, self._stop_when = on_tick, stop_when
        self._known: Known | None = None
        self.stopped = False

    def __call__(self, loop: TickLoop) -> bool:
        """Call the functions; return True if the run ends after this tick."""
        known = self._known = self._known or Known.of(loop.controller)
        known.take(loop.controller)
        seen = known.values(self._sight)
        values = {name: seen[quantity.part] for name, quantity in self._quantities.items()}
        if self._on_tick is not None and (signals := _answer("on_tick", self._on_tick, values)):
            loop.note(signal_texts(signals, "on_tick"))
        self.stopped = self._stop_when is not None and _answer("stop_when", self._stop_when, values)
        return self.stopped


def _answer(name: str, function: Callable[[dict[str, Array]], Any], values: dict[str, Array]) -> Any:
    """Call a function of the user; its error becomes a ValueError with file and line."""
    try:
        answer = function(values)
        return bool(answer) if name == "stop_when" else answer
    except Exception as error:
        raise ValueError(f"{name}: {type(error).__name__}: {error}{place_of(error)}") from error


def signal_texts(signals: Any, source: str) -> dict[str, str]:
    """Return own signals as text of the diagnostics."""
    try:
        if wrong := [name for name in signals if not isinstance(name, str) or not name]:
            raise ValueError(f"the name {wrong[0]!r} is no text")
        return {name: repr(float(np.asarray(value).item())) for name, value in signals.items()}
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{source}: signals {str(signals)[:60]} are not numbers by name ({error})") from None


@dataclass(frozen=True)
class Cost:
    """One cost; the reward is minus the sum of weight times cost."""

    name: str
    unit: str
    meaning: str
    weight: float


COSTS = (
    Cost("tracking", "m²/s", "integral of the squared speed error, mean over the units", 1.0),
    Cost("energy", "kWh", "work of the power units in traction minus that of their electric brakes", 0.1),
    Cost("comfort", "m²/s⁵", "integral of the squared jerk of vehicle 0", 0.1),
    Cost("couplers", "kN", "growth of the largest coupler force of the run, draft or buff", 0.01),
    Cost("stop", "m", "at the end: largest stop error, without a stop the distance from the target", 1.0),
    Cost("punctuality", "s", "at the end: delay of arrival, without one from the planned arrival on; early counts too",
         0.1),
)  # fmt: skip
"""All costs with their default weights [1/unit]. Their sums over a run are those of its metrics."""


def weights_of(given: Mapping[str, float] | None) -> dict[str, float]:
    """Return the weights in the order of the costs; those not given have none, without any given all their default."""
    known = {cost.name: cost.weight for cost in COSTS}
    if not isinstance(given, Mapping | None):
        raise ValueError(f"reward {str(given)[:60]!r}: give weights by name, for example {{'tracking': 1.0}}")
    for name, weight in (given or {}).items():
        if name not in known:
            raise ValueError(f"reward: unknown cost '{name}'{close_match(name, tuple(known))}; use {', '.join(known)}")
        if not isinstance(weight, (int, float, np.number)) or not np.isfinite(weight):
            raise ValueError(f"reward: {name}: weight {weight!r} is not finite; give a number")
    return known if given is None else {name: float(given[name]) for name in known if name in given}


PER_TICK = tuple(cost.name for cost in COSTS[:4])
"""Costs of every tick, in the order of :func:`add_costs`."""
SPEED, ACCELERATION, ENERGY, COUPLER = range(4)
"""Places in the memory of :func:`add_costs`."""


def cost_memory(speed: float) -> Array:
    """Return the memory of :func:`add_costs` at the start, with a speed of vehicle 0 [m/s]."""
    return np.array((speed, 0.0, 0.0, 0.0))


@compiled
def add_costs(costs, memory, errors, state, unit, gear, vehicles, tick):  # type: ignore[no-untyped-def]
    """Add the costs of a tick of a train from its true state after it.

    Parameters
    ----------
    costs : Array, shape (4,)
        Costs so far, :data:`PER_TICK`.
    memory : Array, shape (4,)
        Speed [m/s] and acceleration [m/s²] of vehicle 0, work [J] and largest coupler force [N] after the tick before.
    errors : Array, shape (units,)
        Speed errors before the tick [m/s]; they are squared in place.
    state, unit, gear
        Arrays of the kernel.
    vehicles, tick
        Number of vehicles, and duration [s].
    """
    for u in range(errors.size):
        errors[u] *= errors[u]
    energy = numpy_total(unit[k.WORK_TRACTION]) - numpy_total(unit[k.WORK_REGENERATED])
    coupler = 0.0
    for j in range(vehicles - 1):
        coupler = max(coupler, max(gear[k.DRAFT, j], -gear[k.BUFF, j]))
    acceleration = (state[k.V, 0] - memory[SPEED]) / tick
    jerk = (acceleration - memory[ACCELERATION]) / tick
    costs[0] += numpy_total(errors) / errors.size * tick
    costs[1] += (energy - memory[ENERGY]) / 3.6e6
    costs[2] += jerk * jerk * tick
    costs[3] += (coupler - memory[COUPLER]) / 1e3
    memory[SPEED], memory[ACCELERATION], memory[ENERGY], memory[COUPLER] = state[k.V, 0], acceleration, energy, coupler


def end_costs(setup: RunSetup, metrics: Mapping[str, Any], front: float) -> dict[str, float]:
    """Return the costs of the end of a run.

    Parameters
    ----------
    setup
        The run.
    metrics
        Metrics of the run.
    front
        Position of vehicle 0's centre at the end [m].
    """
    stop, delay = metrics.get("stop_error_max_m"), metrics.get("arrival_delay_max_s")
    late = max(0.0, setup.ticks * setup.tick - float(setup.profile.time[-1]))
    return {
        "stop": abs(front - float(setup.profile.position[-1])) if stop is None else abs(stop),
        "punctuality": late if delay is None else abs(delay),
    }
