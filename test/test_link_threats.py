"""Delay lines: delays, jumps and loss by hand, and the threats of EN 50159 to their messages."""

from typing import Any

import numpy as np
import pytest
from engine_runs import setup_of
from hypothesis import given
from hypothesis import strategies as st

from plant_sim.elementary import random_stream
from train_ato.loop.engine import run_engine
from train_ato.messages.delay_lines import NEVER, DelayJump, Link, LinkSpec, MessageLink, VaryingDelay

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
    assert np.flatnonzero(acting).min() == first_step and set(acting) <= {0.0, 7.0}


def test_newer_command_overtakes_and_replaces_older_ones() -> None:
    """Traction 1 s, brake .3 s: a brake command sent .4 s later arrives first and replaces the traction command."""
    link = Link(LinkSpec(delay=1.0, delay_brake=0.3), 1, STEP, 1, "c")
    acting = run(link, [5.0, 5.0, 5.0, 5.0, *[-3.0] * 20])
    assert 5.0 not in acting
    assert np.flatnonzero(acting == -3.0).min() == (4 * TICK + 300_000_000) // STEP


def test_units_have_their_own_delays() -> None:
    """Breaks if units share a delay, a small or no traction has the delay of braking, or no unit has no link."""
    link = Link(LinkSpec(delay=(1.0, 0.1)), 2, STEP, 1, "c")
    link.push(0, np.array([1.0, 2.0]))
    acting = link.window(0, 400)
    assert [int(np.flatnonzero(acting[:, unit]).min()) for unit in (0, 1)] == [200, 20]
    link = Link(LinkSpec(delay=0.1, delay_brake=1.0), 3, STEP, 1, "c")
    link.push(0, (1.0, 1.0, 1.0))
    link.push(TICK, (0.0, 0.5, -0.5))
    assert list(link.pop(2 * TICK)) == [0.0, 0.5, 1.0]
    assert Link(LinkSpec(delay=0.3), 0, STEP, 1, "c").window(0, 4).shape == (4, 0)


def test_the_slowest_unit_gives_the_delay_of_a_single_link() -> None:
    """Breaks if the delay in braking, a unit or jitter is left out, or no unit has a delay."""
    given = LinkSpec(delay=(0.3, 0.1), delay_brake=0.2, jitter=0.05, varying=VaryingDelay(amplitude=0.4))
    assert given.newest() == given.model_copy(update={"delay": 0.3, "delay_brake": None})
    assert given.longest == pytest.approx(0.75)
    assert LinkSpec(delay=0.1, delay_brake=(0.2, 0.5)).newest() == LinkSpec(delay=0.5)
    assert LinkSpec(delay=()).newest() == LinkSpec()


def test_a_queue_has_room_for_all_values_of_a_window() -> None:
    """Breaks if many values of compiled ticks at once find too few columns, or values in flight are lost."""
    link = Link(LinkSpec(delay=1.0), 1, STEP, 1, "c")
    for tick in range(5):
        link.push(tick * TICK, (tick + 1.0,))
    for count in (12, 100, 1):
        _, units, due, values = link.records(5 * TICK, count)
        first, end = int(units["first"][0]), int(units["end"][0])
        assert due.shape == values.shape and due.shape[1] - end >= count
        assert list(values[0, first:end]) == [1.0, 2.0, 3.0, 4.0, 5.0]
        assert list(due[0, first:end]) == [1_000_000_000 + tick * TICK for tick in range(5)]
    assert due.dtype == np.int64


def test_the_next_jump_is_the_first_one_after_a_stamp() -> None:
    """Breaks if a span of compiled ticks passes a jump, or a jump that has happened ends it."""
    link = Link(LinkSpec(jump=DelayJump(at=9.0)), 1, STEP, 1, "c")
    link.jump(DelayJump(at=4.0))
    assert [link.next_jump(second * 10**9) for second in (0, 4, 8)] == [4 * 10**9, 9 * 10**9, 9 * 10**9]
    assert link.next_jump(9 * 10**9) > 10**18
    assert link.draws(3).tolist() == [[0.0, 1.0]] * 3  # neither late nor lost


