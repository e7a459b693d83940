"""`needlefit identify`: which parameters measurements determine, before and after the fit."""

from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import options
from needlefit.cli.execution import Execution
from needlefit.cli.exit_codes import catch_interrupts
from needlefit.cli.show_results import show_result


def identify(
    context: typer.Context,
    target: options.Target,
    fit: Annotated[
        bool, typer.Option("--fit", help="Also fit, and report what the measured shapes determine.")
    ] = False,
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    out: options.Out = Path("reports"),
    resume: options.Resume = False,
    strict: options.Strict = False,
    explain: options.Explain = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Determine which parameters of a TARGET are identifiable from its insertions.

    Without --fit only the design is used (depths, layers, bevel sides, poses and noise), at the paper's
    hand-tuned parameters or in the middle of the bounds; with --fit, the fitted values. Fisher information,
    its eigenvectors, profile likelihoods and posterior SD / prior SD go to OUT/identify-<target>/.
    """
    with catch_interrupts(context.find_root().obj) as stop:
        from needlefit.studies.kind import find_kind
        from needlefit.studies.targets import load_target

        name = f"identify-{load_target(target)[0].removesuffix('-tune')}"
        execution = Execution(context.find_root().obj, out, seed, jobs, resume, stop)
        execution.prepare([name])
        record = find_kind("identification").make_record(target=target, fit=fit)
        found = execution.run_and_write(name, record)
        execution.remove_checkpoint(name)
    show_result(execution.invocation, found, execution.folder(name), json)
