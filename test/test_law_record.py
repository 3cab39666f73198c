"""Laws and observers over records: one function for Python and compiled loop, checked by mypy, in the loop at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from law_trains import FIVE, SINGLE, inputs, measured, model
from mypy import api
from span_runs import Both, compiled_part, messages_of, setup_of

from plant_sim.compiled import compiled
from plant_sim.record import Records, dtype_of, quantity, zeros
from train_ato.control.contract import NoParameters, parameter
from train_ato.control.guard import GIVEN, limit_demands
from train_ato.control.law import STEPPED, LawForm, LawNow, LawUnit, RecordLaw
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.observers.force_balance import BalanceConstants, ForceBalance
from train_ato.control.observers.record_observer import Body, ObserverForm, RecordObserver
from train_ato.control.registry import LAWS, OBSERVERS
from train_ato.loop import span_kernel as kernel
from train_ato.messages.types import Array


@dataclass(frozen=True)
class LeanParameters:
    """Parameters of :class:`Lean`."""

    gain: float = parameter(0.05, "1/s", 0.0, 10.0, "gain on the speed error")


@dataclass
class LeanUnit:
    """State of :func:`lean` for one unit."""

    mass: float = quantity("kg", "share of the inertia")
    steps: int = quantity("1", "number of steps")
    errors: Array = quantity("m/s", "last errors", 2)
    known: bool = quantity("", "the errors are known")


@compiled
def lean(p: LeanParameters, state: Records[LeanUnit], now: LawNow, units: Records[LawUnit]) -> None:
    """Compute a feed-forward with a gain on the mean of two speed errors [N]."""
    for u in range(units.size):
        x, own = units[u], state[u]
        own.errors[own.steps % 2] = x.velocity - x.reference_velocity
        own.steps, own.known = own.steps + 1, True
        x.wanted = x.feedforward - own.mass * p.gain * (own.errors[0] + own.errors[1]) / 2.0


@compiled
def curious(p: LeanParameters, state: Records[LeanUnit], now: LawNow, units: Records[LawUnit]) -> None:
    """Compute a gain on the speed error and parts of the inputs that few laws use [N]."""
    for u in range(units.size):
        x = units[u]
        known = x.feedforward + 0.1 * x.shoe_force + 0.01 * (now.train_shoe_force + now.line_force)
        ahead = now.acceleration_at_effect + 0.1 * now.jerk_at_effect + 0.01 * now.delay_to_effect
        x.wanted = known + state[u].mass * (0.01 * ahead - p.gain * (x.velocity - x.reference_velocity))


class Curious(RecordLaw):
    """Law of a user without a declaration of its inputs."""

    Parameters = LeanParameters
    form = LawForm(curious, LeanParameters, LeanUnit)

    def __init__(self, parameters, model, period):
        super().__init__(parameters, model, period)
        self.state["mass"] = model.inertia * model.share
        self.set_constants()


class Lean(Curious):
    """Law of a user that declares the inputs that it does not use."""

    form = LawForm(lean, LeanParameters, LeanUnit)
    uses_effect = uses_train_forces = False


def test_a_law_of_a_user_is_in_the_compiled_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the loop is compiled again for a law, leaves it to Python, or gives it other bits than Python."""
    monkeypatch.setitem(LAWS._loaded, "lean", Lean)
    changes = {"supervision.enabled": False, "law": "lean", "compensation": "preview", "duration": 40}
    setup = setup_of("crh380a_gpc:short", changes)
    assert compiled_part(setup_of("crh380a_gpc:short", {**changes, "law": "pid"})) > 0.8
    before = len(getattr(kernel.run_span, "signatures", []))  # missing with NUMBA_DISABLE_JIT
    Both(setup).assert_equal(least=0.8)
    assert len(getattr(kernel.run_span, "signatures", [])) == before


def test_every_input_is_the_same_in_the_compiled_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the loop leaves out an input of a law that declares nothing: shoes, line force, delay to the effect."""
    monkeypatch.setitem(LAWS._loaded, "curious", Curious)
    brake = {"policy": "planned", "events": [{"time": 10, "reduction": 5e4}, {"time": 25, "reduction": 0}]}
    changes = {"supervision.enabled": False, "law": "curious", "compensation": "preview", "tick": 0.05}
    setup = setup_of("daqin_heavy_haul", {**changes, "duration": 30, "brake": brake})
    assert setup.model.delay.min() > 0.0
    Both(setup).assert_equal(least=0.8)


@dataclass(frozen=True)
class HeldConstants(BalanceConstants):
    """Constants of :func:`held`: those of the balance and a part."""

    part: float = quantity("1", "part of the unexplained acceleration")


@compiled
def held(p: HeldConstants, own: Body, position: float, speed: float, driven: float, resistance: float) -> float:
    """Return a part of the acceleration that the model does not explain [m/s²]."""
    return p.part * ((speed - own.speed) / p.period - driven + own.resistance) if own.known else 0.0


class Held(RecordObserver):
    """Observer of a user."""

    Parameters = NoParameters
    form = ObserverForm(held, HeldConstants, Body)

    def __init__(self, parameters, model, period):
        super().__init__(parameters, model, period, ForceBalance(model, "train", 0.0, period), part=0.05)


def test_an_observer_of_a_user_is_in_the_compiled_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if an observer over records is left to Python, or its estimates differ there in one bit."""
    monkeypatch.setitem(OBSERVERS._loaded, "held", Held)
    changes = {"supervision.enabled": False, "observer": "held", "laws.pid.disturbance": True, "duration": 20}
    both = Both(setup_of("xuzhou_metro", changes))
    both.assert_equal(least=0.8)
    assert both.python != messages_of(setup_of("xuzhou_metro", {**changes, "observer": "none"}), compiled=True)


