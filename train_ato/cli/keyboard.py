"""Keyboard control of a replay, with the keys of ``ros2 bag play``."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from train_ato.apps.replay.playback import Playback

RATE_STEP = 1.1


KEYS: dict[bytes, Callable[[Playback], None]] = {
    b" ": lambda playback: playback.toggle_paused(),
    b"\x1b[C": lambda playback: playback.play_next(),
    b"\x1b[A": lambda playback: playback.set_rate(playback.state.rate * RATE_STEP),
    b"\x1b[B": lambda playback: playback.set_rate(playback.state.rate / RATE_STEP),
}
"""Terminal codes of space and the arrows right, up and down."""


def pressed(text: bytes) -> Iterator[Callable[[Playback], None]]:
    """Yield the actions of the keys in terminal input; other keys are ignored."""
    while text:
        for key, action in KEYS.items():
            if text.startswith(key):
                yield action
                text = text[len(key) :]
                break
        else:
            text = text[1:]


@contextmanager
def keyboard(wanted: bool) -> Iterator[Callable[[Playback], None] | None]:
    """Read single keys from the terminal of this process; restore its settings on exit.

    Yields
    ------
    callable or None
        Function that performs the actions of the pressed keys; None without a terminal.
    """
    if not (wanted and sys.stdin and sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()):
        yield None
        return
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)

    def perform(playback: Playback) -> None:
        while select.select([terminal], [], [], 0)[0]:
            text = os.read(terminal, 64)
            if not text:
                return
            for action in pressed(text):
                with suppress(ValueError):  # play_next needs a pause
                    action(playback)

    try:
        yield perform
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
