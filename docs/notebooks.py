"""Execute the notebooks, and write the page of the documentation that shows them.

python docs/notebooks.py            executes docs/notebooks/*.ipynb; an error in a cell ends with exit code 1
python docs/notebooks.py --write    also stores their outputs, and writes docs/notebooks.md

It needs `pip install '.[docs]'`. Stored notebooks hold no times and no ids.
"""

import argparse
import base64
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

HERE = Path(__file__).resolve().parent
FOLDER = HERE / "notebooks"
PAGE = HERE / "notebooks.md"

OPENING = """\
# Notebooks

Three notebooks with their outputs. `python docs/notebooks.py` executes them again; the files are in
`docs/notebooks/`. All data are synthetic.
"""


def main() -> int:
    """Execute all notebooks; return 0 if no cell fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--write", action="store_true", help="store the outputs, and write the page")
    options = parser.parse_args()
    executed = []
    for path in sorted(FOLDER.glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        try:
            executed.append((path, execute(notebook)))
        except CellExecutionError as error:
            print(f"{path.name}: {error}", file=sys.stderr)
            return 1
        print(f"{path.name}: executed", flush=True)
    if options.write:
        for path, notebook in executed:
            nbformat.write(notebook, path)
        PAGE.write_text("\n".join([OPENING, *(part for one in executed for part in show(*one))]), "utf-8")
    return 0


def execute(notebook: Any) -> Any:  # noqa: ANN401 - a notebook of nbformat
    """Return a notebook, executed in an empty folder."""
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=1200, resources={"metadata": {"path": folder}}).execute()
    for number, cell in enumerate(notebook.cells):
        cell.id, cell.metadata = f"cell-{number}", nbformat.NotebookNode()
        for output in cell.get("outputs", []):
            output.get("metadata", {}).clear()
    notebook.metadata = nbformat.from_dict({"kernelspec": {"name": "python3", "display_name": "Python 3"}})
    return notebook


def show(path: Path, notebook: Any) -> Iterator[str]:  # noqa: ANN401 - a notebook of nbformat
    """Yield the parts of the page that show a notebook; its figures become files beside it."""
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
                figure = FOLDER / f"{path.stem}-{number}.png"
                figure.write_bytes(base64.b64decode(data["image/png"]))
                yield f"![Output of the cell above](notebooks/{figure.name})\n"
            elif output.get("name") != "stderr":
                text = output.get("text", data.get("text/plain", ""))
                yield f"```text\n{text.rstrip()}\n```\n"


if __name__ == "__main__":
    sys.exit(main())
