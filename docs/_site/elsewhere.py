"""Pages that lie outside this folder, where a reader of the repository looks for them.

Links name them by where they lie, `../data/README.md`; in the site they are pages of their own. What the site
generates from code, a link names by the code.
"""

import re

from sphinx.application import Sphinx

PAGES = {
    "../data/README.md": "datasets.md",
    "../benchmarks/README.md": "developers/benchmarks.md",
    "../needlefit/cli/application.py": "reference/commands.md",
    "../needlefit/api.py": "api.md",
    "../studies": "reference/shipped.md",
    "figures/steering.csv": "figures/steering.html",
    "notebooks/1_fit_your_csv.ipynb": "reference/notebooks.md",
}


def setup(app: Sphinx) -> dict[str, bool]:
    """Let links lead to the pages of the site."""
    app.connect("source-read", _redirect)
    return {"parallel_read_safe": True}


def _redirect(app: Sphinx, name: str, source: list[str]) -> None:
    up = "../" * name.count("/")
    for there, here in PAGES.items():
        link = re.escape(f"]({up}{there}")
        source[0] = re.sub(rf"{link}(?=[)#])", f"]({up}{here}", source[0])
