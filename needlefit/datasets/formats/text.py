"""A file as text, or why it is none."""

from io import BytesIO, TextIOWrapper
from pathlib import Path

from needlefit.datasets.formats.content import content
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
        return TextIOWrapper(BytesIO(content(path)), encoding="utf-8-sig").read()
    except UnicodeDecodeError as error:
        raise DataError(
            f"cannot be read as text: {error}", where=str(path), expected="UTF-8 text", mend=SAVE_AS
        ) from None
