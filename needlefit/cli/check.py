"""`needlefit check`: every fault of a dataset, with where it stands and how to mend it."""

from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.completion import datasets
from needlefit.cli.warn import warn
from needlefit.errors import DataError
from needlefit.project.result_warnings import KEY, as_rows


def check(
    context: typer.Context,
    dataset: Annotated[
        str,
        typer.Argument(
            metavar="DATASET", autocompletion=datasets, help="data/<name>/dataset.toml or a path."
        ),
    ],
    strict: options.Strict = False,
    json: options.Json = False,
    verbose: options.Verbose = False,
) -> None:
    """Check a DATASET: every fault, and how to mend it; then what is suspicious.

    Looks at files, ids, units, centrelines, surfaces, bevel sides and checksums. Every fit checks the same.
    Faults end in exit code 3; warnings do not, unless with --strict in 5.
    """
    from needlefit.datasets.check import check_all
    from needlefit.project.places import find

    path = find("dataset", dataset)
    faults, warnings = check_all(path)
    if json:
        keys = ("where", "what", "expected", "mend")
        rows = [{key: str(getattr(fault, key)) for key in keys} for fault in faults]
        screen.show_json({"dataset": str(path), "ok": not faults, "faults": rows, KEY: as_rows(warnings)})
    elif not faults:
        screen.say(f"{path}: no faults")
    for fault in faults if not json else ():
        screen.say(str(DataError(fault.what, where=fault.where, expected=fault.expected, mend=fault.mend)))
    warn(context.find_root().obj, warnings)
    if faults:
        screen.note(f"needlefit: {path}: {len(faults)} fault{'s' if len(faults) > 1 else ''}")
        raise typer.Exit(DataError.exit_code)
