"""Configuration of Sphinx for the site; ``python -m msgs_docs.generate --site`` builds it."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from msgs_docs.generate.site import DOCUMENTS, with_navigation  # noqa: E402
from train_ato.program.version import VERSION  # noqa: E402

project = "train_ato"
release = VERSION
author = "The train_ato team"
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
include_patterns = [*DOCUMENTS, "msgs_docs/**.md"]
root_doc = "README"
html_theme = "furo"
html_title = f"train_ato {VERSION}"
html_copy_source = False
html_show_sphinx = False
myst_heading_anchors = 4  # a link to a heading has the anchor of the code hosts
autodoc_typehints = "none"  # the signature has them as written, numpydoc has them in words
numpydoc_show_class_members = False


def setup(app):
    """Connect the navigation."""
    app.connect("source-read", lambda app, page, text: text.__setitem__(0, with_navigation(page, text[0], app.srcdir)))
