"""Couplers: their limits in the trip planner, their fatigue, and their modes in the linear train."""

import sys
from pathlib import Path

import numpy as np
import pytest
import rainflow
from commands import answer, complaint
from law_trains import model
from plant_trains import line_of

import train_ato as ta
from plant_sim.library import load_consist, load_line
from plant_sim.train import Train
from train_ato.api.scenario_choice import choose_scenario
from train_ato.cli import main
from train_ato.control.algorithms.coupler_modes import TrainModes
from train_ato.control.mpc.coupler_limit import CouplerLimit
from train_ato.control.train_model import TrainModel
from train_ato.judge.metrics import CouplerFatigue, relative_fatigue
from train_ato.judge.recording import TRUTH, Recording
from train_ato.log.recorded import open_recording
from train_ato.report.page_data import page_data

pytestmark = pytest.mark.usefixtures("without_figure")

GOLDEN = Path(__file__).resolve().parent / "golden" / "short_train" / "run.mcap"


@pytest.fixture(scope="module")
def recording() -> Recording:
    return open_recording(GOLDEN)


def damage(recording: Recording) -> list[float]:
    """Return the damage of every coupler from all points, without reversals and without a smallest range."""
    columns = recording.of(TRUTH, "coupler_force")[1][:, :-1].T
    return [sum((size / 1e6) ** 5 * count for size, count in rainflow.count_cycles(force)) for force in columns]


