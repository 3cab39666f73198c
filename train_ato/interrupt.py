"""Ctrl-C, SIGTERM and a closed terminal: a flag while a run lasts, otherwise the same clean end."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_ENDING = (signal.SIGTERM, signal.SIGHUP)
AGAIN_S = 0.05
"""Wall time after which an interruption that was dropped is sent again."""


class Interrupt:
    """Set by Ctrl-C, SIGTERM or a closed terminal; the loops look at it, so that no callback is cut in the middle."""

    def __init__(self) -> None:
        self.asked = False

    def ask(self, number: int, frame: FrameType | None) -> None:
        """Signal handler: note it."""
        self.asked = True

    def end(self, number: int, frame: FrameType | None) -> None:
        """Signal handler: note it and leave what is under way."""
        self.asked = True
        raise KeyboardInterrupt


@contextmanager
def interruptible() -> Iterator[Interrupt]:
    """Turn the signals that end a command into a flag while a run lasts, so that no step and no write is cut."""
    interrupt = Interrupt()
    with _handled(interrupt.ask, (signal.SIGINT, *_ENDING)):
        yield interrupt


@contextmanager
def ending_like_ctrl_c(interrupt: Interrupt) -> Iterator[None]:
    """Let SIGTERM and a closed terminal end a command as Ctrl-C does: what it holds is given back.

    Libraries make errors of their own of a KeyboardInterrupt that falls into them; ``interrupt`` remembers what began.
    """
    ignored = signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    numbers = _ENDING if ignored else (signal.SIGINT, *_ENDING)
    with _sent_again(), _handled(interrupt.end, numbers):
        yield


@contextmanager
def _sent_again() -> Iterator[None]:
    """Send an interruption again that fell into a callback from C, such as the compiler's: Python drops it there."""
    before = sys.unraisablehook
    timers: list[threading.Timer] = []

    def dropped(what: Any) -> None:
        if what.exc_type is not KeyboardInterrupt:
            before(what)
            return
        timer = threading.Timer(AGAIN_S, os.kill, (os.getpid(), signal.SIGINT))
        timer.daemon = True
        timers.append(timer)
        timer.start()

    sys.unraisablehook = dropped
    try:
        yield
    finally:
        sys.unraisablehook = before
        for timer in timers:
            timer.cancel()


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], None], numbers: Iterable[int]) -> Iterator[None]:
    """Handle signals, and put the handlers back; under ``nohup`` a closed terminal stays without effect."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in numbers}
    taken = {number for number, old in before.items() if number != signal.SIGHUP or old != signal.SIG_IGN}
    for number in taken:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, before[number])
