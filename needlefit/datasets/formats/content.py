"""A file's bytes, or why they cannot be had."""

from pathlib import Path

from needlefit.errors import DataError


def content(path: Path) -> bytes:
    """Return the bytes of a file.

    Raises
    ------
    DataError
        If the file is missing or may not be read.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise DataError(
            "there is no such file",
            where=str(path),
            mend="check its name against dataset.toml, or restore it",
        ) from None
    except OSError as error:
        raise DataError(
            f"cannot be read: {error.strerror}",
            where=str(path),
            expected="a file that you may read",
            mend="check what it is, and its permissions",
        ) from None
