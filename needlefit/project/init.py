"""An editable copy of the shipped project."""

import shutil
from pathlib import Path

from needlefit.errors import ConfigError
from needlefit.project.folders import create_folder, require_writable
from needlefit.project.locate import PROJECT_FOLDERS, join_names, shipped_folder

MAX_LISTED_NAMES = 5
"""Files that a message names."""

_IGNORED = shutil.ignore_patterns(".*", "__pycache__", "*.partial")


def copy_project(folder: Path) -> list[Path]:
    """Copy the shipped `data/ configs/ studies/` into `folder`, which is made if it is missing.

    Hidden entries of `folder`, such as `.git`, stay beside them.

    Returns
    -------
    list of Path
        The folders written.

    Raises
    ------
    ConfigError
        If `folder` is a file, the root or the user's home, or holds anything that is not hidden.
    """
    targets = [folder / part for part in PROJECT_FOLDERS]
    require_writable(folder)
    _require_unused(folder)
    for part, target in zip(PROJECT_FOLDERS, targets, strict=True):
        with create_folder(target) as fresh:
            shutil.copytree(shipped_folder() / part, fresh, ignore=_IGNORED, dirs_exist_ok=True)
    return targets


def _require_unused(folder: Path) -> None:
    """See that a project scatters no files among others: the folder is missing, empty, or a repository."""
    place = folder.resolve()
    if folder.exists() and not folder.is_dir():
        what = "exists already, and is a file"
    elif _is_home(place):
        what = "is your home folder"
    else:
        held = sorted(folder.iterdir()) if folder.is_dir() else []
        shown = [str(path) for path in held if not path.name.startswith(".")]
        if not shown:
            return
        what = f"exists already, and holds {join_names(shown, MAX_LISTED_NAMES)}"
    raise ConfigError(
        what,
        where=str(folder),
        expected="a new folder, or an empty one",
        fix="choose another folder: nothing is overwritten",
    )


def _is_home(place: Path) -> bool:
    try:
        return place == Path.home().resolve()
    except RuntimeError:  # the user has none
        return False
