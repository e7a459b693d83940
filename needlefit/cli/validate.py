"""`needlefit validate`: tune on these insertions, score on those, stand beside the paper."""

from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.completion import studies
from needlefit.cli.execution import Execution, require_converged
from needlefit.cli.show_validation import show_validation


def validate(
    context: typer.Context,
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY",
            autocompletion=studies,
            help="study1 ... study5, all (those five), another, or a path.",
        ),
    ],
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    out: options.Out = Path("reports"),
    reference: Annotated[
        bool, typer.Option("--reference", help="Write to OUT/reference/: evidence that is committed.")
    ] = False,
    resume: options.Resume = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Run a STUDY: tune on these, score on those.

    Prints and writes tables, figures and a PDF, with the paper's numbers beside ours.

    Ctrl-C once saves what is finished and prints the line that goes on; twice leaves at once.
    """
    from needlefit.project.load import load
    from needlefit.project.places import find_studies
    from needlefit.project.records.study import StudyRecord

    records = [(name, load(path, StudyRecord)) for name, path in find_studies(study)]
    folder = out / "reference" if reference else out
    execution = Execution(context.find_root().obj, folder, seed, jobs, resume)
    done = []
    for name, record in records:
        results = execution.run(name, record)
        if results.interrupted:
            raise execution.interrupted()
        written = execution.write(results)
        if not json:
            show_validation(results)
            screen.say(f"written: {written}/\n")
        done.append(results)
    if json:
        from needlefit.reporting.tables import records as rows
        from needlefit.reporting.tables import validation_table

        screen.show_json(rows(validation_table(*done)))
    if study == "all":
        from needlefit.reporting.write import write_all

        write_all(done, folder / "all")
    for results in done:  # not before all are done: `all` is resumed as a whole
        execution.forget(results.name)
    for results in done:
        require_converged(results)
