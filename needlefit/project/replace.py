"""Writing a folder, or one file, whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from needlefit.project.scratch import NEW, OLD, scratch


@contextmanager
def replacing(folder: Path) -> Iterator[Path]:
    """Yield an empty folder, of the same name, that takes the place of `folder` when the block ends well.

    It stands beside `folder` until then, so that a failure leaves nothing behind and the old one as it was;
    what a killed process left the next one removes. What may be replaced the caller decides before. A block
    that writes nothing replaces nothing.

    Raises
    ------
    ConfigError
        If nothing can be written there.
    """
    folder = folder.resolve()
    with scratch(folder) as beside:
        fresh, old = beside / NEW / folder.name, beside / OLD
        fresh.mkdir()
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
    with scratch(file) as beside:
        fresh = beside / NEW / file.name
        yield fresh
        fresh.replace(file)
