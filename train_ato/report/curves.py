"""Curves of the figures at full resolution, in the units of the axes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from plant_sim.plant_setup import Jump, PlantSetup
from plant_sim.units import KMH
from train_ato.control.train_model import TrainModel
from train_ato.judge import recording as rec
from train_ato.judge.metrics import limit_over_train
from train_ato.judge.series import aligned
from train_ato.loop.engine import SIGNALS
from train_ato.messages.delay_lines import LinkSpec
from train_ato.messages.topic import FIXED_NAMES, Owner
from train_ato.messages.types import Array
from train_ato.program.display_units import display_unit
from train_ato.report.events import delay_jumps
from train_ato.report.quantities import QUANTITIES, unit_in_figures

WINDOWS = 80
"""Approximate number of time windows; each is ``MIN_WINDOW`` to ``MAX_WINDOW`` [s] long."""
MIN_WINDOW, MAX_WINDOW = 5.0, 60.0
CANDIDATES = 120
"""Number of delays that are evaluated."""
DEFAULT_MAX_DELAY = 5.0
"""Maximum of the search without a scenario [s]."""
MIN_VARIATION = 0.003
"""Minimum rms variation of the force in a window, relative to the range of the run."""
MAX_SATURATED = 0.02
"""Maximum fraction of a window with a saturated force."""
MIN_EXPLAINED = 0.8
"""Minimum fraction of the variance of the force explained by the delay."""


def found_delay(time: Array, demand: Array, applied: Array, longest: float, lag: float = 0.0) -> tuple[Array, Array]:
    """Identify the delay of the applied force behind the demand [s] in time windows.

    The delay is the shift of the lagged demand with the least squared difference, refined between the ticks by a
    parabola.  The lag adds its time constant, the delay of slowly changing forces.  Windows with a nearly constant
    force, or with a force that no shift explains (saturation), have no result.

    Parameters
    ----------
    time, demand, applied : Array, shape (k,)
        Stamps [s], equally spaced; demand and applied force [N].
    longest
        Maximum of the search [s].
    lag
        Time constant of the actuators [s]; 0: unknown.

    Returns
    -------
    middle, delay : Array, shape (windows,)
        Middle of every window [s] and the delay [s]; NaN: no result.
    """
    if time.size < 8 or not np.isfinite(demand).any():
        return np.empty(0), np.empty(0)
    tick = float(np.median(np.diff(time)))
    demand = _lagged(np.nan_to_num(demand), lag, tick)
    stride = max(1, int(np.ceil(longest / tick / CANDIDATES)))
    step = stride * tick
    demand, applied, time = demand[::stride], applied[::stride], time[::stride]
    shifts = max(2, min(round(longest / step), time.size // 4))
    width = round(float(np.clip((time[-1] - time[0]) / WINDOWS, MIN_WINDOW, MAX_WINDOW)) / step)
    edges = np.arange(shifts, time.size, max(1, width), dtype=np.intp)
    if edges.size < 2:
        return np.empty(0), np.empty(0)
    shifted = (demand[shifts - shift : demand.size - shift] for shift in range(shifts))
    errors = np.array([_window_sums((applied[shifts:] - earlier) ** 2, edges - shifts) for earlier in shifted])
    counts = np.diff(edges).astype(np.float64)
    best = errors.argmin(axis=0)
    delay = step * _refined(errors, best)
    mean, squares = (_window_sums(applied[shifts:] ** power, edges - shifts) / counts for power in (1, 2))
    varied = np.maximum(squares - mean**2, 0.0)
    low, high = np.nanpercentile(applied, (1, 99))
    varying = np.sqrt(varied) > MIN_VARIATION * (high - low)
    explained = errors.min(axis=0) / counts < (1 - MIN_EXPLAINED) * varied
    inside = best < shifts - 1
    middle = (time[edges[:-1]] + time[edges[1:] - 1]) / 2
    return middle, np.where(varying & explained & inside, lag + delay, np.nan)


def _lagged(values: Array, lag: float, tick: float) -> Array:
    """Return the output of a first-order lag for values held over each tick."""
    if lag <= 0:
        return values
    gain = 1.0 - float(np.exp(-tick / lag))
    steps = accumulate(
        values[:-1].tolist(), lambda force, held: force + gain * (held - force), initial=float(values[0])
    )
    return np.fromiter(steps, dtype=np.float64, count=values.size)


def _window_sums(values: Array, edges: NDArray[np.intp]) -> Array:
    total = np.concatenate(([0.0], np.cumsum(np.nan_to_num(values))))
    return np.asarray([total[b] - total[a] for a, b in pairwise(edges.tolist())])


def _refined(errors: Array, best: NDArray[np.intp]) -> Array:
    """Return the shift of the smallest error between the ticks, from a parabola through three points."""
    inner = np.clip(best, 1, errors.shape[0] - 2)
    windows = np.arange(best.size)
    before, here, after = errors[inner - 1, windows], errors[inner, windows], errors[inner + 1, windows]
    bend = before - 2 * here + after
    offset = np.where(bend > 0, 0.5 * (before - after) / np.where(bend > 0, bend, 1.0), 0.0)
    return np.where(best == inner, inner + np.clip(offset, -0.5, 0.5), best)


def set_lag(recording: rec.Recording, plant: PlantSetup, time: Array, units: int) -> Array:
    """Return the lag of the actuators with its jumps at every stamp [s], mean over the power units, shape (k,)."""
    lag = np.array(np.broadcast_to(np.asarray(plant.lag), (time.size, units)), dtype=np.float64)
    motion = recording.motion
    for jump in plant.jumps:
        if not isinstance(jump, Jump) or jump.what != "lag":
            continue
        begin = np.inf if jump.at is None else jump.at
        if jump.place is not None and motion is not None and "position" in motion:
            begin = min(motion.time[motion["position"][:, 0] >= jump.place], default=np.inf)
        changed = np.isin(np.arange(units), np.arange(units) if jump.units is None else jump.units)
        lag[np.outer(time >= begin, changed)] *= jump.factor
    return np.asarray(lag.mean(axis=1))


def set_delay(
    link: LinkSpec, lag: Array, jumps: list[tuple[float, float, float]], time: Array, demand: Array
) -> Array:  # fmt: skip
    """Return the delay of the command link plus the lag of the actuators at every tick [s], mean over the power units.

    Parameters
    ----------
    link
        Delay of the command in the scenario; the mean of the jitter is added.
    lag : Array, shape (k,)
        Time constant of the actuators, mean over the units [s].
    jumps
        Time [s], factor and addition [s] of the interventions.
    time : Array, shape (k,)
        Stamps [s].
    demand : Array, shape (k, units)
        A negative demand has the delay of the brake.
    """
    traction, brake = link.per_unit(demand.shape[1], "command")
    delay = np.where(demand < 0, brake, traction)
    changes = [*jumps] if link.jump is None else [(link.jump.at, link.jump.factor, link.jump.add), *jumps]
    factor, add = np.ones((time.size, 1)), np.zeros((time.size, 1))
    for at, times, more in changes:
        factor[time >= at] *= times
        add[time >= at] += more
    delay = np.maximum(0.0, delay * factor + add + link.jitter / 2).mean(axis=1)
    if link.varying is not None:
        delay = delay + link.varying.amplitude * np.abs(np.sin(link.varying.omega * time + link.varying.phase))
    return np.asarray(delay + lag)


def assumed_delay(recording: rec.Recording) -> tuple[Array, Array] | None:
    """Return time and delay plus lag assumed by the law [s], from its diagnostics, mean over the power units."""
    controller = recording.diagnostics.get("controller")
    if controller is None:
        return None
    lag = controller.numbers("lag")
    times, values = [], []
    for row, text in enumerate(controller.texts("delay")):
        if text:
            numbers = [float(part) for part in text.strip("[]").split(",") if part.strip()]
            times.append(float(controller.time[row]))
            values.append(float(np.mean(numbers or [0.0])) + (float(lag[row]) if lag is not None else 0.0))
    return (np.array(times), np.array(values)) if times else None


def _without_saturation(recording: rec.Recording, middle: Array, delay: Array) -> tuple[Array, Array]:
    """Remove the windows with saturation: there the force follows its limit without delay, not the demand."""
    total = recording.reported("plant", "saturated")
    if total is None or middle.size < 2:
        return middle, delay
    half = float(np.median(np.diff(middle))) / 2
    saturated = np.interp(middle + half, *total) - np.interp(middle - half, *total)
    return middle, np.where(saturated > MAX_SATURATED * 2 * half, np.nan, delay)


def delays(recording: rec.Recording, jumps: list[tuple[float, float, float]]) -> dict[str, Array]:
    """Return the available delays at the stamps of the commands [s].

    Parameters
    ----------
    recording
        The run.
    jumps
        Interventions in the delay of the link: time [s], factor, addition [s].
    """
    command, applied = recording.of(rec.COMMAND, "force"), recording.of(rec.MEASUREMENT, "applied")
    if command is None or applied is None or command[1].shape[1] == 0:
        return {}
    time, demand = command
    force = aligned(time, applied[0], applied[1])
    longest, lag = DEFAULT_MAX_DELAY, 0.0
    result: dict[str, Array] = {}
    if recording.setup is not None:
        lags = set_lag(recording, recording.setup.scenario.plant, time, demand.shape[1])
        lag = float(np.mean(recording.setup.scenario.plant.lag))
        known = set_delay(recording.setup.scenario.links.command, lags, jumps, time, demand)
        result["delay_set"] = known
        longest = 2.0 * float(known.max() - lag) + 1.0
    found = _without_saturation(recording, *found_delay(time, demand.sum(axis=1), force.sum(axis=1), longest, lag))
    if np.isfinite(found[1]).any():
        middle, delay = found
        result["delay"] = delay[np.searchsorted((middle[1:] + middle[:-1]) / 2, time)]
    if (assumed := assumed_delay(recording)) is not None:
        row = np.searchsorted(assumed[0], time, side="right") - 1
        result["delay_assumed"] = np.where(row >= 0, assumed[1][np.maximum(row, 0)], np.nan)
    return result


KILO, KWH = 1e3, 3.6e6
MAX_UNITS = 8
"""Maximum number of power units with separate curves."""
FAR_ENVELOPE = 20.0
"""An envelope larger than this multiple of the largest force is not drawn."""
ENERGIES = ("traction", "regenerated", "running", "curve", "grade", "air_brake", "couplers", "outside", "kinetic")
"""Curves of the work done on the train; ``energy_traction`` and so on in the plant's diagnostics."""
NO_COUPLER = "the train model has one vehicle and no coupler"
NEVER_APPLIED = "the air brake was never applied"


