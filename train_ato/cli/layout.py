"""``train-ato layout``: write a layout of a viewer for one run."""

import argparse
from functools import partial
from pathlib import Path

from train_ato.cli.screen import print_result
from train_ato.program.arguments import add_option
from train_ato.program.errors import refused_unwritten


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``layout``."""
    add = partial(add_option, parser)
    add("run RUN", "run folder or MCAP file")
    viewer = parser.add_mutually_exclusive_group(required=True)
    add_option(viewer, "--foxglove", "layout for Foxglove")
    add_option(viewer, "--studio", "layout for Foxglove Studio 1 (the last open version 1.87), in SI units")
    add_option(viewer, "--plotjuggler", "layout for PlotJuggler 3; it opens the log too")
    add("--scene", "Foxglove: with the train on its line, as `view RUN --foxglove` sends it")
    add("--out FILE", "new file (default: beside the log)")


def execute(options: argparse.Namespace) -> None:
    """Write the layout with the topics, names and sizes of the run."""
    from train_ato.log.whole_file import write_whole
    from train_ato.view.foxglove_layout import foxglove_layout
    from train_ato.view.layout_signals import read_signals
    from train_ato.view.plotjuggler_layout import plotjuggler_layout

    if options.scene and options.plotjuggler:
        raise ValueError("--scene: PlotJuggler shows curves only; remove it")
    log = read_signals(options.run)
    name = "plotjuggler.xml" if options.plotjuggler else "studio.json" if options.studio else "foxglove.json"
    target: Path = options.out or log.path.with_name(name if options.run.is_dir() else f"{log.path.stem}-{name}")
    if target.exists():
        raise ValueError(f"{target}: exists already; give another file with --out")
    text = (
        plotjuggler_layout(log, target)
        if options.plotjuggler
        else foxglove_layout(log, studio_1=options.studio, scene=options.scene)
    )
    with refused_unwritten(target, "name a writable place"):
        write_whole(target, text)
    data = {"run": str(options.run), "layout": str(target), "topics": sorted(log.names.values())}
    print_result(data, f"{target}\n", as_json=options.json)
