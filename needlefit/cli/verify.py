"""`needlefit verify`: test that the model's equations are solved correctly."""

from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import exit_codes, options, screen
from needlefit.cli.execution import Execution
from needlefit.cli.show_results import show_result
from needlefit.project.progress import never_stop

FOLDER = "verification"


def verify(
    context: typer.Context,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random cases.")] = 1,
    out: options.Out = Path("reports"),
    explain: options.Explain = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Verify the solver: closed forms, observed orders, an independent solution, symmetries.

    All values are measured in this run. Prints the outcome of each group of checks, with --explain every
    check, and writes CSV, LaTeX, PDF and HTML to OUT/verification/. Exit code 6 if a check fails.
    """
    from needlefit.studies.kind import find_kind

    execution = Execution(context.find_root().obj, out, None, None, False, never_stop)
    execution.prepare([FOLDER])
    found = execution.run_and_write(FOLDER, find_kind("verification").make_record(seed=seed))
    if execution.invocation.verbose:
        for trace in found.timing.get("traces", ()):
            screen.print_note(trace)
    show_result(execution.invocation, found, execution.folder(FOLDER), json)
    rows = found.frames["verification"]
    for row in rows[rows["verdict"] == "FAILS"].to_dict("records"):
        remark = f" ({row['note']})" if row["note"] else ""
        screen.print_note(f"needlefit: {row['check']}: {row['quantity']}: fails{remark}")
    if found.faults:
        raise typer.Exit(exit_codes.VERIFICATION_FAILED)
