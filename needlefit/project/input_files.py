"""Read the bytes, text, JSON or TOML of a file that a stranger may have made.

Only regular files are opened, and only up to a stated size: a device may never end.
"""

import hashlib
import json
import os
import re
import stat
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache, wraps
from io import BytesIO, TextIOWrapper
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from needlefit.errors import ConfigError, DataError

MAX_CONFIG_BYTES = 8 * 2**20  # largest size of a TOML file (bytes)
MAX_TEXT_BYTES = 256 * 2**20  # largest size of a table, a list of markups or another text file (bytes)
MAX_FOLDER_FILES = 200_000  # largest number of files in a folder and its subfolders
SAVE_AS_UTF8 = 'save it as UTF-8 (in a spreadsheet: "CSV UTF-8")'

Content = TypeVar("Content")
FileErrorType = type[DataError] | type[ConfigError]


@contextmanager
def open_regular(
    path: Path, max_bytes: int, error: FileErrorType = DataError, where: str = ""
) -> Iterator[BinaryIO]:
    """Open a regular file of at most `max_bytes` for reading; messages name it by `where`, or its path.

    `error` (ConfigError for a file that configures, else DataError) if the file is missing, may not be read,
    is no regular file, or is larger.
    """
    where = where or str(path)
    try:  # without waiting for somebody who writes to a pipe
        file = os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb")
    except FileNotFoundError:
        raise error(
            "there is no such file", fix="check the name and the path, or restore the file", where=where
        ) from None
    except (OSError, ValueError) as fault:  # ValueError: a zero byte in the name
        raise unreadable_error(fault, error, where) from None
    with file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise error("is no regular file", expected="a file", fix="name a file", where=where)
        if status.st_size > max_bytes:
            raise _too_large(status.st_size, max_bytes, error, where)
        yield file


def read_bytes(
    path: Path, max_bytes: int = MAX_TEXT_BYTES, error: FileErrorType = DataError, where: str = ""
) -> bytes:
    """Return the bytes of a file; else as `open_regular`."""
    with open_regular(path, max_bytes, error, where) as file:
        size = os.fstat(file.fileno()).st_size
        try:
            data = file.read(size + 1)  # room for `max_bytes` would be made and given back, at 0.3 ms a file
            if len(data) > size:  # some file systems state no size
                data += file.read(max_bytes - size)
        except OSError as fault:
            raise unreadable_error(fault, error, where or str(path)) from None
    if len(data) > max_bytes:
        raise _too_large(len(data), max_bytes, error, where or str(path))
    return data


def read_text(
    path: Path, max_bytes: int = MAX_TEXT_BYTES, error: FileErrorType = DataError, where: str = ""
) -> str:
    """Return the text of a UTF-8 file, without a byte order mark; lines end as in Python.

    DataError or ConfigError as `open_regular`, or if the file is not UTF-8.
    """
    data = read_bytes(path, max_bytes, error, where)
    try:
        return TextIOWrapper(BytesIO(data), encoding="utf-8-sig").read()
    except UnicodeDecodeError as fault:
        raise error(
            f"cannot be read as text: the byte at position {fault.start} is not UTF-8",
            expected="UTF-8 text",
            fix=SAVE_AS_UTF8,
            where=where or str(path),
        ) from None


def read_json(path: Path, max_bytes: int = MAX_TEXT_BYTES) -> Any:  # noqa: ANN401 - whatever the file holds
    """Return the value in a JSON file; DataError as `read_text` and `parse_json`."""
    return parse_json(read_text(path, max_bytes), str(path))


def parse_json(text: str, where: str) -> Any:  # noqa: ANN401 - whatever the text holds
    """Return the value of a JSON text that stands at `where`; DataError if it is none."""
    try:
        return json.loads(text)
    except (RecursionError, ValueError) as fault:
        raise DataError(
            f"is not valid JSON: {fault}",
            expected="JSON",
            fix="restore the file, or save it again",
            where=where,
        ) from None


#: largest depth of tables and lists within each other; no file of needlefit has more than eight
MAX_NESTING = 50
# pattern of a key of thousands of parts, for which the parser would take the square of their number
_DEEP_KEY = re.compile(rf"""(?:\.\s*+(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')\s*+){{{MAX_NESTING}}}""")


# pattern of a line that gives a key numbers, or lists of them, as JSON writes them
_ARRAY = re.compile(
    r"^(\w++) = (\[(?:[-\d.eE, ]*+|(?:\[[-\d.eE, ]*+\],?+ ?+)++)\])$", re.ASCII | re.MULTILINE
)

_TABLE = re.compile(r"^[ \t]*\[", re.MULTILINE)


def _take_arrays(text: str) -> tuple[dict[str, Any], str]:
    """Return the arrays of numbers at the top of a TOML text, by key, and the text without them.

    The reader of JSON takes a tenth of the time of that of TOML. Lines of the text keep their numbers.
    """
    table = _TABLE.search(text)
    end = table.start() if table else len(text)
    top, rest = text[:end], text[end:]
    found = _ARRAY.findall(top)
    arrays = {}
    if len(dict(found)) == len(found) and '"""' not in top and "'''" not in top:
        with suppress(ValueError):  # numbers that only TOML has
            arrays = {key: json.loads(numbers) for key, numbers in found}
    return arrays, _ARRAY.sub("", top) + rest if arrays else text


