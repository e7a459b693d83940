"""`needlefit identify`: what measurements can tell of the parameters, before and after the fit."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import Execution, count_cores
from needlefit.cli.exit_codes import catch_interrupts
from needlefit.cli.options import complete_targets
from needlefit.cli.screen import print_warnings
from needlefit.cli.tune import add_target_context, load_fit

if TYPE_CHECKING:
    from needlefit.validation.design_identification import Identification
    from needlefit.validation.results import Results


def identify(
    context: typer.Context,
    target: Annotated[
        str,
        typer.Argument(
            metavar="TARGET",
            autocompletion=complete_targets,
            help="A study, a fit in configs/fits, or a path.",
        ),
    ],
    fit: Annotated[
        bool, typer.Option("--fit", help="Also fit, and say what the measured shapes tell.")
    ] = False,
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    out: options.Out = Path("reports"),
    resume: options.Resume = False,
    strict: options.Strict = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Say which parameters the insertions of a TARGET can determine.

    From the design alone: depths, layers, sides, poses and noise, at the paper's hand-tuned set, in the
    middle of the bounds, or with --fit at the fitted values. Fisher information, directions, profile
    likelihoods and contraction against the prior go to OUT/identify-<target>/.
    """
    from needlefit.reporting.identification import (
        identification_to_json,
        merge_warnings,
        write_identification,
    )
    from needlefit.validation.design_identification import identify_design
    from needlefit.validation.run import Settings

    with catch_interrupts() as stop:
        target_name, record = load_fit(target)
        name = f"identify-{target_name.removesuffix('-tune')}"
        execution = Execution(context.find_root().obj, out, seed, jobs, resume, stop)
        execution.prepare([name])
        with add_target_context(target):
            fitted = execution.run(name, record) if fit else None
        if fitted is not None and fitted.interrupted:
            raise execution.interrupted()
        settings = Settings(seed=seed, jobs=jobs or count_cores(), stop=stop)
        with add_target_context(target):
            found = identify_design(name, record, settings, _fitted_values(fitted))
        if stop():
            raise execution.interrupted()
        write_identification(found, fitted, execution.folder(name))
        execution.remove_checkpoint(name)
    if json:
        screen.show_json(identification_to_json(found, fitted))
    else:
        _show(found, fitted)
        screen.print_line(f"written: {execution.folder(name)}/")
    print_warnings(execution.invocation, merge_warnings(found, fitted))


def _show(found: "Identification", fitted: "Results | None") -> None:
    from needlefit.reporting.identification_tables import (
        describe_design,
        describe_verdicts,
        lay_out_expected_directions,
        lay_out_identification,
    )

    for sentence in describe_design(found):
        screen.print_line(sentence)
    screen.print_line()
    screen.show_display(lay_out_identification(found.identification, expected=True))
    screen.show_display(lay_out_expected_directions(found.expectation))
    if fitted is not None:
        screen.show_display(lay_out_identification(fitted.identification))
        for sentence in describe_verdicts(fitted.identification):
            screen.print_line(sentence)


def _fitted_values(fitted: "Results | None") -> dict[str, float] | None:
    if fitted is None:
        return None
    rows = fitted.parameters.query("method == 'fitted'")
    return dict(zip(rows["parameter"], rows["value"].astype(float), strict=True))
