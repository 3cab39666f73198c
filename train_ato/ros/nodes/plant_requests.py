"""What may be asked of the node ``plant`` while it runs: its parameters and services.

Parameters ``pace`` and ``paused`` hold it back or let it go; services ``~/gust``, ``~/delay_jump`` and
``~/emergency_brake`` act from the next tick on and are reported in ``/diagnostics``.  How strong a gust or a jump is
stands in parameters beside it (``gust.acceleration`` ...), because the services of ``std_srvs`` carry no numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import SetBool, Trigger

from train_ato.control.contract import Parameter
from train_ato.interventions import (
    LONGEST_GUST,
    STRONGEST_GUST,
    DelayJumpNow,
    EmergencyBrakeNow,
    GustNow,
    Intervention,
    made,
)
from train_ato.links import LONGEST_DELAY
from train_ato.nodes.parameters import Declared, declare
from train_ato.nodes.shell import Shell

if TYPE_CHECKING:
    from plant_sim.node import PlantNode

FASTEST = 1e6
TIMEOUT = Parameter("timeout", 10.0, "s", 0.001, 86_400.0, "wall time after which a missing answer ends the run")
REALTIME = Parameter("realtime", 0.0, "", 0.0, FASTEST, "simulated seconds per wall second; 0 is lockstep")
PACE = Parameter("pace", 0.0, "", 0.0, FASTEST, "simulated seconds per wall second at most; 0: as fast as it goes")
PAUSED = Parameter("paused", False, "", 0.0, 1.0, "begin no further tick but single steps")
SCENARIO = Parameter("scenario", "", "", 0.0, 0.0, "file of the resolved scenario of this run")
STRENGTHS: tuple[Parameter, ...] = (
    Parameter("gust.acceleration", -0.02, "m/s²", -STRONGEST_GUST, STRONGEST_GUST, "of every vehicle by a gust"),
    Parameter("gust.duration", 20.0, "s", 0.001, LONGEST_GUST, "of a gust, ramps included"),
    Parameter("gust.ramp", 2.0, "s", 0.0, LONGEST_GUST, "rise and fall of a gust"),
    Parameter("delay_jump.factor", 1.0, "", 0.0, 1000.0, "on the delays of commands, by a jump"),
    Parameter("delay_jump.add", 0.5, "s", -LONGEST_DELAY, LONGEST_DELAY, "added to the delays of commands, by a jump"),
)


class PlantRequests:
    """Parameters and services of the plant's node.

    Attributes
    ----------
    given : dict
        Values of the parameters at the start.

    Raises
    ------
    ValueError
        If a parameter given at the start is unknown or out of range.
    """

    def __init__(
        self, plant: PlantNode, shell: Shell, realtime: float, timeout: float, pace: float, scenario: str
    ) -> None:
        self._plant = plant
        self._shell = shell
        self._node = shell.node
        self._following = False
        self.given = declare(
            self._node,
            [
                Declared("timeout", timeout, TIMEOUT),
                Declared("realtime", realtime, REALTIME, read_only=True),
                Declared("pace", realtime or pace, PACE),
                Declared("paused", False, PAUSED),
                Declared("scenario", scenario, SCENARIO, read_only=True),
                *(Declared(entry.name, entry.default, entry) for entry in STRENGTHS),
            ],
        )
        self._node.add_on_set_parameters_callback(self._check)
        self._node.add_post_set_parameters_callback(self._apply)
        self._services()

    def _services(self) -> None:
        triggers: tuple[tuple[str, Callable[[], str]], ...] = (
            ("start", lambda: self._pause(False)),
            ("stop", self._stop),
            ("step", self._step),
            ("gust", lambda: self._ask(made(GustNow, **self._strengths("gust")))),
            ("delay_jump", lambda: self._ask(made(DelayJumpNow, **self._strengths("delay_jump")))),
        )
        switches: tuple[tuple[str, Callable[[bool], str]], ...] = (
            ("pause", self._pause),
            ("emergency_brake", lambda on: self._ask(EmergencyBrakeNow(applied=on))),
        )
        for name, action in triggers:
            self._node.create_service(Trigger, f"~/{name}", _answering(_of_nothing(action)))
        for name, switch in switches:
            self._node.create_service(SetBool, f"~/{name}", _answering(_of_data(switch)))

    def _check(self, parameters: list[Any]) -> Any:
        """Refuse what the plant cannot do; touches nothing."""
        for parameter in parameters:
            if parameter.name == "pace" and parameter.value <= 0 and self.given["realtime"] > 0:
                reason = "pace 0: a run in realtime has a pace; give a number above 0"
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Any]) -> None:
        if self._following:
            return
        for parameter in parameters:
            if parameter.name == "pace":
                self._plant.set_pace(parameter.value)
            elif parameter.name == "paused":
                self._plant.set_paused(parameter.value)

    def _pause(self, paused: bool) -> str:
        """Pause or go on, and let the parameter say so."""
        if self._node.get_parameter("paused").value != paused:
            self._following = True
            try:
                self._node.set_parameters([RosParameter("paused", value=paused)])
            finally:
                self._following = False
        self._plant.set_paused(paused)
        return f"pauses at {self._plant.stamp * 1e-9:.3f} s" if paused else "runs"

    def _stop(self) -> str:
        """End the run after the tick under way."""
        self._plant.request_stop()
        return f"stops at {self._plant.stamp * 1e-9:.3f} s"

    def _step(self) -> str:
        self._plant.single_step()
        return f"takes the tick at {self._plant.asked * 1e-9:.3f} s"

    def _strengths(self, prefix: str) -> dict[str, float]:
        names = [entry.name for entry in STRENGTHS if entry.name.startswith(f"{prefix}.")]
        return {name.partition(".")[2]: self._node.get_parameter(name).value for name in names}

    def _ask(self, intervention: Intervention) -> str:
        if self._plant.finished:
            raise ValueError("the run is over")
        self._plant.role.request(intervention)
        return f"{intervention.described()}; from the tick after {self._plant.stamp * 1e-9:.3f} s"


def _of_nothing(action: Callable[[], str]) -> Callable[[Any], str]:
    return lambda request: action()


def _of_data(action: Callable[[bool], str]) -> Callable[[Any], str]:
    return lambda request: action(bool(request.data))


def _answering(action: Callable[[Any], str]) -> Callable[[Any, Any], Any]:
    """Return a service callback: what the action says, or the reason why it was refused."""

    def answer(request: Any, response: Any) -> Any:
        try:
            response.success, response.message = True, action(request)
        except ValueError as error:
            response.success, response.message = False, str(error)
        return response

    return answer
