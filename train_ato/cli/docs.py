"""``train-ato docs``: open the site of the documentation, which needs no network."""

import argparse
import sys

from train_ato.cli.new import data_folder


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``docs``."""


def execute(options: argparse.Namespace) -> int:
    """Print the entrance of the site, and open it in a browser; with ``--json`` only print it."""
    page = data_folder("site", "index.html") / "index.html"
    if options.json:
        from train_ato.cli.screen import print_json

        print_json({"page": str(page)})
        return 0
    import webbrowser

    sys.stdout.write(f"{page}\n")
    if not webbrowser.open(page.as_uri()):
        sys.stderr.write("train-ato: no browser; open this file\n")
    return 0
