"""What a folder holds, and what a file's bytes sum up to."""

import hashlib
from pathlib import Path


def held(folder: Path) -> list[str]:
    """Return the files (and links) in a folder, relative to it, sorted."""
    paths = (path for path in sorted(folder.rglob("*")) if path.is_symlink() or not path.is_dir())
    return [path.relative_to(folder).as_posix() for path in paths]


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
