"""Persistent sines in the disturbances of units on soft couplers: spectrum, periodic motion, and the law mpc."""

from __future__ import annotations

import numpy as np
import pytest

import train_ato as ta
from plant_sim.library import load_consist, load_line
from train_ato.control.algorithms.coupled_units import CoupledUnits
from train_ato.control.algorithms.disturbance_lines import add_line
from train_ato.control.algorithms.line_spectrum import LineSpectrum
from train_ato.control.algorithms.periodic_motion import COUPLER, POSITION, RATE, periodic_response
from train_ato.control.laws.mpc import Mpc
from train_ato.control.train_model import TrainModel

PERIOD, LAG = 0.1, 0.4
SCENARIO = "freight_consensus:realistic+delay_1_0"


def _units():
    delays = np.full(5, 1.0)
    model = TrainModel(load_consist("freight_five"), load_line("level"), delays, delays, LAG, PERIOD)
    return CoupledUnits(model)


def _stiff(units, frequency):
    return -(frequency**2) * np.eye(units.n) - units.spring - 1j * frequency * units.damper


def _samples(units, frequency, force, drift, noise=0.0, seconds=120.0):
    """Yield time and sample of units under a line of force [m/s²] and drift [m/s], and under a force of 3 rad/s."""
    random = np.random.default_rng(1)
    motion = np.linalg.solve(_stiff(units, frequency), force + 1j * frequency * drift)
    command = np.array([0.02, 0.0, -0.01, 0.0, 0.0])
    forced = np.linalg.solve(_stiff(units, 3.0), command)
    for t in np.arange(0.0, seconds, PERIOD):
        turn, other = np.exp(1j * frequency * t), np.exp(3j * t)
        position = (motion * turn + forced * other).real
        speed = ((1j * frequency * motion - drift) * turn + 3j * forced * other).real
        position = position + noise * random.standard_normal(units.n)
        speed = speed + 0.25 * noise * random.standard_normal(units.n)
        yield t, np.array([position, speed, (command * other).real])


@pytest.mark.parametrize("frequency", [0.77, 1.0, 2.23])
def test_frequency_and_amplitudes_of_a_line_are_found(frequency):
    """The motion by a command, here at 3 rad/s, is no line; a wrong sign or derivative gives another amplitude."""
    units = _units()
    spectrum = LineSpectrum(units, PERIOD)
    force, drift = np.array([0.1, 0.0, -0.05j, 0.0, 0.0]), np.array([0.0, 0.05, 0.0, 0.02j, 0.0])
    for t, sample in _samples(units, frequency, force, drift, noise=0.02):
        spectrum.step(t, sample)
    peaks = spectrum.peaks()
    assert len(peaks) == 1
    assert peaks[0][1] == pytest.approx(frequency, abs=0.02)
    found = spectrum.amplitudes(*peaks[0]) * np.exp(-1j * frequency * t)
    np.testing.assert_allclose(found[0], force + 1j * frequency * drift, atol=0.02)
    np.testing.assert_allclose(found[1], drift, atol=0.01)


def test_noise_has_no_lines():
    """A floor below the noise gives lines at random frequencies."""
    units, random = _units(), np.random.default_rng(2)
    spectrum, found = LineSpectrum(units, PERIOD), []
    for k in range(4000):
        spectrum.step(k * PERIOD, random.standard_normal((3, 5)) * np.array([[0.02], [0.005], [1e-3]]))
        if k % 10 == 0 and k > 200:
            found.append(len(spectrum.peaks()))
    assert np.mean(found) < 0.1


def test_a_line_goes_on_through_missed_samples():
    """Without the turn of missed periods the phase is wrong; a gap of more than 5 s begins again."""
    units, force = _units(), np.array([0.1, 0.0, 0.0, 0.0, 0.0])
    spectrum, amplitude = LineSpectrum(units, PERIOD), []
    for t, sample in _samples(units, 1.0, force, np.zeros(5)):
        if not 80.0 < t < 83.0:
            spectrum.step(t, sample)
            spectrum.peaks()
            amplitude.append(spectrum.amplitudes(6, 1.0)[0, 0] * np.exp(-1j * t))
    np.testing.assert_allclose(amplitude[800:], 0.1, atol=0.01)
    spectrum.step(t + 6.0, sample)
    assert not spectrum.peaks()


