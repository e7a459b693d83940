"""Pages that lie outside this folder, where a reader of the repository looks for them.

Links name them by where they lie, `../data/README.md`; in the site they are pages of their own, each a file
that includes one.
"""

from sphinx.application import Sphinx

PAGES = {"../data/README.md": "datasets.md", "../benchmarks/README.md": "benchmarks.md"}


def setup(app: Sphinx) -> dict[str, bool]:
    """Let links lead to the pages of the site."""
    app.connect("source-read", _redirect)
    return {"parallel_read_safe": True}


def _redirect(app: Sphinx, name: str, source: list[str]) -> None:
    up = "../" * name.count("/")
    for there, here in PAGES.items():
        source[0] = source[0].replace(f"]({up}{there}", f"]({up}{here}")
