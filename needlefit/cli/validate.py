"""`needlefit validate`: tune on these insertions, score on those, stand beside the paper."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import Execution, open_pool, require_no_faults
from needlefit.cli.exit_codes import catch_interrupts
from needlefit.cli.options import complete_studies

if TYPE_CHECKING:
    from needlefit.cli.run_study import StudyOutcomes


def validate(
    context: typer.Context,
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY",
            autocompletion=complete_studies,
            help="study1 ... study5, all (those five), everything, another, or a path.",
        ),
    ],
    sample: options.Sample = False,
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    scheduler: options.Scheduler = None,
    insecure: options.Insecure = False,
    out: options.Out = Path("reports"),
    reference: options.Reference = False,
    resume: options.Resume = False,
    strict: options.Strict = False,
    explain: options.Explain = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Run a STUDY: fit, score held-out insertions, compare, plan, as its file states.

    `all` runs the paper's five studies and the fits of its tuning tables; `everything` runs all studies whose
    data are present.

    Prints and writes tables, figures and a report, with the paper's numbers beside ours, and slicer/: every
    needle, measured and predicted with its 95 % band, for 3D Slicer.

    Ctrl-C saves what is finished and prints the command that continues; a second Ctrl-C stops at once.
    """
    with catch_interrupts(
        context.find_root().obj
    ) as stop:  # from here on, so that Ctrl-C never cuts an import in two
        from needlefit.cli.run_study import plan_studies, run_studies

        execution = Execution(context.find_root().obj, out, seed, jobs, resume, stop, sample)
        todo = plan_studies(study)
        execution.prepare([*(work.name for work in todo), *_combined_report_names(study)])
        if reference:
            execution.prepare_reference(work.name for work in todo)
        with open_pool(jobs, scheduler, insecure) as pool:
            done = run_studies(replace(execution, pool=pool), todo, json)
        if _combined_report_names(study):
            _write_combined_report(execution, study, done, json)
        if reference:
            execution.write_reference(done.runs)
        if json:
            screen.show_json(done.as_json())
        for work in todo:  # not before all are done: a group is resumed as a whole
            execution.remove_checkpoint(work.name)
    require_no_faults(done.faults())


def _combined_report_names(study: str) -> list[str]:
    """Return the folder of the report of several studies together, if there is one."""
    from needlefit.project.locate import STUDY_GROUPS

    return [study] if study in STUDY_GROUPS else []


def _write_combined_report(execution: Execution, study: str, done: "StudyOutcomes", json: bool) -> None:
    from needlefit.studies.combined_report import write_combined
    from needlefit.studies.kinds.cross_validation.score_tables import lay_out_tuning

    folder = execution.folder(study)
    write_combined(done.runs, folder)
    if not json:
        tuned = [one for one in done.runs if one.kind == "fit"]
        for by in ("layers", "media"):
            screen.show_display(lay_out_tuning(tuned, by))
        screen.print_line(f"written: {folder}/")
