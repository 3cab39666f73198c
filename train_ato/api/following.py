"""Trains behind each other: one ordinary run for each, in the order of the line, and a common summary.

The reports of a train go backwards only. The run of a train is therefore complete before the run of the train behind
it. The scenario of the train behind contains the reports. It is an ordinary run in every mode, and ``verify`` repeats
it. Its links deliver each report at its time, as in a common run.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.states import Odometry
from plant_sim.units import KMH
from train_ato.api.drive import RunMode, drive
from train_ato.api.run import Run
from train_ato.api.scenario_choice import choose_scenario
from train_ato.judge.recording import TRUTH, Recording
from train_ato.judge.verdict import unmet_requirements
from train_ato.log.run_folder import RunFolder, summary_text
from train_ato.log.whole_file import write_whole
from train_ato.loop.headway import following_weight, smooth_product, smooth_step
from train_ato.loop.train_ahead import reporter_of
from train_ato.program.display_units import stored_units
from train_ato.program.errors import RunFailed
from train_ato.scenario.following import FollowingFile, FollowingSpec
from train_ato.scenario.scenario_data import PartCache
from train_ato.scenario.setup import RunSetup
from train_ato.supervision.train_report import TrainReport, reports_text

SUMMARY = "summary.json"
MIN_DEVIATION = 1e-9
"""Smallest deviation of a speed that another one is divided by [m/s]."""
MAX_BACKWARDS = 1.0
"""Largest speed backwards of a profile without a delay, which has such speeds of some mm/s before a stop [m/s]."""


@dataclass(frozen=True)
class FollowingResult:
    """Result of trains behind each other.

    Attributes
    ----------
    runs : dict of Run
        Run of every train by its name.
    summary : dict
        Content of the common ``summary.json``.
    """

    runs: dict[str, Run]
    summary: dict[str, Any]


def train_reports(recording: Recording, setup: RunSetup) -> list[TrainReport]:
    """Return the reports of a recorded train, one at every step of its supervisor."""
    reporter = reporter_of(setup)
    columns = [recording.of("train/odometry", name) for name in ("position", "speed", "since_balise")]
    found = [column for column in columns if column is not None]
    rows = zip(found[0][0].tolist(), *(values for _, values in found), strict=True)
    return [reporter.report(Odometry(round(time * 1e9), *values)) for time, *values in rows]


def first_report(setup: RunSetup) -> TrainReport:
    """Return the report of a train at its start."""
    train = setup.train()
    front = float(train.position[0]) + setup.consist.vehicles[0].length / 2.0
    speed = float(train.velocity[0])
    return reporter_of(setup).report(Odometry(0, np.full(2, front), np.full(2, speed), np.zeros(2)))


class Preparation:
    """Prepared runs of all trains of a checked following file."""

    def __init__(self, file: FollowingFile) -> None:
        self._file, self._parts = file, PartCache()

    def setup(self, number: int, reports: list[TrainReport]) -> RunSetup:
        """Return the run of a train with the reports of the train ahead, none for the first train."""
        try:
            data = self._file.scenario_of(number)
            if number:
                data["leader"] = {**data.get("leader", {}), "reports": reports_text(reports)}
            return choose_scenario(data).prepare(parts=self._parts)
        except ValueError as error:
            raise self._file.refusal(number, error) from None

    def check(self) -> None:
        """Prepare every train behind the start of the train ahead."""
        ahead: RunSetup | None = None
        report: list[TrainReport] = []
        for number in range(len(self._file.spec.trains)):
            setup = self.setup(number, report)
            try:
                report = [first_report(setup)]
                if ahead is not None:
                    _check_start(ahead, setup)
                    _check_headway(setup)
            except ValueError as error:
                raise self._file.refusal(number, error) from None
            ahead = setup


def _check_start(ahead: RunSetup, setup: RunSetup) -> None:
    """Check that a train begins behind the train ahead on the same line."""
    if (setup.line.name, setup.line.begin, setup.line.end) != (ahead.line.name, ahead.line.begin, ahead.line.end):
        raise ValueError(
            f"plant.line: '{setup.line.name}' is not '{ahead.line.name}' of the train ahead; give both the same line"
        )
    rear = float(ahead.train().position[-1]) - ahead.consist.vehicles[-1].length / 2.0
    gap = rear - float(setup.train().position[0]) - setup.consist.vehicles[0].length / 2.0
    if gap <= 0.0:
        raise ValueError(f"profile: begins {-gap:.0f} m inside the train ahead; start it further back")


def _check_headway(setup: RunSetup) -> None:
    """Check that a train does not wait from its start on to be one headway behind the train ahead.

    It waits if it would run backwards to be at the place of the train ahead without a delay of its profile.
    """
    spec, own = setup.scenario.leader, setup.profile
    if spec is None or spec.headway is None:
        return
    place = setup.leader_reports[0].front - setup.consist.vehicles[0].length / 2.0
    beyond = own.at(spec.headway)[0] - place
    fading = smooth_product(smooth_step(own.time - own.time[1], spec.smoothing), following_weight(own, spec))
    if beyond <= 0.0 or (own.velocity - beyond * fading[1]).min() >= -MAX_BACKWARDS:
        return
    there = float(own.time[np.searchsorted(own.position, place)])
    raise ValueError(
        f"leader.headway = {spec.headway:g}: after this time the own profile is {beyond:.0f} m beyond "
        "the first place of the train ahead, and the train would have to wait for it; "
        f"write {there:.0f} s, or change profile.since by as much"
    )


def run_following(
    file: FollowingFile, run_mode: RunMode, out: Path | None = None, shown: bool | None = None
) -> FollowingResult:
    """Run trains behind each other.

    Parameters
    ----------
    file
        Checked following file.
    run_mode
        Checked mode of every run.
    out
        Folder to make, with a run folder for each train and the common summary; None: in memory.
    shown
        As for :func:`train_ato.api.drive.drive`.

    Raises
    ------
    ValueError
        Bad input, before the first run.
    RunFailed, RunInterrupted
        If a run fails; those before it are recorded.
    """
    spec, preparation = file.spec, Preparation(file)
    preparation.check()
    if out is None:
        return _driven_trains(spec, preparation, run_mode, None, shown)
    folder = RunFolder.make(out, spec.name)
    with folder.kept_if_recorded():
        return _driven_trains(spec, preparation, run_mode, folder.path, shown)


def _driven_trains(
    spec: FollowingSpec, preparation: Preparation, run_mode: RunMode, place: Path | None, shown: bool | None
) -> FollowingResult:
    """Run the trains one after the other, with a run folder of each in a folder, None for none."""
    runs: dict[str, Run] = {}
    reports: list[TrainReport] = []
    for number, train in enumerate(spec.trains):
        setup = preparation.setup(number, reports)
        try:
            run = drive(setup, run_mode, out=None if place is None else place / train.name, shown=shown, option="--out")
        except RunFailed as error:
            if not error.printed:
                error.args = (f"train {train.name}: {error}", *error.args[1:])
            raise
        runs[train.name], reports = run, train_reports(run.recording, setup)
    return result_of(spec, runs, place)


def result_of(spec: FollowingSpec, runs: dict[str, Run], place: Path | None) -> FollowingResult:
    """Return the result of the runs of all trains; write the common summary into a folder, None for none."""
    rows: list[dict[str, Any]] = []
    ahead: Recording | None = None
    for name, run in runs.items():
        recording = run.recording
        row = {"name": name, **({} if ahead is None else follower_figures(ahead, recording, run.setup))}
        rows.append({**row, **run.metrics})
        ahead = recording
    with stored_units():
        judged = _judged(spec, rows)
    summary = {"following": spec.name, "seed": spec.seed, **judged, "trains": rows}
    if place is not None:
        write_whole(place / SUMMARY, summary_text(summary))
    return FollowingResult(runs, summary)


def follower_figures(ahead: Recording, own: Recording, setup: RunSetup) -> dict[str, Any]:
    """Return the figures of a train behind another one, on the truth of both.

    Gap: rear of the train ahead less the front, at the common ticks. Speed amplification: largest deviation of the
    speed from the own profile, divided by that of the train ahead. It is at most 1 where a disturbance does not grow.
    Headway errors: place and speed of the front less the values of the train ahead one headway before. They count where
    the profile follows the train ahead, away from own stops.
    """
    leader = ahead.setup
    assert leader is not None
    rear = ahead.of(TRUTH, "rear_position")
    last = rear[1][:, 0] if rear is not None else ahead.front_position
    time = own.time[own.time <= ahead.time[-1]]
    front = own.front_position + setup.consist.vehicles[0].length / 2.0
    rears = np.interp(time, ahead.time if rear is None else rear[0], last) - leader.consist.vehicles[-1].length / 2.0
    gap = rears - front[: time.size]
    touching = gap <= 0.0
    figures: dict[str, Any] = {
        "gap_min_m": float(gap.min()),
        "gap_min_s": float(time[gap.argmin()]),
        "contacts": int(touching[0]) + int((touching[1:] & ~touching[:-1]).sum()),
        "speed_amplification": _speed_deviation(own, setup) / max(_speed_deviation(ahead, leader), MIN_DEVIATION),
    }
    spec = setup.scenario.leader
    if spec is None or spec.headway is None:
        return figures
    followed = setup.profile.time[following_weight(setup.profile, spec)[0] >= 1.0]
    used = np.isin(np.rint(own.time * 1e9), np.rint(followed * 1e9))
    used &= (own.time >= spec.headway) & (own.time - spec.headway <= ahead.time[-1])
    if not used.any():
        return figures
    before = own.time[used] - spec.headway
    shift = leader.consist.vehicles[0].length / 2.0
    error = front[used] - np.interp(before, ahead.time, ahead.front_position) - shift
    speed = own.front_velocity[used] - np.interp(before, ahead.time, ahead.front_velocity)
    return figures | {
        "headway_error_max_m": float(np.abs(error).max()),
        "headway_error_rms_m": float(np.sqrt((error**2).mean())),
        "headway_speed_error_max_kmh": float(np.abs(speed).max() * KMH),
    }


def _speed_deviation(recording: Recording, setup: RunSetup) -> float:
    """Return the largest deviation of the speed of the front from the own profile, before any report [m/s]."""
    planned = setup.profile.at_times(recording.time)[1]
    return float(np.abs(recording.front_velocity - planned).max())


def _judged(spec: FollowingSpec, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return verdict, broken requirements and number of contacts of all trains."""
    criteria, broken = spec.criteria, list[str]()
    limits = (
        ("headway_error_max_m", criteria.headway_error, "headway error", "m"),
        ("headway_error_rms_m", criteria.headway_error_rms, "rms headway error", "m"),
        (
            "headway_speed_error_max_kmh",
            None if criteria.headway_speed_error is None else criteria.headway_speed_error * KMH,
            "headway speed error",
            "km/h",
        ),
        ("speed_amplification", criteria.speed_amplification, "amplification of the speed", ""),
        ("brake_interventions", criteria.brake_interventions, "brake interventions", ""),
    )
    for row in rows:
        for key, limit, words, unit in limits:
            if limit is not None and row.get(key) is not None and row[key] > limit:
                broken.append(f"{row['name']}: {words} {row[key]:.3g} {unit}, permitted {limit:g} {unit}".rstrip())
        if row.get("contacts"):
            broken.append(f"{row['name']}: {row['contacts']} contacts with the train ahead")
        if criteria.gap is not None and row.get("gap_min_m", np.inf) < criteria.gap:
            broken.append(f"{row['name']}: gap {row['gap_min_m']:.1f} m, at least {criteria.gap:g} m")
        if row.get("verdict") == "failed":
            broken.append(f"{row['name']}: verdict of its run: failed: {unmet_requirements(row)}")
    contacts = sum(row.get("contacts", 0) for row in rows)
    return {"verdict": "failed" if broken else "passed", "broken": broken, "contacts": contacts}