def test_jumps_change_the_delay_from_their_time_on() -> None:
    """Breaks if a jump acts on commands in flight, a sum is multiplied, or a shorter delay brings an old one back."""
    link = Link(LinkSpec(delay=0.2, jump=DelayJump(at=0.5, factor=2.0)), 1, STEP, 1, "c")
    found = run(link, [float(k + 1) for k in range(20)])
    assert [np.flatnonzero(found == value).min() for value in (5.0, 6.0)] == [80 + 40, 100 + 80]
    link = Link(LinkSpec(delay=0.1, jump=DelayJump(at=0.0, factor=2.0, add=0.05)), 1, STEP, 1, "c")
    link.jump(DelayJump(at=0.0, factor=3.0, add=0.15))
    link.jump(DelayJump(at=1.0, add=-9.0))
    link.push(0, (1.0,))
    assert np.flatnonzero(link.window(0, 400)[:, 0])[0] == 160  # 0.1 s · 2 · 3 + 0.05 s + 0.15 s
    link.push(2_000_000_000, (2.0,))
    assert link.pop(2_000_000_000) == 2.0  # a negative delay is none
    link = Link(LinkSpec(delay=0.1, jump=DelayJump(at=0.0, add=0.1)), 1, STEP, 1, "c")
    link.push(0, (1.0,))
    assert np.flatnonzero(link.window(0, 400)[:, 0])[0] == 40
    link = Link(LinkSpec(delay=1.0), 1, STEP, 1, "c")
    found = acting(link, [float(k + 1) for k in range(30)], [DelayJump(at=1.5, factor=0.1)])
    first = {value: int(np.flatnonzero(found == value)[0]) for value in set(found) - {0.0}}
    assert first == {float(k + 1): (k + 10) * 20 for k in range(6)} | {
        float(k + 1): (k + 1) * 20 for k in range(15, 30)
    }


@given(
    delay=st.floats(0, 1.5),
    jitter=st.floats(0, 0.5),
    loss=st.floats(0, 0.9),
    window=st.sampled_from([1, 2, 4, 5, 10, 20]),
)
def test_acting_values_are_ordered_and_independent_of_the_window(delay, jitter, loss, window):
    """Breaks if an old command acts after a newer one, a value was never sent, or windows change the result."""
    spec = LinkSpec(delay=delay, jitter=jitter, loss=loss)
    values = [float(k + 1) for k in range(40)]
    acting = run(Link(spec, 1, STEP, 3, "c"), values, window)
    assert np.array_equal(acting, run(Link(spec, 1, STEP, 3, "c"), values, 20))
    assert set(acting) <= {0.0, *values} and (np.diff(acting) >= 0).all()
    younger = (np.arange(acting.size) * STEP * 1e-9 - delay + STEP * 1e-9) / (TICK * 1e-9) + 1
    assert (acting <= np.maximum(0, younger)).all()


def test_loss_holds_the_last_value_and_seeds_differ() -> None:
    """Breaks if a lost command acts as 0 or the stream ignores its key."""
    values = [float(k + 1) for k in range(200)]

    def acting(seed: int, name: str) -> np.ndarray:
        return run(Link(LinkSpec(loss=0.3), 1, STEP, seed, name), values)

    one = acting(1, "a")
    arrived = set(one) - {0.0}
    assert 110 < len(arrived) < 170 and np.array_equal(one, acting(1, "a"))
    assert not np.array_equal(one, acting(2, "a")) and not np.array_equal(one, acting(1, "b"))


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
        outcome = run_engine(setup_of("demo", "duration=30", "observer=ndo", *assignments))
        return outcome.recording.command

    assert not np.array_equal(commands(), commands(f"links.{topic}.delay=0.5"))


def test_the_pipe_stays_charged_until_the_first_command_arrives() -> None:
    """Breaks if a delayed brake-pipe command begins with 0 Pa, which is an emergency application."""
    outcome = run_engine(setup_of("demo", "duration=5", "links.brake_pipe.delay=2"))
    assert outcome.recording.topics["train/brake_pipe"]["pressure"].min() == 600e3


JUMPS = st.lists(st.builds(DelayJump, at=st.floats(0, 4), factor=st.floats(0, 3), add=st.floats(-1, 1)), max_size=3)
SPECS = st.builds(
    LinkSpec,
    delay=st.floats(0, 1.5),
    delay_brake=st.none() | st.floats(0, 1.5),
    jitter=st.just(0.0) | st.floats(0, 0.8),
    loss=st.just(0.0) | st.floats(0, 0.9),
    varying=st.none()
    | st.builds(VaryingDelay, amplitude=st.floats(0, 1), omega=st.floats(0.1, 9), phase=st.floats(-3, 3)),
)