def _list_members(value: object) -> list[Any]:
    return [*value.values()] if isinstance(value, dict) else value if isinstance(value, list) else []


def parse_toml(text: str, where: str, error: FileErrorType = ConfigError) -> dict[str, Any]:
    """Return the tables of a TOML text; `where` names it in errors, which are of `error`."""
    try:
        arrays, text = _take_arrays(text)
        tables = {} if (is_deep := _DEEP_KEY.search(text)) else tomllib.loads(text)
        level: list[Any] = [tables]
        for _ in range(MAX_NESTING):
            level = [inner for member in level for inner in _list_members(member)]
        if level or is_deep:
            raise ValueError(f"nested more than {MAX_NESTING} deep")
        if double := arrays.keys() & tables.keys():
            raise ValueError(f"key {min(double)} stands twice")
        return arrays | tables
    except (RecursionError, ValueError) as fault:
        raise error(
            f"is not valid TOML: {fault}",
            expected="TOML: key = value, texts in quotes",
            fix="correct it",
            where=where,
        ) from None


@contextmanager
def convert_stored_errors(where: Path | str) -> Iterator[None]:
    """Turn what is raised where the values of a stored file are parsed into a DataError that names the file.

    A file can hold what its declared form allows and its writer never wrote: an unknown word, a number that
    overflows.
    """
    try:
        yield
    except (OverflowError, TypeError, ValueError) as fault:
        raise DataError(
            f"holds values that needlefit cannot use ({type(fault).__name__})",
            expected="files as needlefit wrote them",
            fix="run it again",
            where=where,
        ) from fault


def path_exists(path: Path) -> bool:
    """Return whether there is a file or folder; False also where the name is too long or cannot be one."""
    try:
        return path.exists()
    except (OSError, ValueError):  # ValueError: it holds a zero byte
        return False


def read_once(read: Callable[[Path], Content]) -> Callable[[Path], Content]:
    """Return a reader that reads a file again only if it has changed; what it returns must not be changed."""
    read_version = lru_cache(maxsize=64)(lambda path, _size, _changed_ns: read(path))

    @wraps(read)
    def read_or_recall(path: Path) -> Content:
        if not is_file(path):
            return read(path)
        status = path.stat()
        return read_version(path, status.st_size, status.st_mtime_ns)

    return read_or_recall


def is_file(path: Path) -> bool:
    """Return whether there is a regular file; else as `path_exists`."""
    return path_exists(path) and path.is_file()


def is_dir(path: Path) -> bool:
    """Return whether there is a folder; else as `path_exists`."""
    return path_exists(path) and path.is_dir()


def list_files(folder: Path) -> list[Path]:
    """Return the files in a folder and its subfolders, sorted, without hidden ones and linked folders.

    DataError if a folder cannot be read, or there are too many files.
    """

    def fail(fault: OSError) -> None:
        raise unreadable_error(fault, DataError, str(fault.filename))

    files: list[Path] = []
    for place, folders, names in os.walk(folder, onerror=fail):
        folders[:] = [name for name in folders if not name.startswith(".")]
        paths = (Path(place, name) for name in names if not name.startswith("."))
        files += filter(is_file, paths)
        if len(files) > MAX_FOLDER_FILES:
            raise DataError(
                f"holds over {MAX_FOLDER_FILES} files",
                expected="the folder of one export",
                fix="name the folder in which the files lie",
                where=folder,
            )
    return sorted(files)


def unreadable_error(
    fault: OSError | ValueError, error: FileErrorType, where: str
) -> DataError | ConfigError:
    """Return the error for a file that the operating system does not give."""
    reason = "its name is not valid"
    if isinstance(fault, OSError):
        reason = fault.strerror or type(fault).__name__
    return error(
        f"cannot be read: {reason}",
        expected="a file that you may read",
        fix="check the path and its permissions",
        where=where if where.isprintable() else repr(where),
    )


def _too_large(size: int, max_bytes: int, error: FileErrorType, where: str) -> DataError | ConfigError:
    return error(
        f"is too large: {size / 2**20:.0f} MiB",
        expected=f"at most {max_bytes / 2**20:.0f} MiB",
        fix="check the file, or divide it",
        where=where,
    )


# ---- values as JSON knows them, and digests of them


def to_json_values(value: object) -> Any:  # noqa: ANN401 - of any type
    """Return mappings, lists, text, numbers and None; numpy's become Python's, NaN and infinity None.

    What is none of these becomes its text.
    """
    from pydantic_core import to_jsonable_python  # late: it takes a tenth of the time of --help

    return to_jsonable_python(value, inf_nan_mode="null", fallback=_to_plain)


def _to_plain(value: object) -> object:
    if hasattr(value, "tolist"):  # numpy arrays and scalars
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    return [*value] if isinstance(value, Iterable) else str(value)


def digest_values(values: object) -> str:
    """Return the SHA-256 of values as JSON has them; the order of keys does not count."""
    text = json.dumps(to_json_values(values), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
