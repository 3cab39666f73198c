"""Force limits of line sections in the plan of a predictive law: limits at its nodes, and the command of every unit."""

# mypy: allow-untyped-defs

from __future__ import annotations

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.summation import plain_sum
from train_ato.messages.types import Array


@compiled
def node_limits(force, nodes, parts, effect, limits, side):
    """Narrow the limits of the total force at the nodes by those of the units ahead.

    A limit of a node is its mean over the time to the neighbours, with weights that fall linearly to 0 there: the
    planned force, linear between the nodes, then has the impulse that a section leaves. The first node has the limit at
    the effect of the command.

    Parameters
    ----------
    force : Array, shape (h, units)
        Limit of every unit at the times of the lookahead [N].
    nodes : Array, shape (nodes,)
        Times of the nodes after the effect [s].
    parts
        Steps from a node to the next at the end of the lookahead.
    effect
        Row of the effect of the command.
    limits : Array, shape (2, nodes)
        Smallest and largest total force [N]; changed.
    side
        0: ``force`` is the smallest, 1: the largest.
    """
    n, first = nodes.size, force.shape[0] - parts * (nodes.size - 1) - 1
    total, weight = np.zeros(n), np.zeros(n)
    for j in range(n - 1):
        step = nodes[j + 1] - nodes[j]
        for k in range(parts + 1):
            value = 0.0
            for unit in range(force.shape[1]):
                value += force[first + j * parts + k, unit]
            part = k / parts
            ends = 0.5 if k == 0 or k == parts else 1.0
            total[j] += ends * step * (1.0 - part) * value
            weight[j] += ends * step * (1.0 - part)
            total[j + 1] += ends * step * part * value
            weight[j + 1] += ends * step * part
    for j in range(n):
        value = total[j] / weight[j]
        if j == 0:
            value = 0.0
            for unit in range(force.shape[1]):
                value += force[effect, unit]
        limits[side, j] = min(limits[side, j], value) if side else max(limits[side, j], value)


def within_units(wanted: list[float], share: list[float], low: list[float], high: list[float]) -> list[float]:
    """Return the forces of the units inside their limits [N]; other units take over what one cannot give.

    Parameters
    ----------
    wanted, share, low, high : list of float, length units
        Forces [N], shares of a total force, and limits at the time of effect [N].
    """
    found = _limited(wanted, low, high)
    for _ in wanted:
        rest = plain_sum(wanted) - plain_sum(found)
        free = [
            part if (most > force if rest > 0.0 else least < force) else 0.0
            for part, force, least, most in zip(share, found, low, high, strict=True)
        ]
        whole = plain_sum(free)
        if rest == 0.0 or whole == 0.0:
            break
        found = _limited([force + rest * part / whole for force, part in zip(found, free, strict=True)], low, high)
    return found


def _limited(force: list[float], low: list[float], high: list[float]) -> list[float]:
    return [min(max(each, least), most) for each, least, most in zip(force, low, high, strict=True)]


def limits_at_nodes(low: Array, high: Array, nodes: Array, parts: int, effect: int, limits: Array) -> Array:
    """Return limits of the total force narrowed by :func:`node_limits` on both sides [N], shape (2, nodes)."""
    found = limits.copy()
    node_limits(low, nodes, parts, effect, found, 0)
    node_limits(high, nodes, parts, effect, found, 1)
    return found
