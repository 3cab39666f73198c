"""Check that a topic, or a name in ``/diagnostics``, has one publisher: identified at discovery, monitored in the run.

In rclpy 7.1 a message has no identifier of its publisher, so messages of two publishers are indistinguishable and a
second publisher fails the run.  The middleware reports every new publisher, at no cost per message; the recorder
checks also that the sequence numbers of the messages are consecutive.
"""

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from train_ato.messages.topics import TOPICS, Role, Topic
from train_ato.messages.variable_codec import status_name
from train_ato.program.errors import NodeFault

_NAMING_S = 3.0
"""Maximum wall time until the name of a new node arrives, after its endpoints [s]; a busy machine takes over 0.3."""
_UNKNOWN = "_NODE_NAME_UNKNOWN_"


def wait_for_names(read: Callable[[], list[str]], least: int = 0) -> list[str]:
    """Return the names of the nodes of a topic's endpoints, after a short wait for at least ``least`` known names."""
    last = time.monotonic() + _NAMING_S
    names = read()
    while (len(names) < least or _UNKNOWN in names) and time.monotonic() < last:
        time.sleep(0.01)
        names = read()
    return names


def in_place_of(node: Node, name: str) -> str:
    """Return the names of programs that publish the topics of a node in its place, "" without one."""
    own = [topic.name for topic in TOPICS if [role.value for role in topic.publishers] == [name]]
    topics = [topic for topic in own if not topic.startswith("/")]  # an absolute one may be that of another train
    found = {info.node_name for topic in topics for info in node.get_publishers_info_by_topic(topic)} - {_UNKNOWN}
    return "" if name in found else " and ".join(sorted(found))


class OnePublisher:
    """Monitor of the publisher of a topic that only one node of the graph sends.

    Attributes
    ----------
    begun : bool
        True after the first message; after it a second publisher is an error.
    name : str
        Name of the node of the publisher, "" as long as it is unknown.
    lost : int
        Number of messages before the first one that :meth:`take` received.
    """

    def __init__(self, node: Node, topic: Topic) -> None:
        self.begun = False
        self.name = ""
        self.lost = 0
        self._node = node
        self._topic = topic
        self._role = topic.publishers[0].value
        self._subscription: Any = None
        self._pinned: tuple[int, ...] | None = None
        self._matches = 1
        self._lost = False
        self._renewed = False
        self._number = 0

    def attach(self, subscription: Any) -> None:
        """Set the subscription of the topic."""
        self._subscription = subscription

    def pin(self) -> None:
        """Store the identifier of the publisher if there is exactly one."""
        found = self._publishers()
        if len(found) == 1:
            self._pinned = tuple(found[0].endpoint_gid)
            self.name = found[0].node_name if found[0].node_name != _UNKNOWN else self.name

    def renew(self) -> None:
        """Accept another publisher as at the start of the run: the process of the node is started again.

        The old one must have left; the messages of the new one are numbered from 1.
        """
        self.begun, self._renewed, self._lost = False, True, True
        self._pinned = None

    def begin(self) -> None:
        """Store the publisher of the first message as that of the run, or as that after a restart of the node.

        Raises
        ------
        ValueError
            If there are several, or another one than at discovery.
        """
        if self._renewed and not self._subscription.get_publisher_count():
            return  # a message of the old publisher
        self.begun = True
        met = self._pinned
        self.pin()
        if self._subscription.get_publisher_count() > 1 or (met is not None and self._pinned != met):
            raise self._refusal()

    def changed(self, event: Any) -> None:
        """Handle the event of a new or lost publisher.

        Raises
        ------
        ValueError
            If a second publisher appears after the first message.  The return of a lost one is no error.
        """
        came = event.total_count > self._matches
        self._matches = max(self._matches, event.total_count)
        if self.begun and came:
            found = [tuple(info.endpoint_gid) for info in self._publishers()]
            if not (self._lost and event.current_count == 1 and self._pinned in found):
                raise self._refusal()
        self._lost = event.current_count == 0

    def take(self, number: int) -> None:
        """Check the sequence number of a message against the one before.

        Raises
        ------
        ValueError
            If the numbers are not consecutive: messages were lost, or there is a second publisher.
        """
        if self.begun and number == self._number + 1:
            self._number = number
            return
        if self._renewed and not self.begun:
            if number not in (1, self._number + 1):
                raise ValueError(f"{self._topic.name}: message {number} came first after the restart of {self._role}")
            self.begin()
            self._number = number
            return
        if self.begun:
            if self._subscription.get_publisher_count() > 1:
                raise self._refusal()
            raise ValueError(
                f"{self._topic.name}: message {number} came after message {self._number}; "
                f"messages were lost, or a second publisher has sent one and left"
            )
        self.begin()
        self._number, self.lost = number, number - 1

    def second(self) -> str:
        """Return the request to stop a second publisher as text, "" without one."""
        if self._subscription.get_publisher_count() <= 1:
            return ""
        return f"the end of {self._others()}, a second publisher of {self._topic.name}"

    def check(self) -> None:
        """Raise ValueError if there is a second publisher after the first message."""
        if self.begun and self._subscription.get_publisher_count() > 1:
            raise self._refusal()
        if self.begun and not self.name:
            self.pin()

    def publisher_name(self) -> str:
        """Return the name of the node of the publisher, as far as it is known."""
        self.pin()
        return self.name or _UNKNOWN

    def _publishers(self) -> list[Any]:
        found = self._node.get_publishers_info_by_topic(self._subscription.topic_name)
        return [info for info in found if info.topic_type == self._topic.type]

    def _refusal(self) -> ValueError:
        return ValueError(f"{self._topic.name} has more than one publisher: {self._others()} too; end it")

    def _others(self) -> str:
        """Return the names of the other nodes that publish the topic, as text."""
        names = wait_for_names(self._names, 2)
        if self.name != self._role and self.name in names:  # a program in place of the node
            names.remove(self.name)
        others = [name for name in names if name != self._role]
        known = {_UNKNOWN: "a node without a name", self.name: f"a second node {self.name}"}
        if others:
            return " and ".join(known.get(name, f"node {name}") for name in others)
        return f"a second node {self._role}" if len(names) > 1 else "a node that has left"

    def _names(self) -> list[str]:
        return sorted(info.node_name for info in self._publishers())


