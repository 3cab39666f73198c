"""Parts of a run from a scenario and its files: train, line, nominal model, profile, law and supervisor."""

import math
import pickle
from collections import OrderedDict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line, split_name
from plant_sim.line import Line, line_for
from train_ato.control.air_brake.policy import BrakeSpec
from train_ato.control.algorithms.train_constants import dead_time
from train_ato.control.compensation.contract import check_compatible
from train_ato.control.contract import Law, RefusedParameter
from train_ato.control.learned_resistance import LearnedResistance, model_hash, read_learned
from train_ato.control.open_loop import actions_text, driver_reductions
from train_ato.control.registry import COMPENSATIONS, LAWS
from train_ato.control.train_model import LineForceTable, TrainModel
from train_ato.messages.topic import TrainLayout
from train_ato.messages.types import Array
from train_ato.profile.profile import Profile
from train_ato.scenario.profile_spec import ProfileSpec
from train_ato.scenario.scenario import Scenario
from train_ato.supervision.plant_line import line_supervision
from train_ato.supervision.supervisor import Supervisor

Part = TypeVar("Part")
SIZE = 32
"""Number of parts in a cache; the least recently used one is dropped."""


class PartCache:
    """Parts by the values that determine them.

    A part is shared between runs, so it must not be changed after its creation.
    """

    def __init__(self, size: int = SIZE) -> None:
        self._size = size
        self._parts: OrderedDict[bytes, object] = OrderedDict()

    def get(self, key: object, make: Callable[[], Part]) -> Part:
        """Return the part of a key; make it if the cache lacks it.

        Parameters
        ----------
        key
            Every value that determines the part, as a tuple of plain values and models.  Equal bytes of its pickle
            mean equal values, bit for bit; equal values with other bytes only cost a second creation.
        make
            Function that makes the part.
        """
        code = pickle.dumps(key)
        if code in self._parts:
            self._parts.move_to_end(code)
            return self._parts[code]  # type: ignore[return-value]  # the first entry of a key names its kind
        part = self._parts[code] = make()
        if len(self._parts) > self._size:
            self._parts.popitem(last=False)
        return part


