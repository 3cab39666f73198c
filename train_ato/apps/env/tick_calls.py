"""Functions of the user that are called in every tick of a run: own signals, and the end of the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from train_ato.apps.env.observation import Known, observed
from train_ato.loop.engine import TickLoop
from train_ato.loop.setup import RunSetup
from train_ato.messages.types import Array

OnTick = Callable[[dict[str, Array]], Mapping[str, float] | None]
StopWhen = Callable[[dict[str, Array]], bool]


class TickCalls:
    """Calls of ``on_tick`` and ``stop_when`` with the observation of every tick.

    Parameters
    ----------
    setup
        Prepared run.
    on_tick
        Receives the observation by name (:func:`train_ato.apps.env.observation.observed`); returns own numbers by name
        for the log, or None.
    stop_when
        Receives the same; True ends the run after this tick.

    Attributes
    ----------
    stopped : bool
        True after ``stop_when`` has ended the run.
    """

    def __init__(self, setup: RunSetup, on_tick: OnTick | None, stop_when: StopWhen | None) -> None:
        self._quantities = observed(setup)
        self._on_tick, self._stop_when = on_tick, stop_when
        self._known: Known | None = None
        self.stopped = False

    def __call__(self, loop: TickLoop) -> bool:
        """Call the functions; return True if the run ends after this tick."""
        known = self._known = self._known or Known.of(loop.controller)
        known.take(loop.controller)
        values = {name: quantity.read(known).copy() for name, quantity in self._quantities.items()}
        if self._on_tick is not None and (signals := self._on_tick(values)):
            loop.note(signal_texts(signals, "on_tick"))
        self.stopped = self._stop_when is not None and bool(self._stop_when(values))
        return self.stopped


def signal_texts(signals: Any, source: str) -> dict[str, str]:
    """Return own signals as text of the diagnostics.

    Raises
    ------
    ValueError
        If they are not numbers by name.
    """
    try:
        return {str(name): repr(float(value)) for name, value in signals.items()}
    except (AttributeError, TypeError, ValueError) as error:
        raise ValueError(f"{source}: signals {str(signals)[:60]} are not numbers by name ({error})") from None
