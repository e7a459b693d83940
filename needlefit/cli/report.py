"""`needlefit report`: tables, figures and report of a run again, from what it stored."""

from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.show_results import show_run


def report(
    context: typer.Context,
    run: options.RunFolder,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write to this folder; the run's own by default."),
    ] = None,
    paper: Annotated[
        Path | None,
        typer.Option(
            "--paper",
            metavar="DIR",
            help="Also write figures 3.5 and 7.16 in wide, LaTeX files and an example to a new folder.",
        ),
    ] = None,
    latex: Annotated[
        Path | None,
        typer.Option(
            "--latex",
            metavar="PDF",
            help="Also compile the example, a paper of all tables and figures. Needs LaTeX.",
        ),
    ] = None,
    explain: options.Explain = False,
    strict: options.Strict = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Write tables, figures and report of a RUN again, and print it, without fitting anything.

    From the stored results, exact to the last digit: as after an update that draws figures differently, or
    where files were lost. A file that was changed is never replaced: remove it first. `all` is made again
    from the runs beside it.
    """
    from needlefit.project.locate import find_run
    from needlefit.studies.csv_tables import find_damaged_files
    from needlefit.studies.rebuild import rebuild

    folder = find_run(run)
    damaged = find_damaged_files(folder)
    written = folder if out is None else out
    runs = rebuild(folder, written)
    for one in runs:
        show_run(context.find_root().obj, one, written, named=len(runs) > 1)
    for name, what in damaged.items():
        screen.print_note(f"needlefit: damaged, and not used: {folder}/{name} {what}")
    if paper is not None:
        from needlefit.studies.paper_folder import write_paper_folder

        for one in runs:
            several = len(runs) > 1
            write_paper_folder(
                one, folder.parent / one.name if several else written, paper / one.name if several else paper
            )
        screen.print_line(f"written: {paper}")
    if latex is not None:
        from needlefit.reporting.paper_example import compile_example

        compile_example(written if paper is None else paper, latex)
        screen.print_line(f"written: {latex}")
