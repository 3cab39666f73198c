"""``train-ato docs``: open the site of the documentation, which needs no network."""

import argparse
import sys

from train_ato.cli.new import data_folder
from train_ato.cli.screen import print_result


def execute(options: argparse.Namespace) -> None:
    """Print the entrance of the site, and open it in a browser; with ``--json`` only print it."""
    page = data_folder("site", "index.html") / "index.html"
    print_result({"page": str(page)}, f"{page}\n", as_json=options.json)
    if options.json:
        return
    import webbrowser

    if not webbrowser.open(page.as_uri()):
        sys.stderr.write("train-ato: no browser; open this file\n")
