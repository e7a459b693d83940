"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

from needlefit.schemas.limits import MAX_SEED


def _set_quiet(context: typer.Context, value: bool) -> bool:
    context.find_root().obj.quiet = value
    return value


def _set_verbose(context: typer.Context, value: bool) -> bool:
    context.find_root().obj.verbose = value
    return value


def _set_strict(context: typer.Context, value: bool) -> bool:
    context.find_root().obj.strict = value
    return value


Quiet = Annotated[bool, typer.Option("--quiet", "-q", callback=_set_quiet, help="No progress on stderr.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", callback=_set_verbose, help="Tracebacks of errors.")
]
Json = Annotated[bool, typer.Option("--json", help="Results as JSON on stdout.")]
Seed = Annotated[
    int | None, typer.Option(min=0, max=MAX_SEED, help="Seed of all randomness (default: the recipe's).")
]
Jobs = Annotated[int | None, typer.Option(min=1, help="Threads (default: all cores); changes no result.")]
Out = Annotated[Path, typer.Option(help="Folder that takes the folders of results.")]
Sample = Annotated[bool, typer.Option("--sample", help="Also sample the posterior (netCDF): takes minutes.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on where an interrupted run stopped.")]
Strict = Annotated[
    bool,
    typer.Option("--strict", callback=_set_strict, help="Exit code 5 after a warning; results are written."),
]
