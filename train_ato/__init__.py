"""Onboard automatic train operation as a ROS 2 node graph: profiles, observers, laws, links, log.

``train_ato.load(run)`` opens a recorded run as pandas tables.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from train_ato.frames.loading import Frames as Frames
    from train_ato.frames.loading import load as load

_LAZY = ("Frames", "load")


def __getattr__(name: str) -> Any:
    """Import pandas and what reads logs only for those who ask for it."""
    if name in _LAZY:
        from train_ato.frames import loading

        return getattr(loading, name)
    raise AttributeError(f"module 'train_ato' has no attribute '{name}'")
