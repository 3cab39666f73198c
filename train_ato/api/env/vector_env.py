"""Many environments in one: a step drives all trains in one compiled call, spread over the cores."""

import os
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from threading import Event, Lock, Thread
from typing import Any
from weakref import finalize

import numpy as np

from train_ato.api.env import observation as obs
from train_ato.api.env.compiled_steps import GOES_ON, GOING_ON, ROWS, TICKS, UNDONE, set_forces, step_trains
from train_ato.api.env.env import MAX_SEED, CallerForces, caller_setup, checked_seed
from train_ato.api.scenario_choice import Changes, GivenScenario, ScenarioChoice, choose_scenario
from train_ato.control.caller import Caller
from train_ato.judge.result import RunResult
from train_ato.loop.engine import TickLoop
from train_ato.loop.native_arguments import reader_of, row_numbers
from train_ato.loop.span import CompiledSpans, Span
from train_ato.messages.types import Array
from train_ato.program.errors import FirstFailure, refusing
from train_ato.scenario.dimensions import read_dimensions
from train_ato.scenario.scenario_data import PartCache
from train_ato.scenario.setup import RunSetup

DOMAIN_STREAM = 33
"""Second seed of the draw of a domain, beside the seed of the run."""
NS = 1e-9
CROWDED = 20
"""Steps in one thread after another thread with a train has waited for a processor, as long as hundreds of steps."""


class _Train:
    """One run of the vector.

    Attributes
    ----------
    loop : TickLoop
        Its stages.
    span : Span or None
        Its compiled ticks, observed up to the present one; None: the stages have observed it.
    ended : bool
        True after the last tick.
    domain : dict
        Keys drawn for this run.
    """

    def __init__(self, setup: RunSetup, caller: Caller, force: Array, domain: dict[str, Any]) -> None:
        self.setup, self.domain, self.watch = setup, domain, FirstFailure()
        brief = not setup.scenario.criteria.requirements and not setup.scenario.evaluation.couplers
        self.loop = loop = TickLoop(setup, None, compiled=True, summary_only=brief)
        loop.start()
        caller.force = force
        self.span: Span | None = None
        self.spans: CompiledSpans | None = None
        self.known: obs.Known | None = None
        self.ended = False
        self.begin = time.perf_counter()

    def new_span(self) -> Span | None:
        """Return the compiled ticks from the present one on; None if it is left to Python."""
        if self.loop.ticks == 0:
            return None
        if self.spans is None:
            self.spans = self.loop.compiled_spans()
        self.spans.ato = self.loop.last_report
        return self.spans.begin(without_python=True)

    def end_span(self, done: int) -> None:
        """Set the stages to their state after the compiled ticks."""
        assert self.spans is not None
        assert self.span is not None
        self.loop.ticks += self.spans.end(self.span, done)
        self.loop.last_report = self.spans.ato
        self.span = None

    def metrics(self) -> dict[str, Any]:
        """Return the metrics of the ended run."""
        loop = self.loop
        counts, recording, wall = loop.recording.counts, loop.recording.finish(), time.perf_counter() - self.begin
        outcome = RunResult.of(
            self.setup, recording, wall, loop.ticks, [], interrupted=False, failure=self.watch.failure, published=counts
        )
        return {**outcome.summary, "mode": "engine"}


def _work(take_part: Callable[[], Any], asleep: list[Lock], ended: Event) -> None:
    """Take part in the calls of the owner; sleep when there is none for some time."""
    turn = Lock()
    turn.acquire()
    while True:
        asleep.append(turn)
        if ended.is_set():
            return
        turn.acquire()
        take_part()


def _wake(asleep: list[Lock]) -> None:
    while asleep:
        asleep.pop().release()


def _end(asleep: list[Lock], ended: Event) -> None:
    ended.set()
    _wake(asleep)


