"""Law and supervisor of a run, with one-line refusals of combinations that do not fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.control.compensation.compatibility import check_compatible
from train_ato.control.contract import Law
from train_ato.control.parameters import RefusedParameter
from train_ato.control.registry import COMPENSATIONS, LAWS
from train_ato.control.train_model import TrainModel
from train_ato.profile.profile import Profile
from train_ato.scenario.scenario import Scenario
from train_ato.supervision.plant_line import line_supervision
from train_ato.supervision.supervisor import Supervisor

__all__ = ["fitting_law", "line_supervisor"]


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

    Raises
    ------
    ValueError
        For an unknown name or parameter, or a train or compensation that does not fit the law.
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

    Raises
    ------
    ValueError
        If the emergency brake is weaker than a grade before a target.
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
