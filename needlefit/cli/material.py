"""`needlefit material`: fit alpha and mu to a compression test."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import Execution
from needlefit.cli.show_results import show_result
from needlefit.project.progress import never_stop


def material(
    context: typer.Context,
    file: Annotated[
        Path, typer.Argument(metavar="FILE.csv", help="Stretch and stress; data/README.md lists the columns.")
    ],
    stress: Annotated[
        Literal["nominal", "true"] | None,
        typer.Option(help="Stress measure of a column `stress_kpa`, whose name does not state it."),
    ] = None,
    foundation: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="FACTOR SPREAD",
            help="Write a prior of the model's mu too: FACTOR times the material's shear modulus, known "
            "within a factor of SPREAD. docs/model.md states the bounds of FACTOR.",
        ),
    ] = None,
    out: options.Out = Path("reports"),
    strict: options.Strict = False,
    explain: options.Explain = False,
    json: options.Json = False,
    verbose: options.Verbose = False,
) -> None:
    """Fit mu and alpha of the Ogden law to a compression test.

    Needle shapes do not identify alpha; a compression test can. Prints the estimates and the 95 % regions of
    alpha, and writes the prior for fits, with tables and figures, to OUT/material-<file>/.
    """
    from needlefit.project.manifest import require_replaceable
    from needlefit.schemas.names import require_file_name
    from needlefit.studies.kind import find_kind

    require_file_name(file.stem, str(file))
    name = f"material-{file.stem}"
    execution = Execution(context.find_root().obj, out, None, None, False, never_stop)
    require_replaceable(out / name)
    record = find_kind("material").make_record(file=str(file), stress=stress, foundation=foundation)
    found = execution.run_and_write(name, record)
    show_result(execution.invocation, found, out / name, json)
    if found.run["prior"] is not None and not json:
        screen.print_line(f'For layer 1 of a fit: priors = {{ 1 = "{out / name}/prior.toml" }}')