def test_periodic_response_is_the_smallest_cost_and_moves_the_units():
    """Any other command has a higher cost; a wrong sign of springs or lag breaks the equation of motion."""
    units, frequency, random = _units(), 1.3, np.random.default_rng(3)
    disturbance = random.standard_normal(5) + 1j * random.standard_normal(5)
    motion, acting = periodic_response(units, LAG, frequency) @ disturbance
    np.testing.assert_allclose(_stiff(units, frequency) @ motion, disturbance + acting, atol=1e-9)

    def cost(force):
        place = np.linalg.solve(_stiff(units, frequency), disturbance + force)
        couplers = -units.stiffness * np.diff(place)
        rate = frequency * (1.0 + 1j * frequency * LAG) * force
        return sum(
            float((np.abs(value) ** 2).sum()) / weight**2
            for value, weight in ((place, POSITION), (couplers, COUPLER), (rate, RATE))
        )

    for _ in range(20):
        other = acting + 1e-3 * (random.standard_normal(5) + 1j * random.standard_normal(5))
        assert cost(other) > cost(acting)


def test_the_command_of_a_line_acts_a_delay_later():
    """Through delay and lag the commands in flight give the acting force that is taken out of the measurement."""
    units, w, tick = _units(), 1.0, 0.1
    response, line = periodic_response(units, LAG, w), np.zeros((2, 5), np.complex128)
    line[0] = [0.1, -0.05j, 0.0, 0.0, 0.02]
    actuators = np.array([np.full(5, 1.0), np.full(5, 1.0), np.full(5, 0.2)])
    motion, sent, command = np.zeros((3, 5)), np.zeros((200, 5)), np.zeros(5)
    add_line(motion, sent, command, response, line, units.mass, w, LAG, actuators, tick, 1)
    force = np.zeros(5)
    for row in -sent[:-10]:
        force += (row - force) * (1.0 - np.exp(-tick / LAG))
    np.testing.assert_allclose(force, -motion[2], atol=0.01 * np.abs(motion[2]).max())
    np.testing.assert_allclose(command, sent[-2] - 2.0 * np.cos(w * tick) * sent[-1])


@pytest.mark.parametrize("scenario", ["delay_0_8", "delay_1_0"])
def test_closed_loop_goals(scenario):
    """Goals of mpc_goals.md; without the lines 50 and 46 kN/s."""
    run = ta.run(f"freight_consensus:realistic+{scenario}", law="mpc", compensation="none", progress=False)
    assert run.metrics["position_rmse_m"] < 0.07
    assert run.metrics["command_variation_kn_per_s"] < 35.0


def test_other_frequencies_without_a_change_of_the_law():
    """Lines of .73 and 2.37 rad/s: frequencies of the scenario in the law, or lines on a grid, fail here."""
    terms = [{"omega": 0.73, "acceleration": 0.1}, {"omega": 2.37, "acceleration": 0.1}]
    changes = {"plant.disturbances": [{"kind": "harmonic", "terms": terms}]}
    run = ta.run(SCENARIO, law="mpc", compensation="none", set=changes, progress=False)
    assert run.metrics["position_rmse_m"] < 0.12  # .206 without the lines
    assert run.metrics["command_variation_kn_per_s"] < 40.0  # 119


@pytest.mark.parametrize(
    "source",
    [
        None,
        {"kind": "turbulence", "acceleration_rms": 0.1, "correlation": 1.0},
        {"kind": "gust", "acceleration": -0.2, "begin": 30, "end": 40},
    ],
)
def test_no_worse_without_lines(source, monkeypatch):
    """Without persistent sines the run is that of a law without this part."""
    changes = {"plant.disturbances": [source] if source else []}
    run = ta.run(SCENARIO, law="mpc", compensation="none", set=changes, progress=False)
    monkeypatch.setattr(LineSpectrum, "peaks", lambda self: [])
    without = ta.run(SCENARIO, law="mpc", compensation="none", set=changes, progress=False)
    for name in ("position_rmse_m", "command_variation_kn_per_s"):
        assert run.metrics[name] <= 1.02 * without.metrics[name]


def test_reset_forgets_the_lines(monkeypatch):
    """A line or a state of the spectrum that stays changes the forces of the next run with the same inputs."""
    laws, inputs, step = [], [], Mpc.step

    def recorded(law, given):
        laws.append(law)
        inputs.append(given)
        return step(law, given)

    monkeypatch.setattr(Mpc, "step", recorded)
    ta.run(SCENARIO, law="mpc", compensation="none", set={"duration": 60}, progress=False)
    law, forces = laws[0], []
    assert law.diagnostics()["disturbance_lines"]
    for _ in range(2):
        law.reset()
        forces.append(np.array([step(law, given).force for given in inputs]))
    np.testing.assert_array_equal(forces[0], forces[1])
    assert law.diagnostics()["disturbance_lines"]
    law.reset()
    assert not law.diagnostics()["disturbance_lines"]
