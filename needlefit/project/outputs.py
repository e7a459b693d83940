"""Where results can be written: what is checked before hours of work, for every command."""

import os
import stat
from collections.abc import Iterable, Mapping
from itertools import combinations
from pathlib import Path

from needlefit.errors import ConfigError
from needlefit.project.input_files import path_exists

SCRATCH_NAME_BYTES = 24
"""What the name of a scratch folder, a checkpoint or a damaged one adds to that of a result."""

INNER_PATH_BYTES = 300
"""Length of the longest path that a result holds, from its own folder on."""

_MAX_NAME_BYTES, _MAX_PATH_BYTES = 255, 4096
"""Of a system that states neither."""


def require_writable(place: Path) -> None:
    """Raise ConfigError unless a file or folder can be made at `place`, with what is written beside it.

    Nothing is made: the nearest folder above that exists must be writable, and take the names.
    """
    if "\0" in str(place):
        raise not_writable_error(Path(repr(place.name)), "its name holds a zero byte")
    place = Path(os.path.realpath(place))  # what Path.resolve refuses is judged below
    if place == place.parent:
        raise not_writable_error(place, "it is the root of the file system")
    folder = place.parent
    while not path_exists(folder) and folder != folder.parent:
        folder = folder.parent
    effective = os.access in os.supports_effective_ids
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK, effective_ids=effective):
        raise not_writable_error(folder, "you may not write there" if folder.is_dir() else "it is a file")
    _require_names(place, folder)


def require_output_files(outputs: Mapping[str, Path], inputs: Iterable[Path]) -> None:
    """Raise ConfigError unless each file that an option names can be written, and is not an input.

    Parameters
    ----------
    outputs : mapping of option to path
    inputs : iterable of path
        Files that the run reads, and folders of such files.

    Raises
    ------
    ConfigError
        If a folder is missing or cannot be written to, or a file is a folder, an input (also by another
        name: a link), or named by two options.
    """
    sources = list(inputs)
    for option, path in outputs.items():
        require_folder(path)
        if path.is_dir():
            raise ConfigError(
                "is a folder",
                where=str(path),
                expected="the name of a file",
                fix=f"name a file with {option}",
            )
        _require_no_input(option, path, sources)
        if path_exists(path) and not stat.S_ISREG(path.stat().st_mode):
            continue  # a pipe or a terminal
        require_writable(path)
    for (one, path), (other, same) in combinations(outputs.items(), 2):
        if os.path.realpath(path) == os.path.realpath(same):
            raise ConfigError(
                f"is named by both {one} and {other}",
                where=str(path),
                expected="a file of its own for each",
                fix="choose another name for one of them",
            )


def require_folder(path: Path) -> None:
    """Raise ConfigError unless the folder of a file to write exists."""
    if not path.parent.is_dir():
        raise ConfigError("there is no such folder", where=str(path.parent), fix="make it first")


def require_no_inputs_within(folder: Path, inputs: Iterable[Path]) -> None:
    """Raise ConfigError if a folder that is to be replaced holds an input of the run."""
    place = Path(os.path.realpath(folder))
    for path in inputs:
        if Path(os.path.realpath(path)).is_relative_to(place):
            raise ConfigError(
                f"holds an input of this run: {path}",
                where=str(folder),
                expected="a folder of results that is not read",
                fix="choose another folder with --out",
            )


def not_writable_error(place: Path, reason: str) -> ConfigError:
    """Return what is raised of a place where nothing can be written."""
    return ConfigError(
        f"cannot be written to: {reason}",
        where=str(place),
        expected="a folder in which you may write",
        fix="choose another one with --out, or check its permissions",
    )


def _require_no_input(option: str, path: Path, inputs: Iterable[Path]) -> None:
    for source in inputs:
        if _is_same(path, source) or (source.is_dir() and _is_within(path, source)):
            raise ConfigError(
                f"is an input of this run, which {option} would replace",
                where=str(path),
                expected="a new file, or one that may be lost",
                fix=f"choose another name with {option}",
            )


def _is_same(path: Path, source: Path) -> bool:
    return path_exists(path) and path_exists(source) and path.samefile(source)


def _is_within(path: Path, folder: Path) -> bool:
    """Whether an existing file lies in a folder."""
    return path_exists(path) and Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))


def _require_names(place: Path, folder: Path) -> None:
    """See that the file system of `folder` takes the names from there to `place`, and what is beside it."""
    missing = place.relative_to(folder).parts
    most = _system_limit(folder, "PC_NAME_MAX", _MAX_NAME_BYTES)
    lengths = [len(os.fsencode(part)) for part in missing]
    if max(lengths) > most or lengths[-1] + SCRATCH_NAME_BYTES > most:
        raise _too_long(folder, f"a name of {max(lengths)} bytes", most - SCRATCH_NAME_BYTES)
    whole = len(os.fsencode(place))
    beside = SCRATCH_NAME_BYTES + lengths[-1] + INNER_PATH_BYTES
    longest = _system_limit(folder, "PC_PATH_MAX", _MAX_PATH_BYTES)
    if whole + beside > longest:
        raise _too_long(folder, f"a path of {whole} bytes", longest - beside)


def _system_limit(folder: Path, name: str, otherwise: int) -> int:
    try:
        stated = os.pathconf(folder, name)
    except (AttributeError, OSError, ValueError):  # Windows; a file system that does not say
        return otherwise
    return stated if stated > 0 else otherwise


def _too_long(folder: Path, what: str, most: int) -> ConfigError:
    return ConfigError(
        f"{what} is too long to write results under it",
        where=str(folder),
        expected=f"at most {most} bytes",
        fix="choose a shorter name",
    )
