"""Services of ``simulation_interfaces`` at the node ``plant``: features, state, steps and entities.

The entities are the vehicles, front first, with the truth at the present tick in the frame ``map``. Not offered are the
reset of a run, because every node would have to begin again, and what makes or moves entities. The package is not among
the wheels: without it a line on ``/rosout`` says so.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from rcl_interfaces.msg import Log as LogMessage

from plant_sim.alignment import Alignment
from train_ato.messages.cdr import SECOND
from train_ato.messages.topic import Owner
from train_ato.messages.topics import EPOCH_NS
from train_ato.ros.nodes.endpoints import NodeEndpoints

PACKAGE = "simulation_interfaces"
ABSENT = f"{PACKAGE} is not installed: its services are absent; ~/pause, ~/start, ~/step, ~/stop, ~/reset are offered"
FEATURES = (
    "SIMULATION_STATE_GETTING", "SIMULATION_STATE_SETTING", "SIMULATION_STATE_PAUSE", "STEP_SIMULATION_SINGLE",
    "STEP_SIMULATION_MULTIPLE", "ENTITY_STATE_GETTING",
)  # fmt: skip
RESETS = ("SIMULATION_RESET", "SIMULATION_RESET_TIME", "SIMULATION_RESET_STATE", "SIMULATION_RESET_SPAWNED")
"""Features of a run that its runner begins again: a new run resets all of them."""
NO_STATE = "a run begins when all nodes are ready; QUITTING ends it, ResetSimulation begins it again"


def serve_simulation(
    plant: Any, endpoints: NodeEndpoints, pause: Callable[[bool], str], reset: Callable[[], str]
) -> None:
    """Offer the services, or say in one line that the package is absent."""
    try:
        messages, services = (importlib.import_module(f"{PACKAGE}.{kind}") for kind in ("msg", "srv"))
    except ImportError:
        endpoints.log(ABSENT, LogMessage.INFO)
        return
    SimulationServices(plant, endpoints, pause, reset, messages=messages, services=services)


class SimulationServices:
    """Answers of the services.

    Parameters
    ----------
    plant, endpoints
        Node of the train.
    pause
        Pauses (True) or resumes the run.
    reset
        Ends the run for its runner, which begins it again; refused with a ``ValueError``.
    messages, services
        Modules of the package.
    """

    def __init__(
        self, plant: Any, endpoints: NodeEndpoints, pause: Callable[[bool], str], reset: Callable[[], str],
        *, messages: Any, services: Any,
    ) -> None:  # fmt: skip
        self._plant, self._pause, self._reset, self._msg, self._srv = plant, pause, reset, messages, services
        self._alignment = Alignment(plant.stage.setup.line)
        self._names = plant.stage.setup.layout.names(Owner.VEHICLE)
        self._goal: int | None = None
        self._stepping: Any = None
        self._reply: Callable[[], None] | None = None
        answers = {
            "GetSimulatorFeatures": self._features, "GetSimulationState": self._get_state,
            "SetSimulationState": self._set_state, "GetEntities": self._entities,
            "GetEntityState": self._entity_state, "GetEntitiesStates": self._entities_states,
            "ResetSimulation": self._reset_all,
        }  # fmt: skip
        for name, answer in answers.items():
            endpoints.serve(getattr(services, name), _path(name), answer)
        step = endpoints.serve(services.StepSimulation, _path("StepSimulation"), self._step)
        self._send = step.send_response
        step.send_response = self._send_step  # the executor calls it: the answer to a step comes after its last tick
        plant.on_stepped = self._stepped

    def _result(self, text: str = "", code: int | None = None) -> Any:
        """Return a result: done without a text, else failed with the reason."""
        kind = self._msg.Result
        failed = kind.RESULT_OPERATION_FAILED if text else kind.RESULT_OK
        return kind(result=failed if code is None else code, error_message=text)

    def _features(self, _: Any, response: Any) -> Any:
        kind = self._msg.SimulatorFeatures
        response.features.features = [
            getattr(kind, name) for name in (*FEATURES, *(RESETS if self._plant.resets else ()))
        ]
        response.features.custom_info = "train_ato: one run; entities are the vehicles, front first, in the frame map"
        return response

    def _state(self) -> int:
        kind = self._msg.SimulationState
        if self._plant.finished:
            return int(kind.STATE_QUITTING)
        if self._plant.paused:
            return int(kind.STATE_PAUSED)
        return int(kind.STATE_STOPPED if self._plant.sent_stamp < 0 else kind.STATE_PLAYING)

    def _get_state(self, _: Any, response: Any) -> Any:
        response.state.state, response.result = self._state(), self._result()
        return response

    def _set_state(self, request: Any, response: Any) -> Any:
        kind, due, now = self._msg.SimulationState, request.state.state, self._state()
        code = None
        if due == now:
            text, code = "the run is in this state", response.ALREADY_IN_TARGET_STATE
        elif now == kind.STATE_QUITTING:
            text, code = "the run is over", response.INCORRECT_TRANSITION
        elif due == kind.STATE_PAUSED or (due == kind.STATE_PLAYING and now == kind.STATE_PAUSED):
            text = ""
            self._pause(due == kind.STATE_PAUSED)
        elif due == kind.STATE_QUITTING:
            text = ""
            self._plant.request_stop()
        elif due in (kind.STATE_STOPPED, kind.STATE_PLAYING):
            text, code = NO_STATE, response.STATE_TRANSITION_ERROR
        else:
            text, code = f"no state {due}", self._msg.Result.RESULT_FEATURE_UNSUPPORTED
        response.result = self._result(text, code)
        return response

    def _reset_all(self, _: Any, response: Any) -> Any:
        """Reset the run; every scope is a whole new run, which has the state and the entities of the start."""
        try:
            self._reset()
            response.result = self._result()
        except ValueError as error:
            response.result = self._result(str(error))
        return response

    def _step(self, request: Any, response: Any) -> Any:
        if not self._plant.paused or self._plant.finished:
            response.result = self._result("the run is not paused; set the state PAUSED first")
        elif self._goal is not None:
            response.result = self._result("the steps of another request are running; wait for their answer")
        else:
            self._stepping, self._reply = response, None
            response.result = self._result()
            self._goal = self._plant.run_steps(request.steps)
            self._stepped()
        return response

    def _stepped(self) -> None:
        """Answer the request for steps if the last one is complete, or does not come any more."""
        plant, goal = self._plant, self._goal
        if goal is None or (plant.stage.tick < goal and plant.paused and not plant.finished):
            return
        if plant.stage.tick < goal:
            self._stepping.result = self._result(
                f"{goal - plant.stage.tick} steps were left when the run went on or ended"
            )
        self._goal = None
        if self._reply is not None:
            self._reply()

    def _send_step(self, response: Any, header: Any) -> None:
        """Send the answer to a step, or keep it until the last tick is complete."""
        if response is self._stepping and self._goal is not None:
            self._reply = lambda: self._send(response, header)
        else:
            self._send(response, header)

    def _matching(self, filters: Any) -> tuple[list[str], Any]:
        """Return the names of the vehicles that a filter leaves, and the result."""
        if filters.categories or filters.tags.tags or filters.bounds.points:
            text = "categories, tags and bounds are no features; filter by the name"
            return [], self._result(text, self._msg.Result.RESULT_FEATURE_UNSUPPORTED)
        try:
            return [name for name in self._names if re.search(filters.filter, name)], self._result()
        except re.error as error:
            return [], self._result(f"filter {filters.filter!r}: {error}")

    def _entities(self, request: Any, response: Any) -> Any:
        response.entities, response.result = self._matching(request.filters)
        return response

    def _entity_state(self, request: Any, response: Any) -> Any:
        if request.entity not in self._names:
            text = f"no entity {request.entity!r}; {self._names[0]} to {self._names[-1]} are known"
            response.result = self._result(text, self._msg.Result.RESULT_NOT_FOUND)
        else:
            response.result, (response.state,) = self._result(), self._states([request.entity])
        return response

    def _entities_states(self, request: Any, response: Any) -> Any:
        response.entities, response.result = self._matching(request.filters)
        response.states = self._states(response.entities)
        return response

    def _states(self, names: list[str]) -> list[Any]:
        """Return pose and speed of vehicles; turn and acceleration are not known: NaN."""
        stage, found = self._plant.stage, []
        rows = [self._names.index(name) for name in names]
        pose = self._alignment.at(stage.train.position[rows])
        turned, forward, speeds = pose.quaternion, pose.forward, stage.train.velocity[rows]
        for number in range(len(rows)):
            state = self._msg.EntityState()
            state.header.frame_id = "map"
            state.header.stamp.sec, state.header.stamp.nanosec = divmod(EPOCH_NS + stage.stamp, SECOND)
            for axis, place, part in zip("xyz", (pose.x, pose.y, pose.z), forward, strict=True):
                setattr(state.pose.position, axis, float(place[number]))
                setattr(state.twist.linear, axis, float(speeds[number] * part[number]))
                for unknown in (state.twist.angular, state.acceleration.linear, state.acceleration.angular):
                    setattr(unknown, axis, np.nan)
            for axis, column in zip("xyzw", turned, strict=True):
                setattr(state.pose.orientation, axis, float(column[number]))
            found.append(state)
        return found


def _path(kind: str) -> str:
    """Return the name of a service by its type: ``~/get_entities``."""
    return "~/" + re.sub(r"(?<!^)([A-Z])", r"_\1", kind).lower()
