"""Replay of a recorded run with its names, types, quality of service and pace.

Without these types every service is a ``std_srvs/srv/Trigger`` of the same name; the arguments of the requests of
rosbag2 are parameters of the node.
"""

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from plant_sim.formats.fields import print_assumption
from plant_sim.units import number_text
from train_ato.log.reading import MAX_RUN_NS
from train_ato.playback.log import ReplayLog, ReplayOptions, chosen_topics
from train_ato.playback.playback import Playback, ReplayState
from train_ato.program.interrupt import interruptible
from train_ato.ros import require_ros

SERVICES = (
    "pause", "resume", "toggle_paused", "is_paused", "get_rate", "set_rate", "play_next", "burst", "seek", "play",
    "stop",
)  # fmt: skip
RESULTS = {"is_paused": "paused", "get_rate": "rate", "burst": "actually_burst"}
"""Fields of the answers of rosbag2 with a result."""


def rosbag2_types() -> Any | None:
    """Return the service types of rosbag2, None if they are not installed."""
    try:
        types = import_module("rosbag2_interfaces.srv")
    except ImportError:
        return None
    return types if all(hasattr(types, type_name(service)) for service in SERVICES) else None


def type_name(service: str) -> str:
    """Return the type name of a service: PlayNext for ``play_next``."""
    return "".join(part.capitalize() for part in service.split("_"))


def offer_services(node: Any, playback: Playback) -> None:
    """Create the services of a replay on its node, after the wait for existing readers."""
    from std_srvs.srv import Trigger

    types = rosbag2_types()
    for service in SERVICES:
        kind, answer = (Trigger, _trigger) if types is None else (getattr(types, type_name(service)), _rosbag2)
        node.create_service(kind, f"~/{service}", partial(answer, node, playback, service))


def _carry_out(playback: Playback, service: str, argument: Callable[[str], Any]) -> Any:
    """Carry out an order, except a change of the rate; return its result.

    Parameters
    ----------
    playback
        Replay to control.
    service
        Name of the service.
    argument
        Returns an argument by the name of its parameter.
    """
    if service == "is_paused":
        return playback.state.paused
    if service == "get_rate":
        return float(playback.state.rate)
    if service == "burst":
        return playback.burst(int(argument("burst")))
    if service == "seek":
        return playback.seek(argument("seek"))
    if service == "play":
        return playback.play(argument("start_offset"), argument("playback_duration") or None)
    return None if service == "set_rate" else getattr(playback, service)()


def _trigger(node: Any, playback: Playback, service: str, request: Any, response: Any) -> Any:
    """Answer a Trigger with the result of the order, the place if it has none, or the reason of a refusal."""

    def place() -> str:
        state = playback.state
        return f"{'paused' if state.paused else 'plays'} at {state.moment:.3f} of {state.length:.3f} s"

    before = place()
    try:
        result = _carry_out(playback, service, lambda name: node.get_parameter(name).value)
    except ValueError as error:
        response.success, response.message = False, str(error)
        return response
    response.success = result if service == "is_paused" else True
    response.message = {
        "get_rate": f"{playback.state.rate:g}",
        "set_rate": f"rate {playback.state.rate:g}, from the parameter",
        "burst": f"{result} messages sent; {place()}",
        "stop": f"stopped, {before}",
    }.get(service, place())
    return response


def _rosbag2(node: Any, playback: Playback, service: str, request: Any, response: Any) -> Any:
    """Answer a request of rosbag2; its time of ``seek`` is an absolute time of the log."""
    from rclpy.parameter import Parameter

    arguments: dict[str, Callable[[], Any]] = {
        "burst": lambda: request.num_messages,
        "seek": lambda: playback.place_of(_nanoseconds(request.time)),
        "start_offset": lambda: _nanoseconds(request.start_offset) * 1e-9,
        "playback_duration": lambda: max(0.0, _nanoseconds(request.playback_duration) * 1e-9),
    }
    done = True
    try:
        result = _carry_out(playback, service, lambda name: arguments[name]())
    except ValueError:
        done = False
    if service == "set_rate":
        change = Parameter("rate", Parameter.Type.DOUBLE, request.rate)
        done = bool(node.set_parameters([change])[0].successful)
    if service in ("set_rate", "play_next", "seek", "play"):
        response.success = done
    elif service in RESULTS and done:
        setattr(response, RESULTS[service], result)
    return response


def _nanoseconds(time: Any) -> int:
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


@dataclass(frozen=True)
class Replayed:
    """Result of a replay.

    Attributes
    ----------
    counts : dict
        Number of sent messages by topic of the log.
    moment : float
        Last time of the log [s].
    end : str
        ``end``, ``stopped`` by the service, or ``interrupted`` by Ctrl-C.
    acknowledged : bool
        The readers have confirmed all messages.
    """

    counts: dict[str, int]
    moment: float
    end: str
    acknowledged: bool