class NotAvailable(Exception):
    """Raised for a figure without data in the recording, with the reason."""


@dataclass(frozen=True)
class Curves:
    """Curves with a common time.

    Attributes
    ----------
    time : Array, shape (k,)
        Stamps [s].
    columns : dict of Array, each of shape (k,)
        By quantity, in its unit; ``quantity:3`` belongs to power unit 3.  NaN: no value.
    """

    time: Array
    columns: dict[str, Array]


def speed_curves(recording: rec.Recording) -> Curves:
    """Return speed of vehicle 0, its profile, its limit and the supervision limits [km/h], and its position [km]."""
    motion = recording.motion
    if motion is None:
        raise NotAvailable("the log has neither train/vehicles nor train/measurement")
    now = motion["velocity"][:, 0]
    columns = {"measured_speed" if recording.measured_only else "speed": KMH * now}
    if (reference := recording.of(rec.REFERENCE, "velocity")) is not None:
        columns["profile"] = KMH * aligned(motion.time, *reference)[:, 0]
    if "position" in motion:
        position = motion["position"][:, 0]
        if (limit := whole_train_limit(recording, position)) is not None:
            columns["limit"] = limit
        columns["position_km"] = position / KILO
    return Curves(motion.time, {**columns, **_supervision_limits(recording, motion.time)})


