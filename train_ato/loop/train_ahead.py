"""Reports of the train ahead as they arrive, and the moving end of authority of the supervisor.

Rules of a receiving end: a report is refused and counted if it is invalid, if it is repeated or older than the newest
report, or if it is further from it than a train can move. The newest accepted report remains in effect. The first
report is known at the start of the run.

Rules of the end of authority: it is the safe rear of the newest report, less a margin. With relative braking distance
the shortest stop of the train ahead is added. Without a new report the end stays and is never extended. A report older
than the timeout loses its shortest stop, because nothing then shows that the train ahead still brakes by its own
brakes. A nearer end acts at once. The end is never beyond the end of authority of the own stop.
"""

from bisect import bisect_right
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from plant_sim.states import Odometry
from train_ato.messages.delay_lines import Link
from train_ato.messages.types import Array, TrainAhead
from train_ato.scenario.setup import RunSetup
from train_ato.supervision.limits import BrakingTarget
from train_ato.supervision.odometry import odometer_error
from train_ato.supervision.track_supervision import LineLimits, TrackSupervision, speeds_to_end
from train_ato.supervision.train_report import TrainReport, TrainReporter

MAX_SPEED = 200.0
"""Speed above that of every train [m/s]."""
MAX_CORRECTION = 50.0
"""Largest change of a reported place at a balise, beside the motion [m]."""


def reporter_of(setup: RunSetup) -> TrainReporter:
    """Return the reporter of a train.

    Raises
    ------
    ValueError
        Without a supervisor, whose odometry the reports have.
    """
    if not setup.layout.supervised:
        raise ValueError("supervision.enabled: the reports need the odometry; set supervision.enabled: true")
    return TrainReporter(setup.consist, setup.scenario.plant, setup.line, setup.supervisor().track.train.max_speed)


class ReportSender:
    """Reports of a train on ``train/report``, live for the train behind it; parameter as :func:`reporter_of`."""

    def __init__(self, setup: RunSetup) -> None:
        self._reporter = reporter_of(setup)

    def message(self, odometry: Odometry) -> TrainAhead:
        """Return the report of an odometry."""
        report = self._reporter.report(odometry)
        values = np.array((report.front, report.rear, report.stop))
        return TrainAhead(odometry.stamp, values, np.full(3, report.speed), odometry.stamp)

    @staticmethod
    def last(stamp: int) -> TrainAhead:
        """Return the message after the last report, with NaN: nothing follows, and the train behind does not wait."""
        return TrainAhead(stamp, np.full(3, np.nan), np.full(3, np.nan), stamp)


class ReportRadio:
    """Live reports of the train ahead on their way to the other nodes, at the plant of the train behind.

    Parameters
    ----------
    setup
        Prepared run with ``leader.train``; a repeated run has the recorded reports.

    Attributes
    ----------
    latest : int
        Stamp of the newest report [ns], -1 before the first.
    """

    def __init__(self, setup: RunSetup) -> None:
        self._coming = deque(setup.ahead)
        self._newest: TrainAhead | None = None
        self.latest = -1

    def put(self, report: TrainAhead) -> None:
        """Add a report; it is delivered from its stamp on."""
        self._coming.append(report)
        self.latest = report.stamp

    def newest(self, stamp: int) -> TrainAhead:
        """Return the newest report up to a stamp [ns], with this stamp; ValueError if there is none."""
        while self._coming and self._coming[0].stamp <= stamp:
            self._newest = self._coming.popleft()
        if self._newest is None:
            raise ValueError(
                f"leader.train: no report of the train ahead up to {stamp * 1e-9:.3f} s; start that train in its "
                "namespace in the same ROS domain"
            )
        return replace(self._newest, stamp=stamp)


class ReceiverState(NamedTuple):
    """State of a receiving end from a time [ns] on: newest accepted report, refusals, reason of the last one."""

    since: int
    report: TrainReport | None = None
    refused: int = 0
    problem: str = ""


