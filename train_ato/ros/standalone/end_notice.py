"""Notice of the end of the run from the plant, on ``train/end``; without it the absence of the plant is a failure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from train_ato.messages.topics import END_TOPIC, Role
from train_ato.ros.nodes.endpoints import NodeEndpoints

CUT = "its messages ended without the notice of the end of the run: the process ended, or the link is cut"
"""Reason of the failure of a plant that has left."""


class EndNotice:
    """Receiver of the notice.

    Parameters
    ----------
    endpoints
        Endpoints of a node other than the plant; those of the recorder are polled.
    """

    def __init__(self, endpoints: NodeEndpoints) -> None:
        self._received = False
        self._take: Callable[[], Any] | None = None
        if endpoints.role is Role.RECORDER:
            self._take, _ = endpoints.taker(END_TOPIC)
        else:
            endpoints.subscribe({END_TOPIC: self._on_end})

    def _on_end(self, _: Any) -> None:
        self._received = True

    @property
    def received(self) -> bool:
        """True after the notice."""
        if self._take is not None and self._take() is not None:
            self._received = True
        return self._received
