"""Case file of braking curves (JSON): inputs, and the speeds of each curve.

A file holds one case (``inputs``, ``curves``) or several by name.

The keys are those of the published cases in ``test/data/etcs_braking_cases.json``.
"""

from itertools import pairwise
from math import isfinite, nan
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from plant_sim.data_text import parse_json
from plant_sim.input_error import build_model, kind_of
from plant_sim.si_model import SiModel
from plant_sim.units import KMH
from train_ato.supervision import train_model
from train_ato.supervision.limits import BrakingTarget, TargetLimits, release_speed, release_start, trip_location
from train_ato.supervision.odometry import MotionEstimate, odometer_error
from train_ato.supervision.settings import FixedValues
from train_ato.supervision.step_function import StepFunction, gradient_acceleration

MAX_STEPS = 100
"""Largest number of steps of a list; the standard has at most seven."""
REQUIRED = {
    "lambda": ("brake_percentage", "Kv_int", "Kr_int", "Kt_int"),
    "gamma": ("A_brake_emergency", "T_brake_emergency"),
}
"""Keys of ``inputs`` that a model needs; published files have them for the other model too, without effect."""
OPTIONAL = {
    "lambda": ("Kv_int_b", "A_P12", "A_P23"),
    "gamma": ("A_brake_service", "T_brake_service", "Kdry", "Kwet", "available_adhesion"),
}
"""Further keys of a model; the other model refuses them."""
SMALLEST, MAX_FACTOR, MAX_DECELERATION = 1e-6, 2.0, 5.0
"""Smallest factor and deceleration, largest factor, largest deceleration [m/s²]."""

Factor = Annotated[float, Field(ge=SMALLEST, le=MAX_FACTOR)]
Deceleration = Annotated[float, Field(ge=SMALLEST, le=MAX_DECELERATION)]
Pair = tuple[float, float]
Duration = Annotated[float, Field(ge=0, le=300)]


