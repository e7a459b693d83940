"""`needlefit init` and `needlefit new dataset`: where a user's own work begins."""

import shlex
from pathlib import Path

from needlefit.cli import screen
from needlefit.cli.options import argument, option, takes


@takes("verbose", folder=argument("DIR", "A folder; it is made if it is missing."))
def init(folder: Path) -> None:
    """Write an editable copy of the project to DIR.

    That is data/, configs/ and studies/; in DIR the program then uses those.
    """
    from needlefit.project.init import copy_project

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
