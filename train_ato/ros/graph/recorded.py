"""Result of a run of the graph, read from its log, with or without a runner."""

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from train_ato.judge.recording import DIAGNOSTICS, FIELDS, LIMITS, PROFILE, Recording
from train_ato.judge.recording_builder import RecordingBuilder
from train_ato.judge.result import RunResult
from train_ato.judge.run_end import FAILED, INTERRUPTED, RunEnd
from train_ato.log.bag_layout import LOG
from train_ato.log.reading import iter_raw
from train_ato.log.recorded import outside_nodes, read_recording, read_reports
from train_ato.log.run_folder import RunFolder
from train_ato.messages.codec import Wire
from train_ato.messages.topics import BY_NAME
from train_ato.ros.graph.environment import opened_by
from train_ato.ros.graph.graph_result import GraphResult
from train_ato.scenario.changes import RunChanges
from train_ato.scenario.setup import RunSetup


def recorded_result(
    setup: RunSetup, folder: Path, end: GraphResult, outside: Mapping[str, str] | None = None
) -> RunResult:
    """Return the result of a run from the log in ``folder``.

    An unreadable record fails the run; the metrics then use the records before it.
    """
    recording, failure = Recording(), None
    if (folder / LOG).is_file():
        try:
            recording = read_recording(folder, setup)
            RunChanges.of(recording.changed_reports)  # as the codec does with single messages
            finite = {topic: samples.values for topic, samples in recording.topics.items() if BY_NAME[topic].finite}
            for topic, values in finite.items():
                if not all(np.isfinite(column).all() for column in values.values()):
                    raise ValueError(f"{topic}: a value is not finite")
        except ValueError:
            recording, failure = _readable_part(setup, folder)
    return RunResult.of(
        setup,
        recording,
        end.wall_s,
        end.ticks,
        end.step_ns,
        interrupted=end.interruption is not None,
        failure=end.failure or failure,
        published=end.published,
        interruption=end.interruption or "",
        outside=outside,
    )


def _readable_part(setup: RunSetup, folder: Path) -> tuple[Recording, str | None]:
    """Return the recording up to the first unreadable record, and the failure that names this record."""
    decode = Wire(setup.layout).decode
    builder = RecordingBuilder(setup)
    failure = None
    where = str(folder / LOG)
    try:
        for topic, stamp, data in iter_raw(folder, (*FIELDS, DIAGNOSTICS, PROFILE, LIMITS)):
            where = f"{folder / LOG}: {topic} for {stamp * 1e-9:.3f} s"
            message = decode(topic, data)
            if topic == DIAGNOSTICS:
                RunChanges.of((message,))
            builder.add(topic, message)
    except Exception as error:  # decoders of foreign bytes raise various exceptions
        failure = f"node recorder failed: {where}: {' '.join(str(error).split())}"
    return builder.finish(), failure


def _end_of(
    counts: dict[str, int], setup: RunSetup, failure: str | None, announced: RunEnd | None, stopped: str
) -> RunEnd:
    """Return the end of a recorded run; a tick without a command is a tick.

    Parameters
    ----------
    counts
        Messages recorded of every topic.
    failure
        Failure of the recorder, or None.
    announced
        End by the notice of the plant, or None.
    stopped
        Signal that ended the recorder, "" without one.
    """
    moved, measured = counts["train/vehicles"] - 1, counts["train/measurement"]
    ticks = announced.ticks if announced is not None else moved if moved >= 0 else measured
    if failure is None and announced is not None and announced.status == FAILED:
        failure = announced.reason
    interruption = announced.reason if announced is not None and announced.status == INTERRUPTED else None
    if announced is None and stopped:
        interruption = f"the recorder was stopped by {stopped}"
    return RunEnd.judged(ticks, setup.ticks, failure, interruption)


def _driven(
    setup: RunSetup, folder: Path, names: Mapping[str, str], counts: Mapping[str, int]
) -> tuple[RunSetup, dict[str, str]]:
    """Return the setup with the start parameters that the nodes reported, and the programs outside of this project.

    Unreadable reports fail the run later; then both are as in the scenario.
    """
    try:
        reports = read_reports(folder)
        begun = RunChanges.of(reports).begun(setup.scenario)
    except ValueError:
        return setup, {}
    sent: dict[str, float] = {}
    for name, count in counts.items():
        if len(BY_NAME[name].publishers) == 1:
            role = BY_NAME[name].publishers[0].value
            sent[role] = max(sent.get(role, 0.0), count * setup.tick)
    return replace(setup, scenario=begun), outside_nodes(
        reports, supervised=setup.layout.supervised, names=names, sent_s=sent
    )


def complete_folder(
    setup: RunSetup,
    folder: Path,
    counts: dict[str, int],
    wall_s: float,
    *,
    failure: str | None = None,
    announced: RunEnd | None = None,
    stopped: str = "",
    names: Mapping[str, str] | None = None,
) -> RunResult | None:
    """Write resolved scenario and summary of a run without a runner beside its log.

    Law, observer and their parameters are those that the nodes reported.  A log that does not begin at the start of the
    run gets no summary: its metrics would be wrong.

    Parameters
    ----------
    counts
        Messages recorded of every topic.
    wall_s
        Wall time of the recording [s].
    failure, announced, stopped
        As in :func:`_end_of`.
    names
        Names of the nodes that published, by node of the graph.

    Returns
    -------
    RunResult or None
        Result of the run; None if the log does not begin at its start.
    """
    setup, outside = _driven(setup, folder, names or {}, counts)
    home = RunFolder(folder)
    home.begin(setup)
    first = next((stamp for topic, stamp, _ in iter_raw(folder, ("train/measurement",))), None)
    if first != 0:
        when = "no step" if first is None else f"nothing before {first * 1e-9:.1f} s"
        sys.stderr.write(f"recorder: {folder}: {when} is recorded, so there is no summary; start the plant last\n")
        return None
    found = _end_of(counts, setup, failure, announced, stopped)
    end = GraphResult(
        wall_s=wall_s,
        ticks=found.ticks,
        published=counts,
        interruption=found.reason if found.status == INTERRUPTED else None,
        failure=found.reason if found.status == FAILED else None,
    )
    result = recorded_result(setup, folder, end, outside)
    if opened_by():
        result = replace(result, summary={**result.summary, "reach": "network"})
    home.finish(setup, result)
    return result
