"""Writing a folder, or one file, whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from needlefit.errors import ConfigError


@contextmanager
def replacing(folder: Path) -> Iterator[Path]:
    """Yield an empty folder, of the same name, that takes the place of `folder` when the block ends well.

    It stands beside `folder` until then, so that a failure leaves nothing behind and the old one as it was.
    What may be replaced the caller decides before. A block that writes nothing replaces nothing.

    Raises
    ------
    ConfigError
        If nothing can be written there.
    """
    folder = folder.resolve()
    with _scratch(folder) as scratch:
        fresh, old = Path(scratch, "new", folder.name), Path(scratch, "old")
        fresh.mkdir(parents=True)
        yield fresh
        if not any(fresh.iterdir()):
            return
        if not folder.exists():
            fresh.rename(folder)
            return
        folder.rename(old)
        try:
            fresh.rename(folder)
        except BaseException:
            old.rename(folder)
            raise


@contextmanager
def replacing_file(file: Path) -> Iterator[Path]:
    """Yield a path, of the same name, whose file takes the place of `file` when the block ends well.

    Raises
    ------
    ConfigError
        If nothing can be written there.
    """
    file = file.resolve()
    with _scratch(file) as scratch:
        fresh = Path(scratch, file.name)
        yield fresh
        fresh.replace(file)


def _scratch(folder: Path) -> "TemporaryDirectory[str]":
    """Return a folder beside `folder`, on the same disk, that goes when it is left."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        return TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent)
    except OSError as error:
        raise ConfigError(
            f"cannot be written: {error.strerror}",
            where=str(folder),
            expected="a folder in which you may write",
            mend="choose another one, or check its permissions",
        ) from None
