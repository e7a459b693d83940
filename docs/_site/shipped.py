"""What ships with the program, read out of its files: studies and what they ask, fits, media, scenes."""

import tomllib
from collections.abc import Iterator

from pages import keep
from sphinx.application import Sphinx

from needlefit.project.places import shipped
from needlefit.validation.inquiries.kinds import KINDS

PAGE = "reference/shipped.md"
FOLDERS = {
    "Fits": "configs/fits",
    "Media": "configs/media",
    "Scenes": "configs/scenes",
    "Recipes": "configs/recipes",
}

OPENING = """\
# What ships

Every file of the project that a command takes by its name; `needlefit init DIR` writes a copy to edit.

## Studies

`needlefit validate NAME` runs one. A study without a kind tunes on some insertions and scores others; the keys of
the other kinds are those of their records: {kinds}.
"""


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page before any is read."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write(app: Sphinx) -> None:
    keep(app.srcdir / PAGE, "\n".join(_page()) + "\n")


def _page() -> Iterator[str]:
    records = {
        kind: f"{found.record.__module__}.{found.record.__qualname__}" for kind, found in KINDS.items()
    }
    yield OPENING.format(kinds=", ".join(f"{{py:obj}}`{kind} <{home}>`" for kind, home in records.items()))
    yield from ("| name | kind | what it asks |", "|---|---|---|")
    for name, said in _files("studies"):
        yield f"| `{name}` | {_cell(said, 'kind')} | {_cell(said, 'question', 'title')} |"
    for title, folder in FOLDERS.items():
        yield from ("", f"## {title}", "", "| name | what it is |", "|---|---|")
        yield from (f"| `{name}` | {_cell(said, 'title')} |" for name, said in _files(folder))


def _files(folder: str) -> Iterator[tuple[str, dict[str, object]]]:
    """Yield the name of every TOML file of a folder, and what it says."""
    for path in sorted((shipped() / folder).glob("*.toml")):
        yield path.stem, tomllib.loads(path.read_text(encoding="utf-8"))


def _cell(said: dict[str, object], *keys: str) -> str:
    found = next((str(said[key]) for key in keys if said.get(key)), "")
    return found.replace("|", r"\|").replace("_", r"\_")
