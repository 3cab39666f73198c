"""``train-ato layout``: write a layout of a viewer for one run.

Options::

    run RUN        run folder or MCAP file
    --foxglove     layout for Foxglove
    --studio       layout for Foxglove Studio 1 (the last open version 1.87), in SI units
    --plotjuggler  layout for PlotJuggler 3; it opens the log too
    --scene        Foxglove: with the train on its line, as `view RUN --foxglove` sends it
    --out FILE     new file (default: beside the log)
"""

import argparse
from pathlib import Path

from train_ato.cli.screen import print_result
from train_ato.program.arguments import Options
from train_ato.program.errors import refused_unwritten

OPTIONS: Options = {
    "--foxglove": {"one_of": "viewer", "required": True},
    "--studio": {"one_of": "viewer", "required": True},
    "--plotjuggler": {"one_of": "viewer", "required": True},
}


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
