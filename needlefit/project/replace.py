"""Replacing a folder that the program writes: whole, or not at all."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from needlefit.errors import ConfigError, DataError
from needlefit.project.load import read_toml


@contextmanager
def replacing_synthetic(folder: Path) -> Iterator[Path]:
    """Yield an empty folder that takes the place of `folder` when the block ends well.

    Raises
    ------
    DataError
        If `folder` holds anything but a synthetic dataset: measurements are never overwritten.
    """
    if folder.exists() and not _is_synthetic(folder):
        raise DataError(
            "holds something else than a synthetic dataset",
            where=str(folder),
            expected='no such folder, or one whose dataset.toml says origin = "synthetic"',
            mend="choose another folder with --out",
        )
    fresh = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    try:
        yield fresh
        shutil.rmtree(folder, ignore_errors=True)
        fresh.rename(folder)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _is_synthetic(folder: Path) -> bool:
    try:
        return read_toml(folder / "dataset.toml").get("origin") == "synthetic"
    except ConfigError:
        return False
