"""Checks of a sweep before its start: every value of every key through the validation of the scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from train_ato.apps.runs.scenario_choice import ScenarioChoice, choose_scenario
from train_ato.apps.sweep.batch import SweepBase
from train_ato.apps.sweep.design import Point
from train_ato.apps.sweep.dimensions import Dimension
from train_ato.apps.sweep.row import one_line
from train_ato.apps.sweep.spec import SweepSpec
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS
from train_ato.log.versions import source_hash
from train_ato.loop.part_cache import PartCache

__all__ = ["check_values", "sweep_base"]

REGISTRIES = {"law": LAWS, "observer": OBSERVERS, "compensation": COMPENSATIONS}


def sweep_base(spec: SweepSpec) -> SweepBase:
    """Return the scenario of a sweep with its fixed keys, checked.

    Raises
    ------
    ValueError
        One line: file, key, value, problem; remedy.
    """
    try:
        choice = choose_scenario(spec.scenario)
    except ValueError as error:
        raise ValueError(f"{spec.source}: scenario: {error}") from None
    try:
        fixed = choice.with_(spec.fixed)
    except ValueError as error:
        raise ValueError(f"{spec.source}: set: {one_line(error, choice)}") from None
    return SweepBase(spec.scenario, fixed.path, fixed.data, source_hash())


def check_values(spec: SweepSpec, base: SweepBase, points: list[Point], step: Callable[[], None] | None = None) -> None:
    """Check every value of every list, and the limits of every range.

    A value is valid if the scenario accepts it alone or in the first point that has it.  A key is valid if at least
    one of its values can be prepared: the other ones, such as a law that does not fit the train, are rows of the
    table with the status ``refused``.

    Parameters
    ----------
    spec, base, points
        The sweep.
    step
        Called after every checked value.

    Raises
    ------
    ValueError
        One line: file, ``over``, key, value, problem; remedy.
    """
    choice, parts = base.choice(), PartCache()
    for dimension in spec.dimensions:
        refusals = []
        accepted = False
        for value, candidates in _candidates(dimension, points):
            where = f"{spec.source}: over: {dimension.key}: {value!r}"
            _check_registered(dimension.key, value, where)
            refusal = _refusal(choice, candidates, parts, where)
            accepted |= refusal is None
            refusals.append(f"{where}: {refusal}")
            if step is not None:
                step()
        if not accepted:
            raise ValueError(refusals[0])


def _candidates(dimension: Dimension, points: list[Point]) -> Iterator[tuple[Any, tuple[Point, ...]]]:
    """Yield the values to check, each with the points in which it may be valid."""
    key = dimension.key
    values: list[Any] = list(dimension.values)
    if dimension.is_range:
        used = [point[key] for point in points]
        values = list(dict.fromkeys((min(used), max(used))))
    for value in values:
        same = next((point for point in points if point[key] == value), None)
        yield value, ({key: value}, *([] if same is None else [same]))


def _check_registered(key: str, value: Any, where: str) -> None:
    """Refuse an unknown law, observer or compensation."""
    registry = REGISTRIES.get(key)
    if registry is None or not isinstance(value, str):
        return
    try:
        registry.get(value)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _refusal(choice: ScenarioChoice, candidates: tuple[Point, ...], parts: PartCache, where: str) -> str | None:
    """Return the reason of a value that no candidate can be prepared with, None if one can.

    Raises
    ------
    ValueError
        If no candidate is a valid scenario.
    """
    reasons, valid = [], False
    for point in candidates:
        try:
            changed = choice.with_(point)
        except ValueError as error:
            reasons.append(one_line(error, choice))
            continue
        valid = True
        try:
            changed.prepare(parts=parts)
        except ValueError as error:
            reasons.insert(0, one_line(error, choice))
        else:
            return None
    if not valid:
        raise ValueError(f"{where}: {reasons[0]}")
    return reasons[0]
