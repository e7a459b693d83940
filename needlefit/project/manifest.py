"""A folder that lists its own files, so that it can be replaced when nobody has changed any of them."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from needlefit.errors import DataError
from needlefit.project import replace
from needlefit.project.files import held, sha256
from needlefit.project.reading import read_json

_EXPECTED = "no such folder, an empty one, or one whose files are those of its {}"


@contextmanager
def replacing_own(folder: Path, name: str) -> Iterator[Path]:
    """Yield what `replace.replacing_own` does, for a folder that holds only what its manifest `name` lists.

    Raises
    ------
    ConfigError
        If `folder` holds a file that was not written there, or was changed since.
    """
    with replace.replacing_own(folder, partial(_foreign, name), _EXPECTED.format(name)) as fresh:
        yield fresh


def require_own(folder: Path, name: str) -> None:
    """Raise ConfigError if `folder` holds more or other than its manifest `name` says."""
    replace.require_own(folder, partial(_foreign, name), _EXPECTED.format(name))


def write_manifest(folder: Path, name: str, said: Mapping[str, Any]) -> None:
    """Write the manifest `name` of all files in `folder` as JSON: their SHA-256, after what is `said`."""
    files = {file: sha256(folder / file) for file in held(folder)}
    text = json.dumps({**said, "files": files}, indent=2, ensure_ascii=False, allow_nan=False)
    (folder / name).write_bytes(text.encode("utf-8") + b"\n")


def _foreign(name: str, folder: Path) -> str:
    """Return why a folder is not, or not only, what its manifest lists; empty if it is."""
    try:
        listed = read_json(folder / name)["files"]
    except (DataError, KeyError, TypeError):
        return f"it holds no {name} that can be read"
    for file in held(folder):
        if file == name:
            continue
        if file not in listed:
            return f"{file} was put there by somebody else"
        if listed[file] != sha256(folder / file):
            return f"{file} was changed since it was written"
    return ""