def file_state(path: Path) -> tuple[int, int] | None:
    """Return time of the last change [ns] and size [bytes] of a file; None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def scenario_consist(named: str | Consist, folder: Path, parts: PartCache | None = None) -> Consist:
    """Return a consist of a scenario: defined there, or a file beside it, or a shipped one."""
    if isinstance(named, Consist):
        return named
    parts = parts or PartCache()
    return parts.get(("consist", data_key(named, folder)), lambda: load_consist(_beside(named, folder)))


def scenario_line(named: str | Line, folder: Path, parts: PartCache | None = None) -> Line:
    """Return a line of a scenario: defined there, or a file beside it, or a shipped one."""
    if isinstance(named, Line):
        return named
    parts = parts or PartCache()
    return parts.get(("line", data_key(named, folder)), lambda: load_line(_beside(named, folder)))


def data_key(named: str | Consist | Line, folder: Path) -> tuple[object, ...]:
    """Return the values that determine a consist or a line: its data, or its file with the state of the file."""
    if not isinstance(named, str):
        return (named,)
    path = _beside(named, folder)
    return path, file_state(Path(split_name(path)[0]))


def _beside(name: str, folder: Path) -> str:
    """Return the path of a file in the folder of the scenario, with the selection of a line, or the name itself."""
    stem, selection = split_name(name)
    path = folder / stem
    return f"{path}{selection}" if path.is_file() else name


def scenario_layout(scenario: Scenario, consist: Consist, line: Line) -> TrainLayout:
    """Return the parts of train and plant that determine the topics of a run and the sizes of their messages."""
    return TrainLayout(
        n_vehicles=len(consist.vehicles),
        n_units=len(consist.power_units),
        sensors=scenario.plant.sensors.couplers,
        air_brake=consist.air_brake is not None,
        disturbed=bool(scenario.plant.disturbances),
        supervised=_is_supervised(scenario, line),
        behind=scenario.leader is not None and bool(scenario.leader.train),
    )


def _is_supervised(scenario: Scenario, line: Line) -> bool:
    """Return the choice of the scenario, or True for a line with speed limits."""
    chosen = scenario.supervision.enabled
    return bool(line.speed_limits) if chosen is None else chosen


def nominal_model(
    scenario: Scenario, consist: Consist, line: Line, layout: TrainLayout, folder: Path, parts: PartCache | None = None
) -> TrainModel:
    """Return the nominal model of a scenario; without a block ``model`` it has the data of plant and links.

    ``parts`` has the tables of the line force of former models.
    """
    parts = parts or PartCache()
    block = scenario.model
    link = scenario.links.command
    delay, delay_brake = link.per_unit(layout.n_units, "links.command")
    if block.delay is not None:
        nominal = link.model_copy(update={"delay": block.delay, "delay_brake": block.delay_brake})
        delay, delay_brake = nominal.per_unit(layout.n_units, "model")
    own_line = line
    consist = consist if block.consist is None else scenario_consist(block.consist, folder, parts)
    if block.line is not None:
        line = line_for(scenario_line(block.line, folder, parts), consist.categories, consist.rating)
    named = (block.consist or scenario.plant.consist, block.line or scenario.plant.line)
    over_length = scenario.plant.grade_over_length
    key = ("line force", over_length, *(data_key(data, folder) for data in named))
    return TrainModel(
        consist,
        line,
        np.asarray(delay),
        np.asarray(delay_brake),
        float(np.max(scenario.plant.lag)) if block.lag is None else block.lag,
        scenario.tick,
        tuple(layout.sensors),
        over_length=over_length,
        reversing=scenario.plant.reversing,
        line_force=parts.get(key, lambda: LineForceTable(consist, line, over_length=over_length)),
        learned=_learned(block.learned, folder, own_line, consist, line, over_length=over_length),
    )


def _learned(
    named: str | LearnedResistance | None, folder: Path, line: Line, consist: Consist, nominal: Line,
    *, over_length: bool,
) -> LearnedResistance | None:  # fmt: skip
    """Return the learned resistance of a scenario for its line, nominal train and nominal line."""
    if named is None:
        return None
    file = _beside(named, folder) if isinstance(named, str) else ""
    try:
        found = read_learned(Path(file)) if isinstance(named, str) else named
        found.check_fits(line, consist, model_hash(consist, nominal, over_length=over_length))
    except ValueError as error:
        message = str(error).removeprefix(f"{file}: ")
        raise ValueError(f"model.learned: {file}{': ' if file else ''}{message}") from None
    return found


def scenario_profile(
    scenario: Scenario,
    consist: Consist,
    line: Line,
    tick_ns: int,
    folder: Path,
    parts: PartCache,
    ceiling: tuple[Array, Array] | None = None,
) -> Profile:
    """Return the profile of a scenario, from former runs if train, line, block ``profile`` and tick are equal.

    ``ceiling`` has places of the front [m] and speeds [m/s] of an additional speed limit of a plan.
    """
    spec, plant = scenario.profile, scenario.plant
    data = (data_key(plant.consist, folder), data_key(plant.line, folder))
    begun = (scenario.duration, plant.start.speed) if spec.driver is not None else (0.0, 0.0)
    key = ("profile", *profile_key(spec, folder), *data, tick_ns, scenario.brake.deepest, ceiling, begun)
    options: Any = {"folder": folder, "reduction": scenario.brake.deepest, "ceiling": ceiling, "begun": begun}
    return parts.get(key, lambda: spec.build(consist, line, tick_ns * 1e-9, **options))


OPEN_LOOP = "train_ato.control.open_loop:OpenLoopDriver"
"""Component of a driver's run in the place of a law."""


def with_driver(scenario: Scenario) -> Scenario:
    """Return the scenario of a driver's run with its notches and reductions in place of law and brake policy."""
    actions = scenario.profile.driver
    if actions is None or scenario.law == OPEN_LOOP:
        return scenario
    for key, given in (
        ("law", "law" in scenario.model_fields_set),
        ("law_changes", bool(scenario.law_changes)),
        ("observer", scenario.observer != "none"),
        ("compensation", scenario.compensation != "none"),
        ("replan", scenario.replan is not None),
        ("brake.policy", scenario.brake.policy != "none"),
    ):
        if given:
            raise ValueError(
                f"{key}: with profile.driver the run has no law, observer or compensation, and the brake of the "
                f"driver; remove {key}"
            )
    events = driver_reductions(actions)
    brake = {"brake": BrakeSpec(policy="planned", events=events)} if events else {}
    off = scenario.supervision.model_copy(update={"enabled": bool(scenario.supervision.enabled)})
    laws = {OPEN_LOOP: {"actions": actions_text(actions)}}
    return scenario.model_copy(update={"law": OPEN_LOOP, "laws": laws, "supervision": off, **brake})


