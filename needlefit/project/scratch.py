"""Folders in which something is written until it is whole; those that a killed process left are removed."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO

from needlefit.errors import ConfigError

try:
    import fcntl
except ImportError:  # Windows: what is left stays, since nothing says safely that its owner is gone
    fcntl = None  # type: ignore[assignment]

NEW, OLD = "new", "old"
"""In a scratch folder: where something is written, and where goes what it takes the place of."""

LOCK = "lock"
"""A file in it that its process holds locked; the lock goes with the process, however that ends."""


@contextmanager
def scratch(place: Path) -> Iterator[Path]:
    """Yield a folder beside `place`, on the same disk, with an empty folder `NEW`; it goes when it is left.

    Raises
    ------
    ConfigError
        If nothing can be written there.
    """
    with _made(place) as made, _locked(Path(made)):
        Path(made, NEW).mkdir()
        yield Path(made)


def _made(place: Path) -> "TemporaryDirectory[str]":
    prefix = f".{place.name}.needlefit-"
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with suppress(OSError):
            _remove_left(place, prefix)
        return TemporaryDirectory(prefix=prefix, dir=place.parent)
    except OSError as error:
        raise ConfigError(
            f"cannot be written: {error.strerror}",
            where=str(place),
            expected="a folder in which you may write",
            mend="choose another one, or check its permissions",
        ) from None


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a scratch folder; it gets its name when it is held, lest another process takes it."""
    if fcntl is None:
        yield
        return
    with Path(folder, f"{LOCK}.new").open("w") as file:
        with suppress(OSError):  # a disk without locks: the folder has none then, and nobody else removes it
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            Path(file.name).rename(folder / LOCK)
        yield


def _remove_left(place: Path, prefix: str) -> None:
    """Remove the scratch folders of `place` whose process has ended."""
    for folder in place.parent.iterdir():
        if not folder.name.startswith(prefix) or not (folder / LOCK).is_file():
            continue
        if (folder / OLD).exists() and not place.exists():
            continue  # killed between two renamings: it holds the only copy
        with suppress(OSError), (folder / LOCK).open("r+") as file:
            if _free(file):
                shutil.rmtree(folder)


def _free(file: IO[str]) -> bool:
    """Whether nobody holds a lock; if so it is held here until the file is closed."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
