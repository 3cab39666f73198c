"""Node ``observer``: answers every measurement with the disturbance estimate of its stamp."""

from __future__ import annotations

import sys
from dataclasses import replace

from train_ato.control.contract import Parameter
from train_ato.nodes.parameters import Declared, block_parameters, declare
from train_ato.nodes.shell import Shell
from train_ato.observe.registry import OBSERVERS
from train_ato.roles.observer import ObserverRole
from train_ato.run_setup import RunSetup
from train_ato.types import Measurement


class ObserverNode:
    """Wraps the observer that the scenario chose, or the parameter ``observer`` given at the start.

    Raises
    ------
    ValueError
        If a parameter given at the start is unknown, out of range or refused by the observer.
    """

    def __init__(self, setup: RunSetup, shell: Shell) -> None:
        self.shell = shell
        self.ignored = 0
        self.role = ObserverRole(self._declared(setup))
        shell.subscribe({"train/measurement": self._measured})

    def _declared(self, setup: RunSetup) -> RunSetup:
        """Declare the observer and its parameters; return the setup with what was given at the start."""
        names = OBSERVERS.names()
        given = setup.scenario.observers
        chosen = Parameter("observer", setup.observer, "", 0.0, 0.0, "disturbance observer", names)
        parameters = [Declared("observer", setup.observer, chosen, read_only=True)]
        for name in names:
            parameters += block_parameters(name, OBSERVERS.parameters(name), given.get(name, {}), read_only=True)
        values = declare(self.shell.node, parameters)
        changed = {p.name: values[p.name] for p in parameters if values[p.name] != p.value}
        if not changed:
            return setup
        blocks = {name: dict(block) for name, block in given.items()}
        for name, value in changed.items():
            block, dot, key = name.partition(".")
            if dot:
                blocks.setdefault(block, {})[key] = value
        update = {"observer": values["observer"], "observers": blocks}
        return replace(setup, scenario=setup.scenario.model_copy(update=update))

    def _measured(self, measurement: Measurement) -> None:
        if measurement.stamp <= self.shell.last_stamp:
            self.ignored += 1
            return
        self.shell.publish_all(self.role.answer(measurement))


def main() -> int:
    """Run this node alone in a process."""
    from train_ato.nodes.process import run_role
    from train_ato.topics import Role

    return run_role(Role.OBSERVER)


if __name__ == "__main__":
    sys.exit(main())
