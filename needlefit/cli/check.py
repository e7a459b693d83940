"""`needlefit check`: list every fault of a dataset, where it is and how to fix it."""

from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.options import complete_datasets
from needlefit.cli.screen import print_warnings
from needlefit.errors import DataError
from needlefit.project.result_warnings import WARNINGS_KEY, to_rows


def check(
    context: typer.Context,
    dataset: Annotated[
        str,
        typer.Argument(
            metavar="DATASET", autocompletion=complete_datasets, help="data/<name>/dataset.toml or a path."
        ),
    ],
    strict: options.Strict = False,
    json: options.Json = False,
    verbose: options.Verbose = False,
) -> None:
    """Check a DATASET: every fault, and how to fix it; then what is suspicious.

    Looks at files, ids, units, centrelines, surfaces, bevel sides and checksums. Every fit checks the same.
    Faults end in exit code 3; warnings do not, unless with --strict in 5.
    """
    from needlefit.datasets.read import check_all
    from needlefit.project.locate import find_file

    path = find_file("dataset", dataset)
    faults, warnings = check_all(path)
    if json:
        keys = ("where", "what", "expected", "fix")
        rows = [{key: str(getattr(fault, key)) for key in keys} for fault in faults]
        screen.show_json(
            {"dataset": str(path), "ok": not faults, "faults": rows, WARNINGS_KEY: to_rows(warnings)}
        )
    elif not faults:
        screen.print_line(f"{path}: no faults")
    for fault in faults if not json else ():
        screen.print_line(
            str(DataError(fault.what, where=fault.where, expected=fault.expected, fix=fault.fix))
        )
    print_warnings(context.find_root().obj, warnings)
    if faults:
        screen.print_note(f"needlefit: {path}: {len(faults)} fault{'s' if len(faults) > 1 else ''}")
        raise typer.Exit(DataError.exit_code)
