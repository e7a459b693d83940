"""A file as text, or why it is none."""

from pathlib import Path

from needlefit.errors import DataError

SAVE_AS = 'save it as UTF-8 (in a spreadsheet: "CSV UTF-8")'


def read_text(path: Path) -> str:
    """Return the text of a UTF-8 file, without a byte order mark.

    Raises
    ------
    DataError
        If the file is missing, may not be read, or is no UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise DataError(
            "there is no such file",
            where=str(path),
            mend="check its name against dataset.toml, or restore it",
        ) from None
    except UnicodeDecodeError as error:
        raise DataError(
            f"cannot be read as text: {error}", where=str(path), expected="UTF-8 text", mend=SAVE_AS
        ) from None
    except OSError as error:
        raise DataError(
            f"cannot be read: {error.strerror}",
            where=str(path),
            expected="a file that you may read",
            mend="check what it is, and its permissions",
        ) from None
