"""`needlefit tune`: fit a medium's parameters to measured needles."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.completion import targets
from needlefit.cli.execution import Execution, require_converged
from needlefit.cli.interruption import stopping
from needlefit.cli.show_tuning import as_json, show_tuning
from needlefit.cli.warn import warn_of
from needlefit.errors import ConfigError

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from needlefit.project.records.fit import FitRecord


def tune(
    context: typer.Context,
    target: Annotated[
        str,
        typer.Argument(
            metavar="TARGET", autocompletion=targets, help="A study, a fit in configs/fits, or a path."
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
    with stopping() as stop:  # from here on, so that Ctrl-C never cuts an import in two
        name, record = fit_of(target)
        execution = Execution(context.find_root().obj, out, seed, jobs, resume, stop, sample)
        execution.prepare([name])
        with in_target(target):
            results = execution.run(name, record)
        if results.interrupted and "fitted" not in set(results.errors["rival"]):
            raise execution.interrupted()  # nothing found yet: an earlier result stays
        written = execution.write(results)
        if json:
            screen.show_json(as_json(results))
        else:
            show_tuning(results)
            screen.say(f"written: {written}/")
        warn_of(execution.invocation, results.run, results.timing.get("dataset", ""))
        if results.interrupted:
            raise execution.interrupted()
        execution.forget(name)
    require_converged(results)


def in_target(target: str) -> "AbstractContextManager[None]":
    """Have errors that name only a key name the file of the study or fit, and the line."""
    from needlefit.project.places import find_target
    from needlefit.project.toml_lines import in_file

    return in_file(find_target(target)[1])


def fit_of(target: str) -> "tuple[str, FitRecord]":
    """Return the name of the results and the fit that the argument means."""
    from needlefit.project.load import load
    from needlefit.project.places import find_target
    from needlefit.project.records.fit import FitRecord
    from needlefit.project.records.study import StudyRecord
    from needlefit.validation.studies import load_study

    kind, path = find_target(target)
    if kind == "fit":
        return path.stem, load(path, FitRecord)
    record = load_study(path)
    if not isinstance(record, StudyRecord):
        raise ConfigError(
            "is a study that does more than tune, and is not tuned by itself",
            where=str(path),
            mend=f"use: needlefit validate {target}",
        )
    return f"{path.stem}-tune", record.tuning()