def acting(link: Link, values: list[float], jumps: list[DelayJump]) -> np.ndarray:
    """Send one value a tick and 4 s of nothing; return the acting values of all steps."""
    for jump in jumps:
        link.jump(jump)
    parts = []
    for tick in range(len(values) + 40):
        if tick < len(values):
            link.push(tick * TICK, (values[tick],))
        parts.append(link.window(tick * TICK, 20)[:, 0])
    return np.concatenate(parts)


@given(SPECS, JUMPS, st.integers(0, 99))
def test_no_message_is_inserted_repeated_or_out_of_sequence(spec: LinkSpec, jumps: list[DelayJump], seed: int) -> None:
    """Breaks if a value acts that was not sent, returns after a newer one, or acts before its stamp."""
    # Commands have either sign, so that those in braking overtake those in traction.
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), 40)
    found = acting(Link(spec, 1, STEP, seed, "c"), list(signs * np.arange(1, 41)), jumps)
    numbers = np.abs(found)
    assert set(found) <= {0.0, *(signs * np.arange(1, 41))} and (np.diff(numbers) >= 0).all()
    sent = np.arange(found.size) // 20 + 1
    assert (numbers <= sent).all()


@given(SPECS, st.integers(0, 99))
def test_no_message_of_a_topic_is_repeated_or_out_of_sequence(spec: LinkSpec, seed: int) -> None:
    """Breaks if a message that a newer one replaced is returned again."""
    link = MessageLink(spec, STEP, seed, "measurement")
    found = [link.pass_on(tick * TICK, tick) for tick in range(60)]
    assert found == sorted(found) and all(number <= tick for tick, number in enumerate(found))


def test_deletion_is_counted_and_holds_the_last_value() -> None:
    """Breaks if a lost command acts, a delivered one is counted as lost, or the value before it is not held."""
    link = Link(LinkSpec(loss=0.4, jitter=0.05), 1, STEP, 7, "c")
    draws = random_stream(7, "link/c").random((50, 2))  # jitter and loss of each message
    found = acting(link, [float(k + 1) for k in range(50)], [])
    delivered = [k for k in range(50) if draws[k, 1] >= 0.4]
    assert link.lost == 50 - len(delivered) > 10
    expected = np.zeros(found.size)
    for k in delivered:
        expected[k * 20 + round(draws[k, 0] * 0.05e9 / STEP) :] = k + 1
    assert np.array_equal(found, expected)


def test_jitter_and_deletion_depend_on_seed_and_topic() -> None:
    """Breaks if jitter has no effect or exceeds its bound, or two topics or two runs lose the same messages."""
    late = []
    for seed in range(200):
        link = Link(LinkSpec(delay=0.2, jitter=0.3), 1, STEP, seed, "c")
        link.push(0, (1.0,))
        late.append(int(np.flatnonzero(link.window(0, 120)[:, 0])[0]))
    assert 40 <= min(late) < 45 and 95 < max(late) <= 100 and len(set(late)) > 40

    def passed(seed: int, name: str) -> list[int]:
        link = MessageLink(LinkSpec(loss=0.5), STEP, seed, name)
        return [link.pass_on(tick * TICK, tick) for tick in range(60)]

    assert passed(1, "a") == passed(1, "a")
    assert len({tuple(passed(*key)) for key in ((1, "a"), (2, "a"), (1, "b"))}) == 3


def test_delays_are_exact_for_long_times() -> None:
    """Breaks if stamps lose a nanosecond, an endless delay is an error, or a reading takes values due later."""
    link = Link(LinkSpec(delay=600.0), 1, 100, 1, "c")
    link.push(0, (1.0,))
    assert link.pop(600_000_000_000 - 100) == 0.0 and link.pop(600_000_000_000) == 1.0
    late = Link(LinkSpec(jump=DelayJump(at=5000.0, add=1.0)), 1, STEP, 1, "c")
    late.push(5_000_000_000_000, (1.0,))
    assert late.pop(5_000_000_000_000) == 0.0
    epoch = 1_700_000_000_000_000_000 + 5
    longest = Link(LinkSpec(varying=VaryingDelay(amplitude=600.0, omega=1e-12, phase=np.pi / 2)), 1, 1, 1, "c")
    longest.push(0, (1.0,))
    assert longest.pop(600_000_000_000 - 1) == 0.0 and longest.pop(600_000_000_000) == 1.0
    varying = Link(LinkSpec(varying=VaryingDelay(amplitude=0.0)), 1, 1, 1, "c")
    varying.push(epoch, (1.0,))
    assert varying.pop(epoch - 1) == 0.0 and varying.pop(epoch) == 1.0
    link = Link(LinkSpec(delay=1.0), 1, STEP, 1, "c")
    for _ in range(120):
        link.jump(DelayJump(at=0.0, factor=1000.0))
    link.push(0, (1.0,))
    assert link.pop(round(NEVER * 1e9) - STEP) == 0.0
    link = Link(LinkSpec(), 1, STEP, 1, "c")
    link.push(STEP, (1.0,))
    assert [float(link.pop(now)[0]) for now in (0, 0, STEP, STEP)] == [0.0, 0.0, 1.0, 1.0]


