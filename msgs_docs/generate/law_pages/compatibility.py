"""Trains and compensations that a component accepts, found by trial on the shipped trains."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

import numpy as np

from msgs_docs.generate.law_pages.components import Component
from plant_sim.library import consist_names, load_consist, load_line
from train_ato.control.compensation.compatibility import check_compatible
from train_ato.control.registry import COMPENSATIONS, LAWS
from train_ato.control.train_model import TrainModel

PERIOD, DELAY, LAG = 0.1, 0.5, 0.4


@functools.cache
def shipped(name: str, sensors: tuple[int, ...]) -> TrainModel:
    """Return the model of a shipped train on a level line, with a delay and sensors at some couplers."""
    consist = load_consist(name)
    delay = np.full(len(consist.power_units), DELAY)
    return TrainModel(consist, load_line("level"), delay, delay, LAG, PERIOD, sensors)


def refusal(component: Component, train: TrainModel) -> str:
    """Return the reason for which a component with its defaults rejects a train; empty if it accepts it."""
    try:
        component.registry.make(component.name, {}, train, PERIOD)
    except ValueError as error:
        return str(error).removeprefix(f"{component.kind} '{component.name}': ")
    return ""


def trains(component: Component) -> list[str]:
    """Return lines with the shipped trains that a component accepts and the reasons for the others."""
    taken, lines = [], []
    for name in consist_names():
        hauled = len(load_consist(name).vehicles) > len(load_consist(name).power_units)
        reason = refusal(component, shipped(name, ()))
        if not reason:
            taken.append(f"`{name}`")
        elif hauled and not refusal(component, shipped(name, (0,))):
            lines.append(f"* `{name}` with a sensor at coupler_0; without: {reason}.")
        else:
            lines.append(f"* `{name}` is rejected: {reason}.")
    everything = len(taken) == len(consist_names())
    head = "Accepts every shipped train." if everything else f"Accepts the shipped trains {', '.join(taken)}."
    return [head, *([""] if lines else []), *lines]


def conflicts(law: str) -> Iterator[tuple[str, str]]:
    """Yield the compensations that reject a law with its defaults, each with the reason."""
    made = LAWS.make(law, {}, shipped("xuzhou_metro_3", ()), PERIOD)
    for name in COMPENSATIONS.loadable():
        if reason := conflict(law, made, name):
            yield name, reason


def conflict(law: str, made: Any, compensation: str) -> str:
    """Return the reason of a compensation for the refusal of a law; "" if it accepts it."""
    try:
        check_compatible(law, made, compensation, COMPENSATIONS.get(compensation))
    except ValueError as error:
        return str(error).partition("': ")[2]
    return ""


def accepted_with_hauled(law: str, compensation: str) -> bool:
    """Return True if a compensation accepts a law on the shipped train with hauled vehicles."""
    try:
        made = LAWS.make(law, {}, shipped("hxd1_c80_105", (0,)), PERIOD)
    except ValueError:
        return False
    return not conflict(law, made, compensation)


def companions(component: Component) -> list[str]:
    """Return lines with the incompatible components and the reasons."""
    if component.kind == "law":
        reasons: dict[str, list[str]] = {}
        for name, reason in conflicts(component.name):
            only = " (accepted with hauled vehicles)" if accepted_with_hauled(component.name, name) else ""
            reasons.setdefault(reason.replace(f"'{name}'", "it"), []).append(f"`{name}`{only}")
        return [f"Rejected with compensation {' or '.join(names)}: {reason}." for reason, names in reasons.items()]
    if component.kind == "compensation":
        laws = [law for law in LAWS.loadable() if component.name in dict(conflicts(law))]
        return [f"Rejected with the laws {', '.join(f'`{law}`' for law in laws)} with their defaults."] if laws else []
    return []
