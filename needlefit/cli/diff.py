"""`needlefit diff`: what changed from one run to another, and whether it matters."""

from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.options import complete_runs

_Run = Annotated[
    str,
    typer.Argument(autocompletion=complete_runs, help="A folder of results, or its bare name in reports/."),
]


def diff(
    run_a: _Run,
    run_b: _Run,
    everything: Annotated[
        bool, typer.Option("--all", help="Also print the changes that do not matter.")
    ] = False,
    json: options.Json = False,
    verbose: options.Verbose = False,
) -> None:
    """Compare RUN_B with RUN_A: inputs, parameters, errors on the same insertions, verdicts.

    Prints the changes that matter, each with its size relative to its own uncertainty, and the inputs that
    differ. `--json` has all changes.
    """
    from needlefit.project.locate import find_run
    from needlefit.studies.differences import (
        differences_to_json,
        lay_out_differences,
        summarize_differences,
    )
    from needlefit.studies.run_differences import compare_runs

    found = compare_runs(find_run(run_a), find_run(run_b))
    if json:
        screen.show_json(differences_to_json(found))
        return
    screen.print_text(summarize_differences(found))
    table = lay_out_differences(found, everything)
    if table.rows:
        screen.print_line()
        screen.show_display(table, notes=everything)
    if table.notes and not everything:
        screen.print_text("\n".join(table.notes))
