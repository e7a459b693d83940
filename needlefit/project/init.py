"""An editable copy of the shipped project."""

import shutil
from pathlib import Path

from needlefit.errors import ConfigError
from needlefit.project.places import PARTS, shipped
from needlefit.project.replace import new_folder

_IGNORED = shutil.ignore_patterns(".*", "__pycache__", "*.partial")


def copy_project(folder: Path) -> list[Path]:
    """Copy the shipped `data/ configs/ studies/` into `folder`, which is made if it is missing.

    Returns
    -------
    list of Path
        The folders written.

    Raises
    ------
    ConfigError
        If one of them exists already: nothing is ever overwritten.
    """
    targets = [folder / part for part in PARTS]
    taken = [str(target) for target in targets if target.exists()]
    if taken or (folder.exists() and not folder.is_dir()):
        raise ConfigError(
            "exists already",
            where=", ".join(taken or [str(folder)]),
            expected="a folder without data, configs and studies",
            mend="choose another folder",
        )
    for part, target in zip(PARTS, targets, strict=True):
        with new_folder(target) as fresh:
            shutil.copytree(shipped() / part, fresh, ignore=_IGNORED, dirs_exist_ok=True)
    return targets
