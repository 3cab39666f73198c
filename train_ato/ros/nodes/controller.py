"""Node ``controller``: sends the command for measurement, reference and estimate of one stamp.

The law is the ROS parameter ``controller``; parameters of laws have the name of the law as prefix (``smc.k``).  A
change is validated before it is applied and takes effect at the next step, without a jump in force.
"""

from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import Trigger

from train_ato.control.contract import Parameter
from train_ato.control.registry import LAWS
from train_ato.loop.controller import ControllerStage
from train_ato.loop.stamp_synchronizer import StampSynchronizer
from train_ato.messages.topics import AHEAD, FORCE_PARTS, Role
from train_ato.profile.profile import profile_of
from train_ato.ros.nodes.endpoints import NodeEndpoints
from train_ato.ros.nodes.parameters import Declared, block_parameters, declare
from train_ato.scenario.changes import LAW, Changes
from train_ato.scenario.interventions import REQUESTS, Request

KINDS = {
    "profile": "ato/profile", "measurement": "train/measurement", "reference": "ato/reference",
    "estimate": "ato/estimate", "protection": "train/protection", "speeds": "atp/speeds", "ahead": AHEAD,
}  # fmt: skip
"""Topics of the inputs of a step."""
PARAMETER = "law"
"""ROS parameter that selects the law."""


class ControllerNode:
    """ROS node of the control stack; sends one answer per stamp."""

    def __init__(self, stage: ControllerStage, endpoints: NodeEndpoints) -> None:
        self.stage = stage
        self.endpoints = endpoints
        setup = stage.setup
        stage.foreign_profile = endpoints.external is Role.PROFILE
        self._inputs = StampSynchronizer(setup.tick_ns, setup.supervised_at, behind=setup.layout.behind)
        self._following = self._heard = False
        self._laws = stage.setup.laws
        self._advice = ""
        self._declare()
        endpoints.parameter_services.on_accepted = lambda: self._advice
        endpoints.ignored = lambda: self.ignored
        endpoints.awaited = lambda: KINDS.get(self._inputs.awaited, "")
        endpoints.subscribe({topic: partial(self._step, kind) for kind, topic in KINDS.items()}, stage.setup.tick_ns)
        for request in REQUESTS:
            endpoints.serve(Trigger, f"~/{request}", partial(self._request, request))

    @property
    def ignored(self) -> int:
        """Number of duplicate and late messages."""
        return self._inputs.ignored

    def join(self, stamp: int) -> None:
        """Join a run that has reached a stamp [ns]."""
        self._inputs.join()
        self.stage.join(stamp)
        self._sync_parameters(self.stage.asked)

    def await_return(self, role: Role, reason: str) -> None:
        """Follow the outage of another node of the loop, whose process is started again."""
        self.stage.follow_outage(f"node {role.value} restarted: {reason}")

    def _declare(self) -> None:
        """Declare ``law`` and the parameters of every law, and apply the start parameters."""
        stage, node = self.stage, self.endpoints.node
        chosen = Parameter(PARAMETER, stage.controller, "", 0.0, 0.0, "law in charge", self._laws)
        parameters = [Declared(PARAMETER, stage.controller, chosen)]
        for law in self._laws:
            parameters += block_parameters(law, LAWS.parameters(law), stage.gains(law).values)
        before = {parameter.name: parameter.value for parameter in parameters}
        values = declare(node, parameters)
        changed = {name: value for name, value in values.items() if value != before[name]}
        stage.validate(_stage_names(changed))
        for name, value in _stage_names(changed).items():
            stage.begin_with(name, value)
        self._sync_parameters(changed)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _check(self, parameters: list[Any]) -> Any:
        """Return acceptance of a change, or refusal with the reason; keep the advice for the answer."""
        try:
            self._advice = self.stage.validate(self._changes(parameters))
        except ValueError as error:
            self._advice = ""
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Any]) -> None:
        if self._following:
            return
        for name, value in self._changes(parameters).items():
            self.stage.apply(name, value)

    def _changes(self, parameters: list[Any]) -> Changes:
        """Return the parameters of laws among those set together."""
        ours = [entry for entry in parameters if entry.name == PARAMETER or entry.name.rpartition(".")[0] in self._laws]
        return _stage_names({entry.name: entry.value for entry in ours})

    def _step(self, kind: str, message: Any) -> None:
        for inputs in self._inputs.put(kind, message):
            if inputs.profile is not None:
                self.stage.set_profile(profile_of(inputs.profile))
            self.stage.receive(
                inputs.measurement,
                inputs.reference,
                inputs.estimate,
                inputs.protection,
                inputs.speeds,
                ahead=inputs.ahead,
            )
            messages = self.stage.command()
            if self.stage.changed:
                self._sync_parameters(self.stage.changed)
            self.endpoints.publish(*messages.published())
            if messages.diagnostics is not None:  # a look for a reader at least once a second
                self._heard = self.endpoints.readers(FORCE_PARTS) > 0
            if self._heard and (parts := self.stage.force_parts(messages.command)) is not None:
                self.endpoints.publish((FORCE_PARTS, parts))

    def _request(self, request: Request, _: Any, response: Any) -> Any:
        """Answer a service request to the ATO; a refusal has its reason."""
        try:
            if not self.stage.setup.layout.supervised:
                raise ValueError(f"{request}: the run has no supervision; set supervision.enabled: true")
            self.stage.ato.request(request)
            response.success, response.message = True, f"{request}: from the next step of the supervisor on"
        except ValueError as error:
            response.success, response.message = False, str(error)
        return response

    def _sync_parameters(self, changed: Changes) -> None:
        """Set the ROS parameters to the values of planned changes, and to the gains of a changed choice."""
        node = self.endpoints.node
        behind = []
        chosen = [name.rpartition(".")[0] for name in changed if name.endswith(".gains")]
        gains = {
            f"{law}.{entry.name}": self.stage.gains(law).values.get(entry.name, entry.default)
            for law in chosen
            for entry in LAWS.parameters(law)
        }
        for changed_name, value in {**gains, **changed}.items():
            name = PARAMETER if changed_name == LAW else changed_name
            shown = node.get_parameter(name).value
            if shown != value:
                behind.append(RosParameter(name, value=float(value) if isinstance(shown, float) else value))
        self._following = True
        try:
            node.set_parameters(behind)
        finally:
            self._following = False


def _stage_names(parameters: Changes) -> Changes:
    """Return ROS parameters under their names in the stage and its diagnostics, the law last."""
    ordered = sorted(parameters, key=lambda name: name == PARAMETER)
    return {LAW if name == PARAMETER else name: parameters[name] for name in ordered}
