"""Arrays of the kernel from the data models."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plant_sim import kernel as k
from plant_sim.consist import Consist, EnvelopeSegment, VehicleType
from plant_sim.disturbances import UnmodelledGrade
from plant_sim.elementary import exp_each
from plant_sim.gears import ClipGear, DraftGear, GearTable, LinearGear, RigidGear, SmoothedGear, TableGear
from plant_sim.line import Line
from plant_sim.plant_setup import PlantSetup, SpeedAdhesion
from plant_sim.states import Array
from plant_sim.track import Track

Integers = NDArray[np.int64]
NO_LIMIT = 1e30
"""Finite value for 'no limit' of force, rate and speed, far beyond any train."""


PAGE = 4096
PLACES = (0, 768, 2560)
"""Distance of state, draft gears and vehicles from the begin of a page [bytes]. At some distances a load waits for a
store with the same last 12 bits of its address: 6.3 instead of 5.5 ns per vehicle-step at (0, 0, 0), 106 vehicles."""


@dataclass(slots=True)
class Arrays:
    """Arrays of :func:`plant_sim.kernel.advance`; the names of the rows are in that module."""

    vehicle: Array
    state: Array
    vehicle_index: Integers
    gear: Array
    table: Array
    run: Integers
    body: Integers
    unit: Array
    unit_index: Integers
    envelope: Array
    piece: Array
    setting: Array


def _gear_column(gear: DraftGear, column: Array, tables: list[GearTable]) -> int:
    """Fill one column of the gear array; return the kind of the gear."""
    if isinstance(gear, RigidGear):
        return k.RIGID
    column[k.HALF_SLACK] = gear.slack / 2
    column[k.DAMPING] = gear.damping
    if isinstance(gear, LinearGear):
        column[k.STIFFNESS] = gear.stiffness
        return k.LINEAR
    column[k.STOP] = gear.stop_stiffness
    if isinstance(gear, TableGear):
        column[k.STIFFNESS], column[k.TRANSITION_DAMPING] = gear.transition_stiffness, gear.transition_damping
        for table, stroke, of in zip((k.TABLE, k.BUFF_TABLE), (k.STROKE, k.BUFF_STROKE), gear.tables, strict=True):
            column[stroke], column[table] = of.deflection[-1], tables.index(of)
        return k.TABULATED
    column[k.F0], column[k.X0], column[k.A1] = gear.preload, gear.preload_length, gear.stiffness
    column[k.A2], column[k.RATIO], column[k.STROKE] = gear.second_order, gear.unloading_ratio, gear.stroke
    if isinstance(gear, SmoothedGear):
        column[k.INVERSE_VE] = 1.0 / gear.switching_speed
        return k.SMOOTHED
    assert isinstance(gear, ClipGear)
    column[k.STIFFNESS], column[k.TRANSITION_DAMPING] = gear.transition_stiffness, gear.transition_damping
    return k.CLIP


def actual_gears(consist: Consist, setup: PlantSetup) -> tuple[DraftGear, ...]:
    """Return the draft gears of the plant: those of the consist, or their replacements by the mismatch.

    Raises
    ------
    ValueError
        If the mismatch names a draft gear that the consist does not have.
    """
    override = setup.mismatch.gears
    for name, other in override.items():
        for needed in (name, other if isinstance(other, str) else name):
            if needed not in consist.draft_gears:
                raise ValueError(
                    f"mismatch.gears: draft gear '{needed}' is not in the consist; it has "
                    f"{', '.join(sorted(consist.draft_gears))}"
                )
    chosen: list[DraftGear] = []
    for name in consist.gear_names:
        other = override.get(name, name)
        chosen.append(consist.draft_gears[other] if isinstance(other, str) else other)
    return tuple(chosen)


def whole_lines(columns: int) -> int:
    """Return the next multiple of 8 columns, with which every row begins at a cache line.

    4.6 instead of 5.0 ns per vehicle-step with an applied air brake, 3.6 instead of 3.7 released, in a batch of 106
    vehicles (``python bench/kernel.py``).
    """
    return -(-columns // 8) * 8


def pack_gears(gears: Sequence[DraftGear], vehicles: int) -> tuple[Array, Array, Integers, Integers]:
    """Return gear columns, tables, runs of equal kinds and first vehicles of the rigid bodies.

    Parameters
    ----------
    gears
        Draft gears, front first.
    vehicles
        Number of vehicles.
    """
    tables = list(dict.fromkeys(table for gear in gears if isinstance(gear, TableGear) for table in gear.tables))
    gear_array = np.zeros((k.GEAR_ROWS, whole_lines(max(vehicles - 1, 1))))
    gear_array[k.X0] = 1.0
    kinds = [_gear_column(gear, gear_array[:, i], tables) for i, gear in enumerate(gears)]
    points = max((len(table.deflection) for table in tables), default=2)
    table_array = np.zeros((max(len(tables), 1), 3, points))
    for j, table in enumerate(tables):
        for row, values in enumerate((table.deflection, table.loading, table.unloading)):
            table_array[j, row, : len(values)] = values
            table_array[j, row, len(values) :] = values[-1]
    run: list[tuple[int, int, int, int]] = []
    for i, kind in enumerate(kinds):
        if run and run[-1][2] == kind:
            first, _, _, equal = run[-1]
            run[-1] = (first, i + 1, kind, int(equal and gears[i] == gears[first]))
        else:
            run.append((i, i + 1, kind, 1))
    body = [0, *(i + 1 for i, kind in enumerate(kinds) if kind != k.RIGID), vehicles]
    runs = np.array(run, dtype=np.int64).reshape(-1, 4)
    return gear_array, table_array, runs, np.array(body, dtype=np.int64)


def _pack_vehicles(vehicles: Sequence[VehicleType], consist: Consist, setup: PlantSetup) -> Array:
    mismatch = setup.mismatch
    array = np.zeros((k.VEHICLE_ROWS, len(vehicles)))
    for i, vehicle in enumerate(vehicles):
        mass = vehicle.mass * mismatch.mass_scale
        array[k.MASS, i] = mass * vehicle.rotating_mass_factor
        array[k.WEIGHT, i] = mass * consist.gravity
        polynomial = vehicle.resistance.polynomial(mass, consist.gravity)
        array[[k.C0, k.C1, k.C2], i] = np.array(polynomial) * mismatch.resistance_scale
    array[k.SHOE] = np.array(consist.friction_forces) * mismatch.brake_scale
    array[k.INVERSE_MASS] = 1.0 / array[k.MASS]
    array[k.HOLD_CAPACITY] = setup.holding_brake_ratio * array[k.WEIGHT]
    array[k.GAP, :-1] = np.diff(consist.offsets)
    array[k.PIPE_DISTANCE] = pipe_distances(consist)
    array[k.RAIL] = _adhesion(setup)
    return array


def pipe_distances(consist: Consist) -> Array:
    """Return the distance of every vehicle from the nearest power unit [m], shape (n,).

    The brake pipe is vented and fed at the power units; without one, at vehicle 0.
    """
    offsets = np.array(consist.offsets)
    sources = offsets[list(consist.power_units or (0,))]
    return np.asarray(np.abs(offsets[:, None] - sources[None, :]).min(axis=1))


def _segments(segments: Sequence[EnvelopeSegment], scale: float) -> list[tuple[float, float, float, float]]:
    return [
        (end, force * scale, slope * scale, power * scale) for end, force, slope, power in (s.row for s in segments)
    ]


def _pack_units(consist: Consist, setup: PlantSetup, step: float) -> tuple[Array, Integers, Array]:
    """Return unit constants and states, unit pointers and rows of the envelopes."""
    numbers, vehicles = consist.power_units, consist.vehicles
    unit = np.zeros((k.UNIT_ROWS, len(numbers)))
    index = np.zeros((k.UNIT_INDEX_ROWS, len(numbers)), dtype=np.int64)
    rows: list[tuple[float, float, float, float]] = []
    mismatch = setup.mismatch
    for u, i in enumerate(numbers):
        index[k.UNIT_VEHICLE, u] = i
        for first, end, segments, scale in (
            (k.TRACTION_FIRST, k.TRACTION_END, vehicles[i].traction, mismatch.traction_scale),
            (k.BRAKE_FIRST, k.BRAKE_END, vehicles[i].brake, mismatch.electric_brake_scale),
        ):
            index[first, u] = len(rows)
            rows += [(NO_LIMIT, NO_LIMIT, 0.0, 0.0)] if setup.ideal_actuator else _segments(segments, scale)
            index[end, u] = len(rows)
        index[k.ELECTRIC_FIRST, u] = len(rows)
        rows += _segments(vehicles[i].electric_brake, mismatch.electric_brake_scale)
        index[k.ELECTRIC_END, u] = len(rows)
    masses = np.array([vehicles[i].mass for i in numbers])
    adhesive = np.array([vehicles[i].adhesive_mass or vehicles[i].mass for i in numbers])
    unit[k.GAIN] = mismatch.actuator_gain
    unit[k.DEAD_BAND] = setup.dead_band
    unit[k.RATE_STEP] = NO_LIMIT if setup.rate_limit is None else setup.rate_limit * step
    unit[k.FORCE_LIMIT] = NO_LIMIT
    if setup.force_limit is not None and len(numbers):
        unit[k.FORCE_LIMIT] = setup.force_limit * masses / masses.sum()
    unit[k.ADHESION_WEIGHT] = adhesive * consist.gravity * mismatch.mass_scale
    unit[k.ADHESION] = _adhesion(setup)
    unit[k.ADHESION_BY_SPEED] = float(isinstance(setup.adhesion, SpeedAdhesion))
    return unit, index, np.array(rows or [(0.0, 0.0, 0.0, 0.0)])


def _adhesion(setup: PlantSetup) -> float:
    """Return the adhesion coefficient, or the factor on a coefficient that depends on the speed."""
    if setup.adhesion is None:
        return NO_LIMIT
    return setup.adhesion.factor if isinstance(setup.adhesion, SpeedAdhesion) else setup.adhesion.coefficient


def lag_decay(lags: Array, step: float) -> Array:
    """Return the part of a deviation that first-order lags [s] leave after one step [s]; 0 for a lag of 0."""
    with np.errstate(divide="ignore"):
        left: Array = exp_each(-step / lags)
    return left


def _pack_pieces(consist: Consist, line: Line, setup: PlantSetup) -> tuple[Array, Integers]:
    """Return the table of pieces and the initial pointer of every vehicle into it."""
    extra = [p for d in setup.disturbances if isinstance(d, UnmodelledGrade) for p in d.pieces]
    track = Track(line, extra)
    if not setup.grade_over_length:
        return track.at_points(), np.zeros(len(consist.vehicles), dtype=np.int64)
    lengths = [vehicle.length for vehicle in consist.vehicles]
    tables, first, begin = [], {}, 0
    for length in sorted(set(lengths)):
        tables.append(track.over_length(length))
        first[length] = begin
        begin += tables[-1].shape[1]
    return np.concatenate(tables, axis=1), np.array([first[length] for length in lengths], dtype=np.int64)


def _initial_state(consist: Consist, setup: PlantSetup) -> Array:
    n = len(consist.vehicles)
    state = np.zeros((k.STATE_ROWS, whole_lines(n + 1)))
    state[[k.RESERVOIR, k.SUPPLY]] = 1.0
    state[k.X, :n] = setup.start.position - np.array(consist.offsets)
    state[k.V, :n] = setup.start.speed
    for row, values, key in ((k.X, setup.start.positions, "positions"), (k.V, setup.start.speeds, "speeds")):
        if values is not None:
            if len(values) != n:
                raise ValueError(f"start.{key} has {len(values)} entries; give one for each of the {n} vehicles")
            state[row, :n] = values
    return state


def _settings(consist: Consist, setup: PlantSetup, step: float) -> Array:
    setting = np.zeros(k.SETTINGS)
    setting[k.REVERSING] = float(setup.reversing)
    setting[k.HOLD_SPEED] = setup.holding_speed
    setting[k.FULL_LEVEL] = 1.0
    setting[k.ADHESION_LIMITED] = float(setup.adhesion is not None)
    setting[k.RAIL_BY_SPEED] = float(isinstance(setup.adhesion, SpeedAdhesion))
    emergency, brake = consist.friction_emergency_brake, consist.air_brake
    if emergency is not None:
        setting[k.APPLY_DECAY] = math.exp(-step / emergency.time_constant)
        setting[k.RELEASE_DECAY] = math.exp(-step / emergency.release_time)
    if brake is not None:
        setting[k.APPLY_DECAY] = math.exp(-step / brake.apply_time)
        setting[k.RELEASE_DECAY] = math.exp(-step / brake.release_time)
        setting[k.RESERVOIR_USE] = brake.reservoir_use
        setting[k.RECHARGE] = 1.0 - math.exp(-step / brake.recharge_time)
        setting[k.FULL_LEVEL] = brake.braking_factor[-1]
    return setting


def _placed(arrays: Sequence[Array]) -> list[Array]:
    """Return copies of the arrays at :data:`PLACES` beyond pages of their own."""
    sizes = [-(-(array.nbytes + PAGE) // PAGE) * PAGE for array in arrays]
    memory = np.zeros(PAGE + int(np.sum(sizes)), dtype=np.uint8)
    begin, placed = -memory.ctypes.data % PAGE, []
    for array, size, place in zip(arrays, sizes, PLACES, strict=True):
        copy = memory[begin + place : begin + place + array.nbytes].view(np.float64).reshape(array.shape)
        copy[:] = array
        placed.append(copy)
        begin += size
    return placed


def pack(consist: Consist, line: Line, setup: PlantSetup, step: float) -> Arrays:
    """Return the arrays of the kernel for a plant step [s].

    Raises
    ------
    ValueError
        If the setup does not match the train (numbers of speeds or lags, names of draft gears).
    """
    vehicles = consist.vehicles
    n = len(vehicles)
    gear, table, run, body = pack_gears(actual_gears(consist, setup), n)
    unit, unit_index, envelope = _pack_units(consist, setup, step)
    lags = setup.lag if isinstance(setup.lag, tuple) else (setup.lag,) * unit.shape[1]
    if len(lags) != unit.shape[1]:
        raise ValueError(f"lag has {len(lags)} entries; give one, or one for each of the {unit.shape[1]} power units")
    unit[k.LAG_DECAY] = lag_decay(np.array(lags), step)
    piece, first = _pack_pieces(consist, line, setup)
    vehicle_index = np.zeros((k.VEHICLE_INDEX_ROWS, n), dtype=np.int64)
    vehicle_index[k.PIECE] = first
    vehicle = _pack_vehicles(vehicles, consist, setup)
    vehicle_index[k.ORDER] = np.argsort(vehicle[k.PIPE_DISTANCE], kind="stable")
    setting = _settings(consist, setup, step)
    state, gear, vehicle = _placed((_initial_state(consist, setup), gear, vehicle))
    arrays = Arrays(vehicle, state, vehicle_index, gear, table, run, body, unit, unit_index, envelope, piece, setting)
    k.locate(state, vehicle, vehicle_index, piece)
    return arrays