class ReportReceiver:
    """Receiving end of the reports of the train ahead.

    It can be ahead of the run: its state at an earlier time remains known.

    Parameters
    ----------
    setup
        Prepared run with a block ``leader``.
    name
        Name of the receiving end, key of its random stream.
    """

    def __init__(self, setup: RunSetup, name: str) -> None:
        spec = setup.scenario.leader
        assert spec is not None
        self._reports, self._next = list(setup.leader_reports), 0
        self._link = Link(spec.link, 1, setup.step_ns, setup.scenario.seed, f"leader/{name}")
        self._arrived = self._sent = 0
        self._seen, self._states = -1, [ReceiverState(-1)]

    def at(self, now: int) -> ReceiverState:
        """Return the state at a time [ns]."""
        return self._states[bisect_right(self._states, now, key=lambda state: state.since) - 1]

    def newest(self, now: int) -> TrainReport:
        """Return the newest accepted report at a time [ns], before the first arrival the first one."""
        return self.at(now).report or self._reports[0]

    def hear(self, message: TrainAhead | None) -> None:
        """Take a live report; the link delivers it."""
        if message is None:
            return
        (front, rear, stop), speed, time = message.position.tolist(), message.speed.item(0), message.time * 1e-9
        if not self._reports or time != self._reports[-1].time:
            self._reports.append(TrainReport(len(self._reports) + 1, time, front, rear, speed, stop))

    def receive(self, now: int) -> TrainReport | None:
        """Return a report that has arrived since the last call and is accepted at a time [ns], else None.

        A call for an earlier time has no effect.
        """
        if now <= self._seen:
            return None
        self._seen, last = now, self._states[-1]
        while self._next < len(self._reports) and self._reports[self._next].stamp <= now:
            self._sent = max(self._sent, self._reports[self._next].stamp)  # a repeated report is sent now
            self._next += 1
            self._link.push(self._sent, (self._next,))
        number = int(self._link.pop(now)[0])
        if number == self._arrived:
            return None
        self._arrived = number
        report = self._reports[number - 1]
        problem = self._problem(report)
        if problem:
            self._states.append(last._replace(since=now, refused=last.refused + 1, problem=problem))
            return None
        self._states.append(last._replace(since=now, report=report))
        return report

    def _problem(self, report: TrainReport) -> str:
        """Return the reason to refuse a report, "" for none."""
        last = self.newest(self._seen)
        if report is self._reports[0] or (problem := report.problem):
            return report.problem
        if report.number <= last.number or report.time <= last.time:
            return f"report {report.number} is not newer than report {last.number}"
        if abs(report.front - last.front) > MAX_SPEED * (report.time - last.time) + MAX_CORRECTION:
            return f"report {report.number} is {abs(report.front - last.front):.0f} m from report {last.number}"
        return problem

    def age(self, now: int) -> float:
        """Return the age of the newest report at a time [ns] in seconds."""
        return (now - self.newest(now).stamp) * 1e-9

    def diagnostics(self, now: int) -> dict[str, str]:
        """Return age and refusals of the reports as text."""
        values, state = {"leader_age": repr(self.age(now))}, self.at(now)
        if state.refused:
            values |= {"leader_refused": str(state.refused), "leader_problem": state.problem}
        return values


class MovingAuthority:
    """End of authority behind the train ahead.

    Parameters
    ----------
    setup
        Prepared run with a block ``leader``.
    track
        Limits of the supervisor up to the own stop.
    name
        Name of the receiving end.

    Attributes
    ----------
    end : float
        End of authority of the last :meth:`move` [m].
    receiver : ReportReceiver
        Receiving end.
    """

    def __init__(self, setup: RunSetup, track: TrackSupervision, name: str = "supervisor") -> None:
        spec = setup.scenario.leader
        assert spec is not None
        self._margin, self._timeout = spec.rear_margin, spec.timeout
        self._relative = spec.authority == "relative"
        self._track = track
        self._own_end = track.end
        self.receiver = ReportReceiver(setup, name)
        self.end = float("inf")

    def move(self, now: int) -> LineLimits:
        """Move the end of authority to that of the newest report at a time [ns]; return the limits up to it."""
        self.receiver.receive(now)
        end = self._end_at(now)
        if end != self.end:
            self.end = float("inf")
            self._track.move_end(BrakingTarget(end, kind="EOA"))
            self.end = end
        return self._track.records

    def _end_at(self, now: int) -> float:
        """Return the end of authority at a time [ns] up to the last :meth:`move`."""
        report = self.receiver.newest(now)
        end = report.rear - self._margin
        if self._relative and self.receiver.age(now) <= self._timeout:
            end += report.stop
        return min(end, self._own_end)

    def diagnostics(self, now: int) -> dict[str, str]:
        """Return the end of authority with the state of its reports as text."""
        return {"end_of_authority": repr(self._end_at(now)), **self.receiver.diagnostics(now)}


class AuthorityAhead(MovingAuthority):
    """End of authority behind the train ahead as the law sees it, by a receiving end of the controller."""

    def __init__(self, setup: RunSetup) -> None:
        super().__init__(setup, setup.supervisor().track, "controller")
        self._half = setup.consist.vehicles[0].length / 2.0
        self._spacing = setup.scenario.plant.odometry.balise_spacing

    def at(self, now: int, places: Array) -> tuple[float, Array]:
        """Return the largest place and the permitted speeds at places, both of vehicle 0's centre, at a time [ns].

        Parameters
        ----------
        now
            Time of the measurement [ns].
        places : Array, shape (h,)
            Places [m].

        Returns
        -------
        position_max : float
            Place at which the front, with the error of the odometer since the balise, reaches the end [m].
        speeds : Array, shape (h,)
            Speeds [m/s], 0 from the end on.
        """
        _, targets, arcs = self.move(now)
        error = 0.0 if self.end == float("inf") else odometer_error(self.end % self._spacing)
        return self.end - error - self._half, speeds_to_end(targets, arcs, places + self._half, self._spacing)
