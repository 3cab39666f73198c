"""Node ``profile``: sends the speed profile, latched, again when planned anew, and its reference for every step."""

from __future__ import annotations

import sys

from train_ato.nodes.shell import Shell
from train_ato.roles.profile import ProfileRole
from train_ato.types import Measurement


class ProfileNode:
    """Answers every measurement with the reference of its stamp."""

    def __init__(self, role: ProfileRole, shell: Shell) -> None:
        self.role = role
        self.shell = shell
        self.ignored = 0
        shell.subscribe({"train/measurement": self._measured})

    def begin(self) -> None:
        """Send the profile and the limits; they stay there for nodes that come later."""
        self.shell.publish_all(self.role.start())

    def _measured(self, measurement: Measurement) -> None:
        if measurement.stamp <= self.shell.last_stamp:
            self.ignored += 1
            return
        self.shell.publish_all(self.role.answer(measurement))


def main() -> int:
    """Run this node alone in a process."""
    from train_ato.nodes.process import run_role
    from train_ato.topics import Role

    return run_role(Role.PROFILE)


if __name__ == "__main__":
    sys.exit(main())
