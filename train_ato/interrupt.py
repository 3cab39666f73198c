"""Ctrl-C, SIGTERM and a closed terminal: a flag during a run, otherwise KeyboardInterrupt."""

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
"""Wall time before a dropped interruption is sent again [s]."""


class Interrupt:
    """Flag set by Ctrl-C, SIGTERM or a closed terminal; loops read it, so that no callback is interrupted."""

    def __init__(self) -> None:
        self.asked = False

    def ask(self, number: int, frame: FrameType | None) -> None:
        """Signal handler: set the flag."""
        self.asked = True

    def end(self, number: int, frame: FrameType | None) -> None:
        """Signal handler: set the flag and raise KeyboardInterrupt."""
        self.asked = True
        raise KeyboardInterrupt


@contextmanager
def interruptible() -> Iterator[Interrupt]:
    """Yield a flag set by the signals that end a command, so that no step and no write is interrupted."""
    interrupt = Interrupt()
    with _handled(interrupt.ask, (signal.SIGINT, *_ENDING)):
        yield interrupt


@contextmanager
def ending_like_ctrl_c(interrupt: Interrupt) -> Iterator[None]:
    """Handle SIGTERM and a closed terminal like Ctrl-C, so that a command releases its resources.

    Some libraries convert KeyboardInterrupt into their own exception; the flag of ``interrupt`` stays set.
    """
    ignored = signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    numbers = _ENDING if ignored else (signal.SIGINT, *_ENDING)
    with _sent_again(interrupt), _handled(interrupt.end, numbers):
        yield


@contextmanager
def _sent_again(interrupt: Interrupt) -> Iterator[None]:
    """Send an interruption again if it occurs in a callback from C, where Python drops it.

    After an interruption, errors in the destructors of incomplete objects of libraries are not printed; such objects
    exist until the end of the process, and so does the hook.
    """
    before = sys.unraisablehook
    timers: list[threading.Timer] = []

    def on_unraisable(unraisable: Any) -> None:
        if unraisable.exc_type is not KeyboardInterrupt:
            if not interrupt.asked:
                before(unraisable)
            return
        timer = threading.Timer(AGAIN_S, os.kill, (os.getpid(), signal.SIGINT))
        timer.daemon = True
        timers.append(timer)
        timer.start()

    sys.unraisablehook = on_unraisable
    try:
        yield
    finally:
        if not interrupt.asked:
            sys.unraisablehook = before
        for timer in timers:
            timer.cancel()


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], None], numbers: Iterable[int]) -> Iterator[None]:
    """Install signal handlers and restore them on exit; SIGHUP stays ignored under ``nohup``."""
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
