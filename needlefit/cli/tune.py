"""`needlefit tune`: fit a medium's parameters to measured needles."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import Execution, require_converged
from needlefit.cli.exit_codes import catch_interrupts
from needlefit.cli.options import complete_targets
from needlefit.cli.screen import print_run_warnings
from needlefit.cli.show_results import show_tuning, tuning_json
from needlefit.errors import ConfigError

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from needlefit.schemas.study import FitRecord


def tune(
    context: typer.Context,
    target: Annotated[
        str,
        typer.Argument(
            metavar="TARGET",
            autocompletion=complete_targets,
            help="A study, a fit in configs/fits, or a path.",
        ),
    ],
    sample: options.Sample = False,
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    out: options.Out = Path("reports"),
    resume: options.Resume = False,
    strict: options.Strict = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Fit the parameters of a TARGET (mu, alpha, b).

    Stands beside the paper's hand-tuned set, and says what the data leave open.

    A study is tuned only, into OUT/<study>-tune/; its slicer/ holds every needle, measured and fitted with
    its 95 % band, for 3D Slicer. Ctrl-C once writes the best so far, marked, and prints
    the line that goes on; twice leaves at once.
    """
    with catch_interrupts() as stop:  # from here on, so that Ctrl-C never cuts an import in two
        name, record = load_fit(target)
        execution = Execution(context.find_root().obj, out, seed, jobs, resume, stop, sample)
        execution.prepare([name])
        with add_target_context(target):
            results = execution.run(name, record)
        if results.interrupted and "fitted" not in set(results.errors["method"]):
            raise execution.interrupted()  # nothing found yet: an earlier result stays
        written = execution.write(results)
        if json:
            screen.show_json(tuning_json(results))
        else:
            show_tuning(results)
            screen.print_line(f"written: {written}/")
        print_run_warnings(execution.invocation, results.run, results.timing.get("dataset", ""))
        if results.interrupted:
            raise execution.interrupted()
        execution.remove_checkpoint(name)
    require_converged(results)


def add_target_context(target: str) -> "AbstractContextManager[None]":
    """Have errors that name only a key name the file of the study or fit, and the line."""
    from needlefit.project.locate import find_study_or_fit
    from needlefit.project.toml_lines import add_file_context

    return add_file_context(find_study_or_fit(target)[1])


def load_fit(target: str) -> "tuple[str, FitRecord]":
    """Return the name of the results and the fit that the argument means."""
    from needlefit.project.load import load
    from needlefit.project.locate import find_study_or_fit
    from needlefit.schemas.study import FitRecord, StudyRecord
    from needlefit.validation.studies import load_study

    kind, path = find_study_or_fit(target)
    if kind == "fit":
        return path.stem, load(path, FitRecord)
    record = load_study(path)
    if not isinstance(record, StudyRecord):
        raise ConfigError(
            "is a study that does more than tune, and is not tuned by itself",
            where=str(path),
            fix=f"use: needlefit validate {target}",
        )
    return f"{path.stem}-tune", record.tuning()
