"""Reader of a recorded run in bulk, with the same result as the recording of the engine."""

import math
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from train_ato.judge.kept_samples import KeptSamples
from train_ato.judge.recording import DIAGNOSTICS, FIELDS, LIMITS, OUTSIDE_KEY, PROFILE, Recording, fields_of
from train_ato.judge.recording_builder import reduced
from train_ato.judge.repeated_reports import KeptReports, changed_reports
from train_ato.judge.series import TopicSamples, seconds
from train_ato.log.bag_layout import LOG, table_name
from train_ato.log.foreign_bag import original
from train_ato.log.reading import MERGED, log_file
from train_ato.log.run_folder import parse_summary, read_run_folder
from train_ato.log.table_columns import TICKS, merged
from train_ato.log.tables import KeptMessages, LayoutRecords, Reader, TopicMessages, check_known
from train_ato.log.versions import SUMMARY
from train_ato.messages.cdr import nanoseconds, typestore
from train_ato.messages.topic import owns
from train_ato.messages.topics import EPOCH_NS, Role, Topic, topic_of, topic_with
from train_ato.messages.types import Array, Diagnostic
from train_ato.messages.variable_codec import STATES, decode_diagnostic, decode_trajectory
from train_ato.scenario.changes import RunChanges
from train_ato.scenario.setup import RunSetup

BATCH = 4096
"""Messages of a topic that are reduced together: the raw log of a long run does not fit into the memory."""
STAMP = "header.stamp"


def read_recording(
    run: Path, setup: RunSetup | None = None, *, vehicles: bool = False, namespace: str = ""
) -> Recording:
    """Read a run folder or a log.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    setup
        Scenario and train; without them the vehicles of the power units are unknown.
    vehicles
        Keep motion, coupler force, shoe force and outside force of every vehicle.
    namespace
        Namespace of one of several trains in the log; without it the first one is read.
    """
    units = list(setup.model.units) if setup is not None else []
    vehicles = vehicles or (setup is not None and setup.scenario.evaluation.couplers)
    path = log_file(run)
    samples, reports, payloads = KeptSamples(path.parent), KeptReports(), KeptMessages()
    everything = (*FIELDS, PROFILE, LIMITS, DIAGNOSTICS)
    for topic, time, values in _samples(path, everything, reports, payloads, namespace):
        samples.add(topic, TopicSamples(time, reduced(topic, values, units, vehicles=vehicles)))
    found = samples.finish()
    if TICKS in found and merged(found[TICKS].time):
        raise ValueError(f"{original(path)}: {TICKS}: two messages of one time: {MERGED}")
    profiles = {found.stamp: found for found in map(decode_trajectory, payloads.get(PROFILE, ()))}
    limits = [decode_trajectory(data) for data in payloads.get(LIMITS, ())]
    return Recording(
        {topic: found[topic] for topic in FIELDS if topic in found},
        tuple(profiles[stamp] for stamp in sorted(profiles)),
        limits[-1] if limits else None,
        reports.finish(),
        setup,
    )


def read_reports(run: Path) -> tuple[Diagnostic, ...]:
    """Return the diagnostics of a run folder or a log, the first and the last one of those with equal texts.

    Errors as :func:`read_recording`.
    """
    reports = KeptReports()
    deque(_samples(log_file(run), (DIAGNOSTICS,), reports, KeptMessages()), maxlen=0)
    return changed_reports(reports.finish())


def _samples(
    path: Path, topics: Collection[str], reports: KeptReports, payloads: KeptMessages, namespace: str = ""
) -> Iterator[tuple[str, Array, dict[str, Array]]]:
    """Read stamps [s] and values by field of some topics of the topic table: thousands of one layout at once.

    Diagnostics are added to ``reports``, profiles and limits to ``payloads``.
    Of several trains in one log that of the namespace is read, without one the first.
    """
    spaces: dict[str, None] = {}
    train = f"{namespace}/" if namespace else ""

    def wanted(channel: Channel, schema: Schema) -> bool:
        topic = table_name(channel.topic)
        if topic is None or topic not in topics or channel.message_encoding != "cdr":
            return False
        space = channel.topic.removesuffix(topic.lstrip("/"))
        if channel.topic != topic:
            spaces[space] = None
            if space != (train or next(iter(spaces))):
                return False
        return topic_of(topic, schema.name) is not None

    found: dict[Topic, TopicMessages] = {}
    for portion in Reader(path, wanted).portions():
        topic = str(table_name(portion.channel.topic))
        try:
            if topic == DIAGNOSTICS:
                for payload in portion.payloads:
                    reports.add(decode_diagnostic(bytes(payload)))
                continue
            if topic not in FIELDS:
                payloads.keep(topic, portion.payloads)
                continue
            entry = topic_of(topic, portion.schema.name)
            assert entry is not None
            if entry.has_states:
                yield topic, *_states(topic, portion.payloads)
                continue
            if entry not in found:
                found[entry] = TopicMessages(typestore(), portion.schema.name, partial(check_known, entry))
            found[entry].add(portion)
        except ValueError as error:
            raise ValueError(f"{original(path)}: {portion.channel.topic}: {error}") from None
        if sum(group.size for group in found[entry].groups) >= BATCH:
            for group in found.pop(entry).groups:
                yield topic, *_values(entry, group)
    if train and train not in spaces:
        there = ", ".join(space.rstrip("/") or "none" for space in spaces) or "none"
        raise ValueError(f"{original(path)}: --namespace {namespace}: is not in the log; its namespaces: {there}")
    for entry, messages in found.items():
        for group in messages.groups:
            yield entry.name, *_values(entry, group)


