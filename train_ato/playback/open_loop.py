"""Commands of a law on the recorded inputs of a run.

The loop is open: measurement, reference and estimate come from the log and do not depend on the commands.  With the law
and the parameters of the run the commands are equal bit for bit; a change of code or gains appears as a difference.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from train_ato.judge.metric_names import html_table
from train_ato.judge.result import Progress
from train_ato.log.reading import iter_raw, read_log
from train_ato.loop.controller import ControllerStage
from train_ato.loop.stamp_synchronizer import StampSynchronizer
from train_ato.messages.codec import Wire
from train_ato.messages.topics import AHEAD
from train_ato.messages.types import Array, Command, Measurement, Pipe, Reference
from train_ato.profile.profile import profile_of
from train_ato.program.errors import RunFailed
from train_ato.program.interrupt import interruptible
from train_ato.report.print_figures import LONG_RUN_S, SHEET_SIZE, styled, write_figure
from train_ato.report.quantities import COLOURS, QUANTITIES
from train_ato.scenario.setup import RunSetup

INPUTS = {
    "ato/profile": "profile",
    "train/measurement": "measurement",
    "ato/reference": "reference",
    "ato/estimate": "estimate",
}
SUPERVISED_INPUTS = {"train/protection": "protection", "atp/speeds": "speeds"}
"""Additional inputs of a run with a supervisor."""
OUTPUTS = ("ato/command", "ato/brake_pipe_command")
_PROGRESS_TICKS = 100


@dataclass(frozen=True)
class OpenLoop:
    """Outputs of a law on recorded inputs and outputs in the log; k ticks.

    Attributes
    ----------
    stamp : array of int64, shape (k,)
        Stamps [ns].
    velocity, reference : Array, shape (k,)
        Measured speed of the first power unit and speed of the reference [m/s].
    recorded, replayed : Array, shape (k, units)
        Force demand in the log and of the law [N].
    recorded_pipe, replayed_pipe : Array, shape (k,)
        Brake-pipe pressure demanded in the log and by the law [Pa]; empty without an air brake.
    """

    stamp: NDArray[np.int64]
    velocity: Array
    reference: Array
    recorded: Array
    replayed: Array
    recorded_pipe: Array
    replayed_pipe: Array

    @property
    def difference(self) -> Array:
        """Replayed minus recorded [N], shape (k, units)."""
        return self.replayed - self.recorded

    def _repr_html_(self) -> str:
        figures = self.summary()
        verdict = f"the same output in {figures['equal_ticks']} of {figures['ticks']} ticks"
        return html_table(verdict, ("difference", "value"), ((key, figures[key]) for key in figures if "_k" in key))

    def summary(self) -> dict[str, Any]:
        """Return figures of both outputs and of their difference in kN, kPa and s."""
        difference = self.difference / 1e3
        size = np.abs(difference).max(axis=1)
        pipe = (self.replayed_pipe - self.recorded_pipe) / 1e3
        equal = (size == 0) & (pipe == 0) if pipe.size else size == 0
        worst = int(size.argmax())
        return {
            "ticks": int(self.stamp.size),
            "equal_ticks": int(equal.sum()),
            "recorded": _force_figures(self.recorded, self.stamp),
            "replayed": _force_figures(self.replayed, self.stamp),
            "difference_rms_kn": float(np.sqrt((difference**2).mean())),
            "difference_max_kn": float(size[worst]),
            "difference_max_at_s": round(float(self.stamp[worst]) * 1e-9, 9),
            "difference_mean_kn": float(difference.mean()),
            **({"brake_pipe_difference_max_kpa": float(np.abs(pipe).max())} if pipe.size else {}),
        }


def _force_figures(force: Array, stamp: NDArray[np.int64]) -> dict[str, float]:
    """Return figures of the force of all units: extremes and rms in kN, mean change in kN/s."""
    total = force.sum(axis=1) / 1e3
    span = float(stamp[-1] - stamp[0]) * 1e-9
    return {
        "force_max_kn": float(total.max()),
        "force_min_kn": float(total.min()),
        "force_rms_kn": float(np.sqrt((total**2).mean())),
        "variation_kn_per_s": float(np.abs(np.diff(total)).sum() / span) if span > 0 else 0.0,
    }


@dataclass
class _Outputs:
    """Commands by stamp."""

    force: dict[int, Array] = field(default_factory=dict)
    pipe: dict[int, float] = field(default_factory=dict)

    def take(self, message: Command | Pipe) -> None:
        if isinstance(message, Pipe):
            self.pipe[message.stamp] = message.pressure
        else:
            self.force[message.stamp] = message.force

    def pressures(self, stamps: list[int]) -> Array:
        return np.array([self.pipe[stamp] for stamp in stamps]) if self.pipe else np.empty(0)


def replay_open_loop(setup: RunSetup, run: Path, progress: Callable[[Progress], None] | None = None) -> OpenLoop:
    """Run a new controller on the recorded inputs of a run.

    Parameters
    ----------
    setup
        Setup of the run with the tested law and parameters.
    run
        Run folder or MCAP file.
    progress
        Callback for the progress.

    Raises
    ------
    ValueError
        If the log lacks an input, or the law rejects the train.
    RunFailed
        After Ctrl-C.
    """
    setup, kinds = _recorded_inputs(setup, run)
    controller = ControllerStage(setup)
    inputs = StampSynchronizer(supervised_at=setup.supervised_at, behind=AHEAD in kinds)
    recorded, replayed = _Outputs(), _Outputs()
    seen: dict[int, tuple[Measurement, Reference]] = {}
    begin = time.monotonic()
    with interruptible() as interrupt:
        for topic, _, message in read_log(run, Wire(setup.layout).decode, (*kinds, *OUTPUTS)):
            if topic in OUTPUTS:
                recorded.take(message)
                continue
            for step in inputs.put(kinds[topic], message):
                if step.profile is not None:
                    controller.set_profile(profile_of(step.profile))
                controller.receive(
                    step.measurement, step.reference, step.estimate, step.protection, step.speeds, ahead=step.ahead
                )
                answer = controller.command()
                stamp = answer.command.stamp
                seen[stamp] = step.measurement, step.reference
                replayed.take(answer.command)
                if answer.brake_pipe_command is not None:
                    replayed.take(answer.brake_pipe_command)
                if progress is not None and len(seen) % _PROGRESS_TICKS == 0:
                    progress(Progress(stamp * 1e-9, setup.ticks * setup.tick, time.monotonic() - begin))
            if interrupt.asked:
                raise RunFailed("interrupted; no result is written")
    return _joined(run, seen, recorded, replayed)


def _recorded_inputs(setup: RunSetup, run: Path) -> tuple[RunSetup, dict[str, str]]:
    """Return setup and inputs of a run by topic; without the topics of a supervisor the ATO drives all the time."""
    if not setup.layout.supervised:
        return setup, INPUTS
    found = {topic for topic, _, _ in islice(iter_raw(run, tuple(SUPERVISED_INPUTS)), 2 * len(SUPERVISED_INPUTS))}
    if found == set(SUPERVISED_INPUTS):
        return setup, {**INPUTS, **SUPERVISED_INPUTS, **({AHEAD: "ahead"} if setup.layout.behind else {})}
    return replace(setup, layout=replace(setup.layout, supervised=False)), INPUTS


def _joined(
    run: Path, seen: dict[int, tuple[Measurement, Reference]], recorded: _Outputs, replayed: _Outputs
) -> OpenLoop:
    """Join both outputs at their common stamps; a measured run has no demand of the brake pipe."""
    pipes = bool(recorded.pipe and replayed.pipe)
    common = [stamp for stamp in seen if stamp in recorded.force and (not pipes or stamp in recorded.pipe)]
    if not common:
        raise ValueError(
            f"{run}: no stamp with profile, measurement, reference, estimate and command; nothing to compare"
        )
    return OpenLoop(
        stamp=np.array(common, dtype=np.int64),
        velocity=np.array([seen[stamp][0].velocity[0] for stamp in common]),
        reference=np.array([seen[stamp][1].velocity for stamp in common]),
        recorded=np.array([recorded.force[stamp] for stamp in common]),
        replayed=np.array([replayed.force[stamp] for stamp in common]),
        recorded_pipe=recorded.pressures(common) if pipes else np.empty(0),
        replayed_pipe=replayed.pressures(common) if pipes else np.empty(0),
    )


_FEW = 4
"""Largest number of power units with a curve each."""


@styled(SHEET_SIZE)
def draw_open_loop(result: OpenLoop, title: str, recorded: str, replayed: str, path: Path) -> None:
    """Draw speed, both force demands, their difference and, with an air brake in use, both brake-pipe demands.

    Parameters
    ----------
    result
        Outputs to draw.
    title
        Title of the figure.
    recorded, replayed
        Names of the two outputs.
    path
        File of the figure; its suffix selects the format.
    """
    pipe = any(demand.size > 0 and np.ptp(demand) > 0 for demand in (result.recorded_pipe, result.replayed_pipe))
    panels = 4 if pipe else 3
    figure = Figure(figsize=(11, 2.6 * panels), dpi=110, layout="constrained")
    axes = figure.subplots(panels, 1, sharex=True)
    long = bool(result.stamp[-1] * 1e-9 > LONG_RUN_S)
    time: Array = result.stamp.astype(np.float64) * (1e-9 / 60 if long else 1e-9)
    speeds = (
        ("profile", "profile", result.reference, 2.2, 0.65),
        ("measured_speed", "measured", result.velocity, 1.0, 1),
    )
    for key, label, speed, width, alpha in speeds:
        axes[0].plot(time, 3.6 * speed, color=QUANTITIES[key].colour, lw=width, alpha=alpha, label=label)
    axes[0].set_ylabel("speed in km/h\n(both as recorded)")
    _legend(axes[0], 2)
    _draw_pair(
        axes[1], time, (result.recorded.sum(axis=1) / 1e3, recorded), (result.replayed.sum(axis=1) / 1e3, replayed)
    )
    axes[1].set_ylabel("command of all units in kN")
    _draw_difference(axes[2], result, time)
    if pipe:
        _draw_pair(axes[3], time, (result.recorded_pipe / 1e3, recorded), (result.replayed_pipe / 1e3, replayed))
        axes[3].set_ylabel("brake pipe command in kPa")
    for panel in axes:
        panel.margins(x=0.01)
    axes[-1].set_xlabel("time in min" if long else "time in s")
    figure.suptitle(title)
    write_figure(figure, path)


def _draw_pair(panel: Axes, time: Array, recorded: tuple[Array, str], replayed: tuple[Array, str]) -> None:
    panel.plot(time, recorded[0], color=COLOURS[5], lw=2.2, alpha=0.5, label=recorded[1])
    panel.plot(time, replayed[0], color=COLOURS[1], lw=0.8, label=replayed[1])
    _legend(panel, 2)


def _draw_difference(panel: Axes, result: OpenLoop, time: Array) -> None:
    difference = result.difference / 1e3
    units = difference.shape[1]
    if units <= _FEW:
        for unit in range(units):
            label = "replayed - recorded" if units == 1 else f"unit {unit}"
            panel.plot(time, difference[:, unit], color=COLOURS[unit], lw=0.8, label=label)
    else:
        panel.fill_between(
            time, difference.min(axis=1), difference.max(axis=1), color=COLOURS[0], alpha=0.3, lw=0, label="all units"
        )
        panel.plot(time, difference.mean(axis=1), color=COLOURS[0], lw=0.8, label="mean over units")
    if not np.any(difference):
        panel.set_ylim(-1, 1)
    panel.set_ylabel("difference in kN\nper unit")
    _legend(panel, units if units <= _FEW else 2)


def _legend(panel: Axes, columns: int) -> None:
    """Draw the legend above the panel, clear of the curves."""
    panel.legend(
        loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.1, frameon=False, ncols=columns, fontsize="small"
    )
