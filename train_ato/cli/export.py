"""``train-ato export``: write the tables of a run as Parquet or CSV files, or its log with the train on the line.

Options::

    run RUN         run folder or MCAP file
    --parquet       write Parquet (the default)
    --csv           write CSV; with --parquet both
    --scene         write a copy of the log with /tf, markers and track
    --rerun         write a recording for the Rerun viewer (pip install rerun-sdk)
    --figure FILE   with --scene: also a picture (PNG, SVG, PDF)
    --at S          with --figure: time in s (default: the largest force)
    --rate HZ       with --scene, --rerun: messages per second (default: 5)
    --out DIR       new folder (default: export or scene in the run folder)
    --topics TOPIC  only these topics (default: all)
"""

import argparse
import dataclasses
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from train_ato.cli.screen import print_json, print_result, print_table
from train_ato.program.arguments import Options
from train_ato.program.errors import check_packages

OPTIONS: Options = {"--topics": {"nargs": "+"}}


def execute(options: argparse.Namespace) -> None:
    """Write the tables, the log with the scene, or the recording for Rerun."""
    if options.units and (options.scene or options.rerun):
        raise ValueError("--units: only for tables; remove it, or --scene and --rerun")
    if options.rate is not None and not (options.scene or options.rerun):
        raise ValueError("--rate: only with --scene or --rerun; remove it")
    for option in ("figure", "at"):
        if getattr(options, option) is not None and not options.scene:
            raise ValueError(f"--{option}: only with --scene; remove it")
    if options.at is not None and options.figure is None:
        raise ValueError("--at: only with --figure; remove it")
    write = _write_scene if options.scene else _write_rerun if options.rerun else _write_tables
    write(options)


def _write_tables(options: argparse.Namespace) -> None:
    """Write one file per topic; the name of every column contains its unit."""
    from train_ato.api.progress import share_bar
    from train_ato.log.reading import log_file

    check_packages("export", "pyarrow")
    from train_ato.log.table_files import FORMATS, write_tables

    formats = [name for name in FORMATS if getattr(options, name)] or ["parquet"]
    folder = _free_folder(options, "export")
    log_file(options.run)  # a missing or unreadable log leaves no folder
    with _new_folder(folder), share_bar(f"writing {folder}") as progress:
        written, left_out = write_tables(options.run, folder, formats, options.topics, progress)
    if options.json:
        files = [dataclasses.asdict(entry) for entry in written]
        print_json({"run": str(options.run), "folder": str(folder), "files": files, "left_out": left_out})
        return
    rows = ((entry.file, entry.topic, entry.rows, entry.columns, entry.size_bytes / 1e3) for entry in written)
    print_table(("file", "topic", "rows", "columns", "kB"), rows, str(folder))
    for topic, reason in left_out.items():
        sys.stdout.write(f"omitted: {topic}: {reason}\n")


def _write_scene(options: argparse.Namespace) -> None:
    """Write a copy of the log with the messages of the scene."""
    from train_ato.api.progress import share_bar
    from train_ato.log.bag_layout import LOG
    from train_ato.log.run_folder import read_run_folder
    from train_ato.view.rerun_file import write_scene_log
    from train_ato.view.scene_picture import draw_scene
    from train_ato.view.train_scene import DEFAULT_RATE, check_rate

    if options.csv or options.parquet or options.topics:
        raise ValueError("--scene: no effect on tables; remove --csv, --parquet and --topics")
    rate = check_rate(DEFAULT_RATE if options.rate is None else options.rate)
    folder = _free_folder(options, "scene")
    setup, _ = read_run_folder(options.run)
    with _new_folder(folder), share_bar(f"writing {folder}") as progress:
        messages, force, worst = write_scene_log(options.run, setup, folder, rate, lambda share: progress(share, ""))
        if options.figure is not None:
            draw_scene(folder / LOG, worst if options.at is None else options.at, force, options.figure)
    data = {"run": str(options.run), "folder": str(folder), "messages": messages, "rate": rate}
    print_result(data, f"{folder / LOG}: {messages} messages of the scene\n", as_json=options.json)


def _write_rerun(options: argparse.Namespace) -> None:
    """Write one recording for the Rerun viewer."""
    from train_ato.api.progress import share_bar
    from train_ato.log.run_folder import read_run_folder
    from train_ato.log.table_loading import load
    from train_ato.view.rerun_file import write_rerun
    from train_ato.view.train_scene import DEFAULT_RATE, check_rate

    if options.csv or options.parquet:
        raise ValueError("--rerun: no effect on tables; remove --csv and --parquet")
    rate = check_rate(DEFAULT_RATE if options.rate is None else options.rate)
    folder = _free_folder(options, "rerun")
    setup, _ = read_run_folder(options.run)
    with share_bar(f"opening {options.run}") as progress:
        frames = load(options.run, options.topics, lambda share: progress(share, ""))
    path = folder / "run.rrd"
    with _new_folder(folder), share_bar(f"writing {path}") as progress:
        curves = write_rerun(options.run, setup, frames, path, rate=rate, progress=progress)
    data = {"run": str(options.run), "file": str(path), "curves": curves, "rate": rate}
    text = f"{path}: {curves} curves and the train on its line; open it with `rerun {path}`\n"
    print_result(data, text, as_json=options.json)


def _free_folder(options: argparse.Namespace, name: str) -> Path:
    """Return the new folder of ``--out``, or the default one: in the run folder, or beside a single log."""
    run: Path = options.run
    folder: Path = options.out or (run / name if run.is_dir() else run.with_name(f"{run.stem}-{name}"))
    if folder.exists():
        raise ValueError(f"{folder}: exists already; give another folder with --out")
    return folder


@contextmanager
def _new_folder(folder: Path) -> Iterator[None]:
    """Create a folder; remove it again on failure or interruption."""
    new = [folder, *(parent for parent in folder.parents if not parent.exists())]
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise ValueError(f"{folder}: cannot be created ({error.strerror}); give a writable place with --out") from None
    try:
        yield
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        for parent in new[1:]:
            parent.rmdir()
        raise
