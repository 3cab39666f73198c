"""Delays of topics: content, time and order of arrivals, independent of the length of a window."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from train_ato.loop.engine import run_engine
from train_ato.loop.setup import prepare
from train_ato.messages.links import DelayJump, Link, LinkSpec, MessageLink, VaryingDelay
from train_ato.scenario.scenario import load_scenario

STEP = 5_000_000
TICK = 20 * STEP


def run(link: Link, values: list[float], window: int = 20) -> np.ndarray:
    """Push one value per tick and return the acting value at every step."""
    parts = []
    for tick, value in enumerate(values):
        link.push(tick * TICK, np.array([value]))
        parts += [link.window(tick * TICK + start * STEP, window) for start in range(0, 20, window)]
    return np.concatenate(parts)[:, 0]


@pytest.mark.parametrize(
    ("delay_ms", "first_step"),
    [(0, 0), (5, 1), (100, 20), (102, 20), (103, 21), (800, 160)],
    ids=["none", "one step", "one tick", "rounded down", "rounded up", "eight ticks"],
)
def test_constant_delay_shifts_by_whole_steps(delay_ms: float, first_step: int) -> None:
    """Breaks if the delay is rounded to the tick, cut instead of rounded, or off by one step."""
    acting = run(Link(LinkSpec(delay=delay_ms / 1e3), 1, STEP, 1, "c"), [7.0] * 12)
    assert np.flatnonzero(acting).min() == first_step
    assert set(acting) <= {0.0, 7.0}


def test_newer_command_overtakes_and_replaces_older_ones() -> None:
    """Traction 1 s, brake .3 s: a brake command sent .4 s later arrives first and replaces the traction command."""
    link = Link(LinkSpec(delay=1.0, delay_brake=0.3), 1, STEP, 1, "c")
    acting = run(link, [5.0, 5.0, 5.0, 5.0, *[-3.0] * 20])
    assert 5.0 not in acting
    assert np.flatnonzero(acting == -3.0).min() == (4 * TICK + 300_000_000) // STEP


def test_each_unit_has_its_own_delay() -> None:
    """Breaks if the units share one queue."""
    link = Link(LinkSpec(delay=(1.0, 0.1)), 2, STEP, 1, "c")
    link.push(0, np.array([1.0, 2.0]))
    acting = link.window(0, 400)
    assert [int(np.flatnonzero(acting[:, unit]).min()) for unit in (0, 1)] == [200, 20]


def test_varying_delay_is_that_of_the_receiver() -> None:
    """Paper 003 delays u(t - tau(t)): at every step the newest command not younger than tau(t) ago acts."""
    link = Link(LinkSpec(varying=VaryingDelay(amplitude=0.2)), 1, STEP, 1, "c")
    acting = run(link, [float(k + 1) for k in range(60)])
    steps = np.arange(acting.size)
    late = np.rint(0.2 * np.abs(np.sin(steps * STEP * 1e-9)) * 1e9 / STEP).astype(int)
    expected = np.maximum.accumulate(np.floor((steps - late) / 20).astype(int) + 1)
    assert np.array_equal(acting, np.maximum(expected, 0))


def test_jump_changes_the_delay_from_its_time_on() -> None:
    """Breaks if a jump is ignored or acts on commands in flight."""
    link = Link(LinkSpec(delay=0.2, jump=DelayJump(at=0.5, factor=2.0)), 1, STEP, 1, "c")
    acting = run(link, [float(k + 1) for k in range(20)])
    first_seen = {value: int(np.flatnonzero(acting == value).min()) for value in (5.0, 6.0)}
    assert first_seen == {5.0: 80 + 40, 6.0: 100 + 80}


def test_a_jump_multiplies_first_and_adds_then() -> None:
    """Breaks if the added delay is multiplied too: 2 x 0.2 s + 0.1 s are 100 steps, 2 x (0.2 s + 0.1 s) are 120."""
    link = Link(LinkSpec(delay=0.2, jump=DelayJump(at=0.0, factor=2.0, add=0.1)), 1, STEP, 1, "c")
    assert np.flatnonzero(run(link, [7.0] * 12)).min() == 100


def test_a_command_of_zero_has_the_delay_of_traction() -> None:
    """Breaks if 0 N counts as braking, so that traction ends 0.7 s early."""
    link = Link(LinkSpec(delay=1.0, delay_brake=0.3), 1, STEP, 1, "c", initial=9.0)
    assert np.flatnonzero(run(link, [0.0] * 20) == 0.0).min() == 200


@given(
    delay=st.floats(0, 1.5),
    jitter=st.floats(0, 0.5),
    loss=st.floats(0, 0.9),
    window=st.sampled_from([1, 2, 4, 5, 10, 20]),
)
def test_acting_values_are_ordered_and_independent_of_the_window(
    delay: float, jitter: float, loss: float, window: int
) -> None:
    """Breaks if an old command acts after a newer one, a value was never sent, or windows change the result."""
    spec = LinkSpec(delay=delay, jitter=jitter, loss=loss)
    values = [float(k + 1) for k in range(40)]
    acting = run(Link(spec, 1, STEP, 3, "c"), values, window)
    assert np.array_equal(acting, run(Link(spec, 1, STEP, 3, "c"), values, 20))
    assert set(acting) <= {0.0, *values}
    assert (np.diff(acting) >= 0).all()
    younger = (np.arange(acting.size) * STEP * 1e-9 - delay + STEP * 1e-9) / (TICK * 1e-9) + 1
    assert (acting <= np.maximum(0, younger)).all()


def test_loss_holds_the_last_value_and_seeds_differ() -> None:
    """Breaks if a lost command acts as 0 or the stream ignores its key."""
    values = [float(k + 1) for k in range(200)]

    def acting(seed: int, name: str) -> np.ndarray:
        return run(Link(LinkSpec(loss=0.3), 1, STEP, seed, name), values)

    one = acting(1, "a")
    arrived = set(one) - {0.0}
    assert 110 < len(arrived) < 170
    assert np.array_equal(one, acting(1, "a"))
    assert not np.array_equal(one, acting(2, "a"))
    assert not np.array_equal(one, acting(1, "b"))


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (LinkSpec(delay=(0.1, 0.2)), r"links\.x\.delay: 2 values for 3 units"),
        (LinkSpec(delay=-0.1), r"links\.x\.delay: -0\.1 s is negative"),
        (LinkSpec(delay=0.1, delay_brake=(0.1,)), r"links\.x\.delay_brake: 1 values for 3 units"),
    ],
)
def test_wrong_delays_are_refused(spec: LinkSpec, message: str) -> None:
    """Breaks if a list of a wrong length is accepted."""
    with pytest.raises(ValueError, match=message):
        Link(spec, 3, STEP, 1, "x")


def test_first_message_is_valid_until_the_first_arrival() -> None:
    """Breaks if a delayed topic has no initial message, or a message arrives after a newer one."""
    link = MessageLink(LinkSpec(delay=0.3), STEP, 1, "measurement")
    assert [link.pass_on(tick * TICK, tick) for tick in range(8)] == [0, 0, 0, 0, 1, 2, 3, 4]
    at_once = MessageLink(LinkSpec(), STEP, 1, "measurement")
    assert [at_once.pass_on(tick * TICK, tick) for tick in range(3)] == [0, 1, 2]


@pytest.mark.parametrize("topic", ["measurement", "reference", "estimate"])
def test_a_delay_on_a_topic_reaches_the_law(topic: str) -> None:
    """Breaks if a link of the scenario has no effect in the loop."""

    def commands(*assignments: str) -> np.ndarray:
        outcome = run_engine(prepare(*load_scenario("demo", ("duration=30", "observer=ndo", *assignments))))
        assert outcome.recording is not None
        return outcome.recording.command

    assert not np.array_equal(commands(), commands(f"links.{topic}.delay=0.5"))


def test_the_pipe_stays_charged_until_the_first_command_arrives() -> None:
    """Breaks if a delayed brake-pipe command begins with 0 Pa, which is an emergency application."""
    outcome = run_engine(prepare(*load_scenario("demo", ("duration=5", "links.brake_pipe.delay=2"))))
    assert outcome.recording is not None
    assert outcome.recording.topics["train/brake_pipe"]["pressure"].min() == 600e3


@pytest.mark.parametrize(("amplitude", "omega"), [(0.2, 1.3), (0.5, 4.0)])
def test_varying_delay_computed_in_blocks_is_that_of_single_steps(amplitude: float, omega: float) -> None:
    """Breaks at the end of a block, also of a delay that grows faster than time: the newest value is held then."""
    varying = LinkSpec(varying=VaryingDelay(amplitude=amplitude, omega=omega))
    values = [float(tick) for tick in range(200)]
    whole, single = (run(Link(varying, 1, STEP, 1, "x"), values, window) for window in (20, 1))
    assert (whole == single).all()
    late = np.rint(amplitude * np.abs(np.sin(omega * STEP * 1e-9 * np.arange(4000))) / 0.005).astype(int)
    newest = np.maximum.accumulate(np.arange(4000) - late)
    assert (whole == np.maximum(newest // 20, 0)).all()
