"""Supervision of a train of the plant on a line: grades and speed limits of the line, brakes of the train."""

from dataclasses import replace

from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.plant_setup import PlantSetup, SpeedAdhesion
from plant_sim.section_effects import with_adhesion_of
from plant_sim.units import KMH
from train_ato.supervision.limits import BrakingTarget
from train_ato.supervision.plant_brake import plant_train
from train_ato.supervision.track_supervision import TrackSupervision
from train_ato.supervision.train_model import BuildUpTime, SupervisedTrain

DEFAULT_MAX_SPEED = 80.0 / KMH
"""Maximum speed of a train on a line without speed limits [m/s]."""


def grades_permille(line: Line) -> list[tuple[float, float]]:
    """Return start [m] and grade [‰] of the pieces of a line; beyond its end it is level."""
    pieces = [(entry.at, 1e3 * entry.grade) for entry in line.rounded_grades if entry.at < line.end]
    return [*pieces, (line.end, 0.0)]


def highest_limit(line: Line) -> float:
    """Return the highest speed limit of a line [m/s]; the default without limits."""
    return max((entry.speed for entry in line.speed_limits), default=DEFAULT_MAX_SPEED)


def line_supervision(
    consist: Consist,
    line: Line,
    setup: PlantSetup,
    target: float | None,
    *,
    max_speed: float | None = None,
    kdry: float = 1.0,
    reaction: float = 0.0,
    service_brake: bool = False,
    service_curve: bool = True,
) -> TrackSupervision:
    """Return the supervision of a train up to an end of authority on a line.

    Parameters
    ----------
    consist, line, setup
        Train, line, and plant with its actuators.
    target
        End of authority, which is also the supervised location [m]; None: the speed limits alone.
    max_speed
        Maximum speed of the train [m/s]; default: the highest limit of the line.
    kdry
        Rolling-stock correction factor of the emergency brake.
    reaction
        Largest time from a motion of the train to the demand at its brakes [s].
    service_brake
        True if the supervisor commands the service brake.
    service_curve
        True to supervise the end of authority with the service-brake curve too.

    Raises
    ------
    ValueError
        If the train has no brake, or it is weaker than a gradient.
    """
    setup = _with_lowest_adhesion(line, setup)
    train = plant_train(consist, setup, highest_limit(line) if max_speed is None else max_speed, kdry)
    train = replace(_with_reaction(train, reaction), service_command=service_brake)
    if not service_curve:
        train = replace(train, brake=replace(train.brake, service=None))
    limits = [(entry.at, entry.speed) for entry in line.restricted_limits]
    end = None if target is None else BrakingTarget(target, kind="EOA")
    return TrackSupervision(train, grades_permille(line), limits, end)


def _with_lowest_adhesion(line: Line, setup: PlantSetup) -> PlantSetup:
    """Return the setup with the lowest adhesion of the line, which the braking curves then have everywhere."""
    adhesion = with_adhesion_of(line, setup).adhesion
    if adhesion is None:
        return setup
    lowest = min((1.0, *(entry.factor for entry in line.adhesion)))
    key = "factor" if isinstance(adhesion, SpeedAdhesion) else "coefficient"
    lower = adhesion.model_copy(update={key: lowest * getattr(adhesion, key)})
    return setup.model_copy(update={"adhesion": lower})


def _with_reaction(train: SupervisedTrain, reaction: float) -> SupervisedTrain:
    """Return the train data with a reaction time [s] in every time of brakes and traction."""

    def later(time: BuildUpTime) -> BuildUpTime:
        return BuildUpTime(time.to_standstill + reaction, time.to_speed + reaction)

    brake = train.brake
    slower = replace(brake, emergency_time=later(brake.emergency_time), service_time=later(brake.service_time))
    return replace(train, brake=slower, t_traction_cut_off=train.t_traction_cut_off + reaction)
