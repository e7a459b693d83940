"""The recording of the start page as a page that computes: what `view --recording` writes."""

import shutil
import subprocess
import sys
from tempfile import TemporaryDirectory

from sphinx.application import Sphinx


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page before any is read."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write(app: Sphinx) -> None:
    recording = app.srcdir / "figures/steering.csv"
    view = [sys.executable, "-m", "needlefit", "view", "--recording", str(recording), "--no-browser"]
    with TemporaryDirectory() as folder:
        written = subprocess.run([*view, "--out", folder], check=True, stdout=subprocess.PIPE, text=True)
        shutil.move(written.stdout.strip(), recording.with_suffix(".html"))