@pytest.mark.parametrize("window", [1, 4, 20])
@pytest.mark.parametrize(
    ("amplitude", "omega", "phase"),
    [(0.2, 1.0, 0.0), (0.2, 1.3, 0.0), (0.5, 4.0, 0.0), (0.6, 1.0, 1.0), (0.6, 7.0, 1.0)],
)
def test_varying_delay_is_that_of_the_receiver(amplitude: float, omega: float, phase: float, window: int) -> None:
    """Paper 003 delays u(t - tau(t)): the newest command not younger than tau(t) ago acts, in any block or window."""
    assert VaryingDelay(amplitude=0.2) == VaryingDelay(amplitude=0.2, omega=1.0, phase=0.0)
    varying = VaryingDelay(amplitude=amplitude, omega=omega, phase=phase)
    found = run(Link(LinkSpec(varying=varying), 1, STEP, 1, "c"), [float(k + 1) for k in range(200)], window)
    steps = np.arange(4000)
    late = np.rint(amplitude * np.abs(np.sin(omega * steps * STEP * 1e-9 + phase)) * 1e9 / STEP).astype(int)
    newest = np.maximum.accumulate(steps - late) // 20 + 1
    assert np.array_equal(found, np.maximum(newest, 0))


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"delay": (0.1, 0.2)}, r"links\.x\.delay: 2 values for 3 units"),
        ({"delay": -0.1}, r"links\.x\.delay: -0\.1 s is negative"),
        ({"delay": (0.2, -0.1, 0.3)}, r"^links\.x\.delay: -0\.1 s is negative; give 0 or more$"),
        ({"delay": 0.1, "delay_brake": (0.1,)}, r"links\.x\.delay_brake: 1 values for 3 units"),
        ({"delay": (0.0, 0.0, 601.0)}, r"^links\.x\.delay: 601 s is longer than 600 s; check its unit$"),
        ({"loss": 1.0}, "less than"),
        ({"jump": {"at": 0.0, "factor": 1000.5}}, "less than"),
    ],
)
def test_wrong_values_are_refused(spec: dict[str, Any], message: str) -> None:
    """Breaks if a wrong length, a negative delay, one above 600 s, a whole loss or a factor above 1000 is accepted."""
    with pytest.raises(ValueError, match=message):
        Link(LinkSpec.model_validate(spec), 3, STEP, 1, "x")
    assert list(LinkSpec(delay=(0.0, 600.0)).per_unit(2, "links.x")[0]) == [0.0, 600.0]


def test_repeated_values_and_skipped_draws_are_those_of_single_ticks() -> None:
    """Breaks if a value in flight or held is forgotten, a tick is left out, or compiled ticks use other draws."""
    link = Link(LinkSpec(delay=0.3), 1, STEP, 1, "c", initial=5.0)
    assert link.delivers_only(5.0) and not link.delivers_only(4.0)
    link.push(0, (4.0,))
    assert not link.delivers_only(5.0)  # 4 is in flight
    link.repeat(TICK, TICK, 2, 4.0)
    assert not link.delivers_only(4.0)  # 5 is held up to 0.3 s
    link.repeat(3 * TICK, TICK, 1, 4.0)
    assert link.delivers_only(4.0) and not link.delivers_only(5.0)
    link.push(4 * TICK, (3.0,))
    link.repeat(5 * TICK, TICK, 2, 2.0)
    assert [float(link.pop(tick * TICK)[0]) for tick in (6, 7, 8, 9)] == [4.0, 3.0, 2.0, 2.0]
    single, skipped = (Link(LinkSpec(jitter=0.1, loss=0.2), 1, STEP, 1, "c") for _ in range(2))
    for tick in range(3):
        single.push(tick * TICK, (1.0,))
    skipped.draws(3)  # compiled ticks look at them, and use as many as they run
    skipped.skip_draws(2)
    skipped.skip_draws(1)
    np.testing.assert_array_equal(single.draws(5), skipped.draws(5))
