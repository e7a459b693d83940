"""A folder that lists its own files, so that it can be replaced when nobody has changed any of them."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from needlefit.errors import ConfigError
from needlefit.project.replace import replacing


@contextmanager
def replacing_own(folder: Path, name: str) -> Iterator[Path]:
    """Yield what `replacing` does, for a folder that is empty or holds only what its manifest `name` lists.

    Raises
    ------
    ConfigError
        If `folder` holds a file that was not written there, or was changed since: nothing of anybody's is
        ever deleted.
    """
    require_own(folder, name)
    with replacing(folder) as fresh:
        yield fresh
        require_own(folder, name)  # it takes a while: somebody may have put a file there


def write_manifest(folder: Path, name: str, said: Mapping[str, Any]) -> None:
    """Write the manifest `name` of all files in `folder` as JSON: their SHA-256, after what is `said`."""
    files = {path.relative_to(folder).as_posix(): _sha256(path) for path in _files(folder)}
    text = json.dumps({**said, "files": files}, indent=2, ensure_ascii=False, allow_nan=False)
    (folder / name).write_bytes(text.encode("utf-8") + b"\n")


def require_own(folder: Path, name: str) -> None:
    """Raise ConfigError if `folder` holds more or other than its manifest `name` says."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    why = _foreign(folder, name)
    if why:
        raise ConfigError(
            f"is not replaced: {why}",
            where=str(folder),
            expected=f"no such folder, an empty one, or one whose files are those of its {name}",
            mend="choose another folder with --out, or move yours away",
        )


def _foreign(folder: Path, name: str) -> str:
    if not folder.is_dir():
        return "it is a file"
    try:
        listed = json.loads((folder / name).read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError):
        return f"it holds no {name} that can be read"
    for path in _files(folder):
        file = path.relative_to(folder).as_posix()
        if file == name:
            continue
        if file not in listed:
            return f"{file} was put there by somebody else"
        if listed[file] != _sha256(path):
            return f"{file} was changed since it was written"
    return ""


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
