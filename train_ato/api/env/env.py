"""Environment: a run that the caller drives step by step, with the force in place of a law."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plant_sim.elementary import plain_sum
from train_ato.api.env import observation as obs
from train_ato.api.env.stepped_loop import History, Past, SharedParts, SteppedLoop
from train_ato.api.run import Run, RunRecord
from train_ato.api.scenario_choice import Changes, GivenScenario, ScenarioChoice, choose_scenario
from train_ato.control.caller import NAME, Caller, forces_text
from train_ato.control.registry import GivenComponent
from train_ato.judge.metric_names import html_table
from train_ato.judge.recording_builder import RecordingBuilder
from train_ato.judge.result import RunResult
from train_ato.messages.types import Array
from train_ato.program.errors import FirstFailure, refusing
from train_ato.program.version import VERSION
from train_ato.scenario.scenario_data import PartCache
from train_ato.scenario.setup import RunSetup

Observation = dict[str, Array] | Array
MAX_SEED = 2**31
"""Bound of the seeds that :meth:`Env.reset` draws."""


@dataclass(frozen=True)
class EnvState:
    """State of an environment, for this or another process of the same version; it can be pickled.

    Like every pickle it must come from a trusted source.

    Attributes
    ----------
    scenario : str
        Name of the scenario.
    hashes : dict of str
        Hash of every key of the scenario with its data, without the seed, and the version.
    seed : int
        Seed of the run.
    data : bytes
        State of all stages.
    past : Past
        Messages so far.
    """

    scenario: str
    hashes: dict[str, str]
    seed: int
    data: bytes
    past: Past


@dataclass
class _Episode:
    """State of the environment beside the stages.

    Attributes
    ----------
    known : Known
        Knowledge of the ATO at the present step.
    memory : Array
        Memory of the costs, :func:`train_ato.api.env.observation.add_costs`.
    failure : str or None
        Failure that ended the run.
    ended : bool
        True after the last step.
    """

    known: obs.Known
    memory: Array
    failure: str | None = None
    ended: bool = False


class CallerForces:
    """Units, period and force limits of the run of a scenario that a caller drives."""

    setup: RunSetup
    normalised: bool

    @property
    def n_units(self) -> int:
        """Number of power units of a train."""
        return self.setup.layout.n_units

    @property
    def period(self) -> float:
        """Duration of a step [s]."""
        return self.setup.control_period

    @property
    def force_bounds(self) -> tuple[Array, Array]:
        """Smallest and largest force of a step [N], or -1 and 1, shape (units,) each."""
        if self.normalised:
            return -np.ones(self.n_units), np.ones(self.n_units)
        model = self.setup.model
        least = np.array([-envelope.largest() for envelope in model.brake])
        return least, np.array([envelope.largest() for envelope in model.traction])


class Env(CallerForces):
    """A run in steps: the caller gives the force of every power unit, the stack and the train do the rest.

    The stages, their order and the numbers are those of :func:`train_ato.run`; the supervisor protects the train as in
    every run. The law, its planned changes, the delay compensation and the shares by place of the scenario have no
    effect. A step lasts ``control_period`` of the scenario, by default a tick.

    Parameters
    ----------
    scenario
        Shipped name, ``name:variant``, a YAML file, or :func:`train_ato.scenario`.
    seed
        Seed of the first :meth:`reset`; default: the seed of the scenario.
    set
        Other keys of the scenario, as for :func:`train_ato.run`.
    observe
        Names of the observed quantities; default: all that the run has, see ``quantities``.
    flat
        True: an observation is one vector, in the order of ``quantities``; False: a dict of vectors.
    normalised
        True: the force of a step is relative to the envelope of every unit at its measured speed, from -1 (largest
        brake) to 1 (largest traction).
    reward
        Weights of the costs by name (:data:`train_ato.api.env.observation.COSTS`) [1/unit]; the reward of a
        step is minus their sum. Default: the weights there.

    Attributes
    ----------
    quantities : dict of Quantity
        Name, unit, meaning and bounds of the observed quantities.
    setup : RunSetup
        Prepared run: scenario, train, line, nominal model, profile.
    flat, normalised : bool
        As given.
    n_units : int
        Number of power units.
    period : float
        Duration of a step [s].

    Raises
    ------
    ValueError
        One line: bad scenario, quantity or cost.

    Examples
    --------
    >>> import train_ato as ta
    >>> env = ta.Env("xuzhou_metro", set={"duration": 20}, observe=("speed", "speed_error"))
    >>> obs, info = env.reset(seed=8)
    >>> ended = False
    >>> while not ended:
    ...     obs, reward, ended, truncated, info = env.step([-1e6 * obs["speed_error"][0]])
    >>> info["metrics"]["simulated_s"], env.run.metrics["seed"]
    (20.0, 8)
    """

    @refusing
    def __init__(
        self,
        scenario: GivenScenario,
        *,
        seed: int | None = None,
        set: Changes | None = None,
        observe: Sequence[str] | None = None,
        flat: bool = False,
        normalised: bool = False,
        reward: Mapping[str, float] | None = None,
    ) -> None:
        self._choice = choose_scenario(scenario).changed(set, seed)
        self._parts = PartCache()
        self._names, self.flat, self.normalised = observe, flat, normalised
        self._weights = obs.weights_of(reward)
        self._caller = Caller()
        self._seeds: np.random.Generator | None = None
        self._loop: SteppedLoop | None = None
        self._run: Run | None = None
        self._prepared(self._choice)

    def _prepared(self, choice: ScenarioChoice) -> None:
        """Prepare the run of a scenario with the caller as the law."""
        setup = caller_setup(choice, self._caller, self._parts)
        self.quantities: dict[str, obs.Quantity] = obs.observed(setup, self._names)
        self.setup, self._sight = setup, obs.Sight(setup)
        self._current, self._hashes = choice, dict[str, str]()

    @refusing
    def reset(self, *, seed: int | None = None, options: Changes | None = None) -> tuple[Observation, dict[str, Any]]:
        """Begin a run and return the first observation and ``info``.

        Parameters
        ----------
        seed
            Seed of the run and of the seeds after it. Default: at the first call that of the scenario, then one that
            follows from the last seed given.
        options
            Other keys of the scenario for this run, in addition to the keys of the constructor: another train, line,
            stop or disturbance.

        Raises
        ------
        ValueError
            One line: bad seed or option.
        """
        choice = self._choice.with_(options) if options else self._choice
        given = None if seed is None else checked_seed(seed)
        if repr(choice) != repr(self._current):
            self._prepared(choice)
        if given is None and self._seeds is not None:
            own = int(self._seeds.integers(MAX_SEED))
        else:
            own = choice.checked.seed if given is None else given
            self._seeds = np.random.default_rng(own)
        self._begin(own)
        self._observe()
        return self._observation(), self._info({})

    def _begin(self, seed: int) -> None:
        """Make the stages of a run with a seed."""
        if seed != self.setup.scenario.seed:
            self.setup = replace(self.setup, scenario=self.setup.scenario.model_copy(update={"seed": seed}))
        self._loop = loop = SteppedLoop(self.setup)
        loop.start()
        stack = loop.controller.stack
        assert stack is not None
        roots = {"profile": loop.controller.profile, "rigid": stack.rigid, "times": loop.controller.step_times}
        self._shared = SharedParts(self.setup, {**roots, "caller": self._caller})
        self._wall, self._run = time.perf_counter(), None
        self._watch = FirstFailure()
        self._episode: _Episode | None = None

    def _observe(self) -> None:
        """Run the stages before the law."""
        loop = self._started()
        loop.observe()
        if self._episode is None:
            self._episode = _Episode(obs.Known.of(loop.controller), obs.cost_memory(loop.plant.train.velocity.item(0)))
        self._episode.known.take(loop.controller)

    @refusing
    def step(
        self, force: Any, signals: Mapping[str, float] | None = None
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive one control period with a force and return observation, reward, terminated, truncated, ``info``.

        Parameters
        ----------
        force : float or array, shape (units,)
            Force demand of every unit [N], > 0 forward, or relative to its envelope. One number is enough for a train
            with one unit. The stack limits it to the envelope, like the demand of a law.
        signals
            Own numbers by name, for ``info``, the log and the report: the diagnostics ``signals``.

        Returns
        -------
        observation, reward, terminated, truncated, info
            ``terminated`` is True at the end of the run. ``info`` then has ``metrics`` and ``verdict``, and ``failure``
            if the run failed; the observation is the last one. ``truncated`` is always False. ``info`` has ``costs`` by
            name, the last ``command`` [N], ``engaged`` (True: the force of the next step drives), ``brake`` and
            ``reason`` of the train. With a supervisor it also has ``interventions``, ``ato_state`` and ``ato_reason``,
            and ``takeover`` while the braking law drives instead of the caller.

        Raises
        ------
        ValueError
            One line: a force of another shape or not finite, or a step before :meth:`reset` or after the end.
        """
        loop, episode = self._started(), self._episode
        assert episode is not None
        if episode.ended:
            raise ValueError("step: the run has ended; call reset()")
        self._caller.force = self._force(force)
        if signals:
            texts = obs.signal_texts(signals, "step")
            if known := sorted(texts.keys() & {*self._info({}), "metrics", "verdict", "failure"}):
                raise ValueError(f"step: signal {known[0]!r} is a name of info; choose another one")
            loop.note(texts)
        loop.note_force(self._caller.force)
        tick_costs = np.zeros(len(obs.PER_TICK))
        for _ in range(round(self.period / self.setup.tick)):
            self._tick(loop, episode, tick_costs)
            if episode.ended:
                break
        costs = dict(zip(obs.PER_TICK, tick_costs.tolist(), strict=True))
        if episode.ended:
            front = float(loop.plant.train.position[0])
            costs |= obs.end_costs(self.setup, self.run.metrics, front)
        reward = -plain_sum(weight * costs.get(name, 0.0) for name, weight in self._weights.items())
        return self._observation(), reward, episode.ended, False, {**(signals or {}), **self._info(costs)}

    def _tick(self, loop: SteppedLoop, episode: _Episode, costs: Array) -> None:
        """Run law and train of a tick and add its costs."""
        train, tick = loop.plant.train, self.setup.tick
        error = train.velocity[list(train.units)] - loop.profile.profile.at(loop.plant.stamp * 1e-9)[1]
        try:
            loop.act()
            episode.ended = loop.plant.finished
            if episode.ended:
                loop.conclude()
            else:
                self._observe()
        except Exception as failure:  # of a component of the run; it is in its record
            self._watch.fail(loop.active, failure)
            episode.ended, episode.failure = True, self._watch.failure
        arrays = train.arrays
        obs.add_costs(costs, episode.memory, error, arrays.state, arrays.unit, arrays.gear, train.n, tick)

    def _force(self, given: Any) -> Array:
        """Return the force of every unit [N] from that of a step."""
        try:
            force = np.array(given, dtype=np.float64)
            if np.asarray(given).dtype.kind in "SU":
                raise TypeError("text")
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"step: force {str(given)[:60]!r} is not a number per unit; give {self.n_units}") from None
        if force.shape == () and self.n_units == 1:
            force = force.reshape(1)
        if force.shape != (self.n_units,):
            raise ValueError(f"step: force has the shape {force.shape}; give ({self.n_units},), one per power unit")
        if not np.isfinite(force).all():
            raise ValueError(f"step: force {force.tolist()} is not finite; give numbers")
        if not self.normalised:
            return force
        assert self._episode is not None
        low, high = self.setup.model.force_limits(self._episode.known.measurement.velocity)
        return np.where(force < 0.0, -low, high) * force

    def _started(self) -> SteppedLoop:
        if self._loop is None:
            raise ValueError("the environment has no run; call reset() first")
        return self._loop

    def _observation(self) -> Observation:
        assert self._episode is not None
        values = self._episode.known.values(self._sight)
        found = {name: values[quantity.part] for name, quantity in self.quantities.items()}
        return obs.flat_vector(found) if self.flat else found

    def _info(self, costs: dict[str, float]) -> dict[str, Any]:
        loop, episode = self._started(), self._episode
        assert episode is not None
        protection, ato = loop.plant.protection, loop.controller.ato
        info: dict[str, Any] = {
            "time": loop.ticks * self.setup.tick,
            "command": loop.command.copy(),
            "engaged": episode.known.engaged,
            "brake": protection.level.text,
            "reason": protection.reason,
            "costs": costs,
        }
        if loop.supervisor is not None:
            stamp = loop.controller.received.measurement.stamp
            info |= ato.diagnostics(stamp) | {"interventions": loop.supervisor.supervisor.interventions}
        if episode.ended:
            metrics = self.run.metrics
            info |= {"metrics": metrics, "verdict": metrics.get("verdict"), "failure": episode.failure}
        return info

    @property
    @refusing
    def run(self) -> Run:
        """The run up to now, as :func:`train_ato.run` returns it; before the end it is an interrupted one.

        Raises
        ------
        ValueError
            Before the first :meth:`reset`.
        """
        self._started()
        assert self._episode is not None
        if not self._episode.ended:
            return self._made_run(self._episode)
        if self._run is None:
            self._run = self._made_run(self._episode)
        return self._run

    def _repr_html_(self) -> str:
        name = self._current.name
        if self._loop is None:
            verdict = f"{name}: not begun; call reset()"
        elif self._episode is not None and self._episode.ended:
            verdict = self.run.result.title
        else:
            verdict = (
                f"{name}: running, {self._loop.ticks * self.setup.tick:.1f} s of {self.setup.scenario.duration:.1f} s"
            )
        rows = ((key, quantity.unit, quantity.meaning) for key, quantity in self.quantities.items())
        return html_table(verdict, ("observed", "unit", "meaning"), rows)

    def _made_run(self, episode: _Episode) -> Run:
        loop, laws = self._started(), {NAME: {"forces": forces_text(self._started().forces())}}
        setup = replace(self.setup, scenario=self.setup.scenario.model_copy(update={"laws": laws}), given={})
        builder, record = RecordingBuilder(setup), RunRecord(setup)
        try:
            for stamp, published in loop.messages(failed=episode.failure is not None):
                builder.extend(published)
                for topic, message in published:
                    record.add(topic, message, stamp)
        finally:
            record.close_log()
        counts, recording = builder.counts, builder.finish()
        wall, times = time.perf_counter() - self._wall, loop.controller.step_times
        outcome = RunResult.of(
            setup, recording, wall, loop.ticks, times, interrupted=not episode.ended,
            failure=episode.failure, published=counts,
            interruption=f"the environment is after {loop.ticks} of {setup.ticks} ticks",
        )  # fmt: skip
        outcome = record.counted(replace(outcome, summary={**outcome.summary, "mode": "engine"}))
        return Run(outcome.summary, record=record, setup=setup, outcome=outcome)

    @refusing
    def save(self) -> EnvState:
        """Return the present state; :meth:`restore` continues from it bit for bit.

        The states of one environment share the messages before them, so that a tree of states needs little memory.
        """
        loop = self._started()
        data = self._shared.dump((loop.state, self._episode))
        scenario = self.setup.scenario
        return EnvState(scenario.name, self._fingerprint(), scenario.seed, data, loop.history.mark())

    @refusing
    def restore(self, state: EnvState) -> tuple[Observation, dict[str, Any]]:
        """Continue from a state of :meth:`save`, also of another environment or process; return as :meth:`reset`.

        Raises
        ------
        ValueError
            One line: a state of another scenario or version.
        """
        if not isinstance(state, EnvState):
            raise ValueError(f"restore: {type(state).__name__} is not a state; give the result of save()")
        own = self._fingerprint()
        other = [key for key in {**own, **state.hashes} if own.get(key) != state.hashes.get(key)]
        if other:
            raise ValueError(f"restore: state of another scenario, '{state.scenario}' with another {', '.join(other)}")
        if self._loop is None or self.setup.scenario.seed != state.seed:
            self._begin(state.seed)
        loop = self._started()
        try:
            stages, self._episode = self._shared.load(state.data)
        except Exception as error:  # the bytes can name any part
            if self._episode is None:
                self.close()
            raise ValueError(f"restore: the state is damaged ({error}); save() it again") from None
        vars(loop).update(stages)
        loop.history, self._run = History(state.past), None
        return self._observation(), self._info({})

    def _fingerprint(self) -> dict[str, str]:
        """Return the hash of every key of the scenario except the seed, and the version."""
        if not self._hashes:
            self._hashes = {**self.setup.fingerprint(), "version": VERSION}
            self._hashes.pop("seed", None)
        return self._hashes

    def __reduce__(self) -> Any:
        """Refuse a copy by ``copy`` or ``pickle``."""
        raise TypeError("an Env is neither copied nor pickled; give the result of save() to restore() of another Env")

    def close(self) -> None:
        """End the run; :meth:`reset` begins another one."""
        self._loop = self._run = None

    def __enter__(self) -> "Env":
        """Return the environment, which is closed at the end of the block."""
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def caller_setup(choice: ScenarioChoice, caller: Caller, parts: PartCache, seed: int | None = None) -> RunSetup:
    """Return the prepared run of a scenario with a caller as the law, and with another seed."""
    block = {"law": NAME, "law_changes": (), "laws": {}, "compensation": "none", "compensations": {}}
    more = {} if seed is None else {"seed": seed}
    scenario = choice.checked.model_copy(update={**block, "force_shares": None, **more})
    return replace(choice.prepare(scenario, parts), given={"law": GivenComponent(caller, NAME, {})})


def checked_seed(seed: Any) -> int:
    """Return the seed of a run."""
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ValueError(f"reset: seed {seed!r} is not possible; give a whole number from 0 on")
    return int(seed)
