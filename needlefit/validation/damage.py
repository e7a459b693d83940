"""Which files of a run's folder are damaged, or were changed since they were written."""

from collections.abc import Iterator
from pathlib import Path

from needlefit.errors import DataError
from needlefit.project.ownership import changed_files, listed_files
from needlefit.project.run_file import RUN_FILE, read_run
from needlefit.validation.csv_tables import read_table


def damaged_files(folder: Path) -> dict[str, str]:
    """Return what is wrong with each damaged file of a run, by its name; empty if nothing is.

    `run.json` and the CSV tables are read; every other file is compared with its digest in the stamp of the
    folder, and a sampled posterior without one is read. Files that are missing are not looked for.
    """
    found = dict(_unreadable(folder))
    changed = dict.fromkeys(changed_files(folder), "was changed since it was written")
    return {name: {**changed, **found}[name] for name in sorted({*changed, *found})}


def _unreadable(folder: Path) -> Iterator[tuple[str, str]]:
    try:
        read_run(folder)
    except DataError as error:
        yield RUN_FILE, error.what
    for path in sorted(folder.glob("*.csv")):
        try:
            read_table(path)
        except DataError as error:
            yield path.name, error.what
    listed = listed_files(folder)
    for path in sorted(folder.glob("posterior*.nc")):
        if path.name not in listed:
            yield from _unreadable_posterior(path)


def _unreadable_posterior(path: Path) -> Iterator[tuple[str, str]]:
    from needlefit.inference.sampling.posterior import load  # xarray takes a second

    try:
        load(path)
    except DataError as error:
        yield path.name, error.what
