"""Name of the node without an answer, in the order of dependence."""

from __future__ import annotations

from train_ato.messages.topics import Role


def silent_node(last: dict[Role, int], stamp: int, blocked: bool, supervised: int = -1) -> Role:
    """Return the node without an answer to the stamp: the first in the order of dependence.

    Parameters
    ----------
    last
        Stamp of the last answer of every node [ns].
    stamp
        Stamp of the plant [ns].
    blocked
        True if the plant waits for the recorder.
    supervised
        Stamp of the newest step of the supervisor [ns]; -1 without one.
    """
    if blocked:
        return Role.RECORDER
    if last.get(Role.SUPERVISOR, -1) < supervised:
        return Role.SUPERVISOR
    for role in (Role.PROFILE, Role.OBSERVER):
        if last.get(role, -1) < stamp:
            return role
    return Role.CONTROLLER