def test_the_command_prints_the_damage_of_a_run(recording: Recording, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a coupler is left out, half cycles count as whole ones, or a report omits the damage."""
    found = answer(capsys, "info", str(GOLDEN), "--fatigue", str(GOLDEN))["fatigue"]
    expected = damage(recording)
    # omitted cycles: at most 441 samples of half a cycle below 20 kN in every coupler; figures have 4 decimals
    tolerance = len(expected) * 441 / 2 * 0.02**5 + 1e-4
    assert found["coupler_damage"] == pytest.approx(sum(expected), abs=tolerance)
    assert found["coupler_damage_worst"] == pytest.approx(max(expected), abs=tolerance)
    assert found["ratio"] == 1.0
    assert page_data(recording).summary["coupler_damage"] == pytest.approx(sum(damage(recording)), abs=1e-3)


def test_the_summary_has_every_coupler(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a coupler is left out of the summary, or its cycles are not those of the log."""
    settings = {"duration": 40, "evaluation.couplers": True}
    rows = ta.run("daqin_heavy_haul", set=settings, out=tmp_path / "run").metrics["couplers"]
    force = open_recording(tmp_path / "run").of(TRUTH, "coupler_force")[1][:, :-1]
    assert [row["coupler"] for row in rows] == list(range(105))
    assert [row["draft_max_kn"] for row in rows] == pytest.approx(force.max(axis=0) / 1e3, abs=1e-3)
    assert [row["buff_max_kn"] for row in rows] == pytest.approx(np.minimum(force.min(axis=0), 0) / 1e3, abs=1e-3)
    cycles = [[(size, count) for size, count in rainflow.count_cycles(column) if size >= 20e3] for column in force.T]
    assert [row["cycles"] for row in rows] == [sum(count for _, count in entry) for entry in cycles]
    assert max(row["range_max_kn"] for row in rows) == pytest.approx(
        max(max((size for size, _ in entry), default=0.0) for entry in cycles) / 1e3, abs=1e-3
    )
    assert main(["info", str(tmp_path / "run")]) == 0 and "couplers" in capsys.readouterr().out


def test_the_ratio_is_that_of_the_first_run() -> None:
    """Breaks if the ratio is upside down, or divides by a run without damage."""
    runs = [CouplerFatigue(np.array(values), np.zeros(2)) for values in ([0.5, 0.5], [1.5, 0.5], [0.0, 0.0])]
    assert relative_fatigue(runs[0], runs[1])["ratio"] == 0.5
    assert relative_fatigue(runs[0], runs[2])["ratio"] is None


def test_a_run_without_couplers_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a train of one vehicle gets a damage of 0, or a traceback."""
    run = tmp_path / "run"
    words = ["--engine", "--set=duration=1", f"--out={run}", "--json"]
    assert main(["run", "crh380a_funnel", *words]) == 0
    assert "no coupler forces" in complaint(capsys, "info", str(run), "--fatigue")


def _model(consist: str, line: str) -> TrainModel:
    return model(load_consist(consist), load_line(line), 0.8, 0.4)


@pytest.mark.parametrize("limit", [2e5, 4e5])
def test_range_of_a_locomotive_with_wagons_on_the_level(limit: float) -> None:
    """The force behind the locomotive has the wagons' part of the inertia: a wrong part or sign changes the range."""
    of = _model("hxd1_c80_105", "level")
    low, high = CouplerLimit(of, limit).force_range(np.array([2e4]), np.array([10.0]))[:, 0].tolist()
    part = 1.0 - of.unit_inertia[0] / of.inertia
    own = of.own_resistance(np.array([10.0]), np.array([2e4]))[0]
    rest = own - (1.0 - part) * of.resisting_force(2e4, 10.0)
    assert high == pytest.approx((limit + rest) / part)
    assert low == pytest.approx((rest - limit) / part)


def test_range_on_a_change_of_grade() -> None:
    """Without the grade of every vehicle at its own place, draft at the top of a grade is not seen."""
    of = _model("hxd1_c80_105", "daqin_section")
    places = np.linspace(4e3, 4e4, 50)
    ranges = CouplerLimit(of, 4e5).force_range(places, np.full(50, 15.0))
    for place, (low, high) in zip(places, ranges.T, strict=True):
        rows = []
        for force in (low, high):
            acceleration = (force - of.resisting_force(place, 15.0)) / of.inertia
            front = force
            largest = 0.0
            for i, vehicle in enumerate(of.consist.vehicles[:-1]):
                at = place - of.consist.offsets[i]
                specific, begin = of.specific_line_force()
                line = np.interp(at - begin, np.arange(specific.size), specific)
                polynomial = vehicle.resistance.polynomial(vehicle.mass, of.consist.gravity)
                running = float(np.polyval(polynomial[::-1], 15.0))
                front -= vehicle.mass * line + running + vehicle.mass * vehicle.rotating_mass_factor * acceleration
                largest = max(largest, abs(front))
            rows.append(largest)
        assert low < high
        np.testing.assert_allclose(rows, 4e5, rtol=0.01)


def test_traction_of_one_locomotive_keeps_the_limit() -> None:
    """Without the limit in the plan this departure has a draft of 549 kN; with it the locomotive pulls less."""
    draft, force = [], []
    for limit in (0.0, 2e5):
        changes = {"duration": 100, "laws.mpc.coupler_limit": limit}
        run = ta.run("daqin_heavy_haul", law="mpc", compensation="none", set=changes, progress=False)
        draft.append(run.metrics["coupler_draft_max_kn"])
        force.append(float(run["ato/command"].filter(like="force").to_numpy().max()) / 1e3)
    assert draft[0] > 500.0
    assert 190.0 < draft[1] < 206.0, "waves add a few kN"
    assert force[1] < 206.0 < force[0]


LEVEL = line_of(10e3)
STEP_NS = 100_000


def plant_slopes(name: str, speed: float, lag: float) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives of the accelerations of all vehicles by displacements and speeds, and by forces."""
    setup = choose_scenario(name).prepare()
    consist = setup.consist
    places, speeds = 5000.0 - np.array(consist.offsets), np.full(len(consist.vehicles), speed)

    def accelerations(moved: np.ndarray, faster: np.ndarray, force: np.ndarray) -> np.ndarray:
        start = {"positions": tuple((places + moved).tolist()), "speeds": tuple((speeds + faster).tolist())}
        plant = setup.scenario.plant.model_copy(
            update={"start": type(setup.scenario.plant.start).model_validate(start), "lag": 0.0, "ideal_actuator": True,
                    "disturbances": (), "jumps": ()}
        )  # fmt: skip
        train = Train(consist, LEVEL, plant, step_ns=STEP_NS, tick_ns=STEP_NS, seed=0)
        train.advance(force[None, :])
        return (train.velocity - speeds - faster) / (STEP_NS * 1e-9)

    n, units = len(consist.vehicles), len(consist.power_units)
    base = np.full(units, 2e4)
    none, unit, push = np.zeros(n), np.eye(n), np.eye(units)
    rows = [accelerations(1e-3 * e, none, base) - accelerations(-1e-3 * e, none, base) for e in unit]
    rows += [accelerations(none, 1e-3 * e, base) - accelerations(none, -1e-3 * e, base) for e in unit]
    forced = [accelerations(none, none, base + 1e3 * e) - accelerations(none, none, base) for e in push]
    return np.array(rows).T / 2e-3, np.array(forced).T / 1e3


@pytest.mark.parametrize(
    ("name", "speed_kmh"), [("freight_consensus", 50.0), ("crh380a_gpc", 200.0), ("xuzhou_metro", 70.0)]
)
def test_the_matrices_are_the_slopes_of_the_plant(name, speed_kmh):
    """Breaks if a mass, a stiffness, a damper, the slope of the resistance, a sign or a row is another one."""
    model = ta.linearise(name, speed_kmh=speed_kmh)
    lag = choose_scenario(name).prepare().model.lag
    state, force = plant_slopes(name, speed_kmh / 3.6, lag)
    n, units = len(state), force.shape[1]
    assert [entry[0] for entry in model.states[:n]] == [f"vehicle_{i}_displacement" for i in range(n)]
    assert model.A[n : 2 * n, : 2 * n] == pytest.approx(state, rel=2e-3, abs=2e-3 * np.abs(state).max())
    found = model.A[n : 2 * n, 2 * n :] if lag else model.B[n:]
    assert found == pytest.approx(force, rel=1e-3, abs=1e-3 * np.abs(force).max())
    assert np.array_equal(model.A[:n, n : 2 * n], np.eye(n))
    if lag:
        assert np.array_equal(model.B[2 * n :], np.eye(units) / lag)
    drag = model.A[n : 2 * n, n : 2 * n].sum(axis=1)
    assert drag == pytest.approx(state[:, n:].sum(axis=1), rel=0.02)


def test_the_poles_are_those_of_the_coupler_modes():
    """Breaks if the friction of the gears or a mode is missing: zeta omega and omega of every mode, and the lag."""
    setup = choose_scenario("demo").prepare()
    modes, model = TrainModes.of(setup.model), ta.linearise("demo", speed_kmh=40)
    poles = model.poles
    waves = sorted(poles[poles.imag > 0], key=abs)
    assert len(waves) == modes.omega.size == len(modes.mass) - 1
    assert np.abs(waves) == pytest.approx(modes.omega, rel=1e-3)
    damped = -np.real(waves) / np.abs(waves)
    assert damped == pytest.approx(modes.viscous + modes.friction, rel=0.02, abs=2e-3)
    assert np.abs(poles + 1.0 / setup.model.lag).min() < 1e-9


def test_the_response_of_one_vehicle_is_a_closed_form():
    """Breaks if the delay is in the matrices or missing in the response: e^(-j w tau)/((1 + j w Ta)(M j w + r))."""
    setup, omega = choose_scenario("xuzhou_metro").prepare(), np.array([0.01, 0.3, 2.0])
    model, nominal = ta.linearise("xuzhou_metro", speed_kmh=60), setup.model
    speed, h = 60 / 3.6, 1e-4
    slope = (nominal.running_resistance(speed + h) - nominal.running_resistance(speed - h)) / (2 * h)
    delay = np.exp(-1j * omega * nominal.delay[0]) / (1 + 1j * omega * nominal.lag)
    expected = delay / (nominal.inertia * 1j * omega + slope)
    assert model.response(omega)[:, 1, 0] == pytest.approx(expected, rel=1e-6)
    assert model.outputs == (("unit_0_displacement", "m"), ("unit_0_speed", "m/s"))
    assert model.delay.tolist() == nominal.delay.tolist() and model.force == nominal.running_resistance(speed)
    system = model.scipy()
    assert np.array_equal(system.A, model.A) and np.array_equal(system.D, model.D)


def test_the_model_of_python_control_has_the_same_response_and_names():
    """Breaks if a matrix is transposed or a name lost on the way to python-control, or the delays are in it twice."""
    pytest.importorskip("control", reason="not required: pip install control")
    model, omega = ta.linearise("crh380a_gpc", speed_kmh=200), np.array([0.05, 0.5, 3.0])
    system = model.control()
    found = np.array([system(1j * w) * np.exp(-1j * w * model.delay) for w in omega])
    assert found == pytest.approx(model.response(omega), rel=1e-9)
    assert system.input_labels == [name for name, _ in model.inputs]
    assert system.output_labels == [name for name, _ in model.outputs]
    assert system.state_labels == [name for name, _ in model.states]


@pytest.mark.parametrize("speed", [0.0, -5.0, float("nan"), 2000.0])
def test_an_impossible_speed_and_a_missing_python_control_are_refused(speed, monkeypatch):
    """Breaks if the missing package is a traceback, or a train is linearised at rest, backwards or too fast."""
    with pytest.raises(ValueError, match="speed_kmh"):
        ta.linearise("demo", speed_kmh=speed)
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ValueError, match="pip install control"):
        ta.linearise("xuzhou_metro", speed_kmh=60).control()
