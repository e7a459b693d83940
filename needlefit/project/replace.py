"""Writing a folder, or one file, whole or not at all."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from needlefit.errors import ConfigError
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
def replacing_own(folder: Path, why_not: Callable[[Path], str], expected: str) -> Iterator[Path]:
    """Yield what `replacing` does, for a folder that is empty or of which `why_not` finds nothing to say.

    Raises
    ------
    ConfigError
        As `require_own`, before and after: nothing of anybody's is ever deleted.
    """
    require_own(folder, why_not, expected)
    with replacing(folder) as fresh:
        yield fresh
        require_own(folder, why_not, expected)  # it takes a while: somebody may have put a file there


def require_own(folder: Path, why_not: Callable[[Path], str], expected: str) -> None:
    """Raise ConfigError if `folder` must not be replaced: `why_not` says why, `expected` what may be."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    why = why_not(folder) if folder.is_dir() else "it is a file"
    if why:
        raise ConfigError(
            f"is not replaced: {why}",
            where=str(folder),
            expected=expected,
            mend="choose another folder with --out, or move yours away",
        )


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
