"""Execute the notebooks.

python docs/notebooks.py [FILE ...]            executes docs/notebooks/*.ipynb; exit code 1 if a cell fails
python docs/notebooks.py [FILE ...] --write    also stores their outputs

It needs `pip install '.[docs]'`. Stored notebooks hold no times and no ids.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

HERE = Path(__file__).resolve().parent
FOLDER = HERE / "notebooks"


def main() -> int:
    """Execute notebooks; return 0 if no cell fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("files", nargs="*", type=Path, default=sorted(FOLDER.glob("*.ipynb")))
    parser.add_argument("--write", action="store_true", help="store the outputs")
    options = parser.parse_args()
    executed = []
    for path in options.files:
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


if __name__ == "__main__":
    sys.exit(main())