class NamedSenders:
    """Monitor of ``/diagnostics``, which all programs of a domain publish: one publisher for the name of every node.

    A message has no identifier of its publisher, but the messages of a publisher are numbered. If the number of a
    message under the name of a node is not the next number, messages were lost or the message is from another program.

    Attributes
    ----------
    fault : ValueError or None
        First message under the name of a node that the node has not sent.
    """

    def __init__(self, node: Node, topic: Topic, subscription: Any) -> None:
        self.fault: ValueError | None = None
        self._node = node
        self._subscription = subscription
        self._own = {(role.value, node.get_namespace()) for role in topic.publishers}
        self._next: dict[str, set[int]] = {}
        self._count = 0
        self._named: set[str] = set()

    def take(self, data: bytes, number: int, *, lossy: bool = False) -> bool:
        """Return True for a message of a node of the graph, by its name and its sequence number.

        ``lossy``: messages of other topics were lost, so a leap of the number is no sign of another program.
        """
        name = status_name(data)
        if not name:
            return False
        due = self._next.get(name, {number})
        later = number > max(due)
        if number in due or (later and lossy):
            self._next[name] = {number + 1}
            return True
        others = wait_for_names(self._others, 1) if self.fault is None else self._others()
        if self.fault is None and others:
            self.fault = NodeFault(" or ".join(others), f"/diagnostics: it sends under the name of node {name}; end it")
        elif self.fault is None:
            self.fault = ValueError(
                f"/diagnostics: message {number} of node {name} came after message {max(due) - 1}; "
                f"messages were lost, or another program has sent one under its name and left"
            )
        if later and not others:
            self._next[name] = {number + 1}
            return True
        return False

    def renew(self, role: Role) -> None:
        """Accept a new publisher of a node, whose process is started again."""
        self._next.setdefault(role.value, set()).add(1)

    def newcomers(self) -> list[str]:
        """Return the names of the other programs that publish the topic, each once."""
        count = self._subscription.get_publisher_count()
        if count == self._count:
            return []
        names = self._others()
        if len(self._publishers()) >= count and _UNKNOWN not in names:  # names arrive after the endpoints, in any time
            self._count = count
        found = sorted({*names} - self._named - {_UNKNOWN})
        self._named.update(found)
        return found

    def _publishers(self) -> list[Any]:
        return list(self._node.get_publishers_info_by_topic(self._subscription.topic_name))

    def _others(self) -> list[str]:
        """Return the names of the publishers that are not nodes of the graph; a second node of a name is one."""
        met: set[tuple[str, str]] = set()
        others = []
        for info in self._publishers():
            key = (info.node_name, info.node_namespace)
            if key not in self._own:
                others.append(info.node_name)
            elif key in met:
                others.append(f"{info.node_name} (a second one)")
            met.add(key)
        return sorted(others)
