"""What a block takes and what it refuses, found by trying it on the shipped trains and with every compensation."""

from __future__ import annotations

import functools
from collections.abc import Iterator

import numpy as np

from plant_sim.library import consist_names, load_consist, load_line
from train_ato.compensate.fit import refuse_misfit
from train_ato.compensate.registry import COMPENSATIONS
from train_ato.control.registry import LAWS
from train_ato.law_docs.blocks import Block
from train_ato.model import TrainModel

PERIOD, DELAY, LAG = 0.1, 0.5, 0.4


@functools.cache
def shipped(name: str, sensors: tuple[int, ...]) -> TrainModel:
    """Return the model of a shipped train on a level line, with a delay and sensors at some couplers."""
    consist = load_consist(name)
    delay = np.full(len(consist.power_units), DELAY)
    return TrainModel(consist, load_line("level"), delay, delay, LAG, PERIOD, sensors)


def refusal(block: Block, train: TrainModel) -> str:
    """Return the reason for which a block with its defaults refuses a train, empty if it takes it."""
    try:
        block.registry.make(block.name, {}, train, PERIOD)
    except ValueError as error:
        return str(error).removeprefix(f"{block.kind} '{block.name}': ")
    return ""


def trains(block: Block) -> list[str]:
    """Return lines that say which shipped trains a block takes, and why not the others."""
    taken, lines = [], []
    for name in consist_names():
        hauled = len(load_consist(name).vehicles) > len(load_consist(name).power_units)
        reason = refusal(block, shipped(name, ()))
        if not reason:
            taken.append(f"`{name}`")
        elif hauled and not refusal(block, shipped(name, (0,))):
            lines.append(f"* `{name}` with a sensor at coupler_0; without: {reason}.")
        else:
            lines.append(f"* `{name}` is refused: {reason}.")
    everything = len(taken) == len(consist_names())
    head = "Takes every shipped train." if everything else f"Takes of the shipped trains {', '.join(taken)}."
    return [head, *([""] if lines else []), *lines]


def misfits(law: str) -> Iterator[tuple[str, str]]:
    """Yield the compensations that a law with its defaults is refused with, and why."""
    made = LAWS.make(law, {}, shipped("xuzhou_metro_3", ()), PERIOD)
    for name in COMPENSATIONS.loadable():
        try:
            refuse_misfit(law, made, name, COMPENSATIONS.get(name))
        except ValueError as error:
            yield name, str(error).partition("': ")[2]


def companions(block: Block) -> list[str]:
    """Return lines that say with what a block is refused."""
    if block.kind == "controller":
        reasons: dict[str, list[str]] = {}
        for name, reason in misfits(block.name):
            reasons.setdefault(reason.replace(f"'{name}'", "it"), []).append(f"`{name}`")
        return [f"Refused with compensation {' or '.join(names)}: {reason}." for reason, names in reasons.items()]
    if block.kind == "compensation":
        laws = [law for law in LAWS.loadable() if block.name in dict(misfits(law))]
        return (
            [f"Refused with the laws {', '.join(f'`{law}`' for law in laws)}, as they are by default."] if laws else []
        )
    return []
