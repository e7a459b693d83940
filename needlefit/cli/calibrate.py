"""`needlefit calibrate`: are the uncertainties that needlefit computes the right ones?"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import exit_codes, options, screen
from needlefit.cli.execution import Execution, count_cores, print_remark
from needlefit.cli.exit_codes import Invocation, catch_interrupts
from needlefit.cli.options import complete_targets
from needlefit.cli.progress import show_progress
from needlefit.cli.screen import print_run_warnings
from needlefit.cli.tune import add_target_context, load_fit
from needlefit.schemas.limits import MAX_REPLICATES

if TYPE_CHECKING:
    from needlefit.schemas.study import FitRecord
    from needlefit.validation.calibration.replicate import Control
    from needlefit.validation.calibration.run import Calibration


DEFAULT_REPLICATES, DEFAULT_SAMPLED_REPLICATES = 500, 100
"""By default: by importance, and by the sampler."""

ALL = "all"


def calibrate(
    context: typer.Context,
    target: Annotated[
        str,
        typer.Argument(
            metavar="TARGET",
            autocompletion=complete_targets,
            help="A study, a fit in configs/fits, or a path.",
        ),
    ],
    replicates: Annotated[
        int | None,
        typer.Option(
            min=1, max=MAX_REPLICATES, help="How many truths are drawn (default: 500; with --sample 100)."
        ),
    ] = None,
    sample: Annotated[
        bool,
        typer.Option("--sample", help="Draw every posterior with the sampler, of three insertions at most."),
    ] = False,
    control: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="A likelihood wrong on purpose: sigma, prior, pose, shuffled, or all of them.",
        ),
    ] = None,
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    out: options.Out = Path("reports"),
    resume: options.Resume = False,
    strict: options.Strict = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Prove the uncertainties of a TARGET: simulation-based calibration on its own design.

    Parameters are drawn from their prior, the design's needles simulated and measured with errors as stated,
    and inferred as `tune` would; ranks of the truth among draws must be uniform. It proves the
    computation, not the model. Results go to OUT/calibrate-TARGET/ (or -CONTROL). Exit code 6 where they
    are not, or where a control is not noticed; 5 where a sampler has not converged.
    """
    with catch_interrupts() as stop:
        target_name, record = load_fit(target)
        name = target_name.removesuffix("-tune")
        execution = Execution(context.find_root().obj, out, seed, jobs, resume, stop)
        count = replicates or (DEFAULT_SAMPLED_REPLICATES if sample else DEFAULT_REPLICATES)
        runs = {f"calibrate-{name}{_suffix(one, sample)}": one for one in _controls(control)}
        execution.prepare(runs)
        with add_target_context(target):
            found = {
                str(execution.folder(folder)): _run(execution, (name, record), (folder, one), count, sample)
                for folder, one in runs.items()
            }
    _end(execution.invocation, found, json)


def _run(
    execution: Execution,
    fit: "tuple[str, FitRecord]",
    run: "tuple[str, Control | None]",
    count: int,
    sample: bool,
) -> "Calibration":
    """Carry out and write one calibration."""
    from needlefit.reporting.calibration import write_calibration
    from needlefit.validation.calibration.run import calibrate as repeat
    from needlefit.validation.job import Settings

    folder, control = run
    with show_progress(execution.invocation.quiet) as report:
        settings = Settings(
            seed=execution.seed,
            jobs=execution.jobs or count_cores(),
            checkpoint=execution.checkpoint(folder),
            resume=execution.resume,
            sample=sample,
            progress=report,
            stop=execution.stop,
            note=print_remark,
        )
        found = repeat(*fit, settings, count, control)
    if found.interrupted:
        raise execution.interrupted()
    write_calibration(found, execution.folder(folder))
    execution.remove_checkpoint(folder)
    return found


def _controls(named: str | None) -> "list[Control | None]":
    if named is None:
        return [None]
    from needlefit.validation.calibration.replicate import CONTROLS

    if named == ALL:
        return list(CONTROLS)
    for control in CONTROLS:
        if control == named:
            return [control]
    raise typer.BadParameter(f"'{named}' is none of {', '.join((*CONTROLS, ALL))}.", param_hint="--control")


def _suffix(control: "Control | None", sample: bool) -> str:
    return ("-sample" if sample else "") + (f"-{control}" if control else "")


def _end(invocation: Invocation, found: "dict[str, Calibration]", json: bool) -> None:
    """Show the results; end with an exit code if one is not what it should be."""
    from needlefit.reporting.calibration import calibration_to_json
    from needlefit.reporting.calibration_summary import SCOPE_NOTE, lay_out_calibration, summarize_calibration

    if json:
        every = [calibration_to_json(one) for one in found.values()]
        screen.show_json(every if len(every) > 1 else every[0])
    else:
        for folder, one in found.items():
            for sentence in summarize_calibration(one):
                screen.print_line(sentence)
            screen.print_line()
            screen.show_display(lay_out_calibration(one))
            screen.print_line(f"written: {folder}/")
        screen.print_line(SCOPE_NOTE)
    for one in found.values():
        print_run_warnings(invocation, one.run)
    wrong = [folder for folder, one in found.items() if one.conclusive and not one.passes]
    for folder in wrong:
        screen.print_note(f"needlefit: {folder}: {summarize_calibration(found[folder])[0]}")
    if wrong:
        raise typer.Exit(exit_codes.VERIFICATION_FAILED)
    few = any(not one.conclusive and not one.failing for one in found.values())
    if few or any(one.untrusted for one in found.values() if one.control is None):
        raise typer.Exit(exit_codes.NOT_CONVERGED)
