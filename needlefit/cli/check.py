"""`needlefit check`: list every fault of a dataset, where it is and how to fix it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.options import complete_datasets
from needlefit.cli.screen import print_warnings
from needlefit.errors import DataError
from needlefit.project.result_warnings import WARNINGS_KEY, to_rows

if TYPE_CHECKING:
    from needlefit.datasets.insertion import Dataset


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
    """Check a DATASET: list every fault and how to fix it, and every warning.

    Looks at files, ids, units, centrelines, surfaces, bevel sides and checksums. Every fit checks the same.
    Faults end in exit code 3; warnings do not, unless with --strict in 5.
    """
    from needlefit.datasets.read import inspect
    from needlefit.datasets.sections import describe_measurement
    from needlefit.project.locate import find_file

    path = find_file("dataset", dataset)
    found = inspect(path)
    faults, warnings = found.faults, found.warnings
    measured = "" if found.dataset is None else describe_measurement(found.dataset)
    if json:
        keys = ("where", "what", "expected", "fix")
        rows = [{key: str(getattr(fault, key)) for key in keys} for fault in faults]
        screen.show_json(
            {
                "dataset": str(path),
                "ok": not faults,
                "measurement": measured,
                "faults": rows,
                WARNINGS_KEY: to_rows(warnings),
            }
        )
    else:
        screen.print_text(_summarize(path, found.dataset, len(faults)))
        for fault in faults:
            screen.print_line(
                str(DataError(fault.what, where=fault.where, expected=fault.expected, fix=fault.fix))
            )
    print_warnings(context.find_root().obj, warnings)
    if found.dataset is not None and not faults and not json:
        _show(found.dataset, measured)
    if faults:
        raise typer.Exit(DataError.exit_code)


def _summarize(path: Path, dataset: "Dataset | None", faults: int) -> str:
    """Return the outcome in one sentence."""
    if faults or dataset is None:
        return f"{faults} fault{'' if faults == 1 else 's'} in {path}:"
    count = len(dataset.insertions)
    return f"No faults: {count} insertion{'' if count == 1 else 's'} in {path}."


def _show(dataset: "Dataset", measured: str) -> None:
    from needlefit.reporting.dataset_table import lay_out_dataset

    origin = "SYNTHETIC data" if dataset.origin == "synthetic" else "Measured data"
    screen.print_line()
    screen.print_text(f"{origin}: {dataset.title}")
    screen.show_display(lay_out_dataset(dataset), notes=False)
    screen.print_text(f"Measurement: {measured}.")