class CurveInputs(SiModel):
    """Block ``inputs`` of a case; speeds in km/h, lengths in m, times in s, gradients in ‰, > 0 uphill."""

    model: Literal["gamma", "lambda"]
    brake_position: train_model.BrakePosition
    length_m: float = Field(gt=0, le=1e5)
    max_speed_kmh: float = Field(gt=0, le=600)
    mrsp_kmh: float | None = Field(None, gt=0, le=600, description="speed limit before the target; default: max_speed")
    brake_percentage: float | None = Field(None, gt=0)
    service_brake_command: bool = False
    service_brake_feedback: bool = False
    traction_cutoff_command: bool = False
    t_traction_cutoff_s: Duration = 0.0
    m_rotating_nom_pct: float | None = Field(None, ge=0, le=100)
    antenna_to_front_m: float = Field(0.0, ge=0, le=1e3, description="of the trip at level 1; no limit uses it")
    gradients: tuple[Pair, ...] = Field((), max_length=10_000, description="start [m] and grade [‰]")
    target_location_m: float
    target_speed_kmh: float = Field(0.0, ge=0, le=600)
    target_type: Literal["MRSP", "LOA", "EOA"] = "MRSP"
    eoa_location_m: float | None = None
    A_est1: float = Field(0.0, ge=-5, le=5, description="estimated acceleration during the traction time")
    A_est2: float | None = Field(None, ge=-5, le=5, description="after it, used up to 0.4 m/s²; default: A_est1")
    speed_error_kmh: float = Field(0.0, ge=0, le=36, description="V_ura; 0: compensation inhibited")
    distance_since_balise_m: float | None = Field(
        None, ge=0, le=1e6, description="for the position error 5 m + 5 %; default: exact position"
    )
    release_computed_at_m: float | None = Field(
        None, description="front position at which the release speed of an EOA is computed, level 2; default: none is"
    )
    level: Literal[1, 2] = 2
    Kv_int: Factor | tuple[Pair, ...] | None = None
    Kv_int_b: Factor | tuple[Pair, ...] | None = Field(None, description="passenger subset b of Kv_int")
    A_P12: float | None = Field(None, ge=0, le=5)
    A_P23: float | None = Field(None, ge=0, le=5)
    Kr_int: Factor | tuple[Pair, ...] | None = None
    Kt_int: float | None = Field(None, ge=0, le=2, description="0 is permitted: A.3.12.1.4")
    Kdry: Factor | tuple[Pair, ...] | None = None
    Kwet: Factor | tuple[Pair, ...] | None = None
    available_adhesion: float | None = Field(None, ge=0, le=1, description="M_NVAVADH, 0 wet ... 1 dry")
    M_rotating_max: float = Field(15.0, ge=0, le=100)
    M_rotating_min: float = Field(2.0, ge=0, le=100)
    T_warning: Duration = 2.0
    T_driver: Duration = 4.0
    indication_driver_time_twice: bool = False
    A_brake_emergency: Deceleration | tuple[Pair, ...] | None = None
    A_brake_service: Deceleration | tuple[Pair, ...] | None = None
    T_brake_emergency: Duration | None = None
    T_brake_service: Duration | None = None

    @model_validator(mode="after")
    def _complete(self) -> "CurveInputs":
        if any(b[0] <= a[0] for a, b in pairwise(self.gradients)):
            raise ValueError("gradients: starts must rise; list them by rising start")
        if any(abs(grade) > 500 for _, grade in self.gradients):
            raise ValueError("gradients: a grade is above 500 ‰; give [start in m, grade in ‰]")
        self._check_steps()
        self._check_keys()
        if self.target_type == "EOA" and self.target_speed_kmh:
            raise ValueError("target_speed_kmh: an end of authority has the target speed 0; write 0 or another type")
        if self.target_type != "EOA" and self.release_computed_at_m is not None:
            raise ValueError("release_computed_at_m: only an end of authority has a release speed; write EOA")
        if self.level == 1 and self.release_computed_at_m is not None:
            raise ValueError(
                "release_computed_at_m: the delay of the trip at level 1 (T41) is not covered; write level 2"
            )
        if self.target_speed_kmh > self.max_speed_kmh:
            raise ValueError("target_speed_kmh: above max_speed_kmh; lower it")
        if self.eoa_location_m is not None and self.eoa_location_m > self.target_location_m:
            raise ValueError("eoa_location_m: beyond the supervised location target_location_m; correct one of them")
        return self

    def _check_keys(self) -> None:
        """Raise ValueError for a missing key of the model, a key of the other model, or an incomplete ``Kv_int_b``."""
        for key in REQUIRED[self.model]:
            if getattr(self, key) is None:
                raise ValueError(f"key {key} is missing, a {self.model} train needs it; add it")
        other = "gamma" if self.model == "lambda" else "lambda"
        for key in OPTIONAL[other]:
            if getattr(self, key) is not None:
                raise ValueError(f"key {key} belongs to a {other} train; remove it, or write the model {other}")
        if self.Kv_int_b is None:
            if self.A_P12 is not None or self.A_P23 is not None:
                raise ValueError("pivots A_P12 and A_P23 belong to Kv_int_b, which is missing; add it, or remove them")
        elif self.brake_position != "PassengerTrainInP":
            raise ValueError("key Kv_int_b belongs to a passenger train in P; remove it")
        elif not (self.A_P12 or 0.0) < (self.A_P23 or 0.0):
            raise ValueError("pivots of Kv_int_b: A_P12 must be below A_P23; give both")

    def _check_steps(self) -> None:
        """Raise ValueError for a list of steps that is empty, does not rise, or has a value out of range."""
        for key in ("Kv_int", "Kv_int_b", "Kr_int", "Kdry", "Kwet", "A_brake_emergency", "A_brake_service"):
            steps = getattr(self, key)
            if not isinstance(steps, tuple):
                continue
            if not 1 <= len(steps) <= MAX_STEPS or steps[0][0] != 0 or any(b[0] <= a[0] for a, b in pairwise(steps)):
                raise ValueError(f"steps of {key}: give [start, value] by rising start, the first from 0")
            most = MAX_DECELERATION if key.startswith("A_") else MAX_FACTOR
            if any(not SMALLEST <= value <= most for _, value in steps):
                raise ValueError(f"steps of {key}: a value is outside {SMALLEST:g} ... {most:g}; correct it")

    def fixed_values(self) -> FixedValues:
        """Return the fixed values of the case."""
        return FixedValues(
            self.T_warning, self.T_driver, self.M_rotating_max, self.M_rotating_min, self.indication_driver_time_twice
        )

    def train(self) -> train_model.SupervisedTrain:
        """Return the train data."""
        return train_model.SupervisedTrain(
            length=self.length_m,
            max_speed=self.max_speed_kmh / KMH,
            brake=self._lambda() if self.model == "lambda" else self._gamma(),
            m_rotating_nom=self.m_rotating_nom_pct,
            service_command=self.service_brake_command,
            service_feedback=self.service_brake_feedback,
            traction_command=self.traction_cutoff_command,
            t_traction_cut_off=self.t_traction_cutoff_s,
        )

    def _lambda(self) -> train_model.BrakeModel:
        assert self.brake_percentage is not None
        max_speed = self.max_speed_kmh / KMH
        train_model.check_conversion(self.brake_percentage, self.brake_position, self.length_m, max_speed)
        kv_int = _over_speed(self.Kv_int, 1.0)
        if self.Kv_int_b is not None:
            largest = train_model.basic_deceleration(self.brake_percentage).largest_up_to(max_speed)
            upper = _over_speed(self.Kv_int_b, 1.0)
            kv_int = train_model.passenger_kv_int(kv_int, upper, self.A_P12 or 0.0, self.A_P23 or 0.0, largest)
        return train_model.lambda_brake(
            self.brake_percentage,
            self.brake_position,
            self.length_m,
            max_speed,
            kv_int=kv_int,
            kr_int=_steps_of(self.Kr_int, 1.0),
            kt_int=1.0 if self.Kt_int is None else self.Kt_int,
        )

    def _gamma(self) -> train_model.BrakeModel:
        assert self.T_brake_emergency is not None
        return train_model.gamma_brake(
            _over_speed(self.A_brake_emergency, 0.0),
            self.T_brake_emergency,
            None if self.A_brake_service is None else _over_speed(self.A_brake_service, 0.0),
            self.T_brake_emergency if self.T_brake_service is None else self.T_brake_service,
            kdry=_over_speed(self.Kdry, 1.0),
            kwet=_over_speed(self.Kwet, 1.0),
            adhesion=1.0 if self.available_adhesion is None else self.available_adhesion,
        )

    def motion(self) -> MotionEstimate:
        """Return the motion estimate of the case."""
        distance = self.distance_since_balise_m
        error = 0.0 if distance is None else odometer_error(distance)
        later = nan if self.A_est2 is None else self.A_est2
        return MotionEstimate(self.A_est1, self.speed_error_kmh / KMH, error, error, later)

    def release(self, limits: TargetLimits) -> dict[str, float] | None:
        """Return the release speed [km/h] and its begin before the target [m]; None if the case has none."""
        front = self.release_computed_at_m
        if front is None:
            return None
        motion = self.motion()
        reference = front - (self.distance_since_balise_m or 0.0)
        trip = trip_location(limits.target.eoa, reference, motion)
        speed = release_speed(limits, trip, motion.speed_error)
        begin = release_start(limits, speed, motion)
        return {"speed_kmh": speed * KMH, "begin_m": limits.target.location - begin}

    def limits(self) -> TargetLimits:
        """Return the supervision limits of the target."""
        train, fixed = self.train(), self.fixed_values()
        target = BrakingTarget(
            self.target_location_m, self.target_speed_kmh / KMH, self.target_type, self.eoa_location_m
        )
        gradient = gradient_acceleration(self.gradients, train.length, train.m_rotating_nom, fixed)
        return TargetLimits(train, target, gradient, fixed, None if self.mrsp_kmh is None else self.mrsp_kmh / KMH)