def _states(topic: str, payloads: Iterable[memoryview]) -> tuple[Array, dict[str, Array]]:
    """Return stamps [s], and states and counters by field, shape (k, n) each."""
    messages = [STATES[topic].decode(bytes(payload)) for payload in payloads]
    stamps = np.array([message.stamp for message in messages], dtype=np.int64)
    return seconds(stamps), {name: np.array([getattr(message, name) for message in messages]) for name in FIELDS[topic]}


def _values(topic: Topic, group: LayoutRecords) -> tuple[Array, dict[str, Array]]:
    """Return stamps [s] and the parts of messages of one layout by field, shape (k, n) each."""
    values: dict[str, Array] = {}
    texts = [leaf.text for leaf in group.layout.leaves if leaf.path.startswith(f"{topic.names_path}[")]
    topic = topic_with(topic, texts)
    for name, place in fields_of(topic).items():
        if place.path not in group.layout.names:
            continue
        rows = group.values(place.path).reshape(group.size, -1)
        if len(topic.owners) > 1 and (owner := place.owner) is not None:
            rows = np.take(rows, [number for number, text in enumerate(texts) if owns(owner, text)], axis=1)
        values[name] = rows
    return seconds(nanoseconds(group.values(STAMP)) - EPOCH_NS), values


def open_recording(run: Path, *, vehicles: bool = True, namespace: str = "") -> Recording:
    """Read a run folder or a log with its scenario and summary; ``namespace``: that of one of several trains."""
    setup, summary, missing = _surroundings(run)
    found = read_recording(run, setup, vehicles=vehicles, namespace=namespace)
    if not (found.topics or found.profiles or found.kept_reports):
        raise ValueError(f"{run}: the log has no message of the topic table; there is nothing to draw")
    return replace(found, setup_missing=missing, summary=summary, name=_name(run), path=run)


def _name(run: Path) -> str:
    """Return the name of a run: of its folder, or of a log that is not named ``run.mcap``."""
    if run.is_dir():
        return run.resolve().name
    return run.resolve().parent.name if run.name == LOG else run.stem


def _surroundings(run: Path) -> tuple[RunSetup | None, dict[str, Any], str]:
    """Return the readable part of scenario and summary, from the folder or the attachments, and a reason if missing.

    The files of a folder belong to its ``run.mcap`` only.
    """
    folder = run.parent if run.is_file() and run.name == LOG else run
    missing = ""
    for place in dict.fromkeys((folder, run)):
        try:
            setup, summary = read_run_folder(place)
            return setup, summary, ""
        except ValueError as error:
            missing = missing or str(error)
    with suppress(ValueError, OSError):
        return None, parse_summary(folder / SUMMARY, (folder / SUMMARY).read_bytes()), missing
    return None, {}, missing


OWN_KEYS = {
    Role.PLANT.value: "commands_lost", Role.SUPERVISOR.value: "brake_interventions", Role.PROFILE.value: "knots",
    Role.OBSERVER.value: "observer", Role.CONTROLLER.value: "compensation",
}  # fmt: skip
"""Key in the diagnostics of every node of this project; a program in place of the node has others, or sends none."""
REPORT_S = 2.0
"""Simulated time of messages without any report after which a node is a program outside of this project [s]."""


def read_changes(run: Path) -> RunChanges:
    """Return the planned and requested changes of a run: laws, parameters, interventions, ATO requests."""
    return RunChanges.of(read_reports(run))


def late_commands(run: Path) -> int:
    """Return the number of late and missing commands of a run without lockstep; they are not reproducible."""
    plant = [message.values for message in read_reports(run) if message.node == "plant"]
    counts = [sum(int(values.get(key, "0")) for key in ("wall_late", "wall_held")) for values in plant]
    return max(counts, default=0)


def outside_nodes(
    reports: Iterable[Diagnostic],
    *,
    supervised: bool,
    names: Mapping[str, str] | None = None,
    sent_s: Mapping[str, float] | None = None,
) -> dict[str, str]:
    """Return the nodes of a run that were programs outside of this project, with their names.

    The plant has met all other nodes before the run and reports those that are none of this project.  Without its word
    a missing report proves nothing: the node may have sent no message yet, or the link may have lost it.  A node of
    this project reports at its first message and once a second, under the name of its role.

    Parameters
    ----------
    reports
        Diagnostics of the run.
    supervised
        True for a run with a supervisor.
    names
        Names of the publishers by node; a program that reports another name of its law or observer has that.
    sent_s
        Simulated time for which a node has sent messages [s], by node; None: for the whole run.
    """
    own: set[str] = set()
    told: dict[str, Mapping[str, str]] = {}
    met: set[str] = set()
    for report in reports:
        told.setdefault(report.node, report.values)
        if OWN_KEYS.get(report.node) in report.values:
            own.add(report.node)
        if report.node == Role.PLANT.value:
            met.update(report.values.get(OUTSIDE_KEY, "").split())
    names = names or {}
    if not told and sent_s is None:  # a log without the topic says nothing about its nodes
        return dict(names)
    found = {}
    for node in OWN_KEYS:
        if node in own - met or (node == Role.SUPERVISOR.value and not supervised):
            continue
        silent = math.inf if sent_s is None else sent_s.get(node, 0.0)
        if node in met or node in told or silent > REPORT_S or (silent and names.get(node, node) != node):
            found[node] = told.get(node, {}).get(node) or names.get(node, node)
    return found
