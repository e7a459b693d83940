"""What ships with the program, read out of its files: studies and what they ask, fits, media, scenes."""

import tomllib
from collections.abc import Iterator

from pages import keep
from sphinx.application import Sphinx

from needlefit.project.locate import shipped_folder
from needlefit.studies.kind import KINDS

PAGE = "reference/shipped.md"
FOLDERS = {
    "Fits": "configs/fits",
    "Media": "configs/media",
    "Scenes": "configs/scenes",
    "Recipes": "configs/recipes",
}

OPENING = """\
# What ships

Every file of the project that a command takes by its name; `needlefit new project DIR` writes a copy to edit.

## Studies

`needlefit validate NAME` runs one. A study without a kind tunes on some insertions and scores others;
`needlefit explain KIND` prints the keys of another kind: {kinds}.
"""


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page before any is read."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write(app: Sphinx) -> None:
    keep(app.srcdir / PAGE, "\n".join(_page()) + "\n")


def _page() -> Iterator[str]:
    yield OPENING.format(kinds=", ".join(f"`{kind}`" for kind in KINDS.names()))
    yield from ("| name | kind | question |", "|---|---|---|")
    for name, record in _files("studies"):
        yield f"| `{name}` | {_cell(record, 'kind')} | {_cell(record, 'question', 'title')} |"
    for title, folder in FOLDERS.items():
        yield from ("", f"## {title}", "", "| name | what it is |", "|---|---|")
        yield from (f"| `{name}` | {_cell(record, 'title')} |" for name, record in _files(folder))


def _files(folder: str) -> Iterator[tuple[str, dict[str, object]]]:
    """Yield the name of every TOML file of a folder, and its content."""
    for path in sorted((shipped_folder() / folder).glob("*.toml")):
        yield path.stem, tomllib.loads(path.read_text(encoding="utf-8"))


def _cell(record: dict[str, object], *keys: str) -> str:
    found = next((str(record[key]) for key in keys if record.get(key)), "")
    return found.replace("|", r"\|").replace("_", r"\_")
