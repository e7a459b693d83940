"""`needlefit verify`: is the model solved rightly?"""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import exit_codes, options, screen
from needlefit.cli.progress import show_progress

if TYPE_CHECKING:
    from needlefit.verification.run import Verification


FOLDER = "verification"


def verify(
    context: typer.Context,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random cases.")] = 1,
    out: options.Out = Path("reports"),
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Verify the solver: closed forms, observed orders, an independent solution, symmetries.

    Every figure is measured now; none is stored. Prints the table and writes it as CSV, JSON
    and PDF to OUT/verification/. Exit code 6 where a row fails.
    """
    from needlefit.project.ownership import require_replaceable
    from needlefit.reporting.verification import (
        summarize_verification,
        tabulate_refinements,
        tabulate_verification,
        write_verification,
    )
    from needlefit.verification.run import verify as measure

    folder = out / FOLDER
    require_replaceable(folder)
    invocation = context.find_root().obj
    screen.compile_ahead("lanes", "sensitivity", quiet=invocation.quiet)
    started = time.perf_counter()
    with show_progress(invocation.quiet) as report:
        found = measure(seed, progress=report)
    if invocation.verbose:
        for trace in found.traces:
            screen.print_note(trace)
    write_verification(found, folder, {"seconds": round(time.perf_counter() - started, 2)})
    if json:
        screen.show_json(
            {
                "seed": seed,
                "summary": summarize_verification(found),
                "rows": tabulate_verification(found),
                "refinements": tabulate_refinements(found),
            }
        )
    else:
        _show(found, folder)
    for row in found.failed:
        screen.print_note(
            f"needlefit: {row.title}: {row.quantity}: fails{f' ({row.remark})' if row.remark else ''}"
        )
    if found.failed:
        raise typer.Exit(exit_codes.VERIFICATION_FAILED)


def _show(found: "Verification", folder: Path) -> None:
    from needlefit.reporting.verification import lay_out_verification, summarize_verification

    for part in lay_out_verification(found):
        screen.show_display(part)
    screen.print_line(summarize_verification(found))
    screen.print_line(f"written: {folder}/")