def _steps_of(given: float | tuple[Pair, ...] | None, default: float) -> StepFunction:
    """Return the step function of a value or of [start, value] pairs."""
    if isinstance(given, tuple):
        return StepFunction.from_starts(given)
    return StepFunction.constant(default if given is None else given)


def _over_speed(given: float | tuple[Pair, ...] | None, default: float) -> StepFunction:
    """Return the step function over the speed [m/s] of a value or of pairs with starts in km/h."""
    steps = _steps_of(given, default)
    return StepFunction(tuple(bound / KMH for bound in steps.bounds), steps.values)


MAX_FILE_SIZE = 16 * 2**20
"""Largest case file [bytes]."""
CURVE_NAMES = ("EBD", "SBD", "EBI", "SBI1", "SBI2", "SBI", "Warning", "Permitted", "Indication")
"""Names of the curves of a case, from the target backwards."""
MAX_ROW_SPEED = 600.0
"""Largest speed of a curve [km/h]."""


def _row(value: Any) -> tuple[float, float | None]:
    """Return speed [km/h] and distance [m] or None of a row.

    Raises
    ------
    ValueError
        If the row is neither a speed nor a pair of finite numbers.
    """
    entries = list(value) if isinstance(value, (list, tuple)) and len(value) == 2 else [value]
    if any(isinstance(entry, bool) or not isinstance(entry, (int, float)) or not isfinite(entry) for entry in entries):
        raise ValueError(f"row {str(value)[:60]} is no speed in km/h and no [speed, distance]; give finite numbers")
    if not 0 <= entries[0] <= MAX_ROW_SPEED:
        raise ValueError(f"row {str(value)[:60]} has a speed out of range; give 0 to {MAX_ROW_SPEED:g} km/h")
    return float(entries[0]), float(entries[1]) if len(entries) == 2 else None


