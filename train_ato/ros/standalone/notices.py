"""Notices of the process that started the nodes, as lines on their standard input.

=======================  ==============================================================================
``lost ROLE REASON``     the process of the node has ended; the plant stops its train and fails the run
``failed ROLE REASON``   a component has failed, and the controller has braked the train to a stop; the run ends at once
``away ROLE N REASON``   the process of the node has ended and is started again for the Nth time
``begin ROLE STAMP``     to this new process: the old one has left the graph at the stamp [ns]
=======================  ==============================================================================
"""

import os
import queue
import threading
from dataclasses import dataclass
from enum import Enum

from train_ato.messages.topics import Role

LAST_COUNT = "ignored"
"""Name of the number that a node prints last: the messages it could not use. After it the work of the node is done."""

READY = "ready"
"""Name of the number that a node prints once all its endpoints are connected, for an external plant."""

TRAIN_STOPPED = "train stopped"
"""Name of the number that a controller prints if its law, or another component, has failed: it has braked the train."""

STOP_TRAIN = "the controller stops the train"
"""Begin of the line on ``/rosout`` of an observer that has failed: the controller brakes as after a failed law."""

FAILURE, INTERRUPTION, OUTSIDE, NOTE = "failure ", "interruption ", "outside ", "note "
"""Begins of standard-output lines of an attached node: its failure, the end of the plant by a signal, the name of the
external node at the recorder, or a note.

Its standard error may be on a full disk."""


class NoticeKind(Enum):
    """Kind of a notice."""

    LOST = "lost"
    FAILED = "failed"
    AWAY = "away"
    BEGIN = "begin"


@dataclass(frozen=True)
class Notice:
    """One notice about a node; ``text`` is the end of its line."""

    kind: NoticeKind
    role: Role
    text: str

    @property
    def line(self) -> str:
        """Notice as one line."""
        return f"{self.kind.value} {self.role.value} {self.text}"

    @classmethod
    def of(cls, line: str) -> "Notice":
        """Return the notice of a line."""
        kind, _, rest = line.partition(" ")
        role, _, text = rest.partition(" ")
        return cls(NoticeKind(kind), Role(role), text)


Notices = queue.SimpleQueue[Notice]


class EndOrder(threading.Event):
    """Order to end a node.

    Attributes
    ----------
    signal : str
        Name of the signal that gave it; "" for an order of the process that started the node.
    """

    signal = ""


def read_notices(stopped: threading.Event, notices: Notices) -> None:
    """Queue the notices on standard input; set the event when standard input is closed.

    A read without a buffer does not block the exit of the process.
    """
    line = b""
    while found := os.read(0, 4096):
        *whole, line = (line + found).split(b"\n")
        for text in whole:
            notices.put(Notice.of(text.decode(errors="replace")))
    stopped.set()


def begin_stamp(stopped: threading.Event, notices: Notices) -> int | None:
    """Wait for the notice ``begin`` and return its stamp [ns]; None if the run ends before it."""
    while not stopped.is_set():
        try:
            notice = notices.get(timeout=0.05)
        except queue.Empty:
            continue
        if notice.kind is NoticeKind.BEGIN:
            return int(notice.text)
    return None