def _supervision_limits(recording: rec.Recording, time: Array) -> dict[str, Array]:
    """Return the limits of the supervisor [km/h] at these times; {} without a supervisor."""
    found = recording.of(rec.SUPERVISED_SPEEDS, "speed")
    names = FIXED_NAMES[Owner.SUPERVISED_SPEED]
    if found is None or found[1].shape[1] != len(names):
        return {}
    values = KMH * aligned(time, *found)
    return {f"{name}_speed": values[:, place] for place, name in enumerate(names) if f"{name}_speed" in QUANTITIES}


def whole_train_limit(recording: rec.Recording, position: Array) -> Array | None:
    """Return the lowest limit under the train [km/h] for positions of vehicle 0; None without limits."""
    setup = recording.setup
    if setup is not None and setup.line.speed_limits:
        front = position + setup.consist.vehicles[0].length / 2
        limit = limit_over_train(setup.line, front, setup.consist.length)
        return np.where(np.isfinite(limit), KMH * limit, np.nan)
    if recording.limits is None or not recording.limits.position.size:
        return None
    places, speeds = recording.limits.position, recording.limits.velocity
    step = np.searchsorted(places, position, side="right") - 1
    return np.where(step >= 0, KMH * speeds[np.maximum(step, 0)], np.nan)


