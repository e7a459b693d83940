"""On which line of a TOML file a key stands, for messages: tomllib does not say."""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from needlefit.errors import ConfigError, NeedlefitError
from needlefit.project.input_files import MAX_CONFIG_BYTES, read_text
from needlefit.project.locate import file_label

MAX_CANDIDATE_LINES = 100
"""Lines that are tried; a key that is repeated more often gets no line."""

MAX_STATEMENT_LINES = 400
"""Lines of one key and its value."""


def find_line(text: str, key: str) -> int | None:
    """Return the line, from 1, on which a key of a TOML text stands; of a missing key that of its table.

    `key` is dotted, members of lists are numbered from 1: `tune.medium`, `validate.2.layers`. None where
    the text does not hold even the key's first part.
    """
    try:
        parts = _known_parts(tomllib.loads(text), key.split("."))
    except (ValueError, RecursionError):
        return None
    named = [part for part in parts if isinstance(part, str)]
    if not named:
        return None
    lines = text.splitlines()
    candidates = [number for number, line in enumerate(lines) if named[-1] in line]
    for number in dict.fromkeys(_statement_start(lines, one) for one in candidates[:MAX_CANDIDATE_LINES]):
        if _statement_sets(lines, number, parts):
            return number + 1
    return None


def _known_parts(tables: object, parts: Sequence[str]) -> list[str | int]:
    """Return the parts of a key as far as the tables hold them, places in lists from 0."""
    known: list[str | int] = []
    while parts:
        part: str | int = parts[0]
        if isinstance(tables, list) and parts[0].isdigit() and 0 < int(parts[0]) <= len(tables):
            part = int(parts[0]) - 1
            tables, parts = tables[part], parts[1:]
        elif isinstance(tables, dict):  # a name may hold points itself
            names = (".".join(parts[:count]) for count in range(1, len(parts) + 1))
            found = next((name for name in names if name in tables), None)
            if found is None:
                break
            part, tables, parts = found, tables[found], parts[found.count(".") + 1 :]
        else:
            break
        known.append(part)
    return known


def _statement_start(lines: Sequence[str], number: int) -> int:
    """Return the line, from 0, on which the statement begins that a line belongs to."""
    first = max(0, number - MAX_STATEMENT_LINES)
    return next((n for n in range(number, first, -1) if _contains_key(lines[:n], ()) is not None), first)


def _statement_sets(lines: Sequence[str], number: int, parts: Sequence[str | int]) -> bool:
    """Whether the statement that begins on a line gives the key its value."""
    for end in range(number + 1, min(len(lines), number + MAX_STATEMENT_LINES) + 1):
        held = _contains_key(lines[:end], parts)
        if held is not None:
            return held
    return False


def _contains_key(lines: Sequence[str], parts: Sequence[str | int]) -> bool | None:
    """Whether the first lines of a file hold a key; None where they end within a statement."""
    try:
        value: object = tomllib.loads("\n".join(lines))
    except ValueError:
        return None
    for part in parts:
        try:
            value = value[part]  # type: ignore[index]
        except (KeyError, IndexError, TypeError):
            return False
    return True


def locate_key(path: Path, key: str) -> str:
    """Return how messages name a key of a TOML file: file and line, or the file where no line is known."""
    try:
        line = find_line(read_text(path, MAX_CONFIG_BYTES), key)
    except NeedlefitError:
        line = None
    name = file_label(path)
    if line is None:
        return name
    return f"{name}:{line}" if name == str(path) else f"{name}, line {line}"


@contextmanager
def add_file_context(path: Path) -> Iterator[None]:
    """Have every ConfigError from within that names only a key name this file, and the key's line."""
    try:
        yield
    except ConfigError as error:
        if not error.key:
            raise
        located = error.at(locate_key(path, error.key))
        located.key = ""  # of this file: no other is looked through for it
        raise located from None


@contextmanager
def add_key_context(key: str) -> Iterator[None]:
    """Have every ConfigError from within that names no place name this key of the file read."""
    try:
        yield
    except ConfigError as error:
        if error.where or error.key:
            raise
        error.key = key
        raise


@contextmanager
def renamed_keys(names: Mapping[str, str]) -> Iterator[None]:
    """Have every ConfigError from within that names no place name its key as the file read calls it."""
    try:
        yield
    except ConfigError as error:
        first, dot, rest = error.key.partition(".")
        if not error.where and first in names:
            error.key = f"{names[first]}{dot}{rest}"
        raise


@contextmanager
def add_study_context(study: str, key: str = "") -> Iterator[None]:
    """Give every ConfigError raised inside, if it names no place, this study and the key of its file."""
    try:
        yield
    except ConfigError as error:
        if error.where:
            raise
        error.key = error.key or key
        raise error.at(describe_key(study, error.key)) from None


def describe_key(study: str, key: str = "") -> str:
    """Return the name of a study file's key for messages."""
    return f"study {study}, key `{key}`" if key else f"study {study}"
