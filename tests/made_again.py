"""A run's folder made again from what it stored."""

import tempfile
from pathlib import Path

from needlefit.project.folders import MANIFEST, write_manifest
from needlefit.studies.report import rebuild
from needlefit.studies.run import store_run


def store(result, folder):
    """Store a result with a manifest of all that lies in the folder."""
    path = store_run(result, folder)
    write_manifest(folder)
    return path


def read_files(folder):
    """Return every file of a run by its path in the folder, but for its times."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != "timing.json")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def assert_made_again(folder, has_data=False):
    """Every file of a run but its times comes back to the same bytes; beside each figure lies its table.

    A folder that is a dataset `has_data`, which are not made again.
    """
    again = Path(tempfile.mkdtemp(dir=folder.parent, prefix="again-")) / folder.name
    rebuild(folder, again)
    first, second = read_files(folder), read_files(again)
    if has_data:
        first = {name: first[name] for name in second if name != MANIFEST}  # which lists the data too
        second.pop(MANIFEST)
    assert {*first} == {*second}
    assert [name for name in first if first[name] != second[name]] == []
    pictures = {name.removesuffix(".pdf") for name in first if name.endswith(".pdf")} - {"report"}
    assert has_data or {f"{name}.csv" for name in pictures} <= {*first}
    return again
