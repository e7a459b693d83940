"""How the site is built: the pages of this folder, and commands, API and what ships from the code.

Nothing is fetched from a network: mathematics is MathML, fonts are those of the reader's system, and names of
other packages are not linked.
"""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

sys.path.insert(0, str(Path(__file__).parent / "_site"))

project = "needlefit"
author = "The needlefit developers"
copyright = author
version = release = version_of("needlefit")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "elsewhere",
    "mathml",
    "docstrings",
    "commands",
    "example_page",
    "notebooks_page",
    "shipped",
]
root_doc = "index"
exclude_patterns = ["_site"]
html_theme = "furo"
html_title = "needlefit"
html_static_path = ["_static"]
html_css_files = ["quiet.css"]
html_copy_source = False
html_show_sphinx = False
smartquotes = False  # options are shown as typed: two hyphens stay two
html_math_renderer = "mathml"
pygments_style = "friendly"
pygments_dark_style = "github-dark"

myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "signature"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 160
default_role = "literal"

nitpicky = True
nitpick_ignore_regex = [("py:class", ".*")]  # types of signatures: most have no entry


class TermIndexer(SphinxTransform):
    """Give each term of the glossary an anchor and an entry in index and search."""

    default_priority = 500

    def apply(self) -> None:
        """Index the items of the page's lists: each begins with its term in bold."""
        if self.env.docname != "glossary":
            return
        for item in self.document.findall(nodes.list_item):
            term = next(item.findall(nodes.strong)).astext()
            anchor = nodes.make_id(term)
            item["ids"].append(anchor)
            item.insert(0, addnodes.index(entries=[("single", term, anchor, "main", None)]))


def setup(app: Sphinx) -> None:
    """Read the glossary at every build: the search index loses index entries of pages that are not read."""
    app.add_transform(TermIndexer)
    app.connect("env-get-outdated", lambda *_: ["glossary"])