def test_an_observer_repeats_its_estimate_for_invalid_inputs() -> None:
    """Breaks if the guard in the call of an observer lets a value through, or a difference bridges the sample."""
    of = model(SINGLE)
    observer = Held(NoParameters(), of, 0.1)
    seen = [ObserverInput.of(measured(of, k * 100_000_000, 0.0, 10.0 + 0.1 * k, 0.0)) for k in range(4)]
    estimates = [observer.step(each)[0] for each in seen[:2]]
    assert estimates[0] == 0.0 and estimates[1] > 0.04 * of.inertia
    for field in ("position", "velocity", "applied", "shoe_force"):
        assert observer.step(replace(seen[2], **{field: np.array([np.nan])}))[0] == estimates[1], field
    assert observer.step(replace(seen[2], train_shoe_force=np.inf))[0] == estimates[1]
    assert observer.step(replace(seen[2], coupler_force=np.array([np.nan])))[0] == estimates[1]
    assert observer.step(seen[3])[0] == 0.0, "the first sample after a gap has no difference"


def test_records_and_inputs_have_their_fields() -> None:
    """Breaks if a field is left out, has another type or place, or two inputs of one unit change places."""
    found = dtype_of(LeanUnit)
    assert found.names == ("mass", "steps", "errors", "known")
    assert [found[name].str for name in ("mass", "steps", "known")] == ["<f8", "<i8", "|b1"]
    assert found["errors"].shape == (2,) and zeros(LeanUnit, 3).dtype is found is dtype_of(LeanUnit)
    of = model(FIVE)
    law = Lean(LeanParameters(), of, 0.1)
    marked = {name: 100.0 * np.arange(1.0, 6.0) + number for number, name in enumerate(GIVEN, start=1)}
    marked["velocity"], marked["reference_velocity"] = np.arange(7.0, 12.0), np.arange(2.0, 7.0)
    marked["reference_acceleration"] = 0.1 * np.arange(1.0, 6.0)
    given = inputs(
        of, t=11.0, acceleration_at_effect=0.12, jerk_at_effect=0.13, delay_to_effect=0.14, train_shoe_force=15.0,
        coupler_force=np.array([16.0, -17.0]), **marked,
    )  # fmt: skip
    assert law.call(given) == STEPPED
    for name in GIVEN:
        assert law.units[name].tolist() == marked[name].tolist(), name
    assert law.now[0].item() == (11.0, 0.12, 0.13, 0.14, 0.0, 15.0, 33.0)


def test_units_give_the_force_that_others_lack_and_are_then_at_no_limit() -> None:
    """Breaks if a law keeps its integral at a limit that the train does not have, or units of one kind are changed."""
    units = zeros(LawUnit, 2)
    units["force_min"], units["force_max"] = (-20.0, -60.0), (60.0, 20.0)
    for shifted, wanted, force, saturated in (
        (True, (-56.0, -20.0), (-20.0, -56.0), False), (True, (-69.0, -23.0), (-20.0, -60.0), True),
        (True, (30.0, 30.0), (40.0, 20.0), False), (False, (-60.0, -20.0), (-20.0, -20.0), None),
    ):  # fmt: skip
        units["shifted"], units["wanted"] = shifted, wanted
        assert limit_demands(units) and units["force"].tolist() == pytest.approx(force)
        assert units["saturated"].tolist() == ([True, False] if saturated is None else [saturated] * 2)


def test_a_subclass_with_a_demand_in_python_is_guarded() -> None:
    """Breaks if the demand of a subclass is not called, or its limits do not reach the law over records."""

    class Doubled(Lean):
        def demand(self, given):
            return [2.0 * force for force in super().demand(given)]

    of = model(SINGLE)
    plain, doubled = (kind(LeanParameters(), of, 0.1) for kind in (Lean, Doubled))
    given = inputs(of, feedforward=np.array([150e3]), force_max=np.array([200e3]))
    assert plain.step(given).force == [150e3] and doubled.step(given).force == [200e3]
    assert doubled.saturated == [True]


@pytest.mark.campaign
def test_mypy_refuses_a_wrong_field(tmp_path) -> None:
    """Breaks if the annotation of a compiled law hides its records from mypy."""
    text = (
        "from train_ato.control.law import LawUnit\nfrom plant_sim.record import Records\n\n"
        "def law(units: Records[LawUnit]) -> None:\n    units[0].{} = 1.0\n    for x in units:\n        x.{} = 1.0\n"
    )
    found = {}
    for name in ("wanted", "wantd"):
        (tmp_path / f"{name}.py").write_text(text.format(name, name))
        found[name] = api.run([str(tmp_path / f"{name}.py"), "--follow-imports=silent"])
    assert found["wanted"][2] == 0, found["wanted"]
    assert found["wantd"][0].count('"LawUnit" has no attribute "wantd"') == 2
