"""`needlefit validate`: tune on these insertions, score on those, stand beside the paper."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.completion import studies
from needlefit.cli.execution import Execution, require_converged
from needlefit.cli.interruption import stopping
from needlefit.cli.show_validation import show_validation
from needlefit.cli.validate_inquiry import validate_inquiry
from needlefit.cli.validate_tracks import observes_tracks, validate_tracks

if TYPE_CHECKING:
    from needlefit.project.records.fit import FitRecord
    from needlefit.project.records.inquiry import InquiryRecord
    from needlefit.project.records.study import StudyRecord
    from needlefit.validation.results import Results


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
    sample: options.Sample = False,
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

    `all` runs the paper's five, and the fits that fill its tuning tables.

    Prints and writes tables, figures and a PDF, with the paper's numbers beside ours, and slicer/: every
    needle, measured and predicted with its 95 % band, for 3D Slicer.

    Ctrl-C once saves what is finished and prints the line that goes on; twice leaves at once.
    """
    folder = out / "reference" if reference else out
    from needlefit.project.places import find_studies

    with stopping() as stop:  # from here on, so that Ctrl-C never cuts an import in two
        execution = Execution(context.find_root().obj, folder, seed, jobs, resume, stop, sample)
        (name, path), *_ = find_studies(study)
        if observes_tracks(path):
            validate_tracks(execution, name, path, json)
            return
        if (record := _inquiry(path)) is not None:
            validate_inquiry(execution, name, record, json)
            return
        done = _run(execution, study, json)
        for results in done:  # not before all are done: `all` is resumed as a whole
            execution.forget(results.name)
    for results in done:
        require_converged(results)


def _inquiry(path: Path) -> "InquiryRecord | None":
    from needlefit.validation.inquiries.kinds import inquiry

    return inquiry(path)


def _run(execution: Execution, study: str, json: bool) -> "list[Results]":
    """Run, write and print the studies, and for `all` the fits of the paper's tuning tables too."""
    from needlefit.project.load import load
    from needlefit.project.places import find_studies, find_tunings
    from needlefit.project.records.fit import FitRecord
    from needlefit.project.records.study import StudyRecord

    studies = [(name, load(path, StudyRecord)) for name, path in find_studies(study)]
    tunings = [(name, load(path, FitRecord)) for name, path in find_tunings(study)]
    execution.prepare([*(name for name, _ in [*studies, *tunings]), *["all"] * (study == "all")])
    scored = [_carry_out(execution, name, record, json) for name, record in studies]
    tuned = [_carry_out(execution, name, record, json) for name, record in tunings]
    if study == "all":
        _write_all(execution, scored, tuned, json)
    if json:
        from needlefit.reporting.tables import records, validation_table

        screen.show_json(records(validation_table(*scored)))
    return [*scored, *tuned]


def _carry_out(execution: Execution, name: str, record: "StudyRecord | FitRecord", json: bool) -> "Results":
    results = execution.run(name, record)
    if results.interrupted:
        raise execution.interrupted()
    written = execution.write(results)
    if not json:
        show_validation(results)
        screen.say(f"written: {written}/\n")
    return results


def _write_all(execution: Execution, scored: "list[Results]", tuned: "list[Results]", json: bool) -> None:
    from needlefit.reporting.layouts import tuning_layout
    from needlefit.reporting.write import write_all

    folder = execution.folder("all")
    write_all(scored, tuned, folder)
    if not json:
        for by in ("layers", "media"):
            screen.show_display(tuning_layout(tuned, by))
        screen.say(f"written: {folder}/")
