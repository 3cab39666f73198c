"""Receiving ends of a stage: its topics with their faults and age limits."""

import json

from train_ato.loop.stage_messages import SECOND_NS, without_values
from train_ato.messages.faults import FAULT_TOPICS, NEVER, MessageFault, message_faults
from train_ato.messages.receiver import Receiver
from train_ato.messages.topics import BY_NAME, Role
from train_ato.messages.types import Measurement
from train_ato.scenario.setup import RunSetup

KEY = "faults"
"""Key of the diagnostics with the faults that act on the messages of a node, as a JSON list of texts."""


class StageInputs:
    """Receiving ends of a stage.

    Parameters
    ----------
    setup
        Prepared run; with supervision invalid and old messages are refused.
    role
        Node of the stage.

    Attributes
    ----------
    ends : dict
        Receiving ends of the topics of the loop that the run has.
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
        self._period_ns = setup.tick_ns * (setup.supervision_ticks if role is Role.SUPERVISOR else 1)
        self.ends = {
            name: Receiver(
                BY_NAME[name],
                role,
                faults,
                setup.scenario.seed,
                checked=setup.layout.supervised,
                max_age=round(ages[name] * 1e9) if name in ages else None,
            )
            for name, readers in FAULT_TOPICS.items()
            if role.value in readers and BY_NAME[name].exists(setup.layout)
        }

    def measurement(self, sent: Measurement) -> Measurement:
        """Return the newest valid measurement with the stamp of the sent one, with NaN as values if there is none."""
        found: Measurement | None = self.ends["train/measurement"].receive(sent.stamp, sent)
        return without_values(sent) if found is None else found

    def add(self, fault: MessageFault) -> None:
        """Add a fault of a topic of the run during the run."""
        self.ends[fault.topic].add(fault)

    def is_regular(self, now: int) -> bool:
        """Return True if all valid messages are received as they are sent, from a time [ns] to the next fault."""
        return all(end.is_regular(now) for end in self.ends.values())

    def next_fault(self, now: int) -> int:
        """Return the begin of the next fault after a time [ns]."""
        return min((end.next_fault(now) for end in self.ends.values()), default=NEVER)

    def report_due(self, stamp: int) -> bool:
        """Return True for a stamp [ns] with diagnostics: the first of a second, and one with a change of a receiver.

        A change is the begin or end of a fault, and a refusal for a new reason; it is returned once.
        """
        due = stamp % SECOND_NS < self._period_ns
        for end in self.ends.values():
            due |= end.changed
            end.changed = False
        return due

    def diagnostics(self) -> dict[str, str]:
        """Return faults and counts as text; empty in a run without missed and refused messages."""
        values: dict[str, str] = {}
        faulty = [end for end in self.ends.values() if not end.is_faultless]
        acting = [text for end in faulty for text in end.acting]
        if acting:
            values[KEY] = json.dumps(acting)
        for end in faulty:
            values |= end.diagnostics()
        return values