Keys = Callable[[Playback], None]
"""Callback that processes the keys."""


def note_far_stamp(run: Path, length: float, options: ReplayOptions) -> None:
    """Note a log longer than a day [s], because the replay waits until its last message: its stamp may be wrong."""
    if length > MAX_RUN_NS / 1e9 and options.duration is None and math.isfinite(options.rate):
        print_assumption(
            f"{run}: {number_text(length)} s from the first message to the last, more than a run has: one of them may "
            "have a wrong stamp, and the replay waits until the last one; end it with --playback-duration"
        )


def publish_run(
    run: Path,
    options: ReplayOptions,
    *,
    domain: int | None = None,
    progress: Callable[[ReplayState], None] | None = None,
    keys: Keys | None = None,
) -> Replayed:
    """Publish a recorded run until its end, the service ``stop``, or Ctrl-C.

    The recorded bytes are sent in the order of the log at their publish times.  The first message is sent after the
    existing readers are matched; latched messages from before the start are sent first.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    options
        Rate, selection and names.
    domain
        ROS domain; default: as in the environment.
    progress
        Callback for the state, about ten times a second.
    keys
        Callback for the keys, at the same rate.

    Returns
    -------
    Replayed
        Sent messages and end of the replay.

    Raises
    ------
    ValueError
        For invalid options, topics not in the log, missing message types, or a damaged log.
    """
    options.check()
    require_ros()
    with ReplayLog(run) as log, interruptible() as interrupt:
        topics = chosen_topics(log.topics, options)
        log.check_place("--start-offset", options.start_offset)
        note_far_stamp(run, log.length, options)
        from train_ato.playback.player import Player
        from train_ato.ros.graph.assembly import executor_of

        def interrupted() -> bool:
            return interrupt.asked

        def report(state: ReplayState) -> None:
            if progress is not None:
                progress(state)
            if keys is not None:
                keys(playback)

        # an empty list: without arguments rclpy would apply the remappings of the command line a second time
        with executor_of(domain, []) as (context, executor):
            player = Player(executor, context, topics, options.clock_hz)
            playback = Playback(log, topics, options, player, interrupted=interrupted, progress=report)
            declare_parameters(player.node, playback)
            player.wait_for_readers(options.meet_s, interrupted)
            others = player.others()
            _warn_of_others(others)
            offer_services(player.node, playback)
            playback.run()
            acknowledged = player.wait_for_confirmation(options.acknowledged_s, interrupted)
            _warn_of_others({topic: nodes for topic, nodes in player.others().items() if topic not in others})
        end = "stopped" if playback.stopped else "interrupted" if interrupt.asked else "end"
        return Replayed(player.counts, playback.state.moment, end, acknowledged)


def _warn_of_others(others: Mapping[str, Sequence[str]]) -> None:
    for topic, nodes in others.items():
        sys.stderr.write(
            f"train-ato: {topic}: also published on this domain by {', '.join(nodes)}, readers receive both; give "
            "--domain, --remap or --exclude-topics\n"
        )


PARAMETERS: tuple[tuple[str, float | int, str], ...] = (
    ("rate", 1.0, "simulated seconds per second, .inf for as fast as possible; takes effect at once"),
    ("seek", 0.0, "time of the service seek [s from the first message]"),
    ("burst", 1, "number of messages of the service burst; 0: all"),
    ("start_offset", 0.0, "start of the service play [s from the first message]"),
    ("playback_duration", 0.0, "duration of the service play [s]; 0: to the end"),
)


def declare_parameters(node: Any, playback: Playback) -> None:
    """Declare the parameters of the node: the rate, and the arguments of services without a request."""
    from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult

    def refuse(parameters: list[Any]) -> Any:
        for name, value in ((parameter.name, parameter.value) for parameter in parameters):
            if name == "rate" and not value > 0:
                return SetParametersResult(successful=False, reason=f"rate {value:g}: give a number above 0")
            if name in ("seek", "burst", "start_offset", "playback_duration") and not 0 <= value < math.inf:
                return SetParametersResult(successful=False, reason=f"{name} {value:g}: give 0 or more")
        return SetParametersResult(successful=True)

    def take_over(parameters: list[Any]) -> None:
        for parameter in parameters:
            if parameter.name == "rate":
                playback.set_rate(parameter.value)

    for name, value, text in PARAMETERS:
        start = playback.state.rate if name == "rate" else value
        node.declare_parameter(name, start, ParameterDescriptor(description=text))
    node.add_on_set_parameters_callback(refuse)
    node.add_post_set_parameters_callback(take_over)
