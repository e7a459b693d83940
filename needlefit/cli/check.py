"""`needlefit check`: list every fault of a dataset or a study, where it is and how to fix it."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from needlefit.cli import screen
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.options import argument, complete_checked, takes
from needlefit.errors import DataError
from needlefit.project.result_warnings import WARNINGS_KEY, to_rows

if TYPE_CHECKING:
    from needlefit.datasets.insertion import Dataset


@takes(
    "strict json verbose",
    name=argument(
        "DATASET|STUDY",
        "data/<name>/dataset.toml, studies/<name>.toml, configs/fits/<name>.toml, or a path.",
        complete_checked,
    ),
)
def check(context: typer.Context, name: str) -> None:
    """Check a dataset or a study: list every fault and how to fix it, and every warning.

    For a dataset it checks files, ids, units, centrelines, surfaces, bevel sides and checksums; for a study
    its keys and all files that it names. Every fit makes the same checks. Exit code 3: there is a fault; with
    --strict, 5: there is a warning.
    """
    from needlefit.project.locate import find_dataset_or_study

    kind, path = find_dataset_or_study(name)
    invocation = context.find_root().obj
    if kind == "dataset":
        _check_dataset(invocation, path)
    else:
        _check_study(invocation, kind, name, path)


def _check_study(invocation: Invocation, kind: Literal["study", "fit"], name: str, path: Path) -> None:
    from needlefit.project.locate import file_label
    from needlefit.studies.study_files import check_study_file

    found = check_study_file(kind, path)
    if invocation.json:
        folds = [{"tune": tune, "validate": held_out} for tune, held_out in found.folds]
        rows = to_rows(found.warnings)
        screen.show_json(
            {"study": str(path), "ok": True, "kind": found.kind, "folds": folds, WARNINGS_KEY: rows}
        )
    else:
        screen.print_text(f"No faults: {file_label(path)}, {found.kind}{_describe_folds(found.folds)}.")
    screen.print_warnings(invocation, found.warnings)
    if not invocation.json:
        command = "tune" if kind == "fit" else "validate"
        screen.print_note(f"next: {shlex.join(('needlefit', command, name))}")


def _describe_folds(folds: Sequence[tuple[int, int]]) -> str:
    if not folds:
        return ""
    tune, held_out = (sorted(set(counts)) for counts in zip(*folds, strict=True))
    counts = f": n = {_join_range(tune)} fitted"
    if any(held_out):
        counts += f", {_join_range(held_out)} held out"
    return counts if len(folds) == 1 else f"{counts}, in each of {len(folds)} folds"


def _join_range(counts: Sequence[int]) -> str:
    return f"{counts[0]}" if len(counts) == 1 else f"{min(counts)} to {max(counts)}"


def _check_dataset(invocation: Invocation, path: Path) -> None:
    from needlefit.datasets.read import inspect
    from needlefit.datasets.sections import describe_measurement

    found = inspect(path)
    faults, warnings = found.faults, found.warnings
    measured = "" if found.dataset is None else describe_measurement(found.dataset)
    if invocation.json:
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
        count = 0 if found.dataset is None else len(found.dataset.insertions)
        sound = f"No faults: {count} insertion{'' if count == 1 else 's'} in {path}."
        unsound = f"{len(faults)} fault{'' if len(faults) == 1 else 's'} in {path}:"
        screen.print_text(unsound if faults or found.dataset is None else sound)
        for fault in faults:
            error = DataError(fault.what, where=fault.where, expected=fault.expected, fix=fault.fix)
            screen.print_line(str(error))
    screen.print_warnings(invocation, warnings)
    if found.dataset is not None and not faults and not invocation.json:
        _show(found.dataset, measured)
    if faults:
        raise typer.Exit(DataError.exit_code)


def _show(dataset: "Dataset", measured: str) -> None:
    """Print a row per medium and number of layers: insertions, specimens, depths and deflections."""
    import pandas as pd

    from needlefit.reporting.table import Table
    from needlefit.reporting.table_files import to_records

    names = ("medium", "layers", "specimen", "depth", "deflection")
    frame = pd.DataFrame([{name: getattr(one, name) for name in names} for one in dataset.insertions])
    rows = frame.groupby(["medium", "layers"], sort=False, as_index=False).agg(
        insertions=("depth", "size"),
        specimen_count=("specimen", "nunique"),
        **{f"{name}_{end}_mm": (name, end) for name in ("depth", "deflection") for end in ("min", "max")},
    )
    columns = ("medium", "layers", "insertions", "specimen_count", "depth_range_mm", "deflection_range_mm")
    table = Table("dataset", "Insertions.", to_records(rows), columns).lay_out()
    origin = "SYNTHETIC data" if dataset.origin == "synthetic" else "Measured data"
    screen.print_line()
    screen.print_text(f"{origin}: {dataset.title}")
    screen.show_display(table, notes=False)
    screen.print_text(f"Measurement: {measured}.")
