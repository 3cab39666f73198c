"""Orders from the keyboard while a run is published, the keys of ``ros2 bag play``."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from train_ato.replay.playback import Playback

RATE_STEP = 1.1


def _faster(playback: Playback) -> None:
    playback.set_rate(playback.state.rate * RATE_STEP)


def _slower(playback: Playback) -> None:
    playback.set_rate(playback.state.rate / RATE_STEP)


def _toggle(playback: Playback) -> None:
    if playback.state.paused:
        playback.resume()
    else:
        playback.pause()


KEYS: dict[bytes, Callable[[Playback], None]] = {
    b" ": _toggle,
    b"\x1b[C": lambda playback: playback.play_next(),
    b"\x1b[A": _faster,
    b"\x1b[B": _slower,
}
"""What a terminal sends for space and the arrows right, up and down."""


def pressed(text: bytes) -> Iterator[Callable[[Playback], None]]:
    """Return the orders of the keys in what came from a terminal; other keys are passed over."""
    while text:
        for key, order in KEYS.items():
            if text.startswith(key):
                yield order
                text = text[len(key) :]
                break
        else:
            text = text[1:]


@contextmanager
def keyboard(wanted: bool) -> Iterator[Callable[[Playback], None] | None]:
    """Read single keys from the terminal, if there is one and it is ours; it is put back as it was.

    Yields
    ------
    callable or None
        Gives the orders of the keys that were pressed; None without a terminal.
    """
    if not (wanted and sys.stdin and sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()):
        yield None
        return
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)

    def orders(playback: Playback) -> None:
        while select.select([terminal], [], [], 0)[0]:
            text = os.read(terminal, 64)
            if not text:
                return
            for order in pressed(text):
                with suppress(ValueError):  # play_next without a pause
                    order(playback)

    try:
        yield orders
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
