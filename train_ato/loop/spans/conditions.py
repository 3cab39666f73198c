"""Conditions for compiled ticks: kinds of runs, states of train and control stack, and the next event."""

from __future__ import annotations

from typing import Any

from plant_sim.brake_events import PipeEvents
from train_ato.control.air_brake.predictive_policy import PredictiveBrake
from train_ato.control.compensation.none import NoCompensation
from train_ato.control.compensation.pade import Pade
from train_ato.control.compensation.predictor import Predictor
from train_ato.control.compensation.preview import PreviewFeedforward
from train_ato.control.compensation.twin import Twin
from train_ato.control.compiled.law_call import RecordStep
from train_ato.control.observers.none import NoObserver
from train_ato.control.observers.record_observer import RecordObserver
from train_ato.control.registry import OBSERVERS
from train_ato.control.stack import ControlStack
from train_ato.loop.inputs import StageInputs
from train_ato.loop.setup import RunSetup
from train_ato.loop.spans.python_law import PythonLaw
from train_ato.loop.spans.stages import Stages
from train_ato.loop.spans.supervised import SupervisedTicks
from train_ato.messages.links import LinkSpec
from train_ato.scenario.changes import requested_stamp

LONGEST, BRAKED = 256, 128
"""Longest span, and longest one with forecasts of shoe forces, which cost more [ticks]."""
_OBSERVER_STEP = RecordObserver.step
_COMPENSATION_STEPS: dict[type, Any] = {
    kind: kind.step for kind in (NoCompensation, Pade, PreviewFeedforward, Predictor, Twin)
}
"""Steps with a compiled form: one that a program replaces has none."""
UNRECORDED, BRIEF = 4, 16
"""Factor of both without a log and without disturbances, whose arrays are large, and with the series of the summary."""


def spans_possible(setup: RunSetup) -> bool:
    """Return True for a run whose ticks can be compiled.

    It has an observer over records or `none`, the compensation `none`, `pade`, `preview`, `predictor` or `twin`, no
    re-planning, no shares or displacements of the power units by place, and delays on the command only.
    """
    scenario, links = setup.scenario, setup.links
    if scenario.replan or scenario.force_shares or scenario.unit_displacements:
        return False
    others = (links.measurement, links.reference, links.estimate, links.brake_pipe, links.brake_release)
    if any(link != LinkSpec() for link in others):
        return False
    observer = OBSERVERS.get(setup.observer)
    return (observer is NoObserver or issubclass(observer, RecordObserver)) and setup.model.n_units > 0


def has_compiled_form(compensation: Any, law: Any, setup: RunSetup) -> bool:
    """Return True for a compensation whose values compiled ticks compute; another one is called in every tick.

    Computed are values that depend only on the time and, for `predictor`, on the state of the units.
    """
    kind = type(compensation)
    if _COMPENSATION_STEPS.get(kind) is not getattr(kind, "step", None):
        return False
    if getattr(law, "lookahead_times", None) is not None:
        return False
    if isinstance(compensation, Predictor):
        return compensation.known_delay is not None
    if isinstance(compensation, Twin) and compensation.parameters.identify:
        return False  # its twin depends on the measurements
    if isinstance(compensation, PreviewFeedforward) and compensation.forward != compensation.backward:
        shoes = setup.layout.air_brake and not isinstance(compensation, Twin)
        return not (shoes or getattr(law, "uses_effect", True))  # the time of the effect depends on the last command
    return True


def ticks_to_event(
    stages: Stages, supervised: SupervisedTicks, stack: ControlStack, *, logged: bool, brief: bool = False
) -> int:
    """Return the number of ticks before the next planned event, at most those of the longest span.

    An event is a change, a jump, an intervention, a fault, a request, a decision of the policy `predictive`, or the end
    of the run. It is 0 for the first tick, at which the control stack has no pressure of the brake pipe yet.
    """
    setup, plant, controller = stages.setup, stages.plant, stages.controller
    tick, stamp = setup.tick_ns, plant.stamp
    if stamp == 0:
        return 0
    shoes = getattr(stack._compensation, "shoes", None)
    longest = LONGEST if shoes is None or shoes.idle else BRAKED
    if not (logged or plant.train._outside.acts):
        longest *= BRIEF if brief else UNRECORDED
    longest = min(longest, plant.train.ticks_before_section)
    ends = [stamp + longest * tick, setup.ticks * tick, plant.link.next_jump(stamp)]
    ends += [requested_stamp(change) for change in controller._planned]
    ends += plant._interventions.due_stamps
    ends += [inputs.next_fault(stamp) for inputs in _inputs(stages)]
    ends += supervised.next_request(stamp)
    if isinstance(stack._policy, PredictiveBrake):
        ends.append(round(max(stack._policy.due, 0.0) * 1e9))
    ends += [round(jump.at * 1e9) // tick * tick for jump in plant.train._jumps._waiting if jump.at is not None]
    return int(-((stamp - min(ends)) // tick))


def is_regular(stages: Stages, supervised: SupervisedTicks, stack: ControlStack, law: RecordStep | PythonLaw) -> bool:
    """Return True if train, control stack and receiving ends are in a state that the compiled ticks contain."""
    train, controller, stamp = stages.plant.train, stages.controller, stages.plant.stamp
    if not supervised.is_quiet or not all(inputs.is_regular(stamp) for inputs in _inputs(stages)):
        return False
    if stack.holding or stack.law_brakes or stack.in_transition:
        return False
    if controller._asked or train._parted._since is not None:
        return False
    pipe, compensation = train._brake, stack._compensation
    if isinstance(pipe, PipeEvents) and (stack._pressure != pipe.pressure or pipe._vented):
        return False
    if isinstance(compensation, Twin) and not compensation.started:
        return False
    if train._has_added_gusts:
        return False
    return _observer_is_regular(stages, stack)


def _observer_is_regular(stages: Stages, stack: ControlStack) -> bool:
    """Return True for the observer `none`, or another one whose forecast of the shoe forces has a compiled form."""
    own = stages.observer._stack
    if type(own._observer) is NoObserver:
        return True
    if type(own._observer).step is not _OBSERVER_STEP or own._policy.state.tobytes() != stack._policy.state.tobytes():
        return False
    return not own._shoes.fitted or own._shoes._pressure == stack._pressure


def _inputs(stages: Stages) -> list[StageInputs]:
    """Return the receiving ends of all stages."""
    owners = (stages.plant, stages.profile, stages.observer, stages.controller, stages.supervisor)
    return [owner._inputs for owner in owners if owner is not None]