class VectorEnv(CallerForces):
    """Environments of one scenario, all of whose trains are driven by one call; as :class:`train_ato.Env` for each.

    Made by :func:`train_ato.vector_env`. The autoreset mode is ``NEXT_STEP``, the default of Gymnasium. The step after
    the end of a run ignores its force. It begins the next run and returns its first observation and the reward 0.

    Parameters
    ----------
    scenario
        As for :class:`train_ato.Env`.
    num_envs
        Number of trains.
    seed
        Seed of the first :meth:`reset`, as there.
    set
        Other keys of the scenario.
    over
        Domain randomisation: keys of the scenario with their values or ranges, as ``over:`` of a sweep. Every run draws
        one value for each key; the draw follows from the seed of the run and is in ``domains``.
    observe
        Names of the observed quantities; default: all that every train has in the same number.
    normalised
        True: the force of a step is relative to the envelope, from -1 to 1.
    reward
        Weights of the costs, as for :class:`train_ato.Env`.
    threads
        Number of threads; default: as in the processors.

    Attributes
    ----------
    quantities : dict of Quantity
        Observed quantities; the observation is one vector per train in their order.
    num_envs, n_units : int
        Number of trains, and of power units of each.
    domains : list of dict
        Keys drawn for the present run of every train.

    Raises
    ------
    ValueError
        One line: bad scenario, quantity, cost or key.

    Examples
    --------
    >>> import train_ato as ta
    >>> masses = {"plant.mismatch.mass_scale": {"from": 0.8, "to": 1.2}}
    >>> envs = ta.vector_env("xuzhou_metro", 4, over=masses, observe=("speed", "speed_error"), normalised=True)
    >>> obs, info = envs.reset(seed=8)
    >>> for _ in range(100):
    ...     obs, reward, terminated, truncated, info = envs.step(-obs[:, 1:])
    >>> obs.shape, len(envs.domains)
    ((4, 2), 4)
    """

    @refusing
    def __init__(
        self,
        scenario: GivenScenario,
        num_envs: int,
        *,
        seed: int | None = None,
        set: Changes | None = None,
        over: Mapping[str, Any] | None = None,
        observe: Sequence[str] | None = None,
        normalised: bool = False,
        reward: Mapping[str, float] | None = None,
        threads: int | None = None,
    ) -> None:
        for name, count in (("num_envs", num_envs), ("threads", 1 if threads is None else threads)):
            if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 1:
                raise ValueError(f"{name} {count!r}: give a whole number from 1 on")
        self._choice = choose_scenario(scenario).changed(set, seed)
        self._dimensions = read_dimensions(over, "over") if over else ()
        self.num_envs, self.normalised = int(num_envs), normalised
        self._parts, self._weights = PartCache(), obs.weights_of(reward)
        self._others = min(threads or os.cpu_count() or 1, self.num_envs) - 1
        self._threads = list[Lock](), Event()
        self._stop = finalize(self, _end, *self._threads)
        self._bounds(observe)
        sight = obs.Sight(self.setup)
        n, units = self.num_envs, self.n_units
        self._forces, self._given = np.zeros((n, units)), np.zeros((n, units))
        self._rows: Any = None
        self._ticks = round(self.period / self.setup.tick)
        self._results = np.zeros((n, 3), dtype=np.int64)
        self._costs, self._memories = np.zeros((n, len(obs.PER_TICK))), np.zeros((n, 4))
        self._states, self._found = np.zeros((n, obs.DIRECTION + 1)), np.zeros((n, sight.size))
        known = obs.observed(self.setup)
        self._limits = [self._found[:, known[name].part] for name in ("force_min", "force_max")]
        self._rewards, self._who = np.zeros(n), np.zeros(n, dtype=np.int64)
        (self._shared, self._alone), self._crowded = np.zeros((2, 3), dtype=np.int64), 0
        self._outputs = (
            np.array([self._weights.get(cost, 0.0) for cost in obs.PER_TICK]), self._results, self._costs,
            self._memories, self._states, self._found, self._rewards, np.zeros((n, 3 + units)),
        )  # fmt: skip
        self._trains: list[_Train] = []
        self._kept: list[obs.Sight] = [sight] * n
        self._seeds: list[np.random.Generator] = []
        self._ended, self._compiled = np.zeros(n, dtype=bool), 0

    def _bounds(self, observe: Sequence[str] | None) -> None:
        """Set the observed quantities with bounds for all domains, from the corners of the ranges."""
        corners = [{}, *({d.key: value} for d in self._dimensions for value in (d.at(0.0), d.at(1.0)))]
        setups = [caller_setup(self._choice.with_(corner), Caller(), self._parts) for corner in corners]
        self.setup = setups[0]
        for setup in setups:
            self._check_step(setup)
        found = [obs.observed(setup, observe) for setup in setups]
        common = {}
        for name, first in found[0].items():
            same = [entry[name] for entry in found if name in entry]
            if any((entry.begin, entry.low.size) != (first.begin, first.low.size) for entry in same):
                raise ValueError(
                    f"over: the observation has another size ({name}: {sorted({q.low.size for q in same})} values); "
                    "fix the key, for example 'model.delay' for a random delay of the commands"
                )
            if len(same) < len(found):  # limits of a line that another line lacks
                continue
            low = np.minimum.reduce([entry.low for entry in same])
            high = np.maximum.reduce([entry.high for entry in same])
            common[name] = obs.Quantity(name, first.unit, first.meaning, low, high, first.begin)
        self.quantities: dict[str, obs.Quantity] = common
        self._columns = np.concatenate([np.arange(q.begin, q.begin + q.low.size) for q in common.values()])
        self._all = np.array_equal(self._columns, np.arange(obs.Sight(self.setup).size))

    def _check_step(self, setup: RunSetup) -> None:
        if (setup.tick, setup.control_period) != (self.setup.tick, self.period):
            raise ValueError("all trains have the same tick and control_period; give them by 'set'")

    @property
    def domains(self) -> list[dict[str, Any]]:
        """Keys drawn for the present run of every train."""
        return [train.domain for train in self._trains]

    @property
    def seeds(self) -> list[int]:
        """Seed of the present run of every train; with its domain, :class:`train_ato.Env` repeats it."""
        return [train.setup.scenario.seed for train in self._trains]

    @refusing
    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: Changes | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin a run of every train and return the observations, shape (trains, values), and ``info``.

        Parameters
        ----------
        seed
            Seeds of the runs: one per train, or that of the first one, with the next numbers for the others. Default:
            at the first call that of the scenario, then those that follow from the last seeds given.
        options
            Other keys of the scenario, up to the next :meth:`reset`.

        Raises
        ------
        ValueError
            One line: bad seed or option.
        """
        changed = self._choice.with_(options) if options else self._choice
        if seed is None and self._seeds:
            own = [int(random.integers(MAX_SEED)) for random in self._seeds]
        else:
            first = changed.checked.seed if seed is None else seed
            own = [checked_seed(each) for each in first] if isinstance(first, (Sequence, np.ndarray)) else [
                checked_seed(first) + number for number in range(self.num_envs)
            ]  # fmt: skip
            if len(own) != self.num_envs:
                raise ValueError(
                    f"reset: {len(own)} seeds for {self.num_envs} trains; give one for each, or one number"
                )
            self._seeds = [np.random.default_rng(each) for each in own]
        self._changed, self._trains = changed, []
        for number, each in enumerate(own):
            self._trains.append(self._begun(number, each))
        self._ended[:], self._compiled = False, 0
        return self._observation(), {"engaged": self._states[:, 0] > 0.0}

    def _begun(self, number: int, seed: int) -> _Train:
        """Begin the run of a train and observe its first tick."""
        shares = np.random.default_rng((seed, DOMAIN_STREAM)).random(len(self._dimensions))
        domain = {
            dimension.key: dimension.at(float(share)) for dimension, share in zip(self._dimensions, shares, strict=True)
        }
        caller = Caller()
        choice: ScenarioChoice = self._changed.with_(domain) if domain else self._changed
        setup = caller_setup(choice, caller, self._parts, seed)
        self._check_step(setup)
        train = _Train(setup, caller, self._forces[number], domain)
        sight = self._kept[number] = obs.Sight(train.setup)
        if sight.size != self._found.shape[1]:
            raise ValueError(
                "reset: the observation of another line or train has another size; make another vector_env"
            )
        self._memories[number] = obs.cost_memory(train.loop.plant.train.velocity.item(0))
        train.loop.observe()
        train.known = obs.Known.of(train.loop.controller)
        self._states[number], train.known.state = train.known.state, self._states[number]
        self._take(number, train)
        return train

    def _take(self, number: int, train: _Train) -> None:
        """Write the values that the stages have observed."""
        assert train.known is not None
        train.known.take(train.loop.controller)
        self._found[number] = train.known.values(self._kept[number])

    @refusing
    def step(self, forces: Any) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Drive all trains for one control period and return observations, rewards, terminated, truncated, ``info``.

        Parameters
        ----------
        forces : array, shape (trains, units)
            Force demand of every unit of every train, as for :meth:`train_ato.Env.step`.

        Returns
        -------
        observations, rewards, terminated, truncated, info
            Shapes (trains, values) and (trains,). ``info`` has ``costs`` by name, ``engaged``; after the end of a run
            ``metrics``, ``verdict`` and ``failure``, with a mask under the name with ``_``, as in Gymnasium.

        Raises
        ------
        ValueError
            One line: forces of another shape or not finite, or a step before :meth:`reset`.
        """
        if not self._trains:
            raise ValueError("the environments have no run; call reset() first")
        self._set_forces(forces)
        self._costs.fill(0.0)
        quick = self._run_compiled() == self.num_envs
        if not quick:
            self._run_others(self._ticks)
        found = self._costs.T.copy()
        costs = dict(zip(obs.PER_TICK, found, strict=True))
        info: dict[str, Any] = {"engaged": self._states[:, 0] > 0.0}
        if not quick and self._ended.any():
            info |= self._ends(costs)
        info["costs"] = costs
        rewards = self._rewards.copy() if quick else self._weighted(costs)
        return self._observation(), rewards, self._ended.copy(), np.zeros(self.num_envs, bool), info

    def _weighted(self, costs: dict[str, Array]) -> Array:
        """Return the rewards: minus the weighted sums of the costs."""
        total = np.zeros(self.num_envs)
        for name, weight in self._weights.items():
            if name in costs:
                total += weight * costs[name]
        return -total

    def _run_others(self, ticks: int) -> None:
        """Drive the trains that the common call did not drive to its end, and begin the next runs of ended ones."""
        for number, train in enumerate(self._trains):
            if self._ended[number]:
                self._trains[number] = self._begun(number, int(self._seeds[number].integers(MAX_SEED)))
            elif train.span is None:
                self._advance(number, train, ticks)
            elif not self._results[number, GOES_ON]:
                left = ticks - int(self._results[number, TICKS])
                self._leave_span(number, train)
                self._advance(number, train, left)
        self._ended[:] = [train.ended for train in self._trains]
        compiled = [number for number, train in enumerate(self._trains) if train.span is not None]
        self._compiled = len(compiled)
        self._who[: len(compiled)] = compiled

    def _set_forces(self, given: Any) -> None:
        """Set the force of every unit [N] from those of a step."""
        shape = (self.num_envs, self.n_units)
        try:
            forces = np.asarray(given, dtype=np.float64)
            if np.asarray(given).dtype.kind in "SU":
                raise TypeError("text")
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"step: forces {str(given)[:60]!r} are not numbers; give the shape {shape}") from None
        if forces.shape != shape:
            raise ValueError(f"step: forces have the shape {forces.shape}; give {shape}, a row for every train")
        self._given[:] = forces
        if not set_forces(self._given, *self._limits, self.normalised, self._forces):
            raise ValueError("step: a force is not finite; give numbers")

    def _run_compiled(self) -> int:
        """Run the compiled ticks of a step in the threads; return the number of trains with a compiled next tick."""
        if not self._compiled:
            return 0
        shared = self._alone if self._crowded else self._shared
        self._crowded = max(self._crowded - 1, 0)
        if shared is self._shared and self._compiled > 1:
            _wake(self._threads[0])
        self._step(self._rows, self._compiled, self._who, shared, self._ticks, NS, *self._outputs)
        while shared[UNDONE]:
            time.sleep(1e-4)
            self._crowded = CROWDED
        return int(shared[GOING_ON])

    def _run_alone(self, number: int, ticks: int) -> None:
        """Run compiled ticks of one train."""
        self._step(self._rows, 1, np.array([number]), self._alone, ticks, NS, *self._outputs)

    def _advance(self, number: int, train: _Train, ticks: int) -> None:
        """Run ticks of a train outside of the common call: in Python up to its next span."""
        while ticks > 0 and not train.ended:
            if train.span is None:
                self._tick(number, train)
                ticks -= 1
                continue
            self._run_alone(number, ticks)
            ticks -= int(self._results[number, TICKS])
            if not self._results[number, GOES_ON]:
                self._leave_span(number, train)

    def _tick(self, number: int, train: _Train) -> None:
        """Run law and train of a tick with the stages, and observe the next one."""
        loop, plant = train.loop, train.loop.plant.train
        error = plant.velocity[list(plant.units)] - loop.profile.profile.at(loop.plant.stamp * NS)[1]
        try:
            loop.act()
            self._look(number, train)
        except Exception as failure:  # of a component of the run
            train.watch.fail(loop.active, failure)
            train.ended = True
        arrays = plant.arrays
        obs.add_costs(
            self._costs[number], self._memories[number], error, arrays.state, arrays.unit, arrays.gear, plant.n,
            train.setup.tick,
        )  # fmt: skip

    def _leave_span(self, number: int, train: _Train) -> None:
        """End a span and observe the present tick, in the next span or with the stages."""
        try:
            train.end_span(int(self._results[number, ROWS]))
            self._look(number, train)
        except Exception as failure:  # of a component of the run
            train.watch.fail(train.loop.active, failure)
            train.ended = True

    def _look(self, number: int, train: _Train) -> None:
        """Observe the present tick, or conclude the run after its last one."""
        loop = train.loop
        if loop.plant.finished:
            loop.conclude()
            train.ended = True
            return
        train.span = train.new_span()
        if train.span is not None:
            self._set_row(number, train.span)
            self._run_alone(number, 0)
            if self._results[number, GOES_ON]:
                return
            train.end_span(0)
        loop.observe()
        self._take(number, train)

    def _set_row(self, number: int, span: Span) -> None:
        """Put the arguments of the compiled ticks of a train into its row; ``span`` keeps their arrays."""
        arguments = span.arguments, self._kept[number].arrays
        row = row_numbers(arguments)
        if self._rows is None:
            plain = isinstance(row, tuple)  # without the compiler
            self._rows = [row] * self.num_envs if plain else np.zeros((self.num_envs, len(row)), int)
            common = self._rows, 0, self._who, self._shared, self._ticks, NS, *self._outputs
            self._step = reader_of(step_trains, arguments, *common)
            take_part = partial(self._step, *common)
            for _ in range(0 if plain else self._others):
                Thread(target=_work, args=(take_part, *self._threads), daemon=True).start()
        self._rows[number] = row

    def _ends(self, costs: dict[str, Array]) -> dict[str, Any]:
        """Return the ``info`` of ended runs, and add the costs of their ends."""
        found: dict[str, Any] = {name: np.full(self.num_envs, None) for name in ("metrics", "verdict", "failure")}
        costs |= {"stop": np.zeros(self.num_envs), "punctuality": np.zeros(self.num_envs)}
        for number in np.flatnonzero(self._ended).tolist():
            train = self._trains[number]
            metrics = train.metrics()
            for name, cost in obs.end_costs(train.setup, metrics, float(train.loop.plant.train.position[0])).items():
                costs[name][number] = cost
            found["metrics"][number], found["verdict"][number] = metrics, metrics.get("verdict")
            found["failure"][number] = train.watch.failure
        return found | {f"_{name}": self._ended.copy() for name in found}

    def _observation(self) -> Array:
        return self._found.copy() if self._all else self._found[:, self._columns]

    def close(self) -> None:
        """End all runs and threads."""
        self._trains = []
        self._stop()

    def __enter__(self) -> "VectorEnv":
        """Return the environments, which are closed at the end of the block."""
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def vector_env(scenario: GivenScenario, num_envs: int, **choices: Any) -> VectorEnv:
    """Return many environments whose trains one call drives, see :class:`VectorEnv` for the other arguments."""
    return VectorEnv(scenario, num_envs, **choices)
