"""Receiving ends of a stage: its topics with their faults and age limits."""

import json
from collections.abc import Callable, Sequence
from typing import Any

from train_ato.loop.stage_messages import without_values
from train_ato.messages.faults import FAULT_TOPICS, NEVER, MessageFault, message_faults
from train_ato.messages.receiver import Receiver
from train_ato.messages.topics import BY_NAME, Role
from train_ato.messages.types import Measurement
from train_ato.scenario.setup import RunSetup

KEY = "faults"
"""Key of the diagnostics with the faults that act on the messages of a node, as a JSON list of texts."""


class StageInputs:
    """Receiving ends of a stage by topic.

    Parameters
    ----------
    setup
        Prepared run; with supervision invalid and old messages are refused.
    role
        Node of the stage.
    """

    def __init__(self, setup: RunSetup, role: Role) -> None:
        spec = setup.scenario.supervision.failsafe
        period = setup.supervision_ticks * setup.tick
        ages = {
            "train/measurement": spec.hold,
            "ato/reference": spec.hold,
            "ato/estimate": spec.hold,
            "train/protection": spec.hold + period,
            "atp/speeds": spec.hold + period,
            "ato/state": spec.hold + period,
            "train/odometry": 0.0,
        }
        faults = message_faults(setup.scenario.faults)
        self._supervised = setup.layout.supervised
        self._receivers = {
            name: Receiver(
                BY_NAME[name],
                role,
                faults,
                setup.seed,
                checked=self._supervised,
                max_age=round(ages[name] * 1e9) if name in ages else None,
            )
            for name, readers in FAULT_TOPICS.items()
            if role.value in readers and BY_NAME[name].exists(setup.layout)
        }

    def receive(self, topic: str, now: int, message: Any) -> Any:
        """Return the newest valid message of a topic at a time [ns]; None without one.

        A topic that the run does not have has no faults.
        """
        receiver = self._receivers.get(topic)
        return message if receiver is None else receiver.receive(now, message)

    def fresh(self, topic: str) -> bool:
        """Return True if the last call for a topic accepted a new message."""
        return topic in self._receivers and self._receivers[topic].fresh

    def measurement(self, sent: Measurement) -> Measurement:
        """Return the newest valid measurement with the stamp of the sent one, with NaN as values if there is none."""
        found: Measurement | None = self.receive("train/measurement", sent.stamp, sent)
        return without_values(sent) if found is None else found

    def add(self, fault: MessageFault) -> None:
        """Add a fault during the run.

        Raises
        ------
        ValueError
            If the run has no such topic.
        """
        if fault.topic not in self._receivers:
            raise ValueError(f"{fault.topic}: this run has no such topic; use one of {', '.join(self._receivers)}")
        self._receivers[fault.topic].add(fault)

    def check(self, topic: str, check: Callable[[Any], str]) -> None:
        """Set the check of a topic by the stage; it returns the problem of a message as text."""
        self._receivers[topic].check = check

    def is_regular(self, now: int) -> bool:
        """Return True if all valid messages are received as they are sent, from a time [ns] to the next fault."""
        return all(receiver.is_regular(now) for receiver in self._receivers.values())

    def next_fault(self, now: int) -> int:
        """Return the begin of the next fault after a time [ns]."""
        return min((receiver.next_fault(now) for receiver in self._receivers.values()), default=NEVER)

    def accept(self, topic: str, count: int, messages: Sequence[Any]) -> None:
        """Take valid messages of a topic: their number, and the last two or the only one."""
        if topic in self._receivers and count:
            self._receivers[topic].accept(count, messages)

    def take_changed(self) -> bool:
        """Return True once after the begin or end of a fault, and after a refusal for a new reason."""
        changed = False
        for receiver in self._receivers.values():
            changed |= receiver.changed
            receiver.changed = False
        return changed

    def diagnostics(self) -> dict[str, str]:
        """Return faults and counts as text; empty in a run without missed and refused messages."""
        values: dict[str, str] = {}
        faulty = [receiver for receiver in self._receivers.values() if not receiver.is_faultless]
        acting = [text for receiver in faulty for text in receiver.acting]
        if acting:
            values[KEY] = json.dumps(acting)
        for receiver in faulty:
            values |= receiver.diagnostics()
        return values
