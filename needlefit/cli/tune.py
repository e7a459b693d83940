"""`needlefit tune`: fit a medium's parameters to measured needles."""

from dataclasses import replace
from pathlib import Path

import typer

from needlefit.cli import options
from needlefit.cli.execution import Execution, open_pool, require_converged
from needlefit.cli.exit_codes import catch_interrupts
from needlefit.cli.show_results import show_result


def tune(
    context: typer.Context,
    target: options.Target,
    sample: options.Sample = False,
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    scheduler: options.Scheduler = None,
    insecure: options.Insecure = False,
    out: options.Out = Path("reports"),
    resume: options.Resume = False,
    strict: options.Strict = False,
    explain: options.Explain = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Fit the parameters of a TARGET (mu, alpha, b).

    Prints each parameter with its 95 % interval, and which ones the data do not determine.

    Of a study only the fit is run; results go to OUT/STUDY-tune/. The folder slicer/ holds every needle,
    measured and fitted with the 95 % band of the parameters, for 3D Slicer. Ctrl-C writes the best result so
    far, marked as interrupted, and prints the command that continues; a second Ctrl-C stops at once.
    """
    with catch_interrupts(
        context.find_root().obj
    ) as stop:  # from here on, so that Ctrl-C never cuts an import in two
        from needlefit.project.toml_lines import add_file_context
        from needlefit.studies.targets import load_target

        name, record, file = load_target(target)
        execution = Execution(context.find_root().obj, out, seed, jobs, resume, stop, sample)
        execution.prepare([name])
        with add_file_context(file), open_pool(jobs, scheduler, insecure) as pool:
            results = replace(execution, pool=pool).run(name, record)
        if results.interrupted and "fitted" not in set(results.frames["errors"]["method"]):
            raise execution.interrupted()  # nothing found yet: an earlier result stays
        written = execution.write(results)
        show_result(execution.invocation, results, written, json)
        if results.interrupted:
            raise execution.interrupted()
        execution.remove_checkpoint(name)
    require_converged(results)
