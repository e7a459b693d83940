"""Read the bytes, text, JSON or TOML of a file that a stranger may have made.

Only regular files are opened, and only up to a stated size: a device may never end.
A message about a file that cannot be parsed names the line and the column, and prints none of the content.
"""

import json
import math
import os
import re
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO, TextIOWrapper
from pathlib import Path
from typing import Any, BinaryIO

from needlefit.errors import ConfigError, DataError, NeedlefitError

MAX_CONFIG_BYTES = 8 * 2**20  # size of a TOML file
MAX_TEXT_BYTES = 256 * 2**20  # size of a table, a list of markups or another text file
MAX_NESTING_LEVELS = 64  # depth to which tables and lists of a TOML or JSON file may be nested
MAX_FOLDER_FILES = 200_000
MAX_FOLDER_LEVELS = 32  # files in a folder and its subfolders, and how deep these may be nested
SAVE_AS_UTF8 = 'save it as UTF-8 (in a spreadsheet: "CSV UTF-8")'

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
)
_INT64 = 2**63
_DEEP_KEY = re.compile(
    r"""(?<![\w-])(?>(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){%d}""" % MAX_NESTING_LEVELS  # noqa: UP031
)
_KEY_WITH_NUMBERS = re.compile(r"([A-Za-z0-9_-]+) = ([-+.,eE0-9 \[\]]+)")
_PLACE = re.compile(r" \(at (line \d+, column \d+|end of document)\)$")

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
    try:
        _require_regular(path.stat().st_mode, error, where)  # some devices act on being opened
        file = os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb")
    except FileNotFoundError:
        raise error(
            "there is no such file", where=where, fix="check the name and the path, or restore the file"
        ) from None
    except (OSError, ValueError) as fault:  # ValueError: a zero byte in the name
        raise unreadable_error(fault, error, where) from None
    with file:
        status = os.fstat(file.fileno())
        _require_regular(status.st_mode, error, where)  # it may have been exchanged in between
        if status.st_size > max_bytes:
            raise _too_large(status.st_size, max_bytes, error, where)
        yield file


def read_bytes(
    path: Path, max_bytes: int = MAX_TEXT_BYTES, error: FileErrorType = DataError, where: str = ""
) -> bytes:
    """Return the bytes of a file; else as `open_regular`."""
    with open_regular(path, max_bytes, error, where) as file:
        try:
            data = file.read(max_bytes + 1)
        except OSError as fault:
            raise unreadable_error(fault, error, where or str(path)) from None
    if len(data) > max_bytes:  # some file systems state no size
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
            where=where or str(path),
            expected="UTF-8 text",
            fix=SAVE_AS_UTF8,
        ) from None


def read_json(path: Path, max_bytes: int = MAX_TEXT_BYTES) -> Any:  # noqa: ANN401 - whatever the file holds
    """Return the value in a JSON file; DataError as `read_text` and `parse_json`."""
    return parse_json(read_text(path, max_bytes), str(path))


def parse_json(text: str, where: str) -> Any:  # noqa: ANN401 - whatever the text holds
    """Return the value of a JSON text that stands at `where`.

    DataError if it is not JSON, nested beyond `MAX_NESTING_LEVELS`, or holds a number too long to read.
    """
    try:
        value = json.loads(text)
    except json.JSONDecodeError as fault:
        reason = f"{fault.msg}, line {fault.lineno}, column {fault.colno}"
    except RecursionError:
        reason = f"nested deeper than {MAX_NESTING_LEVELS} levels"
    except ValueError:
        reason = "it holds a number of too many digits"
    else:
        reason = _find_excess(value)
        if not reason:
            return value
    raise DataError(
        f"is not valid JSON: {reason}",
        where=where,
        expected="JSON",
        fix="restore the file, or save it again from the program that made it",
    )


def read_toml(path: Path, error: FileErrorType = ConfigError, where: str = "") -> dict[str, Any]:
    """Return the tables of a TOML file.

    ConfigError or DataError as `read_text`, or if it is not TOML, nested beyond `MAX_NESTING_LEVELS`, or
    holds an integer beyond 64 bits.
    """
    return parse_toml(read_text(path, MAX_CONFIG_BYTES, error, where), where or str(path), error)


def parse_toml(text: str, where: str, error: FileErrorType = ConfigError) -> dict[str, Any]:
    """Return the tables of a TOML text; `where` and else as `read_toml`."""
    try:
        if _DEEP_KEY.search(text):  # tomllib copies a key with many dots once for every part
            raise RecursionError
        tables = _loads_numbers(text) or tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        reason = _toml_reason(str(fault))
    except RecursionError:
        reason = f"nested deeper than {MAX_NESTING_LEVELS} levels"
    except ValueError:
        reason = "it holds a number or a date that does not exist"
    else:
        reason = _find_excess(tables, _INT64)
        if not reason:
            return tables
    raise error(
        f"is not valid TOML: {reason}",
        where=where,
        expected="TOML: key = value, texts in quotes",
        fix="correct the line named" if "line" in reason else "correct it",
    )