def _of_units(recording: rec.Recording, name: str) -> tuple[Array, Array]:
    """Return time and truth, or else measurement, of every power unit, shapes (k,) and (k, u)."""
    for found in (recording.of(rec.TRUTH, f"unit_{name}"), recording.of(rec.MEASUREMENT, name)):
        if found is not None and found[1].shape[1]:
            return found
    raise NotAvailable(f"the log has no {name} of a power unit")


def _reference(recording: rec.Recording, name: str, time: Array) -> Array:
    reference = recording.of(rec.REFERENCE, name)
    if reference is None:
        raise NotAvailable("the log has no ato/reference")
    if not recording.recorded("reference"):
        raise NotAvailable("the reference was not measured; the profile is the measured speed")
    return np.asarray(aligned(time, *reference)[:, :1])


def _per_unit(name: str, values: Array) -> dict[str, Array]:
    """Return columns by power unit; a single unit has no number."""
    if values.shape[1] == 1:
        return {name: values[:, 0]}
    return {f"{name}:{unit}": values[:, unit] for unit in range(min(values.shape[1], MAX_UNITS))}


def speed_error_curves(recording: rec.Recording) -> Curves:
    """Return speed minus reference at the same stamp [km/h] of every power unit."""
    time, values = _of_units(recording, "velocity")
    return Curves(time, _per_unit("speed_error", KMH * (values - _reference(recording, "velocity", time))))


def position_error_curves(recording: rec.Recording) -> Curves:
    """Return position minus reference [m] of every power unit, corrected by its offset in the train."""
    time, values = _of_units(recording, "position")
    offsets = recording.setup.model.offsets if recording.setup is not None else 0.0
    errors = values + offsets - _reference(recording, "position", time)
    return Curves(time, _per_unit("position_error", np.asarray(errors)))


def force_curves(recording: rec.Recording) -> Curves:
    """Return command, applied force and nominal envelope, sums of all power units [kN]."""
    command, applied = recording.of(rec.COMMAND, "force"), recording.of(rec.MEASUREMENT, "applied")
    if applied is None and command is None:
        raise NotAvailable("the log has neither ato/command nor train/measurement")
    if applied is not None and not recording.recorded("command"):
        command = None
    time = (command or applied or (np.empty(0), np.empty(0)))[0]
    columns: dict[str, Array] = {}
    for name, found in (("demand", command), ("applied", applied)):
        if found is not None and found[1].shape[1]:
            columns[name] = aligned(time, *found).sum(axis=1) / KILO
    if not columns:
        raise NotAvailable("the train has no power unit")
    largest = max(float(np.nanmax(np.abs(values), initial=0.0)) for values in columns.values())
    columns |= _envelope(recording, time, largest)
    return Curves(time, columns)


