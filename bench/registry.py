"""Table of the benchmarks of ``python -m bench``.

A new benchmark is a script ``bench/NAME.py`` that gives its figures to ``figures.publish`` or ``goals.judge``, and a
row here.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Benchmark:
    """One script.

    Attributes
    ----------
    name : str
        Name of the script, without ``.py``.
    summary : str
        Measured quantity and its floor or peer.
    arguments : tuple of str
        Arguments of a full run.
    quick : tuple of str or None
        Arguments of a run with ``--quick``; None: left out.
    needs : tuple of str
        Python packages and programs without which it is left out; a program has a leading ``/``.
    """

    name: str
    summary: str
    arguments: tuple[str, ...] = ()
    quick: tuple[str, ...] | None = ()
    needs: tuple[str, ...] = ()


BENCHMARKS = (
    Benchmark("startup", "start of the command and of a run; beside an empty Python and numpy"),
    Benchmark("memory", "largest memory of a simulated hour; beside the imports alone", quick=("--hours", "0.1")),
    Benchmark("kernel", "plant; beside plain numpy"),
    Benchmark("kernel_cycles", "cycles and instructions of the kernel; beside bare loops"),
    Benchmark("tick", "tick of the engine by scenario; beside its kernel", quick=("daqin_heavy_haul", "xuzhou_metro")),
    Benchmark("tick_parts", "parts of a tick in Python and in spans; beside the kernel", quick=("xuzhou_metro",)),
    Benchmark("laws", "step of every law; beside a law without computation", quick=("pid", "smc", "funnel")),
    Benchmark("codec", "messages; beside rosbags"),
    Benchmark("curves", "braking curves; beside a pass over the vehicles, and two searches"),
    Benchmark("planner", "planner", quick=None),
    Benchmark("plan_optimum", "timetabled plans; beside an independent optimum", quick=None, needs=("scipy",)),
    Benchmark("scene", "scene of the train; beside rosbags"),
    Benchmark(
        "composed", "lockstep graph; beside a bare rclpy ring", quick=("--ticks", "500", "--rounds", "2"),
        needs=("rclpy",),
    ),
    Benchmark(
        "recorder", "recorder; beside the mcap package",
        quick=("--seconds", "5", "--ticks", "1000", "--rounds", "1"), needs=("rclpy",),
    ),
    Benchmark("frames", "tables of an hour; beside rosbags", quick=None),
    Benchmark("report", "report of an hour; beside reading alone", quick=None),
    Benchmark(
        "sweep", "sweep on Dask: two workers beside one, overhead of a run, a killed worker",
        quick=("--runs", "30", "--duration", "60"), needs=("distributed",),
    ),
    Benchmark("view", "live page", quick=None, needs=("rclpy", "/chromium")),
)  # fmt: skip
"""Benchmarks in the order of their runs."""
