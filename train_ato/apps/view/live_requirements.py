"""Requirements of a running scenario on the live page: bounds of their robustness over all continuations of the run."""

from __future__ import annotations

import math
import time
from html import escape

import numpy as np

from train_ato.apps.view.snapshot import Snapshot
from train_ato.loop.recording import (
    BRAKE_PIPE,
    BRAKE_SHOES,
    COMMAND,
    MEASUREMENT,
    REFERENCE,
    SUPERVISED_SPEEDS,
    TRUTH,
    Recording,
)
from train_ato.loop.requirements import Robustness, evaluate_formula
from train_ato.loop.series import TopicSamples
from train_ato.loop.setup import RunSetup
from train_ato.loop.verdict import three_digits
from train_ato.messages.types import Array
from train_ato.scenario.formula_parser import parse_formula

LATEST_START_S = 1.0
"""Largest simulated time of the first snapshot: a page that joins later has no samples of the start."""
EVERY_S, LARGEST_LOAD = 1.0, 0.05
"""Shortest wall time between two evaluations [s], and their largest part of the wall time."""
COLOURS = {True: "#4caf7d", False: "#ff6b5e", None: "inherit"}


class LiveRequirements:
    """Evaluation of the requirements at the snapshots of the page, held to the ticks of the run.

    Parameters
    ----------
    setup
        The run.

    Attributes
    ----------
    markup : str
        Result as HTML; "" for a scenario without requirements.
    """

    def __init__(self, setup: RunSetup) -> None:
        self._setup = setup
        named = setup.scenario.criteria.requirements or {}
        self._formulas = {name: parse_formula(text) for name, text in named.items()}
        self._snapshots: list[Snapshot] = []
        self._due = 0.0
        self._end = (setup.ticks + 1) * setup.tick
        self.markup = ""

    def add(self, moment: Snapshot) -> None:
        """Add a snapshot; evaluate if the last evaluation is long enough ago."""
        if not self._formulas or (self._snapshots and moment.time <= self._snapshots[-1].time):
            return
        if not 0.0 <= moment.time <= self._end:  # a stamp of a foreign node
            return
        self._snapshots.append(moment)
        begin = time.monotonic()
        if begin < self._due:
            return
        self.markup = "<br>".join(_line(name, found) for name, found in self.evaluate().items())
        end = time.monotonic()
        self._due = end + max(EVERY_S, (end - begin) / LARGEST_LOAD)

    def evaluate(self) -> dict[str, Robustness]:
        """Return the bounds of every requirement; {} without snapshots from the start."""
        if not self._snapshots or self._snapshots[0].time > LATEST_START_S:
            return {}
        recording = self._recording()
        return {name: evaluate_formula(formula, self._setup, recording) for name, formula in self._formulas.items()}

    def _recording(self) -> Recording:
        """Return the snapshots as a recording at the ticks; between two snapshots the earlier one is held."""
        tick, moments = self._setup.tick, self._snapshots
        times = np.array([moment.time for moment in moments])
        ticks = tick * np.arange(round(times[-1] / tick) + 1)
        rows = np.maximum(np.searchsorted(times, ticks + 0.5 * tick, side="right") - 1, 0)

        def samples(**values: list[Array | float]) -> TopicSamples:
            stacked = {name: np.array(column, dtype=np.float64) for name, column in values.items()}
            return TopicSamples(ticks, {name: found.reshape(len(moments), -1)[rows] for name, found in stacked.items()})

        nothing = np.full(4, math.nan)
        topics = {
            TRUTH: samples(
                front_position=[moment.position[0] for moment in moments],
                front_velocity=[moment.velocity[0] for moment in moments],
                coupler_draft_max=[moment.coupler.max(initial=0.0) for moment in moments],
                coupler_buff_max=[moment.coupler.min(initial=0.0) for moment in moments],
            ),
            MEASUREMENT: samples(applied=[moment.applied for moment in moments]),
            REFERENCE: samples(
                position=[moment.reference[0] for moment in moments],
                velocity=[moment.reference[1] for moment in moments],
                acceleration=[moment.reference[2] for moment in moments],
            ),
            COMMAND: samples(force=[moment.command for moment in moments]),
            BRAKE_PIPE: samples(pressure=[moment.pipe for moment in moments]),
            BRAKE_SHOES: samples(total=[math.nan if moment.shoe is None else moment.shoe.sum() for moment in moments]),
            SUPERVISED_SPEEDS: samples(
                speed=[
                    np.append(moment.velocity[0], nothing if moment.limits is None else moment.limits)
                    for moment in moments
                ]
            ),
        }
        return Recording(topics)


def _line(name: str, found: Robustness) -> str:
    """Return a requirement as a line of HTML: state, and the margin that can still be reached."""
    unit = f" {found.unit}" if found.unit else ""
    if found.passed is None:
        parts = [
            f"{word} {three_digits(value)}{unit}"
            for word, value in (("at least", found.lower), ("at most", found.upper))
            if math.isfinite(value)
        ]
        text = f"open{', robustness ' if parts else ''}{' and '.join(parts)}"
    else:
        value = found.lower if found.passed else found.upper
        text = f"{'fulfilled' if found.passed else 'broken'}, robustness {three_digits(value)}{unit}"
    return f'<span style="color:{COLOURS[found.passed]}">{escape(name)}: {escape(text)}</span>'
