"""The recording of the start page as a page that computes: what `simulate --html` writes."""

import subprocess
import sys

from sphinx.application import Sphinx


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page before any is read."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write(app: Sphinx) -> None:
    recording = app.srcdir / "figures/steering.csv"
    replay = [sys.executable, "-m", "needlefit", "simulate", "--recording", str(recording)]
    page = recording.with_suffix(".html")
    subprocess.run([*replay, "--html", str(page)], check=True, stdout=subprocess.DEVNULL)