def _envelope(recording: rec.Recording, time: Array, largest: float) -> dict[str, Array]:
    setup, motion = recording.setup, recording.motion
    if setup is None or motion is None or setup.scenario.plant.ideal_actuator:
        return {}
    low, high = envelope(setup.model, aligned(time, motion.time, motion["velocity"][:, 0]))
    if max(float(np.nanmax(high, initial=0.0)), -float(np.nanmin(low, initial=0.0))) > FAR_ENVELOPE * KILO * largest:
        return {}
    return {"envelope_high": high / KILO, "envelope_low": low / KILO}


def envelope(model: TrainModel, speed: Array) -> tuple[Array, Array]:
    """Return minimum and maximum of the total force at these speeds [N]."""
    size = np.abs(speed)
    grid = np.linspace(0.0, max(1.0, float(np.nanmax(size, initial=0.0))), 400)
    pairs = [model.force_limits(np.full(model.n_units, value)) for value in grid]
    low, high = (np.array([pair[side].sum() for pair in pairs]) for side in (0, 1))
    return np.interp(size, grid, low), np.interp(size, grid, high)


def unit_force_curves(recording: rec.Recording) -> Curves:
    """Return the applied force of every power unit [kN]."""
    applied = recording.of(rec.MEASUREMENT, "applied")
    if applied is None or applied[1].shape[1] < 2:
        raise NotAvailable(
            "the train has a single power unit" if applied is not None else "the log has no train/measurement"
        )
    return Curves(applied[0], _per_unit("applied", applied[1] / KILO))


def coupler_curves(recording: rec.Recording) -> Curves:
    """Return largest draft and buff along the train and three couplers [kN]."""
    truth = recording.topics.get(rec.TRUTH)
    if truth is None:
        raise NotAvailable("the log has no train/vehicles")
    if "coupler_draft_max" not in truth:
        raise NotAvailable(NO_COUPLER)
    columns = {
        "draft": np.maximum(truth["coupler_draft_max"][:, 0], 0.0) / KILO,
        "buff": np.minimum(truth["coupler_buff_max"][:, 0], 0.0) / KILO,
    }
    if "coupler_samples" in truth:
        names = ("first_coupler", "middle_coupler", "last_coupler")
        columns |= dict(zip(names, truth["coupler_samples"].T / KILO, strict=True))
    return Curves(truth.time, columns)


def disturbance_curves(recording: rec.Recording) -> Curves:
    """Return estimate and truth of the disturbance [kN]."""
    estimate, truth = recording.of(rec.ESTIMATE, "force"), recording.topics.get(rec.DISTURBANCE)
    estimated = estimate is not None and bool(np.any(estimate[1]))
    if truth is None and not estimated:
        raise NotAvailable("the scenario has no disturbance and no observer estimated one")
    time = estimate[0] if estimate is not None else truth.time if truth is not None else np.empty(0)
    columns: dict[str, Array] = {}
    if estimate is not None and estimated:
        columns |= _per_unit("estimate", estimate[1] / KILO)
    if truth is not None:
        if truth["unit_force"].shape[1]:
            columns |= _per_unit("truth", aligned(time, truth.time, truth["unit_force"]) / KILO)
        if "total" in truth:
            columns["whole_truth"] = aligned(time, truth.time, truth["total"])[:, 0] / KILO
    return Curves(time, columns)


def delay_curves(recording: rec.Recording) -> Curves:
    """Return the delay from command to effect [s]: identified from the log, set in the scenario, assumed by the law."""
    if not recording.recorded("command"):
        raise NotAvailable("the command was not measured")
    columns = delays(recording, delay_jumps(recording))
    if not columns:
        raise NotAvailable("the log has no commands or no applied forces")
    return Curves(recording.topics[rec.COMMAND].time, columns)


