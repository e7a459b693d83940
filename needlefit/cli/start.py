"""`needlefit init` and `needlefit new dataset`: where a user's own work begins."""

import shlex
import shutil
from contextlib import suppress
from pathlib import Path

from needlefit.cli import screen
from needlefit.cli.options import argument, option, takes
from needlefit.errors import ConfigError
from needlefit.project.locate import PROJECT_FOLDERS, join_names, shipped_folder


@takes("verbose", folder=argument("DIR", "A folder; it is made if it is missing."))
def init(folder: Path) -> None:
    """Write an editable copy of the project to DIR.

    That is data/, configs/ and studies/; in DIR the program then uses those.
    """
    for written in copy_project(folder):
        screen.print_line(str(written))
    screen.print_note(f"edit them, then: {shlex.join(('cd', str(folder)))} && needlefit validate study3")


@takes(
    "verbose",
    folder=argument("DIR", "A folder that does not exist yet."),
    source=option(
        "Your centrelines: a CSV with columns x_mm, y_mm, z_mm (and id, if it holds several), a .mat file of "
        "N x 3 arrays, or a .mrk.json or .fcsv of 3D Slicer. For tables of any other layout: needlefit "
        "import.",
        "FILE",
        "--from",
    ),
)
def new_dataset(folder: Path, source: Path | None = None) -> None:
    """Write an example dataset to DIR, to be filled with your own measurements.

    It passes `needlefit check`; what you must fill in is marked TO FILL IN.
    """
    from needlefit.datasets.template import write_template

    screen.print_line(str(write_template(folder, source, screen.print_note)))
    path = str(folder) if folder.is_absolute() else f"./{folder}"
    screen.print_note(f"fill it in, then: {shlex.join(('needlefit', 'check', path))}")


MAX_LISTED_NAMES = 5  # files that a message names
_IGNORED = shutil.ignore_patterns(".*", "__pycache__", "*.partial")


def copy_project(folder: Path) -> list[Path]:
    """Copy the shipped `data/ configs/ studies/` into `folder`, which is made if it is missing.

    Hidden entries of `folder`, such as `.git`, stay beside them.

    ConfigError if `folder` is a file, the root or the user's home, or holds anything that is not hidden.
    """
    from needlefit.project.folders import create_folder, require_writable

    targets = [folder / part for part in PROJECT_FOLDERS]
    require_writable(folder)
    _require_unused(folder)
    for part, target in zip(PROJECT_FOLDERS, targets, strict=True):
        with create_folder(target) as fresh:
            shutil.copytree(shipped_folder() / part, fresh, ignore=_IGNORED, dirs_exist_ok=True)
    return targets


def _require_unused(folder: Path) -> None:
    """See that a project scatters no files among others: the folder is missing, empty, or a repository."""
    place, home = folder.resolve(), None
    with suppress(RuntimeError):  # the user may have none
        home = Path.home().resolve()
    if folder.exists() and not folder.is_dir():
        what = "exists already, and is a file"
    elif place == home:
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
