"""Checks of a scenario against the parts of its train and line, before a law or the plant is created."""

from __future__ import annotations

from plant_sim.line import Line
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS
from train_ato.loop.signal_check import unavailable_signal
from train_ato.messages.layout import TrainLayout
from train_ato.scenario.formula import signals_of
from train_ato.scenario.formula_parser import parse_formula
from train_ato.scenario.scenario import Scenario

__all__ = ["check_parameters", "check_replan", "check_requirements"]


def check_replan(scenario: Scenario, layout: TrainLayout) -> None:
    """Check that the scenario permits re-planning."""
    if scenario.replan is None:
        return
    if scenario.brake.policy != "none":
        events = " and remove brake.events" if scenario.brake.events else ""
        raise ValueError(
            f"replan: not possible with brake.policy {scenario.brake.policy}, because plans do not include its "
            f"air brake; remove replan, or set brake.policy: none{events}"
        )
    if not layout.n_units:
        raise ValueError("replan: the train has no power unit; remove replan")
    plan = scenario.profile.plan
    if scenario.replan.catch_up and (plan is None or (plan.time is None and plan.points is None)):
        raise ValueError("replan: catch_up: true: the profile has no timetable; add profile.plan.time or .points")


def check_requirements(scenario: Scenario, layout: TrainLayout, line: Line) -> None:
    """Check that the run has the signals of its requirements."""
    for name, text in (scenario.criteria.requirements or {}).items():
        if reason := unavailable_signal(signals_of(parse_formula(text)), layout, line):
            raise ValueError(f"criteria.requirements.{name}: {reason}")


def check_parameters(scenario: Scenario) -> None:
    """Check names and values of the parameters of all laws, observers and compensations at the start."""
    blocks = {"laws": LAWS, "observers": OBSERVERS, "compensations": COMPENSATIONS}
    for block, registry in blocks.items():
        for name, values in getattr(scenario, block).items():
            try:
                registry.check_parameters(name, values)
            except ValueError as error:
                message = str(error)
                raise ValueError(f"{block}.{message}" if message.startswith(f"{name}.") else message) from None
