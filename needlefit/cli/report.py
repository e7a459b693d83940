"""`needlefit report`: tables, figures and report of a run again, from what it stored."""

from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.options import complete_runs


def report(
    run: Annotated[
        str,
        typer.Argument(
            metavar="RUN",
            autocompletion=complete_runs,
            help="A folder of results, or its bare name in reports/.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write to this folder; the run's own by default."),
    ] = None,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Write tables, figures and report of a RUN again, without fitting anything.

    From the stored results, exact to the last digit: as after an update that draws figures differently, or
    where files were lost. A file that was changed is never replaced: remove it first. `all` is made again
    from the runs beside it.
    """
    from needlefit.project.locate import find_run
    from needlefit.reporting.rebuild import rebuild
    from needlefit.validation.csv_tables import find_damaged_files

    folder = find_run(run)
    damaged = find_damaged_files(folder)
    written = rebuild(folder, folder if out is None else out)
    for name, what in damaged.items():
        screen.print_note(f"needlefit: damaged, and not used: {folder}/{name} {what}")
    screen.print_line(f"written: {written}/")
