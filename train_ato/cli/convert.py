"""``train-ato convert IN OUT``: write a line or a train of a foreign file in the own format.

Options::

    source IN   line ({lines}), train ({trains}) or shipped name; a path through a network of tracks is FILE:FROM..TO
                or FILE:FROM..VIA..TO, one of several paths or trains FILE:NAME, an effort curve TRAIN:MODE, a line
                against its direction LINE:reverse
    target OUT  new file; the ending is the format: .yaml of this package, .railml or .xml of railML 3, .json of
                TTOBench for a line, of OSRD for a train, or .csv, .gpx or .geojson for a line
"""

import argparse
import sys

from plant_sim.formats.fields import LINE_FORMATS, TRAIN_FORMATS
from train_ato.program.arguments import Options

OPTIONS: Options = {"source": {"words": {"lines": LINE_FORMATS, "trains": TRAIN_FORMATS}}}


def execute(options: argparse.Namespace) -> None:
    """Write the file; print the keys that it does not carry on stderr."""
    from train_ato.api.converting import convert
    from train_ato.cli.screen import print_result

    result = convert(options.source, options.target)
    for key in result["left_out"]:
        sys.stderr.write(f"not carried: {options.source}: {key}\n")
    text = f"{result['file']}: {result['kind']} '{result['name']}', read as {result['format']}\n"
    print_result(result, text, as_json=options.json)
