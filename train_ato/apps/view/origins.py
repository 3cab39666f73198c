"""Check of the ``Host`` and ``Origin`` headers of browsers.

Every web page can open a WebSocket to this machine; only its origin distinguishes it from a program of the user.
"""

from __future__ import annotations

from urllib.parse import urlsplit

LOOPBACK = "127.0.0.1"
LOCAL_IPV6 = "::1"
LOCAL_NAMES = frozenset(("localhost", LOOPBACK, LOCAL_IPV6))
"""Names of this machine that no other host can have."""
FOXGLOVE_ORIGINS = frozenset(("https://app.foxglove.dev", "https://studio.foxglove.dev", "file://"))
"""Origins of Foxglove: its web app, and its desktop app, whose pages are files."""


def host_of(header: str) -> str:
    """Return the host name of a ``Host`` header without its port, in lower case; empty if it is not valid."""
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""


def may_read_topics(host: str, origins: list[str]) -> bool:
    """Return True if a WebSocket client may read the topics of the run.

    Parameters
    ----------
    host
        ``Host`` header; a name of this machine is accepted.
    origins
        All ``Origin`` headers.  None is a program, which the user started; pages must come from this machine or from
        Foxglove.  The origin ``null``, which every page can have, is refused.
    """
    if host_of(host) not in LOCAL_NAMES or len(origins) > 1:
        return False
    if not origins or origins[0] in FOXGLOVE_ORIGINS:
        return True
    scheme, separator, rest = origins[0].partition("://")
    return scheme in ("http", "https") and bool(separator) and host_of(rest) in LOCAL_NAMES
