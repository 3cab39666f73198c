"""Share of the recording in the time of a tick in one process, for ``recorder.py``."""

from __future__ import annotations

import gc
import time
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import Any

from train_ato.errors import FirstFailure
from train_ato.log.compression import COMPRESSIONS
from train_ato.loop.setup import RunSetup
from train_ato.messages.codec.codec import Wire
from train_ato.messages.topics import Role
from train_ato.ros.graph.environment import claim_domain

TURN = 500
"""Ticks of one graph before the next one: several chunks, so that the packing of its own chunks is included."""
PAUSE_S = 0.2
"""Wall time after a turn to finish the packing of chunks."""
UNRECORDED = "not recorded"
TIMES = ("wall", "thread", "process")
"""Clocks: wall time, processor time of the graph's thread, processor time of the process."""


class Graph:
    """Nodes of a run in this process, run for a number of ticks at a time.

    Parameters
    ----------
    compression
        Compression of the log; None: no recorder.
    """

    def __init__(self, setup: RunSetup, folder: Path, compression: str | None, stack: ExitStack) -> None:
        from train_ato.ros.graph.assembly import executor_of, make_node
        from train_ato.ros.nodes.endpoints import ROLES, NodeEndpoints

        folder.mkdir(parents=True)
        recorded = compression is not None
        roles = ROLES if recorded else ROLES[:-1]
        self._watch = FirstFailure()
        domain = stack.enter_context(claim_domain())
        context, self._executor = stack.enter_context(executor_of(domain))
        wire = Wire(setup.layout)
        self._all_endpoints = {role: NodeEndpoints(role, wire, context, self._watch, roles) for role in roles}
        options: dict[str, Any] = {"compression": compression} if recorded else {}
        self._nodes = {
            role: make_node(role, setup, self._all_endpoints[role], folder, True, 60.0, recorded, **options)
            for role in roles
        }
        for role, endpoints in self._all_endpoints.items():
            if role is not Role.RECORDER:
                self._executor.add_node(endpoints.node)
        self._recorder = self._nodes.get(Role.RECORDER)
        self.spent: dict[str, list[float]] = {key: [] for key in TIMES}

    def begin(self) -> None:
        """Let the nodes find each other, and start."""
        while any(endpoints.missing() for endpoints in self._all_endpoints.values()):
            self._executor.spin_once(timeout_sec=0.01)
        self._nodes[Role.PROFILE].begin()
        self._nodes[Role.PLANT].begin()

    def drive(self, ticks: int) -> None:
        """Run and record a number of ticks; store the times of one tick [s]."""
        from train_ato.ros.graph.composed import RECORD_EVERY

        plant = self._nodes[Role.PLANT]
        last, record = plant.stage.tick + ticks, 0
        begin = (time.perf_counter(), time.thread_time(), time.process_time())
        while plant.stage.tick < last and not plant.finished and self._watch.failure is None:
            self._executor.spin_once(timeout_sec=0.1)
            if self._recorder is not None and plant.stage.tick >= record:
                record = plant.stage.tick + RECORD_EVERY
                self._recorder.poll()
        wall, thread = time.perf_counter(), time.thread_time()
        time.sleep(PAUSE_S)
        end = (wall, thread, time.process_time())
        if self._watch.failure is not None:
            raise RuntimeError(self._watch.failure)
        for key, first, second in zip(TIMES, begin, end, strict=True):
            self.spent[key].append((second - first) / ticks)

    def close(self) -> None:
        """Close the log."""
        if self._recorder is not None:
            self._recorder.close(None)
            self._all_endpoints[Role.RECORDER].destroy()


def one_process(setup: RunSetup, ticks: int, scratch: Path) -> dict[str, dict[str, float]]:
    """Run the graph without a recorder and with every compression, in turns.

    Returns
    -------
    dict
        By compression: median times of a tick [s], and share of the recording in each: the median over pairs of
        consecutive turns.
    """
    with ExitStack() as stack:
        graphs = {
            kind or UNRECORDED: Graph(setup, scratch / f"graph {kind}", kind, stack) for kind in (None, *COMPRESSIONS)
        }
        for graph in graphs.values():
            graph.begin()
        gc.collect()
        gc.freeze()
        for _ in range(ticks // TURN):
            for graph in graphs.values():
                graph.drive(TURN)
        gc.unfreeze()
        for graph in graphs.values():
            graph.close()
    found = {kind: {key: median(graph.spent[key]) for key in TIMES} for kind, graph in graphs.items()}
    for kind in COMPRESSIONS:
        for key in TIMES:
            pairs = zip(graphs[UNRECORDED].spent[key], graphs[kind].spent[key], strict=True)
            found[kind][f"{key}_share"] = 1 - median(without / recorded for without, recorded in pairs)
    return found