def _loads_numbers(text: str) -> dict[str, Any]:
    """Return the values of a text in which every line is a key with numbers; nothing of any other.

    Such lines mean the same to the JSON parser, which reads long lists thirty times as fast as tomllib.
    """
    lines = [_KEY_WITH_NUMBERS.fullmatch(line) for line in text.rstrip("\n").split("\n")]
    try:
        found = {line[1]: json.loads(line[2]) for line in lines if line}
    except (ValueError, RecursionError):
        return {}
    return found if len(found) == len(lines) else {}


@contextmanager
def convert_stored_errors(where: Path | str) -> Iterator[None]:
    """Turn what is raised where the values of a stored file are used into a DataError that names the file.

    A file can hold what its declared form allows and its writer never wrote: an unknown word, a number that
    overflows. Errors of needlefit, and of the system (a full disk), pass unchanged.

    DataError for everything else; the first exception is its cause.
    """
    try:
        yield
    except (NeedlefitError, OSError):
        raise
    except Exception as fault:
        raise DataError(
            f"holds values that needlefit cannot use ({type(fault).__name__})",
            where=str(where),
            expected="files as needlefit wrote them",
            fix="run it again, or take them from a copy; if nobody changed them, this is an error of "
            "needlefit: needlefit -v shows where",
        ) from fault


def path_exists(path: Path) -> bool:
    """Return whether there is a file or folder; False also where the name is too long or cannot be one."""
    try:
        return path.exists()
    except (OSError, ValueError):  # ValueError: it holds a zero byte
        return False


def is_file(path: Path) -> bool:
    """Return whether there is a regular file; else as `path_exists`."""
    return path_exists(path) and path.is_file()


def is_dir(path: Path) -> bool:
    """Return whether there is a folder; else as `path_exists`."""
    return path_exists(path) and path.is_dir()


def list_files(folder: Path) -> list[Path]:
    """Return the files in a folder and its subfolders, sorted, without hidden ones and linked folders.

    DataError if a folder cannot be read, or there are too many files or levels.
    """
    found: list[Path] = []
    waiting = [(folder, 0)]
    while waiting:
        here, level = waiting.pop()
        try:
            entries = [one for one in os.scandir(here) if not one.name.startswith(".")]
            found += [Path(one.path) for one in entries if one.is_file()]
            waiting += [(Path(one.path), level + 1) for one in entries if one.is_dir(follow_symlinks=False)]
        except OSError as fault:
            raise unreadable_error(fault, DataError, str(here)) from None
        if len(found) > MAX_FOLDER_FILES or level > MAX_FOLDER_LEVELS:
            raise DataError(
                f"holds over {MAX_FOLDER_FILES} files, or folders nested deeper than {MAX_FOLDER_LEVELS}",
                where=str(folder),
                expected="the folder of one export",
                fix="name the folder in which the files lie",
            )
    return sorted(found)


def unreadable_error(
    fault: OSError | ValueError, error: FileErrorType, where: str
) -> DataError | ConfigError:
    """Return the error for a file that the operating system does not give."""
    reason = "its name is not valid"
    if isinstance(fault, OSError):
        reason = fault.strerror or type(fault).__name__
    return error(
        f"cannot be read: {reason}",
        where=where if where.isprintable() else repr(where),
        expected="a file that you may read",
        fix="check the path and its permissions",
    )


def _require_regular(mode: int, error: FileErrorType, where: str) -> None:
    if stat.S_ISREG(mode):
        return
    kind = next((name for test, name in _KINDS if test(mode)), "not a regular file")
    raise error(f"is {kind}", where=where, expected="a regular file", fix="name a file")


def _too_large(size: int, max_bytes: int, error: FileErrorType, where: str) -> DataError | ConfigError:
    return error(
        f"is too large: {size / 2**20:.0f} MiB",
        where=where,
        expected=f"at most {max_bytes / 2**20:.0f} MiB",
        fix="check that it is the file that you meant, or divide it",
    )


def _toml_reason(message: str) -> str:
    """Return what tomllib says, without what it quotes of the file.

    Behind "Expected" it quotes its own grammar.
    """
    place = _PLACE.search(message)
    text = message[: place.start()] if place else message
    kept = text if text.startswith("Expected ") or not {"'", '"'} & set(text) else ""
    return ", ".join(part for part in (kept, place[1] if place else "") if part) or "no reason given"


def _find_excess(value: object, most: float = math.inf) -> str:
    """Return what is wrong with a value: nested too deeply, or an integer from `most` on, else nothing."""
    level = [value] if isinstance(value, dict | list) else []
    for _ in range(MAX_NESTING_LEVELS):
        inner = [one for outer in level for one in (outer.values() if isinstance(outer, dict) else outer)]
        if most < math.inf and any(isinstance(one, int) and not -most <= one < most for one in inner):
            return "it holds an integer beyond 64 bits"  # which tomllib takes
        level = [one for one in inner if isinstance(one, dict | list)]
    return f"nested deeper than {MAX_NESTING_LEVELS} levels" if level else ""
