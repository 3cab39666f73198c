"""Parameters and services of the node ``plant`` during a run.

Parameters ``rate`` and ``paused`` control the progress of the run. Services ``~/gust``, ``~/delay_jump``,
``~/emergency_brake`` and the services of faults (``~/message_loss`` ...) act at the next tick and later.
``/diagnostics`` reports them. Their strengths are parameters (``gust.acceleration`` ...), because the services of
``std_srvs`` have no fields for numbers.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple, Protocol, get_args

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import SetBool, Trigger

from train_ato.control.contract import Parameter
from train_ato.judge.run_end import RESET
from train_ato.loop.plant import PlantStage
from train_ato.messages.delay_lines import MAX_DELAY
from train_ato.messages.faults import MAX_FAULT_TIME
from train_ato.ros.graph.graph_result import GraphOptions
from train_ato.ros.nodes.endpoints import NodeEndpoints
from train_ato.ros.nodes.parameters import OF_NODES, Declared, declare
from train_ato.ros.nodes.simulation_services import serve_simulation
from train_ato.scenario.interventions import (
    MAX_GUST,
    MAX_GUST_DURATION,
    DelayJumpNow,
    EmergencyBrakeNow,
    GustNow,
    Intervention,
    MessageFreezeNow,
    MessageLossNow,
    PlantTopic,
    TrainJumpNow,
    make_intervention,
)


class TrainJumpService(NamedTuple):
    """Service that multiplies a part of the train: its name, the part, its factor by default and its meaning."""

    service: str
    what: Literal["gain", "brake", "adhesion"]
    default: float
    meaning: str


TRAIN_JUMPS = (
    TrainJumpService("drive_gain", "gain", 0.0, "the force of all drives; 0 cuts them out"),
    TrainJumpService("brake_fade", "brake", 0.5, "the force of shoes and friction brakes"),
    TrainJumpService("adhesion", "adhesion", 0.3, "the adhesion"),
)
PLANT_TOPICS: tuple[str, ...] = get_args(PlantTopic)
FROZEN_TOPICS = (*PLANT_TOPICS, "train/measurement")
MAX_RATE = 1e6
TIMEOUT = Parameter("timeout", 10.0, "s", 0.001, 86_400.0, "wall time after which a missing answer ends the run")
LOCKSTEP = Parameter("lockstep", True, "", 0.0, 1.0, "true: every tick waits for its command")
RATE = Parameter(
    "rate", 0.0, "", 0.0, MAX_RATE, "maximum simulated seconds per wall second; 0: no limit, or 1 without lockstep"
)
NO_RATE = "rate 0: a run without lockstep needs a rate; give a number above 0"
NO_RESET = (
    "only `train-ato run` begins a run again, without --external and --namespace; end this one with ~/stop and start "
    "its nodes again"
)
PAUSED = Parameter("paused", False, "", 0.0, 1.0, "paused: only single steps")
SCENARIO = Parameter("scenario", "", "", 0.0, 0.0, "file of the resolved scenario of this run")
STRENGTHS: tuple[Parameter, ...] = (
    Parameter("gust.acceleration", -0.02, "m/s²", -MAX_GUST, MAX_GUST, "acceleration of the gust, on every vehicle"),
    Parameter("gust.duration", 20.0, "s", 0.001, MAX_GUST_DURATION, "duration of the gust, ramps included"),
    Parameter("gust.ramp", 2.0, "s", 0.0, MAX_GUST_DURATION, "rise and fall time, at most half of the duration"),
    Parameter("delay_jump.factor", 1.0, "", 0.0, 1000.0, "factor on the command delays"),
    Parameter("delay_jump.add", 0.5, "s", -MAX_DELAY, MAX_DELAY, "addition to the command delays"),
    Parameter("message_loss.topic", "ato/command", "", 0.0, 0.0, "topic without messages at the plant", PLANT_TOPICS),
    Parameter("message_loss.duration", 5.0, "s", 0.001, MAX_FAULT_TIME, "duration of the loss"),
    Parameter("message_freeze.topic", "train/measurement", "", 0.0, 0.0, "topic with constant content", FROZEN_TOPICS),
    Parameter("message_freeze.duration", 5.0, "s", 0.001, MAX_FAULT_TIME, "duration of the constant content"),
    *(
        Parameter(f"{jump.service}.factor", jump.default, "", 0.0, 10.0, f"factor on {jump.meaning}")
        for jump in TRAIN_JUMPS
    ),
)
"""Strengths of the services."""
OF_NODES.update(("timeout", "lockstep", "rate", "pace", "realtime", "paused", "scenario"))
OF_NODES.update(entry.name for entry in STRENGTHS)
CHOICES = {entry.name: entry.choices for entry in STRENGTHS if entry.choices}
"""Permitted values of the strengths that are texts."""


class Plant(Protocol):
    """Interface of the plant node for requests."""

    stage: PlantStage
    sent_stamp: int
    finished: bool

    @property
    def stamp(self) -> int:
        """Simulation time of the current tick [ns]."""

    def set_rate(self, rate: float) -> None:
        """Set the rate [simulated s per s]; 0 is unlimited."""

    def set_paused(self, paused: bool) -> None:
        """Pause or resume."""

    resets: bool

    def request_stop(self, reason: str = ...) -> None:
        """End the run after the current tick; the end notice has the reason."""

    def single_step(self) -> None:
        """Run one tick of a paused run."""


class PlantRequests:
    """Parameters and services of the plant's node.

    Attributes
    ----------
    given : dict
        Values of the parameters at the start.
    """

    def __init__(self, plant: Plant, endpoints: NodeEndpoints, options: GraphOptions, scenario: str) -> None:
        self._plant = plant
        self._endpoints = endpoints
        self._node = endpoints.node
        self._following = False
        self.given = declare(
            self._node,
            [
                Declared("timeout", options.patience, TIMEOUT),
                Declared("lockstep", options.lockstep, LOCKSTEP, read_only=True),
                Declared("rate", options.rate, RATE),
                Declared("paused", False, PAUSED),
                Declared("scenario", scenario, SCENARIO, read_only=True),
                *(Declared(entry.name, entry.default, entry) for entry in STRENGTHS),
            ],
        )
        if not self.given["lockstep"] and not self.given["rate"]:
            self.given["rate"] = 1.0
            self._node.set_parameters([RosParameter("rate", value=1.0)])
        self._node.add_on_set_parameters_callback(self._check)
        self._node.add_post_set_parameters_callback(self._apply)
        self._services()

    def _services(self) -> None:
        services: tuple[tuple[str, Any, Callable[[Any], str]], ...] = (
            ("start", Trigger, lambda _: self._pause(False)),
            ("stop", Trigger, lambda _: self._stop()),
            ("reset", Trigger, lambda _: request_reset(self._plant)),
            ("step", Trigger, lambda _: self._step()),
            ("gust", Trigger, lambda _: self._intervene(self._made(GustNow, "gust"))),
            ("delay_jump", Trigger, lambda _: self._intervene(self._made(DelayJumpNow, "delay_jump"))),
            ("message_loss", Trigger, lambda _: self._intervene(self._made(MessageLossNow, "message_loss"))),
            ("message_freeze", Trigger, lambda _: self._intervene(self._made(MessageFreezeNow, "message_freeze"))),
            *((jump.service, Trigger, self._train_jump(jump)) for jump in TRAIN_JUMPS),
            ("pause", SetBool, lambda request: self._pause(bool(request.data))),
            (
                "emergency_brake",
                SetBool,
                lambda request: self._intervene(EmergencyBrakeNow(applied=bool(request.data))),
            ),
        )
        for name, kind, action in services:
            self._endpoints.serve(kind, f"~/{name}", _answering(action))
        serve_simulation(self._plant, self._endpoints, self._pause, lambda: request_reset(self._plant))

    def _check(self, parameters: list[Any]) -> Any:
        """Return acceptance of a change, or refusal with the reason; no side effects."""
        for parameter in parameters:
            if parameter.name == "rate" and parameter.value <= 0 and not self.given["lockstep"]:
                return SetParametersResult(successful=False, reason=NO_RATE)
            choices = CHOICES.get(parameter.name)
            if choices is not None and parameter.value not in choices:
                reason = f"{parameter.value!r} is none of {', '.join(choices)}"
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Any]) -> None:
        if self._following:
            return
        for parameter in parameters:
            if parameter.name == "rate":
                self._plant.set_rate(parameter.value)
            elif parameter.name == "paused":
                self._plant.set_paused(parameter.value)

    def _pause(self, paused: bool) -> str:
        """Pause or resume, and set the parameter ``paused``."""
        if self._node.get_parameter("paused").value != paused:
            self._following = True
            try:
                self._node.set_parameters([RosParameter("paused", value=paused)])
            finally:
                self._following = False
        self._plant.set_paused(paused)
        return f"pauses at {self._plant.stamp * 1e-9:.3f} s" if paused else "runs"

    def _stop(self) -> str:
        """End the run after the current tick."""
        self._plant.request_stop()
        return f"stops at {self._plant.stamp * 1e-9:.3f} s"

    def _step(self) -> str:
        self._plant.single_step()
        return f"takes the tick at {self._plant.sent_stamp * 1e-9:.3f} s"

    def _train_jump(self, jump: TrainJumpService) -> Callable[[Any], str]:
        """Return the action of a service that changes a part of the train."""
        return lambda _: self._intervene(self._made(TrainJumpNow, jump.service, what=jump.what))

    def _made(self, kind: type[Any], service: str, **values: Any) -> Intervention:
        """Return an intervention of a kind with the strengths of its service."""
        names = [entry.name for entry in STRENGTHS if entry.name.startswith(f"{service}.")]
        values |= {name.partition(".")[2]: self._node.get_parameter(name).value for name in names}
        intervention: Intervention = make_intervention(kind, **values)
        return intervention

    def _intervene(self, intervention: Intervention) -> str:
        if self._plant.finished:
            raise ValueError("the run is over")
        self._plant.stage.request(intervention)
        return f"{intervention.described()}; from the tick after {self._plant.stamp * 1e-9:.3f} s"


def request_reset(plant: Plant) -> str:
    """End the run after the current tick; its runner begins it again.

    Raises
    ------
    ValueError
        For a run without a runner that begins it again, before its begin and after its end.
    """
    if not plant.resets:
        raise ValueError(NO_RESET)
    if plant.finished or plant.sent_stamp < 0:
        raise ValueError(f"the run {'is over' if plant.finished else 'has not begun'}; there is nothing to reset")
    plant.request_stop(RESET)
    return f"stops at {plant.stamp * 1e-9:.3f} s and begins again in the next run folder"


def _answering(action: Callable[[Any], str]) -> Callable[[Any, Any], Any]:
    """Return a service callback that answers with the text of the action, or with the reason of its refusal."""

    def answer(request: Any, response: Any) -> Any:
        try:
            response.success, response.message = True, action(request)
        except ValueError as error:
            response.success, response.message = False, str(error)
        return response

    return answer
