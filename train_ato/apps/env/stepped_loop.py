"""Loop of the environment: that of the engine, with its messages in a tree of states in place of one recording."""

from __future__ import annotations

from typing import Any

import numpy as np

from train_ato.apps.env.history import History
from train_ato.loop.engine import TickLoop
from train_ato.loop.setup import RunSetup
from train_ato.loop.stage_messages import Published
from train_ato.messages.types import Array

PARTS = (
    "plant", "profile", "observer", "controller", "supervisor", "ticks", "command", "begun", "_ato", "_release",
)  # fmt: skip
"""Attributes that a run changes."""
TRUTH = ("/clock", "train/vehicles", "train/brake_pipe", "train/brake_pipe_tail", "train/brake_shoes",
         "train/disturbance")  # fmt: skip
"""Topics after the last tick of a run, without its diagnostics."""
GIVEN = "force of the caller"
"""Name of the forces in the history."""


class SteppedLoop(TickLoop):
    """Stages of a run whose ticks are divided before the law.

    Attributes
    ----------
    history : History
        Messages so far.
    command : Array, shape (units,)
        Last command [N].
    begun : int
        Number of entries of the history that belong to the tick that has begun.
    """

    def __init__(self, setup: RunSetup) -> None:
        super().__init__(setup, None)
        self.history = History()
        self.command: Array = np.zeros(setup.layout.n_units)
        self.begun = 0

    def _publish(self, stamp: int, messages: Published) -> None:
        self.history.add(stamp, messages)
        self.begun += 1

    def observe(self) -> None:
        """Run the stages of a tick up to the inputs of the law."""
        self.begun = 0
        super().observe()

    def act(self) -> None:
        """Run the law and the train of a tick."""
        super().act()
        self.command, self.begun = self.history.newest["ato/command"].force, 0

    def note_force(self, force: Array) -> None:
        """Keep the force of a step [N] in the history."""
        self._publish(self.plant.stamp, [(GIVEN, force)])

    def forces(self) -> list[Array]:
        """Return the forces of all steps [N]."""
        return [messages[0][1] for _, messages in self.history.mark().all() if messages and messages[0][0] == GIVEN]

    def messages(self, *, failed: bool = False) -> list[tuple[int, Published]]:
        """Return stamp and messages of all ticks; of one that has begun in a run that goes on only the truth."""
        found = self.history.mark().all()
        if self.begun and not failed:
            begun, found = found[-self.begun :], found[: -self.begun]
            truth = [(topic, message) for topic, message in begun[0][1] if topic in TRUTH]
            found.append((self.plant.stamp, [*truth, ("/diagnostics", self.plant.diagnostic())]))
        return [entry for entry in found if not entry[1] or entry[1][0][0] != GIVEN]

    @property
    def state(self) -> dict[str, Any]:
        """Attributes that a run changes."""
        return {name: getattr(self, name) for name in PARTS}
