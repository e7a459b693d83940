"""`needlefit calibrate`: test whether the computed uncertainties are correct."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import exit_codes, options, screen
from needlefit.cli.execution import Execution, open_pool
from needlefit.cli.exit_codes import Invocation, catch_interrupts
from needlefit.cli.show_results import show_run, show_warnings
from needlefit.schemas.limits import MAX_REPLICATES

if TYPE_CHECKING:
    from needlefit.studies.rank_statistics import Control
    from needlefit.studies.run import Run


ALL, SYNTHETIC = "all", "synthetic"


def calibrate(
    context: typer.Context,
    target: options.Target,
    replicates: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=MAX_REPLICATES,
            help="Number of simulated datasets (default: 500; with --sample 100; with --truth synthetic 50).",
        ),
    ] = None,
    sample: Annotated[
        bool,
        typer.Option("--sample", help="Sample every posterior by MCMC; uses at most three insertions."),
    ] = False,
    control: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Use a wrong likelihood, which the test must detect: sigma, prior, pose, shuffled, or all.",
        ),
    ] = None,
    truth: Annotated[
        str,
        typer.Option(
            metavar="SOURCE",
            help="True parameters: drawn from the prior, or synthetic (simulated by another model than the "
            "fitted one).",
        ),
    ] = "prior",
    ct: Annotated[
        bool,
        typer.Option("--ct", help="With --truth synthetic: measure through CT volumes (4 s per insertion)."),
    ] = False,
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
    """Test whether the intervals of a TARGET are right (simulation-based calibration).

    Parameters are drawn from their prior; the needles of TARGET are simulated with them, measured with the
    stated errors, and fitted as `tune` does. The ranks of the true values among the draws must be uniform.
    This tests the computation, not the model.

    With --truth synthetic, the needles are simulated with friction, layers and a needle that the fitted model
    does not have, and held-out tips are predicted. This tests the model.

    Results go to OUT/calibrate-TARGET/ (or -CONTROL, -synthetic, -synthetic-ct). Exit code 6: ranks are not
    uniform, or a control is not detected. Exit code 5: a posterior has not converged, or there are too few
    replicates for a verdict.
    """
    given = {"replicates": replicates} if replicates else {}
    source = _check_truth(truth, ct, sample or control is not None)
    with catch_interrupts(context.find_root().obj) as stop:
        from needlefit.studies.kind import find_kind
        from needlefit.studies.targets import load_target

        name = load_target(target)[0].removesuffix("-tune")
        execution = Execution(context.find_root().obj, out, seed, jobs, resume, stop)
        ending = _suffix(sample, ct, truth)
        runs = {f"calibrate-{name}{ending}{f'-{one}' if one else ''}": one for one in _controls(control)}
        execution.prepare(runs)
        if reference:
            execution.prepare_reference(runs)
        found = {}
        with open_pool(jobs, scheduler, insecure) as pool:
            execution = replace(execution, pool=pool)
            for folder, one in runs.items():
                options_ = {"target": target, "control": one, "sampled": sample, **source, **given}
                record = find_kind("calibration").make_record(**options_)
                found[str(execution.folder(folder))] = execution.run_and_write(folder, record)
                execution.remove_checkpoint(folder)
        if reference:
            execution.write_reference(found.values())
    _end(execution.invocation, found, json)


def _controls(named: str | None) -> "list[Control | None]":
    if named is None:
        return [None]
    from needlefit.studies.kinds.calibration import CONTROLS

    if named == ALL:
        return list(CONTROLS)
    for control in CONTROLS:
        if control == named:
            return [control]
    raise typer.BadParameter(f"'{named}' is none of {', '.join((*CONTROLS, ALL))}.", param_hint="--control")


def _check_truth(truth: str, ct: bool, tests_computation: bool) -> dict[str, object]:
    """Return the keys of a source of truths; a usage error if there is none such, or it excludes others."""
    if truth not in ("prior", SYNTHETIC):
        raise typer.BadParameter(f"'{truth}' is none of prior, {SYNTHETIC}.", param_hint="--truth")
    if ct and truth != SYNTHETIC:
        raise typer.BadParameter(f"needs --truth {SYNTHETIC}.", param_hint="--ct")
    if truth == SYNTHETIC and tests_computation:
        raise typer.BadParameter("excludes --sample and --control.", param_hint=f"--truth {SYNTHETIC}")
    return {"truth": truth, "ct": ct}


def _suffix(sample: bool, ct: bool, truth: str) -> str:
    return ("-sample" if sample else "") + (f"-{truth}" if truth == SYNTHETIC else "") + ("-ct" if ct else "")


def _end(invocation: Invocation, found: "dict[str, Run]", json: bool) -> None:
    """Show the results; end with an exit code if one is not what it should be."""
    from needlefit.studies.kind import find_kind
    from needlefit.studies.report import run_to_json

    if json:
        every = [run_to_json(one) for one in found.values()]
        screen.show_json(every if len(every) > 1 else every[0])
    for folder, one in found.items():
        if json:
            show_warnings(invocation, one)
        else:
            show_run(invocation, one, Path(folder), named=len(found) > 1)
    wrong = [folder for folder, one in found.items() if one.run["conclusive"] and not one.run["passes"]]
    for folder in wrong:
        screen.print_note(
            f"needlefit: {folder}: {find_kind('calibration').report.summarize(found[folder])[0]}"
        )
    if wrong:
        raise typer.Exit(exit_codes.VERIFICATION_FAILED)
    if any(one.faults for one in found.values()):
        raise typer.Exit(exit_codes.NOT_CONVERGED)
