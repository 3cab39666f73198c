"""Trains and compensations that a component accepts, found by trial on the shipped trains."""

from __future__ import annotations

import contextlib
import functools
from typing import Any

import numpy as np
import yaml

from msgs_docs.generate.law_pages.components import Component
from plant_sim.library import consist_names, load_consist, load_line
from train_ato.control.compensation.compatibility import check_compatible
from train_ato.control.gains import TABLE
from train_ato.control.registry import COMPENSATIONS, LAWS
from train_ato.control.train_model import TrainModel

OTHER = {"delay": 0.5, "lag": 0.4, "period": 0.1}
"""Delay, lag and period of a shipped train without fitted gains [s]."""


load = functools.cache(load_consist)


@functools.cache
def shipped(name: str, sensors: tuple[int, ...]) -> TrainModel:
    """Return the model of a shipped train on a level line with the delay of its fitted gains, and coupler sensors."""
    consist = load(name)
    entries = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    loop = next((entry for entry in entries if name in entry["trains"]), OTHER)
    delay = np.full(len(consist.power_units), loop["delay"])
    return TrainModel(consist, load_line("level"), delay, delay, loop["lag"], loop["period"], sensors)


def refusal(component: Component, train: TrainModel) -> str:
    """Return the reason for which a component with its defaults rejects a train; empty if it accepts it."""
    try:
        component.registry.make(component.name, {}, train, train.tick)
    except ValueError as error:
        return str(error).removeprefix(f"{component.kind} '{component.name}': ")
    return ""


def trains(component: Component) -> list[str]:
    """Return lines with the shipped trains that a component accepts and the reasons for the others."""
    taken, lines = [], []
    for name in consist_names():
        hauled = len(load(name).vehicles) > len(load(name).power_units)
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


@functools.cache
def conflicts(law: str) -> tuple[tuple[str, str, list[str]], ...]:
    """Return the compensations that reject a law with its default gains: name, reason, trains ([]: all)."""
    made = {}
    for train in consist_names():
        hauled = len(load(train).vehicles) > len(load(train).power_units)
        model = shipped(train, (0,) if hauled else ())
        with contextlib.suppress(ValueError):
            made[train] = LAWS.make(law, {}, model, model.tick)
    found = []
    for name in COMPENSATIONS.loadable():
        reasons = {train: reason for train, each in made.items() if (reason := conflict(law, each, name))}
        if reasons:
            found.append((name, next(iter(reasons.values())), [] if len(reasons) == len(made) else list(reasons)))
    return tuple(found)


def conflict(law: str, made: Any, compensation: str) -> str:
    """Return the reason of a compensation for the refusal of a law; "" if it accepts it."""
    try:
        check_compatible(law, made, compensation, COMPENSATIONS.get(compensation))
    except ValueError as error:
        return str(error).partition("': ")[2]
    return ""


def companions(component: Component) -> list[str]:
    """Return lines with the incompatible components and the reasons."""
    if component.kind == "law":
        reasons: dict[str, list[str]] = {}
        for name, reason, where in conflicts(component.name):
            reasons.setdefault(reason.replace(f"'{name}'", "it"), []).append(f"`{name}`{on_trains(where)}")
        return [f"Rejected with compensation {' or '.join(names)}: {reason}." for reason, names in reasons.items()]
    if component.kind == "compensation":
        found = [
            f"`{law}`{on_trains(where)}"
            for law in LAWS.loadable()
            for name, _, where in conflicts(law)
            if name == component.name
        ]
        return [f"Rejected with the laws {', '.join(found)} with their default gains."] if found else []
    return []


def on_trains(names: list[str]) -> str:
    """Return a list of trains as text; "" for an empty list."""
    return f" (on {', '.join(f'`{name}`' for name in names)})" if names else ""
