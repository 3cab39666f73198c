"""Ctrl-C, SIGTERM and a closed terminal: a flag during a run, otherwise KeyboardInterrupt."""

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from multiprocessing import resource_tracker
from threading import get_ident
from time import monotonic
from types import FrameType
from typing import Any, ClassVar, NoReturn

from train_ato.program.errors import RunFailed

_ENDING = (signal.SIGTERM, signal.SIGHUP)
RETURN_S = 2.0
"""Wall time after which a call of a component, interrupted by Ctrl-C, is ended [s]."""
STEP_LIMIT_S = 8.0
"""Wall time after which the step of a component outside of this project is ended [s]; less than the time-out of 10 s
after which the graph gives up a node."""
_LOOK_S = 0.1
BURST_S = 1.0
"""Wall time in which several signals count as one: Ctrl-C is often pressed more than once [s]."""
AGAIN_S = 0.05
"""Wall time before a dropped interruption is sent again [s]."""


class ComponentCall:
    """Context of a call of a control law, an observer or another component that a user can write.

    ``sys.exit()`` in it, and Ctrl-C during a call that does not return, become :class:`RunFailed` with its name.

    Parameters
    ----------
    name
        Kind and name of the component, for messages.
    """

    _since: ClassVar[dict[int, float]] = {}
    """Wall time of the begin of the call of every thread [s]."""
    interrupted: ClassVar[bool] = False
    """True after Ctrl-C during a call that does not return."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __enter__(self) -> None:
        self._since[get_ident()] = monotonic()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        del self._since[get_ident()]
        if error is None:
            return
        if isinstance(error, SystemExit):
            raise RunFailed(f"{self.name} {text_of_exit(error)}") from error
        if isinstance(error, KeyboardInterrupt):
            raise RunFailed(f"{self.name} did not return; Ctrl-C ended it") from error

    @classmethod
    def overdue(cls) -> bool:
        """Return True if the main thread is inside a call that takes longer than :data:`RETURN_S`."""
        since = cls._since.get(threading.main_thread().ident or 0)
        return since is not None and monotonic() - since > RETURN_S


class ProcessExit(SystemExit):
    """``os._exit()`` or ``os.exec...()`` of a component: the run would end without a word, its log without an end."""


def text_of_exit(error: SystemExit) -> str:
    """Return the call that ends a process, as text."""
    call, argument = error.args if isinstance(error, ProcessExit) else ("sys.exit", error.code)
    return f"called {call}({argument!r})"


@contextmanager
def no_silent_exit() -> Iterator[None]:
    """Let a call that ends the process in the block raise :class:`ProcessExit`.

    Processes that are forked in it end. A thread that began before the block ends the process too: the worker of a
    library ends so if its parent is gone.
    """
    process = os.getpid()
    before = {thread.ident for thread in threading.enumerate()} - {get_ident()}
    ends = {name: getattr(os, name) for name in ("_exit", "execv", "execve")}  # every os.exec...() calls one of them

    def refused(name: str, argument: object, *others: object) -> NoReturn:
        if os.getpid() != process or get_ident() in before:
            ends[name](argument, *others)
        raise ProcessExit(f"os.{name}", argument)

    for name in ends:
        setattr(os, name, partial(refused, name))
    try:
        yield
    finally:
        for name, end in ends.items():
            setattr(os, name, end)


class TimedOut(BaseException):
    """End of a step of a component that takes too long.

    ``except Exception`` in the step does not catch it.
    """


class StepLimit:
    """Context of a step of a component outside of this project: after :data:`STEP_LIMIT_S` it is ended.

    A thread looks at the running steps. It sends SIGURG, which is ignored without a handler, to the main thread, where
    it also ends a wait, and an asynchronous exception to another thread. Both act between two bytecodes: a call that
    never returns from C goes on.
    """

    _until: ClassVar[dict[int, float]] = {}
    """Wall time of the end of the step of every thread [s]."""
    _watch: ClassVar[threading.Thread | None] = None
    _handled: ClassVar[bool] = False

    def __enter__(self) -> None:
        self._until[get_ident()] = monotonic() + STEP_LIMIT_S
        self._begin_watch()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self._until.pop(get_ident(), None)

    @classmethod
    def _begin_watch(cls) -> None:
        """Start the thread, and handle its signal, each once."""
        if cls._watch is None:
            cls._watch = threading.Thread(target=cls._look, name="step limit", daemon=True)
            cls._watch.start()
        if not cls._handled and threading.current_thread() is threading.main_thread():
            cls._handled = True
            signal.signal(signal.SIGURG, cls._end)

    @classmethod
    def forget_watch(cls) -> None:
        """Start the thread again at the next step: no thread lives on after a fork."""
        cls._watch = None

    @classmethod
    def _end(cls, number: int, frame: FrameType | None) -> None:
        """Signal handler: end the step of the main thread, if it is still running."""
        until = cls._until.get(get_ident())
        if until is not None and monotonic() >= until:
            cls._until[get_ident()] = monotonic() + _LOOK_S  # again, if the step catches it
            raise TimedOut

    @classmethod
    def _look(cls) -> None:
        """End the steps that are overdue."""
        wait = threading.Event().wait
        while True:
            wait(_LOOK_S)
            main = threading.main_thread().ident
            for thread, until in tuple(cls._until.items()):
                if monotonic() < until:
                    continue
                if thread == main:
                    signal.pthread_kill(thread, signal.SIGURG)
                else:
                    cls._until[thread] = monotonic() + _LOOK_S
                    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(TimedOut))


os.register_at_fork(after_in_child=StepLimit.forget_watch)


class Interrupt:
    """Flag set by Ctrl-C, SIGTERM or a closed terminal; loops read it, so that no callback is interrupted."""

    def __init__(self) -> None:
        self.asked = False
        self._ended = -BURST_S
        self._number: int | None = None
        self._released = threading.Event()
        self._watching = False

    def ask(self, number: int, frame: FrameType | None) -> None:
        """Signal handler: set the flag; end the call of a component that does not return."""
        self.asked, self._number = True, number
        if ComponentCall.overdue():
            ComponentCall.interrupted = True
            raise KeyboardInterrupt
        if not self._watching:
            self._watching = True
            threading.Thread(target=self._watch, args=(number,), name="interrupt", daemon=True).start()

    def _watch(self, number: int) -> None:
        """Send the signal again if a component does not return."""
        while not self._released.wait(RETURN_S):
            if ComponentCall.overdue():
                os.kill(os.getpid(), number)

    def release(self) -> None:
        """End the watch over components."""
        self._released.set()

    def pass_on(self) -> None:
        """Give the signal to the handler of the program, which ends it: by default KeyboardInterrupt or SystemExit."""
        if self._number is None:
            return
        if signal.getsignal(self._number) == signal.SIG_DFL:
            raise SystemExit(128 + self._number)  # not the signal itself: the program still closes its files
        signal.raise_signal(self._number)

    def reason(self, ticks: int, planned: int) -> str:
        """Return why a run ended after some of its planned ticks; "" without a signal."""
        by = "" if self._number is None else signal.Signals(self._number).name
        return by and f"the run was stopped by {by} after {ticks} of {planned} ticks"

    def end(self, number: int, frame: FrameType | None) -> None:
        """Signal handler: set the flag and raise KeyboardInterrupt, once for signals within :data:`BURST_S`."""
        self.asked = True
        if monotonic() - self._ended >= BURST_S:
            self._ended = monotonic()
            raise KeyboardInterrupt

    def dropped(self) -> None:
        """Let the next signal raise, after a KeyboardInterrupt that Python has dropped."""
        self._ended = -BURST_S


@contextmanager
def interruptible() -> Iterator[Interrupt]:
    """Yield a flag set by the signals that end a command; no write is interrupted, and no step that returns."""
    interrupt = Interrupt()
    with _handled(interrupt.ask, (signal.SIGINT, *_ENDING)):
        try:
            yield interrupt
        finally:
            interrupt.release()


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ignore the signals that end a command, for the writing of its results."""
    with _handled(lambda number, frame: None, (signal.SIGINT, *_ENDING)):
        yield


@contextmanager
def workers_without_ctrl_c() -> Iterator[None]:
    """Start worker processes in the block: Ctrl-C and the closed terminal are for the main process alone.

    The workers inherit the signal mask. multiprocessing unblocks SIGINT when it starts its resource tracker, which
    therefore is started before.
    """
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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
        interrupt.dropped()
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
