"""`needlefit check`: every fault of a dataset, with where it stands and how to mend it."""

from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.completion import datasets
from needlefit.errors import DataError


def check(
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
    """Check a DATASET: every fault, and how to mend it.

    Looks at files, ids, units, centrelines, surfaces and checksums. Faults end in exit code 3.
    """
    from needlefit.datasets.check import check as find_faults
    from needlefit.project.places import find

    path = find("dataset", dataset)
    faults = find_faults(path)
    if json:
        keys = ("where", "what", "expected", "mend")
        rows = [{key: str(getattr(fault, key)) for key in keys} for fault in faults]
        screen.show_json({"dataset": str(path), "ok": not faults, "faults": rows})
    elif not faults:
        screen.say(f"{path}: no faults")
    for fault in faults if not json else ():
        screen.say(str(DataError(fault.what, where=fault.where, expected=fault.expected, mend=fault.mend)))
    if faults:
        screen.note(f"needlefit: {path}: {len(faults)} fault{'s' if len(faults) > 1 else ''}")
        raise typer.Exit(DataError.exit_code)