def pipe_curves(recording: rec.Recording) -> Curves:
    """Return demand and actual value of the brake-pipe pressure at the head, and the value at the tail [kPa]."""
    demand, head = recording.of(rec.BRAKE_PIPE_COMMAND, "pressure"), recording.of(rec.BRAKE_PIPE, "pressure")
    tail = recording.of(rec.BRAKE_PIPE_TAIL, "pressure")
    if demand is None and head is None:
        raise NotAvailable(recording.without_brake)
    time = (head or demand or (np.empty(0), np.empty(0)))[0]
    columns = {
        name: aligned(time, *found)[:, 0] / KILO
        for name, found in (("pipe_demand", demand), ("pipe", head), ("pipe_tail", tail))
        if found is not None
    }
    if all(np.nanmax(row, initial=-np.inf) - np.nanmin(row, initial=np.inf) < 1.0 for row in columns.values()):
        raise NotAvailable(NEVER_APPLIED)
    return Curves(time, columns)


def shoe_curves(recording: rec.Recording) -> Curves:
    """Return the shoe force of the whole train [kN]."""
    found = recording.of(rec.BRAKE_SHOES, "total")
    if found is None:
        raise NotAvailable(recording.without_brake)
    if not np.any(found[1]):
        raise NotAvailable(NEVER_APPLIED)
    return Curves(found[0], {"shoe_force": found[1][:, 0] / KILO})


def energy_curves(recording: rec.Recording) -> Curves:
    """Return the work done on the train since the start [kWh]; the sum of all parts is the kinetic energy."""
    plant = recording.diagnostics.get("plant")
    if plant is not None:
        columns = {
            name: (-values if name == "regenerated" else values) / KWH  # positive in the diagnostics
            for name in ENERGIES
            if (values := plant.numbers(f"energy_{name}")) is not None and np.nanmax(np.abs(values)) > 0
        }
        if columns:
            return Curves(plant.time, columns)
    applied, moved = recording.of(rec.MEASUREMENT, "applied"), recording.of(rec.MEASUREMENT, "velocity")
    if applied is None or moved is None or applied[1].shape[1] != moved[1].shape[1] or applied[0].size < 2:
        raise NotAvailable("the log has neither the plant's diagnostics nor forces and speeds of the units")
    power = (applied[1] * moved[1]).sum(axis=1)
    steps = np.diff(applied[0], prepend=applied[0][0])
    work = {"traction": np.maximum(power, 0.0), "regenerated": np.minimum(power, 0.0)}
    return Curves(applied[0], {name: np.cumsum(values * steps) / KWH for name, values in work.items()})


def signal_curves(recording: rec.Recording) -> Curves:
    """Return the own numbers of ``on_tick`` or of the caller of :class:`train_ato.Env` by name."""
    series = recording.diagnostics.get(SIGNALS)
    columns = {} if series is None else {
        f"signal:{name}": values for name in series.values if (values := series.numbers(name)) is not None
    }  # fmt: skip
    if series is None or not columns:
        raise NotAvailable("the run has no own signals")
    return Curves(series.time, columns)


CURVES: dict[str, Callable[[rec.Recording], Curves]] = {
    "speed": speed_curves, "speed_error": speed_error_curves, "position_error": position_error_curves,
    "forces": force_curves, "unit_forces": unit_force_curves, "coupler_extremes": coupler_curves,
    "disturbance": disturbance_curves, "delay": delay_curves, "pipe": pipe_curves, "shoe_force": shoe_curves,
    "energy": energy_curves, "signals": signal_curves,
}  # fmt: skip
"""Figures of lines over time."""


def shown_curves(lines: Curves) -> Curves:
    """Return curves in the units of display."""
    units = {name: "km" if name == "position_km" else unit_in_figures(name) for name in lines.columns}
    return Curves(lines.time, {name: display_unit(units[name])[1] * values for name, values in lines.columns.items()})


def curves_of(
    recording: rec.Recording,
    names: Sequence[str] = tuple(CURVES),
    reduced: Callable[[Curves], Curves] = lambda lines: lines,
) -> tuple[dict[str, Curves], dict[str, str]]:
    """Return the curves of a run by figure, each ``reduced`` before the next, and reasons for figures without data."""
    found: dict[str, Curves] = {}
    missing: dict[str, str] = {}
    for name in names:
        try:
            found[name] = shown_curves(reduced(CURVES[name](recording)))
        except NotAvailable as reason:
            missing[name] = str(reason)
    return found, missing
