"""List, hash and remove files."""

import hashlib
import shutil
from collections.abc import Container
from pathlib import Path


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def remove_folder(folder: Path, last: Container[str]) -> None:
    """Remove a folder with all in it, the files called as `last` says at the end.

    These say whose it is: a removal that a kill or the disk cuts short can then be finished by the next run.
    Links are removed and not followed; OSError where something cannot be.
    """
    remove_contents(folder, last)
    folder.rmdir()


def remove_contents(folder: Path, last: Container[str], keep: Container[str] = ()) -> None:
    """Remove what lies in a folder but for the names `keep`; else as `remove_folder`."""
    for path in sorted(folder.iterdir(), key=lambda path: (path.name in last, path.name)):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif path.name not in keep:
            path.unlink()
