"""The notebooks with their stored outputs, as a page."""

import base64
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
from pages import keep
from sphinx.application import Sphinx

PAGE = "reference/notebooks.md"

OPENING = """\
# Notebooks

Three notebooks with their outputs. `python docs/notebooks.py` executes them again; the files are in
`docs/notebooks/`. All data are synthetic.
"""


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page before any is read."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write(app: Sphinx) -> None:
    page = app.srcdir / PAGE
    page.parent.mkdir(exist_ok=True)
    shown = [
        part
        for path in sorted((Path(app.srcdir) / "notebooks").glob("*.ipynb"))
        for part in _show(path, nbformat.read(path, as_version=4), page.parent)
    ]
    keep(page, "\n".join([OPENING, *shown]))


def _show(path: Path, notebook: Any, folder: Path) -> Iterator[str]:  # noqa: ANN401 - a notebook of nbformat
    """Yield the parts of the page that show a notebook; its figures become files in a folder."""
    for number, cell in enumerate(notebook.cells):
        if cell.cell_type == "markdown":
            yield cell.source.replace("# ", "## ", 1) if number == 0 else f"\n{cell.source}"
            if number == 0:
                yield f"\n*`docs/notebooks/{path.name}`*\n"
            continue
        is_command = cell.source.startswith("!")
        yield f"\n```{'bash' if is_command else 'python'}\n{cell.source.removeprefix('!')}\n```\n"
        for output in cell.outputs:
            data = output.get("data", {})
            if "image/png" in data:
                figure = folder / f"{path.stem}-{number}.png"
                figure.write_bytes(base64.b64decode(data["image/png"]))
                yield f"![Output of the cell above]({figure.name})\n"
            elif output.get("name") != "stderr":
                text = output.get("text", data.get("text/plain", ""))
                yield f"```text\n{text.rstrip()}\n```\n"