def profile_key(spec: ProfileSpec, folder: Path) -> tuple[object, ...]:
    """Return the values that determine the data of a block ``profile``: its keys, and the state of its file."""
    return spec, folder, None if spec.file is None else file_state(spec.file_in(folder))


def with_departure(scenario: Scenario, model: TrainModel) -> Scenario:
    """Return the scenario with the departure of its plan, unless it defines one: when the first command takes effect.

    No law follows an earlier one: the train would have the speed error of the acceleration over delay and lag, which a
    slow loop carries to the first stop.
    """
    plan = scenario.profile.plan
    if plan is None or plan.departure is not None or plan.begin_speed > 0.0:
        return scenario
    if plan.points is not None and plan.points[0].departure is not None:
        return scenario
    departure = math.ceil(dead_time(model) / model.tick - 1e-9) * model.tick
    profile = scenario.profile.model_copy(update={"plan": plan.model_copy(update={"departure": departure})})
    return scenario.model_copy(update={"profile": profile})


def with_start(scenario: Scenario, position: float, speed: float = 0.0) -> Scenario:
    """Return the scenario with the train at the begin of the profile, unless it defines the start position.

    A profile that begins in motion by ``since`` gives the speed of its begin too.
    """
    start = scenario.plant.start
    if start.positions is not None or "position" in start.model_fields_set:
        return scenario
    update = {"position": position}
    if scenario.profile.since is not None and start.speeds is None and "speed" not in start.model_fields_set:
        update["speed"] = speed
    plant = scenario.plant.model_copy(update={"start": start.model_copy(update=update)})
    return scenario.model_copy(update={"plant": plant})


def fitting_law(name: str, values: Mapping[str, Any], model: TrainModel, period: float, compensation: str) -> Law:
    """Return a law that fits the train and the delay compensation.

    Parameters
    ----------
    name, values
        Name of the law, and its parameters that differ from the defaults.
    model
        Nominal model.
    period
        Period of the law [s].
    compensation
        Name of the delay compensation.
    """
    if not model.n_units:
        raise ValueError(f"law '{name}': no vehicle of the train has traction or brake; add an envelope")
    loaded, law_class = COMPENSATIONS.get(compensation), LAWS.get(name)
    try:
        law: Law = LAWS.make(name, values, model, period)
    except RefusedParameter as error:
        if getattr(loaded, "feedforward_only", False):  # the sensors would not make the law use it
            raise error.with_remedy_only() from None
        raise
    except ValueError as error:
        try:
            check_compatible(name, law_class, compensation, loaded)
        except ValueError as second:
            raise ValueError(f"{error}; also {second}") from None
        raise
    check_compatible(name, law, compensation, loaded)
    return law


def line_supervisor(scenario: Scenario, consist: Consist, line: Line, profile: Profile, reaction: float) -> Supervisor:
    """Return the supervisor of a train on its line, up to the stop at the end of the profile.

    Parameters
    ----------
    scenario, consist, line, profile
        Scenario with the train and the line of its plant, and its profile.
    reaction
        Largest time from a motion of the train to the demand at its brakes [s].
    """
    spec = scenario.supervision
    front = consist.vehicles[0].length / 2.0
    stop = float(profile.position[-1]) + front if profile.velocity[-1] == 0.0 else None
    try:
        track = line_supervision(
            consist, line, scenario.plant, None if stop is None else stop + spec.overlap,
            kdry=spec.kdry, reaction=reaction, service_brake=spec.service_brake, service_curve=spec.service_curve,
        )  # fmt: skip
    except ValueError as error:
        raise ValueError(f"supervision: {error}; or set supervision.enabled: false") from None
    return Supervisor(track, spec)