Row = Annotated[tuple[float, float | None], BeforeValidator(_row)]


class CurveCase(SiModel):
    """One case: inputs, and for each curve its speeds [km/h], or pairs of speed and distance for a comparison."""

    inputs: CurveInputs
    curves: dict[str, tuple[Row, ...]] = Field(min_length=1)

    @model_validator(mode="after")
    def _known_curves(self) -> "CurveCase":
        for name in self.curves:
            if name not in CURVE_NAMES:
                raise ValueError(f"curves: '{name}' is none of {', '.join(CURVE_NAMES)}; correct it")
        return self

    def speeds(self, name: str) -> list[float]:
        """Return the speeds of a curve [km/h]."""
        return [speed for speed, _ in self.curves[name]]

    @property
    def has_distances(self) -> bool:
        """True if a curve of the file has a distance."""
        return any(distance is not None for rows in self.curves.values() for _, distance in rows)

    def distances(self, name: str) -> list[float | None]:
        """Return the distances of a curve in the file [m]; None for a speed without one."""
        return [distance for _, distance in self.curves[name]]


def read_cases(path: Path) -> tuple[dict[str, CurveCase], bool]:
    """Return the cases of a file."""
    data = _read_json(path)
    if "inputs" in data or "curves" in data:
        return {path.stem: build_model(CurveCase, data, str(path))}, True
    if not data:
        raise ValueError(f"{path}: no case; give 'inputs' and 'curves', or cases by name")
    return {name: build_model(CurveCase, case, f"{path}: {name}") for name, case in data.items()}, False


def _read_json(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MAX_FILE_SIZE:
            raise ValueError(f"larger than {MAX_FILE_SIZE} bytes")
        data = parse_json(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}; name a JSON file of cases") from None
    except ValueError as error:
        raise ValueError(f"{path}: not valid JSON: {' '.join(str(error).split())[:200]}; correct it") from None
    if not isinstance(data, dict):
        raise ValueError(f"{path}: holds {kind_of(data)} in place of cases; give 'inputs' and 'curves'")
    return data
