"""Environments of Gymnasium, one for every shipped scenario.

``import train_ato`` after that of Gymnasium registers them: Gymnasium since 1.0 looks up no entry points.

>>> import gymnasium, train_ato  # doctest: +SKIP
>>> env = gymnasium.make("train_ato/XuzhouMetro-v0", set={"duration": 60})  # doctest: +SKIP

A vector environment has the default autoreset mode of Gymnasium, ``NEXT_STEP``: the step after the end of a run is its
reset. One that drives all trains in one compiled call:

>>> envs = gymnasium.make_vec("train_ato/XuzhouMetro-v0", 64)  # doctest: +SKIP
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces

if TYPE_CHECKING:
    from train_ato.api.env.env import Env, Observation
    from train_ato.api.env.vector_env import VectorEnv

VERSION = 0
"""Version of the environments in their names."""


def _spaces(env: Env | VectorEnv, *, flat: bool) -> tuple[spaces.Box, spaces.Box | spaces.Dict]:
    """Return the spaces of the force and of the observation of one train."""
    boxes = {name: spaces.Box(q.low, q.high, dtype=np.float64) for name, q in env.quantities.items()}
    low, high = (np.concatenate([getattr(box, end) for box in boxes.values()]) for end in ("low", "high"))
    observation = spaces.Box(low, high, dtype=np.float64) if flat else spaces.Dict(boxes)
    return spaces.Box(*env.force_bounds, dtype=np.float64), observation


class GymnasiumEnv(gymnasium.Env):  # type: ignore[misc]  # without types where it is not installed
    """The environment of a scenario with the spaces and the seeds of Gymnasium.

    The force of a step is relative to the envelope, from -1 to 1 for every power unit. The observation has the bounds
    of train and line. ``reset(seed=7)`` drives the run with the seed 7. Without a seed it takes one from ``np_random``.

    Parameters
    ----------
    scenario
        As for :class:`train_ato.api.env.env.Env`.
    **choices
        Other arguments of it: ``set``, ``observe``, ``flat``, ``normalised``, ``reward``.

    Attributes
    ----------
    run_env : Env
        The environment, with ``run``, ``save()`` and ``restore()``.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - the declaration of Gymnasium

    def __init__(self, scenario: str, render_mode: str | None = None, **choices: Any) -> None:
        from train_ato.api.env.env import Env  # a late import: the registration needs no compiler

        self.render_mode = render_mode
        self.run_env = env = Env(scenario, **{"normalised": True, **choices})
        self.action_space, self.observation_space = _spaces(env, flat=env.flat)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin a run; ``options`` as in :meth:`train_ato.api.env.env.Env.reset`, with the spaces of the first run."""
        super().reset(seed=seed)
        return self.run_env.reset(seed=int(self.np_random.integers(2**31)) if seed is None else seed, options=options)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive one step; see :meth:`train_ato.api.env.env.Env.step`."""
        return self.run_env.step(action)

    def close(self) -> None:
        """End the run."""
        self.run_env.close()


class GymnasiumVectorEnv(gymnasium.vector.VectorEnv):  # type: ignore[misc]  # as above
    """Environments of a scenario, all driven by one compiled call, with the spaces and the seeds of Gymnasium.

    Parameters
    ----------
    scenario, num_envs
        As for :class:`train_ato.api.env.vector_env.VectorEnv`.
    **choices
        Other arguments of it: ``set``, ``over``, ``observe``, ``normalised``, ``reward``, ``threads``; and ``flat``.

    Attributes
    ----------
    run_envs : VectorEnv
        The environments, with ``seeds`` and ``domains``.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - the declaration of Gymnasium
        "render_modes": [], "autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP,
    }  # fmt: skip

    def __init__(
        self, scenario: str, num_envs: int = 1, render_mode: str | None = None, *, flat: bool = False, **choices: Any
    ) -> None:
        from train_ato.api.env.vector_env import VectorEnv  # a late import: the registration needs no compiler

        self.render_mode, self.num_envs, self._flat = render_mode, num_envs, flat
        self.run_envs = envs = VectorEnv(scenario, num_envs, **{"normalised": True, **choices})
        self.single_action_space, self.single_observation_space = _spaces(envs, flat=flat)
        self._ends = np.cumsum([q.low.size for q in envs.quantities.values()])[:-1]
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)

    def _observed(self, rows: Any) -> Any:
        if self._flat:
            return rows
        return dict(zip(self.run_envs.quantities, np.split(rows, self._ends, axis=1), strict=True))

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin a run of every train; see :meth:`train_ato.api.env.vector_env.VectorEnv.reset`."""
        if isinstance(seed, int):
            super().reset(seed=seed)
        rows, info = self.run_envs.reset(seed=seed, options=options)
        return self._observed(rows), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Drive one step of all trains; see :meth:`train_ato.api.env.vector_env.VectorEnv.step`."""
        rows, *others, info = self.run_envs.step(actions)
        return self._observed(rows), *others, info

    def close_extras(self, **_: Any) -> None:
        """End the runs and the threads."""
        self.run_envs.close()


def _register() -> None:
    """Register the shipped scenarios, without an import of their model, which needs the compiler."""
    for path in sorted((Path(str(files("train_ato"))) / "scenario" / "shipped").glob("*.yaml")):
        name = f"train_ato/{''.join(part.capitalize() for part in path.stem.split('_'))}-v{VERSION}"
        if name not in gymnasium.registry:
            single, vector = (f"{__name__}:{kind.__name__}" for kind in (GymnasiumEnv, GymnasiumVectorEnv))
            kwargs = {"scenario": path.stem}
            gymnasium.register(name, entry_point=single, vector_entry_point=vector, kwargs=kwargs)


_register()
