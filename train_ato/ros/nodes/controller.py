"""Node ``controller``: waits for measurement, reference and estimate of one stamp and answers with the command.

The law is the ROS parameter ``controller``; the parameters of every law stand under its name (``smc.k``).  A change
is checked completely before anything is touched and takes effect at the next step, without a jump in force.
"""

from __future__ import annotations

import sys
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter as RosParameter

from train_ato.changes import Changes
from train_ato.control.contract import Parameter
from train_ato.control.registry import LAWS
from train_ato.nodes.inputs import StepInputs
from train_ato.nodes.parameters import Declared, block_parameters, declare
from train_ato.nodes.shell import Shell
from train_ato.roles.controller import ControllerRole
from train_ato.roles.trajectories import profile_of
from train_ato.types import DisturbanceEstimate, Measurement, Reference, Trajectory


class ControllerNode:
    """Wraps the control stack; every stamp is answered exactly once.

    Raises
    ------
    ValueError
        If a parameter given at the start is unknown, out of range or refused by the law.
    """

    def __init__(self, role: ControllerRole, shell: Shell) -> None:
        self.role = role
        self.shell = shell
        self._inputs = StepInputs()
        self._following = False
        self._declare()
        shell.subscribe(
            {
                "ato/profile": self._profiled,
                "train/measurement": self._measured,
                "ato/reference": self._referred,
                "ato/estimate": self._estimated,
            }
        )

    @property
    def ignored(self) -> int:
        """Messages that came twice or too late."""
        return self._inputs.ignored

    def _declare(self) -> None:
        """Declare ``controller`` and the parameters of every law, and take over what was given at the start."""
        role, node = self.role, self.shell.node
        given = role.setup.controller_parameters
        chosen = Parameter("controller", role.controller, "", 0.0, 0.0, "control law in charge", LAWS.loadable())
        parameters = [Declared("controller", role.controller, chosen)]
        for law in LAWS.loadable():
            parameters += block_parameters(law, LAWS.parameters(law), given.get(law, {}))
        before = {parameter.name: parameter.value for parameter in parameters}
        values = declare(node, parameters)
        changed = {name: value for name, value in values.items() if value != before[name]}
        for name in sorted(changed, key=lambda name: name == "controller"):
            role.validate(name, changed[name])
            role.begin_with(name, changed[name])
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _check(self, parameters: list[Any]) -> Any:
        """Refuse a change with its reason; touches nothing."""
        for parameter in parameters:
            if self._ours(parameter.name):
                try:
                    self.role.validate(parameter.name, parameter.value)
                except ValueError as error:
                    return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Any]) -> None:
        if self._following:
            return
        for parameter in sorted(parameters, key=lambda parameter: parameter.name == "controller"):
            if self._ours(parameter.name):
                self.role.apply(parameter.name, parameter.value)

    def _ours(self, name: str) -> bool:
        return name == "controller" or name.partition(".")[0] in LAWS.loadable()

    def _profiled(self, trajectory: Trajectory) -> None:
        self._step("profile", trajectory)

    def _measured(self, message: Measurement) -> None:
        self._step("measurement", message)

    def _referred(self, message: Reference) -> None:
        self._step("reference", message)

    def _estimated(self, message: DisturbanceEstimate) -> None:
        self._step("estimate", message)

    def _step(self, kind: str, message: Any) -> None:
        for profile, complete in self._inputs.put(kind, message):
            if profile is not None:
                self.role.set_profile(profile_of(profile))
            _, _, messages = self.role.step(*complete)
            if self.role.changed:
                self._show(self.role.changed)
            self.shell.publish_all(messages)

    def _show(self, changed: Changes) -> None:
        """Let the parameters follow what the scenario had planned."""
        node = self.shell.node
        behind = []
        for name, value in changed.items():
            shown = node.get_parameter(name).value
            if shown != value:
                behind.append(RosParameter(name, value=float(value) if isinstance(shown, float) else value))
        self._following = True
        try:
            node.set_parameters(behind)
        finally:
            self._following = False


def main() -> int:
    """Run this node alone in a process."""
    from train_ato.nodes.process import run_role
    from train_ato.topics import Role

    return run_role(Role.CONTROLLER)


if __name__ == "__main__":
    sys.exit(main())
