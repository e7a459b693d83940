"""`needlefit diff`: what changed from one run to another, and whether it matters."""

from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.options import complete_runs

_Run = Annotated[
    str,
    typer.Argument(autocompletion=complete_runs, help="A folder of results, or its bare name in reports/."),
]


def diff(run_a: _Run, run_b: _Run, json: options.Json = False, verbose: options.Verbose = False) -> None:
    """Say what RUN_B changed from RUN_A: inputs, parameters, errors on the same insertions, verdicts.

    And whether it matters: beside each change stands how large it is in its own uncertainty.
    """
    from needlefit.project.locate import find_run
    from needlefit.reporting.differences import (
        differences_to_json,
        lay_out_differences,
        summarize_differences,
    )
    from needlefit.validation.run_differences import compare_runs

    found = compare_runs(find_run(run_a), find_run(run_b))
    if json:
        screen.show_json(differences_to_json(found))
        return
    screen.print_line(summarize_differences(found))
    if found:
        screen.show_display(lay_out_differences(found))
